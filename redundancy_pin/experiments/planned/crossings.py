"""What became of the crossings: limits broken, the shortest return, the jump on switching on, heavier end-effectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import CROSSINGS, SwitchOffCase
from redundancy_pin.experiments.planned.store import PlanStore

HEAVY_END_EFFECTOR = 0.5
"""Mass of the end-effector, kg, with which the method is tried: that of the 3-RRR's platform."""


@dataclass(frozen=True)
class CrossingRow:
    """One crossing.

    Attributes:
        case: its name.
        status: of the plan.
        broken: limits broken, the worst of each carrier and quantity.
        beyond_track_at_exit: how far a carrier is beyond its track as the actuators are switched on, m.
        beyond_track: the same over the whole plan, m.
        shortest: the shortest return within all limits, s; NaN if there is none.
        no_shortest: why there is none; empty if there is one.
        jump: of the forces on switching on, solved exactly, N.
        jump_of_differences: the same by backward differences with the same step, N.
        step: that step, s.
        peak_on_return: largest force on the return, N.
    """

    case: str
    status: str
    broken: str
    beyond_track_at_exit: float
    beyond_track: float
    shortest: float
    no_shortest: str
    jump: tuple[float, ...]
    jump_of_differences: tuple[float, ...]
    step: float
    peak_on_return: float

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON; None where there is no number."""
        return {**vars(self), "shortest": None if np.isnan(self.shortest) else self.shortest}


@dataclass(frozen=True)
class Infeasible:
    """A plan that does not exist.

    Attributes:
        what: the attempt.
        message: what the planner says.
        details: the numbers it gives.
    """

    what: str
    message: str
    details: Mapping[str, Any]

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {"what": self.what, "message": self.message, "details": dict(self.details)}


def crossing_rows(store: PlanStore) -> tuple[CrossingRow, ...]:
    """Return what became of every crossing of the thesis."""
    return tuple(_row(store, case) for case in CROSSINGS)


def with_heavy_end_effector(store: PlanStore) -> Infeasible | None:
    """Return why the circle cannot be crossed with a massive end-effector; None if it can."""
    case = replace(CROSSINGS[0], name="circle-0.5-heavy", end_effector_mass=HEAVY_END_EFFECTOR)
    try:
        store.plan(case)
    except InfeasiblePlanError as error:
        what = f"circle at 0.5 m/s, CN 5, end-effector of {HEAVY_END_EFFECTOR:g} kg"
        return Infeasible(what, error.message, {key: _plain(value) for key, value in error.details.items()})
    return None


def _row(store: PlanStore, case: SwitchOffCase) -> CrossingRow:
    plan = store.plan(case)
    end = max(limits.upper for limits in plan.limits.judged_by)
    shortest, why = float("nan"), ""
    try:
        shortest = float(m.window(store.plan(replace(case, return_time="shortest")))["return_time"])
    except InfeasiblePlanError as error:
        why = error.message
    other = store.plan(replace(case, scheme="backward_differences"))
    return CrossingRow(
        case=case.name,
        status=plan.status.value,
        broken=_broken(plan.limits.violated),
        beyond_track_at_exit=max(0.0, m.position_at_exit(plan)[0] - end),
        beyond_track=max(0.0, m.farthest_position(plan)[0] - end),
        shortest=shortest,
        no_shortest=why,
        jump=m.exit_forces(plan),
        jump_of_differences=m.exit_forces(other),
        step=case.dt,
        peak_on_return=m.peak_in("return")(plan)[0],
    )


def _broken(events: Any) -> str:
    worst: dict[tuple[str, str], Any] = {}
    for event in events:
        key = (event.carrier, event.quantity)
        if key not in worst or event.amount > worst[key].amount:
            worst[key] = event
    return "; ".join(
        f"{event.quantity} of {event.carrier} by {event.amount:.3g} at {event.worst:.2f} s" for event in worst.values()
    )


def _plain(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value
