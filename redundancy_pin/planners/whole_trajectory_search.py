"""Finding the optimum: first guesses, time bound, and what to say where there is none."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_elastic import relax
from redundancy_pin.planners.whole_trajectory_motion import CarrierCourse
from redundancy_pin.planners.whole_trajectory_nlp import build
from redundancy_pin.planners.whole_trajectory_solver import LEAST_SECONDS, Solution, Solver

_SWINGS = 3
"""Sines of a random first guess."""

_REACH = 0.4
"""Largest excursion of a random first guess as a fraction of half the track."""


@dataclass(frozen=True, eq=False)
class Found:
    """The best solution and all that were found.

    Attributes:
        best: the best one.
        costs: scaled objective from each first guess; NaN where none was reached.
        messages: how the solver ended from each.
    """

    best: Solution
    costs: tuple[float, ...]
    messages: tuple[str, ...]


def search(problem: WholeProblem, carriers: tuple[str, ...], warm: CarrierCourse | None, seconds: float) -> Found:
    """Solve a problem from all first guesses within a time bound.

    Args:
        problem: the numbers.
        carriers: (k,) names, for messages.
        warm: a motion to begin with in place of parked carriers.
        seconds: time bound over all, s. The search for an explanation of a failure has as much again.

    Raises:
        InfeasiblePlanError: no motion keeps every limit, or none was found in time; says which limit is in the way,
            where, and how much would suffice.
    """
    deadline = time.perf_counter() + seconds
    program = build(problem)
    solutions: list[Solution] = []
    for number in range(problem.settings.starts):
        left = deadline - time.perf_counter()
        if solutions and left <= 0.0:
            break
        guess = _guess(problem, warm if number == 0 else None, number)
        solution = Solver(program, max(left, LEAST_SECONDS)).solve(guess)
        left = deadline - time.perf_counter()
        if (
            not (solution.optimal or solution.infeasible) and left > 0.0
        ):  # the other strategy often ends where this one crawls
            again = Solver(program, left, {"ipopt.mu_strategy": "adaptive"}).solve(solution.values)
            solution = again if again.optimal or (again.feasible and not solution.feasible) else solution
        solutions.append(solution)
    usable = [solution for solution in solutions if solution.feasible]
    if not usable:
        elastic = relax(problem, carriers, _guess(problem, warm, 0), seconds, solutions[0].message)
        solution = Solver(program, seconds).solve(elastic.values)
        if not solution.feasible:
            raise InfeasiblePlanError(
                f"No plan was found within {seconds:g} s (the solver says {solution.message}), although none of the "
                "limits is known to be in the way.",
                remedy="Allow more seconds, or a shorter dt.",
                constraint="seconds",
                time=float(problem.grid.t[0]),
                amount=seconds,
            )
        solutions.append(solution)
        usable = [solution]
    best = min(usable, key=lambda found: (not found.optimal, found.cost))
    costs = tuple(found.cost if found.feasible else float("nan") for found in solutions)
    return Found(best, costs, tuple(found.message for found in solutions))


def _guess(problem: WholeProblem, warm: CarrierCourse | None, number: int) -> dict[str, Array]:
    """Return scaled s, ṡ, s̈: a motion that is known, parked carriers, or random swings about the start."""
    grid, u, settings = problem.grid, problem.scales, problem.settings
    if warm is not None:
        motion = warm.at(grid.t)
        return {"s": motion.s / u.s, "sd": motion.sd / u.sd, "sdd": motion.sdd / u.sdd}
    s = np.tile(settings.start / u.s, (len(grid.t), 1))
    if number == 0:
        return {"s": s}
    rng = np.random.default_rng(number)
    duration = float(grid.t[-1] - grid.t[0])
    frequency = np.pi * np.arange(1, _SWINGS + 1) / duration
    phase = frequency * (grid.t[:, None] - grid.t[0])
    size = rng.uniform(-_REACH, _REACH, (_SWINGS, problem.model.k)) / _SWINGS
    sd = (frequency * np.cos(phase)) @ size * u.s / u.sd
    sdd = -(frequency**2 * np.sin(phase)) @ size * u.s / u.sdd
    return {"s": s + np.sin(phase) @ size, "sd": np.clip(sd, -0.9, 0.9), "sdd": np.clip(sdd, -0.9, 0.9)}
