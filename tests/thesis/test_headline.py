"""The headline table: what its cells show, and that the README shows what the job writes."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import Any

import pytest

from redundancy_pin.thesis.beyond import INFEASIBLE, headline, plan_record
from redundancy_pin.thesis.cases import (
    EFFORT,
    NONE,
    PEAK,
    SINGULAR,
    SMOOTH,
    STEPWISE,
    SWITCH_OFF,
    SWITCH_OFF_LATE,
    TASKS,
    TURNS,
    Case,
    Plans,
    crosses,
)
from redundancy_pin.thesis.claims import BREAKS, NO_PLAN, peak_text

README = Path(__file__).resolve().parents[2] / "README.md"

ROUNDING = 0.01
"""Three digits are shown, and a solver that takes another path to the optimum refines another grid."""

CHEAP = (SINGULAR[4], TURNS[0])
"""Motions that are planned again each time: a crossing and a corner."""

MORE = (SINGULAR[0], SINGULAR[2], SINGULAR[5], TURNS[1])
"""Motions of ``make long``; the others take as long as all of these."""

PLANS = Plans()
record = functools.cache(functools.partial(plan_record, PLANS))


def row(task: str, method: str, worst: float, status: str = "ok", unit: str = "N") -> dict[str, Any]:
    return {"task": task, "way": method, "unit": unit, "worst": worst, "status": status,
            "exists": status != INFEASIBLE, "sound": status == "ok"}  # fmt: skip


def cells(line: str) -> list[str]:
    return [part.strip() for part in line.strip().strip("|").split("|")]


def in_readme() -> list[list[str]]:
    """The table of the README: cells by line."""
    text = README.read_text(encoding="utf-8")
    (table,) = re.findall(r"results/headline\.md -->\n(.*?)<!-- end of headline -->", text, flags=re.DOTALL)
    return [cells(line) for line in table.strip().splitlines()]


def test_a_cell_shows_what_is_wrong_with_a_plan() -> None:
    shown = {0.52: "0.520 N", 28.54: "28.5 N", 285.4: "285 N"}
    for worst, text in shown.items():
        assert peak_text(row("a", EFFORT, worst)) == text
    assert peak_text(row("a", EFFORT, 0.52, "limit_violated")) == f"0.520 N, {BREAKS}"
    assert peak_text(row("a", EFFORT, 0.52, "not_converged")) == "0.520 N, not converged"
    assert peak_text(row("a", EFFORT, float("inf"), "unbounded")) == "unbounded"
    assert peak_text(row("a", EFFORT, 0.52, INFEASIBLE)) == NO_PLAN
    assert peak_text(None) is None


@pytest.mark.parametrize(
    ("off", "late", "shown"),
    [
        ((28.0, "ok"), 23.0, "23.0 N"),
        ((18.0, "ok"), 23.0, "18.0 N"),
        ((18.0, "limit_violated"), 23.0, "23.0 N"),
        ((0.0, INFEASIBLE), 23.0, "23.0 N"),
    ],
)
def test_the_best_plan_of_the_thesis_is_shown(off: tuple[float, str], late: float, shown: str) -> None:
    rows = [row("line-0.1", EFFORT, 0.52), row("line-0.1", SWITCH_OFF, *off), row("line-0.1", SWITCH_OFF_LATE, late)]
    assert cells(headline(rows).markdown().splitlines()[2])[2] == shown


@pytest.mark.parametrize("tasks", [CHEAP, pytest.param(MORE, marks=pytest.mark.long)], ids=["cheap", "more"])
def test_the_readme_shows_what_the_job_writes(tasks: tuple[Case, ...]) -> None:
    shown = {motion: rest for motion, *rest in in_readme()[2:]}
    assert list(shown) == [task.title for task in TASKS]
    rows = []
    for task in tasks:
        thesis = (SWITCH_OFF, SWITCH_OFF_LATE) if crosses(task) else (NONE, STEPWISE)
        rows += [record(task, method) for method in (*thesis, EFFORT, PEAK)]
    written = [cells(line) for line in headline(rows).markdown().splitlines()[2:]]
    assert len(written) == len(tasks)
    for motion, *values in written:
        for here, there in zip(values, shown[motion], strict=True):
            assert re.sub(r"[0-9.]+", "#", here) == re.sub(r"[0-9.]+", "#", there), (motion, here, there)
            numbers = [[float(value) for value in re.findall(r"[0-9.]+", text)] for text in (there, here)]
            assert numbers[0] == pytest.approx(numbers[1], rel=ROUNDING), (motion, here, there)


@pytest.mark.parametrize("task", [TURNS[0], pytest.param(TURNS[1], marks=pytest.mark.long)], ids=["wide", "sharp"])
def test_what_the_readme_tells_of_corners(task: Case) -> None:
    none = record(task, NONE)
    for best in (record(task, EFFORT), record(task, PEAK)):
        assert best["energy"] > none["energy"]
        assert best["rms"] > none["rms"]


@pytest.mark.long
def test_what_the_readme_tells_of_calm_efforts() -> None:
    calm = record(SINGULAR[0], SMOOTH)
    assert calm["worst"] == pytest.approx(0.222, rel=ROUNDING)
    assert calm["reversals"] <= 6
    assert record(SINGULAR[0], EFFORT)["reversals"] > 25
    assert record(SINGULAR[0], PEAK)["reversals"] > 80
