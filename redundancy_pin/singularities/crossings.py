"""Singularities along a trajectory: the exact times at which a motion crosses, touches or stays on one.

Type II is found where the signed margin (smallest singular value of the scaled W with the sign of det W) changes sign,
by Brent's method on exact configurations. Between two samples of equal sign a dip that the slopes at both ends announce
is searched for its minimum, so that a pair of crossings within one step is not missed, nor one that only touches.
Type I is a minimum of the serial margin that reaches zero: a motion in one working mode can touch it, not cross it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from redundancy_pin.arrays import RANK_TOLERANCE, Array, BoolArray, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import difference, row_scale
from redundancy_pin.kinematics.modes import mode_indicator
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.classify import SingularityKind, classify
from redundancy_pin.singularities.followed_path import FollowedPath, TimedMotion, follow_law, position_law

SPACING = 0.01
"""Distance of samples along the path, in characteristic lengths. On every shipped robot the margin is far from
oscillating within such a step; two dips within one would be needed to hide a crossing."""

SERIAL_TOUCH = 1e-6
"""Serial margin below which a motion counts as touching type I. The margin goes with the square root of the distance
to the border of the workspace: this is 1e-12 m on a one-metre machine, and Newton reaches a margin of 1e-8."""

TANGENT_SLOPE = 1e-4
"""Change of the signed margin per characteristic length of path below which the path counts as tangent to the locus;
crossing at a right angle gives a slope of order one."""

_TIME_TOLERANCE = 1e-13
"""Relative to the duration; Brent's method stops there."""

_PROBE = 1e-2
"""Where slopes are taken: this fraction of a step away from its ends."""

_SHALLOW = 0.5
"""A dip whose tangents meet above this fraction of its ends cannot reach zero (a convex dip lies above their meeting
point) and is not searched."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """One singularity met along a motion.

    Attributes:
        t: time, s. Exact to about 1e-13 of the duration where the motion crosses; to about 1e-8 where it touches (at a
            minimum a time is only known to the square root of rounding).
        until: equal to ``t``, or the time, s, until which the motion stays on the singularity.
        x: (n,) or (4, 4) platform coordinates, base frame, m and rad.
        q: (nq,) configuration of the tree, carriers at zero.
        kind: type I, type II or combined.
        crosses: whether det W changes sign; if not, the motion touches the singularity or ends on it.
        slope: change of the signed margin along the path per characteristic length; zero for a touching type I.
        leg: at type I, the number (from 1) of the leg that changes its working mode there; None where no
            working modes are declared, and at type II.
        uncontrolled_twist: (n,) m/s and rad/s, base frame, see ``Singularities``; NaN at type I.
        lost_direction: (n,) m/s and rad/s, base frame; NaN at type II.
    """

    t: float
    until: float
    x: Array
    q: Array
    kind: SingularityKind
    crosses: bool
    slope: float
    leg: int | None
    uncontrolled_twist: Array
    lost_direction: Array

    @property
    def tangential(self) -> bool:
        """Whether the path is tangent to the singularity: it touches, or crosses with (nearly) zero slope."""
        return abs(self.slope) < TANGENT_SLOPE


def find_crossings(
    robot: Robot,
    motion: PlatformMotion | TimedMotion,
    *,
    spacing: float = SPACING,
    tolerance: float = RANK_TOLERANCE,
) -> tuple[Crossing, ...]:
    """Return every singularity along a motion, in order of time.

    Args:
        robot: the robot; the motion is followed in its working mode.
        motion: a trajectory (evaluated exactly at every time asked for), or N samples (interpolated by quintics
            through x, ẋ, ẍ; see ``position_law``).
        spacing: longest step of the search along the path, in characteristic lengths.
        tolerance: scaled margin of W below which a minimum counts as touching type II.

    Raises:
        InputError: coordinates of another robot, a single instant, a spacing or tolerance that is not positive.
        UnreachablePoseError: the motion leaves the workspace; carries the time.
        WorkingModeError: the motion cannot be followed in the working mode; carries the time.
    """
    for name, value in (("spacing", spacing), ("tolerance", tolerance)):
        if not 0.0 < value < 1.0:
            raise InputError(f"{name} is {value}.", remedy="Pass a number between 0 and 1.", name=name)
    path = follow_law(ConstraintSystem(robot), position_law(robot, motion), spacing)
    probes = _Probes.of(path)
    type_ii = _search(path, probes, _parallel(path), probes.parallel, tolerance)
    type_i = _search(path, probes, _serial(path), probes.serial, SERIAL_TOUCH)
    met = [_described(path, event, SingularityKind.TYPE_I) for event in type_i]
    alone = [event for event in type_ii if not any(_overlap(event, other, path) for other in type_i)]
    met += [_described(path, event, SingularityKind.TYPE_II) for event in alone]
    return tuple(sorted(met, key=lambda crossing: crossing.t))


@dataclass(frozen=True)
class _Event:
    t: float
    until: float
    crosses: bool


@dataclass(frozen=True, eq=False)
class _Probes:
    """Margins at three times of each step: its start, and just inside both ends; plus the last sample.

    Attributes:
        t: (3 S + 1,) times of S steps.
        parallel, serial: (3 S + 1,) margins there.
    """

    t: Array
    parallel: Array
    serial: Array

    @staticmethod
    def of(path: FollowedPath) -> _Probes:
        inward = _PROBE * np.diff(path.t)
        t = np.append(np.stack([path.t[:-1], path.t[:-1] + inward, path.t[1:] - inward], axis=1), path.t[-1])
        margins = path.margins(t)
        # at type I the entries of W are infinite and its sign means nothing
        parallel = np.where(margins.serial > SERIAL_TOUCH, margins.parallel, np.nan)
        return _Probes(t, parallel, margins.serial)


def _parallel(path: FollowedPath) -> Callable[[float], float]:
    return lambda t: float(path.margins(np.array([t])).parallel[0])


def _serial(path: FollowedPath) -> Callable[[float], float]:
    return lambda t: float(path.margins(np.array([t])).serial[0])


def _search(
    path: FollowedPath, probes: _Probes, margin: Callable[[float], float], values: Array, tolerance: float
) -> list[_Event]:
    """Find zeros of a margin: sign changes, dips between samples, and samples that are zero already."""
    t, sampled = path.t, values[::3]
    zero = np.abs(sampled) <= tolerance
    events = [_run_of_zeros(path, margin, sampled, first, last, tolerance) for first, last in _runs(zero)]
    plain = ~(zero[:-1] | zero[1:]) & np.isfinite(sampled[:-1]) & np.isfinite(sampled[1:])
    changes = plain & (sampled[:-1] * sampled[1:] < 0.0)
    for k in np.flatnonzero(changes):
        root = _root(path, margin, t[k], t[k + 1])
        events.append(_Event(root, root, True))
    for k in np.flatnonzero(plain & ~changes & _dips(probes.t, np.abs(values))):
        events += _inside_dip(path, margin, t[k], t[k + 1], float(np.sign(sampled[k])), tolerance)
    return events


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return first and last index of each run of true values."""
    edges = np.diff(np.concatenate([[0], np.asarray(flags, dtype=np.intp), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))


def _run_of_zeros(
    path: FollowedPath, margin: Callable[[float], float], sampled: Array, first: int, last: int, tolerance: float
) -> _Event:
    """Turn consecutive zero samples into one event: a crossing that hit a sample, a touch, or a stay."""
    t = path.t
    before = sampled[first - 1] if first > 0 else np.nan
    after = sampled[last + 1] if last + 1 < len(t) else np.nan
    crosses = bool(before * after < 0.0)
    if last - first < 2:
        if crosses:
            root = _root(path, margin, t[first - 1], t[last + 1])
            return _Event(root, root, True)
        best = first + int(np.argmin(np.abs(sampled[first : last + 1])))
        return _Event(float(t[best]), float(t[best]), False)

    def excess(time: float) -> float:
        return abs(margin(time)) - tolerance

    entered = brentq(excess, t[first - 1], t[first]) if first > 0 and excess(t[first]) < 0.0 else t[first]
    left = brentq(excess, t[last], t[last + 1]) if last + 1 < len(t) and excess(t[last]) < 0.0 else t[last]
    return _Event(float(entered), float(left), crosses)


def _dips(t: Array, size: Array) -> BoolArray:
    """Return (S,) whether a margin falls at the start and rises at the end of a step, steeply enough to reach zero."""
    start, after, before, end = size[:-1:3], size[1::3], size[2::3], size[3::3]
    falling = (after - start) / (t[1::3] - t[:-1:3])
    rising = (end - before) / (t[3::3] - t[2::3])
    with np.errstate(invalid="ignore", divide="ignore"):
        meet = (end - start + falling * t[:-1:3] - rising * t[3::3]) / (falling - rising)
        lowest = start + falling * (meet - t[:-1:3])
        result: BoolArray = (falling < 0.0) & (rising > 0.0) & (lowest < _SHALLOW * np.minimum(start, end))
    return result


def _inside_dip(
    path: FollowedPath, margin: Callable[[float], float], left: float, right: float, sign: float, tolerance: float
) -> list[_Event]:
    found = minimize_scalar(
        lambda t: sign * margin(t),
        bounds=(left, right),
        method="bounded",
        options={"xatol": _TIME_TOLERANCE * (path.law.end - path.law.start)},
    )
    lowest, t = float(found.fun), float(found.x)
    if lowest > tolerance:
        return []
    if lowest >= -tolerance:
        return [_Event(t, t, False)]
    return [_Event(root, root, True) for root in (_root(path, margin, left, t), _root(path, margin, t, right))]


def _root(path: FollowedPath, margin: Callable[[float], float], left: float, right: float) -> float:
    return float(brentq(margin, left, right, xtol=_TIME_TOLERANCE * (path.law.end - path.law.start), rtol=1e-15))


def _overlap(event: _Event, other: _Event, path: FollowedPath) -> bool:
    """Whether two events are one (a combined singularity shows in both margins)."""
    slack = float(np.diff(path.t).max()) * _PROBE
    return event.t <= other.until + slack and other.t <= event.until + slack


def _described(path: FollowedPath, event: _Event, expected: SingularityKind) -> Crossing:
    system, robot = path.system, path.system.robot
    time = np.array([event.t])
    q = path.configurations(time)
    tolerance = SERIAL_TOUCH if expected == SingularityKind.TYPE_I else RANK_TOLERANCE
    found = classify(robot, q, tolerance=tolerance)
    type_i = expected == SingularityKind.TYPE_I
    kind = SingularityKind.COMBINED if type_i and found.type_ii[0] else expected
    nothing = np.full(robot.n, np.nan)
    leg = None
    if type_i and robot.working_modes is not None:
        leg = int(np.abs(mode_indicator(robot, q)[0]).argmin()) + 1
    if kind == SingularityKind.COMBINED:
        uncontrolled = found.uncontrolled_twist[0]
    else:
        uncontrolled = nothing if type_i else found.least_controlled[0]
    return Crossing(
        t=event.t,
        until=event.until,
        x=frozen(path.law.at(time)[0]),
        q=frozen(q[0]),
        kind=kind,
        crosses=event.crosses,
        slope=0.0 if type_i else _slope(system, path, event.t),
        leg=leg,
        uncontrolled_twist=frozen(uncontrolled),
        lost_direction=frozen(found.least_producible[0] if type_i else nothing),
    )


def _slope(system: ConstraintSystem, path: FollowedPath, t: float) -> float:
    """Return the central difference of the signed margin along the path, per characteristic length."""
    robot = system.robot
    half = _PROBE * float(np.diff(path.t).max())
    times = np.array([max(path.law.start, t - half), min(path.law.end, t + half)])
    x = path.law.at(times)
    length = float(np.linalg.norm(difference(robot, x[1:], x[:-1])[0] * row_scale(robot)))
    if length == 0.0:
        return 0.0
    margins = path.margins(times).parallel
    return float(margins[1] - margins[0]) / length * robot.characteristic_length
