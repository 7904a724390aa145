"""Why there is no plan: the smallest relaxation of the limits that admits one."""

from __future__ import annotations

import time

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.robot_record import RobotRecord
from redundancy_pin.planners.whole_trajectory.coefficients import Problem
from redundancy_pin.planners.whole_trajectory.solver import OUT_OF_TIME, Solution, solve_nlp
from redundancy_pin.planners.whole_trajectory.transcription import KIND_OF, KINDS, scaled_bounds, slack_name, transcribe

NOTHING = 1e-5
"""A relaxation below this fraction of a limit is none: the objective and the reserve leave as much."""

TOUCHED = 1e-4
"""Fraction of its range within which a limit counts as reached."""


def relax(problem: Problem, robot: RobotRecord, guess: dict[str, Array], message: str) -> Solution:
    """Find the smallest relaxation of the limits that admits a plan, and return it where it is none.

    First all limits may give way at once, then each of those that did, or that are touched, by itself.

    Args:
        problem: the numbers.
        robot: names of carriers and actuators, and which of them rotate.
        guess: first guess.
        message: how the solver ended on the ordinary problem.

    Raises:
        InfeasiblePlanError: limits have to give way. It carries ``constraint`` (the limit of the smallest relaxation),
            ``time`` and ``carrier`` where it is exceeded most, ``amount`` of that, and ``limit`` that would suffice;
            ``relaxations``, the same for every limit that gave way; and ``together``, whether all of these are needed
            or one of them is enough. Or nothing admits a plan, or the time ran out.
    """
    settings = problem.settings.solver
    deadline = time.perf_counter() + settings.seconds
    elastic = solve_nlp(transcribe(problem, KINDS), guess, settings.seconds, progress=settings.progress)
    if not elastic.feasible:
        raise _nothing_helps(problem, elastic, message)
    exceeded = [kind for kind in KINDS if _slack(elastic, kind) > NOTHING]
    if not exceeded:
        return elastic
    # one that is only touched may do as well by itself: with a price on all, others gave way in its place
    touched = [kind for kind in KINDS if kind not in exceeded and _touched(problem, robot, elastic, kind)]
    candidates = [*exceeded, *touched]
    alone = {}
    for kind in candidates if len(candidates) > 1 else []:
        left = deadline - time.perf_counter()
        if left <= 0.0:
            break
        solution = solve_nlp(transcribe(problem, (kind,)), elastic.values, left, progress=settings.progress)
        if solution.optimal:
            alone[kind] = solution
    relaxed = alone or dict.fromkeys(exceeded, elastic)
    order = sorted(relaxed, key=lambda kind: _slack(relaxed[kind], kind))
    events = [_event(problem, robot, relaxed[kind], kind) for kind in order]
    text = ("; or " if alone else "; and ").join(str(event.pop("text")) for event in events)
    raise InfeasiblePlanError(
        f"No motion of the carriers keeps every limit. What would suffice: {text}.",
        remedy="Widen these limits, slow the motion down, or leave the end free.",
        relaxations=tuple(events),
        together=not alone and len(exceeded) > 1,
        **events[0],
    )


def _slack(solution: Solution, kind: str) -> float:
    return float(solution.values[slack_name(kind)][0, 0])


def _touched(problem: Problem, robot: RobotRecord, elastic: Solution, kind: str) -> bool:
    """Return whether a limit is reached somewhere."""
    if kind == "end" or (kind == "force" and "force" not in elastic.values):
        return False
    values, low, high, _ = _quantity(problem, robot, elastic, kind)
    with np.errstate(invalid="ignore"):
        near = TOUCHED * np.where(np.isfinite(high - low), high - low, 0.0)
    return bool(((values >= high - near) | (values <= low + near)).any())


def _nothing_helps(problem: Problem, elastic: Solution, message: str) -> InfeasiblePlanError:
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


def _event(problem: Problem, robot: RobotRecord, elastic: Solution, kind: str) -> dict[str, object]:
    """Return what is exceeded most, where, and what would suffice."""
    fraction = _slack(elastic, kind)
    t = problem.grid.t
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
    problem: Problem, robot: RobotRecord, elastic: Solution, kind: str
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
