"""Load or make a robot: read its files, close its reference configuration, check its mobility."""

from redundancy_pin.loading.changes import with_limits, with_parameters
from redundancy_pin.loading.files import RobotLike, as_robot, idle_gravity, load_robot, load_with
from redundancy_pin.loading.pinocchio_model import robot_from_model
from redundancy_pin.loading.undecided import propose_robot

__all__ = [
    "RobotLike",
    "as_robot",
    "idle_gravity",
    "load_robot",
    "load_with",
    "propose_robot",
    "robot_from_model",
    "with_limits",
    "with_parameters",
]
