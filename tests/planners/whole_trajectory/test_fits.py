"""Fits of f around a course, where it is no sum over carriers, by the backend itself beside the course."""

from __future__ import annotations

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.planners.whole_trajectory.problem import second_order_fit
from redundancy_pin.trajectory import reference

ARMS = {"arm_length": 0.15, "end_effector_mass": 0.5, "cylinder_mass": 0.3}
SIZES = np.array([0.4, 3.0, 30.0])
"""Of s, ṡ and s̈."""

POINTS = 6


@pytest.fixture(scope="module")
def along():
    return rp.RneaDynamics(zoo.robot_of("2rpr", **ARMS)).along(reference.circle().sample(0.3)[:POINTS])


def course(rng, count, k):
    return rng.uniform(-1.0, 1.0, (count, k, 3)) * SIZES


def carriers(motion):
    return rp.CarrierMotion(*np.moveaxis(motion, -1, 0), check_rates=False)


def fitted(model, motion):
    s, sd, sdd = np.moveaxis(motion, -1, 0)
    return model.f(s, sd, sdd), model.carrier_force(s, sd, sdd)


def test_what_a_fit_leaves_of_f_is_of_third_order_in_the_distance(along):
    """Carriers on arms turn: f has waves of their angles, times s̈ and the squares of ṡ, and carriers do not mix."""
    rng = np.random.default_rng(1)
    here = course(rng, len(along.motion), 2)
    model = second_order_fit(along, carriers(here))
    exact = along.reduce(carriers(here))
    f, force = fitted(model, here)
    np.testing.assert_allclose(f, exact.f, atol=1e-9 * np.abs(exact.f).max())
    np.testing.assert_allclose(force, exact.carrier_force, atol=1e-9 * np.abs(exact.carrier_force).max())
    for _ in range(6):
        away = rng.uniform(-1.0, 1.0, here.shape) * SIZES
        left, own = [], []
        for step in (0.02, 0.01):
            there = along.reduce(carriers(here + step * away))
            f, force = fitted(model, here + step * away)
            left.append(np.abs(f - there.f).max())
            own.append(np.abs(force - there.carrier_force).max())
        moved = np.abs(there.f - exact.f).max()
        assert left[1] < 2e-3 * moved
        assert 6.0 < left[0] / left[1] < 10.0
        # a carrier's force is taken to first order
        assert 3.0 < own[0] / own[1] < 5.5


@pytest.mark.parametrize("which", [0, 1, 2])
def test_slopes_of_a_fit_are_those_of_the_backend(along, which):
    rng = np.random.default_rng(2)
    here = course(rng, len(along.motion), 2)
    model, slopes = second_order_fit(along, carriers(here)), along.carrier_derivatives(carriers(here))
    exact = getattr(slopes, ("f_s", "f_sd", "f_sdd")[which])
    step = 1e-5 * SIZES[which]
    for k in range(2):
        move = np.zeros_like(here)
        move[:, k, which] = step
        difference = (fitted(model, here + move)[0] - fitted(model, here - move)[0]) / (2.0 * step)
        np.testing.assert_allclose(difference, exact[:, :, k], atol=1e-7 * np.abs(exact).max())
