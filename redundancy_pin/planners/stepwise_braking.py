"""Bringing the carriers to rest at the end of a stepwise plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_stop import braked_speeds, braking_times
from redundancy_pin.planners.stepwise_course import BRAKE, PARKED, Course
from redundancy_pin.planners.stepwise_settings import StepwiseSettings

AT_REST = 1e-12
"""Speed, m/s, that is the rounding of a carrier brought to rest."""

_ON_TRACK = 1e-9
"""Excess over a track end, as a fraction of the track, that is rounding."""


@dataclass(frozen=True, eq=False)
class Braking:
    """The end of a course.

    Attributes:
        t: (E,) instants added after the motion, s; none where the carriers rest by its end.
        s, sd, sdd: (B, k) motion at the instants after ``Course.brake_from``, the added ones included.
        phase: (B,) index into ``PHASES``.
        start, end: s; NaN where no carrier moved.
    """

    t: Array
    s: Array
    sd: Array
    sdd: Array
    phase: IntArray
    start: float
    end: float


def brake(settings: StepwiseSettings, course: Course, step: float, platform_rests: bool) -> Braking:
    """Brake the carriers from ``course.brake_from`` until all are at rest.

    Each is braked by a constant deceleration within ``brake_time``, sooner where its track is too short for that.

    Args:
        settings: of the planner.
        course: the course up to there.
        step: length of the steps added after the motion, s.
        platform_rests: whether the platform rests at the end of the motion.

    Raises:
        InfeasiblePlanError: a carrier cannot be stopped on its track or by the time it must; names it, the time and
            the amount.
    """
    first = course.brake_from
    s, sd = course.s[first], np.where(np.abs(course.sd[first]) > AT_REST, course.sd[first], 0.0)
    start, last = float(course.t[first]), float(course.t[-1])
    stopping = _stopping_times(settings, s, sd, last - start)
    longest = float(stopping.max())
    _require_time(settings, course, stopping, last - start, platform_rests)
    added = max(0, int(np.ceil((longest - (last - start)) / step - 1e-9))) if settings.stop == "after" else 0
    extra: Array = last + step * np.arange(1, added + 1, dtype=float)
    times = np.concatenate([course.t[first:], extra])
    h = np.diff(times)[:, None]
    speeds = braked_speeds(sd, stopping, times[1:] - start)
    path = s + np.cumsum(h * speeds, axis=0)
    before = np.vstack([sd, speeds])[:-1]
    _require_on_track(settings, times, path, sd)
    moving = np.abs(before).max(axis=1, initial=0.0) > 0.0
    none = longest == 0.0
    return Braking(
        extra,
        path,
        speeds,
        (speeds - before) / h,
        np.where(moving, BRAKE, PARKED).astype(np.intp),
        float("nan") if none else start,
        float("nan") if none else start + longest,
    )


def _stopping_times(settings: StepwiseSettings, s: Array, sd: Array, left: float) -> Array:
    limits = settings.limits.limits
    room = [(b.upper - x) if v > 0.0 else (x - b.lower) for b, x, v in zip(limits, s, sd, strict=True)]
    deceleration = np.array([limit.acceleration for limit in limits])
    wanted = settings.brake_time if settings.stop == "after" else min(settings.brake_time, left)
    return braking_times(sd, np.maximum(room, 0.0), deceleration, wanted)


def _require_time(
    settings: StepwiseSettings, course: Course, stopping: Array, left: float, platform_rests: bool
) -> None:
    j = int(np.argmax(stopping))
    if stopping[j] == 0.0 or (settings.stop == "after" and platform_rests):
        return
    late = float(stopping[j] - left)
    if late <= _ON_TRACK * stopping[j]:
        return
    carrier, end = settings.limits.carriers[j], float(course.t[-1])
    why = (
        "and the platform moves on, so it cannot be held while they stop"
        if settings.stop == "after"
        else f"which takes {late:.3g} s longer than the motion"
    )
    raise InfeasiblePlanError(
        f"{carrier} still has {course.sd[course.brake_from, j]:.6g} m/s at t = {course.t[course.brake_from]:.6g} s and "
        f"must be stopped, {why}.",
        remedy='Use a motion that ends at rest, stop="after", or a shorter return_time.',
        constraint="rest",
        carrier=carrier,
        time=end,
        amount=late,
    )


def _require_on_track(settings: StepwiseSettings, times: Array, path: Array, sd: Array) -> None:
    for j, limit in enumerate(settings.limits.limits):
        beyond = np.maximum(path[:, j] - limit.upper, limit.lower - path[:, j])
        if not len(beyond) or beyond.max() <= _ON_TRACK * (limit.upper - limit.lower):
            continue
        worst = int(np.argmax(beyond))
        carrier = settings.limits.carriers[j]
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
