"""From a solution to a plan: efforts, statuses, limits, and what is worth reporting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import read_only
from redundancy_pin.dynamics.status import SampleStatus
from redundancy_pin.planners.finish import finish_plan
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.planners.whole_trajectory_check import DenseCheck, limits_broken
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_objective import value
from redundancy_pin.planners.whole_trajectory_prepare import Task
from redundancy_pin.planners.whole_trajectory_search import Found

PHASES = ("optimised",)

ROUNDING = 1e-6
"""Relative excess of an effort at a node over its limit that counts as rounding."""


def assemble(task: Task, problem: WholeProblem, found: Found, checks: list[DenseCheck], seconds: float) -> Plan:
    """Let the backend judge the solution at the nodes, and report.

    At singular nodes the efforts are those of the solution, which W⁻¹ f tends to; elsewhere, and with as many main
    actuators as coordinates, W τ = f leaves no choice.
    """
    robot, best = task.dynamics.robot, found.best
    starts = found.summary
    tau = best.tau(problem)
    prescribed = tau.copy()
    if robot.m <= robot.n:
        decided = np.ones(len(tau), dtype=bool)
        decided[problem.grid.singular] = False
        prescribed[decided] = np.nan
    plan = finish_plan(
        task.dynamics.along(task.source.sample_at(problem.grid.t)),
        best.course(problem).at_nodes(),
        planner="whole_trajectory",
        phase=np.zeros(len(tau), dtype=np.intp),
        phases=PHASES,
        parameters=task.settings.parameters,
        diagnostics={
            "optimal": best.optimal,
            "solver": best.message,
            "iterations": best.iterations,
            "violation": best.violation,
            "cost": best.cost,
            "starts": starts,
            "costs": starts["costs"],
            "solver_messages": starts["messages"],
            "objective": value(problem, best.values),
            "fits": list(found.fits),
            "nodes": len(problem.grid.t),
            "singular_instants": np.unique(problem.grid.t[problem.grid.singular]).tolist(),
            "singular_nodes": [int(i) for i in problem.grid.singular],
            "smooth_nodes": [int(i) for i in np.flatnonzero(problem.grid.smooth)],
            "dense_check": checks[-1].summary,
            "dense_ratios": [check.ratio for check in checks],
            "solver_seconds": best.seconds,
            "seconds": seconds,
        },
        prescribed=prescribed,
        carrier_limits=task.settings.limits,
    )
    status = np.array(plan.sample_status)
    at = problem.grid.singular
    status[at] = np.where(status[at] == SampleStatus.REGULAR, SampleStatus.SINGULAR_CONSISTENT, status[at])
    at_nodes = limits_broken("effort", robot.actuated, plan.t, plan.tau, task.settings.effort, 1.0 + ROUNDING)
    broken = (*plan.limits.violated, *at_nodes, *checks[-1].broken)
    verdict = plan.status
    if verdict is PlanStatus.WITHIN_LIMITS and broken:
        verdict = PlanStatus.VIOLATES_LIMITS
    elif verdict is PlanStatus.WITHIN_LIMITS and not best.optimal:
        verdict = PlanStatus.STOPPED_EARLY
    limits = replace(plan.limits, violated=tuple(sorted(broken, key=lambda event: event.start)))
    return replace(plan, sample_status=read_only(status), status=verdict, limits=limits)
