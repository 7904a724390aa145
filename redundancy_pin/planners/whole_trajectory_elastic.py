"""Why there is no plan: the smallest relaxation of the limits that admits one."""

from __future__ import annotations

import time

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.robot_record import RobotRecord
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_limits import KINDS, scaled_bounds, slack_name
from redundancy_pin.planners.whole_trajectory_nlp import build
from redundancy_pin.planners.whole_trajectory_progress import Say
from redundancy_pin.planners.whole_trajectory_solver import Solution, Solver

NOTHING = 1e-5
"""A relaxation below this fraction of a limit is none: the price of the objective and the reserve leave as much."""

TOUCHED = 1e-4
"""Fraction of its range within which a limit counts as reached."""

OUT_OF_TIME = "Maximum_WallTime_Exceeded"
"""The solver's word for it."""


def relax(
    problem: WholeProblem,
    robot: RobotRecord,
    guess: dict[str, Array],
    seconds: float,
    message: str,
    say: Say | None = None,
) -> Solution:
    """Find the smallest relaxation of the limits that admits a plan, and return it where it is none.

    First all limits may give way together, then each of those that did, or that are touched, by itself.

    Args:
        problem: the numbers.
        robot: names of carriers and actuators, and which of them rotate.
        guess: first guess.
        seconds: time bound, s.
        message: how the solver ended on the ordinary problem.
        say: called with the progress of the solver.

    Raises:
        InfeasiblePlanError: limits have to give way. It carries ``constraint`` (the limit of the smallest relaxation),
            ``time`` and ``carrier`` where it is exceeded most, ``amount`` of that, and ``limit`` that would suffice;
            ``relaxations``, the same for every limit that gave way; and ``together``, whether all of these are needed
            or one of them is enough. Or nothing admits a plan, or the time ran out.
    """
    deadline = time.perf_counter() + seconds
    elastic = Solver(build(problem, elastic=KINDS), seconds, say=say).solve(guess)
    if not elastic.feasible:
        raise _nothing_helps(problem, elastic, message)
    let_out = [kind for kind in KINDS if _slack(elastic, kind) > NOTHING]
    if not let_out:
        return elastic
    alone = {}
    # one that is only touched may do as well by itself: with a price on all, others gave way in its place
    touched = [kind for kind in KINDS if kind not in let_out and _touched(problem, robot, elastic, kind)]
    candidates = [*let_out, *touched]
    for kind in candidates if len(candidates) > 1 else []:
        left = deadline - time.perf_counter()
        if left <= 0.0:
            break
        found = Solver(build(problem, elastic=(kind,)), left, say=say).solve(elastic.values)
        if found.optimal:
            alone[kind] = found
    relaxed = alone or dict.fromkeys(let_out, elastic)
    order = sorted(relaxed, key=lambda kind: _slack(relaxed[kind], kind))
    events = [_event(problem, robot, relaxed[kind], kind) for kind in order]
    text = ("; or " if alone else "; and ").join(str(event["text"]) for event in events)
    relaxations = tuple({name: value for name, value in event.items() if name != "text"} for event in events)
    raise InfeasiblePlanError(
        f"No motion of the carriers keeps every limit. What would suffice: {text}.",
        remedy="Widen these limits, slow the motion down, or leave the end free.",
        relaxations=relaxations,
        together=not alone and len(let_out) > 1,
        **relaxations[0],
    )


def _slack(solution: Solution, kind: str) -> float:
    return float(solution.values[slack_name(kind)][0])


def _touched(problem: WholeProblem, robot: RobotRecord, elastic: Solution, kind: str) -> bool:
    """Return whether a limit is reached somewhere."""
    if kind == "end" or (kind == "force" and "force" not in elastic.values):
        return False
    values, low, high, _ = _quantity(problem, robot, elastic, kind)
    with np.errstate(invalid="ignore"):
        near = TOUCHED * np.where(np.isfinite(high - low), high - low, 0.0)
    return bool(((values >= high - near) | (values <= low + near)).any())


def _nothing_helps(problem: WholeProblem, elastic: Solution, message: str) -> InfeasiblePlanError:
    start = float(problem.grid.t[0])
    if elastic.message == OUT_OF_TIME:
        return InfeasiblePlanError(
            "The time ran out before any plan was found, and before any limit was shown to be in the way.",
            remedy="Allow more seconds, or a longer dt.",
            constraint="seconds",
            time=start,
            amount=elastic.violation,
        )
    return InfeasiblePlanError(
        "No plan was found, nor one with relaxed limits "
        f"(the solver says {message}, then {elastic.message}; unbalanced by {elastic.violation:.2g} of f).",
        remedy="The actuators and carriers cannot balance this motion at all: lead the platform elsewhere.",
        constraint="balance",
        time=start,
        amount=elastic.violation,
    )


def _event(problem: WholeProblem, robot: RobotRecord, elastic: Solution, kind: str) -> dict[str, object]:
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
    problem: WholeProblem, robot: RobotRecord, elastic: Solution, kind: str
) -> tuple[Array, Array, Array, tuple[str, ...]]:
    """Return the values of a limited quantity at the nodes, its bounds, and whose they are."""
    u = problem.scales
    if kind == "jerk":
        h = np.where(problem.grid.h > 0.0, problem.grid.h, np.inf)[:, None]
        jerk = np.diff(elastic.values["sdd"], axis=0) * u.sdd / h
        return jerk, -problem.settings.jerk, problem.settings.jerk, robot.carriers
    name, size = {
        "track": ("s", u.s),
        "speed": ("sd", u.sd),
        "acceleration": ("sdd", u.sdd),
        "effort": ("tau", np.full(problem.model.W.shape[2], u.tau)),
        "force": ("force", u.force),
    }[kind]
    low, high = (bound * size for bound in scaled_bounds(problem)[name])
    return elastic.values[name] * size, low, high, robot.actuated if kind == "effort" else robot.carriers
