"""Which joints of the tree leave the limits that the URDF gives them, passive ones too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.coordinates import turning_velocities
from redundancy_pin.robot import Robot

ROUNDING = 1e-9
"""rad or m beyond a limit that count as being at it."""


_A_TURN = 2.0 * np.pi + 0.01
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


class _Ranged(NamedTuple):
    """A joint with limits, and its positions (N,), counted in turns that suit the limits where some do."""

    column: int
    name: str
    unit: str
    value: Array
    lower: float
    upper: float


def _ranged(robot: Robot, q: Array, motion: bool) -> Iterator[_Ranged]:
    model, turning = robot.model, turning_velocities(robot)
    for column, (name, joint) in enumerate(zip(list(model.names)[1:], list(model.joints)[1:], strict=True)):
        lower, upper = (float(limits[joint.idx_q]) for limits in (model.lowerPositionLimit, model.upperPositionLimit))
        if joint.nq != 1 or not lower < upper:  # a URDF says so where it knows no limits
            continue
        turns, value = bool(turning[joint.idx_v]), q[:, joint.idx_q]
        if turns and upper - lower <= _A_TURN:
            middle = 0.5 * ((value.max() + value.min() if motion else 2.0 * value) - lower - upper)
            value = value - 2.0 * np.pi * np.round(middle / (2.0 * np.pi))
        yield _Ranged(column, str(name), "rad" if turns else "m", value, lower, upper)


def range_excess(robot: Robot, q: Array, *, motion: bool = True) -> Array:
    """Return (N, joints) how far each joint of the model is beyond its limits of position, m or rad; negative inside.

    A joint without limits, or of several freedoms, is −inf, and so is a configuration of NaN. A revolute joint whose
    limits are within a turn may be counted from another turn than they are: the same whole number of turns is taken
    from all samples of a ``motion`` where that helps, from each by itself where configurations (N, nq) are none.
    """
    excess = np.full((len(q), robot.model.njoints - 1), -np.inf)
    known = np.isfinite(q).all(axis=1)
    for joint in _ranged(robot, q[known], motion) if known.any() else ():
        excess[known, joint.column] = np.maximum(joint.lower - joint.value, joint.value - joint.upper)
    return excess


def beyond_limits(robot: Robot, q: Array, t: Array) -> tuple[JointExcess, ...]:
    """Return the joints that are somewhere beyond a limit of position, turns counted as in ``range_excess``.

    Carriers have tracks, which are checked elsewhere.

    Args:
        robot: the robot.
        q: (N, nq) configurations, NaN where there is none.
        t: (N,) their times, s.
    """
    found = []
    known = np.isfinite(q).all(axis=1)
    if not known.any():
        return ()
    t = t[known]
    for joint in _ranged(robot, q[known], True):
        for limit, excess in ((joint.lower, joint.lower - joint.value), (joint.upper, joint.value - joint.upper)):
            if excess.max() > ROUNDING and joint.name not in robot.carriers:
                first, worst = int(np.argmax(excess > ROUNDING)), int(np.argmax(excess))
                when = float(t[first]), float(t[worst]), float(joint.value[worst])
                found.append(JointExcess(joint.name, *when, limit, joint.unit))
    return tuple(found)
