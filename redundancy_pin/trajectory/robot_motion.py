"""The motion of a robot's platform as a function of time: its own coordinates, angles unwrapped."""

from __future__ import annotations

import numpy as np

from redundancy_pin.kinematics.coordinates import difference, pose_rows
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import require_matching
from redundancy_pin.trajectory.continuous_motion import Motion, TimedTrajectory, as_motion


def robot_motion(robot: Robot, source: PlatformMotion | TimedTrajectory) -> Motion:
    """Return the motion of a robot's platform as a function of time (``as_motion``).

    Angles of samples may be written within a turn; between them they take the short way. Where a platform cannot move
    along some axes, the rates of its pose along them are zero.

    Args:
        robot: the robot.
        source: a trajectory, or N samples of the robot's coordinates, m and rad, or poses, base frame.

    Raises:
        InputError: the motion does not have the robot's coordinates, or has a single instant only.

    Example:
        >>> robot_motion(rp.load_robot("2rpr"), reference.circle()).end
    """
    if not isinstance(source, PlatformMotion):
        law = as_motion(source)
        require_matching(robot, law.sample_at(np.array([law.start])))
        return law
    require_matching(robot, source)
    if source.is_pose:
        rates = np.zeros((2, len(source), 6))
        rates[:, :, pose_rows(robot)] = source.xd, source.xdd
        return as_motion(PlatformMotion(source.t, source.x, *rates, check_rates=source.check_rates))
    steps = np.diff(source.x, axis=0)
    turns = np.cumsum(np.round((difference(robot, source.x[1:], source.x[:-1]) - steps) / (2.0 * np.pi)), axis=0)
    x = source.x + 2.0 * np.pi * np.concatenate([np.zeros((1, robot.n)), turns])
    return as_motion(PlatformMotion(source.t, x, source.xd, source.xdd, check_rates=source.check_rates))
