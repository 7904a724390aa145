"""Points carried by moving links against differences of their positions; sums over bodies against known machines."""

from __future__ import annotations

import numpy as np
import pytest
from point_mass_oracle import derivative

from redundancy_pin.dynamics.virtual_work.mechanism import Body, Efforts, PlanarFrame

ORIGIN, TURN = np.array([[0.3, -0.2], [0.7, 1.1], [-0.4, 0.9]]), np.array([0.5, 1.3, -0.8])
ALONG, ACROSS = np.array([0.6, -0.9, 1.7]), np.array([-0.4, 0.8, 0.5])
"""Value, rate and second rate of the link's origin, its angle, and a point's coordinates in it."""


def at(series, t):
    return series[0] + series[1] * t + series[2] * t**2 / 2


def position(t):
    angle = at(TURN, t)
    u, n = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    return at(ORIGIN, t) + at(ALONG, t) * u + at(ACROSS, t) * n


def test_a_point_carried_by_a_moving_link_moves_as_its_positions_say():
    origin = (np.array([complex(*value)]) for value in ORIGIN)
    turned = np.exp([1j * TURN[0]]), np.array([TURN[1]]), np.array([TURN[2]])
    point = PlanarFrame(*origin, *turned, *np.zeros((2, 1, 1))).point(*(ALONG + 1j * ACROSS))
    velocity = derivative(position)
    acceleration = derivative(lambda h: derivative(lambda k: position(h + k)))
    assert point.place[0] == pytest.approx(complex(*position(0.0)), abs=1e-14)
    assert point.velocity[0] == pytest.approx(complex(*velocity), abs=1e-11)  # rounding over the step
    assert point.acceleration[0] == pytest.approx(complex(*acceleration), abs=1e-8)  # and over its square


def one_body(x, y, vx, vy, ax, ay, spin, spin_rate):
    values = (complex(x, y), complex(vx, vy), complex(ax, ay), 1.0 + 0.0j, spin, spin_rate)
    return PlanarFrame(*(np.array([value]) for value in values), *np.zeros((2, 1, 1)))


def of_body(frame, gravity):
    """What a body of 2 kg and 0.5 kg·m² requires: its ground wrench (1, 6) and its energy (1,)."""
    efforts = Efforts(1, 1, 1)
    Body("link", 2.0, 0.0, 0.5).add_to(efforts, frame, gravity)
    return efforts


def test_a_body_in_free_fall_puts_nothing_on_the_base():
    gravity = np.array([1.0, -9.0, 0.0])
    falling = one_body(0.4, 0.7, 3.0, 1.0, 1.0, -9.0, 5.0, 0.0)
    np.testing.assert_allclose(of_body(falling, gravity).ground, np.zeros((1, 6)), atol=1e-14)


def test_a_body_at_rest_puts_its_weight_on_the_base():
    gravity = np.array([1.0, -9.0, 4.0])
    resting = one_body(0.4, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    weight = 2.0 * gravity
    expected = np.concatenate([weight, np.cross([0.4, 0.7, 0.0], weight)])
    np.testing.assert_allclose(of_body(resting, gravity).ground, expected[None], atol=1e-14)
    np.testing.assert_allclose(of_body(resting, gravity).energy, -weight @ [0.4, 0.7, 0.0])


def test_a_body_that_spins_up_turns_the_base_the_other_way():
    spinning = one_body(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 7.0)
    np.testing.assert_allclose(of_body(spinning, np.zeros(3)).ground, [[0, 0, 0, 0, 0, -3.5]])
    np.testing.assert_allclose(of_body(spinning, np.zeros(3)).energy, 0.5 * 0.5 * 3.0**2)
