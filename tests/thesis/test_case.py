"""Cases: variations, what is planned, and the memo that plans once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.thesis.case import Case, Plans, call_of, options
from redundancy_pin.thesis.cases import (
    CORNERS,
    HEAVY_CROSSING,
    MOTIONS,
    SINGULAR,
    at_speed,
    motion_name,
    parked,
    read_case,
    without_carriers,
)


def test_every_motion_of_the_thesis_is_there_once() -> None:
    names = [case.name for case in MOTIONS]
    assert len(set(names)) == len(names)
    assert {motion_name(case) for case in MOTIONS} == {
        "circle-0.5", "circle-0.75", "line-0.1", "line-0.2", "corner-r0.025", "corner-r0.013", "square",
    }  # fmt: skip
    assert max(case.dt for case in MOTIONS) <= 1e-3


def test_a_case_is_read_with_the_keys_of_a_problem_file() -> None:
    entry = {
        "robot": "five_bar",
        "set": {"carriers": True},
        "working_mode": "+-",
        "trajectory": {"name": "line", "speed": 0.1},
        "planner": "switch_off",
        "threshold": 5.0,
        "dt": 0.01,
        "title": "descent",
    }
    read = Case("a", "five_bar", "line", options(speed=0.1), "switch_off", options(threshold=5.0), (1, -1))
    assert read_case("a", entry) == replace(read, arguments=options(carriers=True), dt=0.01, title="descent")
    assert read_case("a", {"robot": "2rpr", "trajectory": {"name": "circle"}}).planner == "parked"


def test_at_another_speed_the_ramps_last_as_long() -> None:
    slow, fast = SINGULAR[0], at_speed(SINGULAR[0], 0.8)
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
    plans, case = Plans(), CORNERS[0]
    moving, none, still = (plans.plan(one) for one in (case, without_carriers(case), parked(case)))
    assert none.carriers.s.shape[1] == 0
    assert not still.carriers.s.any()
    np.testing.assert_array_equal(none.t, still.t)
    np.testing.assert_array_equal(moving.t[: len(none.t)], none.t)
