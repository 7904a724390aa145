"""One point of a feasibility map: what a planner says of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import Any

Key = tuple[str, float, float]
"""Planner, value on the x axis, value on the y axis."""


class Verdict(Enum):
    """What is known of a cell. Infeasible and failed are never the same thing."""

    FEASIBLE = "feasible"
    """There is a plan that keeps every limit, and the planner finished."""
    STOPPED_EARLY = "stopped_early"
    """There is a plan that keeps every limit, but the optimiser stopped before it had an optimum."""
    INFEASIBLE = "infeasible"
    """The planner says that no plan keeps every limit, or its plan breaks one."""
    FAILED = "failed"
    """Nothing is known: the time ran out, the solver gave up, or something went wrong."""


@dataclass(frozen=True)
class Cell:
    """What a planner says of one cell.

    Attributes:
        planner: its name on the command line.
        x, y: values of the two parameters.
        verdict: what is known.
        limits: feasible: the limits that bind, at least to 0.1 %; infeasible: those in the way, the worst first.
            "track", "speed", "acceleration", "jerk", "force" of a carrier, "effort" of a main actuator, "end" of the
            motion, "workspace", and whatever else a planner names.
        carrier: infeasible: which carrier or actuator exceeds the first of them most.
        time: when, s.
        amount: by how much, in its unit.
        peak_effort: largest |τ| of any main actuator, between the samples included where the planner looks there, N or
            N·m; None without a plan.
        dense_ratio: largest effort between the samples over the largest at the samples; None where it is not known.
        seconds: time taken.
        status: status of the plan; empty without one.
        message: why there is none, or what limits it breaks.
        settings: parameters of the planner that were tried in turn, as they were in the end.
    """

    planner: str
    x: float
    y: float
    verdict: Verdict
    limits: tuple[str, ...] = ()
    carrier: str | None = None
    time: float | None = None
    amount: float | None = None
    peak_effort: float | None = None
    dense_ratio: float | None = None
    seconds: float = 0.0
    status: str = ""
    message: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> Key:
        """What tells it from the others of a map."""
        return self.planner, self.x, self.y

    @property
    def possible(self) -> bool | None:
        """Whether the machine can do it; None where nothing is known."""
        if self.verdict is Verdict.FAILED:
            return None
        return self.verdict is not Verdict.INFEASIBLE

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON."""
        data = {**asdict(self), "verdict": self.verdict.value, "limits": list(self.limits)}
        # JSON knows neither NaN nor infinity
        return {
            key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in data.items()
        }


def cell_from(data: Mapping[str, Any]) -> Cell:
    """Return a cell from its plain data.

    Raises:
        KeyError, TypeError, ValueError: something is missing or has no meaning.
    """
    values = {**data, "verdict": Verdict(data["verdict"]), "limits": tuple(str(name) for name in data["limits"])}
    if not all(isinstance(values[name], (int, float)) for name in ("x", "y")):
        raise ValueError("x and y must be numbers")
    return Cell(**values)
