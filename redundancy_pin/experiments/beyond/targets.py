"""What the whole-trajectory planner was asked to reach, and what it reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.ways import EFFORT, PEAK

BETWEEN = 1.05
"""Largest peak between the nodes over that at the nodes that is accepted."""

_ASKED = (
    ("circle-0.5", EFFORT, 0.21),
    ("circle-0.5", PEAK, 0.11),
    ("corner-r0.025", PEAK, 2.27),
    ("corner-r0.013", PEAK, 7.2),
)
"""Task, way, and the largest |τ| that was asked for, N or N·m."""


@dataclass(frozen=True)
class Target:
    """One number that was asked for.

    Attributes:
        task, way: which plan.
        unit: of the efforts.
        asked: largest |τ| at the nodes.
        found: what came out; NaN without a plan.
        between: largest |τ| between the nodes.
        sound: whether the plan is optimal and within the limits.
    """

    task: str
    way: str
    unit: str
    asked: float
    found: float
    between: float
    sound: bool

    @property
    def met(self) -> bool:
        """Whether the plan is sound, reaches the number, and is no worse between its nodes than is accepted."""
        return self.sound and self.found <= self.asked and self.between <= BETWEEN * self.found

    @property
    def said(self) -> str:
        """The verdict as text."""
        if self.met:
            return "met"
        reasons = []
        if not self.sound:
            reasons.append("no sound plan")
        if not self.found <= self.asked:
            reasons.append(f"{self.found:.3g} {self.unit} at the nodes")
        if not self.between <= BETWEEN * self.found:
            reasons.append(f"{self.between:.3g} {self.unit} between the nodes")
        return "missed: " + ", ".join(reasons)

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON; None without a plan."""
        data = {**vars(self), "met": self.met}
        return {key: None if value != value else value for key, value in data.items()}


def targets(rows: Sequence[Row]) -> tuple[Target, ...]:
    """Return every number that was asked for with what came out."""
    by_key = {(row.task, row.way): row for row in rows}
    found = []
    for task, way, asked in _ASKED:
        row = by_key[task, way]
        found.append(Target(task, way, row.unit, asked, row.peak, row.dense_peak, row.sound))
    return tuple(found)
