"""The figures of the chapter: tracking errors over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from redundancy_pin.experiments.replay.cases import CASES
from redundancy_pin.experiments.replay.study import Replays
from redundancy_pin.visualisation.figures.summaries import plot_tracking

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ReplayFigure:
    """A figure of the chapter.

    Attributes:
        stem: name of its files without suffix.
        title: above it.
        caption: below it.
        case: name of the case whose replays it shows.
    """

    stem: str
    title: str
    caption: str
    case: str

    def draw(self, replays: Replays) -> Figure:
        """Draw it."""
        curves = {row.drive: (row.t, row.error) for row in replays.of(self.case) if len(row.t)}
        return plot_tracking(self.title, curves)


FIGURES: tuple[ReplayFigure, ...] = tuple(
    ReplayFigure(
        f"replay-{case.task.name}",
        case.task.title,
        f"Distance of the platform from its plan ({case.name}), for each drive.",
        case.name,
    )
    for case in (CASES[3], CASES[10])
)
