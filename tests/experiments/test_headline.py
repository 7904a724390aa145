"""The headline table: what its cells say, and that the README shows what the job writes."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from redundancy_pin.experiments.beyond.rows import INFEASIBLE, Row
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.tasks import CORNERS, CROSSINGS, TASKS
from redundancy_pin.experiments.beyond.ways import (
    EFFORT,
    PEAK,
    SMOOTH,
    STEPWISE,
    SWITCH_OFF,
    SWITCH_OFF_LATE,
    stepwise_rows,
    switch_off_row,
    whole_row,
)
from redundancy_pin.experiments.headline import BREAKS, HEADINGS, NO_PLAN, cell, headline
from redundancy_pin.experiments.planned.store import PlanStore

README = Path(__file__).resolve().parents[2] / "README.md"

ROUNDING = 0.01
"""Three digits are shown, and a solver that takes another way to the optimum refines another grid."""

CHEAP = (CROSSINGS[0], CROSSINGS[2], CROSSINGS[4], CROSSINGS[5], *CORNERS[:2])
"""Motions that are planned again here; the others take as long as all of these."""

SOUND = Row("line-0.1", EFFORT, "N", "within_limits", peak=0.5, dense_peak=0.52)


@pytest.fixture(scope="module")
def store() -> BeyondStore:
    return BeyondStore(PlanStore())


def cells(line: str) -> list[str]:
    return [part.strip() for part in line.strip().strip("|").split("|")]


def shown() -> dict[str, list[str]]:
    """The table of the README: cells by motion."""
    text = README.read_text(encoding="utf-8")
    (table,) = re.findall(r"results/headline\.md -->\n(.*?)<!-- end of headline -->", text, flags=re.DOTALL)
    lines = table.strip().splitlines()
    assert cells(lines[0]) == list(HEADINGS)
    return {row[0]: row[1:] for row in map(cells, lines[2:])}


def test_a_cell_says_what_is_wrong_with_a_plan() -> None:
    assert cell(SOUND) == "0.520 N"  # the larger one of the peaks at and between samples
    assert cell(replace(SOUND, peak=28.54)) == "28.5 N"
    assert cell(replace(SOUND, peak=285.4)) == "285 N"
    assert cell(replace(SOUND, status="violates_limits")) == f"0.520 N, {BREAKS}"
    assert cell(replace(SOUND, status="stopped_early")) == "0.520 N, stopped early"
    assert cell(replace(SOUND, status="unbounded_effort", peak=float("inf"))) == "unbounded, unbounded effort"
    assert cell(replace(SOUND, status=INFEASIBLE)) == NO_PLAN
    assert cell(None) == "–"


def test_a_table_has_a_line_for_each_motion_and_its_own_ways() -> None:
    corner = CORNERS[0]
    rows = [
        replace(SOUND, way=SWITCH_OFF, status=INFEASIBLE),
        SOUND,
        replace(SOUND, way=STEPWISE, peak=99.0),  # no way to cross a singularity
        *(Row(corner.name, way, "N·m", "within_limits", peak=peak, dense_peak=0.0) for way, peak in
          ((STEPWISE, 7.0), (EFFORT, 3.0), (PEAK, 2.0))),
    ]  # fmt: skip
    late = replace(SOUND, way=SWITCH_OFF_LATE, peak=23.0)
    for off, said in (
        (replace(SOUND, way=SWITCH_OFF, peak=28.0), "23.0 N"),
        (replace(SOUND, way=SWITCH_OFF, peak=18.0), "18.0 N"),
        (replace(SOUND, way=SWITCH_OFF, peak=18.0, status="violates_limits"), "23.0 N"),
        (replace(SOUND, way=SWITCH_OFF, status=INFEASIBLE), "23.0 N"),
    ):
        assert cells(headline([SOUND, off, late]).splitlines()[2])[2] == said
    lines = headline(rows).splitlines()
    assert cells(lines[0]) == list(HEADINGS)
    assert cells(lines[2]) == ["2-RPR, line at 0.1 m/s", "–", NO_PLAN, "0.520 N", "–"]
    assert cells(lines[3]) == [corner.title, "–", "7.00 N·m", "3.00 N·m", "2.00 N·m"]
    assert len(lines) == 4


def test_the_readme_shows_every_motion() -> None:
    assert list(shown()) == [task.title for task in TASKS]


def test_the_readme_shows_what_the_job_writes(store: BeyondStore) -> None:
    rows: list[Row] = []
    for task in CHEAP:
        off = (SWITCH_OFF, SWITCH_OFF_LATE) if task.crosses else ()
        rows += [switch_off_row(store, task, way) for way in off] or stepwise_rows(store, task)
        rows += [whole_row(store, task, way, 1.0) for way in (EFFORT, PEAK)]
    written = [cells(line) for line in headline(rows).splitlines()[2:]]
    assert len(written) == len(CHEAP)
    for motion, *found in written:
        for here, there in zip(found, shown()[motion], strict=True):
            assert re.sub(r"[0-9.]+", "#", here) == re.sub(r"[0-9.]+", "#", there), (motion, here, there)
            numbers = [[float(value) for value in re.findall(r"[0-9.]+", text)] for text in (there, here)]
            assert numbers[0] == pytest.approx(numbers[1], rel=ROUNDING), (motion, here, there)


def test_what_the_readme_says_below_the_table(store: BeyondStore) -> None:
    for task in CORNERS[:2]:
        none = stepwise_rows(store, task)[0]
        for best in (whole_row(store, task, way, 1.0) for way in (EFFORT, PEAK)):
            assert best.energy > none.energy
            assert best.rms > none.rms
    for task in (CROSSINGS[0], CROSSINGS[4]):
        off = switch_off_row(store, task)
        assert off.before < 0.5 * off.peak
    calm = whole_row(store, CROSSINGS[0], SMOOTH, 1.0)
    assert calm.worst == pytest.approx(0.222, rel=ROUNDING)
    assert calm.reversals <= 6
    assert whole_row(store, CROSSINGS[0], EFFORT, 1.0).reversals > 25
    assert whole_row(store, CROSSINGS[0], PEAK, 1.0).reversals > 80
