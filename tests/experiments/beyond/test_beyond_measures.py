"""Numbers read off plans: reversals, peaks between samples, differences, trade-off."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from redundancy_pin.experiments.beyond.between import peak_at_rest, peak_of_switch_off
from redundancy_pin.experiments.beyond.cases import SwitchOff, Whole, whole
from redundancy_pin.experiments.beyond.optimality import backend_row
from redundancy_pin.experiments.beyond.rows import reversals, row_of, row_without
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.tasks import CORNERS, CROSSINGS
from redundancy_pin.experiments.beyond.tradeoff import trade
from redundancy_pin.experiments.planned.store import PlanStore

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.switch_off import plan_switch_off

LINE = CROSSINGS[4]
T = np.linspace(0.0, 1.0, 1001)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return whole(LINE, "effort", 8.0).plan("virtual-work")


def with_efforts(plan: Plan, *columns: Array) -> Plan:
    return replace(plan, tau=np.stack(columns, axis=1))


def test_reversals_count_turns_and_not_ripple(plan: Plan) -> None:
    ripple = 0.01 * np.sin(200.0 * np.pi * T)  # 2 % of the peak from top to bottom
    swing = np.sin(10.0 * np.pi * T)  # five maxima and five minima
    assert reversals(with_efforts(plan, swing, 0.5 * swing)).tolist() == [10, 10]
    assert reversals(with_efforts(plan, T + ripple, swing)).tolist() == [0, 10]
    assert reversals(with_efforts(plan, 0.0 * T, 0.0 * T)).tolist() == [0, 0]


def test_switch_off_between_its_samples_is_what_finer_samples_show() -> None:
    task = CROSSINGS[0]
    coarse = SwitchOff(task, task.threshold).plan("virtual-work")
    fine = plan_switch_off(task.machine.dynamics(), task.trajectory(), threshold=5.0, ramp_down=0.03, return_time=0.4,
                           dt=2.5e-4)  # fmt: skip
    peak = peak_of_switch_off(task.machine.dynamics("rnea"), task.trajectory(), coarse)
    # curvature of τ at its peak: both grids see it to better than 1e-4
    assert peak == pytest.approx(float(np.nanmax(np.abs(fine.tau))), rel=1e-4)


def test_motors_that_are_off_need_no_force() -> None:
    task = CROSSINGS[0]
    plan = SwitchOff(task, task.threshold).plan("virtual-work")
    off = np.flatnonzero(plan.phase == plan.phases.index("off"))[3:-3]
    carriers = plan.carriers
    sdd = np.array(carriers.sdd)
    sdd[off] += 1e3  # would ask for forces of kilonewtons, were the motors on
    shaken = replace(plan, carriers=CarrierMotion(carriers.s, carriers.sd, sdd))
    found = (peak_of_switch_off(task.machine.dynamics(), task.trajectory(), each) for each in (plan, shaken))
    assert next(found) == next(found)


def test_row_of_a_switch_off_plan_has_the_force_before_it_is_off() -> None:
    plan = SwitchOff(CROSSINGS[0], 5.0).plan("virtual-work")
    row = row_of("circle", "off", "N", plan, 0.0)
    off = plan.phase == plan.phases.index("off")
    assert row.before == np.abs(plan.tau[plan.t < plan.t[off][0]]).max()
    assert row.before < row.peak
    assert "track of carrier_1 by" in row.broken
    assert not row.sound


def test_peak_at_rest_of_a_point_mass_by_hand() -> None:
    """Without carriers the 3-RRR's torques at the corner are known: 3.03 N·m at r = 0.025 m."""
    task = CORNERS[0]
    assert peak_at_rest(task.machine.dynamics(carriers=False), task.trajectory(), 5e-3) == pytest.approx(3.03, abs=0.01)
    parked = peak_at_rest(task.machine.dynamics("rnea"), task.trajectory(), 5e-3)
    assert parked > 3.0 * 3.03  # three carriers of 3 kg


def test_a_missing_plan_carries_its_force() -> None:
    error = InfeasiblePlanError("no", constraint="singular_pose", amount=0.25)
    assert row_without("a", "b", "N", error).missing == 0.25
    assert np.isnan(row_without("a", "b", "N", InfeasiblePlanError("no", constraint="track", amount=0.25)).missing)
    assert row_without("a", "b", "N", error).as_dict()["peak"] is None


class Given(BeyondStore):
    """A store that has what it is given."""

    def __init__(self, **found: Plan | InfeasiblePlanError) -> None:
        super().__init__(PlanStore())
        self._found = found

    def outcome(self, case: Any, backend: str) -> Plan | InfeasiblePlanError:
        return self._found[backend.replace("-", "_")]


def test_differences_of_backends_are_found(plan: Plan) -> None:
    case = whole(LINE, "effort", 8.0)
    same = backend_row(Given(virtual_work=plan, rnea=plan), case)
    assert same.same
    assert same.worst == 0.0
    off = replace(plan, tau=plan.tau * (1.0 + 1e-5))
    found = backend_row(Given(virtual_work=plan, rnea=off), case)
    assert not found.same
    assert found.tau == pytest.approx(1e-5, rel=1e-3)
    none = backend_row(Given(virtual_work=plan, rnea=InfeasiblePlanError("no")), case)
    assert not none.same
    assert none.as_dict()["worst"] is None


def test_store_plans_once_and_keeps_failures(monkeypatch: pytest.MonkeyPatch) -> None:
    count: list[str] = []

    def plan_it(self: Whole, backend: str) -> Plan:
        count.append(backend)
        raise InfeasiblePlanError("no")

    monkeypatch.setattr(Whole, "plan", plan_it)
    store = BeyondStore(PlanStore())
    for backend in ("a", "a", "b"):
        with pytest.raises(InfeasiblePlanError):
            store.plan(whole(LINE, "effort"), backend)
    assert count == ["a", "b"]


def test_trade_off_is_ordered_and_says_when_not() -> None:
    found = trade(BeyondStore(PlanStore()), CORNERS[0], (1e-2, 1.0, 100.0), 6.0)
    assert found.monotone
    assert found.points[0].rms_effort < found.points[-1].rms_effort
    assert found.points[0].rms_acceleration > found.points[-1].rms_acceleration
    assert not replace(found, points=found.points[::-1]).monotone
    raised = replace(found.points[1], rms_acceleration=2.0 * found.points[0].rms_acceleration)
    assert not replace(found, points=(found.points[0], raised, *found.points[2:])).monotone
