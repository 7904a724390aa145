"""The motion of the carriers from the first instant to the last: optimised steps, returns to the datum, braking."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import Literal

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, require_few
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_model import EffortModel
from redundancy_pin.planners.carrier_return import CarrierState, no_force, return_polynomial, shortest_return
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.stepwise.step import AccelerationBox, OptimisedSteps, optimise
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

Active = Literal["always", "accelerating"]
"""When the optimiser works: at every step, or only while the platform accelerates."""

Stop = Literal["after", "within"]
"""When the carriers are brought to rest: after the motion, with the platform at rest, or by its last sample."""

PHASES = ("parked", "optimise", "return", "brake")
"""What the carriers do: stand, follow the optimiser, follow the degree-seven polynomial, are braked."""

PARKED, OPTIMISE, RETURN, BRAKE = range(4)


@dataclass(frozen=True, eq=False)
class StepwiseSettings:
    """Checked options of ``plan_stepwise``; see there."""

    limits: ResolvedLimits
    lam: float
    active: Active
    start: Array
    datum: Array
    anticipate: bool
    return_time: float | Literal["shortest"]
    stop: Stop
    brake_time: float
    least_margin: float

    @property
    def parameters(self) -> dict[str, object]:
        """The settings as plain data, for the plan."""
        own = {each.name: getattr(self, each.name) for each in fields(self)[1:]}
        return own | {name: tuple(own[name].tolist()) for name in ("start", "datum")}


@dataclass(eq=False)
class Course:
    """The motion of k carriers, to which one segment after the other is appended.

    Attributes:
        t: (J + 1,) instants, s.
        s, sd, sdd: (J + 1, k) motion there, m, m/s and m/s². Of optimised and braked steps ṡ and s̈ are the backward
            differences of s and ṡ, on a return the derivatives of its polynomial.
        phase: (J + 1,) index into ``PHASES``, of the step that ends at an instant; of the first instant, of the step
            that begins there.
        position: s as functions of time, one after the other.
        optimised: first step and result of each segment of the optimiser.
        returns: start and end of each return, s; its polynomial ends there.
        braking: when the carriers are braked, s; NaN if none moved.
    """

    t: Array
    s: Array
    sd: Array
    sdd: Array
    phase: IntArray
    position: list[PiecewisePolynomial] = field(default_factory=list)
    optimised: list[tuple[int, OptimisedSteps]] = field(default_factory=list)
    returns: list[tuple[float, float]] = field(default_factory=list)
    braking: tuple[float, float] = (math.nan, math.nan)

    def state(self, i: int) -> CarrierState:
        """Return the carriers at an instant."""
        return CarrierState(float(self.t[i]), self.s[i], self.sd[i], self.sdd[i])

    def append_steps(self, first: int, s: Array, sd: Array, sdd: Array, phase: IntArray | int) -> None:
        """Append steps of constant s̈ from instant ``first`` on; (P, k) motion at their ends."""
        steps = slice(first + 1, first + 1 + len(s))
        self.s[steps], self.sd[steps], self.sdd[steps], self.phase[steps] = s, sd, sdd, phase
        own = slice(first, steps.stop)
        if len(s):
            # parabolas: each ends short of the value that backward differences have at the end of the step
            acceleration = np.append(sdd, sdd[-1:], axis=0)
            self.position.append(PiecewisePolynomial.taylor(self.t[own], self.s[own], self.sd[own], acceleration))

    def append_return(self, first: int, last: int, back: PiecewisePolynomial, datum: Array) -> None:
        """Append a return from instant ``first`` on, and standing at the datum (k,) until instant ``last``."""
        inner, end = np.arange(first + 1, last + 1), float(self.t[last])
        self.s[inner] = datum
        inner = inner[self.t[inner] < back.end]
        for order, part in enumerate((self.s, self.sd, self.sdd)):
            part[inner] = back.derivative(order)(self.t[inner])
        self.phase[inner] = RETURN
        self.returns.append((float(self.t[first]), back.end))
        self.position.append(back.between(back.start, min(back.end, end)))
        if back.end < end:
            self.position.append(PiecewisePolynomial.constant(datum, back.end, end))


def plan_course(
    robot: Robot,
    settings: StepwiseSettings,
    box: AccelerationBox,
    missing: EffortModel,
    active: BoolArray,
    at_rest: BoolArray,
) -> Course:
    """Plan the carriers from the first instant until they rest.

    Args:
        robot: the robot.
        settings: options of the planner.
        box: what the carriers must keep to.
        missing: efforts less their target, at the J + 1 instants between which the steps lie.
        active: (J,) whether the optimiser decides a step.
        at_rest: (J,) whether the platform rests at the end of a step.
    """
    t, zero = missing.t, np.zeros((len(missing.t), robot.k))
    course = Course(t, zero + settings.start, zero.copy(), zero.copy(), np.full(len(t), PARKED, dtype=np.intp))
    brake_from = len(active)
    for first, last in pairwise([0, *(np.flatnonzero(np.diff(active)) + 1).tolist(), len(active)]):
        if active[first]:
            steps = optimise(missing, first, last, course.state(first), box)
            course.append_steps(first, steps.s, steps.sd, steps.sdd, OPTIMISE)
            course.optimised.append((first, steps))
        elif first == 0:
            course.position.append(PiecewisePolynomial.constant(settings.start, t[0], t[last]))
        elif last == len(active) and at_rest[first:last].all():
            brake_from = first
        else:
            back = _return(settings, course.state(first), float(t[-1]))
            course.append_return(first, last, back, settings.datum)
    return _braked(settings, course, brake_from, bool(at_rest[-1]))


def _return(settings: StepwiseSettings, state: CarrierState, end: float) -> PiecewisePolynomial:
    """Return the way back to the datum from a state; ``end`` of the motion, s."""
    if settings.return_time != "shortest":
        return return_polynomial(state, settings.return_time, settings.datum)
    remedy = "Use a larger lam, higher limits, or a return_time and accept a plan that violates limits."
    return shortest_return(settings.limits, no_force, state, settings.datum, end - state.t, remedy)


_MOST_ADDED = 1_000_000
"""Largest number of steps added after the motion."""

_AT_REST = 1e-12
"""Speed, m/s, that is the rounding of a carrier brought to rest."""

_LATE = 1e-9
"""Of the duration of braking, that is rounding."""


def _braked(settings: StepwiseSettings, course: Course, first: int, platform_rests: bool) -> Course:
    """Return the course with the carriers braked from instant ``first`` until all are at rest.

    Each is braked by a constant deceleration within ``brake_time``, or less if its track is too short.
    ``platform_rests``: at the end of the motion; the steps added after it are the median of its steps.
    """
    limits, within = settings.limits, settings.stop == "within"
    s, start, last = course.s[first], float(course.t[first]), float(course.t[-1])
    sd = np.where(np.abs(course.sd[first]) > _AT_REST, course.sd[first], 0.0)
    wanted = min(settings.brake_time, last - start) if within else settings.brake_time
    room = np.where(sd > 0.0, limits.track[:, 1] - s, s - limits.track[:, 0])
    duration = _braking_times(sd, np.maximum(room, 0.0), limits.acceleration, wanted)
    longest = float(duration.max())
    if within or not platform_rests:
        _require_time(settings, course, first, duration)
    step, added = float(np.median(np.diff(course.t))), 0
    if not within:
        added = max(0, int(np.ceil((longest - (last - start)) / step - 1e-9)))
    require_few(added, _MOST_ADDED, "Braking adds {} steps", "Shorten brake_time.", name="brake_time")
    course.t = np.append(course.t, last + step * np.arange(1.0, added + 1.0))
    course.s, course.sd, course.sdd = (np.pad(part, ((0, added), (0, 0))) for part in (course.s, course.sd, course.sdd))
    course.phase = np.pad(course.phase, (0, added))
    times = course.t[first:]
    h = np.diff(times)[:, None]
    share = (times[1:, None] - start) / np.where(duration > 0.0, duration, 1.0)
    speeds = sd * np.clip(1.0 - share, 0.0, None)
    before = np.vstack([sd, speeds])[:-1]
    moving = np.abs(before).max(axis=1, initial=0.0) > 0.0
    path = s + np.cumsum(h * speeds, axis=0)
    course.append_steps(first, path, speeds, (speeds - before) / h, np.where(moving, BRAKE, PARKED))
    if longest > 0.0:
        course.braking = (start, start + longest)
    course.phase[0] = course.phase[1]
    return course


def _braking_times(speed: Array, room: Array, deceleration: Array, wanted: float) -> Array:
    """Return (k,) the time, s, each carrier takes to stop: as requested, less if the track ends before.

    Never below |v|/a, even where the ``room`` (k,) to the end of the track, m, is too short for it.
    """
    size = np.abs(speed)
    by_track = 2.0 * room / np.where(size > 0.0, size, 1.0)
    return np.where(size > 0.0, np.maximum(np.minimum(wanted, by_track), size / deceleration), 0.0)


def _require_time(settings: StepwiseSettings, course: Course, first: int, duration: Array) -> None:
    """Check that the carriers come to rest by the end of the motion."""
    j = int(np.argmax(duration))
    late = float(duration[j] - (course.t[-1] - course.t[first]))
    if duration[j] == 0.0 or late <= _LATE * duration[j]:
        return
    carrier = settings.limits.names[j]
    if settings.stop == "after":
        why = "and the platform moves on, so it cannot be held while they stop"
    else:
        why = f"which takes {late:.3g} s longer than the motion"
    raise InfeasiblePlanError(
        f"{carrier} still has {course.sd[first, j]:.6g} m/s at t = {course.t[first]:.6g} s and must be stopped, {why}.",
        remedy='Use a motion that ends at rest, stop="after", or a shorter return_time.',
        constraint="rest",
        joint=carrier,
        time=float(course.t[-1]),
        amount=late,
    )
