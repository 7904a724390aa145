"""Maps small enough for tests: coarse nodes, nine cells."""

from __future__ import annotations

import time
from typing import Any

from redundancy_pin.errors import InputError
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.feasibility import STEPWISE, SWITCH_OFF, WHOLE, Axis, MapProblem
from redundancy_pin.studies.verdicts import Cell

COARSE = {WHOLE: {"dt": 0.03, "refinements": 0}, SWITCH_OFF: {"threshold": 20.0, "return_time": "shortest", "dt": 5e-3}}


def crossing(**changes: Any) -> MapProblem:
    """The 2-RPR on its circle: slow and fast, short and long tracks; each planner can do some of it."""
    given: dict[str, Any] = {
        "robot": "2rpr",
        "x": Axis("speed", (0.4, 0.8, 2.0)),
        "y": Axis("stroke", (0.05, 0.2, 1.0)),
        "trajectory": "circle",
        "planners": (SWITCH_OFF, WHOLE),
        "parameters": COARSE,
    }
    return MapProblem(**{**given, **changes})


def corner(**changes: Any) -> MapProblem:
    """The 3-RRR round its corner with 5 N·m: what it can do depends on speed and stroke alike."""
    given: dict[str, Any] = {
        "robot": "3rrr",
        "x": Axis("speed", (0.1, 0.2, 0.3)),
        "y": Axis("stroke", (0.02, 0.1, 2.0)),
        "trajectory": "corner",
        "mode": (1, 1, 1),
        "limits": {"max_effort": 5.0},
        "planners": (STEPWISE, WHOLE),
        "parameters": {WHOLE: {"dt": 0.05, "refinements": 0}, STEPWISE: {"lam": 0.0}},
    }
    return MapProblem(**{**given, **changes})


def quick(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
    """A cell that is possible on one side of a slanting border, at once."""
    possible = x <= 0.1 + 0.2 * y
    verdict, limits = (ResultStatus.OK, ()) if possible else (ResultStatus.INFEASIBLE, ("track",))
    return Cell(planner, x, y, verdict, limits, peak_effort=x if possible else None)


def slow(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
    """The same in a worker, slowly enough to be interrupted."""
    time.sleep(0.3)
    return quick(problem, planner, x, y)


def place(number: int) -> int:
    """Its argument, whichever process is asked first."""
    return number


def refuses(number: int) -> int:
    """A call that fails on the fewest of arguments."""
    if number == 1:
        raise InputError("One is the fewest.", remedy="Pass two.")
    return number
