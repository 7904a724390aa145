"""Singularities along a trajectory: the exact times at which a motion crosses, touches or stays on one.

Type II is a zero of the signed margin (smallest singular value of the scaled W with the sign of det W), found on exact
configurations: crossed, touched, or two within one step. Type I is a minimum of the serial margin that reaches zero: a
motion in one working mode can touch it, not cross it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import RANK_TOLERANCE, Array, Frozen, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import difference, mode_indicator, row_scale
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import RobotLike, as_robot
from redundancy_pin.singularities.classify import SingularityKind, classify
from redundancy_pin.singularities.followed_path import FollowedPath, follow_law, motion_of
from redundancy_pin.singularities.roots import Zero, zeros
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory

SPACING = 0.01
"""Distance of samples along the path, in characteristic lengths. On every shipped robot the margin is far from
oscillating within such a step; two dips within one would be needed to hide a crossing."""

SERIAL_TOUCH = 1e-6
"""Serial margin below which a motion counts as touching type I. The margin goes with the square root of the distance
to the border of the workspace: this is 1e-12 m on a one-metre machine, and Newton reaches a margin of 1e-8."""

TANGENT_SLOPE = 1e-4
"""Change of the signed margin per characteristic length of path below which the path counts as tangent to the locus;
crossing at a right angle gives a slope of order one."""

_PROBE = 1e-2
"""Half of the step of the slope, and the distance within which two zeros are one: this fraction of a step."""


@dataclass(frozen=True, eq=False)
class Crossing(Frozen):
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
    robot: RobotLike,
    motion: PlatformMotion | TimedTrajectory,
    *,
    spacing: float = SPACING,
    tolerance: float = RANK_TOLERANCE,
) -> tuple[Crossing, ...]:
    """Return every singularity along a motion, in order of time.

    Args:
        robot: the robot, or its name or path; the motion is followed in its working mode.
        motion: a trajectory (evaluated exactly at every time asked for), or N samples (interpolated by quintics
            through x, ẋ, ẍ; see ``continuous_motion``).
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
    robot = as_robot(robot)
    path = follow_law(constraint_system(robot), motion_of(robot, motion), spacing)

    def parallel(times: Array) -> Array:
        margins = path.margins(times)
        # at type I the entries of W are infinite and its sign means nothing
        return np.where(margins.serial > SERIAL_TOUCH, margins.parallel, np.nan)

    type_ii = zeros(parallel, path.t, tolerance)
    type_i = zeros(lambda times: path.margins(times).serial, path.t, SERIAL_TOUCH)
    slack = _PROBE * float(np.diff(path.t).max())
    alone = [one for one in type_ii if not any(_overlap(one, other, slack) for other in type_i)]
    met = [_described(path, zero, SingularityKind.TYPE_I) for zero in type_i]
    met += [_described(path, zero, SingularityKind.TYPE_II) for zero in alone]
    return tuple(sorted(met, key=lambda crossing: crossing.t))


def _overlap(one: Zero, other: Zero, slack: float) -> bool:
    """Whether two zeros are one (a combined singularity shows in both margins)."""
    return one.t <= other.until + slack and other.t <= one.until + slack


def _described(path: FollowedPath, zero: Zero, expected: SingularityKind) -> Crossing:
    system, robot = path.system, path.system.robot
    time = np.array([zero.t])
    q = path.configurations(time)
    tolerance = SERIAL_TOUCH if expected == SingularityKind.TYPE_I else RANK_TOLERANCE
    classified = classify(robot, q, tolerance=tolerance)
    type_i = expected == SingularityKind.TYPE_I
    kind = SingularityKind.COMBINED if type_i and classified.type_ii[0] else expected
    nothing = np.full(robot.n, np.nan)
    leg = None
    if type_i and robot.working_modes is not None:
        leg = int(np.abs(mode_indicator(robot, q)[0]).argmin()) + 1
    if kind == SingularityKind.COMBINED:
        uncontrolled = classified.uncontrolled_twist[0]
    else:
        uncontrolled = nothing if type_i else classified.least_controlled[0]
    return Crossing(
        t=zero.t,
        until=zero.until,
        x=frozen(path.law.sample_at(time).x[0]),
        q=frozen(q[0]),
        kind=kind,
        crosses=zero.crosses,
        slope=0.0 if type_i else _slope(system, path, zero.t),
        leg=leg,
        uncontrolled_twist=frozen(uncontrolled),
        lost_direction=frozen(classified.least_producible[0] if type_i else nothing),
    )


def _slope(system: ConstraintSystem, path: FollowedPath, t: float) -> float:
    """Return the central difference of the signed margin along the path, per characteristic length."""
    robot = system.robot
    half = _PROBE * float(np.diff(path.t).max())
    times = np.array([max(path.law.start, t - half), min(path.law.end, t + half)])
    x = path.law.sample_at(times).x
    length = float(np.linalg.norm(difference(robot, x[1:], x[:-1])[0] * row_scale(robot)))
    if length == 0.0:
        return 0.0
    margins = path.margins(times).parallel
    return float(margins[1] - margins[0]) / length * robot.characteristic_length
