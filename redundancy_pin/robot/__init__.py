"""Robots: URDF or xacro plus a declaration, read into a frozen description."""

from redundancy_pin.robot.loads import JointForces, Load, Payload, Spring, Wrench
from redundancy_pin.robot.types import AXES, Body, CarrierLimits, Closure, Coupling, Platform, Robot, WorkingModes

__all__ = [
    "AXES",
    "Body",
    "CarrierLimits",
    "Closure",
    "Coupling",
    "JointForces",
    "Load",
    "Payload",
    "Platform",
    "Robot",
    "Spring",
    "WorkingModes",
    "Wrench",
]
