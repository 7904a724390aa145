"""Ranges of joints, and where a motion leaves them.

All comparisons of positions with limits allow the same slack, ``JointRange.slack``, in the unit of the joint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import FILE_TOLERANCE, Array, BoolArray, frozen, read_only
from redundancy_pin.robot.types import Robot, slides

ROUNDING = 1e-9
"""Distance beyond a limit that counts as being at it: rad, and of a slide as part of the characteristic length.

Newton's method closes loops to 1e-11 of that length."""


_TURN = 2.0 * np.pi

_WITHIN_A_TURN = _TURN + 0.01
"""rad; limits farther apart count turns."""


@dataclass(frozen=True)
class JointExcess:
    """A joint beyond a limit.

    Attributes:
        joint: its name.
        t: first time beyond, s.
        worst: time at which it is farthest beyond, s.
        value: its position there, rad or m.
        limit: the limit that it leaves, rad or m.
        unit: "rad" or "m".
    """

    joint: str
    t: float
    worst: float
    value: float
    limit: float
    unit: str

    def __str__(self) -> str:
        """Return it in words."""
        end = "upper" if self.value > self.limit else "lower"
        farthest = f", and is at {self.value:.6g} {self.unit} at t = {self.worst:.6g} s"
        return (
            f"joint {self.joint!r} leaves its {end} limit {self.limit:.6g} {self.unit} at t = {self.t:.6g} s{farthest}"
        )


class JointRange(NamedTuple):
    """The range of a joint of one freedom: place among the joints and in q, whether it turns, ends and slack.

    Positions a whole turn apart count as one (``repeats``) of a joint that turns within a range of a turn, unless it is
    a carrier.
    """

    column: int
    name: str
    at: int
    turns: bool
    repeats: bool
    lower: float
    upper: float
    slack: float

    def holds(self, value: float) -> bool:
        """Return whether a position is within the ends and their slack."""
        if self.repeats:
            middle = 0.5 * (self.lower + self.upper)
            value = middle + math.remainder(value - middle, _TURN)
        return self.lower - self.slack <= value <= self.upper + self.slack

    def excess(self, value: Array, motion: bool) -> Array:
        """Return (N,) how far positions are beyond, rad or m; see ``range_excess``."""
        counted = self.counted(value, motion)
        return np.maximum(self.lower - counted, counted - self.upper)

    def counted(self, value: Array, motion: bool) -> Array:
        """Return (N,) positions, whole turns taken off where that brings them into a range within a turn."""
        if not self.repeats or not len(value):
            return value
        middle = 0.5 * ((value.max() + value.min() if motion else 2.0 * value) - self.lower - self.upper)
        return np.asarray(value - _TURN * np.round(middle / _TURN))


@lru_cache(maxsize=64)
def all_ranges(robot: Robot) -> tuple[JointRange, ...]:
    """Return the ranges of all joints that have one, actuated or passive, and the tracks of the carriers.

    A URDF gives equal ends for unknown limits; joints of several freedoms have no range here.
    """
    model, ranges, tracks = robot.model, [], dict(zip(robot.carriers, robot.carrier_limits, strict=True))
    for column, (name, joint) in enumerate(zip(list(model.names)[1:], list(model.joints)[1:], strict=True)):
        if joint.nq != 1:
            continue
        lower, upper = (float(ends[joint.idx_q]) for ends in (model.lowerPositionLimit, model.upperPositionLimit))
        if name in tracks:
            lower, upper = tracks[name].lower, tracks[name].upper
        if lower < upper:
            turns = not slides(joint)
            repeats = turns and upper - lower <= _WITHIN_A_TURN and name not in tracks
            slack = ROUNDING * (1.0 if turns else robot.characteristic_length)
            ranges.append(JointRange(column, str(name), int(joint.idx_q), turns, repeats, lower, upper, slack))
    return tuple(ranges)


@lru_cache(maxsize=64)
def joint_ranges(robot: Robot) -> tuple[JointRange, ...]:
    """Return the ranges of all joints that have one, except carriers, whose tracks are compared with their motion."""
    return tuple(joint for joint in all_ranges(robot) if joint.name not in robot.carriers)


_SMALL_PART = 0.01
"""Part of a range that may be the rounding of its ends: a stroke of two digits."""


def meet_limits(robot: Robot) -> Robot:
    """Return the robot with limits moved to its reference where that is beyond them by the rounding of a file.

    A note names the joints, and by how much: up to ``FILE_TOLERANCE``, rad or characteristic lengths, and up to a
    hundredth of the range.
    """
    q, moved, model = np.array(robot.q_reference), list[str](), pin.Model(robot.model)
    ends = {"lower": model.lowerPositionLimit, "upper": model.upperPositionLimit}
    for joint in joint_ranges(robot):
        value = q[joint.at : joint.at + 1]
        excess, at = float(joint.excess(value, False)[0]), float(joint.counted(value, False)[0])
        rounding = min(joint.slack * FILE_TOLERANCE / ROUNDING, _SMALL_PART * (joint.upper - joint.lower))
        if joint.slack < excess <= rounding:
            end = "lower" if at < joint.lower else "upper"
            ends[end][joint.at] = at
            moved.append(f"{end} of {joint.name!r} by {excess:.1g} {'rad' if joint.turns else 'm'}")
    if not moved:
        return robot
    model.lowerPositionLimit, model.upperPositionLimit = ends["lower"], ends["upper"]
    note = f"Limits that the reference misses by rounding are moved to it: {', '.join(moved)}."
    return replace(robot, model=model, notes=(*robot.notes, note))


@lru_cache(maxsize=64)
def range_table(robot: Robot) -> Array:
    """Return (r, 5) of each range and track: index in q, whether turns count as none (0 or 1), ends and slack."""
    rows = [(one.at, one.repeats, one.lower, one.upper, one.slack) for one in all_ranges(robot)]
    return read_only(np.array(rows, dtype=np.float64).reshape(-1, 5))


def is_in_range(robot: Robot, q: Array) -> bool:
    """Return whether all joints of one configuration (nq,) are in their ranges, carriers on their tracks."""
    positions = q.tolist()
    return all(joint.holds(positions[joint.at]) for joint in all_ranges(robot))


@lru_cache(maxsize=64)
def track_slack(robot: Robot) -> Array:
    """Return (k,) the slack of each carrier's track, m or rad."""
    slack = {joint.name: joint.slack for joint in all_ranges(robot)}
    return frozen([slack[name] for name in robot.carriers])


@lru_cache(maxsize=64)
def range_slack(robot: Robot) -> Array:
    """Return (joints,) the slack of each joint of the model, m or rad; zero of joints without a range."""
    slack = np.zeros(robot.model.njoints - 1)
    for joint in joint_ranges(robot):
        slack[joint.column] = joint.slack
    return read_only(slack)


def range_excess(robot: Robot, q: Array, *, motion: bool = True) -> Array:
    """Return (N, joints) how far each joint of the model is beyond its range, m or rad; negative inside.

    A joint without limits, or of several freedoms, is −inf, and so is a configuration of NaN. A revolute joint whose
    limits are within a turn may be counted from another turn than they are: the same whole number of turns is taken
    from all samples of a ``motion`` where that helps, from each by itself where configurations (N, nq) are none.
    """
    excess = np.full((len(q), robot.model.njoints - 1), -np.inf)
    known = np.isfinite(q).all(axis=1)
    for joint in joint_ranges(robot):
        excess[known, joint.column] = joint.excess(q[known, joint.at], motion)
    return excess


def out_of_range(robot: Robot, q: Array, *, motion: bool = True) -> BoolArray:
    """Return (N,) whether some joint is beyond its range by more than its slack, as ``range_excess`` counts."""
    if motion and len(q):
        ends = np.array([q.min(axis=0), q.max(axis=0)])  # a motion is within its ranges where its extremes are
        if np.isfinite(ends).all() and not (range_excess(robot, ends) > range_slack(robot)).any():
            return read_only(np.zeros(len(q), dtype=bool))
    beyond = range_excess(robot, q, motion=motion) > range_slack(robot)
    return read_only(np.asarray(beyond.any(axis=1)))


def beyond_limits(robot: Robot, q: Array, t: Array) -> tuple[JointExcess, ...]:
    """Return the joints that are somewhere beyond a limit of position, turns counted as in ``range_excess``.

    Args:
        robot: the robot.
        q: (N, nq) configurations, NaN for unknown ones.
        t: (N,) their times, s.
    """
    excesses = []
    known = np.isfinite(q).all(axis=1)
    if not known.any():
        return ()
    t = t[known]
    for joint in joint_ranges(robot):
        value = joint.counted(q[known, joint.at], True)
        for limit, excess in ((joint.lower, joint.lower - value), (joint.upper, value - joint.upper)):
            if excess.max() > joint.slack:
                first, worst = int(np.argmax(excess > joint.slack)), int(np.argmax(excess))
                when = float(t[first]), float(t[worst]), float(value[worst])
                excesses.append(JointExcess(joint.name, *when, limit, "rad" if joint.turns else "m"))
    return tuple(excesses)
