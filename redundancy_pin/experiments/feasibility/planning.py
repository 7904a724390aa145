"""Asking a planner about one cell."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from redundancy_pin.errors import InputError
from redundancy_pin.experiments.feasibility.cell import Cell, Verdict
from redundancy_pin.experiments.feasibility.judging import judge, of_error
from redundancy_pin.experiments.feasibility.machine import Machine, machine
from redundancy_pin.experiments.feasibility.problem import STEPWISE, SWITCH_OFF, WHOLE, MapProblem
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.planner import plan_stepwise
from redundancy_pin.planners.switch_off.planner import plan_switch_off
from redundancy_pin.planners.whole_trajectory.planner import plan_whole_trajectory

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
        cell = of_error(planner, error)
    return replace(cell, x=x, y=y, seconds=round(time.perf_counter() - began, 4))


def _best(problem: MapProblem, planner: str, made: Machine) -> Cell:
    """Return the answer to the first try that keeps every limit, or else the first that says most."""
    answers = []
    for settings in tries(problem, planner):
        try:
            cell = judge(planner, PLAN[planner](made, settings), made)
        except Exception as error:
            cell = of_error(planner, error)
        answers.append(replace(cell, settings=dict(settings)))
        if cell.verdict is Verdict.FEASIBLE:
            break
    return min(answers, key=lambda cell: _RANK[cell.verdict])


def tries(problem: MapProblem, planner: str) -> Iterator[Mapping[str, Any]]:
    """Give the parameters to try in turn: those of the problem in place of the usual ones, none of them twice."""
    seen: list[Mapping[str, Any]] = []
    for usual in TRIES[planner]:
        settings = {**usual, **problem.parameters.get(planner, {})}
        if usual.get("lam", 0.0) > 0.0 and not problem.has_baseline:
            continue
        if settings not in seen:
            seen.append(settings)
            yield settings


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
        InputError: one is not, or there is no baseline for it.
    """
    for planner, given in problem.parameters.items():
        if given.get("lam", 0.0) > 0.0 and not problem.has_baseline:
            raise InputError(
                f"lam = {given['lam']:g} needs a baseline, and {problem.robot} cannot be loaded without carriers.",
                remedy="Leave lam out.",
            )
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
