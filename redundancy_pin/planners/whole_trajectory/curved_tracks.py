"""Carriers on curved tracks: f is no polynomial of their motion, so it is fitted anew around each course.

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
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.planners.whole_trajectory.constraint_generation import solve
from redundancy_pin.planners.whole_trajectory.mesh import CarrierCourse, Grid
from redundancy_pin.planners.whole_trajectory.multistart import Found, first_guess, relax
from redundancy_pin.planners.whole_trajectory.problem import Task, WholeProblem, prepare
from redundancy_pin.planners.whole_trajectory.solver import LEAST_SECONDS, LONG, Say, Solution

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


def search_curved(
    task: Task, grid: Grid, warm: CarrierCourse | None, say: Say | None = None
) -> tuple[WholeProblem, Found]:
    """Plan for carriers on curved tracks from all first guesses.

    Args:
        task: robot, motion and settings.
        grid: the nodes.
        warm: a course to begin with in place of parked carriers.
        say: called with the progress where the plan is long.

    Returns:
        The problem as fitted around the best course, and what was found.

    Raises:
        InfeasiblePlanError: no motion keeps every limit, as far as the fit around the last course tells.
    """
    deadline = time.perf_counter() + task.settings.seconds
    say = say if len(grid.t) >= LONG else None
    k = task.dynamics.robot.k
    parked = CarrierCourse(grid.t, np.tile(task.settings.start, (len(grid.t), 1)), *np.zeros((2, len(grid.t), k)))
    first = prepare(task, grid, parked.at_nodes())
    outcomes = []
    for number in range(task.settings.starts):
        if number and time.perf_counter() > deadline:
            break
        course = warm if warm is not None and number == 0 else _course(first, first_guess(first, None, number))
        outcomes.append(_fitted(task, first, course, deadline, say))
    problem, best, _ = min(outcomes, key=lambda outcome: (not outcome[1].optimal, outcome[1].cost))
    return problem, Found(
        best,
        tuple(solution for _, solution, _ in outcomes),
        task.settings.starts,
        tuple(fits for _, _, fits in outcomes),
    )


def _fitted(
    task: Task, first: WholeProblem, course: CarrierCourse, deadline: float, say: Say | None
) -> tuple[WholeProblem, Solution, int]:
    """Fit and solve in turn, and count; the outcome is an optimum only where the true f is balanced."""
    grid, robot = first.grid, robot_record(task.dynamics.robot)
    course = CarrierCourse(grid.t, *_parts(course, grid))
    balance, cost, iterations = np.inf, np.inf, 0
    tau = np.zeros((len(grid.t), first.model.W.shape[2]))
    along = task.dynamics.along(task.source.sample_at(grid.t))
    fits = 0
    while fits < FITS:
        fits += 1
        problem = replace(prepare(task, grid, course.at_nodes()), scales=first.scales)
        u = problem.scales
        guess = {"s": course.s / u.s, "sd": course.sd / u.sd, "sdd": course.sdd / u.sdd, "tau": tau / u.tau}
        left = max(deadline - time.perf_counter(), LEAST_SECONDS)
        solution = solve(problem, guess, left, say)
        iterations += solution.iterations
        if not solution.feasible:
            solution = relax(problem, robot, guess, task.settings.seconds, solution.message, say)
        target, goal = solution.course(problem), solution.tau(problem)
        step = 1.0
        while True:
            trial = CarrierCourse(grid.t, *(a + step * (b - a) for a, b in zip(_of(course), _of(target), strict=True)))
            efforts = tau + step * (goal - tau)
            f = np.asarray(along.reduce(trial.at_nodes()).f)
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
    return problem, solution, fits


def _course(problem: WholeProblem, guess: dict[str, Array]) -> CarrierCourse:
    u, shape = problem.scales, (len(problem.grid.t), problem.model.k)
    parts = ((guess.get(name, np.zeros(shape)) * size) for name, size in (("s", u.s), ("sd", u.sd), ("sdd", u.sdd)))
    return CarrierCourse(problem.grid.t, *parts)


def _of(course: CarrierCourse) -> tuple[Array, Array, Array]:
    return course.s, course.sd, course.sdd


def _parts(course: CarrierCourse, grid: Grid) -> tuple[Array, Array, Array]:
    if len(course.t) == len(grid.t) and bool((course.t == grid.t).all()):
        return _of(course)
    motion = course.at(grid.t)
    return motion.s, motion.sd, motion.sdd
