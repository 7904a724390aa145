"""Calm plans: of all motions of nearly least cost, the one whose efforts reverse least.

s̈ is linear in a step, and near a singularity W⁻¹ magnifies what that leaves: the efforts of an optimum zigzag from node
to node (docs/planning.md, *Calm plans*). So the programme is solved once more. The nodes are denser by the
square root of the distance to the singularity, the carriers' jerk may jump at all of them but the singular ones, the
ripple is the objective, and the objective of the task at the nodes is bounded by (1 + calm) times the least cost there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.planners.intersample_check import intersample_check
from redundancy_pin.planners.optimal.mesh import NEAR_SINGULAR, Grid, resample, singular_ratio, with_middles
from redundancy_pin.planners.optimal.nlp import CALMING
from redundancy_pin.planners.optimal.problem import Task, read_problem
from redundancy_pin.planners.optimal.refine import Planned, Planning
from redundancy_pin.planners.optimal.solve import Multistart, Outcome, solve
from redundancy_pin.planners.optimal.transcription import objective_sizes, objective_values
from redundancy_pin.planners.plan import effort_reversals

MANY_REVERSALS = 10
"""Reversals of one effort above which a calmer plan is sought: the motion of the platform causes a few."""

LEVELS = 2
"""How often steps near a singularity are halved: the error of a step, h² over the distance, is then the same at a
quarter of the distance."""

LEAST_COST = 1e-9
"""Least cost over the size of the objective below which it counts as zero, and no fraction of it can be spent."""


def calmed(planning: Planning, planned: Planned, seconds: float) -> tuple[Planned, dict[str, object]]:
    """Return a calmer plan than the least-cost plan, or the least-cost plan itself; and diagnostics, as plain data.

    Args:
        planning: the planner, whose task has the fraction ``calm`` that may be spent.
        planned: its least-cost plan.
        seconds: time bound, s; no attempt is made if no time remains.

    Returns:
        The plan, the least-cost plan unless one with fewer reversals passes the check; and ``tried``, ``kept``, and,
        if it was tried, ``reversals`` before and after, and ``solver``, ``iterations`` and ``seconds`` of the
        solution.
    """
    task, best = planning.task, planned.best
    before = _most_reversals(best)
    costs = objective_values(best.problem, best.values)
    sizes = objective_sizes(best.problem)
    spendable = all(costs[name] > LEAST_COST * sizes[name] for name in task.settings.objective)
    if seconds <= 0.0 or not (task.settings.calm and best.solution.optimal and spendable and before > MANY_REVERSALS):
        return planned, {"tried": False, "kept": False}
    bounds = {name: (1.0 + task.settings.calm) * costs[name] for name in task.settings.objective}
    for name, bound in task.settings.at_most.items():
        bounds[name] = min(bound, bounds.get(name, np.inf))
    calmer = replace(task, settings=replace(task.settings, objective={"ripple": 1.0}, at_most=bounds))
    found = _solve(calmer, best, seconds)
    after = _most_reversals(found)
    chosen, solution = planned, found.solution
    if solution.feasible and solution.optimal and after < before:
        motion = planning.planned(found)
        check = intersample_check(motion)
        if check.passed:
            chosen = replace(planned, solutions=Multistart((found,), 1), motion=motion, check=check)
    return chosen, {
        "tried": True,
        "kept": chosen is not planned,
        "reversals": [before, after],
        "solver": solution.message,
        "iterations": solution.iterations,
        "seconds": solution.seconds,
    }


def _most_reversals(outcome: Outcome) -> int:
    efforts = outcome.problem.tau(outcome.values)
    return max(len(samples) for samples in effort_reversals(efforts))


def _solve(task: Task, outcome: Outcome, seconds: float) -> Outcome:
    """Solve on denser nodes, from an optimum."""
    old = outcome.problem
    nodes = _denser(task, old.grid)
    problem = read_problem(task, nodes, old)
    if old.shares is not None:
        problem = replace(problem, shares=resample({"shares": old.shares}, old.grid.t, nodes.t)["shares"])
    guess = old.resampled(outcome.values, problem)
    solution = solve(problem, guess, seconds, warm=CALMING)
    return Outcome(replace(problem, settings=old.settings), solution)


def _denser(task: Task, nodes: Grid) -> Grid:
    """Return nodes that are denser near singularities, of which only the singular ones keep the jerk continuous."""
    for level in range(1, LEVELS + 1):
        steps = np.flatnonzero(nodes.h > 0.0)
        middles: Array = 0.5 * (nodes.t[steps] + nodes.t[steps + 1])
        ratio = singular_ratio(task.dynamics.along(task.source.sample_at(middles)).reduce())
        marked = np.zeros(len(nodes.h), dtype=bool)
        marked[steps] = ratio < NEAR_SINGULAR / 4.0**level
        nodes = with_middles(nodes, marked)
    smooth = np.zeros(len(nodes.t), dtype=bool)
    smooth[nodes.singular] = nodes.smooth[nodes.singular]
    return replace(nodes, smooth=read_only(smooth))
