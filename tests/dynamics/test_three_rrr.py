"""Closed form of the 3-RRR, inverse: closure in all modes, reach, rates against differences of positions."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.arrays import CLOSURE_TOLERANCE
from redundancy_pin.dynamics.virtual_work.three_rrr import (
    ThreeRrrGeometry,
    inverse_displacement,
    leg_rates,
)

ROUNDING = 1e-13
GAP_ROUNDING = 1e-12
"""m: where the border is touched the gap is a difference of lengths that went through their squares."""
"""A few hundred roundings of lengths of a few metres."""

THESIS = ThreeRrrGeometry(1.0, 0.25, 1.0, 1.0)
UNEQUAL = ThreeRrrGeometry(0.9, 0.3, 1.2, 0.9)
PHI = np.array([np.pi / 6, 5 * np.pi / 6, -np.pi / 2])


def u(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def corners(geometry, pose):
    return pose[:2] - geometry.platform_radius * u(pose[2] + PHI)


@given(
    pose=st.tuples(st.floats(-1, 2.5), st.floats(-1, 2.5), st.floats(-np.pi, np.pi)),
    geometry=st.sampled_from([THESIS, UNEQUAL]),
)
def test_all_modes_close_or_report_how_far_the_corner_is(pose, geometry):
    pose = np.array(pose)
    A, G = corners(geometry, pose), geometry.base_points
    rho = np.hypot(*(A - G).T)
    l1, l2 = geometry.proximal_length, geometry.distal_length
    within = np.maximum(rho - l1 - l2, abs(l1 - l2) - rho) <= 0
    for mode in product((1, -1), repeat=3):
        legs = inverse_displacement(geometry, pose[None], mode)
        tip = G + l1 * u(legs.theta[:, 0]) + l2 * u(legs.beta[:, 0])
        np.testing.assert_allclose(tip[within], A[within], atol=ROUNDING)
        np.testing.assert_allclose(np.abs(legs.b)[within], l1, atol=ROUNDING)
        np.testing.assert_allclose(np.abs(legs.e)[within], l2, atol=ROUNDING)
        np.testing.assert_allclose(
            legs.gap[:, 0], np.where(within, 0, np.maximum(rho - l1 - l2, abs(l1 - l2) - rho)), atol=GAP_ROUNDING
        )
        # θ = γ ± ψ: the mode is the side of the line G A on which the elbow lies
        side = np.sin(legs.theta[:, 0] - np.arctan2(*(A - G).T[::-1]))
        clear = within & (np.abs(side) > 1e-6)
        np.testing.assert_array_equal(np.sign(side)[clear], np.array(mode)[clear])


def test_thesis_formulas_for_theta_and_jacobian():
    """Angles by arc cosine and the Jacobian's entries as printed (Parsa 2014, eq. 2.22-2.38)."""
    pose, mode = np.array([1.0, 0.4, 0.3]), (1, -1, 1)
    legs = inverse_displacement(UNEQUAL, pose[None], mode)
    l1, l2, l3 = 1.2, 0.9, 0.3
    for i in range(3):
        xA, yA = corners(UNEQUAL, pose)[i] - UNEQUAL.base_points[i]
        rho = np.hypot(xA, yA)
        theta = np.arctan2(yA, xA) + mode[i] * np.arccos((l1**2 + rho**2 - l2**2) / (2 * l1 * rho))
        phi = pose[2] + PHI[i]
        a, b = xA - l1 * np.cos(theta), yA - l1 * np.sin(theta)
        c, d = l1 * (xA * np.sin(theta) - yA * np.cos(theta)), l3 * (a * np.sin(phi) - b * np.cos(phi))
        assert abs(np.exp(1j * theta) - np.exp(1j * legs.theta[i, 0])) < ROUNDING
        np.testing.assert_allclose(legs.jacobian[:, i, 0], -np.array([a, b, d]) / c, atol=ROUNDING)
        np.testing.assert_allclose(legs.c[i, 0], c, atol=ROUNDING)


def smooth_motion(t):
    x = np.column_stack([0.87 + 0.1 * np.cos(3 * t), 0.5 + 0.1 * np.sin(2 * t), 0.4 * np.sin(t)])
    v = np.column_stack([-0.3 * np.sin(3 * t), 0.2 * np.cos(2 * t), 0.4 * np.cos(t)])
    a = np.column_stack([-0.9 * np.cos(3 * t), -0.4 * np.sin(2 * t), -0.4 * np.sin(t)])
    return x, v, a


@pytest.mark.parametrize("mode", list(product((1, -1), repeat=3)))
@pytest.mark.parametrize("geometry", [THESIS, UNEQUAL], ids=["thesis", "unequal"])
def test_rates_are_the_differences_of_positions(geometry, mode):
    t, h = np.linspace(0, 2, 40), 1e-4
    before, here, after = (inverse_displacement(geometry, smooth_motion(t + k * h)[0], mode) for k in (-1, 0, 1))
    rates = leg_rates(here, *smooth_motion(t)[1:])
    for name in ("theta", "beta"):
        middle = getattr(here, name)
        low, high = (
            angle + 2 * np.pi * np.round((middle - angle) / (2 * np.pi))
            for angle in (getattr(before, name), getattr(after, name))
        )
        # order two: h² = 1e-8 times third and fourth derivatives of up to 1e2; rounding / h² = 1e-8
        np.testing.assert_allclose(getattr(rates, f"{name}_rate"), (high - low) / (2 * h), atol=2e-6)
        np.testing.assert_allclose(getattr(rates, f"{name}_acceleration"), (high - 2 * middle + low) / h**2, atol=2e-6)
    np.testing.assert_allclose(
        np.einsum("jin,nj->in", here.jacobian, smooth_motion(t)[1]), rates.theta_rate, atol=ROUNDING
    )


@pytest.mark.parametrize(("beyond", "reached"), [(0.5 * CLOSURE_TOLERANCE, True), (1e-9, False), (0.3, False)])
def test_reach_ends_at_the_stretched_leg(beyond, reached):
    """Leg 1 is stretched along its own arm: G, B, A and P on one line at 30 degrees."""
    pose = np.append((2.0 + 0.25 + beyond) * u(np.pi / 6), 0.0)
    legs = inverse_displacement(THESIS, pose[None])
    assert legs.reachable[0, 0] == reached
    assert np.isnan(legs.b[0, 0]) != reached
    np.testing.assert_allclose(legs.gap[0, 0], beyond, atol=1e-14)  # roundings of 2 m


def test_a_leg_folded_on_itself_has_no_direction_and_no_warning():
    """Equal links, the corner on the base hinge: any θ closes the leg, and c = 0 tells."""
    pose = np.append(0.25 * u(np.pi / 6), 0.0)
    legs = inverse_displacement(THESIS, pose[None])
    assert abs(legs.margin[0, 0]) < 1e-12
    assert legs.reachable[0, 0]


def test_results_are_read_only():
    legs = inverse_displacement(THESIS, [[1.0, 0.4, 0.0]])
    for array in (legs.b, legs.c, legs.gap, legs.theta, legs.jacobian, legs.reachable):
        assert not array.flags.writeable
