"""Encoders and friction: steps, homing, closures of the known robot, speeds; forces against speeds."""

from __future__ import annotations

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.planners.reference import motion_reference
from redundancy_pin.simulation.controllers.base import Sampling
from redundancy_pin.simulation.controllers.encoders import PRISMATIC_STEP, REVOLUTE_STEP, Encoders, JointFriction
from redundancy_pin.simulation.state import closed_state, tree_state
from redundancy_pin.trajectory import reference


class Still:
    def effort(self, t, state):
        return np.zeros(2), np.zeros(2)


def moving():
    robot = rp.load_robot("2rpr", end_effector_mass=0.5)
    circle = reference.circle(speed=0.5)
    inside = rp.PlatformMotion(*(part[:61] for part in (lambda m: (m.t, m.x, m.xd, m.xdd))(circle.sample(5e-3))))
    return motion_reference(robot, inside)  # 0.3 s, before the type II pose


def test_the_estimate_is_the_truth_to_a_step():
    motion = moving()
    encoders = Encoders(Still(), motion, period=1e-3)
    for i in range(200):
        t = 1e-3 * i
        q, v, _ = motion.tree(t)
        estimate = encoders.estimate(t, tree_state(motion.robot, q, v, t=t))
    assert np.abs((estimate.q - q)[encoders.step == REVOLUTE_STEP]).max() <= REVOLUTE_STEP
    assert np.abs(estimate.s - q[motion.robot.carrier_position]).max() <= PRISMATIC_STEP
    assert np.abs(estimate.q - q).max() > 0.0
    # a step in one period, first-order filtered, and half as much from its neighbours through the closures
    assert np.abs(estimate.v - v).max() < 2.0 * REVOLUTE_STEP / (5e-3 + 1e-3)
    closure = ConstraintSystem(motion.robot).evaluate(estimate.q[None])
    assert np.abs(closure.phi).max() < 1e-12


def test_speeds_off_the_plan_are_found_with_the_lag_of_the_filter():
    motion = moving()
    encoders = Encoders(Still(), motion, period=1e-3, time_constant=2e-3, revolute_step=1e-9, prismatic_step=1e-9)
    for i in range(31):
        t = 1e-3 * i
        point = motion.at(t)
        away = 0.1 * t
        state = closed_state(motion.robot, point.x, point.xd, point.s + away, point.sd + 0.1, t=t)
        estimate = encoders.estimate(t, state)
        if i == 6:
            assert estimate.sd - point.sd == pytest.approx(0.1 * (1.0 - (2.0 / 3.0) ** 6), rel=1e-4)
    assert estimate.sd - point.sd == pytest.approx(0.1, rel=1e-4)


def test_homing_hides_the_geometry_where_it_starts():
    motion = moving()
    point = motion.at(0.0)
    other = rp.load_robot("2rpr", end_effector_mass=0.5, base_distance=0.501)
    encoders = Encoders(Still(), motion, period=1e-3)
    estimate = encoders.estimate(0.0, closed_state(other, point.x, point.xd, point.s, point.sd))
    assert np.abs(estimate.q - point.q).max() < REVOLUTE_STEP


def test_the_same_time_twice_is_one_reading():
    motion = moving()
    encoders = Encoders(Still(), motion, period=1e-3)
    q, v, _ = motion.tree(0.0)
    encoders.estimate(0.0, tree_state(motion.robot, q, v))
    q, v, _ = motion.tree(1e-3)
    first = encoders.estimate(1e-3, tree_state(motion.robot, q, v))
    again = encoders.estimate(1e-3, tree_state(motion.robot, q, v))
    assert np.array_equal(first.v, again.v)


def test_encoders_of_another_simulation_are_refused():
    motion = moving()
    encoders = Encoders(Still(), motion, period=1e-3)
    run = rp.simulate(motion.robot, encoders, start=closed_state(motion.robot), duration=5e-3, sampling=Sampling(1e-3))
    assert run.status.value == "ok"
    with pytest.raises(InputError, match="new Encoders for each simulation"):
        rp.simulate(motion.robot, encoders, start=closed_state(motion.robot), duration=5e-3, sampling=Sampling(1e-3))


@pytest.mark.parametrize("name", ["period", "time_constant", "revolute_step", "prismatic_step"])
def test_settings_out_of_their_domain(name):
    with pytest.raises(InputError, match=name):
        Encoders(Still(), moving(), **{"period": 1e-3, name: 0.0})


def test_friction_opposes_every_speed_and_saturates():
    robot = rp.load_robot("2rpr", end_effector_mass=0.5)
    friction = JointFriction(np.full(6, 0.3), np.full(6, 0.2), np.full(6, 0.01))
    v = np.array([1.0, -1.0, 0.0, 0.01, -2.0, 1e-4])
    force = friction(tree_state(robot, np.array(robot.q_reference), v))
    assert force == pytest.approx([-0.5, 0.5, 0.0, -0.3 * np.tanh(1.0) - 0.002, 0.7, -0.3 * np.tanh(0.01) - 2e-5])


def test_encoders_homed_elsewhere_see_a_start_off_the_plan():
    """Homed at the planned pose of a machine 1 mm wider, started 0.3 mm beside it: that is seen, the width not."""
    motion = moving()
    point = motion.at(0.0)
    other = rp.load_robot("2rpr", end_effector_mass=0.5, base_distance=0.501)
    home = closed_state(other, point.x, point.xd, point.s, point.sd).q - point.q
    x, s = point.x + np.array([3e-4, 0.0]), point.s + np.array([0.0, 2e-4])
    off = closed_state(other, x, point.xd, s, point.sd)
    encoders = Encoders(Still(), motion, period=1e-3, home=home)
    estimate = encoders.estimate(0.0, off)
    assert estimate.x == pytest.approx(x, abs=3e-5)  # a step of 16 bits at half a metre
    assert estimate.s == pytest.approx(s, abs=2e-6)
    assert estimate.v == pytest.approx(point.v, abs=1e-2)  # no difference of readings yet
    with pytest.raises(InputError, match="home has shape"):
        Encoders(Still(), motion, period=1e-3, home=np.zeros(3))
