"""Noise of amplifiers and friction by kind of joint, against what they are made of."""

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.simulation import FeedForward, Sampling, motion_reference
from redundancy_pin.simulation.controllers import NoisyAmplifier, controller_by_name, joint_friction
from redundancy_pin.trajectory import reference

NOISE = 0.3
PERIOD = 0.01


@pytest.fixture(scope="module")
def held():
    robot = rp.load_robot("3rrr")
    return motion_reference(robot, reference.corner(radius=0.05).sample(0.01)[:31])


def test_noise_is_on_top_of_what_is_commanded(held):
    drive = NoisyAmplifier(FeedForward(held), np.random.default_rng(3), NOISE)
    run = rp.simulate(held.robot, drive, sampling=Sampling(PERIOD), dt=PERIOD, rtol=1e-6, atol=1e-8)
    planned = np.array([np.concatenate(held.loads(t)) for t in run.t[:-1]])
    noise = np.concatenate([run.tau, run.carrier_force], axis=1)[:-1] - planned
    expected = np.random.default_rng(3).standard_normal((len(noise), 6)) * NOISE
    np.testing.assert_allclose(noise, expected, atol=1e-9)


def test_friction_goes_by_kind_of_joint(held):
    robot = held.robot
    state = rp.simulation.tree_state(robot, *held.tree(0.1)[:2])
    friction = joint_friction(
        robot, prismatic_coulomb=1.0, prismatic_viscous=2.0, revolute_coulomb=3.0, revolute_viscous=4.0
    )(state)
    for name in list(robot.model.names)[1:]:
        i = robot.model.joints[robot.model.getJointId(name)].idx_v
        c, b, v0 = (1.0, 2.0, 0.01) if name.startswith("carrier") else (3.0, 4.0, 0.05)
        assert friction[i] == pytest.approx(-c * np.tanh(state.v[i] / v0) - b * state.v[i], abs=1e-15)
    assert np.abs(friction).max() > 0.01


def test_an_unknown_name_is_refused(held):
    with pytest.raises(InputError, match="controller is 'PID'"):
        controller_by_name("PID", held)
    with pytest.raises(InputError, match="Open loop has no setting bandwidth"):
        controller_by_name("open loop", held, bandwidth=10.0)


@pytest.mark.parametrize("compiled", [False, True])
def test_open_loop_of_a_digital_controller_is_that_of_the_middle_of_the_interval_in_which_it_acts(held, compiled):
    """Half a period late, and held for one: the middle of the interval is the next reading, which is a sample."""
    sampling = Sampling(PERIOD, 0.5 * PERIOD)
    drive = controller_by_name("open loop", held, sampling=sampling)
    dynamics = held.robot if compiled else None
    run = rp.simulate(held.robot, drive, sampling=sampling, dt=PERIOD, rtol=1e-6, atol=1e-8, dynamics=dynamics)
    planned = np.array([np.concatenate(held.loads(t)) for t in run.t])
    planned[0] = planned[1]  # until the first output acts, the first output acts
    np.testing.assert_allclose(np.concatenate([run.tau, run.carrier_force], axis=1), planned, atol=1e-9)
    assert np.abs(np.diff(planned[1:], axis=0)).max() > 0.01
    assert run.parameters["drive"] == "FeedForward"
    with pytest.raises(InputError, match=r"FeedForward was made for Sampling.*simulation has None"):
        rp.simulate(held.robot, drive)


@pytest.mark.parametrize("sampling", [None, Sampling(PERIOD)])
def test_a_regulator_commands_no_more_than_the_limits_that_it_was_told(held, sampling):
    robot = held.robot
    state = rp.simulation.closed_state(robot, held.platform(0.0)[0] + 0.01)
    free, bound = (
        controller_by_name("LQR", held, sampling=sampling, step=0.1, **limits).effort(0.0, state)
        for limits in ({}, {"effort_limit": 0.5, "carrier_force_limit": 0.25})
    )
    for unlimited, limited, most in zip(free, bound, (0.5, 0.25), strict=True):
        assert np.abs(unlimited).max() > 2.0 * most
        np.testing.assert_allclose(limited, np.clip(unlimited, -most, most), rtol=1e-12)
