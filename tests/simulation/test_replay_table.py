"""Replay of plans: exact where the continuous motion is fed, honest where samples are, and where nothing can be."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.controllers.base import Sampling
from redundancy_pin.simulation.replay import AWAY, Replay, distance_off_track, replay, replay_table
from redundancy_pin.trajectory import reference

SLOW = Sampling(4e-3, 4e-3)
MOTION = reference.corner(radius=0.025)

EXACT = 1e-9
"""m. The target is 1e-6; series, integrator and projection leave 1e-13."""


@cache
def corner_plan(step: float) -> Plan:
    robot = rp.load_robot("3rrr")
    return rp.plan_stepwise(rp.RneaDynamics(robot), MOTION.sample(step, two_sided=True))


@cache
def controlled() -> dict[str, Replay]:
    plans, motions = {"corner": corner_plan(1e-2)}, {"corner": MOTION}
    row = replay_table(plans, motions, drives=["computed torque", "LQR"], sampling=SLOW)
    return {one.drive: one for one in row}


def test_open_loop_a_stepwise_plan_follows_the_motion_it_stands_for():
    row = replay(corner_plan(2e-2), motion=MOTION, name="corner")
    assert (row.status, row.plan, row.drive) == ("ok", "corner", "open loop")
    assert row.largest < EXACT
    assert row.carrier_error < EXACT
    assert row.gap < 1e-9
    assert 1e-4 < row.carrier_lag < 1e-1  # half a step at up to 1 m/s, carried on


@pytest.mark.long
def test_efforts_of_the_samples_alone_cost_what_the_step_costs():
    errors = [replay(corner_plan(step), "open loop, samples", motion=MOTION).largest for step in (2e-2, 1e-2)]
    assert errors[0] > 1e-4  # far above the error of the integrator: it is the discretisation
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.long
def test_under_control_the_start_is_off_and_the_end_is_not():
    assert list(controlled()) == ["computed torque", "LQR"]
    for row in controlled().values():
        assert row.status == "ok"
        assert row.error[0] == pytest.approx(AWAY, rel=1e-6)
        assert row.largest < 2.0 * AWAY
        assert row.last < 0.1 * AWAY
        assert row.off_track == 0.0
        assert row.rms == pytest.approx(np.sqrt(np.trapezoid(row.error**2, row.t) / np.ptp(row.t)))


def test_a_massless_plan_cannot_be_replayed_as_forces_and_says_why():
    robot = rp.load_robot("2rpr")
    circle = reference.circle(speed=0.5)
    plan = rp.plan_switch_off(rp.RneaDynamics(robot), circle, threshold=10.0, mesh=rp.Mesh(dt=5e-2))
    for drive in ("open loop", "LQR"):
        row = replay(plan, drive, motion=circle)
        assert row.status == "not_converged"
        assert "end_effector_mass" in row.reason
        assert np.isnan(row.largest)
        assert len(row.t) == 0


def test_samples_without_finite_efforts_are_not_made_up():
    plan = corner_plan(2e-2)
    tau = np.array(plan.tau)
    tau[40] = np.nan
    row = replay(replace(plan, tau=tau), "open loop, samples", motion=MOTION)
    assert row.status == "unbounded"
    assert f"t = {plan.t[40]:.6g} s" in row.reason


def test_carriers_beyond_their_tracks_are_told():
    robot = rp.load_robot("3rrr")
    middle = np.array([0.5 * (limits.lower + limits.upper) for limits in robot.carrier_limits])
    half = np.array([0.5 * (limits.upper - limits.lower) for limits in robot.carrier_limits])
    s = np.array([middle, middle + half + [1e-3, -1e-3, 0.0], middle - half - [0.0, 2e-3, 1e-4]])
    assert distance_off_track(robot, s) == pytest.approx(2e-3)


def test_an_unknown_drive():
    with pytest.raises(InputError, match=r"'by hand'.*carriers by motion"):
        replay(corner_plan(2e-2), "by hand")  # type: ignore[arg-type]
