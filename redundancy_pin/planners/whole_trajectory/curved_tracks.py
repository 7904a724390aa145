"""Carriers on curved tracks: f is no polynomial of their motion, so it is fitted anew around each solution.

Around a course s̄(t) the backend gives f and its exact derivatives by s, ṡ and s̈; differences of those give the second
ones. That is a polynomial like that of straight tracks with two more terms, and everything else works on it as it does
for those. The programme is solved, its course is the next to fit around, and so on until the true f balances W τ; near
the end the error squares from fit to fit. Where a step makes the balance worse, the new course is taken only in part:
the other conditions on a course are linear, so that what lies between two that keep them does as well.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.planners.whole_trajectory.coefficients import Problem, Task, read_coefficients
from redundancy_pin.planners.whole_trajectory.constraint_generation import solve
from redundancy_pin.planners.whole_trajectory.infeasibility import relax
from redundancy_pin.planners.whole_trajectory.multistart import Outcome
from redundancy_pin.planners.whole_trajectory.solver import LEAST_SECONDS

BALANCED = 1e-8
"""Largest imbalance of W τ − f that is left, as a fraction of the size of f."""

SETTLED = 1e-7
"""Relative change of the cost from one fit to the next below which the optimum is reached."""

FITS = 40
"""Largest number of fits."""

WORSE = 2.0
"""Factor by which the imbalance may grow in a full step."""

LEAST_STEP = 1.0 / 32.0
"""Smallest part of a step that is tried."""


def fit_and_solve(task: Task, first: Problem, guess: dict[str, Array], seconds: float) -> Outcome:
    """Fit and solve in turn; the outcome is an optimum only where the true f is balanced.

    Args:
        task: robot, motion and settings.
        first: the problem as fitted around parked carriers: its scales are kept.
        guess: first guess, scaled.
        seconds: time bound, s.

    Raises:
        InfeasiblePlanError: no motion keeps every limit, as far as the fit around the last course tells.
    """
    deadline = time.perf_counter() + seconds
    grid, u = first.grid, first.scales
    along = task.dynamics.along(task.source.sample_at(grid.t))
    course, tau = first.carriers(guess), np.zeros((len(grid.t), first.model.W.shape[2]))
    balance, cost, iterations, settled = np.inf, np.inf, 0, False
    for fits in range(1, FITS + 1):  # noqa: B007 # how many it took is reported
        problem = replace(read_coefficients(task, grid, course), scales=u)
        guess = {**problem.scaled(course), "tau": tau / u.tau}
        solution = solve(problem, guess, max(deadline - time.perf_counter(), LEAST_SECONDS))
        iterations += solution.iterations
        if not solution.feasible:
            solution = relax(problem, robot_record(task.dynamics.robot), guess, solution.message)
        target, step = problem.carriers(solution.values), 1.0
        while True:
            trial = _between(course, target, step)
            efforts = tau + step * (solution.tau(problem) - tau)
            f = np.asarray(along.reduce(trial).f)
            imbalance = float(np.abs((np.einsum("nim,nm->ni", problem.model.W, efforts) - f) / u.row).max())
            if step <= LEAST_STEP or imbalance <= max(BALANCED, WORSE * balance):
                break
            step *= 0.5
        settled = abs(solution.cost - cost) <= SETTLED * abs(cost) and step == 1.0 and imbalance <= BALANCED
        course, tau, balance, cost = trial, efforts, imbalance, solution.cost
        if settled or time.perf_counter() > deadline:
            break
    solution = replace(
        solution,
        optimal=solution.optimal and settled,
        feasible=solution.feasible and imbalance <= BALANCED,
        violation=max(solution.violation, imbalance),
        iterations=iterations,
    )
    return Outcome(problem, solution, fits)


def _between(course: CarrierMotion, target: CarrierMotion, step: float) -> CarrierMotion:
    parts = ((getattr(course, name), getattr(target, name)) for name in ("s", "sd", "sdd"))
    return CarrierMotion(*(here + step * (there - here) for here, there in parts))
