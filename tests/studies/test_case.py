"""Cases: variations, what is planned, and the memo that plans once."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.studies.case import Case, Plans
from redundancy_pin.studies.cases import (
    CORNERS,
    CROSSINGS,
    EFFORT,
    HEAVY_CROSSING,
    MOTIONS,
    REPLAYED,
    SINGULAR,
    TASKS,
    at_speed,
    by_method,
    methods,
    motion_name,
    parked,
    thresholds,
    without_carriers,
)


def test_every_motion_of_the_thesis_is_there_once() -> None:
    names = [case.name for case in MOTIONS]
    assert len(set(names)) == len(names)
    assert {motion_name(case) for case in MOTIONS} == {
        "circle-0.5", "circle-0.75", "line-0.1", "line-0.2", "corner-r0.025", "corner-r0.013", "square",
    }  # fmt: skip
    assert max(case.dt for case in MOTIONS) <= 1e-3
    assert thresholds(MOTIONS[0]) == (5.0, 10.0, 20.0)


def test_cases_are_values() -> None:
    for case in (*CROSSINGS, *CORNERS, *(by_method(task, method) for task in TASKS for method in methods(task))):
        assert hash(case) == hash(replace(case))
        assert pickle.loads(pickle.dumps(case)) == case
    files = [by_method(task, method).name for task in TASKS for method in methods(task) if "whole" in method]
    assert len(set(files)) == len(files)
    assert len({replayed.name for replayed in REPLAYED}) == len(REPLAYED)


def test_a_variation_leaves_its_origin_alone() -> None:
    case = CROSSINGS[0]
    other = case.with_options(threshold=7.0).with_path(speed=0.6)
    assert (case.option("threshold"), case.option("speed")) == (5.0, 0.5)
    assert (other.option("threshold"), other.option("speed"), other.option("ramp_down")) == (7.0, 0.6, 0.03)


def test_at_another_speed_the_ramps_last_as_long() -> None:
    slow, fast = SINGULAR[0], at_speed(SINGULAR[0], 0.8)
    assert fast.option("ramp_length") == pytest.approx(0.5 * 0.8 * 0.2)  # v T / 2
    ramps = [motion.duration - motion.path.length / speed for motion, speed in
             ((slow.trajectory(), 0.5), (fast.trajectory(), 0.8))]  # fmt: skip
    assert ramps == pytest.approx([0.2, 0.2])  # two of T, each T / 2 longer than at full speed


def test_plans_are_made_once_whatever_they_are_called(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[str, str]] = []

    def fails(self: Case, backend: str) -> Plan:
        made.append((self.name, backend))
        raise InfeasiblePlanError("no")

    monkeypatch.setattr(Case, "plan", fails)
    plans, case = Plans(), by_method(SINGULAR[0], EFFORT)
    for named in (case, replace(case, name="other", title="another")):
        for backend in ("a", "b"):
            with pytest.raises(InfeasiblePlanError):
                plans.plan(named, backend)
    assert made == [(case.name, "a"), (case.name, "b")]


def test_prepared_plans_are_those_that_are_made_alone() -> None:
    case, missing = CORNERS[0], HEAVY_CROSSING
    told: list[str] = []
    prepared = Plans()
    prepared.prepare([(one, one.backends[0]) for one in (case, missing, case)], 1, told.append)
    assert len(told) == 3
    np.testing.assert_array_equal(prepared.plan(case).tau, case.plan().tau)
    assert isinstance(prepared.outcome(missing), InfeasiblePlanError)
    assert [one.name for one, _ in prepared.existing([case, missing])] == [case.name]


def test_the_machine_without_carriers_and_with_parked_ones_stand_at_the_same_samples() -> None:
    plans, case = Plans(), CORNERS[0]
    moving, none, still = (plans.plan(one) for one in (case, without_carriers(case), parked(case)))
    assert none.carriers.s.shape[1] == 0
    assert not still.carriers.s.any()
    np.testing.assert_array_equal(none.t, still.t)
    np.testing.assert_array_equal(moving.t[: len(none.t)], none.t)
