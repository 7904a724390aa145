"""A problem solved, from one or several first guesses, with rows between the nodes only where they are needed.

Three rows a step and carrier hold track and speed everywhere by the hulls of the Bézier points, and double what the
solver has to factorise, while a handful of steps touches a limit. So the problem is solved with the limits at the
nodes, the exact extremes between the nodes are evaluated, rows are added around the steps that leave the limits, and
it is solved again from the last solution. The carriers' forces become variables only once one exceeds its limit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.planners.optimal.mesh import Grid, widened
from redundancy_pin.planners.optimal.nlp import (
    FALLBACK,
    FIRST,
    LEAST_SECONDS,
    PATIENCE,
    WARM,
    Options,
    Solution,
    solve_nlp,
)
from redundancy_pin.planners.optimal.problem import PathTiming, Problem
from redundancy_pin.planners.optimal.transcription import RESERVE, VARIABLES, scaled_bounds, transcribe

ROUNDS = 4
"""Rounds of adding rows, after which all steps have them."""

CLOSE = -1e-4
"""Minus the distance from a limit, as a fraction of its size, at which steps of a known optimum have rows at once."""

AROUND = 2
"""Steps on both sides of one that leaves a limit that get rows as well: the next solution would leave it there."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A problem, and the final values of the solver."""

    problem: Problem
    solution: Solution

    @property
    def values(self) -> dict[str, Array]:
        """The variables by name, scaled."""
        return self.solution.values


Stop = Callable[[Outcome], bool]
"""Returns whether an optimum with limits at the nodes suffices, for example if other nodes are needed anyway."""


def solve(
    problem: Problem,
    guess: Mapping[str, Array],
    seconds: float,
    stop: Stop | None = None,
    *,
    elastic: Sequence[str] = (),
    most: int | None = None,
    first: Options | None = None,
    warm: Options = WARM,
) -> Solution:
    """Solve a problem with every limit enforced at the nodes and between them.

    ``guess``: first guess, scaled blocks by name; with efforts, an optimum of the same task; ``seconds``: time bound,
    s; ``stop``: ends the rounds in which rows are added;
    ``elastic``: relaxed kinds of limits (``transcribe``); ``most``: bound of the iterations; ``first``: options
    from the first guess, ``FIRST`` or, with efforts, ``warm`` when left out; ``warm``: those from an optimum.

    Returns:
        An optimum that keeps every limit; or where that is not reached, the outcome with ``feasible`` as found.
    """
    deadline = time.perf_counter() + seconds
    between: BoolArray = np.zeros(len(problem.grid.h), dtype=bool)
    if elastic and problem.timing is not None:
        # the least relaxation for a timing is a flat optimum: to find it again with more rows takes as long
        between = np.ones_like(between)
    elif "tau" in guess:
        between = widened(leaves_limits(problem, guess, CLOSE), AROUND)
    limit_force = bool(elastic) or "force" in guess
    # where all limits give way there is a solution, and searches for a timing come closer after 90 iterations
    patience = np.inf if problem.timing is not None or (elastic and most is None) else PATIENCE
    iterations, spent = 0, 0.0
    for added in range(ROUNDS + 2):
        nlp = transcribe(problem, elastic, between=between, limit_force=limit_force)
        begin = warm if added else first or (warm if "tau" in guess else FIRST)
        if most is not None:
            begin = {**begin, "ipopt.max_iter": most - iterations}
        # a bound below the least there is takes long to refute here, and one solution elsewhere (``require_bounds``)
        attempts: list[Solution] = []
        for options in (begin,) if problem.settings.at_most or elastic else (begin, FALLBACK):
            left = max(deadline - time.perf_counter(), LEAST_SECONDS)
            attempt = solve_nlp(nlp, guess, left, options, problem.settings.solver.progress, patience)
            iterations, spent = iterations + attempt.iterations, spent + attempt.seconds
            attempts.append(attempt)
            if attempt.optimal or attempt.infeasible or attempt.stalled or time.perf_counter() > deadline:
                break
            guess = attempt.values if attempt.feasible else guess
        solution = min(attempts, key=preference)
        leaves = leaves_limits(problem, solution.values) & ~between
        beyond = not limit_force and exceeds_force(Outcome(problem, solution))
        if not solution.feasible or not (leaves.any() or beyond):
            break
        # forces beyond their limits at the nodes are no matter of the mesh
        if solution.optimal and not beyond and stop is not None and stop(Outcome(problem, solution)):
            return replace(solution, iterations=iterations, seconds=spent)
        limit_force = limit_force or beyond
        between = between | widened(leaves, AROUND) if added < ROUNDS else np.ones_like(between)
        guess = solution.values
        if most is not None and iterations >= most:
            break
    kept = solution.feasible and not leaves.any() and not beyond
    return replace(solution, optimal=solution.optimal and kept, feasible=kept, iterations=iterations, seconds=spent)


def preference(solution: Solution) -> tuple[bool, bool, float]:
    """Return the sort key of solutions, the best first: first those within limits, then optima, then by cost."""
    return not solution.feasible, not solution.optimal, solution.cost


def leaves_limits(problem: Problem, values: Mapping[str, Array], by: float = 0.0) -> BoolArray:
    """Return (M − 1,) the steps inside which track or speed limits are exceeded, by more than a part of the reserve.

    ``values``: scaled blocks by name; ``by``: by how much more, as a fraction of the sizes of s and ṡ.
    """
    exceeded = np.zeros(len(problem.grid.h), dtype=bool)
    if not problem.model.k:
        return exceeded
    bounds, position = scaled_bounds(problem, values), problem.position(values)
    for kind, function in (("track", position), ("speed", position.derivative())):
        (lower, upper), size = bounds[kind], getattr(problem.scales, VARIABLES[kind])
        width = upper - lower
        spare = by + 0.25 * RESERVE * np.where(np.isfinite(width), width, 0.0)
        least, most = function.ranges()
        exceeded[problem.grid.h > 0.0] |= ((most / size > upper + spare) | (least / size < lower - spare)).any(axis=1)
    return exceeded


def exceeds_force(outcome: Outcome) -> bool:
    """Return whether a carrier needs more force at a node than its limit."""
    problem, values = outcome.problem, outcome.values
    low, high = scaled_bounds(problem, values)["carrier_force"]
    force = problem.carrier_force(values) / problem.scales.force
    return bool(((force > high) | (force < low)).any())


# --- several first guesses ---

_SWINGS = 3
"""Sines of a random first guess."""

REACH = 0.4
"""Largest excursion of a random first guess as a fraction of half the track."""

SAME_COST = 1e-5
"""Relative difference of the costs of two solutions from which they are different optima."""

SAME_MOTION = 0.01
"""Difference of the positions, as a fraction of half the track, from which they are."""


@dataclass(frozen=True, eq=False)
class Multistart:
    """The outcome from each first guess tried, of ``requested`` ones."""

    outcomes: tuple[Outcome, ...]
    requested: int

    @property
    def best(self) -> Outcome:
        """The best optimum; without one, the best solution that keeps the limits."""
        return min(self.outcomes, key=lambda one: preference(one.solution))

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
            "asked": self.requested,
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
    problem: Problem, guess: Mapping[str, Array] | None, deadline: float, stop: Stop | None = None
) -> Multistart:
    """Solve from all first guesses, within the time bound.

    ``guess``: scaled blocks by name to begin with in place of parked carriers; ``deadline``: on the clock of
    ``time.perf_counter``, s; ``stop``: as for ``solve``.
    """
    outcomes: list[Outcome] = []
    for number in range(problem.settings.solver.starts):
        left = deadline - time.perf_counter()
        if outcomes and left <= 0.0:
            break
        first = guess if number == 0 and guess is not None else first_guess(problem, number)
        outcomes.append(Outcome(problem, solve(problem, first, max(left, LEAST_SECONDS), stop)))
    return Multistart(tuple(outcomes), problem.settings.solver.starts)


def first_guess(problem: Problem, number: int = 0) -> dict[str, Array]:
    """Return scaled s, ṡ, s̈: parked carriers, or random swings about the start."""
    grid, u, settings = problem.grid, problem.scales, problem.settings
    s = np.tile(settings.start / u.s, (len(grid.t), 1))
    if number == 0:
        return {"s": s} if problem.timing is None else {"s": s, **_harmonic(problem.timing, grid, settings.lap)}
    rng = np.random.default_rng(number)
    duration = float(grid.t[-1] - grid.t[0])
    frequency = np.pi * np.arange(1, _SWINGS + 1) / duration
    phase = frequency * (grid.t[:, None] - grid.t[0])
    size = rng.uniform(-REACH, REACH, (_SWINGS, problem.model.k)) / _SWINGS
    sd = (frequency * np.cos(phase)) @ size * u.s / u.sd
    sdd = -(frequency**2 * np.sin(phase)) @ size * u.s / u.sdd
    return {"s": s + np.sin(phase) @ size, "sd": np.clip(sd, -0.9, 0.9), "sdd": np.clip(sdd, -0.9, 0.9)}


def _harmonic(timing: PathTiming, grid: Grid, lap: bool) -> dict[str, Array]:
    """Return scaled ṗ, p̈ and durations of a harmonic motion along the path, of half the size of ṗ in a lap."""
    place = (grid.t / grid.t[-1])[:, None]
    if lap:
        pd, pdd, h = np.full_like(place, 0.5), np.zeros_like(place), grid.h / (0.5 * timing.speed) / timing.h
    else:
        pd, pdd, h = np.sqrt(4.0 * place * (1.0 - place)), 1.0 - 2.0 * place, np.where(grid.h > 0.0, 1.0, 0.0)
    return {"pd": pd, "pdd": pdd, "h": h[:, None]}
