"""The shortest vector under linear equations and bounds, or, where there is none, the one that misses least."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear, nnls

from redundancy_pin.arrays import RANK_TOLERANCE, Array

_WEIGHT = 1e-6
"""Weight of the length, relative to the largest singular value, where the equations cannot be met: directions in which
they hardly change are left alone."""

_ROUNDING = 1e-14
"""Relative change of the squares at which they count as least."""

_MOST = 20
"""Changes of the active set, for each unknown."""

_NOTHING_LEFT = 1e-9
"""Residual of the non-negative least squares below which bounds contradict one another; it is 1 / √(1 + ‖z‖²)."""


def shortest(matrix: Array, wanted: Array, bounded: Array, lower: Array, upper: Array) -> tuple[Array, bool]:
    """Return the shortest y with A y = w and l ≤ C y ≤ u.

    Along y = A⁺ w + N z this is a least-distance problem, which non-negative least squares solves (Lawson and Hanson
    1974, chapter 23). Where nothing within the bounds meets the equations, it is the y within them that makes
    ‖A y − w‖² + ε² ‖y‖² least, ε small: least squares over a box in C y. Both are continuous in w, so an integrator can
    follow them.

    Args:
        matrix: (n, p) A.
        wanted: (n,) w, in the range of A.
        bounded: (p, p) C.
        lower: (p,) l, −inf where there is none; below u.
        upper: (p,) u, inf where there is none.

    Returns:
        y (p,), and whether it is within the bounds; it is not where C is singular and they forbid what is asked.
    """
    limits = _rows(bounded, lower, upper)
    u, values, vt = np.linalg.svd(matrix)
    rank = int((values > RANK_TOLERANCE * values[0]).sum())
    particular = vt[:rank].T @ ((u[:, :rank].T @ wanted) / values[:rank])
    null = vt[rank:].T
    z = _least_distance(limits[0] @ null, limits[1] - limits[0] @ particular)
    if z is not None:
        return particular + null @ z, True
    size = matrix.shape[1]
    if np.linalg.cond(bounded) > 1.0 / RANK_TOLERANCE:
        return particular, False
    system = np.concatenate([matrix, _WEIGHT * values[0] * np.eye(size)])
    goal = np.concatenate([wanted, np.zeros(size)])
    unit = np.linalg.norm(bounded, axis=1)
    inverse = np.linalg.inv(bounded / unit[:, None])
    found = lsq_linear(
        system @ inverse, goal, (lower / unit, upper / unit), method="bvls", tol=_ROUNDING, max_iter=_MOST * size
    )
    return inverse @ found.x, True


def _rows(bounded: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return the finite bounds as G y ≥ h."""
    below, above = np.isfinite(lower), np.isfinite(upper)
    return np.concatenate([bounded[below], -bounded[above]]), np.concatenate([lower[below], -upper[above]])


def _least_distance(G: Array, h: Array) -> Array | None:
    """Return the shortest z with G z ≥ h, or None where there is none."""
    size = np.linalg.norm(G, axis=1)
    none = size <= RANK_TOLERANCE * size.max(initial=0.0)
    if (h[none] > RANK_TOLERANCE * (1.0 + np.abs(h[none]))).any():
        return None  # bounds that z does not move, and that are broken
    G, h = G[~none] / size[~none, None], h[~none] / size[~none]
    scale = float(h.max(initial=0.0))  # every z is at least that long: one of length 1 or more is sought
    if scale <= 0.0:
        return np.zeros(G.shape[1])
    system = np.concatenate([G.T, h[None] / scale])
    goal = np.zeros(len(system))
    goal[-1] = 1.0
    try:
        found, left = nnls(system, goal)
    except RuntimeError:  # it did not converge: the answer that misses least is the safe one
        return None
    if left < _NOTHING_LEFT:
        return None
    residual = system @ found - goal
    answer: Array = -scale * residual[:-1] / residual[-1]
    return answer
