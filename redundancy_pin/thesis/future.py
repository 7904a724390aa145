"""What the thesis leaves to the future: carriers elsewhere, balancing, design, time and space, with what each costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.parallel import parallel
from redundancy_pin.planners.base_wrench import load_at_rest
from redundancy_pin.planners.optimal.time_optimal import plan_time_optimal
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.robot.lookup import find_joint_index
from redundancy_pin.simulation.replay import replay
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis.case import Case, Plans, options
from redundancy_pin.thesis.cases import Extent
from redundancy_pin.thesis.measures import numbers
from redundancy_pin.thesis.planned import Chapter, Progress
from redundancy_pin.thesis.table import Record

CENTRE = (0.866, 0.5, 0.0)
"""Of the base of the 3-RRR, m; moments are taken about it."""

_WIDE: Mapping[str, Any] = {"track": (-1.0, 1.0), "speed": 5.0, "acceleration": 20.0}
_CORNER = Case(
    "corner",
    "3rrr",
    "corner",
    options(radius=0.025, speed=0.2, ramp_time=0.4),
    "whole_trajectory",
    options(**_WIDE),
    working_mode=(1, 1, 1),
    dt=0.02,
)
_BARE = Case("corner", "3rrr", "corner", _CORNER.path_options, "none", working_mode=(1, 1, 1), dt=2e-3)
_BALANCED = _CORNER.with_options(objective="base_wrench", base_point=CENTRE)
_ARMS = options(arm_length=0.3)
_TWICE = replace(_BARE, path_options=options(radius=0.025, speed=0.4, ramp_time=0.4))
_CIRCLE = Case(
    "circle",
    "2rpr",
    "circle",
    options(speed=0.5, ramp_time=0.2),
    "whole_trajectory",
    arguments=options(end_effector_mass=0.5),
    dt=0.02,
)

PLANNED: Mapping[tuple[str, str], Case] = {
    **{
        ("2-RPR circle, 0.5 kg at the end-effector", f"least effort, carriers {where}"): replace(
            _CIRCLE, arguments=options(end_effector_mass=0.5, **arguments)
        )
        for where, arguments in (
            ("on the legs", {}),
            ("on the end-effector", {"carriers": False, "end_effector_carriers": True}),
            ("on arms of 0.3 m", dict(_ARMS)),
        )
    },
    ("3-RRR corner, carriers on arms of 0.3 m", "least effort"): replace(_CORNER, options=(), arguments=_ARMS),
    ("3-RRR corner at twice the feed", "no carriers"): _TWICE,
    ("3-RRR corner at twice the feed", "machine of co-design, least peak"): replace(
        _TWICE,
        planner="whole_trajectory",
        options=options(objective="peak", speed=5.0, acceleration=60.0),
        arguments=options(carrier_mass=0.6, tail_length=0.56),
        dt=0.01,
    ),
    **{
        ("3-RRR corner, front of peak over energy", f"least peak with at most {energy:g} J"): _CORNER.with_options(
            objective="peak", at_most=(("energy", energy),)
        )
        for energy in (2.0, 3.0, 4.0)
    },
    ("3-RRR corner, balanced", "no carriers"): _BARE,
    ("3-RRR corner, balanced", "least effort, parked at the end"): _CORNER,
    ("3-RRR corner, balanced", "least base wrench, parked at the end"): _BALANCED,
    ("3-RRR corner, balanced", "least base wrench, free end"): _BALANCED.with_options(end="free"),
    ("Gough platform, 70 to 110° of yaw", "least effort"): Case(
        "gough",
        "gough",
        "pose",
        options(
            start=(0.0, 0.0, 0.6, 0.0, 0.0, 0.573576436, 0.819152044),
            end=(0.0, 0.0, 0.6, 0.0, 0.0, 0.819152044, 0.573576436),
        ),
        "whole_trajectory",
        arguments=options(carriers=True),
        dt=0.05,
        title="Gough platform through the type II pose at 90° of yaw, under gravity",
    ),
    ("delta, through the plane of its elbows", "least effort"): Case(
        "delta",
        "delta",
        "points",
        options(points=((-0.04, 0.02, -0.25), (0.05, 0.0, -0.05)), speed=0.6, ramp_time=0.2),
        "whole_trajectory",
        arguments=options(rod_carriers=True, rod_length=0.35),
        dt=0.02,
        title="delta through the plane of its elbows, under gravity",
    ),
}
"""Whole-trajectory plans by task and method."""

TIMED: Mapping[tuple[str, str], Case] = {
    ("3-RRR corner, least time", "no carriers"): _BARE,
    **{
        ("3-RRR corner, least time", method): _CORNER.with_options(**ends)
        for method, ends in (
            ("parked before, free after", {"end": "free"}),
            ("at rest before and after", {"begin": "rest", "end": "rest"}),
        )
    },
}
"""Plans of least time under ``TORQUE``."""

TORQUE = 3.03
"""N·m, largest of the corner at 0.2 m/s without carriers."""

SPATIAL = tuple(case for case in PLANNED.values() if case.title)


def run_future(plans: Plans, extent: Extent, progress: Progress) -> Chapter:
    """Run the chapter, on several processes."""
    cases = {key: coarsened(case, extent) for key, case in PLANNED.items()}
    first = [(least_time, *key, case) for key, case in TIMED.items()]
    timed = plans.prepare([(case, case.backends[0]) for case in cases.values()], extent.jobs, progress, first=first)
    progress("least time")
    calls = [(*key, case, plans.outcome(case)) for key, case in cases.items()]
    return {"plans": [*parallel(task_record, calls, extent.jobs, ordered=True), *timed]}


def coarsened(case: Case, extent: Extent) -> Case:
    """Return a case with the steps of an extent, up to a factor of two: fewer nodes do not show the crossings."""
    return replace(case, dt=case.dt * min(extent.coarser, 2.0))


def least_time(task: str, method: str, case: Case) -> Record:
    """Return the record of a plan of least time."""
    settings = {name: value for name, value in case.options if case.planner != "none"}
    keywords = in_groups(plan_time_optimal, {"effort": TORQUE, **settings})
    plan = plan_time_optimal(case.dynamics(), case.trajectory().path, **keywords)
    return task_record(task, method, case, plan)


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
