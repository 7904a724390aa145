"""A robot wherever one is wanted: itself, or by its name or path."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TypeAlias

from redundancy_pin.arrays import require_type
from redundancy_pin.robot.types import Robot

RobotLike: TypeAlias = Robot | str | Path
"""A robot, the name of a shipped one, or the path of a declaration or of its folder."""


def as_robot(robot: RobotLike) -> Robot:
    """Return a robot, loaded as ``load_robot`` does where it is named; whoever takes a robot begins with this.

    Raises:
        InputError: neither a robot nor a name or path.
        RedundancyPinError: what ``load_robot`` raises.
    """
    if isinstance(robot, (str, Path)):
        # closing its chains needs kinematics, which is above this room: looked up when a robot is named
        loaded: Robot = importlib.import_module("redundancy_pin.loading").load_robot(robot)
        return loaded
    require_type(robot, Robot, "A robot", "Pass load_robot(...), or the name or path of one.")
    return robot
