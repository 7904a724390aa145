"""How much of the planned study to run."""

from __future__ import annotations

from dataclasses import dataclass

from redundancy_pin.experiments.planned.cases import Mode


@dataclass(frozen=True)
class StudySettings:
    """Extent of the study; the thesis's cases are always run, with both backends.

    Attributes:
        modes: working modes of the 3-RRR to compare; the first is that of the figures.
        sensitivity: whether to vary what the thesis leaves unstated over the whole grids, or only at their ends.
    """

    modes: tuple[Mode, ...]
    sensitivity: bool = True


_SIGNS = (1, -1)

FULL = StudySettings(tuple((a, b, c) for a in _SIGNS for b in _SIGNS for c in _SIGNS))
"""All eight working modes, whole grids."""

QUICK = StudySettings(((1, 1, 1), (-1, -1, -1)), sensitivity=False)
"""Two working modes and the ends of the grids: for tests."""
