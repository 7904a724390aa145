"""The steps of the optimiser: one small least-squares problem after the other (Parsa 2014, section 4.1.1)."""

from __future__ import annotations

from dataclasses import dataclass
from operator import mul

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.planners.box_least_squares import damping_of, minimise
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.effort_model import EffortModel
from redundancy_pin.planners.stepwise_limits import StepLimits

_TOLERANCE = 1e-9
"""Of the gradient at a minimum, as a fraction of the efforts along the motion."""


@dataclass(frozen=True, eq=False)
class StepProblems:
    """The least-squares problem of every step.

    A step of length h from (s, ṡ) with the acceleration u ends at ṡ' = ṡ + h u, s' = s + h ṡ'. The efforts there less
    their target are r, and J = ∂r/∂u; both are linear in φ = (1, s', s'², ṡ', s' ṡ', u), so one product gives both. The
    second derivatives do not depend on the state: r(u + d) = r + J d + C (d ∘ d).

    J steps; step j ends at instant j + 1.

    Attributes:
        t: (J + 1,) instants, s.
        h: (J,) lengths of the steps, s.
        maps: (J, m (k + 1), 1 + 5 k) from φ to [J r], row by row.
        C: (J, m, k) curvatures.
        slope: (J,) size of J.
        curvature: (J,) size of C.
        tolerance: of the gradient, divided by the slope, N or N·m.
    """

    t: Array
    h: Array
    maps: Array
    C: Array
    slope: Array
    curvature: Array
    tolerance: float

    def linearised(self, first: int, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return r (P, m) and J (P, m, k) at the ends (P, k) of the steps from ``first`` on."""
        features = np.concatenate([np.ones((len(s), 1)), s, s * s, sd, s * sd, sdd], axis=1)
        steps, m, k = self.C[first : first + len(s)].shape
        values = np.einsum("jvf,jf->jv", self.maps[first : first + steps], features)
        both = values.reshape(steps, m, k + 1)
        return both[:, :, k], both[:, :, :k]


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
    maps = np.zeros((steps, m, k + 1, 1 + 5 * k))
    maps[:, :, k, 0] = model.tau0[ends] - target[ends]
    maps[:, :, k, 1:] = np.concatenate([by_s, by_s2, by_sd, by_ssd, by_sdd], axis=2)
    each = np.arange(k)
    slope = H * H * by_s + H * by_sd + by_sdd
    maps[:, :, each, 0] = slope
    maps[:, :, each, 1 + each] = 2.0 * H * H * by_s2 + H * by_ssd
    maps[:, :, each, 1 + 2 * k + each] = H * H * by_ssd
    C = H**4 * by_s2 + H**3 * by_ssd
    size = np.abs(slope).max(axis=(1, 2), initial=np.finfo(float).tiny)
    efforts = np.abs(maps[:, :, k, 0]).max(initial=0.0)
    return StepProblems(
        t,
        h,
        maps.reshape(steps, m * (k + 1), -1),
        C,
        size,
        np.abs(C).max(axis=(1, 2), initial=0.0),
        float(_TOLERANCE * (efforts or size.max(initial=0.0))),
    )


@dataclass(frozen=True, eq=False)
class Stretch:
    """Consecutive steps of the optimiser.

    Attributes:
        s: (P, k) positions at the end of each step, m.
        sd: (P, k) speeds there, m/s.
        sdd: (P, k) accelerations, m/s².
        lower: (P, k) smallest accelerations the limits allow.
        upper: (P, k) largest.
        iterations: (P,) iterations of each step.
    """

    s: Array
    sd: Array
    sdd: Array
    lower: Array
    upper: Array
    iterations: IntArray


def optimise(problems: StepProblems, first: int, last: int, start: CarrierState, limits: StepLimits) -> Stretch:
    """Solve steps first ... last − 1, each from where the one before it ended.

    Args:
        problems: the prepared steps.
        first: index of the first step.
        last: one past the last.
        start: the carriers before the first step; their accelerations are the first guess.
        limits: what to keep to.

    Raises:
        InfeasiblePlanError: the box of a step is empty; names carrier, time and amount.
    """
    m, k = problems.C.shape[1:]

    def linearised(u: list[float]) -> Array:
        rate = [v + h * a for v, a in zip(sd, u)]  # noqa: B905 (strict costs time here)
        place = [x + h * v for x, v in zip(s, rate)]  # noqa: B905
        features = [1.0, *place, *map(mul, place, place), *rate, *map(mul, place, rate), *u]
        both: Array = step_map.dot(features).reshape(m, k + 1)
        return both

    damping = damping_of(k, float(problems.slope.max()))
    lengths, times = problems.h.tolist(), problems.t.tolist()
    slopes, curvatures = problems.slope.tolist(), problems.curvature.tolist()
    positions: list[float] = []
    speeds: list[float] = []
    accelerations: list[float] = []
    lower: list[float] = []
    upper: list[float] = []
    iterations: list[int] = []
    s, sd, u = start.s.tolist(), start.sd.tolist(), start.sdd.tolist()
    guess = u
    for j in range(first, last):
        h, step_map, before = lengths[j], problems.maps[j], u
        low, high = limits.box(times[j + 1], h, s, sd)
        u, count = minimise(
            linearised,
            low,
            high,
            guess,
            slope=slopes[j],
            curvature=curvatures[j],
            damping=damping,
            tolerance=problems.tolerance,
        )
        guess = [2.0 * now - then for now, then in zip(u, before)]  # noqa: B905
        sd = [v + h * a for v, a in zip(sd, u)]  # noqa: B905
        s = [x + h * v for x, v in zip(s, sd)]  # noqa: B905
        positions += s
        speeds += sd
        accelerations += u
        lower += low
        upper += high
        iterations.append(count)
    s, sd, sdd, low_box, high_box = (
        np.array(part).reshape(-1, k) for part in (positions, speeds, accelerations, lower, upper)
    )
    return Stretch(s, sd, sdd, low_box, high_box, np.array(iterations, dtype=np.intp))
