"""Checks of a robot by those who use it: poses or numbers as coordinates, enough motors, a motion that fits."""

from __future__ import annotations

from functools import lru_cache

from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion, require_sampled
from redundancy_pin.robot.types import Robot


@lru_cache(maxsize=64)
def is_pose(robot: Robot) -> bool:
    """Return whether the independent coordinates are a homogeneous pose."""
    return robot.platform is not None and robot.platform.is_pose


def too_few_motors(robot: Robot) -> str:
    """Return a warning for a robot with fewer main actuators than degrees of freedom; empty for others."""
    if robot.m >= robot.n:
        return ""
    taken = {*robot.actuated, *robot.carriers, *(coupling.joint for coupling in robot.couplings)}
    model = robot.model
    numbers = sorted(range(1, model.njoints), key=lambda index: len(model.supports[index]))  # those on the base first
    passive = [str(model.names[k]) for k in numbers if model.joints[k].nv == 1 and str(model.names[k]) not in taken]
    candidates = f" Passive joints that could be: {', '.join(passive)}." if passive else ""
    return (
        f"{robot.name} has {robot.n} degrees of freedom and {robot.m} actuated joint{'s' * (robot.m != 1)} "
        f"({', '.join(robot.actuated)}): efforts cannot balance a general motion. Declare more joints as `actuated`."
        f"{candidates}"
    )


def require_matching(robot: Robot, motion: PlatformMotion) -> None:
    """Check that a motion has this robot's coordinates.

    Raises:
        InputError: not sampled, wrong number of coordinates, or poses where coordinates belong.
    """
    require_sampled(motion)
    wants_pose = is_pose(robot)
    names = robot.platform.axes if robot.platform else robot.independent_joints
    if motion.is_pose != wants_pose or motion.xd.shape[1] != robot.n:
        given = "poses" if motion.is_pose else f"{motion.xd.shape[1]} coordinates"
        moves = "through poses" if wants_pose else f"in {robot.n} ({', '.join(names)})"
        columns = "x0 to x6 (position, unit quaternion)" if wants_pose else f"x0 to x{robot.n - 1}"
        form = "(N, 4, 4) poses" if wants_pose else f"(N, {robot.n})"
        remedy = (
            f"Choose another motion: in Python x as {form} and xd, xdd as (N, {robot.n}), in a file the "
            f"columns {columns}, xd0 to xd{robot.n - 1} and xdd0 to xdd{robot.n - 1}."
        )
        if tuple(names) == ("x", "y", "rz") and motion.xd.shape[1] == 2:
            remedy = f"Add alpha=0 to the trajectory: the constant angle of the platform, rad. {remedy}"
        raise InputError(
            f"The motion has {given}, x of shape {motion.x.shape}, but {robot.name} moves {moves}.",
            remedy=remedy,
            robot=robot.name,
            axes=tuple(names),
            poses=wants_pose,
            given=motion.xd.shape[1],
            given_poses=motion.is_pose,
        )
