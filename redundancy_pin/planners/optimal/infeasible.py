"""Explain infeasibility: find the smallest relaxation of the limits that admits a plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.limits import QUANTITIES
from redundancy_pin.planners.optimal.mesh import Grid
from redundancy_pin.planners.optimal.nlp import ON_FINER_NODES, OUT_OF_TIME, RELAXED, RELAXED_AGAIN, Options, Solution
from redundancy_pin.planners.optimal.problem import Problem
from redundancy_pin.planners.optimal.solve import Outcome, solve
from redundancy_pin.planners.optimal.transcription import (
    KINDS,
    VARIABLES,
    Evaluation,
    half_range,
    objective_values,
    scaled_bounds,
    slack_name,
)
from redundancy_pin.planners.robot_record import RobotRecord

NOTHING = 1e-5
"""Relaxation, as a fraction of a limit, below which it counts as zero: objective and reserve leave as much."""

NOISE = 1e-4
"""Relaxations below this fraction of larger ones are residues of the barrier of a rough solution: at most 2e-5."""

SPARED = 15_000
"""Iterations, times nodes, for finding out whether one limit does by itself: a second of the processor."""

AGAIN = 2
"""The same in iterations of the first programme: rows between the nodes, which that has not, take a second solution."""

ITERATIONS_OF_TIMING = 500
"""Most iterations for the least relaxation that admits a timing: efforts alone take 30 to 230, with forces 300."""

FINAL = 150
"""Most iterations for the least relaxation at all nodes, from that at a few: they are 10 to 80."""

SAME = 1e-3
"""Relative difference of two relaxations on meshes of which the finer one shows nothing new."""

ENOUGH = 150
"""Number of nodes, in addition to those at events, that suffices to find the conflicting limits."""

TOUCHED = 2e-3
"""Fraction of its range within which a limit counts as reached: the barrier of a rough solution keeps off by 2e-4."""

COARSE = 1.2
"""Largest effort between the nodes over its relaxed limit up to which a few per cent more than that suffices.

On a circle of the 2-RPR 2 % more was needed where it was 1.07, and 13 to 17 % where it was 1.7.
"""


@dataclass(frozen=True, eq=False)
class Relaxation:
    """From where, and of which limits, the smallest relaxation is sought.

    ``guess``: first guess, scaled blocks by name; ``kinds``: limits that may give way, all when left out; ``finer``:
    returns the problem on a finer mesh where the nodes do not show the efforts of a relaxed motion, otherwise None;
    ``peaks``: largest efforts (m,) of a relaxed motion, between its nodes too, N or N·m.
    """

    guess: Mapping[str, Array]
    kinds: Sequence[str] = KINDS
    finer: Callable[[Outcome], Problem | None] = lambda _: None
    peaks: Callable[[Outcome], Array] | None = None


def relax(problem: Problem, robot: RobotRecord, sought: Relaxation, message: str, deadline: float) -> Outcome:
    """Find the smallest relaxation of the limits that admits a plan; if none is needed, return the solution.

    First all limits may give way at once, at a few of the nodes (``coarser``). Then each of those that did, or that are
    touched, may by itself, within ``SPARED`` and ``AGAIN``: a limit that does by itself is found in one or two
    times the iterations of the first, one that does not in ten times as many. Efforts come first: where carriers can
    move at all, they do. What is named is then relaxed once more, exactly, at all nodes and between them.

    ``problem``: the numbers; ``robot``: names of carriers and actuators, and which of them rotate; ``sought``: from
    where; ``message``: how the solver ended on the ordinary problem; ``deadline``: as for ``multistart``, s.

    Raises:
        InfeasiblePlanError: limits have to give way. It carries ``constraint`` (the limit of the smallest relaxation),
            ``time`` (along a path, of a slow motion) and ``joint`` of the largest excess, ``amount`` of it,
            and ``limit`` that would suffice;
            ``relaxations``, the same for every limit that gave way; ``together``, whether all of these are needed
            or one of them is enough; and ``untried``, limits of which it is not known whether they do by themselves.
            Or nothing admits a plan, or the time ran out.
    """
    problem = replace(problem, shares=None)  # messages state the limits themselves
    limited = (*sought.kinds, *problem.settings.limits.further)
    search = _Search(problem, robot, tuple(kind for kind in limited if _is_limited(problem, kind)), deadline)
    least = search.together(sought)
    problem = problem if problem.timing is None else least.problem
    if not least.solution.feasible:
        raise nothing_helps(least, message)
    exceeded = _exceeded(least.solution)
    if not exceeded:
        return least
    alone = search.alone(least, exceeded)
    relaxed: dict[str, Outcome] = {}
    for kinds, found in (alone or {tuple(exceeded): least}).items():
        exact = found if problem.timing is not None else search.exactly(problem, found, kinds)
        if exact.problem is problem and exact.solution.optimal and not _exceeded(exact.solution):
            return exact  # with a price on several limits the solver ended elsewhere
        needed = [kind for kind in kinds if slack(exact.solution, kind) > NOTHING] or kinds
        relaxed |= dict.fromkeys(needed, exact)
    order = sorted(relaxed, key=lambda kind: slack(relaxed[kind].solution, kind))
    events = [elastic_event(relaxed[kind], robot, kind) for kind in order]
    text = ("; or " if alone else "; and ").join(str(event.pop("text")) for event in events)
    untried, in_vain = ([name_of(kind) for kind in kinds] for kinds in (search.untried, search.in_vain))
    rest = f" Not tried to the end: {', '.join(untried)} alone." if untried else ""
    rest += f" Tried without finding a motion, which proves nothing: {', '.join(in_vain)} alone." if in_vain else ""
    ratio = _hidden_share(problem, sought, relaxed)
    if problem.timing is None and any(found.problem is not problem for found in relaxed.values()):
        rest += " The numbers are of a coarser mesh: all nodes may need a little more."
    elif ratio > COARSE:
        rest += f" The numbers are of a coarse mesh: efforts between its nodes are up to {ratio:.3g} times as large."
    what = "motion of the carriers" if problem.timing is None else "timing"
    raise InfeasiblePlanError(
        f"No {what} keeps every limit. What would suffice: {text}.{rest}",
        remedy=_remedy(problem, coarse=ratio > COARSE),
        relaxations=tuple(events),
        together=not alone and len(events) > 1,
        untried=(*untried, *in_vain),
        **events[0],
    )


def _hidden_share(problem: Problem, sought: Relaxation, relaxed: Mapping[str, Outcome]) -> float:
    """Return the largest effort between the nodes over its relaxed limit; 1 where efforts are none of those."""
    if sought.peaks is None or "effort" not in relaxed:
        return 1.0
    found = relaxed["effort"]
    most = problem.settings.limits.effort * (1.0 + slack(found.solution, "effort"))
    return float((sought.peaks(found) / most).max())


class _Search:
    """The search for the smallest relaxation.

    ``untried``: limits that were not yet relaxed alone; ``in_vain``: limits whose search came no closer, so relaxing
    them alone hardly suffices.
    """

    def __init__(self, problem: Problem, robot: RobotRecord, kinds: tuple[str, ...], deadline: float) -> None:
        self.problem, self.robot, self.kinds, self._deadline = problem, robot, kinds, deadline
        self.untried: list[str] = []
        self.in_vain: list[str] = []

    def _solve(
        self, nodes: Problem, values: Mapping[str, Array], kinds: tuple[str, ...], first: Options, **options: Any
    ) -> Outcome:
        seconds = self._deadline - time.perf_counter()
        return Outcome(nodes, solve(nodes, values, seconds, elastic=kinds, first=first, **options))

    def together(self, sought: Relaxation) -> Outcome:
        """Return the smallest relaxation of all limits at once, with limits at the nodes.

        Most often one limit suffices by itself; it is then enforced between the nodes.
        """
        most = None if self.problem.timing is None else ITERATIONS_OF_TIMING
        for nodes in (coarser(self.problem), self.problem):
            guess = self.problem.resampled(sought.guess, nodes)
            found = self._solve(nodes, guess, self.kinds, RELAXED, stop=lambda _: True, most=most)
            if found.solution.feasible and not _exceeded(found.solution):
                found = self._solve(nodes, found.values, self.kinds, RELAXED)
            if nodes is self.problem or (found.solution.feasible and _exceeded(found.solution)):
                break
        iterations = found.solution.iterations  # of all finer meshes: a refusal is to come in seconds
        for _ in range(self.problem.settings.refinements if found.solution.feasible else 0):
            before, following = found, sought.finer(found)
            if following is None or iterations <= 0:
                break
            values = before.problem.resampled(before.values, following)
            finer = self._solve(following, values, self.kinds, RELAXED_AGAIN, most=iterations)
            iterations -= finer.solution.iterations
            if not finer.solution.feasible:  # what the coarser nodes need is known
                break
            found, slacks = finer, [(slack(one.solution, kind) for one in (before, finer)) for kind in self.kinds]
            if all(abs(now - then) <= SAME * now for then, now in slacks):
                break
        return found

    def alone(self, least: Outcome, exceeded: list[str]) -> dict[tuple[str, ...], Outcome]:
        """Return the relaxations of one kind of limits that suffice by themselves, of those relaxed or touched."""
        nodes, solution = least.problem, least.solution
        # one that is only touched may do as well: with a price on all, others gave way in its place
        touched = [one for one in self.kinds if one not in exceeded and is_touched(least, self.robot, one)]
        left = max(AGAIN * solution.iterations, SPARED // len(nodes.grid.t))
        relaxed: dict[tuple[str, ...], Outcome] = {}
        for kind in sorted([*exceeded, *touched], key=lambda kind: (exceeded != [kind], kind != "effort")):
            if exceeded == [kind]:
                relaxed[(kind,)] = least
                continue
            if left <= 0 or time.perf_counter() > self._deadline:
                self.untried.append(kind)
                continue
            found = self._solve(nodes, solution.values, (kind,), RELAXED, most=left)
            left -= found.solution.iterations
            if found.solution.optimal:
                relaxed[(kind,)] = found
            elif not found.solution.infeasible:
                (self.in_vain if found.solution.stalled else self.untried).append(kind)
        return relaxed

    def exactly(self, problem: Problem, found: Outcome, kinds: tuple[str, ...]) -> Outcome:
        """Return a relaxation at all nodes and between them; if none is found, the one passed in."""
        kept = {slack_name(kind) for kind in kinds}
        values = found.problem.resampled(found.values, problem)
        values = {name: value for name, value in values.items() if name in kept or not name.startswith(slack_name(""))}
        exact = self._solve(problem, values, kinds, ON_FINER_NODES, most=FINAL)
        return exact if exact.solution.feasible else found


def _remedy(problem: Problem, *, coarse: bool = False) -> str:
    """Return a remedy for limits that must be wider; ``coarse``: the nodes do not show by how much."""
    settings, timed = problem.settings, problem.timing is not None
    more = "a few per cent more than that (the least leaves no room)"
    if coarse:
        more = "more than that (how much is found with a shorter dt)"
    ways = [
        f"Widen these limits, by {more}",
        "lead the path elsewhere" if timed else "slow the motion down",
    ]
    ends = {"start": settings.begin, "end": settings.end} if timed else {"end": settings.end}
    bound = [place for place, how in ends.items() if how != "free"]
    if bound and not settings.lap:
        ways.append(f"leave the {' and the '.join(bound)} free")
    return f"{', '.join(ways[:-1])}, or {ways[-1]}."


def require_bounds(problem: Problem, guess: Mapping[str, Array], deadline: float) -> None:
    """Check that each bound of ``at_most`` is not below the least that there is of it within the limits.

    That takes a solution for each, and no search for a way to keep them all: it is a tenth of the time.

    Raises:
        InfeasiblePlanError: one is, as ``relax``.
    """
    settings, events = problem.settings, []
    for name, bound in settings.at_most.items():
        least = replace(problem, settings=replace(settings, objective={name: 1.0}, at_most={}))
        solution = solve(least, guess, deadline - time.perf_counter())
        fraction = objective_values(least, solution.values)[name] / bound - 1.0
        if solution.optimal and fraction > NOTHING:
            events.append(_bound_event(problem, {name: fraction}))
    if events:
        text = "; and ".join(str(event.pop("text")) for event in events)
        known = "What would suffice" if len(settings.at_most) == 1 else "What is needed at least"
        raise InfeasiblePlanError(
            f"No motion of the carriers keeps every limit. {known}: {text}. Not tried: wider limits.",
            remedy=_remedy(problem),
            relaxations=tuple(events),
            together=len(events) > 1,
            untried=tuple(name_of(kind) for kind in KINDS if kind != "at_most"),
            **events[0],
        )


def _bound_event(problem: Problem, fractions: Mapping[str, float]) -> dict[str, object]:
    """Return by which fractions bounds of ``at_most`` have to be wider, all of them together, the widest first."""
    bounds = problem.settings.at_most
    wider = {name: bounds[name] * (1.0 + fraction) for name, fraction in fractions.items()}
    text = " with ".join(
        f"{name} at most, from {bounds[name]:.6g} to {wider[name]:.6g} ({100.0 * fraction:.3g} %)"
        for name, fraction in fractions.items()
    )
    name, fraction = next(iter(fractions.items()))
    numbers = {"amount": bounds[name] * fraction, "limit": wider[name], "fraction": fraction, "limits": wider}
    return {"constraint": "at_most", "objective": name, "time": float(problem.grid.t[0]), **numbers, "text": text}


def name_of(kind: str) -> str:
    """Return the name that users know of a kind of limit."""
    return QUANTITIES[kind].name if kind in QUANTITIES else kind


def slack(solution: Solution, kind: str) -> float:
    """Return the fraction by which a kind of limits gives way."""
    return float(solution.values[slack_name(kind)][0, 0])


def _exceeded(elastic: Solution) -> list[str]:
    """Return the kinds of limits that were relaxed."""
    found = [kind for kind in elastic.rows["elastic"] if slack(elastic, kind) > NOTHING]
    return [kind for kind in found if slack(elastic, kind) > NOISE] or found


def coarser(problem: Problem) -> Problem:
    """Return a problem on at most ``ENOUGH`` of its nodes, plus the nodes on jumps, singular instants and both ends.

    Along a path, and where f is an expression, these are all nodes.
    """
    grid = problem.grid
    free = np.flatnonzero(~grid.smooth)  # the others let the carriers do no more than without them
    every = -(-len(free) // ENOUGH)
    if problem.timing is not None or problem.exact is not None or every == 1:
        return problem
    kept = np.zeros(len(grid.t), dtype=bool)
    kept[free[::every]] = kept[-1] = kept[grid.singular] = True
    jumps = np.flatnonzero(grid.h == 0.0)
    kept[jumps] = kept[jumps + 1] = True
    at, model, base = np.flatnonzero(kept), problem.model, problem.base
    return replace(
        problem,
        grid=Grid(read_only(grid.t[at]), np.searchsorted(at, grid.singular), grid.smooth[at]),
        model=model[at],
        singular=tuple(replace(node, index=int(np.searchsorted(at, node.index))) for node in problem.singular),
        actuated_rate=problem.actuated_rate[at],
        target=problem.target[at],
        base=base and replace(base, w0=base.w0[at], by_term=base.by_term[at]),
    )


def _is_limited(problem: Problem, kind: str) -> bool:
    """Return whether there is any limit of a kind."""
    settings = problem.settings
    if kind in QUANTITIES:
        return bool(np.isfinite(settings.limits.of(kind)).any())
    return bool(settings.at_most) if kind == "at_most" else settings.end != "free"


def is_touched(elastic: Outcome, robot: RobotRecord, kind: str) -> bool:
    """Return whether a limit is reached somewhere."""
    if kind not in QUANTITIES:
        return kind == "at_most"
    values, low, high, *_ = _quantity(elastic, robot, kind)
    with np.errstate(invalid="ignore"):
        near = TOUCHED * np.where(np.isfinite(high - low), high - low, 0.0)
    return bool(((values >= high - near) | (values <= low + near)).any())


def nothing_helps(outcome: Outcome, message: str) -> InfeasiblePlanError:
    """Return the error of a problem that wider limits do not make feasible."""
    problem, elastic = outcome.problem, outcome.solution
    if elastic.message == OUT_OF_TIME:
        constraint = "seconds"
        text = "The time ran out before any plan was found, and before any limit was shown to be in the way."
        remedy = "Allow more seconds, or a longer dt." if problem.timing is None else "Allow more seconds."
    else:
        constraint = "balance"
        said = ", then ".join(filter(None, (message, elastic.message)))
        ends = f"the solver says {said}; unbalanced by {elastic.violation:.2g} of f"
        text = f"No plan was found, nor one with relaxed limits ({ends})."
        remedy = "The actuators and carriers cannot balance this motion at all: lead the platform elsewhere."
        if problem.timing is not None:
            remedy = "Raise the limits of efforts or carriers."
            if problem.settings.end != "free":
                remedy = "Raise the limits of efforts or carriers, or leave the end free."
    amount, start = elastic.violation, float(problem.grid.t[0])
    return InfeasiblePlanError(text, remedy=remedy, constraint=constraint, time=start, amount=amount)


def elastic_event(elastic: Outcome, robot: RobotRecord, kind: str) -> dict[str, object]:
    """Return the limit with the largest excess, its time and joint, and the limit that would suffice."""
    problem, fraction = elastic.problem, slack(elastic.solution, kind)
    t = problem.times(elastic.values)
    if kind == "at_most":
        costs, bounds = objective_values(problem, elastic.values), problem.settings.at_most
        widest, *others = sorted(bounds, key=lambda name: -costs[name] / bounds[name])
        over = {name: costs[name] / bounds[name] - 1.0 for name in others}
        return _bound_event(problem, {widest: fraction} | {k: more for k, more in over.items() if more > NOTHING})
    if kind == "end":
        missed = np.abs(elastic.values["s"][-1] - problem.settings.datum / problem.scales.s) * problem.scales.s
        if problem.settings.end == "datum":
            text = f"an end of the carriers up to {missed.max():.4g} m from the datum"
        else:
            text = f"the end state by {fraction:.3g} of its size"
        return {"constraint": kind, "time": float(t[-1]), "amount": float(missed.max()), "text": text}
    values, low, high, room, names = _quantity(elastic, robot, kind)
    with np.errstate(invalid="ignore"):
        excess = np.maximum(values - high, low - values) / room
    i, j = np.unravel_index(int(np.argmax(np.where(np.isfinite(excess), excess, -np.inf))), excess.shape)
    upper = bool(values[i, j] - high[j] >= low[j] - values[i, j])
    # at the nodes less may be used than is needed between them
    amount = fraction * float(room[j])
    limit, unit = float((high if upper else low)[j]), robot.limit_unit(name_of(kind), names[j])
    enough = limit + (amount if upper else -amount)
    if kind != "track" and low[j] == -high[j]:
        # a limit of the size, as users write it; the ends of a track are places
        limit, enough = abs(limit), abs(enough)
    half = 0.5 * float(high[j] - low[j])
    fraction = amount / half if np.isfinite(half) else fraction  # of the limit, however small that is
    percent = f"{100.0 * fraction:.3g}" if fraction < 1.0 else f"{100.0 * fraction:.0f}"
    where = f"t = {t[i]:.6g} s" if problem.timing is None else f"{100.0 * problem.grid.t[i] / problem.grid.t[-1]:.3g} %"
    where += "" if problem.timing is None else " of the path"
    needed = f"{names[j]}, from {limit:.6g} to {enough:.6g} {unit}"
    if np.isfinite(high - low).sum() > 1:  # limits of one kind are wider together
        every = "both ends of every track outwards" if kind == "track" else f"every {name_of(kind)} limit"
        of = " of half its length" if kind == "track" else ""
        text = f"{every} by {percent} %{of} (most needed by {needed}, at {where})"
    else:
        text = f"the {name_of(kind)} of {needed} ({percent} %), most at {where}"
    return {
        "constraint": name_of(kind),
        "joint": names[j],
        "time": float(t[i]),
        "amount": amount,
        "limit": enough,
        "unit": unit,
        "fraction": fraction,
        "text": text,
    }


def _quantity(elastic: Outcome, robot: RobotRecord, kind: str) -> tuple[Array, Array, Array, Array, tuple[str, ...]]:
    """Return the values of a limited quantity at the nodes, its bounds, their half ranges, and whose they are."""
    problem, quantity = elastic.problem, QUANTITIES[kind]
    limit = problem.settings.limits.of(kind)
    owners: tuple[str, ...] = getattr(robot, quantity.owner)
    if kind in VARIABLES:
        variable = elastic.values[VARIABLES[kind]]
        size = np.broadcast_to(getattr(problem.scales, VARIABLES[kind]), variable.shape[1:])
        bounds = scaled_bounds(problem)[kind]
        low, high, room = (bound * size for bound in (*bounds, half_range(kind, *bounds)))
        return variable * size, low, high, room, owners
    if kind == "jerk":
        h = np.diff(problem.times(elastic.values))
        value = np.diff(elastic.values["sdd"], axis=0) * problem.scales.sdd / np.where(h > 0.0, h, np.inf)[:, None]
    else:
        value = np.asarray(quantity.values(Evaluation(problem, elastic.values)))
    return value, -limit, limit, limit, owners
