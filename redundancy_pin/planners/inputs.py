"""What every planner is given: a backend and a motion, told apart from what is likely to be passed by mistake."""

from __future__ import annotations

from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion


def require_dynamics(dynamics: object) -> None:
    """Check that the first argument of a planner is a backend.

    Raises:
        InputError: it is a robot, or something else.
    """
    if not (hasattr(dynamics, "along") and hasattr(dynamics, "robot")):
        raise InputError(
            f"The planner was given {type(dynamics).__name__} for the dynamics.",
            remedy="Pass a backend of the robot: RneaDynamics(robot) or VirtualWork(robot).",
        )


def require_motion(motion: object, *methods: str) -> None:
    """Check that a motion is sampled, or a trajectory that offers some methods.

    Raises:
        InputError: it is neither.
    """
    if not isinstance(motion, PlatformMotion) and not all(hasattr(motion, method) for method in methods):
        raise InputError(
            f"The planner was given {type(motion).__name__} for the motion.",
            remedy="Pass a trajectory, such as trajectory.reference.circle(), or a PlatformMotion.",
        )
