"""Least squares of a slightly curved function over a box: min ‖r(u)‖² with lower ≤ u ≤ upper.

Gauss–Newton on r, which is a quadratic of u with no mixed terms: r(u + d) = r + J d + C (d ∘ d). Each step is a convex
quadratic programme over the box, solved exactly: without the bounds first, and by pivoting (Júdice and Pires 1992)
where that leaves the box. What a step misses is known from the sizes of d, r and C, and decides whether one more is
needed. The problems are tiny and solved by the thousand: plain floats where they are faster than arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import add, mul, sub
from typing import TypeAlias

import numpy as np
from scipy.linalg.lapack import dposv

from redundancy_pin.arrays import Array
from redundancy_pin.errors import RedundancyPinError

Linearised: TypeAlias = Callable[[list[float]], Array]
"""From u, k numbers, to [J r] (m, k + 1), J = ∂r/∂u."""

MOST_ITERATIONS = 50
"""One or two are usual. The curvature would have to match the slope for it to take ten."""

_DAMPING = 1e-13
"""Relative to the squared slope, to which it is added. It changes the rate at which the minimum is reached, not the
minimum, and makes a component that r does not feel stay where it is."""

_ROUNDING = 1e-13
"""Relative; below it a bound counts as met and a multiplier as zero when the pivoting decides."""

_PATIENCE = 10
"""Rounds in which all wrong guesses are changed at once may fail this often before they are changed one by one."""


def minimise(
    linearised: Linearised,
    lower: list[float],
    upper: list[float],
    start: list[float],
    *,
    slope: float,
    curvature: float,
    damping: Array,
    tolerance: float,
) -> tuple[list[float], int]:
    """Return the minimum of ‖r(u)‖² over lower ≤ u ≤ upper.

    Args:
        linearised: J and, as its last column, r at a point.
        lower: k lower bounds; −inf for none.
        upper: k upper bounds, not below the lower ones.
        start: k numbers, a guess, inside the box or not.
        slope: size of J, positive.
        curvature: size of C.
        damping: (k, k) added to JᵀJ, see ``damping_of``.
        tolerance: how far the gradient at the result may be from that of a minimum, divided by the slope; in the unit
            of r.

    Returns:
        The minimum, k numbers, and the number of Gauss–Newton steps it took.

    Raises:
        RedundancyPinError: no convergence (the curvature dominates).
    """
    u, k = start, len(start)
    for iteration in range(1, MOST_ITERATIONS + 1):
        both = linearised(u)
        squared = both.T.dot(both)
        hessian, gradient = squared[:k, :k] + damping, squared[:k, k]
        step = [-d for d in dposv(hessian, gradient)[1].tolist()]
        reached = list(map(add, u, step))
        if _outside(reached, lower, upper):
            low, high = list(map(sub, lower, u)), list(map(sub, upper, u))
            step = minimise_quadratic(hessian.tolist(), gradient.tolist(), low, high, step)
            # a bound is met bit by bit, not up to the rounding of a difference
            ends = zip(u, step, lower, upper, low, high, strict=True)
            reached = [a if d == least else b if d == most else x + d for x, d, a, b, least, most in ends]
        u = reached
        largest, remains = max(map(abs, step)), math.sqrt(squared.item(k, k))
        if curvature * largest * (largest + 2.0 * remains / slope) <= tolerance:
            return u, iteration
    raise RedundancyPinError(
        f"The least-squares problem of one step did not converge in {MOST_ITERATIONS} iterations.",
        remedy="Use a smaller time step: the effort is then closer to affine in the carriers' acceleration.",
        iterations=MOST_ITERATIONS,
    )


def damping_of(k: int, slope: float) -> Array:
    """Return the (k, k) damping of ``minimise`` for slopes of a given size."""
    damping: Array = _DAMPING * slope * slope * np.eye(k)
    return damping


def _outside(values: list[float], lower: list[float], upper: list[float]) -> bool:
    for value, low, high in zip(values, lower, upper):  # noqa: B905, SIM110 (strict or a generator costs time here)
        if not low <= value <= high:
            return True
    return False


def minimise_quadratic(
    hessian: list[list[float]], gradient: list[float], lower: list[float], upper: list[float], guess: list[float]
) -> list[float]:
    """Return the minimum of ½ dᵀ H d + gᵀ d over lower ≤ d ≤ upper, H positive definite.

    Every component is free or at one of its bounds. A choice is solved; components outside their bounds are moved to
    them, those whose multiplier has the wrong sign are freed. Changing all at once is fast, changing the last one only
    is certain to end (Murty's rule).

    Args:
        hessian: (k, k) H, symmetric positive definite.
        gradient: (k,) g.
        lower: (k,) lower bounds.
        upper: (k,) upper bounds.
        guess: (k,) where it lies outside the box a component starts at its bound: the minimum without bounds.
    """
    H, g, low, high = hessian, gradient, lower, upper
    every = range(len(g))
    side = [(x > b) - (x < a) for x, a, b in zip(guess, low, high, strict=True)]
    fewest, patience = len(g) + 1, _PATIENCE
    for _ in range(MOST_ITERATIONS * 3 ** len(g)):
        d = [low[i] if side[i] < 0 else high[i] if side[i] > 0 else 0.0 for i in every]
        free = [i for i in every if side[i] == 0]
        right = [-g[i] - sum(map(mul, H[i], d)) for i in free]
        for i, x in zip(free, _solved([[H[i][j] for j in free] for i in free], right), strict=True):
            d[i] = x
        wanted = [_side(H[i], g[i], d, d[i], low[i], high[i], side[i]) for i in every]
        wrong = [i for i in every if wanted[i] != side[i]]
        if not wrong:
            return [min(max(x, a), b) for x, a, b in zip(d, low, high, strict=True)]
        if len(wrong) < fewest:
            fewest, patience = len(wrong), _PATIENCE
        else:
            patience -= 1
        for i in wrong if patience > 0 else wrong[-1:]:
            side[i] = wanted[i]
    raise RedundancyPinError(
        "The pivoting of a box-constrained quadratic programme did not end.",
        remedy="Check the efforts along the motion: they must not be NaN.",
    )


def _side(row: list[float], g: float, d: list[float], x: float, low: float, high: float, side: int) -> int:
    """Return where a component belongs: −1 at its lower bound, 0 free, 1 at its upper bound."""
    if side == 0:
        room = _ROUNDING * abs(x)
        return (x > high + room) - (x < low - room)
    terms = list(map(mul, row, d))
    slope, size = sum(terms) + g, _ROUNDING * (sum(map(abs, terms)) + abs(g))
    return 0 if side * slope > size else side


def _solved(matrix: list[list[float]], right: list[float]) -> list[float]:
    """Return the solution of a small positive definite system, by elimination."""
    n = len(right)
    for i in range(n):
        for j in range(i + 1, n):
            factor = matrix[j][i] / matrix[i][i]
            for q in range(i + 1, n):
                matrix[j][q] -= factor * matrix[i][q]
            right[j] -= factor * right[i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            right[i] -= matrix[i][j] * right[j]
        right[i] /= matrix[i][i]
    return right


def optimality(residual: Array, jacobian: Array, lower: Array, upper: Array, u: Array) -> Array:
    """Return (P,) how far P points are from satisfying the conditions of a minimum.

    The largest component of the gradient that a move inside the box could follow downhill, divided by the size of J;
    zero at a minimum. In the unit of r.

    Args:
        residual: (P, m) r at the points.
        jacobian: (P, m, k) J there.
        lower: (P, k) lower bounds.
        upper: (P, k) upper bounds.
        u: (P, k) the points.
    """
    gradient = np.einsum("pm,pmk->pk", residual, jacobian)
    gradient = np.where((u <= lower) & (gradient > 0.0), 0.0, gradient)
    gradient = np.where((u >= upper) & (gradient < 0.0), 0.0, gradient)
    size = np.maximum(np.abs(jacobian).max(axis=(1, 2), initial=0.0), np.finfo(float).tiny)
    value: Array = np.abs(gradient).max(axis=1, initial=0.0) / size
    return value


def definiteness(residual: Array, jacobian: Array, curvatures: Array) -> Array:
    """Return (P,) the smallest eigenvalue of the Hessian at P points, relative to the largest.

    The Hessian of ½ ‖r‖² is JᵀJ + 2 diag(Cᵀ r). Where it is positive everywhere in the box the minimum is the only one.

    Args:
        residual: (P, m) r at the points.
        jacobian: (P, m, k) J there.
        curvatures: (P, m, k) C.
    """
    hessian = np.einsum("pmk,pml->pkl", jacobian, jacobian)
    each = np.arange(hessian.shape[1])
    hessian[:, each, each] += 2.0 * np.einsum("pmk,pm->pk", curvatures, residual)
    eigenvalues = np.linalg.eigvalsh(hessian)
    ratio: Array = eigenvalues[:, 0] / np.abs(eigenvalues).max(axis=1)
    return ratio
