"""Numbers read off plans: reversals, peaks between samples, differences."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from redundancy_pin.arrays import Array
from redundancy_pin.planners.plan import Plan
from redundancy_pin.thesis.cases import EFFORT, SINGULAR, TURNS, by_method, parked, without_carriers
from redundancy_pin.thesis.measures import numbers

CIRCLE, LINE, CORNER = SINGULAR[0], SINGULAR[4], TURNS[0]
T = np.linspace(0.0, 1.0, 1001)


@functools.cache
def switched_off() -> Plan:
    return CIRCLE.plan()


@functools.cache
def whole() -> Plan:
    return by_method(LINE, EFFORT, 8.0).plan()


def with_efforts(*columns: Array) -> Plan:
    return replace(whole(), tau=np.stack(columns, axis=1))


def test_reversals_count_turns_and_not_ripple() -> None:
    ripple = 0.01 * np.sin(200.0 * np.pi * T)  # 2 % of the peak from top to bottom
    swing = np.sin(10.0 * np.pi * T)  # five maxima and five minima
    assert with_efforts(swing, 0.5 * swing).reversals.tolist() == [10, 10]
    assert with_efforts(T + ripple, swing).reversals.tolist() == [0, 10]
    assert with_efforts(0.0 * T, 0.0 * T).reversals.tolist() == [0, 0]


def test_only_turns_beside_singularities_are_told_as_such() -> None:
    swing = np.sin(10.0 * np.pi * T)  # turns at 0.05, 0.15, ... 0.95 s
    plan = replace(with_efforts(swing, swing), margin=np.where(T < 0.2, 0.04, 0.06))  # two of them beside one
    assert plan.reversals_near_singularities.tolist() == [2, 2]


@pytest.mark.long
def test_switch_off_between_its_samples_is_what_finer_samples_show() -> None:
    fine = replace(CIRCLE, dt=2.5e-4).plan("rnea")
    # curvature of τ at its peak: both grids see it to better than 1e-4
    assert switched_off().peak_effort.max() == pytest.approx(float(np.nanmax(np.abs(fine.tau))), rel=1e-4)


def test_numbers_of_a_switch_off_plan() -> None:
    plan, shown = switched_off(), numbers(switched_off())
    off = plan.phase == plan.phases.index("off")
    assert shown["before"] == np.abs(plan.tau[plan.t < plan.t[off][0]]).max()
    assert shown["before"] < shown["peak"] == np.nanmax(np.abs(plan.tau))
    assert "track of carrier_1 by" in shown["broken"]
    assert np.isnan(numbers(whole())["before"])


def test_peak_at_rest_by_hand() -> None:
    """Without carriers the 3-RRR's torques at the corner are known: 3.03 N·m at r = 0.025 m."""
    none, still = without_carriers(CORNER), parked(CORNER)
    assert none.plan().peak_effort.max() == pytest.approx(3.03, abs=0.01)
    assert still.plan().peak_effort.max() > 3.0 * 3.03  # three carriers of 3 kg
