"""The carriers' whole course and its options: stretches of the optimiser, returns to the datum, braking."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Literal, get_args

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, fraction, one_of, positive, require_few, whole
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.base_wrench import BASE, point_of, weights_of
from redundancy_pin.planners.carrier_return import CarrierState, no_return, return_polynomial, shortest_return
from redundancy_pin.planners.limits import Limits, ResolvedLimits, return_duration
from redundancy_pin.planners.stepwise.optimiser import AccelerationBox, OptimisedSteps, StepProblems, optimise
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

Active = Literal["always", "accelerating"]
"""When the optimiser works: at every step, or only while the platform accelerates."""

Stop = Literal["after", "within"]
"""When the carriers are brought to rest: after the motion, with the platform held, or by its last sample."""


@dataclass(frozen=True, eq=False)
class StepwiseSettings:
    """Checked options of ``plan_stepwise``; see there. Numbers and names a plan has among its parameters."""

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
    between: int
    objective: Mapping[str, float]
    base_point: Array

    @property
    def parameters(self) -> dict[str, object]:
        """The settings as plain data, for the plan."""
        own = {field.name: getattr(self, field.name) for field in fields(self)[1:]}
        own |= {name: tuple(own[name].tolist()) for name in ("start", "datum", "base_point")}
        return {**own, **self.limits.parameters()}

    def box(self, end: float) -> AccelerationBox:
        """Return what the carriers must keep to in a motion that ends at a time, s."""
        limits = self.limits
        return AccelerationBox(
            limits.names, limits.of_carriers, self.anticipate, end if self.stop == "within" else math.inf
        )


def checked_settings(robot: Robot, limits: Limits, **options: Any) -> StepwiseSettings:
    """Return the settings of ``plan_stepwise`` after checking every one; ``options`` are the fields but ``limits``."""
    for name, allowed in (("active", get_args(Active)), ("stop", get_args(Stop)), ("anticipate", (True, False))):
        one_of(options[name], name, allowed)
    for name in ("jerk", "carrier_force", "effort"):
        if getattr(limits, name) is not None:
            raise InputError(
                f"The stepwise planner keeps to no limit of {name}.",
                remedy="Leave it out, or use plan_whole_trajectory.",
                name=name,
            )
    resolved = limits.resolved(robot)
    if options["stop"] == "within" and np.isinf(resolved.acceleration).any():
        raise InputError(
            'stop="within" needs acceleration limits: without them nothing says when to brake.',
            remedy='Declare or pass acceleration limits, or use stop="after".',
        )
    checks: dict[str, Callable[[Any, str], object]] = {
        "lam": fraction,
        "between": partial(whole, least=0, most=1000),
        "objective": lambda objective, name: weights_of(objective, ("effort", *BASE)),
        "base_point": lambda point, name: point_of(point),
        "start": resolved.on_track,
        "datum": resolved.on_track,
        "return_time": return_duration,
        "brake_time": partial(positive, unit="s"),
        "least_margin": partial(positive, unit=""),
    }
    return StepwiseSettings(
        resolved, **{**options, **{name: check(options[name], name) for name, check in checks.items()}}
    )


PHASES = ("parked", "optimise", "return", "brake")
"""What the carriers do: stand, follow the optimiser, follow the degree-seven polynomial, are braked."""

PARKED, OPTIMISE, RETURN, BRAKE = range(4)


@dataclass(frozen=True, eq=False)
class Course:
    """The carriers at J + 1 instants, those that ``brake`` adds after the motion included.

    ``t`` (J + 1,) instants, s; ``s``, ``sd``, ``sdd`` (J + 1, k) their motion; while they are optimised or braked ṡ and
    s̈ are the backward differences of s and ṡ, on a return the derivatives of its polynomial; ``phase`` (J + 1,) index
    into ``PHASES``: what the step that ends there was; ``stretches``: first step and result of each run of the
    optimiser; ``returns``: start and end of each return, s; the end is that of its polynomial; ``parts``: positions as
    a function of time, one after the other; ``brake_from``: instant from which the carriers are only braked; ``brake``
    fills in the motion after it; ``braking``: when they are braked, s; NaN where no carrier moved.
    """

    t: Array
    s: Array
    sd: Array
    sdd: Array
    phase: IntArray
    stretches: tuple[tuple[int, OptimisedSteps], ...]
    returns: tuple[tuple[float, float], ...]
    parts: tuple[PiecewisePolynomial, ...]
    brake_from: int
    braking: tuple[float, float] = (math.nan, math.nan)


def run_course(
    robot: Robot,
    settings: StepwiseSettings,
    box: AccelerationBox,
    problems: StepProblems,
    active: BoolArray,
    at_rest: BoolArray,
) -> Course:
    """Plan the carriers from the first instant to the last, but for the braking.

    ``problems``: the prepared steps, J of them; ``active`` (J,) whether the optimiser decides a step; ``at_rest`` (J,)
    whether the platform rests at the end of a step.
    """
    t = problems.t
    s, sd, sdd = (np.zeros((len(t), robot.k)) for _ in range(3))
    s[0] = settings.start
    phase, brake_from = np.full(len(t), PARKED, dtype=np.intp), len(active)
    stretches: list[tuple[int, OptimisedSteps]] = []
    returns: list[tuple[float, float]] = []
    parts: list[PiecewisePolynomial] = []
    edges = (np.flatnonzero(np.diff(active)) + 1).tolist()
    for first, last in zip([0, *edges], [*edges, len(active)], strict=True):
        here, steps = slice(first, last + 1), slice(first + 1, last + 1)
        state = CarrierState(float(t[first]), s[first], sd[first], sdd[first])
        if active[first]:
            stretch = optimise(problems, first, last, state, box)
            s[steps], sd[steps], sdd[steps], phase[steps] = stretch.s, stretch.sd, stretch.sdd, OPTIMISE
            stretches.append((first, stretch))
            parts.append(PiecewisePolynomial.constant_acceleration(t[here], s[here], sd[here], sdd[here]))
        elif first == 0:
            s[steps] = settings.start
            parts.append(PiecewisePolynomial.constant(settings.start, t[0], t[last]))
        elif last == len(active) and at_rest[first:last].all():
            brake_from = first
        else:
            duration = _return_duration(robot, settings, state, float(t[-1]))
            back = return_polynomial(state, duration, settings.datum)
            s[steps] = settings.datum
            returning = np.arange(first + 1, last + 1)[t[steps] < back.end]
            for order, part in enumerate((s, sd, sdd)):
                part[returning] = back.derivative(order)(t[returning])
            phase[returning] = RETURN
            returns.append((state.t, back.end))
            parts.append(back.until(min(back.end, float(t[last]))))
            if parts[-1].end < t[last]:
                parts.append(PiecewisePolynomial.constant(settings.datum, parts[-1].end, t[last]))
    return Course(t, s, sd, sdd, phase, tuple(stretches), tuple(returns), tuple(parts), brake_from)


_MOST_ADDED = 1_000_000  # steps after the motion


def _return_duration(robot: Robot, settings: StepwiseSettings, state: CarrierState, end: float) -> float:
    if settings.return_time != "shortest":
        return settings.return_time
    limited = replace(robot, carrier_limits=settings.limits.of_carriers)

    def no_force(times: Array, *_: Array) -> Array:
        return np.zeros((len(times), robot.k))

    duration, _, nearest = shortest_return(limited, no_force, state, settings.datum, end - state.t)
    if duration is None:
        remedy = "Use a larger lam, higher limits, or a return_time and accept a plan that violates limits."
        raise no_return(nearest, state.t, end - state.t, remedy)
    return duration


AT_REST = 1e-12
"""Speed, m/s, that is the rounding of a carrier brought to rest."""

_ON_TRACK = 1e-9
"""Excess over a track end, as a fraction of the track, that is rounding."""


def brake(
    settings: StepwiseSettings, box: AccelerationBox, course: Course, step: float, platform_rests: bool
) -> Course:
    """Brake the carriers from ``course.brake_from`` until all are at rest, and return the whole course.

    Each is braked by a constant deceleration within ``brake_time``, sooner where its track is too short for that.
    ``step``: length of the steps added after the motion, s; ``platform_rests``: at the end of the motion.
    """
    kept, first = course.brake_from + 1, course.brake_from
    s, sd = course.s[first], np.where(np.abs(course.sd[first]) > AT_REST, course.sd[first], 0.0)
    start, last = float(course.t[first]), float(course.t[-1])
    stopping = _stopping_times(settings, box, s, sd, last - start)
    longest = float(stopping.max())
    _require_time(settings, box, course, stopping, last - start, platform_rests)
    added = max(0, int(np.ceil((longest - (last - start)) / step - 1e-9))) if settings.stop == "after" else 0
    require_few(added, _MOST_ADDED, "Braking adds {} steps", "Shorten brake_time.", name="brake_time")
    t = np.append(course.t, last + step * np.arange(1, added + 1, dtype=float))
    times = t[first:]
    h = np.diff(times)[:, None]
    speeds = braked_speeds(sd, stopping, times[1:] - start)
    path = s + np.cumsum(h * speeds, axis=0)
    before = np.vstack([sd, speeds])[:-1]
    _require_on_track(box, times, path, sd)
    deceleration = (speeds - before) / h
    moving = np.abs(before).max(axis=1, initial=0.0) > 0.0
    braked = PiecewisePolynomial.constant_acceleration(
        times, np.vstack([s, path]), np.vstack([sd, speeds]), np.vstack([np.zeros_like(sd), deceleration])
    )
    return replace(
        course,
        t=t,
        s=np.vstack([course.s[:kept], path]),
        sd=np.vstack([course.sd[:kept], speeds]),
        sdd=np.vstack([course.sdd[:kept], deceleration]),
        phase=np.append(course.phase[:kept], np.where(moving, BRAKE, PARKED)),
        parts=(*course.parts, *([braked] if len(times) > 1 else [])),
        braking=(start, start + longest) if longest > 0.0 else course.braking,
    )


def braked_speeds(speed: Array, braking_time: Array, elapsed: Array) -> Array:
    """Return (J, k) the speeds of carriers that are braked by constant decelerations.

    ``speed`` (k,) speed at the start, m/s, either sign; ``braking_time`` (k,) time until rest, s; zero for a carrier at
    rest; ``elapsed`` (J,) time since the start at the end of each step, s.
    """
    duration = np.where(braking_time > 0.0, braking_time, 1.0)
    left: Array = speed * np.clip(1.0 - elapsed[:, None] / duration, 0.0, None)
    left[:, braking_time <= 0.0] = 0.0
    return left


def braking_times(speed: Array, room: Array, deceleration: Array, wanted: float) -> Array:
    """Return (k,) the time, s, each carrier takes to stop: as wanted, sooner where the track ends before.

    Never below |v|/a, even where the ``room`` (k,) to the end of the track, m, is too short for it.
    """
    size = np.abs(speed)
    moving = size > 0.0
    by_track = np.where(moving, 2.0 * room / np.where(moving, size, 1.0), np.inf)
    return np.where(moving, np.maximum(np.minimum(wanted, by_track), size / deceleration), 0.0)


def _stopping_times(settings: StepwiseSettings, box: AccelerationBox, s: Array, sd: Array, left: float) -> Array:
    limits = box.limits
    room = [(b.upper - x) if v > 0.0 else (x - b.lower) for b, x, v in zip(limits, s, sd, strict=True)]
    deceleration = np.array([limit.acceleration for limit in limits])
    wanted = settings.brake_time if settings.stop == "after" else min(settings.brake_time, left)
    return braking_times(sd, np.maximum(room, 0.0), deceleration, wanted)


def _require_time(
    settings: StepwiseSettings, box: AccelerationBox, course: Course, stopping: Array, left: float, platform_rests: bool
) -> None:
    j = int(np.argmax(stopping))
    if stopping[j] == 0.0 or (settings.stop == "after" and platform_rests):
        return
    late = float(stopping[j] - left)
    if late <= _ON_TRACK * stopping[j]:
        return
    carrier, end = box.carriers[j], float(course.t[-1])
    why = (
        "and the platform moves on, so it cannot be held while they stop"
        if settings.stop == "after"
        else f"which takes {late:.3g} s longer than the motion"
    )
    message = (
        f"{carrier} still has {course.sd[course.brake_from, j]:.6g} m/s at t = {course.t[course.brake_from]:.6g} s and "
        f"must be stopped, {why}."
    )
    remedy = 'Use a motion that ends at rest, stop="after", or a shorter return_time.'
    raise InfeasiblePlanError(message, remedy=remedy, constraint="rest", carrier=carrier, time=end, amount=late)


def track_size(limit: CarrierLimits) -> float:
    """Return the length of a track, m, that rounding is compared with; a metre of one that does not end."""
    length = limit.upper - limit.lower
    return length if math.isfinite(length) else 1.0


def _require_on_track(box: AccelerationBox, times: Array, path: Array, sd: Array) -> None:
    for j, limit in enumerate(box.limits):
        beyond = np.maximum(path[:, j] - limit.upper, limit.lower - path[:, j])
        if not len(beyond) or beyond.max() <= _ON_TRACK * track_size(limit):
            continue
        worst = int(np.argmax(beyond))
        carrier = box.carriers[j]
        raise InfeasiblePlanError(
            f"{carrier} cannot be stopped: braked by {limit.acceleration:g} m/s² from {sd[j]:.6g} m/s at "
            f"t = {times[0]:.6g} s it is {beyond[worst]:.3g} m beyond the end of its track at "
            f"t = {times[worst + 1]:.6g} s.",
            remedy="Use anticipate=True, a larger lam, or higher limits.",
            constraint="track",
            carrier=carrier,
            time=float(times[worst + 1]),
            amount=float(beyond[worst]),
        )
