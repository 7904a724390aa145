"""The default backend: functions that take dynamics take a robot too, and choose its backend here.

Generated code (``dynamics.compiled``) if it can be compiled, otherwise RNEA (``dynamics.rnea``) with one warning that
names the reason and what to install. Planners and simulations name no other backend.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.dynamics.compiled import CompiledDynamics, MotionDerivatives
from redundancy_pin.dynamics.rnea import RneaAlongMotion, RneaDynamics
from redundancy_pin.errors import CompilerError, InputError, UnsupportedRobotError
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot

DynamicsLike: TypeAlias = Dynamics | RobotLike
"""A backend; or a robot, its name or its path, for which ``as_dynamics`` chooses the backend."""


def as_dynamics(dynamics: DynamicsLike) -> Dynamics:
    """Return a backend: the given one, or the default of a robot. Functions that take dynamics begin with this.

    Raises:
        InputError: neither a backend nor a robot, its name or its path.
        RedundancyPinError: any error of ``load_robot``.

    Warns:
        RuntimeWarning: RNEA is used because no compiler is found (the remedy names the extra ``compiler``), it fails,
            or generated code does not cover a joint; once for each reason.

    Example:
        >>> from redundancy_pin.dynamics.default import as_dynamics
        >>> as_dynamics("five_bar").robot.name
        'five_bar'
    """
    if not isinstance(dynamics, (Robot, str, Path)):
        if not isinstance(dynamics, type) and hasattr(dynamics, "along") and hasattr(dynamics, "robot"):
            return dynamics
        raise InputError(
            f"{type(dynamics).__name__} was given for the dynamics.",
            remedy="Pass a robot, its name or its path; or a backend, such as RneaDynamics(robot).",
        )
    robot = as_robot(dynamics)
    try:
        return CompiledDynamics(robot)
    except (CompilerError, UnsupportedRobotError) as error:
        # attributed to this line for every caller, so that Python prints each reason once
        warnings.warn(
            f"{error.message} RNEA is used: the same numbers, many times as slow. {error.remedy}".strip(),
            RuntimeWarning,
            stacklevel=1,
        )
        return RneaDynamics(robot)


def as_cached_dynamics(dynamics: DynamicsLike) -> Dynamics:
    """Return ``as_dynamics`` with a cache for one task: RNEA solves each sample once, for any number of calls.

    Errors and warnings as of ``as_dynamics``.
    """
    own = as_dynamics(dynamics)
    return own.with_cache() if type(own) is RneaDynamics else own


def rnea_along(tree: JointTrajectory) -> DynamicsAlongMotion:
    """Return RNEA along a motion of the tree, carriers at zero: the reading copy, whatever backend made a plan."""
    return RneaAlongMotion(tree)


def design_derivatives(
    robot: Robot, motion: PlatformMotion, carriers: CarrierMotion | None, parameters: Sequence[str]
) -> MotionDerivatives:
    """Return exact derivatives along a motion by numbers of the robot, which generated code alone has.

    Args:
        robot: the robot.
        motion: N samples of the platform.
        carriers: N samples of the carriers; parked at s = 0 when left out.
        parameters: (d,) names of design parameters, as of ``CompiledAlongMotion.derivatives``.

    Raises:
        CompilerError: there is no C compiler.
        UnsupportedRobotError: generated code does not cover a joint; a parameter that changes the joints.
        InputError, UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.

    Example:
        >>> design_derivatives(load_robot("four_bar"), motion, None, ["crank_mass"]).tau.parameters.shape
        (101, 1, 1)
    """
    return CompiledDynamics(robot).along(motion).derivatives(carriers, parameters)
