"""The two backends by name: the one place where they are listed."""

from __future__ import annotations

from collections.abc import Callable

from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.robot import Robot

RNEA = "rnea"
VIRTUAL_WORK = "virtual-work"

BACKENDS: dict[str, Callable[[Robot], Dynamics]] = {RNEA: RneaDynamics, VIRTUAL_WORK: VirtualWork}
"""Dynamics of a robot, by the name the command line uses."""
