"""Simulations in files: read back with every inconsistency refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from redundancy_pin.errors import InputError
from redundancy_pin.planners.archive import read_archive
from redundancy_pin.planners.robot_record import read_robot
from redundancy_pin.simulation.events import Event
from redundancy_pin.simulation.result import FORMAT, VERSION, Simulation, SimulationStatus, Statistics


def load_simulation(path: str | Path) -> Simulation:
    """Read a simulation that was saved with ``Simulation.save``. Nothing in the file is executed.

    Raises:
        PlanFileError: the file is missing, truncated, damaged, no simulation, of a newer format, or its arrays do not
            fit together.
    """
    return read_archive(path, FORMAT, VERSION, "simulation", _simulation)


def _simulation(record: Mapping[str, Any]) -> Simulation:
    """Return the simulation of a record, checked."""
    values = {field.name: record[field.name] for field in fields(Simulation)}
    values["robot"] = read_robot(values["robot"])
    values["events"] = tuple(Event(**entry) for entry in values["events"])
    values["status"] = SimulationStatus(values["status"])
    values["statistics"] = Statistics(**values["statistics"])
    simulation = Simulation(**values)
    _check(simulation)
    return simulation


def _check(simulation: Simulation) -> None:
    """Check that the arrays fit together."""
    # the sizes that the others are measured by
    for name, axes in (("t", (1,)), ("v", (2,)), ("x", (2, 3)), ("xd", (2,)), ("closure_force", (2,))):
        value = getattr(simulation, name)
        if np.ndim(value) not in axes:
            raise InputError(f"{name} has shape {np.shape(value)}, which no simulation has")
    count, robot = len(simulation.t), simulation.robot
    n, nv = simulation.xd.shape[1], simulation.v.shape[1]
    m, k = len(robot.actuated), len(robot.carriers)
    poses = simulation.x.ndim == 3
    for name, shape in (
        ("t", (count,)),
        ("q", (count, len(robot.q_reference))),
        ("v", (count, nv)),
        ("a", (count, nv)),
        ("x", (count, 4, 4) if poses else (count, n)),
        ("xd", (count, n)),
        *((name, (count, k)) for name in ("s", "sd", "sdd", "carrier_force")),
        *((name, (count, m)) for name in ("tau", "actuated_rate")),
        ("closure_force", (count, simulation.closure_force.shape[1])),
        ("gap", (count,)),
        ("energy", (count,)),
    ):
        value = getattr(simulation, name)
        if not isinstance(value, np.ndarray) or value.dtype != np.float64:
            raise InputError(f"{name} is no array of floats")
        if value.shape != shape:
            raise InputError(f"{name} has shape {value.shape}, but the rest of the simulation needs {shape}")
