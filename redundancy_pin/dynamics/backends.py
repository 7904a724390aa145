"""The backends by the names that the command line, problem files and results use."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.robot import Robot

RNEA, VIRTUAL_WORK, COMPILED = "rnea", "virtual-work", "compiled"

BACKENDS: Mapping[str, Callable[[Robot], Dynamics]] = {
    RNEA: RneaDynamics,
    VIRTUAL_WORK: VirtualWork,
    COMPILED: CompiledDynamics,
}
"""Constructors of the dynamics of a robot, by name."""


def backend_of(dynamics: Dynamics) -> str:
    """Return the name of a backend in ``BACKENDS``; the name of its class if it is not there."""
    own = type(dynamics)
    return next((name for name, kind in BACKENDS.items() if kind is own), own.__name__)
