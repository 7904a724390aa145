"""Robots: URDF or xacro plus a declaration, read into a frozen description."""

from redundancy_pin.robot.named import RobotLike, as_robot
from redundancy_pin.robot.types import AXES, CarrierLimits, Closure, Platform, Robot, WorkingModes

__all__ = ["AXES", "CarrierLimits", "Closure", "Platform", "Robot", "RobotLike", "WorkingModes", "as_robot"]
