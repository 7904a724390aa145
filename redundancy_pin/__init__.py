"""Closed-chain (parallel-robot) dynamics and planning on Pinocchio."""

from redundancy_pin import trajectory
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.reactions import joint_reactions
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.kinematics.state import lift
from redundancy_pin.loading import load_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.plan_file import load_plan, load_robot_of

__all__ = [
    "CarrierMotion",
    "PlatformMotion",
    "RneaDynamics",
    "VirtualWork",
    "distribute",
    "joint_reactions",
    "lift",
    "load_plan",
    "load_robot",
    "load_robot_of",
    "trajectory",
]
__version__ = "0.1.0"
