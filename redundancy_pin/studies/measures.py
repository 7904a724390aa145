"""Numbers read off a plan or off a motion without a planner; the data files name these functions.

A measure returns one or more numbers, NaN where there is none. ``measure("first_bound", "speed", 2)`` binds the
arguments behind the plan.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.interpolate import BPoly
from scipy.signal import find_peaks

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.planner import between_samples
from redundancy_pin.studies.case import Case
from redundancy_pin.studies.motions import MotionRun, relative_difference, windows
from redundancy_pin.trajectory import Trajectory

Numbers = tuple[float, ...]
Measure = Callable[[Any], Numbers]

ACCELERATING = 1e-6
"""Fraction of the largest reference acceleration below which the platform does not accelerate."""

SWING = 0.05
"""Fraction of the peak that an effort has to move back by for a turn to count."""

FINER = 20
"""Points in a step at which plans are looked at between their samples, as in the planner's own dense check."""

_FINER_SWITCH_OFF = 5
"""The same for switch-off plans, whose samples are 1 ms apart: a fifth of the nodes' 5 ms."""

_SAME_TIME = 9
"""Digits of a time, s, that have to agree for two samples to be the same: those at events may be apart by rounding."""


def measure(name: str, *arguments: Any) -> Measure:
    """Return a measure of this file by its name."""
    function = globals()[name]
    return lambda plan: function(plan, *arguments)


# --- switch-off plans ----------------------------------------------------------------------------------------------


def window(plan: Plan) -> Mapping[str, Any]:
    """Return what a switch-off plan reports of its (first) window."""
    first: Mapping[str, Any] = plan.diagnostics["windows"][0]  # type: ignore[index]
    return first


def time_of(plan: Plan, event: str) -> Numbers:
    """Return when the condition number meets the threshold ("entry") and falls below it, or forces begin to fall, s."""
    return (float(window(plan)[event]),)


def entry_forces(plan: Plan) -> Numbers:
    """Return |τ| of each actuator as the forces begin to fall, N."""
    return tuple(abs(float(value)) for value in window(plan)["effort_at_ramp_start"])


def exit_forces(plan: Plan) -> Numbers:
    """Return the jump of |τ| of each actuator at switch-on, N: zero but for backward differences."""
    return tuple(float(value) for value in window(plan)["exit_jump"])


def rise_to_threshold(plan: Plan) -> Numbers:
    """Return by how much |τ| rises at most from the start of the ramp-down to the threshold, carriers parked, N."""
    met = window(plan)["parked_effort_at_entry"]
    return (max(abs(float(b)) - a for a, b in zip(entry_forces(plan), met, strict=True)),)


def condition_at(plan: Plan, instant: float) -> Numbers:
    """Return the condition number at an instant, s."""
    return (float(np.interp(instant, plan.t, np.minimum(plan.condition, 1e6))),)


def position_at_exit(plan: Plan) -> Numbers:
    """Return the largest |s| of a carrier as the actuators are switched on, m."""
    return (max(abs(float(value)) for value in window(plan)["carriers_at_exit"]["s"]),)


def peak_until_off(plan: Plan) -> float:
    """Return the largest |τ| until the motors are off, N or N·m; NaN of plans that do not switch off."""
    if plan.planner != "switch_off":
        return math.nan
    off = np.flatnonzero(plan.phase == plan.phases.index("off"))
    return float(np.nanmax(np.abs(plan.tau[: off[0]]))) if len(off) else math.nan


# --- plans of any kind ---------------------------------------------------------------------------------------------


def farthest_position(plan: Plan) -> Numbers:
    """Return the largest |s| of a carrier over the whole plan, m."""
    return (float(np.abs(plan.carriers.s).max()),)


def peak(plan: Plan) -> Numbers:
    """Return the largest |τ| of any actuator, N or N·m."""
    return (float(plan.peak_effort.max()),)


def peak_in(plan: Plan, phase: str) -> Numbers:
    """Return the largest |τ| of any actuator in a phase, N or N·m."""
    chosen = plan.phase == plan.phases.index(phase)
    return (float(np.nanmax(np.abs(plan.tau[chosen]), initial=0.0)) if chosen.any() else math.nan,)


def largest_rms(plan: Plan) -> Numbers:
    """Return the largest root mean square over time of an actuator's τ, N or N·m."""
    return (float(plan.rms_effort.max()),)


def reversals(plan: Plan) -> IntArray:
    """Return (m,) how often each main effort turns round and then moves by more than ``SWING`` of the peak."""
    least = SWING * float(plan.peak_effort.max())
    if least == 0.0:
        return np.zeros(plan.tau.shape[1], dtype=np.intp)
    tau = np.nan_to_num(plan.tau)
    return np.array(
        [sum(len(find_peaks(sign * effort, prominence=least)[0]) for sign in (1.0, -1.0)) for effort in tau.T]
    )


def rms_acceleration(plan: Plan) -> float:
    """Return the root mean square over time of the norm of s̈, m/s²."""
    return float(np.sqrt(square_integral(plan.t, plan.carriers.sdd) / (plan.t[-1] - plan.t[0])))


def square_integral(t: Array, values: Array) -> float:
    """Return ∫ Σ v² dt by the trapezoidal rule, from (N,) times and (N, k) v."""
    return float(np.trapezoid((values**2).sum(axis=1), t))


def broken_limits(plan: Plan) -> str:
    """Return the limits broken, the worst of each carrier and quantity: ``"track of carrier_1 by 0.05 at 0.9 s"``."""
    worst: dict[tuple[str, str], Any] = {}
    for event in plan.limits.violated:
        key = (event.quantity, event.carrier)
        if key not in worst or event.amount > worst[key].amount:
            worst[key] = event
    return "; ".join(
        f"{what} of {carrier} by {event.amount:.3g} at {event.worst:.2f} s" for (what, carrier), event in worst.items()
    )


def accelerating(plan: Plan) -> BoolArray:
    """Return (N,) whether the platform accelerates."""
    size = np.abs(plan.motion.xdd).max(axis=1)
    moving: BoolArray = size > ACCELERATING * size.max()
    return moving


# --- limits that a stepwise plan meets -----------------------------------------------------------------------------


def bounds(plan: Plan, kind: str | None = None, carrier: int | None = None) -> list[tuple[int, str, float, float]]:
    """Return the limits a stepwise plan meets: carrier (from 1), kind, first and last time, s.

    Kinds are "speed", "acceleration", "track" and "stop"; any kind, any carrier when left out.
    """
    events: Any = plan.diagnostics["bounds"]
    met = [
        (plan.robot.carriers.index(event["carrier"]) + 1, event["bound"], event["start"], event["end"])
        for event in events
    ]
    return [event for event in met if (kind is None or event[1] == kind) and (carrier is None or event[0] == carrier)]


def first_bound(plan: Plan, kind: str, carrier: int) -> Numbers:
    """Return when a carrier first meets a limit, s; NaN if it never does."""
    return (min((start for _, _, start, _ in bounds(plan, kind, carrier)), default=math.nan),)


def bound_nearest(plan: Plan, kind: str, carrier: int, instant: float) -> Numbers:
    """Return the time nearest to an instant at which a carrier is at a limit, s; NaN if it never is."""
    times = [float(np.clip(instant, start, end)) for _, _, start, end in bounds(plan, kind, carrier)]
    return (min(times, key=lambda t: abs(t - instant), default=math.nan),)


def limits_met(plan: Plan) -> str:
    """Return which carriers meet which limit first when: ``"2 speed 0.34 s, 2 acceleration 0.82 s"``."""
    first: dict[tuple[int, str], float] = {}
    for carrier, kind, start, _ in bounds(plan):
        first.setdefault((carrier, kind), start)
    return ", ".join(f"{carrier} {kind} {start:.2f} s" for (carrier, kind), start in first.items()) or "none"


# --- between the samples: samples alone flatter a method that chooses accelerations for them -----------------------


def dense_peak(case: Case, plan: Plan) -> float:
    """Return the largest |τ| between the samples of a plan, N or N·m; of a switch-off plan while the motors are on."""
    dynamics, trajectory = case.dynamics(), case.trajectory()
    match case.planner:
        case "switch_off":
            return _dense_switch_off(dynamics, trajectory, plan)
        case "stepwise":
            return max(between_samples(dynamics, plan, FINER - 1, trajectory)["peak_effort"])  # type: ignore[call-overload, no-any-return]
        case "whole_trajectory":  # the planner looks itself
            check: Mapping[str, Any] = plan.diagnostics["dense_check"]  # type: ignore[assignment]
            return float(check["peak_effort"])
    motion = trajectory.sample(case.dt / FINER)
    carriers = CarrierMotion.parked(len(motion), dynamics.robot.k)
    return float(np.abs(distribute(dynamics.reduce(motion, carriers)).tau).max())


def _dense_switch_off(dynamics: Dynamics, trajectory: Trajectory, plan: Plan) -> float:
    """Carriers move on quintics through s, ṡ, s̈ of the samples, which follow the planner's motion to rounding."""
    off = plan.phase == plan.phases.index("off")
    left = np.flatnonzero((np.diff(plan.t) > 0.0) & ~off[1:] & ~off[:-1])
    fraction = (np.arange(_FINER_SWITCH_OFF) + 0.5) / _FINER_SWITCH_OFF
    times = (plan.t[left, None] + np.diff(plan.t)[left, None] * fraction).ravel()
    carriers = _interpolated(plan, times)
    efforts = distribute(dynamics.reduce(trajectory.sample_at(times), carriers, check_track=False)).tau
    return float(np.nanmax(np.abs(efforts)))


def _interpolated(plan: Plan, times: Array) -> CarrierMotion:
    """Return the carriers between the samples; a time that occurs twice separates two pieces."""
    carriers, edges = plan.carriers, np.flatnonzero(np.diff(plan.t) == 0.0) + 1
    parts = [np.empty((len(times), carriers.s.shape[1])) for _ in range(3)]
    for first, stop in zip([0, *edges], [*edges, len(plan.t)], strict=True):
        if stop - first < 2:
            continue
        here = (times >= plan.t[first]) & (times <= plan.t[stop - 1])
        piece = slice(first, stop)
        given = np.stack([carriers.s[piece], carriers.sd[piece], carriers.sdd[piece]], axis=1)
        curve = BPoly.from_derivatives(plan.t[piece], given)
        for part, rate in zip(parts, (curve, curve.derivative(), curve.derivative(2)), strict=True):
            part[here] = rate(times[here])
    return CarrierMotion(*parts)


# --- plans in numbers ----------------------------------------------------------------------------------------------


def numbers(plan: Plan) -> dict[str, Any]:
    """Return a plan in numbers: efforts, energies, carriers against their limits.

    ``rms`` is that of the norm of τ; energies are ∫ Σ |power| dt, J, what motors that recover nothing would draw;
    ``position``, ``speed`` and ``acceleration`` are the largest of any carrier, ``track``, ``speed_limit`` and
    ``acceleration_limit`` what they are judged by.
    """
    carriers, limits = plan.carriers, plan.limits.judged_by if plan.carriers.s.shape[1] else ()
    return {
        "status": plan.status.value,
        "peak": peak(plan)[0],
        "before": peak_until_off(plan),
        "reversals": float(reversals(plan).max()),
        "rms": float(np.linalg.norm(plan.rms_effort)),
        "carrier_force": float(np.abs(plan.carrier_force).max(initial=0.0)),
        "main_energy": plan.main_energy,
        "carrier_energy": plan.carrier_energy,
        "energy": plan.main_energy + plan.carrier_energy,
        "position": float(np.abs(carriers.s).max(initial=0.0)),
        "speed": float(np.abs(carriers.sd).max(initial=0.0)),
        "acceleration": float(np.abs(carriers.sdd).max(initial=0.0)),
        "track": max((limit.upper for limit in limits), default=math.nan),
        "speed_limit": max((limit.speed for limit in limits), default=math.nan),
        "acceleration_limit": max((limit.acceleration for limit in limits), default=math.nan),
        "broken": broken_limits(plan),
        "solver": str(plan.diagnostics.get("solver", "")),
    }


def plan_differences(first: Plan, second: Plan) -> dict[str, float]:
    """Return the largest differences of two plans over the largest value, at the samples that both have."""
    a, b = (np.round(plan.t, _SAME_TIME) for plan in (first, second))
    if len(a) == len(b) and (a == b).all():
        one, other = np.arange(len(a)), np.arange(len(b))
    else:
        _, one, other = np.intersect1d(a, b, return_indices=True)
    pairs = {
        "position": (first.carriers.s, second.carriers.s),
        "speed": (first.carriers.sd, second.carriers.sd),
        "acceleration": (first.carriers.sdd, second.carriers.sdd),
        "tau": (np.nan_to_num(first.tau), np.nan_to_num(second.tau)),
        "carrier_force": (first.carrier_force, second.carrier_force),
    }
    return {name: relative_difference(left[one], right[other]) for name, (left, right) in pairs.items()}


def missing_force(error: InfeasiblePlanError) -> float:
    """Return the force that nothing can carry at a singular pose, N, where that is why there is no plan; else NaN."""
    amount = error.details.get("amount") if error.details.get("constraint") == "singular_pose" else None
    return amount if isinstance(amount, float) else math.nan


# --- motions without a planner -------------------------------------------------------------------------------------


def duration(run: MotionRun) -> Numbers:
    """Return the total time, s."""
    return (run.trajectory.duration,)


def deceleration_start(run: MotionRun) -> Numbers:
    """Return the time at which the speed begins to fall for the last time, s."""
    speed = np.linalg.norm(run.motion.xd, axis=1)
    cruising = np.isclose(speed, np.median(speed), rtol=1e-9)
    return (float(run.t[np.flatnonzero(cruising)[-1]]),)


def arc_times(run: MotionRun) -> Numbers:
    """Return the first and last jump of the acceleration, s: where the corner begins and ends."""
    breaks = run.trajectory.breaks
    return (float(breaks[0]), float(breaks[-1]))


def crossing_abscissae(run: MotionRun) -> Numbers:
    """Return x at the singular instants, m."""
    return tuple(instant.x[0] for instant in run.instants)


def peak_efforts(run: MotionRun) -> Numbers:
    """Return the largest |τ| of each actuator, N·m or N."""
    return tuple(float(value) for value in run.peaks)


def threshold_met(run: MotionRun, threshold: float) -> Numbers:
    """Return when the condition number first exceeds a threshold, s.

    The circle passes two singularities, between which the condition number falls to about 17; the thesis treats
    them as one region, so the first entry and the last exit count.
    """
    return _threshold_times(run, threshold)[:1]


def threshold_left(run: MotionRun, threshold: float) -> Numbers:
    """Return when it last exceeds the threshold, s."""
    return _threshold_times(run, threshold)[1:]


def parked_forces(run: MotionRun, threshold: float, ramp: float) -> Numbers:
    """Return |τ| of each actuator one ramp, s, before the condition number meets a threshold, N."""
    start, tau = switch_off_start(run, threshold, ramp)[0], run.distribution.tau
    return tuple(abs(float(np.interp(start, run.t, tau[:, i]))) for i in range(tau.shape[1]))


def switch_off_start(run: MotionRun, threshold: float, ramp: float) -> Numbers:
    """Return the time one ramp, s, before the condition number meets a threshold, s."""
    return (_threshold_times(run, threshold)[0] - ramp,)


def _threshold_times(run: MotionRun, threshold: float) -> tuple[float, float]:
    # the logarithm of the condition number is nearly straight between samples, and finite below the threshold
    condition = np.minimum(run.distribution.condition, 1e6)
    above = windows(run.t, condition > threshold)
    first = int(np.searchsorted(run.t, above[0][0]))
    last = int(np.searchsorted(run.t, above[-1][1], side="right")) - 1

    def level(left: int) -> float:
        a, b = np.log(condition[left : left + 2])
        return float(run.t[left] + (np.log(threshold) - a) / (b - a) * (run.t[left + 1] - run.t[left]))

    return level(first - 1), level(last)
