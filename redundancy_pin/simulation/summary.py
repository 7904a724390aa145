"""What a simulation is, as plain data and as a table, against the motion that it was to follow."""

from __future__ import annotations

from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.io.summary import Summary, TextTable, listed, number
from redundancy_pin.kinematics.coordinates import distance
from redundancy_pin.planners.reference import MotionReference
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import turning_coordinates
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.status import ResultStatus

_LISTED = 8
"""Events that the table lists; the rest is counted."""

_ON_ITS_WAY = 0.05
"""Share of the extent of the motion, and of a track, up to which a machine that stops was near its plan."""


def platform_error(run: Simulation, reference: MotionReference, robot: Robot) -> Array:
    """Return the distance (N,) of the platform from a motion at the samples of a simulation, m.

    Rotations count times the characteristic length of ``robot``.
    """
    planned = np.array([reference.platform(t)[0] for t in run.t.tolist()])
    return read_only(distance(robot, np.array(run.x), planned))


def summary(run: Simulation, reference: MotionReference, robot: Robot) -> Summary:
    """Return a summary of a simulation, SI units: a mapping, whose ``print`` is a table with warnings.

    Args:
        run: the simulation.
        reference: the motion that it was to follow.
        robot: the robot that was simulated; angles count times its characteristic length in distances, m.
    """
    away = platform_error(run, reference, robot)[run.t <= reference.end]
    facts: dict[str, Any] = {
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
    main, moved = run.robot.effort_units
    unit = f"m, rad times {robot.characteristic_length:.4g} m" if any(turning_coordinates(robot)) else "m"
    seen = [f"{event.kind.replace('_', ' ')} ({event.name}) at {event.t:.4g} s" for event in run.events]
    efforts = zip(run.robot.actuated, facts["peak_effort"].tolist(), strict=True)
    forces = zip(run.robot.carriers, facts["peak_carrier_force"].tolist(), strict=True)
    rows = [
        ("status", run.status.value.replace("_", " ")),
        ("time [s]", f"{facts['start']:.6g} to {facts['end']:.6g}, {len(run)} samples"),
        ("events", listed(seen, _LISTED, "\n") or "none"),
        (f"largest distance from the planned motion [{unit}]", number(facts["largest_distance"])),
        (f"distance at the end [{unit}]", number(facts["last_distance"])),
        *((f"peak of {name} [{main}]", number(value)) for name, value in efforts),
        *((f"peak of {name} [{moved}]", number(value)) for name, value in forces),
        ("work of all actuators [J]", number(facts["work"])),
    ]
    return Summary(facts, TextTable(run.robot.name, [*rows]), warnings=_warnings(run, reference, robot))


def _warnings(run: Simulation, reference: MotionReference, robot: Robot) -> list[str]:
    """Return the reason why a simulation ended early, and a remedy."""
    if run.status is ResultStatus.NOT_CONVERGED:
        return [f"could not go on at t = {run.t[-1]:.6g} s: {run.reason}"]
    if run.status is not ResultStatus.STOPPED:
        return []
    last = run.events[-1]
    what = f"stopped at t = {last.t:.6g} s: {last.kind.replace('_', ' ')} ({last.name})"
    if last.kind != "track" or not _is_on_its_way(run, reference, robot):
        return [what]
    return [f"{what}; a plan of a narrower track (limits=Limits(track=...), --track) leaves room to deviate from it."]


def _is_on_its_way(run: Simulation, reference: MotionReference, robot: Robot) -> bool:
    """Return whether platform and carriers end near where the plan has them then."""
    platform = np.array([reference.platform(t)[0] for t in reference.edges.tolist()])
    extent = float(distance(robot, platform, np.broadcast_to(platform[0], platform.shape)).max())
    off = float(platform_error(run, reference, robot)[-1])
    lengths = np.array([limits.upper - limits.lower for limits in robot.carrier_limits])
    planned, _, _ = reference.carriers(float(run.t[-1]))
    return off <= _ON_ITS_WAY * extent and bool((np.abs(run.s[-1] - planned) <= _ON_ITS_WAY * lengths).all())
