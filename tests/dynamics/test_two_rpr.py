"""Closed form of the 2-RPR: closure, round trips, rates against differences of positions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.dynamics.virtual_work.two_rpr import (
    inverse_displacement,
    leg_rates,
)

ROUNDING = 1e-13
"""A few hundred roundings of lengths of a few metres."""

THESIS = 0.5  # m, from hinge to hinge

coordinate = st.floats(-3, 3)


@given(x=coordinate, y=coordinate, mode=st.tuples(*[st.sampled_from([1, -1])] * 2))
def test_legs_close_the_loops_in_the_mode_asked_for(x, y, mode):
    legs = inverse_displacement(THESIS, [[x, y]], mode)
    away = np.hypot([x, x - 0.5], y) > 1e-6
    np.testing.assert_array_equal(np.sign(legs.d[away, 0]), np.array(mode)[away])
    tip = np.array([[0.0, 0.0], [0.5, 0.0]]) + legs.d * np.column_stack([np.cos(legs.theta), np.sin(legs.theta)])
    np.testing.assert_allclose(tip[away], np.tile([x, y], (2, 1))[away], atol=ROUNDING)
    assert np.all(legs.gap[away] < ROUNDING)


def smooth_motion(t):
    x = np.column_stack([0.25 + 0.3 * np.cos(3 * t), 0.4 + 0.2 * np.sin(2 * t)])
    v = np.column_stack([-0.9 * np.sin(3 * t), 0.4 * np.cos(2 * t)])
    a = np.column_stack([-2.7 * np.cos(3 * t), -0.8 * np.sin(2 * t)])
    return x, v, a


@pytest.mark.parametrize("mode", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_rates_are_the_differences_of_positions(mode):
    t, h = np.linspace(0, 1, 50), 1e-4
    before, here, after = (inverse_displacement(THESIS, smooth_motion(t + k * h)[0], mode) for k in (-1, 0, 1))
    rates = leg_rates(here, *smooth_motion(t)[1:])
    # order two: h² = 1e-8 times third and fourth derivatives of up to 1e3; rounding / h² = 1e-8
    tolerance = {"atol": 2e-5, "rtol": 0}
    turned = [legs.theta + 2 * np.pi * np.round((here.theta - legs.theta) / (2 * np.pi)) for legs in (before, after)]
    np.testing.assert_allclose(rates.d_rate, (after.d - before.d) / (2 * h), **tolerance)
    np.testing.assert_allclose(rates.d_acceleration, (after.d - 2 * here.d + before.d) / h**2, **tolerance)
    np.testing.assert_allclose(rates.theta_rate, (turned[1] - turned[0]) / (2 * h), **tolerance)
    np.testing.assert_allclose(rates.theta_acceleration, (turned[1] - 2 * here.theta + turned[0]) / h**2, **tolerance)
    np.testing.assert_allclose(np.einsum("jin,nj->in", here.jacobian, smooth_motion(t)[1]), rates.d_rate, atol=ROUNDING)


def test_a_leg_of_no_length_has_no_direction_and_no_warning():
    legs = inverse_displacement(THESIS, [[0.0, 0.0]])
    assert np.isnan(legs.u[0, 0])
    assert legs.u[1, 0] == -1.0
    np.testing.assert_array_equal(legs.gap, 0.0)  # any direction closes a leg of no length


def test_results_are_read_only():
    legs = inverse_displacement(THESIS, [[0.1, 0.2]])
    for array in (legs.d, legs.u, legs.theta, legs.jacobian):
        assert not array.flags.writeable
