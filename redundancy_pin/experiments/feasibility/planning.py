"""Asking a planner about one cell, and judging what it answers."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from redundancy_pin.errors import (
    InfeasiblePlanError,
    InputError,
    SingularPoseError,
    UnreachablePoseError,
    WorkingModeError,
)
from redundancy_pin.experiments.feasibility.cell import Cell, Verdict
from redundancy_pin.experiments.feasibility.machine import Machine, machine
from redundancy_pin.experiments.feasibility.problem import STEPWISE, SWITCH_OFF, WHOLE, MapProblem
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.planners.stepwise import plan_stepwise
from redundancy_pin.planners.switch_off import plan_switch_off
from redundancy_pin.planners.whole_trajectory import plan_whole_trajectory
from redundancy_pin.planners.whole_trajectory_check import ALLOWED

TRIES: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    SWITCH_OFF: tuple(
        {"threshold": threshold, "return_time": duration}
        for threshold in (5.0, 10.0, 20.0)
        for duration in (0.4, "shortest")
    ),
    STEPWISE: tuple({"dt": 5e-3, "lam": lam, "between": 3} for lam in (0.0, 0.5, 1.0)),
    WHOLE: ({"dt": 1e-2, "seconds": 20.0},),
}
"""Parameters of each planner, tried in turn until a plan keeps every limit.

Of switching off, the thresholds of the thesis's circle, each with its return and, where that breaks a limit, with the
shortest return that breaks none. Of the stepwise planner, its fractions of the efforts without carriers.
"""

BINDS = 0.999
"""A limit is said to bind where this fraction of it is used: an interior-point solution stays a little inside."""

ROUNDING = 1e-6
"""Relative excess of an effort over its limit that counts as rounding."""

UNDECIDED = ("seconds", "balance")
"""What an error of the planner names where it shows of no limit that it is in the way."""

_RANK = {Verdict.FEASIBLE: 0, Verdict.STOPPED_EARLY: 1, Verdict.FAILED: 2, Verdict.INFEASIBLE: 3}
"""Which of several answers stands: a plan before none; while one of them failed, it is not shown that there is none."""


def compute(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
    """Ask a planner about one cell.

    Args:
        problem: what the map is of.
        planner: its name.
        x: value of the first parameter.
        y: value of the second.

    Returns:
        The cell. Whatever goes wrong is in it: a sweep does not stop for one cell.
    """
    began = time.perf_counter()
    try:
        made = machine(problem, x, y)
        cell = _best(problem, planner, made)
    except Exception as error:
        cell = _of_error(planner, error)
    return replace(cell, x=x, y=y, seconds=round(time.perf_counter() - began, 4))


def _best(problem: MapProblem, planner: str, made: Machine) -> Cell:
    """Return the answer to the first try that keeps every limit, or else the first that says most."""
    answers = []
    for settings in tries(problem, planner):
        try:
            cell = judge(planner, PLAN[planner](made, settings), made)
        except Exception as error:
            cell = _of_error(planner, error)
        answers.append(replace(cell, settings=dict(settings)))
        if cell.verdict is Verdict.FEASIBLE:
            break
    return min(answers, key=lambda cell: _RANK[cell.verdict])


def tries(problem: MapProblem, planner: str) -> Iterator[Mapping[str, Any]]:
    """Give the parameters to try in turn: those of the problem in place of the usual ones, none of them twice."""
    seen: list[Mapping[str, Any]] = []
    for usual in TRIES[planner]:
        settings = {**usual, **problem.parameters.get(planner, {})}
        if settings.get("lam", 0.0) > 0.0 and not problem.has_baseline:
            continue
        if settings not in seen:
            seen.append(settings)
            yield settings


def judge(planner: str, plan: Plan, made: Machine) -> Cell:
    """Return what a plan says of its cell.

    A plan that breaks a limit of the carriers, exceeds the limit of the main efforts, or needs unbounded ones is none.

    Args:
        planner: its name.
        plan: the plan.
        made: the machine it is for.
    """
    ratio = _dense_ratio(plan)
    peak = float(plan.peak_effort.max(initial=0.0))
    between = peak * max(1.0, ratio or 1.0)
    cell = Cell(planner, 0.0, 0.0, Verdict.FEASIBLE, dense_ratio=ratio, status=plan.status.value)
    if plan.status is PlanStatus.UNBOUNDED_EFFORT:
        return replace(cell, verdict=Verdict.INFEASIBLE, limits=("effort",), message="No finite main efforts exist.")
    cell = replace(cell, peak_effort=between)
    broken = _broken(plan, peak, made.effort)
    if broken:
        worst = broken[0]
        message = "; ".join(f"{name} of {who} by {by:.4g} at {t:.4g} s" for _, name, who, t, by in broken[:4])
        return replace(
            cell,
            verdict=Verdict.INFEASIBLE,
            limits=tuple(dict.fromkeys(entry[1] for entry in broken)),
            carrier=worst[2],
            time=worst[3],
            amount=worst[4],
            message=f"The plan breaks limits: {message}.",
        )
    if made.effort is not None and between > ALLOWED * made.effort:
        return replace(
            cell, verdict=Verdict.FAILED, message=f"Between the nodes the efforts reach {between:.4g}: not resolved."
        )
    early = plan.status is not PlanStatus.WITHIN_LIMITS
    verdict = Verdict.STOPPED_EARLY if early else Verdict.FEASIBLE
    message = f"The solver says {plan.diagnostics.get('solver')}." if early else ""
    return replace(cell, verdict=verdict, limits=_binding(plan, peak, made), message=message)


def _broken(plan: Plan, peak: float, effort: float | None) -> list[tuple[float, str, str, float, float]]:
    """Return relative excess, quantity, whose, when and amount of every limit that is broken, the worst first."""
    found = [
        (event.amount / max(abs(event.limit), 1e-12), event.quantity, event.carrier, event.worst, event.amount)
        for event in plan.limits.violated
    ]
    if effort is not None and peak > effort * (1.0 + ROUNDING):
        i, j = np.unravel_index(int(np.nanargmax(np.abs(plan.tau))), plan.tau.shape)
        found.append(((peak - effort) / effort, "effort", plan.robot.actuated[int(j)], float(plan.t[i]), peak - effort))
    return sorted(found, reverse=True)


def _binding(plan: Plan, peak: float, made: Machine) -> tuple[str, ...]:
    """Return the limits of which a plan uses all but a thousandth, the one most used first."""
    s, limits = plan.carriers, plan.limits.judged_by
    lower, upper, speed, acceleration, force = (
        np.array([getattr(limit, name) for limit in limits])
        for name in ("lower", "upper", "speed", "acceleration", "force")
    )
    use = {
        "track": np.abs(s.s - 0.5 * (lower + upper)) / (0.5 * (upper - lower)),
        "speed": np.abs(s.sd) / speed,
        "acceleration": np.abs(s.sdd) / acceleration,
        "force": np.abs(plan.carrier_force) / force,
        "effort": np.array([peak / made.effort if made.effort else 0.0]),
    }
    if made.jerk:
        h = np.diff(plan.t)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            jerk = np.where(h > 0.0, np.diff(s.sdd, axis=0) / h, 0.0)
        use["jerk"] = np.abs(jerk) / made.jerk
    most = {name: float(np.max(np.where(np.isfinite(part), part, 0.0), initial=0.0)) for name, part in use.items()}
    return tuple(name for name in sorted(most, key=lambda name: -most[name]) if most[name] >= BINDS)


def _dense_ratio(plan: Plan) -> float | None:
    found: Any = plan.diagnostics
    if "dense_check" in found:
        return float(found["dense_check"]["ratio"])
    if "between_samples" in found:
        peak = float(plan.peak_effort.max(initial=0.0))
        return max(found["between_samples"]["peak_effort"]) / peak if peak > 0.0 else None
    return None


def _of_error(planner: str, error: Exception) -> Cell:
    """Return what an error says of its cell."""
    message = f"{type(error).__name__}: {' '.join(str(error).split())}"
    if isinstance(error, (UnreachablePoseError, SingularPoseError, WorkingModeError)):
        return Cell(planner, 0.0, 0.0, Verdict.INFEASIBLE, limits=("workspace",), message=message)
    details: Mapping[str, Any] = error.details if isinstance(error, InfeasiblePlanError) else {}
    constraint = str(details.get("constraint", ""))
    if not constraint or constraint in UNDECIDED:
        return Cell(planner, 0.0, 0.0, Verdict.FAILED, message=message)
    limits: tuple[str, ...] = (constraint,)
    if details.get("together"):
        limits = tuple(dict.fromkeys(str(entry["constraint"]) for entry in details["relaxations"]))
    when = details.get("time", details.get("t"))
    return Cell(
        planner,
        0.0,
        0.0,
        Verdict.INFEASIBLE,
        limits=limits,
        carrier=None if details.get("carrier") is None else str(details["carrier"]),
        time=None if when is None else float(when),
        amount=None if details.get("amount") is None else float(details["amount"]),
        message=message,
    )


def _switch_off(made: Machine, settings: Mapping[str, Any]) -> Plan:
    return plan_switch_off(made.dynamics, made.trajectory, **settings)


def _stepwise(made: Machine, settings: Mapping[str, Any]) -> Plan:
    baseline = made.baseline() if settings.get("lam", 0.0) > 0.0 else None
    return plan_stepwise(made.dynamics, made.trajectory, baseline=baseline, **settings)


def _whole(made: Machine, settings: Mapping[str, Any]) -> Plan:
    baseline = made.baseline() if settings.get("lam", 0.0) > 0.0 else None
    return plan_whole_trajectory(
        made.dynamics, made.trajectory, effort=made.effort, jerk=made.jerk, baseline=baseline, **settings
    )


PLAN: Mapping[str, Callable[[Machine, Mapping[str, Any]], Plan]] = {
    SWITCH_OFF: _switch_off,
    STEPWISE: _stepwise,
    WHOLE: _whole,
}
"""Planners by the name the command line uses."""

_OF_THE_MAP = ("effort", "jerk", "track", "speed", "acceleration", "carrier_force", "baseline", "progress")
"""Keywords of planners that a map sets itself, or that are no plain data."""


def require_parameters(problem: MapProblem) -> None:
    """Check that the parameters of a problem are keywords of their planners that a map does not set itself.

    Raises:
        InputError: one is not.
    """
    for planner, given in problem.parameters.items():
        makers: Mapping[str, Callable[..., Plan]] = {
            SWITCH_OFF: plan_switch_off,
            STEPWISE: plan_stepwise,
            WHOLE: plan_whole_trajectory,
        }
        keywords = inspect.signature(makers[planner]).parameters.values()
        known = [key.name for key in keywords if key.kind is key.KEYWORD_ONLY and key.name not in _OF_THE_MAP]
        for name in given:
            if name not in known:
                limit = "Limits are those of the map (max_effort, stroke, ...). " if name in _OF_THE_MAP else ""
                raise InputError(
                    f"{name!r} is no parameter of {planner} in a map.",
                    remedy=f"{limit}It takes {', '.join(known)}.",
                    name=name,
                )
