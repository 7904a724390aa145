"""The journal of a sweep: one line for every finished cell."""

from __future__ import annotations

from redundancy_pin.experiments.feasibility.cell import Cell, cell_from
from redundancy_pin.experiments.journal import JournalKind

CELLS: JournalKind[Cell] = JournalKind(
    "redundancy_pin feasibility journal", 1, "a feasibility map", "problem", "cell", cell_from
)
"""The identity of its cells is ``MapProblem.identity`` and the machine."""
