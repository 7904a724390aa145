"""Least squares of a slightly curved function over a box: min ‖c + B u + C (u ∘ u)‖² with lower ≤ u ≤ upper.

Gauss–Newton. Each step is a convex quadratic programme over the box, solved exactly: without the bounds first, and by
pivoting (Júdice and Pires 1992) where that leaves the box. One step misses the curved function by exactly C (d ∘ d), so
the number of steps follows from the size of d. The problems are tiny and solved by the thousand: plain floats where they
are faster than arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from redundancy_pin.arrays import Array
from redundancy_pin.errors import RedundancyPinError

MOST_ITERATIONS = 50
"""Two are usual. The curvature would have to match the slope for it to take ten."""

_DAMPING = 1e-13
"""Added to the squared slope. It leaves no trace in the minimum, only in the rate at which it is reached, and makes a
carrier that the efforts do not feel stay at its acceleration."""

_ROUNDING = 1e-13
"""Relative; below it a bound counts as met and a multiplier as zero when the pivoting decides."""

_PATIENCE = 10
"""Rounds in which all wrong guesses are changed at once may fail this often before they are changed one by one."""


class BoxMinimum(NamedTuple):
    """A minimum over a box.

    Attributes:
        u: (k,) where it is.
        iterations: Gauss–Newton steps.
    """

    u: Array
    iterations: int


def minimise(
    c: Array,
    B: Array,
    C: Array,
    lower: list[float],
    upper: list[float],
    start: Array,
    *,
    slope: float,
    curvature: float,
    tolerance: float,
) -> BoxMinimum:
    """Return the minimum of ‖c + B u + C (u ∘ u)‖² over lower ≤ u ≤ upper.

    Args:
        c: (m,) value at u = 0.
        B: (m, k) slopes there.
        C: (m, k) curvatures.
        lower: k lower bounds; −inf for none.
        upper: k upper bounds, not below the lower ones.
        start: (k,) a guess, inside the box or not.
        slope: size of B, positive.
        curvature: size of C.
        tolerance: how far the gradient at the result may be from that of a minimum, divided by the slope; in the unit
            of c.

    Raises:
        RedundancyPinError: no convergence (the curvature dominates).
    """
    u = start
    damping = _DAMPING * slope * slope * np.eye(len(u))
    for iteration in range(1, MOST_ITERATIONS + 1):
        residual = c + B @ u + C @ (u * u)
        jacobian = B + 2.0 * C * u
        gradient = residual @ jacobian
        hessian = jacobian.T @ jacobian + damping
        step = dposv(hessian, -gradient)[1]
        reached = u + step
        if _outside(reached.tolist(), lower, upper):
            low, high = np.array(lower), np.array(upper)
            step = minimise_quadratic(hessian, gradient, low - u, high - u)
            reached = np.clip(u + step, low, high)
        u = reached
        largest = max(map(abs, step.tolist()))
        remains = max(map(abs, residual.tolist()))
        if curvature * largest * (largest + 2.0 * remains / slope) <= tolerance:
            return BoxMinimum(u, iteration)
    raise RedundancyPinError(
        f"The least-squares problem of one step did not converge in {MOST_ITERATIONS} iterations.",
        remedy="Use a smaller time step: the effort is then closer to affine in the carriers' acceleration.",
        iterations=MOST_ITERATIONS,
    )


def _outside(values: list[float], lower: list[float], upper: list[float]) -> bool:
    for value, low, high in zip(values, lower, upper):  # noqa: B905 (strict costs time here)
        if not low <= value <= high:
            return True
    return False


def minimise_quadratic(hessian: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """Return the minimum of ½ dᵀ H d + gᵀ d over lower ≤ d ≤ upper, H positive definite.

    Every component is free or at one of its bounds. A guess is solved; components outside their bounds are moved to
    them, those whose multiplier has the wrong sign are freed. Changing all at once is fast, changing the last one only
    is certain to end (Murty's rule).

    Args:
        hessian: (k, k) H, symmetric positive definite.
        gradient: (k,) g.
        lower: (k,) lower bounds.
        upper: (k,) upper bounds.
    """
    k = len(gradient)
    side = np.zeros(k, dtype=int)
    fewest, patience = k + 1, _PATIENCE
    for _ in range(MOST_ITERATIONS * 3**k):
        free = np.flatnonzero(side == 0)
        d = np.where(side < 0, lower, np.where(side > 0, upper, 0.0))
        if len(free):
            right = -(gradient[free] + hessian[free] @ d)
            d[free] = dposv(hessian[np.ix_(free, free)], right)[1]
        slope = hessian @ d + gradient
        size = _ROUNDING * (np.abs(hessian) @ np.abs(d) + np.abs(gradient))
        room = _ROUNDING * np.abs(d)
        wanted = np.where(side == 0, np.where(d < lower - room, -1, np.where(d > upper + room, 1, 0)), side)
        wanted[((side < 0) & (slope < -size)) | ((side > 0) & (slope > size))] = 0
        wrong = np.flatnonzero(wanted != side)
        if len(wrong) == 0:
            clipped: Array = np.clip(d, lower, upper)
            return clipped
        if len(wrong) < fewest:
            fewest, patience = len(wrong), _PATIENCE
        else:
            patience -= 1
        changed = wrong if patience > 0 else wrong[-1:]
        side[changed] = wanted[changed]
    raise RedundancyPinError(
        "The pivoting of a box-constrained quadratic programme did not end.",
        remedy="Check the efforts along the motion: they must not be NaN.",
    )


def optimality(c: Array, B: Array, C: Array, lower: Array, upper: Array, u: Array) -> Array:
    """Return (J,) how far J points are from satisfying the conditions of a minimum.

    The gradient, projected on the directions that stay in the box and divided by the size of B, plus nothing for points
    in the box; zero at a minimum. In the unit of c.

    Args:
        c: (J, m) as in ``minimise``, one problem a row.
        B: (J, m, k) slopes.
        C: (J, m, k) curvatures.
        lower: (J, k) lower bounds.
        upper: (J, k) upper bounds.
        u: (J, k) the points.
    """
    residual = c + np.einsum("jmk,jk->jm", B, u) + np.einsum("jmk,jk->jm", C, u * u)
    gradient = np.einsum("jm,jmk->jk", residual, B + 2.0 * C * u[:, None, :])
    gradient = np.where((u <= lower) & (gradient > 0.0), 0.0, gradient)
    gradient = np.where((u >= upper) & (gradient < 0.0), 0.0, gradient)
    size = np.maximum(np.abs(B).max(axis=(1, 2), initial=0.0), np.finfo(float).tiny)
    value: Array = np.abs(gradient).max(axis=1, initial=0.0) / size
    return value


def definiteness(c: Array, B: Array, C: Array, u: Array) -> Array:
    """Return (J,) the smallest eigenvalue of the Hessian at J points, relative to the largest.

    The Hessian is JᵀJ + 2 diag(Cᵀ r), r the residual and J = B + 2 C diag(u). Where it is positive everywhere in the box
    the minimum is the only one; the arguments are those of ``optimality``.
    """
    residual = c + np.einsum("jmk,jk->jm", B, u) + np.einsum("jmk,jk->jm", C, u * u)
    jacobian = B + 2.0 * C * u[:, None, :]
    hessian = np.einsum("jmk,jml->jkl", jacobian, jacobian)
    diagonal = np.arange(u.shape[1])
    hessian[:, diagonal, diagonal] += 2.0 * np.einsum("jmk,jm->jk", C, residual)
    eigenvalues = np.linalg.eigvalsh(hessian)
    ratio: Array = eigenvalues[:, 0] / np.abs(eigenvalues).max(axis=1)
    return ratio
