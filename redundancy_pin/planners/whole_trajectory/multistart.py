"""Why there is no plan: the smallest relaxation of the limits that admits one."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.robot_record import RobotRecord
from redundancy_pin.planners.whole_trajectory.constraint_generation import solve
from redundancy_pin.planners.whole_trajectory.mesh import CarrierCourse
from redundancy_pin.planners.whole_trajectory.problem import WholeProblem
from redundancy_pin.planners.whole_trajectory.solver import LEAST_SECONDS, LONG, Say, Solution, Solver
from redundancy_pin.planners.whole_trajectory.transcription import KINDS, build, scaled_bounds, slack_name

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
