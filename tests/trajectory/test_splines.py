from itertools import pairwise

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import through_points

FLOWER = np.array([[0, 0], [0.3, 0.1], [0.5, 0.5], [0.2, 0.8], [-0.3, 0.6]])


def test_passes_through_its_points_in_order():
    path = through_points(FLOWER)
    step = path.length / 2000
    p = np.linspace(0.0, path.length, 2001)
    x = path.evaluate(p).x
    nearest = [np.argmin(np.linalg.norm(x - point, axis=1)) for point in FLOWER]
    assert nearest == sorted(nearest)
    for point, centre in zip(FLOWER, p[nearest], strict=True):
        close = path.evaluate(np.clip(np.linspace(centre - step, centre + step, 401), 0.0, path.length)).x
        # half a step of the finer grid is length / 800000
        assert np.linalg.norm(close - point, axis=1).min() < path.length / 3e5
    np.testing.assert_allclose(path.evaluate([0.0, path.length]).x, FLOWER[[0, -1]], atol=1e-15)


def test_length_agrees_with_adaptive_quadrature():
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(FLOWER, axis=0), axis=1))])
    slope = CubicSpline(chord, FLOWER, bc_type="natural").derivative()
    expected = sum(
        quad(lambda u: np.linalg.norm(slope(u)), a, b, epsabs=1e-14, epsrel=1e-13)[0] for a, b in pairwise(chord)
    )
    assert through_points(FLOWER).length == pytest.approx(expected, rel=1e-13)


@examples(25)
@given(st.integers(0, 10**6), st.integers(3, 7), st.booleans())
def test_arc_length_is_met_on_wild_curves(seed, count, closed):
    """The chord over a short arc is its length but for (curvature × arc)² / 24; random points turn sharply."""
    path = through_points(np.random.default_rng(seed).normal(size=(count, 2)), closed=closed)
    p = np.linspace(0.0, path.length, 400)
    short = 1e-4 * path.length
    start = np.minimum(p, path.length - short)
    before, after = path.evaluate(start), path.evaluate(start + short)
    bend = np.maximum(*(np.linalg.norm(q.curvature, axis=1) for q in (before, after))) * short
    gentle = bend < 1e-2
    chord = np.linalg.norm(after.x - before.x, axis=1)
    assert gentle.mean() > 0.9
    np.testing.assert_allclose(chord[gentle], short, rtol=1e-5)


@pytest.mark.parametrize("narrow", [0.1, 0.02, 0.005])
def test_arc_length_is_met_next_to_a_cusp(narrow):
    """There the speed |r'| falls to ``narrow`` of what it is elsewhere, and a Newton step leaves its panel."""
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, narrow]])
    path = through_points(points)
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    spline = CubicSpline(knots, points, bc_type="natural")
    slope = spline.derivative()
    p = path.length * np.array([0.1, 0.4, 0.49, 0.499, 0.5, 0.501, 0.51, 0.6, 0.9])
    x, tangent, _ = path.evaluate(p)
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, rtol=1e-12)
    fine = np.linspace(0.0, knots[-1], 400_001)
    speed = np.linalg.norm(slope(fine), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(fine))])
    # the trapezoid's own error is of the order of the square of its step of 5e-6, over the sharpness of the turn
    np.testing.assert_allclose(x, spline(np.interp(p, arc, fine)), atol=2e-7)
    assert path.length == pytest.approx(arc[-1], rel=1e-8)


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_arc_length_is_met_as_closely_whatever_the_size(size):
    path, scaled = through_points(FLOWER), through_points(size * FLOWER)
    p = np.linspace(0.0, path.length, 500)
    np.testing.assert_allclose(scaled.evaluate(size * p).x / size, path.evaluate(p).x, atol=1e-13 * path.length)


def test_points_of_a_circle_give_nearly_a_circle_with_a_smooth_seam():
    """Periodic cubic splines converge with the fourth power of the spacing; 64 points leave about 1e-6."""
    angle = np.arange(64) * 2 * np.pi / 64
    path = through_points(np.column_stack([np.cos(angle), np.sin(angle)]), closed=True)
    assert path.length == pytest.approx(2 * np.pi, abs=1e-4)
    point = path.evaluate(np.linspace(0.0, path.length, 999))
    np.testing.assert_allclose(np.linalg.norm(point.x, axis=1), 1.0, atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(point.curvature, axis=1), 1.0, atol=2e-3)
    for part in point:
        np.testing.assert_allclose(part[0], part[-1], atol=1e-12)


def test_two_points_are_a_straight_line():
    path = through_points([[0, 0, 0], [1, 2, 2]])
    assert path.length == pytest.approx(3.0, rel=1e-15)
    np.testing.assert_allclose(path.evaluate(1.5).x, [0.5, 1, 1], rtol=1e-14)
    np.testing.assert_allclose(path.evaluate(1.5).curvature, 0.0, atol=1e-14)


@pytest.mark.parametrize(
    ("points", "closed", "message"),
    [
        ([[0, 0]], False, "has 1 points, expected at least 2"),
        ([[0, 0], [1, 0]], True, "has 2 points, expected at least 3"),
        ([[0, 0], [1, 0], [1, 0]], False, r"Points 1 and 2 coincide at \[1\.0, 0\.0\]"),
        ([[0, 0], [1, 0], [1, 1], [0, 0]], True, "does not repeat its first point"),
        ([0, 1, 2], False, r"points has shape \(3,\)"),
        ([[0, 0], [1, 0], [0, 0]], False, r"cusp near \[1\.0, 0\.0\]"),
    ],
)
def test_bad_points_are_refused(points, closed, message):
    with pytest.raises(InputError, match=message):
        through_points(points, closed=closed)
