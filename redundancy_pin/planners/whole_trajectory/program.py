"""Quadratic programmes with bilinear constraints, sparse, for IPOPT.

    minimise ½ xᵀ H x + qᵀ x    subject to    l ≤ x ≤ u,    b ≤ A x + (products of two variables) ≤ c

Everything about such a programme is linear: the entries of the Jacobian are an affine function of x, those of the
Hessian of the Lagrangian a linear one of the multipliers. Both are one sparse product, so that neither setting up nor
evaluating needs automatic differentiation, and the cost of both is linear in the number of nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_matrix

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import RedundancyPinError


def casadi() -> Any:
    """Return the optional solver library.

    Raises:
        RedundancyPinError: it is not installed.
    """
    try:
        import casadi as library
    except ImportError as error:
        raise RedundancyPinError(
            "Planning over the whole trajectory needs casadi, which is not installed.",
            remedy="Install it with `pip install 'redundancy_pin[optimal]'`.",
        ) from error
    return library


@dataclass
class _Entries:
    """Triplets that grow: rows, first and second variables, values."""

    parts: list[tuple[IntArray, ...]] = field(default_factory=list)
    values: list[Array] = field(default_factory=list)

    def add(self, *indices_and_value: ArrayLike) -> None:
        *indices, value = np.broadcast_arrays(*indices_and_value)
        kept = value.ravel() != 0.0
        self.parts.append(tuple(np.asarray(index, dtype=np.intp).ravel()[kept] for index in indices))
        self.values.append(np.asarray(value, dtype=float).ravel()[kept])

    def collected(self, indices: int) -> tuple[IntArray, ...]:
        columns = [np.concatenate([np.empty(0, np.intp), *(p[i] for p in self.parts)]) for i in range(indices)]
        return (*columns, np.concatenate([np.empty(0), *self.values]))


class Program:
    """A programme while it is put together; blocks of variables and rows are arrays of their indices."""

    def __init__(self) -> None:
        self.blocks: dict[str, IntArray] = {}
        self._lower: list[Array] = []
        self._upper: list[Array] = []
        self._least: list[Array] = []
        self._most: list[Array] = []
        self._linear, self._product, self._cost, self._square = _Entries(), _Entries(), _Entries(), _Entries()
        self.size = 0
        self.row_count = 0
        self._functions: tuple[dict[str, Any], dict[str, Any]] | None = None

    def variable(self, name: str, shape: tuple[int, ...], lower: Any = -np.inf, upper: Any = np.inf) -> IntArray:
        """Add a block of variables within bounds and return their indices, of the same shape."""
        count = int(np.prod(shape))
        self.blocks[name] = np.arange(self.size, self.size + count).reshape(shape)
        self.size += count
        self._lower.append(np.broadcast_to(lower, shape).ravel())
        self._upper.append(np.broadcast_to(upper, shape).ravel())
        return self.blocks[name]

    def rows(self, shape: tuple[int, ...], lower: Any = 0.0, upper: Any = 0.0) -> IntArray:
        """Add a block of rows within bounds, still empty, and return their indices."""
        count = int(np.prod(shape))
        indices = np.arange(self.row_count, self.row_count + count).reshape(shape)
        self.row_count += count
        self._least.append(np.broadcast_to(lower, shape).ravel())
        self._most.append(np.broadcast_to(upper, shape).ravel())
        return indices

    def add(self, rows: ArrayLike, variables: ArrayLike, coefficient: ArrayLike) -> None:
        """Add coefficient · x to rows; all three broadcast."""
        self._linear.add(rows, variables, coefficient)

    def add_product(self, rows: ArrayLike, first: ArrayLike, second: ArrayLike, coefficient: ArrayLike) -> None:
        """Add coefficient · x_first x_second to rows; all four broadcast."""
        self._product.add(rows, first, second, coefficient)

    def charge(self, variables: ArrayLike, price: ArrayLike) -> None:
        """Add price · x to the cost."""
        self._cost.add(variables, price)

    def charge_square(self, variables: ArrayLike, price: ArrayLike) -> None:
        """Add price · x² to the cost."""
        self._square.add(variables, price)

    def split(self, x: Array) -> dict[str, Array]:
        """Return the blocks of a vector of all variables by name."""
        return {name: x[indices] for name, indices in self.blocks.items()}

    def join(self, values: dict[str, Array]) -> Array:
        """Return the vector of all variables from blocks; those left out are zero."""
        x = np.zeros(self.size)
        for name, value in values.items():
            if name in self.blocks:
                x[self.blocks[name]] = value
        return x

    def bounds(self) -> dict[str, Array]:
        """Return the bounds of variables and rows under the names the solver has for them."""
        parts = {"lbx": self._lower, "ubx": self._upper, "lbg": self._least, "ubg": self._most}
        return {name: np.concatenate([np.empty(0), *part]) for name, part in parts.items()}

    def functions(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the finished programme and its derivatives as the solver wants them; they are made once."""
        if self._functions is None:
            self._functions = self._assembled()
        return self._functions

    def _assembled(self) -> tuple[dict[str, Any], dict[str, Any]]:
        library = casadi()
        x, p = library.MX.sym("x", self.size), library.MX.sym("p", 0)
        lam_f, lam_g = library.MX.sym("lam_f"), library.MX.sym("lam_g", self.row_count)
        rows, at, slope = self._linear.collected(2)
        product_rows, first, second, factor = self._product.collected(3)
        priced, price = self._cost.collected(1)
        squared, square = self._square.collected(1)
        count = len(factor)

        linear = _matrix(csc_matrix((slope, (rows, at)), shape=(self.row_count, self.size)))
        combine = _matrix(csc_matrix((factor, (product_rows, np.arange(count))), shape=(self.row_count, count)))
        g = linear @ x + combine @ (x[first.tolist()] * x[second.tolist()])
        q = np.bincount(priced, price, self.size)
        d = np.bincount(squared, square, self.size)
        f = library.dot(library.DM(q), x) + library.dot(library.DM(d), x * x)

        # entries of the Jacobian: those of A, and for each product the one factor at the place of the other
        nonzero, where = _pattern(
            np.concatenate([rows, product_rows, product_rows]),
            np.concatenate([at, first, second]),
            self.row_count,
            self.size,
        )
        fixed = np.bincount(where[: len(slope)], slope, nonzero.nnz())
        moving = csc_matrix(
            (np.concatenate([factor, factor]), (where[len(slope) :], np.concatenate([second, first]))),
            shape=(nonzero.nnz(), self.size),
        )
        jacobian = library.MX(nonzero, library.DM(fixed) + _matrix(moving) @ x)

        low, high = np.minimum(first, second), np.maximum(first, second)
        upper, place = _pattern(np.concatenate([squared, low]), np.concatenate([squared, high]), self.size, self.size)
        own = np.bincount(place[: len(square)], 2.0 * square, upper.nnz())
        weight = factor * np.where(low == high, 2.0, 1.0)
        curved = csc_matrix((weight, (place[len(square) :], product_rows)), shape=(upper.nnz(), self.row_count))
        hessian = library.MX(upper, lam_f * library.DM(own) + _matrix(curved) @ lam_g)

        derivatives = {
            "grad_f": library.Function("grad_f", [x, p], [f, library.DM(q) + 2.0 * library.DM(d) * x]),
            "jac_g": library.Function("jac_g", [x, p], [g, jacobian]),
            "hess_lag": library.Function("hess_lag", [x, p, lam_f, lam_g], [hessian]),
        }
        return {"x": x, "p": p, "f": f, "g": g}, derivatives


def _pattern(rows: IntArray, columns: IntArray, height: int, width: int) -> tuple[Any, IntArray]:
    """Return the sparsity of entries (repeated ones once), and the number of the nonzero of each."""
    keys, where = np.unique(columns * height + rows, return_inverse=True)
    starts = np.searchsorted(keys, np.arange(width + 1) * height)
    pattern = casadi().Sparsity(height, width, starts.tolist(), (keys % height).tolist())
    return pattern, where.ravel()


def _matrix(matrix: csc_matrix) -> Any:
    """Return a sparse matrix as the solver library's; its own conversion takes ten times as long."""
    library = casadi()
    pattern = library.Sparsity(*matrix.shape, matrix.indptr.tolist(), matrix.indices.tolist())
    return library.DM(pattern, matrix.data)
