"""Efforts of least weighted norm within bounds: one small quadratic programme for each sample that needs it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import lsq_linear

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.dynamics.minimum_norm import null_basis
from redundancy_pin.errors import RedundancyPinError

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
