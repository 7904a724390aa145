"""What a simulation is, as plain data, against the motion that it was to follow."""

from __future__ import annotations

from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.kinematics.coordinates import distance
from redundancy_pin.planners.reference import MotionReference
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.result import Simulation


def platform_error(run: Simulation, reference: MotionReference, robot: Robot) -> Array:
    """Return the distance (N,) of the platform from a motion at the samples of a simulation, m.

    Rotations count times the characteristic length of ``robot``.
    """
    planned = np.array([reference.platform(t)[0] for t in run.t.tolist()])
    return read_only(distance(robot, np.array(run.x), planned))


def summary(run: Simulation, reference: MotionReference, robot: Robot) -> dict[str, Any]:
    """Return what is worth knowing of a simulation as plain data, by name; SI units.

    Args:
        run: the simulation.
        reference: the motion that it was to follow.
        robot: the robot that was simulated; angles count times its characteristic length in distances, m.
    """
    away = platform_error(run, reference, robot)[run.t <= reference.end]
    return {
        "robot": run.robot.name,
        "status": run.status.value,
        "reason": run.reason,
        "samples": len(run),
        "start": float(run.t[0]),
        "end": float(run.t[-1]),
        "events": [vars(event) for event in run.events],
        "largest_distance": float(away.max()),
        "last_distance": float(away[-1]),
        "peak_effort": np.fmax.reduce(np.abs(run.tau), axis=0),
        "peak_carrier_force": np.fmax.reduce(np.abs(run.carrier_force), axis=0),
        "work": float(run.work[-1]),
        "largest_closure_residual": float(run.gap.max()),
        "parameters": run.parameters,
        "statistics": vars(run.statistics),
    }
