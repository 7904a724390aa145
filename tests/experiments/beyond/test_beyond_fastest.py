"""The bracket of the fastest motion: it holds the border, and a verdict is given only after every first guess."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from redundancy_pin.experiments.beyond.cases import Whole, whole
from redundancy_pin.experiments.beyond.fastest import GROWTH, attempt, fastest
from redundancy_pin.experiments.beyond.settings import QUICK
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.tasks import CROSSINGS
from redundancy_pin.experiments.planned.store import PlanStore

from redundancy_pin import plan_whole_trajectory
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.whole_trajectory_solver import Solver

CIRCLE, LINE = CROSSINGS[0], CROSSINGS[4]
SETTINGS = replace(QUICK, tolerance=0.01, starts=3)


class Border(BeyondStore):
    """A store in which a motion has a plan as a rule says."""

    def __init__(self, plan: Plan, rule: Callable[[Whole], bool], constraint: str = "acceleration") -> None:
        super().__init__(PlanStore())
        self._plan, self._rule, self._constraint = plan, rule, constraint
        self.asked: list[Whole] = []

    def outcome(self, case: Any, backend: str) -> Plan | InfeasiblePlanError:
        self.asked.append(case)
        if self._rule(case):
            return self._plan
        return InfeasiblePlanError("none", constraint=self._constraint, carrier="carrier_1", time=0.2, limit=-10.1,
                                   unit="m/s²", fraction=0.01)  # fmt: skip


@pytest.fixture(scope="module")
def plan() -> Plan:
    return whole(LINE, "effort", 8.0).plan("virtual-work")


@pytest.mark.parametrize("border", [0.52, 0.7, 1.234, 3.0])
def test_bracket_holds_the_border(plan: Plan, border: float) -> None:
    store = Border(plan, lambda case: case.task.speed <= border)
    found = fastest(store, CIRCLE, SETTINGS)
    assert found.faster is not None
    assert found.slower.speed <= border < found.faster.speed
    assert found.faster.speed - found.slower.speed <= 0.01 * found.slower.speed * (1.0 + 1e-9)
    assert [trial.speed for trial in found.trials] == sorted({case.task.speed for case in store.asked})
    assert all(trial.feasible == (trial.speed <= border) for trial in found.trials)


def test_the_verdict_needs_every_first_guess_and_both_objectives(plan: Plan) -> None:
    store = Border(plan, lambda case: case.task.speed <= 1.0)
    found = fastest(store, CIRCLE, SETTINGS)
    assert found.faster is not None
    last = [case for case in store.asked if case.task.speed == found.faster.speed and case.starts == SETTINGS.starts]
    assert {case.objective[0][0] for case in last} == {"effort", "carrier_acceleration"}


def test_a_plan_from_another_guess_moves_the_border(plan: Plan) -> None:
    """From parked carriers plans exist up to 1 m/s, from other guesses up to 1.05 m/s."""
    found = fastest(Border(plan, lambda case: case.task.speed <= (1.05 if case.starts > 1 else 1.0)), CIRCLE, SETTINGS)
    assert found.slower.speed > 1.0
    assert found.faster is not None
    assert found.faster.speed > 1.05


def test_no_border_below_what_the_ramps_allow(plan: Plan) -> None:
    found = fastest(Border(plan, lambda case: True), LINE, SETTINGS)
    assert found.faster is None
    assert found.slower.speed <= 1.105 < found.slower.speed * GROWTH  # a path of 1.1045 m, two ramps of v / 2


def test_out_of_time_is_no_verdict_on_limits(plan: Plan) -> None:
    found = fastest(Border(plan, lambda case: case.task.speed <= 0.6, "seconds"), CIRCLE, SETTINGS)
    assert found.faster is not None
    assert found.faster.constraint == "seconds"
    assert found.suffices is None


def test_whether_the_wider_limit_suffices(plan: Plan) -> None:
    for enough in (True, False):
        store = Border(plan, lambda case, enough=enough: case.task.speed <= 0.6 or (  # type: ignore[misc]
            enough and case.acceleration is not None))  # fmt: skip
        found = fastest(store, CIRCLE, SETTINGS)
        assert found.suffices is enough
        assert [case.acceleration for case in store.asked if case.acceleration] == [pytest.approx(1.01 * 10.1)]


def test_an_unsound_plan_is_none(plan: Plan) -> None:
    from redundancy_pin.planners.plan import PlanStatus

    broken = replace(plan, status=PlanStatus.VIOLATES_LIMITS)
    trial = attempt(Border(broken, lambda case: True), whole(CIRCLE, "effort"))
    assert not trial.feasible
    assert trial.status == "violates_limits"


def test_the_planner_tries_every_first_guess_before_it_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: set[bytes] = set()
    original = Solver.solve

    def watched(self: Solver, guess: Any, *others: Any, **named: Any) -> Any:
        if set(guess) <= {"s", "sd", "sdd"}:  # later ones start from solutions, which have efforts as well
            tried.add(np.asarray(guess["s"]).tobytes())
        return original(self, guess, *others, **named)

    monkeypatch.setattr(Solver, "solve", watched)
    fast = replace(CIRCLE, speed=2.5)
    with pytest.raises(InfeasiblePlanError):
        plan_whole_trajectory(fast.machine.dynamics(), fast.trajectory(), dt=0.03, starts=3)
    assert len(tried) == 3


def test_the_real_border_of_the_circle() -> None:
    """A necessary condition, by hand: with parked carriers each leg's force would be that of the compatibility."""
    settings = replace(QUICK, tolerance=0.2, starts=1)
    found = fastest(BeyondStore(PlanStore()), replace(CIRCLE, speed=1.4), settings)
    assert found.faster is not None
    assert found.faster.constraint == "acceleration"
    assert found.faster.fraction > 0.0
    # the limit that would suffice grows with the speed beyond the border
    failed = [trial for trial in found.trials if not trial.feasible]
    assert np.all(np.diff([trial.fraction for trial in failed]) > 0.0)
