"""The chapter on the thesis's planners on a small scale: its numbers against rebuilds, its verdicts against numbers."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import quick_results

from redundancy_pin.errors import CrossCheckError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.thesis.cases import CORNERS, MOVING, NONE, Case, Plans, parked, without_carriers
from redundancy_pin.thesis.claims import NOT_JUDGED
from redundancy_pin.thesis.in_words import IN_WORDS, runs_of
from redundancy_pin.thesis.planned import plan_parity
from redundancy_pin.thesis.statements import thesis

chapter = functools.partial(quick_results.chapter, "planned")

# verdicts of claims in words, where the answer is known from plans made without this study
KNOWN = {
    "no_limit": {(1, 1, 1): False, (-1, -1, -1): True},
    "cured_by_acceleration": {(1, 1, 1): False, (-1, -1, -1): True},
    "sharp_exceeds": {(1, 1, 1): True, (-1, -1, -1): True},
    "wide_half": {(1, 1, 1): False, (-1, -1, -1): True},
}


@pytest.mark.long
def test_every_statement_has_a_verdict() -> None:
    records = chapter()["against_thesis"]
    assert {record["row"] for record in records} == set(thesis()["rows"])
    assert len(records) == len(thesis()["planned"]) + len(IN_WORDS) + 2  # two are about several runs
    for record in records:
        assert record["stated"]
        assert record["ours"]
        assert record["reason"] or record["verdict"] == "reproduced", record
    # only what a full run cannot cure differs in one with two of the working modes
    assert {record["quantity"] for record in records if record["verdict"] == "differs"} == {
        "carrier 2 first meets its speed limit [s]"
    }
    assert {record["verdict"] for record in records} == {"reproduced", "differs", NOT_JUDGED}


@pytest.mark.long
def test_backends_plan_the_same() -> None:
    worst = [record["worst"] for record in chapter()["parity"]]
    assert max(worst) < 1e-8
    assert max(worst) > 0.0  # not one backend twice


def test_plans_that_differ_stop_the_chapter() -> None:
    class Off(Plans):
        def outcome(self, case: Case, backend: str | None = None) -> Any:
            plan = super().outcome(case, "virtual-work")
            return replace(plan, tau=plan.tau * (1.0 + 1e-6)) if backend == "rnea" and isinstance(plan, Plan) else plan

    with pytest.raises(CrossCheckError, match="differ by 1e-06"):
        plan_parity(Off(), CORNERS[0])


@pytest.mark.long
def test_the_track_is_left_where_it_is_left() -> None:
    """Rebuilt elsewhere: carrier 1 is at 0.247 m (0.5 m/s) and 0.260 m (0.75 m/s) as actuators are switched on."""
    records = {record["case"]: record for record in chapter()["crossings"]}
    assert records["circle-0.5-cn5"]["status"] == "limit_violated"
    assert records["circle-0.5-cn5"]["beyond_track_at_exit"] == pytest.approx(0.047, abs=5e-4)
    assert records["circle-0.75-cn5"]["beyond_track_at_exit"] == pytest.approx(0.060, abs=5e-4)
    assert records["circle-0.5-cn20"]["beyond_track"] == 0.0
    assert np.isnan(records["circle-0.5-cn5"]["shortest"])
    assert "No return of the carriers" in records["circle-0.5-cn5"]["no_shortest"]
    assert chapter()["heavy_end_effector"]["details"]["amount"] > 0.0


@pytest.mark.long
def test_ranges_contain_the_run_they_vary() -> None:
    records = chapter()["sensitivity"]
    for record in records:
        assert record["low"] <= record["high"] or np.isnan(record["low"])
    by_mode = [record for record in records if record["parameter"] == "working mode" and not np.isnan(record["ours"])]
    assert by_mode
    for record in by_mode:  # the run's own mode is on the grid
        assert record["low"] - 1e-12 <= record["ours"] <= record["high"] + 1e-12


@pytest.mark.long
def test_actuators_do_at_least_the_work_that_the_platform_gains_and_loses() -> None:
    """Without gravity ∫ Σ |power| dt is no less than the total variation of the kinetic energy."""
    plans = quick_results.reproduction("planned").results.plans
    for record in chapter()["fair_comparison"]:
        if record["motion"].startswith("corner") and not record["what"].startswith(MOVING):
            case = next(case for case in CORNERS if case.name.startswith(record["motion"]))
            case = (without_carriers if record["what"] == NONE else parked)(replace(case, working_mode=record["mode"]))
            energy = case.dynamics("rnea").along(plans.plan(case).motion).energy()
            assert record["energy"] >= np.abs(np.diff(energy)).sum() * (1.0 - 1e-3)  # trapezoids of 5 ms


@pytest.mark.parametrize("mode", [(1, 1, 1), pytest.param((-1, -1, -1), marks=pytest.mark.long)])
def test_known_answers_in_a_working_mode(mode: tuple[int, ...]) -> None:
    runs, tests = runs_of(Plans(), mode), {statement.name: statement.test for statement in IN_WORDS}
    for name, answers in KNOWN.items():
        holds, number = tests[name](runs)
        assert holds == answers[mode], (name, number)
    for run in runs.values():
        np.testing.assert_array_equal(run.plan.t[: len(run.baseline.t)], run.baseline.t)
        assert run.accelerating.sum() > 20
