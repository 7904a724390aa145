"""Future work named by the thesis: carriers elsewhere, balancing, design, time and space, and the cost of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.base_wrench import load_at_rest
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot.lookup import find_joint_index
from redundancy_pin.simulation.replay import replay
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis.case import Call, Case, Options, Plans, options, plan_or_error
from redundancy_pin.thesis.cases import FIRST_MODE, Extent
from redundancy_pin.thesis.measures import numbers
from redundancy_pin.thesis.planned import Chapter
from redundancy_pin.thesis.table import Record

CENTRE = (0.866, 0.5, 0.0)
"""Centre of the base of the 3-RRR, m, about which moments are taken."""

TORQUE = 3.03
"""Largest effort of plans of least time, N·m: that of the corner at 0.2 m/s without carriers."""

_ROUND = options(radius=0.025, speed=0.2, ramp_time=0.4)
_WIDE: Mapping[str, Any] = {"track": (-1.0, 1.0), "speed": 5.0, "acceleration": 20.0}
_CORNER = Case("corner", "3rrr", "corner", _ROUND, "whole_trajectory", options(**_WIDE), FIRST_MODE, dt=0.02)
_BARE = replace(_CORNER, planner="none", options=(), dt=2e-3)
_BALANCED = _CORNER.with_options(objective="base_wrench", base_point=CENTRE)
_TWICE = _BARE.with_path(speed=0.4)
_FAST = replace(
    _TWICE.with_planner("whole_trajectory", 0.01, objective="peak", speed=5.0, acceleration=60.0),
    arguments=options(carrier_mass=0.6, tail_length=0.56),
)
_TIMED = _CORNER.with_planner("time_optimal", effort=TORQUE)


def _circle(**arguments: Any) -> Case:
    path: Options = options(speed=0.5, ramp_time=0.2)
    machine = options(end_effector_mass=0.5, **arguments)
    return Case("circle", "2rpr", "circle", path, "whole_trajectory", arguments=machine, dt=0.02)


_GOUGH = Case(
    "gough", "gough", "pose",
    options(start=(0.0, 0.0, 0.6, 0.0, 0.0, 0.573576436, 0.819152044),
            end=(0.0, 0.0, 0.6, 0.0, 0.0, 0.819152044, 0.573576436)),
    "whole_trajectory", arguments=options(carriers=True), dt=0.05,
    title="Gough platform through the type II pose at 90° of yaw, under gravity",
)  # fmt: skip
_DELTA = Case(
    "delta", "delta", "points", options(points=((-0.04, 0.02, -0.25), (0.05, 0.0, -0.05)), speed=0.6, ramp_time=0.2),
    "whole_trajectory", arguments=options(rod_carriers=True, rod_length=0.35), dt=0.02,
    title="delta through the plane of its elbows, under gravity",
)  # fmt: skip
SPATIAL = (_GOUGH, _DELTA)

_MASS, _ARMS = "2-RPR circle, 0.5 kg at the end-effector", "3-RRR corner, carriers on arms of 0.3 m"
_FEED, _FRONT = "3-RRR corner at twice the feed", "3-RRR corner, front of peak over energy"
_CALM, _TIME = "3-RRR corner, balanced", "3-RRR corner, least time"

PLANNED: Mapping[tuple[str, str], Case] = {
    (_MASS, "least effort, carriers on the legs"): _circle(),
    (_MASS, "least effort, carriers on the end-effector"): _circle(carriers=False, end_effector_carriers=True),
    (_MASS, "least effort, carriers on arms of 0.3 m"): _circle(arm_length=0.3),
    (_ARMS, "least effort"): replace(_CORNER, options=(), arguments=options(arm_length=0.3)),
    (_FEED, "no carriers"): _TWICE,
    (_FEED, "machine of co-design, least peak"): _FAST,
    **{
        (_FRONT, f"least peak with at most {energy:g} J"): _CORNER.with_options(
            objective="peak", at_most=(("energy", energy),)
        )
        for energy in (2.0, 3.0, 4.0)
    },
    (_CALM, "no carriers"): _BARE,
    (_CALM, "least effort, parked at the end"): _CORNER,
    (_CALM, "least base wrench, parked at the end"): _BALANCED,
    (_CALM, "least base wrench, free end"): _BALANCED.with_options(end="free"),
    ("Gough platform, 70 to 110° of yaw", "least effort"): _GOUGH,
    ("delta, through the plane of its elbows", "least effort"): _DELTA,
    (_TIME, "no carriers"): replace(_TIMED, arguments=options(carriers=False)),
    (_TIME, "parked before, free after"): _TIMED.with_options(**_WIDE, end="free"),
    (_TIME, "at rest before and after"): _TIMED.with_options(**_WIDE, begin="rest", end="rest"),
}
"""Plans by task and method."""


def calls(extent: Extent) -> list[Call]:
    """Return the calls that make the rows of the chapter."""
    return [(f"{task}: {method}", make_record, task, method, coarsened(case, extent))
            for (task, method), case in PLANNED.items()]  # fmt: skip


def run_future(plans: Plans, extent: Extent) -> Chapter:
    """Return the records of the chapter."""
    return {"plans": [plans.result(*call) for call in calls(extent)]}


def coarsened(case: Case, extent: Extent) -> Case:
    """Return a case with the steps of an extent, up to a factor of two: fewer nodes do not show the crossings."""
    return replace(case, dt=case.dt * min(extent.coarser, 2.0))


def make_record(task: str, method: str, case: Case) -> Record:
    """Plan a case and return its row."""
    return task_record(task, method, case, plan_or_error(case, case.backends[0]))


def task_record(task: str, method: str, case: Case, outcome: Plan | InfeasiblePlanError) -> Record:
    """Return one row of the table: a method's plan of a task, or the reason why it has none."""
    if isinstance(outcome, InfeasiblePlanError):
        return {"task": task, "way": method, "status": f"{ResultStatus.INFEASIBLE.value}: {outcome.message}"}
    dynamics, carriers = case.dynamics(), outcome.carriers
    robot, point = dynamics.robot, np.array(CENTRE if case.robot == "3rrr" else (0.0, 0.0, 0.0))
    push = outcome.base_wrench(dynamics, point) - load_at_rest(dynamics, outcome.motion, carriers.s[0], point)
    added = sum(robot.model.inertias[find_joint_index(robot.model, name)].mass for name in robot.carriers)
    return {
        **numbers(outcome),
        "task": task,
        "way": method,
        "unit": case.unit if case.robot != "gough" else "N",
        "added": float(added),
        "duration": float(outcome.t[-1] - outcome.t[0]),
        "peak": float(outcome.peak_effort.max()),
        "stroke": float(np.ptp(carriers.s, axis=0).max(initial=0.0)),
        "base_force": float(np.linalg.norm(push[:, :3], axis=1).max()),
        "replay": replay(outcome, backend=as_dynamics).largest,
        "base_moment": float(np.linalg.norm(push[:, 3:], axis=1).max()),
        "singular_instants": list(outcome.findings.singular_instants),
    }
