"""The problem solved from several first guesses; what is known about the best optimum, or why there is none.

Where carriers carry one another, say, f is no sum of known terms (``carrier_model``). Unless it is an expression it is
fitted anew around each solution. Around a course s̄(t) the backend gives f and its exact derivatives by s, ṡ and s̈;
differences of those give the second ones. That is a polynomial like that of straight tracks with two more terms, and
everything else works on it as it does for those.
The programme is solved, its course is the next to fit around, and so on until the true f balances W τ; near the end the
error squares from fit to fit. Where a step makes the balance worse, the new course is taken only in part: the other
conditions on a course are linear, so that what lies between two that keep them does as well.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.robot_record import RobotRecord, robot_record
from redundancy_pin.planners.whole_trajectory.problem import Task, WholeTrajectoryProblem, read_coefficients
from redundancy_pin.planners.whole_trajectory.solver import LEAST_SECONDS, OUT_OF_TIME, Solution, solve, solve_nlp
from redundancy_pin.planners.whole_trajectory.transcription import (
    KIND_OF,
    KINDS,
    objective_values,
    scaled_bounds,
    slack_name,
    transcribe,
)
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

_SWINGS = 3
"""Sines of a random first guess."""

REACH = 0.4
"""Largest excursion of a random first guess as a fraction of half the track."""

SAME_COST = 1e-5
"""Relative difference of the costs of two solutions from which they are different optima."""

SAME_MOTION = 0.01
"""Difference of the positions, as a fraction of half the track, from which they are."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one first guess led to.

    ``problem``: the numbers that were solved with; ``solution``: the solution; ``fits``: how often f was fitted,
    if it was.
    """

    problem: WholeTrajectoryProblem
    solution: Solution
    fits: int = 0


@dataclass(frozen=True, eq=False)
class Multistart:
    """The outcome from each first guess tried, of ``requested`` ones."""

    outcomes: tuple[Outcome, ...]
    requested: int

    @property
    def best(self) -> Outcome:
        """The best optimum; where there is none, the best of what keeps the limits."""
        return min(
            self.outcomes, key=lambda one: (not one.solution.feasible, not one.solution.optimal, one.solution.cost)
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
    problem: WholeTrajectoryProblem,
    warm: PiecewisePolynomial | None,
    solve_from: Callable[[dict[str, Array], float], Outcome],
) -> Multistart:
    """Solve from all first guesses, as far as the time bound of the settings allows.

    ``problem``: what the guesses are made for; ``warm``: positions of the carriers to begin with in place of parked
    carriers; ``solve_from``: from a first guess, scaled blocks by name, and a time bound, s.
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


def first_guess(problem: WholeTrajectoryProblem, warm: PiecewisePolynomial | None, number: int) -> dict[str, Array]:
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
    size = rng.uniform(-REACH, REACH, (_SWINGS, problem.model.k)) / _SWINGS
    sd = (frequency * np.cos(phase)) @ size * u.s / u.sd
    sdd = -(frequency**2 * np.sin(phase)) @ size * u.s / u.sdd
    return {"s": s + np.sin(phase) @ size, "sd": np.clip(sd, -0.9, 0.9), "sdd": np.clip(sdd, -0.9, 0.9)}


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


def fit_and_solve(task: Task, first: WholeTrajectoryProblem, guess: dict[str, Array], seconds: float) -> Outcome:
    """Fit and solve in turn; the outcome is an optimum only where the true f is balanced.

    ``task``: robot, motion and settings; ``first``: the problem as fitted around parked carriers: its scales are kept;
    ``seconds``: time bound, s.
    """
    deadline = time.perf_counter() + seconds
    grid, u = first.grid, first.scales
    along = task.dynamics.along(task.source.sample_at(grid.t))
    course, tau = first.carriers(guess), np.zeros((len(grid.t), first.model.W.shape[2]))
    balance, cost, iterations, settled = np.inf, np.inf, 0, False
    for fits in range(1, FITS + 1):  # noqa: B007 # how many it took is reported
        problem = replace(read_coefficients(task, grid, course), scales=u, shares=first.shares)
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


NOTHING = 1e-5
"""A relaxation below this fraction of a limit is none: the objective and the reserve leave as much."""

SPARED = 25_000
"""Iterations, times nodes, for finding out whether one limit does by itself: two seconds of the processor."""

TOUCHED = 1e-4
"""Fraction of its range within which a limit counts as reached."""


def relax(problem: WholeTrajectoryProblem, robot: RobotRecord, guess: dict[str, Array], message: str) -> Solution:
    """Find the smallest relaxation of the limits that admits a plan, and return it where it is none.

    First all limits may give way at once, then each of those that did, or that are touched, by itself, as far as
    ``SPARED`` goes: a limit that does by itself is found in as many iterations as the first took, one that does not in
    ten times as many. Efforts come first: where carriers can move at all, they do.

    ``problem``: the numbers; ``robot``: names of carriers and actuators, and which of them rotate; ``guess``: first
    guess; ``message``: how the solver ended on the ordinary problem.

    Raises:
        InfeasiblePlanError: limits have to give way. It carries ``constraint`` (the limit of the smallest relaxation),
            ``time`` and ``carrier`` where it is exceeded most, ``amount`` of that, and ``limit`` that would suffice;
            ``relaxations``, the same for every limit that gave way; ``together``, whether all of these are needed
            or one of them is enough; and ``untried``, limits of which it is not known whether they do by themselves.
            Or nothing admits a plan, or the time ran out.
    """
    problem, settings = replace(problem, shares=None), problem.settings.solver  # what is said is said of whole limits
    deadline = time.perf_counter() + settings.seconds
    elastic = solve_nlp(transcribe(problem, KINDS), guess, settings.seconds, progress=settings.progress)
    if not elastic.feasible:
        raise nothing_helps(problem, elastic, message)
    exceeded = [kind for kind in KINDS if _slack(elastic, kind) > NOTHING]
    if not exceeded:
        return elastic
    # one that is only touched may do as well by itself: with a price on all, others gave way in its place
    touched = [kind for kind in KINDS if kind not in exceeded and is_touched(problem, robot, elastic, kind)]
    candidates = sorted([*exceeded, *touched], key=lambda kind: (exceeded != [kind], kind != "effort"))
    alone: dict[str, Solution] = {}
    untried: list[str] = []
    left = max(elastic.iterations, SPARED // len(problem.grid.t))
    for kind in candidates if len(candidates) > 1 else ():
        seconds = deadline - time.perf_counter()
        if left <= 0 or seconds <= 0.0:
            untried.append(kind)
            continue
        programme, most = transcribe(problem, (kind,)), {"ipopt.max_iter": left}
        solution = solve_nlp(programme, elastic.values, seconds, most, settings.progress)
        left -= solution.iterations
        if solution.optimal:
            alone[kind] = solution
        elif not solution.infeasible:
            untried.append(kind)
    relaxed = alone or dict.fromkeys(exceeded, elastic)
    order = sorted(relaxed, key=lambda kind: _slack(relaxed[kind], kind))
    events = [elastic_event(problem, robot, relaxed[kind], kind) for kind in order]
    text = ("; or " if alone else "; and ").join(str(event.pop("text")) for event in events)
    rest = f" Not tried to the end: {', '.join(untried)} alone." if untried else ""
    raise InfeasiblePlanError(
        f"No motion of the carriers keeps every limit. What would suffice: {text}.{rest}",
        remedy=_REMEDY,
        relaxations=tuple(events),
        together=not alone and len(exceeded) > 1,
        untried=tuple(untried),
        **events[0],
    )


_REMEDY = "Widen these limits, slow the motion down, or leave the end free."


def require_bounds(problem: WholeTrajectoryProblem, guess: dict[str, Array]) -> None:
    """Check that each bound of ``at_most`` is not below the least that there is of it within the limits.

    That takes a solution for each, and no search for a way to keep them all: it is a tenth of the time.

    Raises:
        InfeasiblePlanError: one is, as ``relax``.
    """
    settings, events = problem.settings, []
    for name, bound in settings.at_most.items():
        least = replace(problem, settings=replace(settings, objective={name: 1.0}, at_most={}))
        solution = solve(least, guess, settings.solver.seconds)
        fraction = objective_values(least, solution.values)[name] / bound - 1.0
        if solution.optimal and fraction > NOTHING:
            events.append(_bound_event(problem, name, fraction))
    if events:
        text = "; and ".join(str(event.pop("text")) for event in events)
        known = "What would suffice" if len(settings.at_most) == 1 else "What is needed at least"
        raise InfeasiblePlanError(
            f"No motion of the carriers keeps every limit. {known}: {text}. Not tried: wider limits.",
            remedy=_REMEDY,
            relaxations=tuple(events),
            together=len(events) > 1,
            untried=tuple(kind for kind in KINDS if kind != "at_most"),
            **events[0],
        )


def _bound_event(problem: WholeTrajectoryProblem, name: str, fraction: float) -> dict[str, object]:
    """Return by how much a bound of ``at_most`` has to be wider."""
    bound = problem.settings.at_most[name]
    text = f"{name} at most, from {bound:.6g} to {bound * (1.0 + fraction):.6g} ({100.0 * fraction:.3g} %)"
    numbers = {"amount": bound * fraction, "limit": bound * (1.0 + fraction), "fraction": fraction}
    return {"constraint": "at_most", "objective": name, "time": float(problem.grid.t[0]), **numbers, "text": text}


def _slack(solution: Solution, kind: str) -> float:
    return float(solution.values[slack_name(kind)][0, 0])


def is_touched(problem: WholeTrajectoryProblem, robot: RobotRecord, elastic: Solution, kind: str) -> bool:
    """Return whether a limit is reached somewhere."""
    if kind == "at_most":
        return bool(problem.settings.at_most)
    if kind == "end" or (kind == "force" and "force" not in elastic.values):
        return False
    values, low, high, _ = _quantity(problem, robot, elastic, kind)
    with np.errstate(invalid="ignore"):
        near = TOUCHED * np.where(np.isfinite(high - low), high - low, 0.0)
    return bool(((values >= high - near) | (values <= low + near)).any())


def nothing_helps(problem: WholeTrajectoryProblem, elastic: Solution, message: str) -> InfeasiblePlanError:
    """Return the error of a problem that wider limits do not make feasible."""
    if elastic.message == OUT_OF_TIME:
        constraint = "seconds"
        text = "The time ran out before any plan was found, and before any limit was shown to be in the way."
        remedy = "Allow more seconds, or a longer dt."
    else:
        constraint = "balance"
        ends = f"the solver says {message}, then {elastic.message}; unbalanced by {elastic.violation:.2g} of f"
        text = f"No plan was found, nor one with relaxed limits ({ends})."
        remedy = "The actuators and carriers cannot balance this motion at all: lead the platform elsewhere."
    amount, start = elastic.violation, float(problem.grid.t[0])
    return InfeasiblePlanError(text, remedy=remedy, constraint=constraint, time=start, amount=amount)


def elastic_event(
    problem: WholeTrajectoryProblem, robot: RobotRecord, elastic: Solution, kind: str
) -> dict[str, object]:
    """Return what is exceeded most, where, and what would suffice."""
    fraction = _slack(elastic, kind)
    t = problem.grid.t
    if kind == "at_most":
        costs = objective_values(problem, elastic.values)
        name, _ = max(problem.settings.at_most.items(), key=lambda one: costs[one[0]] / one[1])
        return _bound_event(problem, name, fraction)
    if kind == "end":
        missed = np.abs(elastic.values["s"][-1] - problem.settings.datum / problem.scales.s) * problem.scales.s
        if problem.settings.end == "datum":
            text = f"the carriers end up to {missed.max():.4g} m from the datum"
        else:
            text = f"the end state by {fraction:.3g} of its size"
        return {"constraint": kind, "time": float(t[-1]), "amount": float(missed.max()), "text": text}
    values, low, high, names = _quantity(problem, robot, elastic, kind)
    excess = np.maximum(values - high, low - values)
    i, j = np.unravel_index(int(np.argmax(np.where(np.isfinite(excess), excess, -np.inf))), excess.shape)
    upper = bool(values[i, j] - high[j] >= low[j] - values[i, j])
    limit, amount, unit = float((high if upper else low)[j]), float(excess[i, j]), robot.limit_unit(kind, names[j])
    enough = limit + (amount if upper else -amount)
    if kind != "track" and low[j] == -high[j]:
        # a limit of the size, as users write it; the ends of a track are places
        limit, enough = abs(limit), abs(enough)
    percent = f"{100.0 * fraction:.3g}" if fraction < 1.0 else f"{100.0 * fraction:.0f}"
    text = f"the {kind} of {names[j]}, from {limit:.6g} to {enough:.6g} {unit} ({percent} %), most at t = {t[i]:.6g} s"
    return {
        "constraint": kind,
        "carrier": names[j],
        "time": float(t[i]),
        "amount": amount,
        "limit": enough,
        "unit": unit,
        "fraction": fraction,
        "text": text,
    }


def _quantity(
    problem: WholeTrajectoryProblem, robot: RobotRecord, elastic: Solution, kind: str
) -> tuple[Array, Array, Array, tuple[str, ...]]:
    """Return the values of a limited quantity at the nodes, its bounds, and whose they are."""
    u = problem.scales
    if kind == "jerk":
        h = np.where(problem.grid.h > 0.0, problem.grid.h, np.inf)[:, None]
        jerk = np.diff(elastic.values["sdd"], axis=0) * u.sdd / h
        return jerk, -problem.settings.limits.jerk, problem.settings.limits.jerk, robot.carriers
    name = next(name for name, limit in KIND_OF.items() if limit == kind)
    size = np.broadcast_to(getattr(u, name), elastic.values[name].shape[1:])
    low, high = (bound * size for bound in scaled_bounds(problem)[name])
    return elastic.values[name] * size, low, high, robot.actuated if kind == "effort" else robot.carriers
