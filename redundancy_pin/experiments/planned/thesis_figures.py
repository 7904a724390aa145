"""The result figures of the thesis, 3.6 to 3.22 and 4.2 to 4.18, from the runs of this study."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from redundancy_pin.experiments.planned import captions, drawings
from redundancy_pin.experiments.planned.cases import CORNERS, CROSSINGS
from redundancy_pin.experiments.planned.store import PlanStore

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_C5, _C10, _C20, _F5, _L1, _L2, _L15 = CROSSINGS
_WIDE, _WIDE_HALF, _SHARP, _, _SQUARE_HALF, _SQUARE = CORNERS


@dataclass(frozen=True)
class ThesisFigure:
    """A figure of the thesis, drawn anew.

    Attributes:
        number: as in the thesis, ``"3.11"``.
        draw: makes the figure.
        caption: says what it shows, and from which run.
    """

    number: str
    draw: Callable[[PlanStore], Figure]
    caption: Callable[[PlanStore], str]

    @property
    def stem(self) -> str:
        """Name of its files without suffix, ``"figure-3-11"``."""
        chapter, _, count = self.number.partition(".")
        return f"figure-{chapter}-{int(count):02d}"

    @property
    def title(self) -> str:
        """For people: ``"Figure 3.11"``."""
        return f"Figure {self.number}"


FIGURES: tuple[ThesisFigure, ...] = (
    ThesisFigure("3.6", drawings.profile(_C5), captions.profile(_C5)),
    ThesisFigure("3.7", drawings.crossing_path(_C5), captions.crossing_path(_C5)),
    ThesisFigure("3.8", drawings.profile(_L1), captions.profile(_L1)),
    ThesisFigure("3.9", drawings.crossing_path(_L1), captions.crossing_path(_L1)),
    ThesisFigure("3.10", drawings.condition(_C5, (5.0, 10.0, 20.0)), captions.condition(_C5)),
    ThesisFigure("3.11", drawings.forces(_C5), captions.forces(_C5)),
    ThesisFigure("3.12", drawings.carriers(_C5), captions.carriers(_C5)),
    ThesisFigure("3.13", drawings.forces(_C10), captions.forces(_C10)),
    ThesisFigure("3.14", drawings.forces(_C20), captions.forces(_C20)),
    ThesisFigure("3.15", drawings.carriers(_C20), captions.carriers(_C20)),
    ThesisFigure("3.16", drawings.forces(_F5), captions.forces(_F5)),
    ThesisFigure("3.17", drawings.carriers(_F5), captions.carriers(_F5)),
    ThesisFigure("3.18", drawings.condition(_L1, (_L1.threshold,)), captions.condition(_L1)),
    ThesisFigure("3.19", drawings.forces(_L1), captions.forces(_L1)),
    ThesisFigure("3.20", drawings.carriers(_L1), captions.carriers(_L1)),
    ThesisFigure("3.21", drawings.forces(_L2), captions.forces(_L2)),
    ThesisFigure("3.22", drawings.forces(_L15), captions.forces(_L15)),
    ThesisFigure("4.2", drawings.corner_paths(_WIDE, _SHARP), captions.corner_paths()),
    ThesisFigure("4.3", drawings.profile(_WIDE), captions.profile(_WIDE)),
    ThesisFigure("4.4", drawings.profile(_SHARP), captions.profile(_SHARP)),
    ThesisFigure("4.5", drawings.square_path(_SQUARE), captions.square_path(_SQUARE)),
    ThesisFigure("4.6", drawings.displacement(_SQUARE), captions.displacement(_SQUARE)),
    ThesisFigure("4.7", drawings.profile(_SQUARE), captions.profile(_SQUARE)),
    ThesisFigure("4.8", drawings.torques(_WIDE), captions.torques(_WIDE)),
    ThesisFigure("4.9", drawings.carrier_panels(_WIDE, "acceleration"), captions.carrier(_WIDE, "acceleration")),
    ThesisFigure("4.10", drawings.torques(_SHARP), captions.torques(_SHARP)),
    ThesisFigure("4.11", drawings.carrier_panels(_SHARP, "acceleration"), captions.carrier(_SHARP, "acceleration")),
    ThesisFigure("4.12", drawings.torques(_WIDE_HALF), captions.torques(_WIDE_HALF)),
    ThesisFigure("4.13", drawings.carrier_panels(_WIDE_HALF, "position"), captions.carrier(_WIDE_HALF, "position")),
    ThesisFigure("4.14", drawings.carrier_panels(_WIDE_HALF, "acceleration"),
                 captions.carrier(_WIDE_HALF, "acceleration")),
    ThesisFigure("4.15", drawings.torques(_SQUARE_HALF), captions.torques(_SQUARE_HALF)),
    ThesisFigure("4.16", drawings.carrier_panels(_SQUARE_HALF, "acceleration"),
                 captions.carrier(_SQUARE_HALF, "acceleration")),
    ThesisFigure("4.17", drawings.torques(_SQUARE), captions.torques(_SQUARE)),
    ThesisFigure("4.18", drawings.carrier_panels(_SQUARE, "acceleration"), captions.carrier(_SQUARE, "acceleration")),
)  # fmt: skip
"""In the order of the thesis. Its 3.1 to 3.5 and 4.1 are flow charts and sketches, not results."""
