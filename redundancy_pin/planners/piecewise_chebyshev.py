"""Functions of time as piecewise Chebyshev interpolants, subdivided until they are exact to rounding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.trajectory import Side

NODES = 16
"""Nodes a piece. Smooth motions of a second then need a few dozen pieces for twelve digits."""

LEAST_WIDTH = 1e-7
"""Pieces narrower than this fraction of the interval are not divided: only an undeclared kink gets there, and an error
over so short a time has no consequence."""

MOST_PIECES = 20_000
"""Past this the function is noise at the tolerance asked for, and what has been reached is kept."""


@dataclass(frozen=True, eq=False)
class PiecewiseChebyshev:
    """A function from time to C numbers.

    Attributes:
        edges: (P + 1,) ends of the pieces, s.
        coefficients: (P, 16, C) Chebyshev coefficients of each piece.
    """

    edges: Array
    coefficients: Array

    def __call__(self, t: Array, side: Side = "right") -> Array:
        """Return the values (N, C) at (N,) times inside the interval; ``side`` decides on the edge of two pieces."""
        times = np.asarray(t, dtype=np.float64)
        piece = np.clip(np.searchsorted(self.edges, times, side=side) - 1, 0, len(self.edges) - 2)
        left, right = self.edges[piece], self.edges[piece + 1]
        x = ((2.0 * times - left - right) / (right - left))[:, None]
        later = np.zeros((len(times), self.coefficients.shape[2]))
        last = later.copy()
        for j in range(self.coefficients.shape[1] - 1, 0, -1):  # Clenshaw
            last, later = self.coefficients[piece, j] + 2.0 * x * last - later, last
        value: Array = self.coefficients[piece, 0] + x * last - later
        return value


def fit(
    function: Callable[[Array], Array], edges: Array, knots: Array, scale: Callable[[Array], Array], tolerance: float
) -> PiecewiseChebyshev:
    """Interpolate a function, dividing the pieces until their last coefficients fall below a tolerance.

    Args:
        function: from (N,) strictly increasing times inside the pieces to (N, C) values.
        edges: (P + 1,) ends of the first pieces, s: the ends of the interval and every known jump in between.
        knots: (c,) times at which pieces are preferably divided, s.
        scale: from (N, C) values of the first pieces to the (C,) sizes that the tolerance is a fraction of.
        tolerance: largest allowed last coefficients, as a fraction of the scale.
    """
    nodes = np.sort(chebyshev.chebpts1(NODES))
    to_coefficients = np.linalg.inv(chebyshev.chebvander(nodes, NODES - 1))
    left, right = edges[:-1], edges[1:]
    least = LEAST_WIDTH * (edges[-1] - edges[0])
    done: list[tuple[Array, Array]] = []
    size: Array | None = None
    count = 0
    while len(left):
        times = 0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * nodes
        values = function(times.ravel())
        if size is None:
            size = scale(values)
        coefficients = np.einsum("dn,pnc->pdc", to_coefficients, values.reshape(len(left), NODES, -1))
        tail = (np.abs(coefficients[:, -3:]).max(axis=1) / size).max(axis=1)
        count += len(left)
        divide = (tail > tolerance) & (right - left > least) & (count < MOST_PIECES)
        done.append((left[~divide], coefficients[~divide]))
        middle = np.array([preferred_middle(a, b, knots) for a, b in zip(left[divide], right[divide], strict=True)])
        left, right = (
            np.sort(np.concatenate([left[divide], middle])),
            np.sort(np.concatenate([middle, right[divide]])),
        )
    starts = np.concatenate([part[0] for part in done])
    order = np.argsort(starts)
    return PiecewiseChebyshev(
        read_only(np.append(starts[order], edges[-1])),
        read_only(np.concatenate([part[1] for part in done])[order]),
    )


def preferred_middle(left: float, right: float, knots: Array) -> float:
    """Return where to divide an interval: the knot nearest to its middle, or the middle if there is none inside."""
    middle = 0.5 * (left + right)
    slack = 1e-3 * (right - left)
    inside = knots[np.searchsorted(knots, left + slack) : np.searchsorted(knots, right - slack)]
    return float(inside[np.abs(inside - middle).argmin()]) if len(inside) else middle
