import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import corner_path, rounded_polygon

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def test_corner_of_the_thesis():
    path = corner_path([1.0, 0.4], [0.0, 1.0], 0.12, 0.025)
    np.testing.assert_allclose(path.breaks, [0.12, 0.12 + 0.025 * np.pi / 2], rtol=1e-14)
    np.testing.assert_allclose(path.evaluate(path.length).x, [1 - 0.025 - 0.12, 0.4 + 0.12 + 0.025], rtol=1e-14)
    np.testing.assert_allclose(path.evaluate(path.breaks[0], "right").curvature, [-40.0, 0.0], atol=1e-12)
    assert np.all(path.evaluate(path.breaks[0], "left").curvature == 0.0)


@given(st.floats(-3.0, 3.0).filter(lambda a: abs(a) > 0.05), st.floats(-3.1, 3.1))
def test_corner_turns_by_its_angle(angle, heading):
    path = corner_path([0.0, 0.0], [3 * np.cos(heading), 3 * np.sin(heading)], 0.2, 0.1, angle, 0.3)
    assert path.length == pytest.approx(0.5 + 0.1 * abs(angle), rel=1e-13)
    end = path.evaluate(path.length).tangent
    np.testing.assert_allclose(end, [np.cos(heading + angle), np.sin(heading + angle)], atol=1e-13)


def test_closed_square_starts_and_ends_in_the_middle_of_its_first_edge():
    path = rounded_polygon(SQUARE, 0.2)
    assert path.length == pytest.approx(4 * 0.6 + 2 * np.pi * 0.2, rel=1e-14)
    assert len(path.breaks) == 8
    for p in (0.0, path.length):
        np.testing.assert_allclose(path.evaluate(p).x, [0.5, 0.0], atol=1e-15)
        np.testing.assert_allclose(path.evaluate(p).tangent, [1.0, 0.0], atol=1e-15)


def test_closed_polygon_may_start_where_an_arc_ends():
    path = rounded_polygon(SQUARE, 0.2, start=0.2)
    assert path.length == pytest.approx(4 * 0.6 + 2 * np.pi * 0.2, rel=1e-14)
    assert len(path.breaks) == 7  # the eighth is the seam itself


def test_largest_radius_leaves_no_straight_and_no_jump():
    path = rounded_polygon(SQUARE, 0.5, start=0.5)
    assert path.length == pytest.approx(np.pi, rel=1e-14)
    assert len(path.breaks) == 0
    radius = np.linalg.norm(path.evaluate(np.linspace(0, np.pi, 50)).x - 0.5, axis=1)
    np.testing.assert_allclose(radius, 0.5, rtol=1e-14)


def test_open_polygon_keeps_its_ends_and_rounds_in_the_plane_of_each_corner():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1.0]])
    path = rounded_polygon(vertices, 0.1, closed=False)
    assert path.length == pytest.approx(3 - 4 * 0.1 + 0.1 * np.pi, rel=1e-14)
    np.testing.assert_array_equal(path.evaluate(0.0).x, vertices[0])
    np.testing.assert_allclose(path.evaluate(path.length).x, vertices[-1], atol=1e-15)
    middle = 0.9 + 0.1 * np.pi / 4
    expected = vertices[1] + 0.1 * (np.sqrt(2) - 1) * np.array([-1, 1, 0]) / np.sqrt(2)
    np.testing.assert_allclose(path.evaluate(middle).x, expected, atol=1e-15)


def test_vertices_on_a_straight_edge_make_no_break():
    path = rounded_polygon([[0, 0], [1, 0], [2, 0], [2, 1]], 0.1, closed=False)
    assert len(path.breaks) == 2
    two_points = rounded_polygon([[0, 0], [1, 1]], 0.1, closed=False)
    assert two_points.length == pytest.approx(np.sqrt(2), rel=1e-15)


def test_radius_that_does_not_fit_names_the_largest_that_does():
    with pytest.raises(InputError, match=r"radius 0\.6 m does not fit: edge 0 is 1 m long .* take 1\.2 m") as caught:
        rounded_polygon(SQUARE, 0.6)
    assert caught.value.details["largest_radius"] == pytest.approx(0.5, rel=1e-14)
    rounded_polygon(SQUARE, caught.value.details["largest_radius"])
    # An open polygon rounds its first and last edge on one side only: 90° on edges of 1 and 2 m fits r = 1 m.
    rounded_polygon([[0, 0], [1, 0], [1, 2]], 1.0, closed=False)
    with pytest.raises(InputError, match=r"at most 1 m"):
        rounded_polygon([[0, 0], [1, 0], [1, 2]], 1.01, closed=False)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rounded_polygon([[0, 0], [1, 0]], 0.1), "has 2 points, expected at least 3"),
        (lambda: rounded_polygon([[0, 0], [1, 0], [1, 0], [2, 2]], 0.1), r"Points 1 and 2 coincide at \[1\.0, 0\.0\]"),
        (lambda: rounded_polygon([*SQUARE, SQUARE[0]], 0.1), "closed list does not repeat its first point"),
        (lambda: rounded_polygon([[0, 0], [1, 0], [0.2, 0]], 0.1, closed=False), "turns back on itself after edge 0"),
        (lambda: rounded_polygon(SQUARE, 0.0), r"radius is 0 m, expected a positive number"),
        (lambda: rounded_polygon(SQUARE, 0.2, start=0.1), r"start = 0\.1 m is not on the .*\[0\.2, 0\.8\] m"),
        (lambda: rounded_polygon(SQUARE, 0.2, closed=False, start=0.5), "start = 0.5 m is for a closed polygon"),
        (lambda: corner_path([0, 0], [0, 0], 0.1, 0.1), "needs a direction"),
        (lambda: corner_path([0, 0], [1, 0], 0.1, 0.1, 0.0), "angle = 0 rad"),
        (lambda: corner_path([0, 0], [1, 0], -0.1, 0.1), r"straight is -0\.1 m"),
        (lambda: corner_path([0, 0], [1, 0], 0.1, 0.1, second_straight=0.0), "second_straight is 0 m"),
    ],
)
def test_bad_corners_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-2])
@pytest.mark.parametrize(("end", "outwards"), [(0.2, -1.0), (0.8, 1.0)])
@pytest.mark.parametrize(("slacks", "right"), [(0.0, True), (0.5, True), (2.0, False), (-1e9, True)])
def test_a_closed_polygon_begins_on_the_straight_part_of_its_first_edge(unit, end, outwards, slacks, right):
    start = (end + outwards * slacks * 1e-12) * unit
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


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-2])
def test_a_closed_polygon_begins_in_the_middle_of_a_straight_between_unlike_corners(unit):
    """A triangle of 3, 4 and 5: its corners are a right angle and those whose tangents are 3/4 and 4/3."""
    vertices = unit * np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
    radius = 0.3 * unit
    # at each end an arc takes r / tan(half the angle inside)
    low = radius / np.tan(0.5 * np.arctan2(3.0, 4.0))
    high = 4.0 * unit - radius
    path = rounded_polygon(vertices, radius)
    np.testing.assert_allclose(path.evaluate(0.0).x, [0.5 * (low + high), 0.0], atol=1e-13 * unit)
