"""How far plans can be trusted: the same from both backends, and from several first guesses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.beyond.cases import Whole
from redundancy_pin.experiments.beyond.rows import INFEASIBLE
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.planners.plan import Plan

SAME_PLAN = 1e-6
"""Relative difference up to which plans of two backends count as the same."""

SAME_COST = 1e-4
"""Relative difference of costs up to which two optima count as the same."""

_SAME_TIME = 9
"""Digits of a time, s, that have to agree."""


@dataclass(frozen=True)
class BackendRow:
    """A plan by both backends.

    Attributes:
        case: its name.
        position, speed, acceleration, tau, carrier_force: largest differences over the largest value along the plan;
            infinite where only one backend has a plan.
        cost: relative difference of the objectives.
        statuses: of both plans.
    """

    case: str
    position: float
    speed: float
    acceleration: float
    tau: float
    carrier_force: float
    cost: float
    statuses: tuple[str, str]

    @property
    def worst(self) -> float:
        """The largest difference along the plan."""
        return max(self.position, self.speed, self.acceleration, self.tau, self.carrier_force)

    @property
    def same(self) -> bool:
        """Whether both give the same plan with the same status."""
        return self.worst <= SAME_PLAN and self.statuses[0] == self.statuses[1]

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON; None where a plan is missing."""
        data = {**vars(self), "worst": self.worst, "same": self.same, "statuses": list(self.statuses)}
        return {key: None if isinstance(value, float) and math.isinf(value) else value for key, value in data.items()}


@dataclass(frozen=True)
class StartsRow:
    """A plan from several first guesses.

    Attributes:
        case: its name.
        costs: scaled objective from each guess, parked carriers first; NaN where none was reached.
        step: largest step between nodes, s.
    """

    case: str
    costs: tuple[float, ...]
    step: float

    @property
    def reached(self) -> tuple[float, ...]:
        """The costs of guesses that led to a plan."""
        return tuple(cost for cost in self.costs if not math.isnan(cost))

    @property
    def excess(self) -> float:
        """By how much the worst cost is above the best, relative; NaN without a plan."""
        found = self.reached
        return (max(found) - min(found)) / min(found) if found else math.nan

    @property
    def optima(self) -> int:
        """Number of different costs."""
        count, last = 0, -math.inf
        for cost in sorted(self.reached):
            if cost > last + SAME_COST * abs(cost):
                count, last = count + 1, cost
        return count

    @property
    def parked_is_best(self) -> bool:
        """Whether parked carriers as the first guess lead to the best plan known."""
        return bool(self.reached) and self.costs[0] <= min(self.reached) * (1.0 + SAME_COST)

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {
            "case": self.case,
            "step": self.step,
            "costs": [None if math.isnan(cost) else cost for cost in self.costs],
            "excess": None if math.isnan(self.excess) else self.excess,
            "optima": self.optima,
            "parked_is_best": self.parked_is_best,
        }


def backend_row(store: BeyondStore, case: Whole) -> BackendRow:
    """Plan a case with both backends and compare."""
    first, second = (store.outcome(case, backend) for backend in case.task.machine.backends)
    if isinstance(first, InfeasiblePlanError) or isinstance(second, InfeasiblePlanError):
        # nothing to compare: the same if neither has a plan
        gap = 0.0 if type(first) is type(second) else math.inf
        return BackendRow(case.name, gap, gap, gap, gap, gap, gap, (_status(first), _status(second)))
    one, other = _common(first, second)
    costs = [float(str(plan.diagnostics["cost"])) for plan in (first, second)]
    return BackendRow(
        case.name,
        _difference(first.carriers.s[one], second.carriers.s[other]),
        _difference(first.carriers.sd[one], second.carriers.sd[other]),
        _difference(first.carriers.sdd[one], second.carriers.sdd[other]),
        _difference(first.tau[one], second.tau[other]),
        _difference(first.carrier_force[one], second.carrier_force[other]),
        abs(costs[0] - costs[1]) / max(abs(costs[0]), abs(costs[1])),
        (first.status.value, second.status.value),
    )


def starts_row(store: BeyondStore, case: Whole) -> StartsRow:
    """Return the costs of a case from all of its first guesses."""
    step = case.coarser * case.task.dt
    found = store.outcome(case, case.task.machine.backends[0])
    if isinstance(found, InfeasiblePlanError):
        return StartsRow(case.name, (math.nan,) * case.starts, step)
    costs = found.diagnostics["costs"]
    return StartsRow(case.name, tuple(float(cost) for cost in costs) if isinstance(costs, Sequence) else (), step)


def _status(found: Plan | InfeasiblePlanError) -> str:
    return INFEASIBLE if isinstance(found, InfeasiblePlanError) else found.status.value


def _common(first: Plan, second: Plan) -> tuple[IntArray, IntArray]:
    """Return the nodes that two plans share: all of them unless one grid was refined differently."""
    a, b = (np.round(plan.t, _SAME_TIME) for plan in (first, second))
    if len(a) == len(b) and (a == b).all():
        return np.arange(len(a)), np.arange(len(b))
    _, one, other = np.intersect1d(a, b, return_indices=True)
    return one, other


def _difference(a: Array, b: Array) -> float:
    size = max(float(np.abs(a).max(initial=0.0)), float(np.abs(b).max(initial=0.0)))
    return float(np.abs(a - b).max(initial=0.0)) / size if size > 0.0 else 0.0
