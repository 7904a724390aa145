"""The arguments of a distribution, checked and freed of units: A u = g, a cost, and bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, checked, frozen, read_only
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.spectrum import scaled

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
