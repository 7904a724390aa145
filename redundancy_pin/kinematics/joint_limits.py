"""Which joints of the tree leave the limits that the URDF gives them, passive ones too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.coordinates import turning_velocities
from redundancy_pin.robot import Robot

_ROUNDING = 1e-9
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


def beyond_limits(robot: Robot, q: Array, t: Array) -> tuple[JointExcess, ...]:
    """Return the joints that are somewhere beyond a limit of position.

    Carriers have tracks, which are checked elsewhere. A revolute joint whose limits are within a turn may be counted
    from another turn than they are: the same whole number of turns is taken from all samples where that helps.

    Args:
        robot: the robot.
        q: (N, nq) configurations, NaN where there is none.
        t: (N,) their times, s.
    """
    model, found = robot.model, []
    turning = turning_velocities(robot)
    known = np.isfinite(q).all(axis=1)
    if not known.any():
        return ()
    q, t = q[known], t[known]
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if name in robot.carriers or joint.nq != 1:
            continue
        lower, upper = (float(limit[joint.idx_q]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
        if not lower < upper:  # a URDF says so where it knows no limits
            continue
        turns, value = bool(turning[joint.idx_v]), q[:, joint.idx_q]
        if turns and upper - lower <= _A_TURN:
            middle = 0.5 * (value.max() + value.min() - lower - upper)
            value = value - 2.0 * np.pi * np.round(middle / (2.0 * np.pi))
        for limit, excess in ((lower, lower - value), (upper, value - upper)):
            if excess.max() > _ROUNDING:
                first, worst = int(np.argmax(excess > _ROUNDING)), int(np.argmax(excess))
                unit = "rad" if turns else "m"
                found.append(JointExcess(str(name), float(t[first]), float(t[worst]), float(value[worst]), limit, unit))
    return tuple(found)
