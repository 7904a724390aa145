"""Limits of timing laws at their very edge, numbers in their errors, and the same law in other units."""

from __future__ import annotations

import numpy as np
import pytest

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import SpeedProfile, boundary_polynomial

SLACK = 1e-12
"""Relative: what counts as rounding of a length. Edges are tried at half of it and at twice it."""

V, T = 0.5, 0.4
"""m/s and s of the ramps: 0.4 v T is 0.08 m, 0.5 v T is 0.1 m."""


def allowed(make):
    """Return the error that a call ends with, None if it does not."""
    try:
        make()
    except InputError as error:
        return error
    return None


@pytest.mark.parametrize(
    ("t0", "t1", "right"),
    [
        (0.0, 0.0, False),
        (0.0, 1e-300, True),
        (1.0, float(np.nextafter(1.0, 2.0)), True),
        (1.0, float(np.nextafter(1.0, 0.0)), False),
        (-3.0, -2.0, True),
        (-1e308, 1e308, False),  # its duration is no number
        (1.0e308, 1.5e308, True),  # the sum of its ends is none, which does not matter
        (0.0, np.inf, False),
    ],
)
def test_the_interval_of_a_polynomial_has_a_duration(t0, t1, right):
    error = allowed(lambda: boundary_polynomial(t0, t1, [0.0], [1.0]))
    assert (error is None) is right
    if error is not None:
        assert (error.details["t0"], error.details["t1"]) == (t0, t1)


@pytest.mark.parametrize("end", [False, True], ids=["up", "down"])
@pytest.mark.parametrize(("share", "right"), [(1.0, True), (1.0 - 0.5 * SLACK, True), (1.0 - 2.0 * SLACK, False)])
def test_a_ramp_may_be_as_short_as_four_tenths_of_speed_and_time(end, share, right):
    key = "end_ramp_length" if end else "ramp_length"
    error = allowed(lambda: SpeedProfile(1.0, V, T, **{key: 0.4 * V * T * share}))
    assert (error is None) is right
    if error is not None:
        assert error.details["name"] == key
        assert error.details["least"] == pytest.approx(0.08, rel=1e-15)
        assert error.details["most"] == 1.0


@pytest.mark.parametrize(("share", "right"), [(1.0, True), (1.0 - 0.5 * SLACK, True), (1.0 - 2.0 * SLACK, False)])
def test_a_path_may_be_as_short_as_both_ramps(share, right):
    error = allowed(lambda: SpeedProfile(0.25 * share, V, T, 0.11, end_ramp_length=0.14))
    assert (error is None) is right
    if error is None:
        assert SpeedProfile(0.25 * share, V, T, 0.11, end_ramp_length=0.14).cruise_time == 0.0
    else:
        assert error.details == {"length": 0.25 * share, "ramp_length": 0.11, "end_ramp_length": 0.14}


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, 0.1),
        ({"ramp_length": 0.11}, 0.11),  # as the ramp up
        ({"ramp_length": 0.11, "end_ramp_time": 0.4}, 0.11),
        ({"ramp_length": 0.11, "end_ramp_time": 0.6}, 0.5 * V * 0.6),  # of its own time
        ({"end_ramp_time": 0.2}, 0.5 * V * 0.2),
        ({"end_ramp_time": 0.6, "end_ramp_length": 0.17}, 0.17),
    ],
)
def test_the_ramp_down_left_out_is_as_said(given, expected):
    law = SpeedProfile(1.0, V, T, **given)
    assert law.end_ramp_length == pytest.approx(expected, rel=1e-15)
    up, down = law.ramp_length, law.end_ramp_length
    duration = T + (1.0 - up - down) / V + given.get("end_ramp_time", T)
    assert law.duration == pytest.approx(duration, rel=1e-14)
    np.testing.assert_allclose(law.knots, [T, duration - given.get("end_ramp_time", T)], rtol=1e-14)


@pytest.mark.parametrize(("metre", "second"), [(1000.0, 1.0), (1.0, 1000.0), (0.01, 60.0)])
def test_the_same_profile_in_other_units(metre, second):
    """Lengths, times and what follows from them change by their units alone; 1e-12 is rounding."""
    one = SpeedProfile(1.0, V, T, 0.15, 0.6, 0.13)
    other = SpeedProfile(metre, V * metre / second, T * second, 0.15 * metre, 0.6 * second, 0.13 * metre)
    assert other.peak_speed == pytest.approx(one.peak_speed * metre / second, rel=1e-12)
    assert other.duration == pytest.approx(one.duration * second, rel=1e-12)
    assert other.time_at(0.37 * metre) == pytest.approx(one.time_at(0.37) * second, rel=1e-12)
    t = np.linspace(0.0, one.duration, 31)[1:-1]
    for k, (here, there) in enumerate(zip(one.evaluate(t), other.evaluate(t * second), strict=True)):
        np.testing.assert_allclose(there, here * metre / second**k, rtol=0.0, atol=1e-12 * metre * 10.0 / second**k)
