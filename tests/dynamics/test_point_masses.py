"""Carriers on end-effectors, arms and rods are point masses: against Newton's law for points."""

from functools import partial

import numpy as np
import pytest
from point_masses import delta_points, newton

import redundancy_pin as rp
from redundancy_pin.errors import UnsupportedRobotError

DIFFERENCES = 2e-5
"""N, of some 15: fourth derivatives times the square of the step of the central differences, which is 1e-4."""


def on_the_end_effector(mass=0.0):
    return rp.load_robot("2rpr", carriers=False, end_effector_carriers=True, end_effector_mass=mass, carrier_mass=0.8)


def reduce_one(dynamics, x, v, a, s, sd, sdd):
    motion = rp.PlatformMotion(np.zeros(1), x[None], v[None], a[None])
    return dynamics.reduce(motion, rp.CarrierMotion(s[None], sd[None], sdd[None]))


@pytest.mark.long_for("CompiledDynamics")
@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.CompiledDynamics])
def test_carriers_on_the_end_effector_are_point_masses_that_turn_with_leg_1(backend):
    """Against Newton for three points: positions as formulas of B and s, all else by central differences."""
    robot = on_the_end_effector(0.3)
    rng = np.random.default_rng(3)
    x0, v, a, s0, sd, sdd = rng.uniform(0.2, 0.5, (6, 2)) * np.array([1, 1, 1, 0.3, 1, 1])[:, None]

    def masses(x, s):
        u = x / np.hypot(*x)
        return np.array([x, x + s[0] * u, x + s[1] * np.array([-u[1], u[0]])])

    motion = x0, v, a, s0, sd, sdd
    of_x, of_s = newton(masses, [0.3, 0.8, 0.8], *motion)
    reduced = reduce_one(backend(robot), *motion)
    np.testing.assert_allclose(reduced.f[0], of_x, atol=1e-6)
    np.testing.assert_allclose(reduced.carrier_force[0], of_s, atol=1e-6)


@pytest.mark.parametrize("carriers", [True, False])
def test_the_closed_form_refuses_them(carriers):
    robot = rp.load_robot("2rpr", carriers=carriers, end_effector_carriers=True)
    assert robot.closed_form is None
    assert robot.k == (4 if carriers else 2)
    with pytest.raises(UnsupportedRobotError, match="RneaDynamics"):
        rp.VirtualWork(robot)


@pytest.mark.parametrize("on", ["arms", "rods"])
def test_carriers_of_a_delta_are_point_masses_across_its_arms_or_rods(on):
    """Against Newton for points, under gravity."""
    places = {"carriers": on == "arms", "rod_carriers": on == "rods"}
    robot = rp.load_robot("delta", rod_length=0.35, carrier_mass=0.6, **places)
    rng = np.random.default_rng(5)
    x = np.array([0.03, -0.02, -0.2])
    v, a, s, sd, sdd = rng.uniform(-1.0, 1.0, (5, 3)) * np.array([1, 5, 0.1, 1, 10])[:, None]
    legs = [0.4 / 6, 0.4 * 4 / 6, 0.4 / 6, 0.15 / 6, 0.15 * 4 / 6, 0.15 / 6, 0.6]
    of_x, of_s = newton(partial(delta_points, on=on), [0.3, *3 * legs], x, v, a, s, sd, sdd, gravity=9.81)
    reduced = reduce_one(rp.RneaDynamics(robot), x, v, a, s, sd, sdd)
    np.testing.assert_allclose(reduced.f[0], of_x, atol=DIFFERENCES)
    np.testing.assert_allclose(reduced.carrier_force[0], of_s, atol=DIFFERENCES)
