"""Track and speed limits between the nodes, and those of force: rows only where a solution needs them.

Three rows a step and carrier hold track and speed everywhere by the hulls of the Bézier points, and double what the
solver has to factorise, while a handful of steps touches a limit. So the problem is solved with the limits at the
nodes, the exact extremes between the nodes are looked at, rows are added around the steps that leave the limits, and
it is solved again from where it was. The carriers' forces become variables only once one exceeds its limit.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.planners.whole_trajectory.mesh import CarrierCourse
from redundancy_pin.planners.whole_trajectory.problem import WholeProblem
from redundancy_pin.planners.whole_trajectory.program import Program
from redundancy_pin.planners.whole_trajectory.solver import (
    LEAST_SECONDS,
    Options,
    Say,
    Solution,
    Solver,
    first_attempts,
    is_flat,
    last_steps,
    later_attempts,
    refined,
    with_more_rows,
)
from redundancy_pin.planners.whole_trajectory.transcription import RESERVE, build, scaled_bounds

ROUNDS = 4
"""Rounds of adding rows, after which all are."""

AROUND = 2
"""Steps on both sides of one that leaves a limit that get rows as well: the next solution would leave it there."""


def leaving(problem: WholeProblem, course: CarrierCourse) -> BoolArray:
    """Return (M − 1,) the steps inside which track or speed limits are exceeded, by more than a part of the reserve."""
    u, bounds = problem.scales, scaled_bounds(problem)
    s_low, s_high, sd_low, sd_high = course.ranges()
    exceeded = np.zeros(len(problem.grid.h), dtype=bool)
    for name, low, high, size in (("s", s_low, s_high, u.s), ("sd", sd_low, sd_high, u.sd)):
        lower, upper = bounds[name]
        width = upper - lower
        spare = 0.25 * RESERVE * np.where(np.isfinite(width), width, 0.0)
        exceeded |= ((high / size > upper + spare) | (low / size < lower - spare)).any(axis=1)
    return exceeded


def solve(problem: WholeProblem, guess: dict[str, Array], seconds: float, say: Say | None = None) -> Solution:
    """Solve a problem with every limit held at the nodes and between them.

    Args:
        problem: the numbers.
        guess: first guess, scaled blocks by name.
        seconds: time bound, s.
        say: called with the progress of long plans.

    Returns:
        An optimum that keeps every limit; or where that is not reached, the outcome with all rows from the start.
    """
    deadline = time.perf_counter() + seconds
    first = _by_rows_needed(problem, guess, deadline, say)
    if first.optimal:
        return first
    attempts = [first]
    values = guess
    # the other strategy often ends where the first one crawls
    for options in later_attempts(problem):
        left = deadline - time.perf_counter()
        if attempts[-1].infeasible or left <= 0.0:
            break
        attempts.append(Solver(build(problem), left, options, say).solve(values))
        values = attempts[-1].values
        if attempts[-1].optimal:
            break
    best = min(attempts, key=lambda found: (not found.optimal, not found.feasible))
    return _summed(best, attempts)


def _by_rows_needed(problem: WholeProblem, guess: dict[str, Array], deadline: float, say: Say | None) -> Solution:
    """Solve with rows only where they are needed; the outcome is feasible only where limits hold in between, too."""
    groups: list[BoolArray] = []
    covered = np.zeros(len(problem.grid.h), dtype=bool)
    found: list[Solution] = []
    limit_force, warm, finished = False, False, not is_flat(problem)

    def attempt(program: Program, options: Options, start: dict[str, Array] | Solution) -> None:
        left = max(deadline - time.perf_counter(), LEAST_SECONDS)
        found.append(Solver(program, left, options, say).solve(start))

    while True:
        program = build(problem, between=groups, limit_force=limit_force)
        if warm:
            attempt(program, with_more_rows(problem), found[-1])
        else:
            for options in first_attempts(problem):
                attempt(program, options, guess)
                if found[-1].optimal or time.perf_counter() > deadline:
                    break
        if not found[-1].optimal and found[-1].acceptable:
            attempt(program, refined(problem), found[-1])
        if not found[-1].optimal:
            kept = not leaving(problem, found[-1].course(problem)).any() and not _too_strong(problem, found[-1])
            return _summed(replace(found[-1], feasible=found[-1].feasible and kept), found)
        if not limit_force and _too_strong(problem, found[-1]):
            limit_force, warm, guess = True, False, found[-1].values
            continue
        leaves = leaving(problem, found[-1].course(problem))
        if not leaves.any() and not finished:
            finished = True
            near = found[-1]
            attempt(program, last_steps(problem), near)
            if not (found[-1].optimal or found[-1].acceptable):
                return _summed(near, found)
            found[-1] = replace(found[-1], optimal=True, message=near.message)
            leaves = leaving(problem, found[-1].course(problem))
        if not leaves.any():
            return _summed(found[-1], found)
        new = _wider(leaves) & ~covered
        if len(groups) == ROUNDS or not new.any():
            return _summed(replace(found[-1], optimal=False, feasible=False), found)
        groups.append(new)
        covered |= new
        warm, finished = True, not is_flat(problem)


def _too_strong(problem: WholeProblem, solution: Solution) -> bool:
    """Return whether a carrier needs more force at a node than its limit."""
    course, (low, high) = solution.course(problem), scaled_bounds(problem)["force"]
    force = problem.model.carrier_force(course.s, course.sd, course.sdd) / problem.scales.force
    return bool(((force > high) | (force < low)).any())


def _summed(chosen: Solution, attempts: list[Solution]) -> Solution:
    iterations, seconds = (sum(getattr(found, name) for found in attempts) for name in ("iterations", "seconds"))
    return replace(chosen, iterations=int(iterations), seconds=float(seconds))


def _wider(steps: BoolArray) -> BoolArray:
    at = np.flatnonzero(steps)[:, None] + np.arange(-AROUND, AROUND + 1)
    found = np.zeros(len(steps), dtype=bool)
    found[np.clip(at, 0, len(steps) - 1)] = True
    return found
