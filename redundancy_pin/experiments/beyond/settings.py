"""How much of the chapter to run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from redundancy_pin.experiments.planned.cases import Mode
from redundancy_pin.experiments.planned.settings import FULL as ALL_MODES

Race = Literal["light", "light, limited force", "heavy", "line"]
"""Motions of the 2-RPR whose fastest is bracketed: the circle by the massless machine, by the same with no more main
force than switching off needs at 0.5 m/s, and by the machine with masses; and the line."""


@dataclass(frozen=True)
class BeyondSettings:
    """Extent of the chapter; every motion is always planned.

    Attributes:
        coarser: factor on the largest step between nodes of every plan.
        modes: working modes of the 3-RRR to compare; the first is that of the other tables.
        tolerance: width of the bracket of the fastest motion, as a fraction of the speed.
        starts: first guesses in the search for other optima, and for a plan at a speed where one failed.
        starts_coarser: the same factor for plans from several first guesses.
        ratios: weights of the carriers' acceleration in the trade-off, over the one at which both parts of the cost
            would be the same for the plan of least effort.
        races: motions whose fastest is bracketed, by ``Race``.
        both_backends: whether every plan is made with both backends, or only the first of each motion.
    """

    coarser: float
    modes: tuple[Mode, ...]
    tolerance: float
    starts: int
    starts_coarser: float
    ratios: tuple[float, ...]
    races: tuple[Race, ...]
    both_backends: bool = True


FULL = BeyondSettings(
    coarser=1.0,
    modes=ALL_MODES.modes,
    tolerance=1e-2,
    starts=5,
    starts_coarser=2.0,
    ratios=(0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3),
    races=("light", "light, limited force", "heavy", "line"),
)
"""Nodes 5 ms apart (10 ms on the slow line), all working modes."""

QUICK = BeyondSettings(
    coarser=4.0,
    modes=((1, 1, 1), (-1, -1, -1)),
    tolerance=0.1,
    starts=2,
    starts_coarser=6.0,
    ratios=(1e-2, 1.0, 100.0),
    races=("line",),
    both_backends=False,
)
"""Coarse: for tests."""
