"""The arguments of a distribution, checked and freed of units: A u = g, a cost, and bounds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import lsq_linear

from redundancy_pin.arrays import Array, BoolArray, IntArray, checked, frozen, read_only
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.kinematics.spectrum import scaled


def minimum_norm(matrices: Array, forces: Array, rank: IntArray, cost: Array) -> tuple[Array, Array]:
    """Return the minimiser of Σ cost_j u_j² among the solutions of A u = P g, and the size of g − P g.

    P projects on the range of A, taken as its first ``rank`` singular directions. The caller decides whether what
    the projection leaves out is negligible; until then u is not a solution of A u = g.

    Args:
        matrices: (N, n, m) A, finite, in scaled units.
        forces: (N, n) g, finite, in scaled units.
        rank: (N,) rank of A; all n where n = m takes a plain linear solve, about a tenth of the cost.
        cost: (m,) positive weights.

    Returns:
        efforts: (N, m) u.
        outside: (N,) ‖g − P g‖; zero where the rank is n.
    """
    samples, n, m = matrices.shape
    efforts = np.empty((samples, m))
    outside = np.zeros(samples)
    square = (rank == n) & (n == m)
    if square.any():
        efforts[square] = np.linalg.solve(matrices[square], forces[square, :, np.newaxis])[:, :, 0]
    if square.all():
        return efforts, outside
    other = ~square
    efforts[other], outside[other] = _by_singular_vectors(matrices[other], forces[other], rank[other], cost)
    return efforts, outside


def null_basis(matrix: Array, rank: int) -> Array:
    """Return (m, m − rank) an orthonormal basis of the null space of one matrix (n, m) of known rank."""
    basis: Array = np.linalg.svd(matrix, full_matrices=True)[2][rank:].T
    return basis


def _by_singular_vectors(matrices: Array, forces: Array, rank: IntArray, cost: Array) -> tuple[Array, Array]:
    _, n, m = matrices.shape
    p = min(n, m)
    u, singular_values, vt = np.linalg.svd(matrices, full_matrices=True)
    kept = np.arange(p) < rank[:, np.newaxis]
    inverse = np.divide(1.0, singular_values, out=np.zeros_like(singular_values), where=kept)
    components = np.einsum("Nij,Ni->Nj", u, forces)
    efforts = np.einsum("Nji,Nj->Ni", vt[:, :p], inverse * components[:, :p])
    # summing the left-out components themselves keeps a tiny remainder accurate, unlike g − P g
    left_out = np.where(np.arange(n) < rank[:, np.newaxis], 0.0, components)
    outside: Array = np.linalg.norm(left_out, axis=1)
    if np.ptp(cost) > 0.0 and (rank < m).any():
        # move along the null space (other columns zeroed) to the least ‖√cost u‖
        null = vt.transpose(0, 2, 1) * (np.arange(m) >= rank[:, np.newaxis])[:, np.newaxis, :]
        root = np.sqrt(cost)
        step = np.linalg.pinv(root[:, np.newaxis] * null) @ (root * efforts)[:, :, np.newaxis]
        efforts = efforts - (null @ step)[:, :, 0]
    return efforts, outside


LARGEST_WEIGHT_RATIO = 1e12
"""Weights (on force-equivalent efforts) further apart than this would lose the optimum to rounding."""


@dataclass(frozen=True, eq=False)
class ScaledProblem:
    """Minimise Σ cost_j u_j² over A u = g, lower ≤ u ≤ upper, with u = D_a⁻¹ τ: moments and torques as forces.

    Attributes:
        A: (N, n, m) D_x⁻¹ W D_a; NaN where not solvable.
        g: (N, n) D_x⁻¹ f, N; NaN where not solvable.
        cost: (m,) positive, the largest is 1.
        lower, upper: (N, m) bounds of u, N, infinite where there is none.
        solvable: (N,) the sample is reachable, and its W and f are finite.
    """

    A: Array
    g: Array
    cost: Array
    lower: Array
    upper: Array
    solvable: BoolArray


def scaled_problem(
    reduced: ReducedDynamics, weights: ArrayLike | None, lower: ArrayLike | None, upper: ArrayLike | None
) -> ScaledProblem:
    """Check the arguments of ``distribute`` and return them without units.

    Args:
        reduced: f (N, n), W (N, n, m) and their scales.
        weights: (m,) on τ, or None for 1/column_scale².
        lower: (m,) or (N, m), N or N·m by joint, or None.
        upper: (m,) or (N, m), N or N·m by joint, or None.

    Raises:
        InputError: shapes do not fit, weights or bounds out of their domain.
    """
    _check_shapes(reduced)
    samples, n, m = reduced.W.shape
    row_scale = _positive(reduced.row_scale, "row_scale", n)
    column_scale = _positive(reduced.column_scale, "column_scale", m)
    A = scaled(reduced.W, row_scale, column_scale)
    g: Array = reduced.f / row_scale
    solvable: BoolArray = reduced.reachable & np.isfinite(A).all(axis=(1, 2)) & np.isfinite(g).all(axis=1)
    A[~solvable] = np.nan
    g[~solvable] = np.nan
    low = _bound(lower, "lower", -math.inf, samples, m)
    high = _bound(upper, "upper", math.inf, samples, m)
    _check_order(low, high)
    return ScaledProblem(
        A=read_only(A),
        g=read_only(g),
        cost=_cost(weights, column_scale),
        lower=read_only(low / column_scale),
        upper=read_only(high / column_scale),
        solvable=read_only(solvable),
    )


def _check_shapes(reduced: ReducedDynamics) -> None:
    W, f, reachable = np.shape(reduced.W), np.shape(reduced.f), np.shape(reduced.reachable)
    if len(W) != 3 or 0 in W[1:] or f != W[:2] or reachable != W[:1]:
        raise InputError(
            f"W, f and reachable have shapes {W}, {f} and {reachable}, expected (N, n, m), (N, n) and (N,).",
            remedy="Pass the result of a backend's reduce, or arrays of those shapes with n and m at least 1.",
            W=W,
            f=f,
            reachable=reachable,
        )


def _positive(values: ArrayLike, name: str, length: int) -> Array:
    array = checked(values, name, (length,))
    if not (array > 0.0).all():
        j = int(np.argmin(array))
        raise InputError(
            f"{name}[{j}] is {array[j]:g}, but must be positive.", remedy=f"Make all of {name} positive.", index=j
        )
    return array


def _cost(weights: ArrayLike | None, column_scale: Array) -> Array:
    if weights is None:
        return read_only(np.ones(len(column_scale)))
    cost = _positive(weights, "weights", len(column_scale)) * column_scale**2
    ratio = float(cost.max() / cost.min())
    if not ratio <= LARGEST_WEIGHT_RATIO:
        raise InputError(
            f"The weights, times column_scale², differ by a factor of {ratio:.3g}, more than {LARGEST_WEIGHT_RATIO:g}.",
            remedy="To keep an actuator from contributing, bound it to zero instead of making it expensive.",
            ratio=ratio,
        )
    return read_only(cost / cost.max())


def _bound(values: ArrayLike | None, name: str, absent: float, samples: int, m: int) -> Array:
    if values is None:
        return np.broadcast_to(np.float64(absent), (samples, m))
    try:
        given = frozen(values)
    except (TypeError, ValueError):
        return checked(values, name, (m,))  # raises, and says why
    # finite stand-ins make checked() refuse everything but the infinity that means "no bound"
    is_absent = given == absent
    shape = (m,) if given.ndim == 1 else (samples, m)
    array = np.where(is_absent, absent, checked(np.where(is_absent, 0.0, given), name, shape))
    return np.broadcast_to(array, (samples, m))


def _check_order(lower: Array, upper: Array) -> None:
    wrong = lower > upper
    if wrong.any():
        k, j = (int(i) for i in np.argwhere(wrong)[0])
        raise InputError(
            f"lower is above upper for actuator {j} (first at sample {k}): {lower[k, j]:g} > {upper[k, j]:g}.",
            remedy="Swap or widen the bounds.",
            sample=k,
            actuator=j,
        )


BOUND_TOLERANCE = 1e-9
"""An effort may pass its bound by this fraction of the sample's largest effort before it counts as outside. It is
then put on the bound, so that the bounds hold exactly and the residual shows the difference."""


def leaves_bounds(efforts: Array, lower: Array, upper: Array) -> BoolArray:
    """Return (N,) whether the efforts (N, m) leave the bounds (N, m) by more than the tolerance."""
    slack = BOUND_TOLERANCE * np.abs(efforts).max(axis=1, keepdims=True, initial=0.0)
    outside: BoolArray = ((efforts < lower - slack) | (efforts > upper + slack)).any(axis=1)
    return outside


def fit_into_bounds(matrices: Array, efforts: Array, rank: IntArray, cost: Array, lower: Array, upper: Array) -> Array:
    """Return the minimisers of Σ cost_j u_j² over the solutions of A u = A u₀ within the bounds, NaN if there are none.

    Args:
        matrices: (N, n, m) A, scaled.
        efforts: (N, m) u₀, solutions without bounds, scaled.
        rank: (N,) rank of A.
        cost: (m,) positive weights.
        lower: (N, m) bounds, −∞ allowed, scaled.
        upper: (N, m) bounds, ∞ allowed, scaled.

    Raises:
        RedundancyPinError: a quadratic programme is to be solved and quadprog is not installed.
    """
    fitted = np.full_like(efforts, np.nan)
    for k in np.flatnonzero(rank < matrices.shape[2]):
        null = null_basis(matrices[k], int(rank[k]))
        fitted[k] = _move_along(null, efforts[k], cost, lower[k], upper[k])
    return fitted


def least_residual(matrices: Array, forces: Array, lower: Array, upper: Array) -> Array:
    """Return (N,) min ‖A u − g‖ over lower ≤ u ≤ upper: how much force the bounds leave unbalanced, N, scaled.

    Args:
        matrices: (N, n, m) A, scaled.
        forces: (N, n) g, scaled.
        lower: (N, m) bounds, scaled.
        upper: (N, m) bounds, scaled.
    """
    residual = np.empty(len(forces))
    for k, (A, g, low, high) in enumerate(zip(matrices, forces, lower, upper, strict=True)):
        fixed = low == high  # lsq_linear takes no empty interiors
        rest = g - A[:, fixed] @ low[fixed]
        if not fixed.all():
            box = (low[~fixed], high[~fixed])
            u = np.clip(lsq_linear(A[:, ~fixed], rest, box, method="bvls", tol=1e-14, max_iter=1000).x, *box)
            rest = rest - A[:, ~fixed] @ u
        residual[k] = np.linalg.norm(rest)
    return residual


def _move_along(null: Array, efforts: Array, cost: Array, lower: Array, upper: Array) -> Array:
    """Minimise Σ cost_j u_j² for u = u₀ + N z within the bounds of one sample; NaN if they cannot be met.

    Working in z leaves A u untouched and the programme with as many unknowns as there is freedom. It is divided by
    the largest effort at stake, since quadprog's tolerances are absolute: among them it takes a null direction with an
    entry below 1e-8 as unable to move that effort, which keeps rounding from posing as freedom.
    """
    solve_qp = _quadprog()
    size = max(np.abs(efforts).max(), np.abs(np.clip(efforts, lower, upper)).max())
    start = efforts / size
    root = np.sqrt(cost)[:, np.newaxis] * null
    inverse_factor = np.linalg.inv(np.linalg.qr(root, mode="r"))
    rows = np.concatenate([null, -null])
    limits = np.concatenate([lower / size - start, start - upper / size]) - BOUND_TOLERANCE
    finite = np.isfinite(limits)
    try:
        z = solve_qp(
            inverse_factor, -null.T @ (cost * start), rows[finite].T.copy(), limits[finite], 0, factorized=True
        )[0]
    except ValueError as error:
        if "inconsistent" not in str(error):
            raise
        return np.full_like(efforts, np.nan)
    moved: Array = np.clip(efforts + size * (null @ z), lower, upper)
    return moved


def _quadprog() -> Callable[..., tuple[Array, ...]]:
    try:
        from quadprog import solve_qp
    except ImportError as error:
        raise RedundancyPinError(
            "Efforts leave their bounds and the quadratic programmes that bring them back need quadprog.",
            remedy="Install it with `pip install 'redundancy_pin[bounds]'`.",
            extra="bounds",
        ) from error
    solver: Callable[..., tuple[Array, ...]] = solve_qp
    return solver
