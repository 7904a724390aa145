"""The steps of the optimiser: one small least-squares problem after the other (Parsa 2014, section 4.1.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.planners.box_least_squares import minimise
from redundancy_pin.planners.effort_model import EffortModel
from redundancy_pin.planners.stepwise_limits import StepLimits

_TOLERANCE = 1e-13
"""Of the gradient at a minimum, as a fraction of the efforts that the carriers can make."""


@dataclass(frozen=True, eq=False)
class StepProblems:
    """The least-squares problem of every step, as far as it does not depend on the state before the step.

    A step of length h from (s, ṡ) with the acceleration u ends at ṡ' = ṡ + h u, s' = s̄ + h² u, with s̄ = s + h ṡ. Put
    into τ this is c + B u + C (u ∘ u), with c and B linear in φ = (1, s̄, s̄², ṡ, s̄ ṡ) and C a function of time.

    J steps; step j ends at instant j + 1.

    Attributes:
        t: (J + 1,) instants, s.
        h: (J,) lengths of the steps, s.
        c_and_B: (J, m (1 + k), 1 + 4 k) the map from φ to c and B, row by row.
        C: (J, m, k) curvatures.
        slope: (J,) size of B with the carriers at rest in the middle.
        curvature: (J,) size of C.
        tolerance: of the gradient, divided by the slope, N or N·m.
    """

    t: Array
    h: Array
    c_and_B: Array
    C: Array
    slope: Array
    curvature: Array
    tolerance: float


def step_problems(model: EffortModel, target: Array, at: IntArray) -> StepProblems:
    """Prepare the steps between chosen samples of a model.

    Args:
        model: coefficients of the efforts, N samples.
        target: (N, m) efforts to aim at, λ τ̂, N or N·m.
        at: (J + 1,) samples between which the steps lie; their times increase.
    """
    t = model.t[at]
    h = np.diff(t)
    ends = at[1:]
    by_s, by_s2, by_sd, by_ssd, by_sdd = np.moveaxis(model.tau_terms[ends], -1, 0)
    steps, m, k = by_s.shape
    H = h[:, None, None]
    maps = np.zeros((steps, m, 1 + k, 1 + 4 * k))
    maps[:, :, 0, 0] = model.tau0[ends] - target[ends]
    maps[:, :, 0, 1:] = np.concatenate([by_s, by_s2, by_sd, by_ssd], axis=2)
    slope = H * H * by_s + H * by_sd + by_sdd
    each = np.arange(k)
    maps[:, :, 1 + each, 0] = slope
    maps[:, :, 1 + each, 1 + each] = 2.0 * H * H * by_s2 + H * by_ssd
    maps[:, :, 1 + each, 1 + 2 * k + each] = H * H * by_ssd
    C = H**4 * by_s2 + H**3 * by_ssd
    size = np.abs(slope).max(axis=(1, 2), initial=np.finfo(float).tiny)
    efforts = np.abs(maps[:, :, 0, 0]).max(initial=0.0) + size.max(initial=0.0)
    return StepProblems(
        t,
        h,
        np.concatenate([maps[:, :, 0], maps[:, :, 1:].reshape(steps, m * k, -1)], axis=1),
        C,
        size,
        np.abs(C).max(axis=(1, 2), initial=0.0),
        float(_TOLERANCE * efforts),
    )


@dataclass(frozen=True, eq=False)
class Stretch:
    """Consecutive steps of the optimiser.

    Attributes:
        s, sd, sdd: (J, k) positions, speeds and accelerations at the end of each step.
        lower, upper: (J, k) box of the accelerations.
        c: (J, m) efforts less their target at s̈ = 0.
        B: (J, m, k) slopes.
        iterations: (J,) iterations of each step.
    """

    s: Array
    sd: Array
    sdd: Array
    lower: Array
    upper: Array
    c: Array
    B: Array
    iterations: IntArray


def optimise(
    problems: StepProblems, first: int, last: int, s: Array, sd: Array, sdd: Array, limits: StepLimits
) -> Stretch:
    """Solve steps first ... last − 1, each from where the one before it ended.

    Args:
        problems: the prepared steps.
        first: index of the first step.
        last: one past the last.
        s, sd: (k,) state before the first step, m and m/s.
        sdd: (k,) acceleration before it, m/s²: the first guess.
        limits: what to keep to.

    Raises:
        InfeasiblePlanError: the box of a step is empty; names carrier, time and amount.
    """
    m, k = problems.C.shape[1:]
    lengths, times = problems.h.tolist(), problems.t.tolist()
    slopes, curvatures = problems.slope.tolist(), problems.curvature.tolist()
    features = np.ones(1 + 4 * k)
    coasted, coasted2, speed, product = (features[1 + j * k : 1 + (j + 1) * k] for j in range(4))
    found: tuple[list[Array], ...] = ([], [], [], [])
    positions, speeds, accelerations, values = found
    lower, upper, iterations = [], [], []
    guess = u = sdd
    for j in range(first, last):
        h = lengths[j]
        np.multiply(sd, h, coasted)
        np.add(coasted, s, coasted)
        np.multiply(coasted, coasted, coasted2)
        speed[:] = sd
        np.multiply(coasted, sd, product)
        value = problems.c_and_B[j] @ features
        low, high = limits.box(times[j + 1], h, s.tolist(), sd.tolist())
        before = u
        u, count = minimise(
            value[:m],
            value[m:].reshape(m, k),
            problems.C[j],
            low,
            high,
            guess,
            slope=slopes[j],
            curvature=curvatures[j],
            tolerance=problems.tolerance,
        )
        guess = u + (u - before)
        sd = sd + h * u
        s = s + h * sd
        positions.append(s)
        speeds.append(sd)
        accelerations.append(u)
        values.append(value)
        lower.append(low)
        upper.append(high)
        iterations.append(count)
    stacked = np.array(values).reshape(-1, m * (1 + k))
    return Stretch(
        *(np.array(part).reshape(-1, k) for part in (positions, speeds, accelerations, lower, upper)),
        stacked[:, :m],
        stacked[:, m:].reshape(-1, m, k),
        np.array(iterations, dtype=np.intp),
    )
