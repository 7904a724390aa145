"""What a simulation is, as plain data and as a table, against the motion that it was to follow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.io.summary import Summary, TextTable, listed, number
from redundancy_pin.kinematics.coordinates import distance
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.reference import MotionReference, plan_reference
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.planners.summary import event_texts, limits_broken
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import turning_coordinates
from redundancy_pin.status import ResultStatus

if TYPE_CHECKING:
    from redundancy_pin.simulation.result import Simulation

_LISTED = 8
"""Events that the table lists; the rest is counted."""

_SAME = 1e-9
"""Of a motion's end or a simulation's duration: times that differ by less are one."""

_ON_ITS_WAY = 0.05
"""Share of the extent of the motion, and of a track, up to which a machine that stops was near its plan."""


def platform_error(run: Simulation, reference: MotionReference, robot: Robot) -> Array:
    """Return the distance (N,) of the platform from a motion at the samples of a simulation, m.

    Rotations count times the characteristic length of ``robot``.
    """
    planned = np.array([reference.platform(t)[0] for t in run.t.tolist()])
    return read_only(distance(robot, np.array(run.x), planned))


def summary(run: Simulation, motion: Plan | MotionReference | None = None, robot: Robot | None = None) -> Summary:
    """Return ``Simulation.summary``."""
    facts: dict[str, Any] = {
        "robot": run.robot.name,
        "status": run.status.value,
        "reason": run.reason,
        "samples": len(run),
        "start": float(run.t[0]),
        "end": float(run.t[-1]),
        "events": [vars(event) for event in run.events],
        "limits": {"violated": [vars(event) for event in run.violated]},
        "peak_effort": np.fmax.reduce(np.abs(run.tau), axis=0),
        "peak_carrier_force": np.fmax.reduce(np.abs(run.carrier_force), axis=0),
        "work": float(run.work[-1]),
        "largest_closure_residual": float(run.gap.max()),
        "parameters": run.parameters,
        "statistics": vars(run.statistics),
    }
    main, moved = run.robot.effort_units
    seen = [f"{event.kind.replace('_', ' ')} ({event.name}) at {event.t:.4g} s" for event in run.events]
    efforts = zip(run.robot.actuated, facts["peak_effort"].tolist(), strict=True)
    forces = zip(run.robot.carriers, facts["peak_carrier_force"].tolist(), strict=True)
    broken = event_texts(run.robot, run.violated, broken=True)
    away: list[tuple[str, str]] = []
    near_plan = False
    if motion is not None:
        robot = robot_of_record(run.robot, robot)
        reference = motion if isinstance(motion, MotionReference) else plan_reference(motion)
        error = platform_error(run, reference, robot)[run.t <= reference.end]
        facts |= {"largest_distance": float(error.max()), "last_distance": float(error[-1])}
        unit = f"m, rad times {robot.characteristic_length:.4g} m" if any(turning_coordinates(robot)) else "m"
        away = [
            (f"largest distance from the planned motion [{unit}]", number(facts["largest_distance"])),
            (f"distance at the end [{unit}]", number(facts["last_distance"])),
        ]
        near_plan = run.status is ResultStatus.STOPPED and _is_on_its_way(run, reference, robot)
    rows = [
        ("status", run.status.value.replace("_", " ")),
        ("time [s]", f"{facts['start']:.6g} to {facts['end']:.6g}, {len(run)} samples"),
        ("events", listed(seen, _LISTED, "\n") or "none"),
        ("limits broken", listed(broken, _LISTED, "\n") or "none"),
        *away,
        *((f"peak of {name} [{main}]", number(value)) for name, value in efforts),
        *((f"peak of {name} [{moved}]", number(value)) for name, value in forces),
        ("work of all actuators [J]", number(facts["work"])),
    ]
    return Summary(facts, TextTable(run.robot.name, rows), warnings=_warnings(run, near_plan=near_plan))


def _warnings(run: Simulation, *, near_plan: bool) -> Iterator[str]:
    """Give why a simulation ended early and what helps, the limits it broke, and that it outlasted its motion."""
    if run.status is ResultStatus.NOT_CONVERGED:
        yield f"could not go on at t = {run.t[-1]:.6g} s: {run.reason}"
    if run.status is ResultStatus.STOPPED:
        last = run.events[-1]
        what = f"stopped at t = {last.t:.6g} s: {last.kind.replace('_', ' ')} ({last.name})"
        remedy = "; a plan of a narrower track (limits=Limits(track=...), --track) leaves room to deviate from it."
        yield what + (remedy if last.kind == "track" and near_plan else "")
    if run.violated:
        yield limits_broken(run.robot, run.violated)
    end = run.parameters.get("motion_end")
    if isinstance(end, float) and run.t[-1] > end + _SAME * max(abs(end), float(run.t[-1] - run.t[0])):
        yield (
            f"the motion to follow ends at t = {end:.6g} s, and the simulation goes on to {run.t[-1]:.6g} s with what "
            "was planned for its last instant."
        )


def _is_on_its_way(run: Simulation, reference: MotionReference, robot: Robot) -> bool:
    """Return whether platform and carriers end near where the plan has them then."""
    platform = np.array([reference.platform(t)[0] for t in reference.edges.tolist()])
    extent = float(distance(robot, platform, np.broadcast_to(platform[0], platform.shape)).max())
    off = float(platform_error(run, reference, robot)[-1])
    lengths = np.array([limits.upper - limits.lower for limits in robot.carrier_limits])
    planned, _, _ = reference.carriers(float(run.t[-1]))
    return off <= _ON_ITS_WAY * extent and bool((np.abs(run.s[-1] - planned) <= _ON_ITS_WAY * lengths).all())
