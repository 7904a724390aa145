"""The corners in every working mode of the 3-RRR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.tasks import corner
from redundancy_pin.experiments.beyond.ways import EFFORT, NONE, PEAK, PEAK_FREE, stepwise_rows, whole_row
from redundancy_pin.experiments.planned.cases import Mode

RADII = (0.025, 0.013)

WAYS = (EFFORT, PEAK, PEAK_FREE)
"""Plans over the whole trajectory in each mode; the last has the freedom of stepwise planning, which brings no carrier
back."""


@dataclass(frozen=True)
class ModeRows:
    """One corner in one working mode.

    Attributes:
        radius: m.
        mode: ±1 a leg.
        rows: by way.
    """

    radius: float
    mode: Mode
    rows: dict[str, Row]

    @property
    def lower(self) -> bool:
        """Whether the plan of least peak has a lower peak than the machine without carriers."""
        return self.rows[PEAK].sound and self.rows[PEAK].worst < self.rows[NONE].worst

    @property
    def ratio(self) -> float:
        """Both peaks, one over the other; NaN without a plan."""
        return self.rows[PEAK].worst / self.rows[NONE].worst

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {
            "radius": self.radius,
            "mode": list(self.mode),
            "rows": {way: row.as_dict() for way, row in self.rows.items()},
            "lower": self.lower,
        }


def mode_rows(store: BeyondStore, modes: Sequence[Mode], coarser: float) -> tuple[ModeRows, ...]:
    """Return both corners in every working mode."""
    found = []
    for radius in RADII:
        for mode in modes:
            task = corner(radius, mode)
            rows = (*stepwise_rows(store, task), *(whole_row(store, task, way, coarser) for way in WAYS))
            found.append(ModeRows(radius, mode, {row.way: row for row in rows}))
    return tuple(found)
