"""Multistart: the problem solved from several first guesses, and what is known about the best optimum."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.planners.whole_trajectory.coefficients import Problem
from redundancy_pin.planners.whole_trajectory.solver import LEAST_SECONDS, Solution
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

_SWINGS = 3
"""Sines of a random first guess."""

_REACH = 0.4
"""Largest excursion of a random first guess as a fraction of half the track."""

SAME_COST = 1e-5
"""Relative difference of the costs of two solutions from which they are different optima."""

SAME_MOTION = 0.01
"""Difference of the positions, as a fraction of half the track, from which they are."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one first guess led to.

    Attributes:
        problem: the numbers that were solved with.
        solution: the solution.
        fits: how often f was fitted, for carriers on curved tracks.
    """

    problem: Problem
    solution: Solution
    fits: int = 0


@dataclass(frozen=True, eq=False)
class Multistart:
    """The outcome from each first guess tried, of ``asked`` ones."""

    outcomes: tuple[Outcome, ...]
    asked: int

    @property
    def best(self) -> Outcome:
        """The best optimum; where there is none, the best of what keeps the limits."""
        return min(
            self.outcomes,
            key=lambda one: (not one.solution.feasible, not one.solution.optimal, one.solution.cost),
        )

    @property
    def feasible(self) -> bool:
        """Whether any solution keeps every constraint."""
        return any(outcome.solution.feasible for outcome in self.outcomes)

    @property
    def summary(self) -> dict[str, object]:
        """What is known about the optimum being the best: see ``plan_whole_trajectory``."""
        solutions = [outcome.solution for outcome in self.outcomes]
        optima: list[list[int]] = []
        for number, solution in enumerate(solutions):
            if solution.optimal:
                same = next((group for group in optima if _is_same(solutions[group[0]], solution)), None)
                optima += [] if same else [[]]
                (same or optima[-1]).append(number)
        optima.sort(key=lambda group: min(solutions[i].cost for i in group))
        return {
            "asked": self.asked,
            "tried": len(solutions),
            "converged": sum(len(group) for group in optima),
            "won": self.outcomes.index(self.best),
            "optima": [{"cost": min(solutions[i].cost for i in group), "starts": group} for group in optima],
            "costs": [solution.cost if solution.feasible else float("nan") for solution in solutions],
            "messages": [solution.message for solution in solutions],
        }


def _is_same(one: Solution, other: Solution) -> bool:
    size = max(abs(one.cost), abs(other.cost))
    apart = float(np.abs(one.values["s"] - other.values["s"]).max())
    return abs(one.cost - other.cost) <= SAME_COST * size and apart <= SAME_MOTION


def multistart(
    problem: Problem, warm: PiecewisePolynomial | None, solve_from: Callable[[dict[str, Array], float], Outcome]
) -> Multistart:
    """Solve from all first guesses, as far as the time bound of the settings allows.

    Args:
        problem: what the guesses are made for.
        warm: positions of the carriers to begin with in place of parked carriers.
        solve_from: from a first guess, scaled blocks by name, and a time bound, s.
    """
    solver = problem.settings.solver
    deadline = time.perf_counter() + solver.seconds
    outcomes: list[Outcome] = []
    for number in range(solver.starts):
        left = deadline - time.perf_counter()
        if outcomes and left <= 0.0:
            break
        guess = first_guess(problem, warm if number == 0 else None, number)
        outcomes.append(solve_from(guess, max(left, LEAST_SECONDS)))
    return Multistart(tuple(outcomes), solver.starts)


def first_guess(problem: Problem, warm: PiecewisePolynomial | None, number: int) -> dict[str, Array]:
    """Return scaled s, ṡ, s̈: a motion that is known, parked carriers, or random swings about the start."""
    grid, u, settings = problem.grid, problem.scales, problem.settings
    if warm is not None:
        return problem.scaled(carriers_at(warm, grid.t))
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
