"""Numbers read off a plan."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from redundancy_pin.arrays import BoolArray
from redundancy_pin.planners.plan import Plan

Measure = Callable[[Plan], tuple[float, ...]]
"""From a plan to one or more numbers; NaN where the plan has none."""

ACCELERATING = 1e-6
"""Fraction of the largest reference acceleration below which the platform does not accelerate."""


def window(plan: Plan) -> Mapping[str, Any]:
    """Return what a switch-off plan reports of its (first) window."""
    found: Mapping[str, Any] = plan.diagnostics["windows"][0]  # type: ignore[index]
    return found


def entry_time(plan: Plan) -> tuple[float, ...]:
    """Return when the condition number meets the threshold, s."""
    return (float(window(plan)["entry"]),)


def exit_time(plan: Plan) -> tuple[float, ...]:
    """Return when it falls below it again, s."""
    return (float(window(plan)["exit"]),)


def ramp_start(plan: Plan) -> tuple[float, ...]:
    """Return when the forces begin to fall, s."""
    return (float(window(plan)["ramp_start"]),)


def entry_forces(plan: Plan) -> tuple[float, ...]:
    """Return |τ| of each actuator as the forces begin to fall, N."""
    return tuple(abs(float(value)) for value in window(plan)["effort_at_ramp_start"])


def exit_forces(plan: Plan) -> tuple[float, ...]:
    """Return the jump of |τ| of each actuator at switch-on, N: zero but for backward differences."""
    return tuple(float(value) for value in window(plan)["exit_jump"])


def position_at_exit(plan: Plan) -> tuple[float, ...]:
    """Return the largest |s| of a carrier as the actuators are switched on, m."""
    return (max(abs(float(value)) for value in window(plan)["carriers_at_exit"]["s"]),)


def farthest_position(plan: Plan) -> tuple[float, ...]:
    """Return the largest |s| of a carrier over the whole plan, m."""
    return (float(np.abs(plan.carriers.s).max()),)


def peak_in(phase: str) -> Measure:
    """Return a measure: the largest |τ| of any actuator in a phase, N or N·m."""

    def measure(plan: Plan) -> tuple[float, ...]:
        chosen = plan.phase == plan.phases.index(phase)
        return (float(np.nanmax(np.abs(plan.tau[chosen]), initial=0.0)),) if chosen.any() else (float("nan"),)

    return measure


def peak(plan: Plan) -> tuple[float, ...]:
    """Return the largest |τ| of any actuator, N or N·m."""
    return (float(plan.peak_effort.max()),)


def rms(plan: Plan) -> float:
    """Return the root mean square over time of the norm of τ, N or N·m."""
    return float(np.linalg.norm(plan.rms_effort))


def peak_carrier_force(plan: Plan) -> float:
    """Return the largest |force| of a carrier's actuator, N; 0 without carriers."""
    return float(np.abs(plan.carrier_force).max(initial=0.0))


def bounds(plan: Plan, kind: str | None = None, carrier: int | None = None) -> list[tuple[int, str, float, float]]:
    """Return the limits a stepwise plan meets: carrier (from 1), kind, first and last time, s.

    Args:
        plan: a stepwise plan.
        kind: "speed", "acceleration", "track" or "stop"; any when left out.
        carrier: number of the carrier; any when left out.
    """
    events: Any = plan.diagnostics["bounds"]
    found = [
        (plan.robot.carriers.index(event["carrier"]) + 1, event["bound"], event["start"], event["end"])
        for event in events
    ]
    return [event for event in found if (kind is None or event[1] == kind) and (carrier is None or event[0] == carrier)]


def first_bound(kind: str, carrier: int) -> Measure:
    """Return a measure: when a carrier first meets a limit, s; NaN if it never does."""

    def measure(plan: Plan) -> tuple[float, ...]:
        return (min((start for _, _, start, _ in bounds(plan, kind, carrier)), default=float("nan")),)

    return measure


def bound_nearest(kind: str, carrier: int, instant: float) -> Measure:
    """Return a measure: the time nearest to an instant at which a carrier is at a limit, s; NaN if it never is."""

    def measure(plan: Plan) -> tuple[float, ...]:
        times = [float(np.clip(instant, start, end)) for _, _, start, end in bounds(plan, kind, carrier)]
        return (min(times, key=lambda t: abs(t - instant), default=float("nan")),)

    return measure


def accelerating(plan: Plan) -> BoolArray:
    """Return (N,) whether the platform accelerates."""
    size = np.abs(plan.motion.xdd).max(axis=1)
    moving: BoolArray = size > ACCELERATING * size.max()
    return moving


def limited(plan: Plan, kind: str | None = None, carrier: int | None = None) -> BoolArray:
    """Return (N,) whether a limit binds (see ``bounds``)."""
    inside = np.zeros(len(plan.t), dtype=bool)
    for _, _, start, end in bounds(plan, kind, carrier):
        inside |= (plan.t >= start) & (plan.t <= end)
    return inside
