"""Future work named by the thesis: carriers elsewhere, balancing, design, time and space, and the cost of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.base_wrench import load_at_rest
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot.lookup import find_joint_index
from redundancy_pin.simulation.replay import replay
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis.case import Call, Case, Plans, plan_or_error
from redundancy_pin.thesis.cases import Extent, read_case
from redundancy_pin.thesis.measures import numbers
from redundancy_pin.thesis.table import Record, data

CENTRE = (0.866, 0.5, 0.0)
"""Centre of the base of the 3-RRR, m, about which moments are taken."""

PLANNED: Mapping[tuple[str, str], Case] = {
    (task, method): read_case(entry["robot"], entry)
    for task, methods in data("cases")["future"].items()
    for method, entry in methods.items()
}
"""Plans by task and method."""

SPATIAL = [case for case in PLANNED.values() if case.robot in ("gough", "delta")]


def calls(extent: Extent) -> list[Call]:
    """Return the calls that make the rows of the chapter."""
    return [(f"{task}: {method}", make_record, task, method, coarsened(case, extent))
            for (task, method), case in PLANNED.items()]  # fmt: skip


def run_future(plans: Plans, extent: Extent) -> Record:
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
