"""Effort of the main actuators against acceleration of the carriers: what each weight between the two leads to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.beyond.cases import Whole
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.tasks import Task
from redundancy_pin.planners.plan import Plan

ORDERED = 1e-6
"""Relative rise of a quantity that should fall which still counts as rounding of the solver."""


@dataclass(frozen=True)
class TradePoint:
    """One weight.

    Attributes:
        ratio: weight over the one at which both parts of the cost are the same for the plan of least effort; 0 for
            effort alone.
        weight: of ∫ Σ s̈² dt beside ∫ Σ τ² dt, in units of these.
        rms_effort: root mean square over time of the norm of τ, N or N·m.
        rms_acceleration: the same of s̈, m/s².
        peak: largest |τ|.
        status: of the plan; "infeasible", and zeros, where there is none.
    """

    ratio: float
    weight: float
    rms_effort: float
    rms_acceleration: float
    peak: float
    status: str

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return dict(vars(self))


@dataclass(frozen=True)
class Trade:
    """The trade-off for one motion.

    Attributes:
        task: its name.
        title: for people.
        unit: of the efforts.
        points: by increasing weight of the acceleration.
    """

    task: str
    title: str
    unit: str
    points: tuple[TradePoint, ...]

    @property
    def monotone(self) -> bool:
        """Whether effort rises and acceleration falls with the weight, as they must between global optima."""
        efforts, accelerations = (
            [getattr(point, name) for point in self.points] for name in ("rms_effort", "rms_acceleration")
        )
        return _rises(efforts) and _rises(accelerations[::-1])

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {"task": self.task, "monotone": self.monotone, "points": [point.as_dict() for point in self.points]}


def trade(store: BeyondStore, task: Task, ratios: Sequence[float], coarser: float) -> Trade:
    """Return the trade-off for a motion.

    Args:
        store: the plans.
        task: the motion.
        ratios: see ``TradePoint``, ascending.
        coarser: factor on the largest step between nodes.

    Raises:
        InfeasiblePlanError: the motion has no plan at all.
    """
    backend = task.machine.backends[0]
    least = store.plan(Whole(task, (("effort", 1.0),), coarser), backend)
    effort: Mapping[str, Any] = least.diagnostics["objective"]  # type: ignore[assignment]
    equal = float(effort["effort"]) / integral(least.t, least.carriers.sdd)
    points = [_point(0.0, 0.0, least)]
    for ratio in ratios:
        weight = ratio * equal
        case = Whole(task, (("effort", 1.0), ("carrier_acceleration", weight)), coarser)
        found = store.outcome(case, backend)
        if isinstance(found, InfeasiblePlanError):
            points.append(TradePoint(ratio, weight, 0.0, 0.0, 0.0, "infeasible"))
        else:
            points.append(_point(ratio, weight, found))
    return Trade(task.name, task.title, task.unit, tuple(points))


def integral(t: Array, values: Array) -> float:
    """Return ∫ Σ v² dt by the trapezoidal rule.

    Args:
        t: (N,) time, s.
        values: (N, k) v.
    """
    return float(np.trapezoid((values**2).sum(axis=1), t))


def rms_acceleration(plan: Plan) -> float:
    """Return the root mean square over time of the norm of s̈, m/s²."""
    return float(np.sqrt(integral(plan.t, plan.carriers.sdd) / (plan.t[-1] - plan.t[0])))


def _point(ratio: float, weight: float, plan: Plan) -> TradePoint:
    rms = float(np.linalg.norm(plan.rms_effort))
    return TradePoint(ratio, weight, rms, rms_acceleration(plan), float(plan.peak_effort.max()), plan.status.value)


def _rises(values: Sequence[float]) -> bool:
    return all(after >= before * (1.0 - ORDERED) for before, after in pairwise(values))
