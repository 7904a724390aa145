"""Captions of the figures: what each shows, from which run, with the numbers of that run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import Case, StepwiseCase, SwitchOffCase
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.planners.plan import Plan

Caption = Callable[[PlanStore], str]


def profile(case: Case) -> Caption:
    """Return the caption of speed and acceleration of the platform."""

    def caption(store: PlanStore) -> str:
        trajectory = case.trajectory()
        motion = trajectory.sample(2e-3)
        speed = float(np.linalg.norm(motion.xd[:, :2], axis=1).max())
        acceleration = float(np.linalg.norm(motion.xdd[:, :2], axis=1).max())
        return (
            f"Speed and acceleration of the platform (reference motion of run {case.name}): "
            f"{trajectory.duration:.3f} s in all, at most {speed:.3g} m/s and {acceleration:.3g} m/s²."
        )

    return caption


def crossing_path(case: SwitchOffCase) -> Caption:
    """Return the caption of the 2-RPR with its path."""

    def caption(store: PlanStore) -> str:
        plan = store.plan(case)
        instants = _numbers(plan.diagnostics["singular_instants"])
        places = case.trajectory().sample_at(np.array(instants)).x[:, 0]
        return (
            f"Path of run {case.name} and the mechanism at its start. Crosses mark where A1, B and A2 are in line: "
            f"x = {_list(places)} m, at t = {_list(instants, 4)} s."
        )

    return caption


def corner_paths() -> Caption:
    """Return the caption of the two corners."""
    return lambda store: (
        "The corners of the runs corner-r0.025 and corner-r0.013. Straights of 0.12 m: the 0.07 m of the "
        "text contradict its own times."
    )


def square_path(case: StepwiseCase) -> Caption:
    """Return the caption of the square."""
    return lambda store: (
        f"The square of run {case.name}: straights of 0.17 m between corners of 0.025 m, from and to the dot."
    )


def displacement(case: StepwiseCase) -> Caption:
    """Return the caption of the platform's displacement."""
    return lambda store: (
        f"Displacement of the platform from its start (1, 0.4) m over time (reference motion of run {case.name})."
    )


def condition(case: SwitchOffCase) -> Caption:
    """Return the caption of the condition number."""

    def caption(store: PlanStore) -> str:
        instants = _numbers(store.plan(case).diagnostics["singular_instants"])
        return (
            f"Condition number of the Jacobian along the motion of run {case.name}, with the thresholds. It is "
            f"infinite at t = {_list(instants, 4)} s (dotted); the axis is cut at 1000."
        )

    return caption


def forces(case: SwitchOffCase) -> Caption:
    """Return the caption of the forces of a crossing."""

    def caption(store: PlanStore) -> str:
        plan = store.plan(case)
        found = m.window(plan)
        return (
            f"Forces of the main actuators and condition number, run {case.name} (status {_status(plan)}; return "
            f"in {case.return_time:g} s). They begin to fall from {_list(m.entry_forces(plan))} N at "
            f"{found['ramp_start']:.3f} s, are zero from {found['entry']:.3f} to {found['exit']:.3f} s, and reach "
            f"{m.peak_in('return')(plan)[0]:.3g} N while the carriers return. Positive forces push; the thesis has "
            "the opposite sign."
        )

    return caption


def carriers(case: SwitchOffCase) -> Caption:
    """Return the caption of the carriers of a crossing."""

    def caption(store: PlanStore) -> str:
        plan = store.plan(case)
        broken = sorted({f"{event.quantity} of {event.carrier}" for event in plan.limits.violated})
        said = f" Limits broken: {', '.join(broken)}." if broken else " All limits hold."
        return (
            f"Position, speed and acceleration of the carriers, run {case.name} (status {_status(plan)}). "
            f"As the actuators are switched on a carrier is {m.position_at_exit(plan)[0]:.3f} m from the middle of its "
            f"track; its farthest is {m.farthest_position(plan)[0]:.3f} m.{said}"
        )

    return caption


def torques(case: StepwiseCase) -> Caption:
    """Return the caption of the base torques of a stepwise plan."""

    def caption(store: PlanStore) -> str:
        plan, none, parked = store.plan(case), store.baseline(case), store.parked(case)
        return (
            f"Base torques, run {case.name} in working mode (+,+,+), step {1e3 * case.dt:g} ms (status "
            f"{_status(plan)}): peaks {_list(plan.peak_effort)} N·m; without carriers "
            f"{_list(none.peak_effort)}, with parked ones {_list(parked.peak_effort)} N·m. Limits met: {_met(plan)}."
        )

    return caption


def carrier(case: StepwiseCase, quantity: Literal["position", "acceleration"]) -> Caption:
    """Return the caption of one quantity of the carriers of a stepwise plan."""

    def caption(store: PlanStore) -> str:
        plan = store.plan(case)
        values, unit = (plan.carriers.s, "m") if quantity == "position" else (plan.carriers.sdd, "m/s²")
        return (
            f"{quantity.capitalize()} of the carriers, run {case.name} in working mode (+,+,+) (status "
            f"{_status(plan)}): at most {_list(np.abs(values).max(axis=0))} {unit}. Limits met: {_met(plan)}."
        )

    return caption


def _met(plan: Plan) -> str:
    first: dict[tuple[int, str], tuple[float, float]] = {}
    for number, kind, start, end in m.bounds(plan):
        first.setdefault((number, kind), (start, end))
    named = [f"{kind} of carrier {number} ({a:.2f} to {b:.2f} s)" for (number, kind), (a, b) in first.items()]
    return ", ".join(named) or "none"


def _status(plan: Plan) -> str:
    return plan.status.value


def _numbers(values: object) -> list[float]:
    return [float(value) for value in values] if isinstance(values, (list, tuple)) else []


def _list(values: Sequence[float] | Array, digits: int = 3) -> str:
    return ", ".join(f"{value:.{digits}g}" for value in values)
