"""Cases: their motions and variations, the memo that plans once, and numbers read off plans."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.thesis.cases import (
    CORNERS,
    EFFORT,
    FULL,
    FUTURE,
    HEAVY_CROSSING,
    MOTIONS,
    QUICK,
    SINGULAR,
    TASKS,
    TURNS,
    Plans,
    at_speed,
    by_method,
    call_of,
    methods,
    motion_name,
    parked,
    without_carriers,
)
from redundancy_pin.thesis.measures import numbers
from redundancy_pin.thesis.table import Table, span, table, text

CIRCLE, LINE, CORNER = SINGULAR[0], SINGULAR[4], TURNS[0]


def test_every_motion_of_the_thesis_is_there_once() -> None:
    names = [case.name for case in MOTIONS]
    assert len(set(names)) == len(names)
    assert {motion_name(case) for case in MOTIONS} == {
        "circle-0.5", "circle-0.75", "line-0.1", "line-0.2", "corner-r0.025", "corner-r0.013", "square",
    }  # fmt: skip
    assert max(case.dt for case in MOTIONS) <= 1e-3
    files = [by_method(task, method).name for task in TASKS for method in methods(task)[-3:]]
    assert len(set(files)) == len(files)


def test_a_quick_run_is_a_part_of_the_full_one() -> None:
    assert not QUICK.complete
    assert FULL.complete
    assert set(QUICK.chapters) == set(FULL.chapters)
    assert {case.name for case in QUICK.motions} < {case.name for case in FULL.motions}
    assert not QUICK.ratios  # no trade-off
    assert set(QUICK.future) < set(FULL.future) == set(FUTURE)
    for part in ("parity", "modes", "started", "races", "compared"):
        assert set(getattr(QUICK, part)) < set(getattr(FULL, part))


def test_at_another_speed_the_ramps_last_as_long() -> None:
    slow, fast = CIRCLE, at_speed(CIRCLE, 0.8)
    assert fast.option("ramp_length") == pytest.approx(0.5 * 0.8 * 0.2)  # v T / 2
    ramps = [motion.duration - motion.path.length / speed for motion, speed in
             ((slow.trajectory(), 0.5), (fast.trajectory(), 0.8))]  # fmt: skip
    assert ramps == pytest.approx([0.2, 0.2])  # two of T, each T / 2 longer than at full speed


def test_prepared_plans_are_those_that_are_made_alone() -> None:
    case, missing = CORNERS[0], HEAVY_CROSSING
    told: list[str] = []
    prepared = Plans()
    prepared.prepare(map(call_of, (case, missing, replace(case, name="other"))), 1, told.append)
    assert len(told) == 2  # cases that differ in their names share a plan
    np.testing.assert_array_equal(prepared.plan(case).tau, case.plan().tau)
    assert isinstance(prepared.outcome(missing), InfeasiblePlanError)
    assert prepared.plan(case) is prepared.plan(case)


def test_the_machine_without_carriers_and_with_parked_ones_stand_at_the_same_samples() -> None:
    """Without carriers the 3-RRR's torques at the corner are known: 3.03 N·m at r = 0.025 m."""
    moving, none, still = (case.plan() for case in (CORNER, without_carriers(CORNER), parked(CORNER)))
    assert none.carriers.s.shape[1] == 0
    assert not still.carriers.s.any()
    np.testing.assert_array_equal(none.t, still.t)
    np.testing.assert_array_equal(moving.t[: len(none.t)], none.t)
    assert none.peak_effort.max() == pytest.approx(3.03, abs=0.01)
    assert still.peak_effort.max() > 3.0 * 3.03  # three carriers of 3 kg


def test_numbers_of_a_switch_off_plan() -> None:
    plan = CIRCLE.plan()
    shown, off = numbers(plan), plan.phase == plan.phases.index("off")
    assert shown["before"] == np.abs(plan.tau[plan.t < plan.t[off][0]]).max()
    assert shown["before"] < shown["peak"] == np.nanmax(np.abs(plan.tau))
    assert "track of carrier_1 by" in shown["broken"]


def test_reversals_count_turns_and_not_ripple() -> None:
    t, whole = np.linspace(0.0, 1.0, 1001), by_method(LINE, EFFORT, 8.0).plan()
    assert np.isnan(numbers(whole)["before"])
    ripple = 0.01 * np.sin(200.0 * np.pi * t)  # 2 % of the peak from top to bottom
    swing = np.sin(10.0 * np.pi * t)  # five maxima and five minima, at 0.05, 0.15, ... 0.95 s

    def with_efforts(*columns: np.ndarray) -> list[int]:
        # two of the turns are near a singularity
        plan = replace(whole, tau=np.stack(columns, axis=1), margin=np.where(t < 0.2, 0.04, 0.06))
        return [*plan.reversals.tolist(), *plan.reversals_near_singularities.tolist()]

    assert with_efforts(swing, 0.5 * swing) == [10, 10, 2, 2]
    assert with_efforts(t + ripple, swing)[:2] == [0, 10]
    assert with_efforts(0.0 * t, 0.0 * t) == [0, 0, 0, 0]


@pytest.mark.long
def test_switch_off_between_its_samples_is_what_finer_samples_show() -> None:
    fine = replace(CIRCLE, dt=2.5e-4).plan("rnea")
    # curvature of τ at its peak: both grids see it to better than 1e-4
    assert CIRCLE.plan().peak_effort.max() == pytest.approx(float(np.nanmax(np.abs(fine.tau))), rel=1e-4)


def test_tables_as_markdown_and_on_a_terminal() -> None:
    shown = Table(("name", "tau", "file"), ("name", "|torque|", "file"), (("a|b", "1.00, –", "[run](a.csv)"),), "title")
    assert shown.markdown().splitlines() == [
        "| name | \\|torque\\| | file |",
        "| --- | --- | --- |",
        "| a\\|b | 1.00, – | [run](a.csv) |",
    ]
    assert shown.only("file").rows == (("[run](a.csv)",),)
    assert [list(column.cells) for column in shown.terminal().columns] == [["a|b"], ["1.00, –"], ["run"]]


def test_cells_show_numbers_that_do_not_exist() -> None:
    assert text((1.0, math.nan), ".2f") == "1.00, –"
    assert [text(value) for value in (math.inf, True, np.bool_(False), None)] == ["unbounded", "yes", "no", "–"]
    assert [span(values) for values in ([2.0, math.nan, 1.0], [1.0, 1.0001], [math.nan])] == ["1 to 2", "1", "–"]
    (row,) = table(
        "fastest", [{"fastest_with_plan": {"speed": 1.25}, "slowest_without": None, "a.b": 3}], more=["a.b"]
    ).rows
    assert (row[1], row[5], row[-1]) == ("1.250", "–", "3")
