"""Finding the optimum: first guesses, time bound, and what to say where there is none."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.robot_record import RobotRecord
from redundancy_pin.planners.whole_trajectory_between import solve
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_elastic import OUT_OF_TIME, relax
from redundancy_pin.planners.whole_trajectory_motion import CarrierCourse
from redundancy_pin.planners.whole_trajectory_progress import LONG, Say
from redundancy_pin.planners.whole_trajectory_solver import LEAST_SECONDS, Solution

_SWINGS = 3
"""Sines of a random first guess."""

_REACH = 0.4
"""Largest excursion of a random first guess as a fraction of half the track."""


SAME_COST = 1e-5
"""Relative difference of the costs of two solutions from which they are different optima."""

SAME_MOTION = 0.01
"""Difference of the positions, as a fraction of half the track, from which they are."""


@dataclass(frozen=True, eq=False)
class Found:
    """The best solution and all that were found.

    Attributes:
        best: the best one.
        solutions: the outcome from each first guess.
        asked: number of first guesses asked for.
        fits: how often f was fitted from each guess, for carriers on curved tracks.
    """

    best: Solution
    solutions: tuple[Solution, ...]
    asked: int
    fits: tuple[int, ...] = ()

    @property
    def summary(self) -> dict[str, object]:
        """What is known about the optimum being the best: see ``plan_whole_trajectory``."""
        optima: list[list[int]] = []
        for number, solution in enumerate(self.solutions):
            if solution.optimal:
                for group in optima:
                    if _same(self.solutions[group[0]], solution):
                        group.append(number)
                        break
                else:
                    optima.append([number])
        optima.sort(key=lambda group: min(self.solutions[i].cost for i in group))
        return {
            "asked": self.asked,
            "tried": len(self.solutions),
            "converged": sum(len(group) for group in optima),
            "won": next(i for i, solution in enumerate(self.solutions) if solution is self.best),
            "optima": [{"cost": min(self.solutions[i].cost for i in group), "starts": group} for group in optima],
            "costs": [found.cost if found.feasible else float("nan") for found in self.solutions],
            "messages": [found.message for found in self.solutions],
        }


def _same(one: Solution, other: Solution) -> bool:
    size = max(abs(one.cost), abs(other.cost))
    apart = float(np.abs(one.values["s"] - other.values["s"]).max())
    return abs(one.cost - other.cost) <= SAME_COST * size and apart <= SAME_MOTION


def search(
    problem: WholeProblem, robot: RobotRecord, warm: CarrierCourse | None, seconds: float, say: Say | None = None
) -> Found:
    """Solve a problem from all first guesses within a time bound.

    Args:
        problem: the numbers.
        robot: names and kinds of its joints, for messages.
        warm: a motion to begin with in place of parked carriers.
        seconds: time bound over all, s. The search for an explanation of a failure has as much again.
        say: called with the progress where the plan is long.

    Raises:
        InfeasiblePlanError: no motion keeps every limit, or none was found in time; says which limit is in the way,
            where, and how much would suffice.
    """
    deadline = time.perf_counter() + seconds
    say = say if len(problem.grid.t) >= LONG else None
    solutions: list[Solution] = []
    for number in range(problem.settings.starts):
        left = deadline - time.perf_counter()
        if solutions and left <= 0.0:
            break
        guess = first_guess(problem, warm if number == 0 else None, number)
        solutions.append(solve(problem, guess, max(left, LEAST_SECONDS), say))
    usable = [solution for solution in solutions if solution.feasible]
    if not usable:
        elastic = relax(problem, robot, first_guess(problem, warm, 0), seconds, solutions[0].message, say)
        solution = solve(problem, elastic.values, seconds, say)
        if not solution.feasible:
            late = solution.message == OUT_OF_TIME
            raise InfeasiblePlanError(
                f"No plan was found{f' within {seconds:g} s' if late else ''} (the solver says {solution.message}), "
                "although none of the limits is known to be in the way.",
                remedy="Allow more seconds, or a longer dt."
                if late
                else "Widen the limits a little, or start elsewhere.",
                constraint="seconds",
                time=float(problem.grid.t[0]),
                amount=seconds,
            )
        solutions.append(solution)
        usable = [solution]
    best = min(usable, key=lambda found: (not found.optimal, found.cost))
    return Found(best, tuple(solutions), problem.settings.starts)


def first_guess(problem: WholeProblem, warm: CarrierCourse | None, number: int) -> dict[str, Array]:
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
