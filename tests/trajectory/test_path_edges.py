"""Rounded paths at the edge of what fits, and pieces of functions of time: in any units, wherever time begins."""

from __future__ import annotations

import numpy as np
import pytest

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import rounded_polygon
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

SLACK = 1e-12
"""Relative to an edge: rounding of a length. Limits are tried at half of it, and at twice it."""

UNITS = [1.0, 1e3, 1e-2]
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize(("end", "outwards"), [(0.2, -1.0), (0.8, 1.0)])
@pytest.mark.parametrize(("slacks", "right"), [(0.0, True), (0.5, True), (2.0, False), (-1e9, True)])
def test_a_closed_polygon_begins_on_the_straight_part_of_its_first_edge(unit, end, outwards, slacks, right):
    start = (end + outwards * slacks * SLACK) * unit
    if right:
        path = rounded_polygon(SQUARE * unit, 0.2 * unit, start=start)
        np.testing.assert_allclose(path.evaluate(0.0).x, [start, 0.0], atol=1e-14 * unit)
        # four straights of 0.6 and a circle
        assert path.length == pytest.approx(unit * (2.4 + 0.4 * np.pi), rel=1e-11)
    else:
        with pytest.raises(InputError, match="not on the straight part") as caught:
            rounded_polygon(SQUARE * unit, 0.2 * unit, start=start)
        details = caught.value.details
        assert details["start"] == start
        assert (details["lower"], details["upper"]) == pytest.approx((0.2 * unit, 0.8 * unit), rel=1e-14)


@pytest.mark.parametrize("unit", UNITS)
def test_a_closed_polygon_begins_in_the_middle_of_a_straight_between_unlike_corners(unit):
    """A triangle of 3, 4 and 5: its corners are a right angle and those whose tangents are 3/4 and 4/3."""
    vertices = unit * np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
    radius = 0.3 * unit
    # at each end an arc takes r / tan(half the angle inside)
    low = radius / np.tan(0.5 * np.arctan2(3.0, 4.0))
    high = 4.0 * unit - radius
    path = rounded_polygon(vertices, radius)
    np.testing.assert_allclose(path.evaluate(0.0).x, [0.5 * (low + high), 0.0], atol=1e-13 * unit)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("angle", [np.pi / 2.0, np.pi / 3.0, 2.0])
@pytest.mark.parametrize(("slacks", "right"), [(0.0, True), (0.4, True), (4.0, False), (1e11, False)])
def test_the_largest_radius_of_a_corner_takes_the_shorter_edge(unit, angle, slacks, right):
    """An arc of radius r between edges that turn by an angle takes r tan(angle/2) of both: here of 0.7 and of 2."""
    turned = np.array([1.0, 0.0]) + 0.7 * np.array([np.cos(angle), np.sin(angle)])
    vertices = unit * np.array([[-1.0, 0.0], [1.0, 0.0], turned])
    largest = 0.7 * unit / np.tan(0.5 * angle)
    radius = largest * (1.0 + slacks * SLACK)
    if right:
        path = rounded_polygon(vertices, radius, closed=False)
        assert path.length == pytest.approx(2.0 * unit - 0.7 * unit + largest * angle, rel=1e-11)
    else:
        with pytest.raises(InputError, match="does not fit") as caught:
            rounded_polygon(vertices, radius, closed=False)
        assert caught.value.details["edge"] == 1
        assert caught.value.details["largest_radius"] == pytest.approx(largest, rel=1e-13)


@pytest.mark.parametrize(("start", "length"), [(-1.0, 2.0), (-2.0, 2.0), (0.0, 2.0), (100.0, 2.0), (-1000.0, 2000.0)])
def test_a_kink_that_is_not_told_is_closed_in_on_to_1e_7_of_the_interval(start, length):
    """Pieces are halved until they are no wider: the narrowest are between half of that and all of it."""
    kink = start + 0.637 * length

    def function(t):
        return np.abs(t - kink)[:, None] / length * [1.0, -0.5]

    found = PiecewisePolynomial.fit(
        function, np.array([start, start + length]), np.empty(0), lambda values: np.abs(values).max(axis=0), 1e-13
    )
    widths = np.diff(found.edges) / length
    assert 0.5e-7 <= widths.min() <= 1e-7
    assert len(widths) == len(np.unique(found.edges)) - 1
    t = start + length * np.linspace(0.0, 1.0, 201)
    np.testing.assert_allclose(found(t), function(t), atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_taylor_and_linear_are_the_polynomials_of_the_times_before(seed):
    """A time that occurs twice is a jump: what stands after it counts for the piece that begins there."""
    dice = np.random.default_rng(seed)
    t = np.repeat(np.cumsum(0.1 + dice.random(5)), [1, 1, 2, 1, 1]) - 0.9
    x, v, a = dice.normal(size=(3, len(t), 2))
    taylor, linear = PiecewisePolynomial.taylor(t, x, v, a), PiecewisePolynomial.linear(t, x, v, a)
    np.testing.assert_array_equal(taylor.edges, np.unique(t))
    for k in np.flatnonzero(np.diff(t) > 0.0):
        step = t[k + 1] - t[k]
        jerk = (a[k + 1] - a[k]) / step
        for h in step * np.array([0.0, 0.3, 0.9]):
            expected = x[k] + h * v[k] + 0.5 * h**2 * a[k]
            np.testing.assert_allclose(taylor(t[k] + h), expected, atol=1e-13)
            np.testing.assert_allclose(linear(t[k] + h), expected + h**3 / 6.0 * jerk, atol=1e-13)
