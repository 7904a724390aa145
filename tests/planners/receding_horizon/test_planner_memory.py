"""What machine code reads of Python's memory, and when: types of numbers, copies, plans that are given back."""

from __future__ import annotations

import copy
import pickle
import shlex
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.machine_code import CACHE, find_compiler
from redundancy_pin.planners.receding_horizon import Preview, RecedingHorizon, Weights
from redundancy_pin.status import UpdateStatus

STEP = 0.02

ROUNDING = 1e-7
"""m, m/s and m/s²: Newton's method closes the loops from what was asked for last, so that no two planners have the same
rounding; the solver stops at 1e-9 in units of up to 10, and W⁻¹ magnifies both."""

FLAT = 2e-5, 2e-4, 5e-3
"""m, m/s and m/s²: two solutions of one programme, begun at different points, whose cost is next to flat: 1.3e-3 in s̈,
of which the limit is 10."""

FEW = {0.005: 5.2, 0.02: 7.1}
"""Steps of the interior point method a tick, by its period in s: 4.8 and 6.7; 5.9 and 7.6 where duals are taken from
wrong nodes, 6.6 and 9.3 without the corrector's terms of second order, 8.0 and 9.3 where nothing is remembered."""

CIRCLE = rp.trajectory.reference.circle(speed=0.3)


@cache
def dynamics() -> Dynamics:
    return rp.CompiledDynamics(rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3))


def after(planner: RecedingHorizon, motion: object, ticks: int) -> RecedingHorizon:
    for i in range(ticks):
        planner.update(STEP * i, motion)
    return planner


def assert_same(own: RecedingHorizon, other: RecedingHorizon, tolerance: float = ROUNDING) -> None:
    for one, two in zip(own.updates.last.at, other.updates.last.at, strict=True):
        np.testing.assert_allclose(one, two, rtol=0.0, atol=tolerance)


def test_whole_numbers_as_weights_are_the_same_weights() -> None:
    whole = (1, 1, 0, 1, 1, 1, 1, 1, 10000)
    planners = [
        after(RecedingHorizon(dynamics(), objective=w), CIRCLE, 12)
        for w in (Weights(*whole), Weights(*map(float, whole)))
    ]
    assert_same(*planners)
    assert planners[0].updates.last.command.peak < 1.0  # 0.64 N, and 6.7 where all weights are read as zero


@pytest.mark.parametrize("kind", [np.float32, np.int64])
def test_jumps_ahead_in_other_numbers_are_the_same_jumps(kind: type) -> None:
    base = Preview.of(CIRCLE)
    at = np.arange(0.03125, 1.0, 0.015625) if kind is np.float32 else np.arange(3)
    first, second = (
        after(RecedingHorizon(dynamics()), replace(base, breaks=at.astype(as_kind)), 3)
        for as_kind in (kind, np.float64)
    )
    np.testing.assert_array_equal(first.updates.last.command.efforts.edges, second.updates.last.command.efforts.edges)


def test_a_backend_in_single_precision_is_read_as_such() -> None:
    class Single(type(dynamics())):
        def carrier_terms(self, *motion: Array):
            return type(terms := super().carrier_terms(*motion))(*(part.astype(np.float32) for part in terms))

    robot = dynamics().robot
    single, double = after(RecedingHorizon(Single(robot)), CIRCLE, 6), after(RecedingHorizon(dynamics()), CIRCLE, 6)
    assert_same(single, double, 1e-2)  # sums of 1e-7


@pytest.mark.parametrize("ticks", [0, 3])
@pytest.mark.parametrize("again", [copy.deepcopy, lambda planner: pickle.loads(pickle.dumps(planner))])
def test_a_copy_of_a_planner_goes_on_by_itself(again, ticks: int) -> None:
    planner = after(RecedingHorizon(dynamics()), CIRCLE, ticks)
    other = again(planner)
    planner.update(STEP * ticks, CIRCLE)
    kept = [part.copy() for part in planner.updates.last.at]
    for i in range(ticks, ticks + 2):
        other.update(STEP * i, CIRCLE)
    for own, before in zip(planner.updates.last.at, kept, strict=True):
        np.testing.assert_array_equal(own, before)
    planner.update(STEP * (ticks + 1), CIRCLE)
    assert_same(planner, other)


def test_another_motion_in_a_preview_is_that_motion() -> None:
    base = Preview.of(CIRCLE)

    def resting(t: Array) -> rp.PlatformMotion:
        there = base.motion(t)
        still = np.zeros_like(there.xd)
        return rp.PlatformMotion(t, np.repeat(there.x[:1], len(t), axis=0), still, still)

    other = replace(base, motion=resting)
    for got, want in zip(other.states(np.array([0.3, 0.4])), base.states(np.array([0.3, 0.4])), strict=True):
        assert np.abs(got - want).max() > 1e-3
    x, xd, xdd = other.states(np.array([0.3, 0.4]))
    np.testing.assert_array_equal(x[0], x[1])
    assert not xd.any()
    assert not xdd.any()


def test_forces_are_known_where_the_preview_ends_at_once() -> None:
    short = replace(Preview.of(CIRCLE), end=0.1005)
    planner = after(RecedingHorizon(dynamics()), short, 6)
    command = planner.updates.last.command
    reduced = dynamics().along(CIRCLE.sample_at(np.array([0.1, 0.1005])))
    s, sd, sdd = (np.tile(part, (2, 1)) for part in command.motion_at(0.1))
    force = reduced.reduce(rp.CarrierMotion(s, sd, sdd, check_rates=False)).carrier_force[0]
    np.testing.assert_allclose(command.forces.at(0.1), force, atol=1e-9)


def test_without_a_folder_a_library_is_compiled_once_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    compiler = find_compiler()
    assert compiler is not None
    robot_dynamics, script, log = dynamics(), tmp_path / "cc", tmp_path / "log"
    command = " ".join(shlex.quote(word) for word in compiler.command)
    script.write_text(f'#!/bin/sh\necho compiled >> {log}\nexec {command} "$@"\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setenv("LEVEL", "-O0")
    monkeypatch.setenv(CACHE, "")
    for _ in range(2):
        RecedingHorizon(robot_dynamics, horizon=0.1)
        assert len(log.read_text().split()) == 1


def iterations(period: float) -> float:
    """Mean of those a tick over the first second and a half of a path that goes over the line twice."""
    planner, counts = RecedingHorizon(dynamics()), []
    motion = rp.trajectory.reference.circle(speed=0.5)
    for t in np.arange(0.0, min(1.5, motion.duration), period).tolist():
        planner.update(t, motion)
        counts.append(planner.updates.last.iterations)
    return float(np.mean(counts[1:]))


@pytest.mark.parametrize(("period", "most"), FEW.items())
def test_a_programme_begins_where_the_one_before_ended(period: float, most: float) -> None:
    assert iterations(period) < most


def test_a_copy_of_a_planner_whose_updates_are_relaxed_makes_the_same_guesses() -> None:
    planner = RecedingHorizon(dynamics(), limits=rp.Limits(effort=1.0, acceleration=2.0))
    statuses = [planner.update(STEP * i, CIRCLE).status for i in range(6)]
    assert UpdateStatus.RELAXED in statuses
    other = copy.deepcopy(planner)
    for i in range(6, 10):
        command, again = planner.update(STEP * i, CIRCLE), other.update(STEP * i, CIRCLE)
        np.testing.assert_allclose(again.efforts.coefficients, command.efforts.coefficients, atol=1e-6)


def test_a_weight_of_zero_for_what_is_missed_is_refused() -> None:
    with pytest.raises(InputError, match="missing weighs 0"):
        Weights(missing=0.0)
