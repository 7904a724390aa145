"""The plans of the main cases by both backends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import CrossCheckError
from redundancy_pin.experiments.backends import RNEA, VIRTUAL_WORK
from redundancy_pin.experiments.planned.cases import CORNERS, CROSSINGS, Case
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.planners.plan import Plan

PLAN_TOLERANCE = 1e-8
"""Largest relative difference of two plans: carriers are integrated with error control, which rounding steers."""


@dataclass(frozen=True)
class PlanParity:
    """Largest differences of the plans of two backends, relative to the largest value along the plan.

    Attributes:
        case: name of the case.
        position, speed, acceleration: of the carriers.
        tau: of the main efforts.
        carrier_force: of the carriers' actuators.
        status: of the plan, the same for both.
    """

    case: str
    position: float
    speed: float
    acceleration: float
    tau: float
    carrier_force: float
    status: str

    @property
    def worst(self) -> float:
        """The largest of them."""
        return max(self.position, self.speed, self.acceleration, self.tau, self.carrier_force)

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {**vars(self), "worst": self.worst}


def plan_parity(store: PlanStore, case: Case) -> PlanParity:
    """Plan a case with both backends and compare.

    Raises:
        CrossCheckError: the plans differ by more than ``PLAN_TOLERANCE``, or in length or status.
    """
    first, second = store.plan(case, VIRTUAL_WORK), store.plan(case, RNEA)
    if first.status is not second.status:
        raise CrossCheckError(
            f"The backends plan {case.name} differently: {first.status.value} and {second.status.value}.",
            remedy="One of them is wrong: run `redundancy-pin validate` to see where.",
        )
    one, other = _common(first, second)
    parity = PlanParity(
        case.name,
        _difference(first.carriers.s[one], second.carriers.s[other]),
        _difference(first.carriers.sd[one], second.carriers.sd[other]),
        _difference(first.carriers.sdd[one], second.carriers.sdd[other]),
        _difference(np.nan_to_num(first.tau[one]), np.nan_to_num(second.tau[other])),
        _difference(first.carrier_force[one], second.carrier_force[other]),
        first.status.value,
    )
    if not parity.worst <= PLAN_TOLERANCE:
        raise CrossCheckError(
            f"The plans of {case.name} by the two backends differ by {parity.worst:.3g} (relative), more than "
            f"{PLAN_TOLERANCE:g}.",
            remedy="One of them is wrong: run `redundancy-pin validate` to see where.",
            parity=parity,
        )
    return parity


_SAME_TIME = 9
"""Digits of a time, s, that have to agree."""

MAIN_CASES: tuple[Case, ...] = (*CROSSINGS, *CORNERS)
"""Cases that both backends plan."""


def _common(first: Plan, second: Plan) -> tuple[IntArray, IntArray]:
    """Return the samples that two plans share: those at events may be apart by rounding, and count as the same."""
    a, b = (np.round(plan.t, _SAME_TIME) for plan in (first, second))
    _, one, other = np.intersect1d(a, b, return_indices=True)
    return one, other


def _difference(a: Array, b: Array) -> float:
    size = max(float(np.abs(a).max(initial=0.0)), float(np.abs(b).max(initial=0.0)))
    return float(np.abs(a - b).max(initial=0.0)) / size if size > 0.0 else 0.0
