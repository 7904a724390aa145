"""Grids vary one thing and nothing else."""

from __future__ import annotations

from dataclasses import fields

import pytest
from redundancy_pin.experiments.planned import grids
from redundancy_pin.experiments.planned.cases import CORNERS, CROSSINGS, Case

CASES: list[tuple[grids.Grid, Case, set[str], int]] = [
    (grids.ramp_lengths((0.4, 0.5)), CROSSINGS[0], {"path_options"}, 2),
    (grids.ramp_lengths((0.4, 0.5)), CORNERS[0], {"path_options"}, 2),
    (grids.return_times((0.2, 0.3)), CROSSINGS[0], {"return_time"}, 2),
    (grids.steps((1e-2,)), CROSSINGS[0], {"dt", "scheme"}, 1),
    (grids.steps((1e-2,)), CORNERS[0], {"dt"}, 1),
    (grids.steps_and_returns((1e-2, 2e-2), (0.2, 0.3)), CROSSINGS[0], {"dt", "scheme", "return_time"}, 4),
    (grids.thresholds((7.0,)), CROSSINGS[0], {"threshold"}, 1),
    (grids.ramp_down_samples((0.02,)), CROSSINGS[0], {"ramp_down"}, 1),
    (grids.modes([(-1, -1, -1)]), CORNERS[0], {"mode"}, 1),
    (grids.orientations((0.3,)), CORNERS[0], {"path_options"}, 1),
]


@pytest.mark.parametrize(("grid", "case", "allowed", "count"), CASES, ids=lambda value: getattr(value, "parameter", ""))
def test_only_what_is_named_changes(grid: grids.Grid, case: Case, allowed: set[str], count: int) -> None:
    found = grid.cases(case)
    assert len(found) == count
    for variation in found:
        changed = {entry.name for entry in fields(case) if getattr(case, entry.name) != getattr(variation, entry.name)}
        assert changed
        assert changed <= allowed


def test_ramp_lengths_are_fractions_of_speed_times_duration() -> None:
    """v T is 0.5 m/s · 0.2 s on the circle and 0.2 m/s · 0.4 s on the corner."""
    assert grids.ramp_lengths((0.5,)).cases(CROSSINGS[0])[0].path_options["ramp_length"] == pytest.approx(0.05)
    assert grids.ramp_lengths((0.5,)).cases(CORNERS[0])[0].path_options["ramp_length"] == pytest.approx(0.04)
