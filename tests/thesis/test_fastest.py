"""The bracket of the fastest motion: it holds the border, and a verdict is given only after every first guess."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis import beyond
from redundancy_pin.thesis.beyond import attempt, fastest
from redundancy_pin.thesis.case import Case, Plans
from redundancy_pin.thesis.cases import EFFORT, QUICK, SINGULAR, Race, at_speed, by_method

CIRCLE, LINE = SINGULAR[0], SINGULAR[4]
EXTENT = replace(QUICK, tolerance=0.01, starts=3)


@functools.cache
def plan() -> Plan:
    return by_method(LINE, EFFORT, 8.0).plan()


def speed(case: Case) -> float:
    return float(case.option("speed"))


class Border(Plans):
    """A memo in which a motion has a plan as a rule says."""

    def __init__(
        self, rule: Callable[[Case], bool], constraint: str = "acceleration", given: Plan | None = None
    ) -> None:
        super().__init__()
        self._rule, self._constraint, self._given = rule, constraint, given
        self.wanted: list[Case] = []

    def outcome(self, case: Case, backend: str | None = None) -> Any:
        self.wanted.append(case)
        if self._rule(case):
            return self._given or plan()
        return InfeasiblePlanError("none", constraint=self._constraint, joint="carrier_1", time=0.2, limit=-10.1,
                                   unit="m/s²", fraction=0.01)  # fmt: skip


def slower(record: dict[str, Any]) -> float:
    return float(record["fastest_with_plan"]["speed"])


def faster(record: dict[str, Any]) -> float:
    return float(record["slowest_without"]["speed"])


@pytest.mark.parametrize("border", [0.52, 0.7, 1.234, 3.0])
def test_bracket_holds_the_border(border: float) -> None:
    plans = Border(lambda case: speed(case) <= border)
    record = fastest(plans, CIRCLE, EXTENT)
    assert slower(record) <= border < faster(record)
    assert faster(record) - slower(record) <= 0.01 * slower(record) * (1.0 + 1e-9)
    assert [trial["speed"] for trial in record["trials"]] == sorted({speed(case) for case in plans.wanted})
    assert all(trial["feasible"] == (trial["speed"] <= border) for trial in record["trials"])
    # at the upper end every first guess is tried, with both objectives
    last = [case for case in plans.wanted if speed(case) == faster(record) and case.option("starts") == EXTENT.starts]
    assert {case.option("objective")[0][0] for case in last} == {"effort", "carrier_acceleration"}


def test_a_plan_from_another_guess_moves_the_border() -> None:
    """From parked carriers plans exist up to 1 m/s, from other guesses up to 1.05 m/s."""
    record = fastest(Border(lambda case: speed(case) <= (1.05 if case.option("starts") else 1.0)), CIRCLE, EXTENT)
    assert slower(record) > 1.0
    assert faster(record) > 1.05


@pytest.mark.parametrize("enough", [True, False])
def test_whether_the_wider_limit_suffices(enough: bool) -> None:
    plans = Border(lambda case: speed(case) <= 0.6 or (enough and case.option("acceleration") is not None))
    assert fastest(plans, CIRCLE, EXTENT)["suffices"] is enough
    wider = [case.option("acceleration") for case in plans.wanted if case.option("acceleration")]
    assert wider == [pytest.approx(1.01 * 10.1)]


def test_efforts_of_a_capped_race_are_those_until_the_motors_are_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beyond, "fastest", lambda plans, task, extent, effort=np.inf: {"effort": effort})
    switched = CIRCLE.plan()
    off = switched.t[switched.phase == switched.phases.index("off")][0]
    capped = beyond.run_race(Race(CIRCLE, capped=True), EXTENT)["effort"]
    assert capped == np.abs(switched.tau[switched.t < off]).max()
    assert beyond.run_race(Race(CIRCLE), EXTENT)["effort"] == np.inf


def test_an_unsound_plan_is_none() -> None:
    broken = replace(plan(), status=ResultStatus.LIMIT_VIOLATED)
    trial = attempt(Border(lambda case: True, given=broken), by_method(CIRCLE, EFFORT))
    assert not trial["feasible"]
    assert trial["status"] == "limit_violated"


@pytest.mark.long
def test_the_real_border_of_the_circle() -> None:
    record = fastest(Plans(), at_speed(CIRCLE, 1.4), replace(QUICK, tolerance=0.2, starts=1))
    assert record["slowest_without"]["constraint"] == "acceleration"
    # the limit that would suffice grows with the speed beyond the border
    fractions = [trial["fraction"] for trial in record["trials"] if not trial["feasible"]]
    assert fractions[0] > 0.0
    assert np.all(np.diff(fractions) > 0.0)
