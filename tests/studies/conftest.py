"""Sweeps of cells that cost nothing."""

from __future__ import annotations

import pytest
from small_maps import quick

from redundancy_pin.studies import feasibility
from redundancy_pin.studies.feasibility import MapProblem
from redundancy_pin.studies.verdicts import Cell, Key


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[Key]:
    """Let cells be quick, and list those that are computed."""
    keys: list[Key] = []

    def compute(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
        keys.append((planner, x, y))
        return quick(problem, planner, x, y)

    monkeypatch.setattr(feasibility, "compute", compute)
    return keys
