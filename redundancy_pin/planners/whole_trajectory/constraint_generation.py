"""Constraint generation: limits between the nodes, and those of force, get rows only where a solution needs them.

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
from redundancy_pin.planners.whole_trajectory.coefficients import Problem
from redundancy_pin.planners.whole_trajectory.mesh import widened
from redundancy_pin.planners.whole_trajectory.solver import (
    LEAST_SECONDS,
    Options,
    Solution,
    solve_nlp,
    strategies,
)
from redundancy_pin.planners.whole_trajectory.transcription import NLP, RESERVE, scaled_bounds, transcribe

ROUNDS = 4
"""Rounds of adding rows, after which all are."""

AROUND = 2
"""Steps on both sides of one that leaves a limit that get rows as well: the next solution would leave it there."""


def solve(problem: Problem, guess: dict[str, Array], seconds: float) -> Solution:
    """Solve a problem with every limit held at the nodes and between them.

    Args:
        problem: the numbers.
        guess: first guess, scaled blocks by name.
        seconds: time bound, s.

    Returns:
        An optimum that keeps every limit; or where that is not reached, the outcome with all rows from the start.
    """
    deadline = time.perf_counter() + seconds
    attempts = [_with_needed_rows(problem, guess, deadline)]
    # the other strategy often ends where the first one crawls
    for options in () if attempts[0].optimal else strategies(problem).later:
        left = deadline - time.perf_counter()
        if attempts[-1].optimal or attempts[-1].infeasible or left <= 0.0:
            break
        start = guess if len(attempts) == 1 else attempts[-1].values
        attempts.append(solve_nlp(transcribe(problem), start, left, options, problem.settings.solver.progress))
    best = min(attempts, key=lambda solution: (not solution.optimal, not solution.feasible))
    return _with_totals(best, attempts)


def _with_needed_rows(problem: Problem, guess: dict[str, Array], deadline: float) -> Solution:
    """Solve with rows only where they are needed; the outcome is feasible only where limits hold in between, too."""
    attempts: list[Solution] = []

    def attempt(nlp: NLP, options: Options, start: dict[str, Array] | Solution) -> Solution:
        left = max(deadline - time.perf_counter(), LEAST_SECONDS)
        attempts.append(solve_nlp(nlp, start, left, options, problem.settings.solver.progress))
        return attempts[-1]

    strategy = strategies(problem)
    groups: list[BoolArray] = []
    limit_force = False
    start: dict[str, Array] | Solution = guess
    while True:
        nlp = transcribe(problem, between=groups, limit_force=limit_force)
        for options in (strategy.more_rows,) if isinstance(start, Solution) else strategy.first:
            solution = attempt(nlp, options, start)
            if solution.optimal or time.perf_counter() > deadline:
                break
        if solution.acceptable:
            solution = attempt(nlp, strategy.refined, solution)
        if not solution.optimal:
            kept = not _leaves_limits(problem, solution).any() and not _exceeds_force(problem, solution)
            return _with_totals(replace(solution, feasible=solution.feasible and kept), attempts)
        if not limit_force and _exceeds_force(problem, solution):
            # more variables, so that the multipliers are of no use
            limit_force, start = True, solution.values
            continue
        leaves = _leaves_limits(problem, solution)
        if not leaves.any() and strategy.last_steps is not None:
            exact = attempt(nlp, strategy.last_steps, solution)
            if not (exact.optimal or exact.acceptable):
                return _with_totals(solution, attempts)
            # the barrier parameter stays, so that the solver cannot call it more than acceptable
            solution = replace(exact, optimal=True, message=solution.message)
            leaves = _leaves_limits(problem, solution)
        if not leaves.any():
            return _with_totals(solution, attempts)
        new = widened(leaves, AROUND) & ~np.any([np.zeros_like(leaves), *groups], axis=0)
        if len(groups) == ROUNDS or not new.any():
            return _with_totals(replace(solution, optimal=False, feasible=False), attempts)
        groups.append(new)
        start = solution


def _leaves_limits(problem: Problem, solution: Solution) -> BoolArray:
    """Return (M − 1,) the steps inside which track or speed limits are exceeded, by more than a part of the reserve."""
    position, bounds = solution.position(problem), scaled_bounds(problem)
    exceeded = np.zeros(len(problem.grid.h), dtype=bool)
    for name, function in (("s", position), ("sd", position.derivative())):
        (lower, upper), size = bounds[name], getattr(problem.scales, name)
        width = upper - lower
        spare = 0.25 * RESERVE * np.where(np.isfinite(width), width, 0.0)
        least, most = function.ranges()
        exceeded[problem.grid.h > 0.0] |= ((most / size > upper + spare) | (least / size < lower - spare)).any(axis=1)
    return exceeded


def _exceeds_force(problem: Problem, solution: Solution) -> bool:
    """Return whether a carrier needs more force at a node than its limit."""
    carriers, (low, high) = problem.carriers(solution.values), scaled_bounds(problem)["force"]
    force = problem.model.carrier_force(carriers.s, carriers.sd, carriers.sdd) / problem.scales.force
    return bool(((force > high) | (force < low)).any())


def _with_totals(chosen: Solution, attempts: list[Solution]) -> Solution:
    """Return a solution with the iterations and the time of all attempts."""
    iterations, seconds = (sum(getattr(attempt, name) for attempt in attempts) for name in ("iterations", "seconds"))
    return replace(chosen, iterations=int(iterations), seconds=float(seconds))
