"""Every path: unit speed, exact derivatives, continuity, one-sided curvature at the breaks."""

import numpy as np
import pytest
from trajectory_checks import clear_of, differentiate

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import (
    Arc,
    ChainedPath,
    Line,
    circle_path,
    corner_path,
    rounded_polygon,
    through_points,
    with_constant,
)

ZIGZAG = [[0, 0, 0], [1, 0, 0.2], [1, 1, 0.1], [2, 1, 0.9]]
FLOWER = [[0, 0], [0.3, 0.1], [0.5, 0.5], [0.2, 0.8], [-0.3, 0.6]]
PATHS = {
    "line": Line([0.15, 0.4], [0.25, -0.7]),
    "line in 4-D": Line([0, 0, 0, 0], [1, 2, 3, 4]),
    "circle": circle_path([0.25, 0.185], 0.2, np.pi),
    "clockwise arc": circle_path([1.0, -2.0], 0.7, 0.3, -1.9),
    "corner": corner_path([1, 0.4], [0, 2], 0.12, 0.025),
    "right corner": corner_path([0, 0], [1, 1], 0.1, 0.05, -2.5, 0.3),
    "square": rounded_polygon([[0, 0], [1, 0], [1, 1], [0, 1]], 0.2),
    "zigzag in space": rounded_polygon(ZIGZAG, 0.1, closed=False),
    "spline": through_points(FLOWER),
    "closed spline": through_points(FLOWER, closed=True),
    "spline in space": through_points(ZIGZAG),
    "appended": with_constant(corner_path([1, 0.4], [0, 1], 0.12, 0.025), 0.3),
}
every_path = pytest.mark.parametrize("path", PATHS.values(), ids=PATHS.keys())


def _knots(path):
    """Arc lengths at which the path is not smooth: its breaks, and the points of a spline."""
    inner = list(path.breaks)
    if hasattr(path, "points"):
        dense = np.linspace(0.0, path.length, 20001)
        x = path.evaluate(dense).x
        inner = [dense[np.argmin(np.linalg.norm(x - point, axis=1))] for point in path.points]
    return sorted({0.0, *inner, path.length})


@every_path
def test_tangent_and_curvature_are_the_derivatives(path):
    step = path.length * 2e-4
    if hasattr(path, "points"):
        step *= 2.0  # spline knots are located on a grid of length / 20000 only; the stencil keeps clear of them
    p = clear_of(_knots(path), step)
    x_p = differentiate(lambda q: path.evaluate(q).x, p, step)
    x_pp = differentiate(lambda q: path.evaluate(q).tangent, p, step)
    point = path.evaluate(p)
    # Rounding of x over the step: 1e-15 / 2e-4 on paths of a metre; truncation is of order (step / radius)^8.
    np.testing.assert_allclose(point.tangent, x_p, atol=1e-10)
    np.testing.assert_allclose(point.curvature, x_pp, atol=1e-10 * max(1.0, np.abs(point.curvature).max() ** 2))


@every_path
def test_parameter_is_the_arc_length(path):
    p = np.linspace(0.0, path.length, 501)
    point = path.evaluate(p)
    np.testing.assert_allclose(np.linalg.norm(point.tangent, axis=-1), 1.0, rtol=1e-14)
    across = np.sum(point.tangent * point.curvature, axis=-1)
    np.testing.assert_allclose(across, 0.0, atol=1e-13 * max(1.0, np.abs(point.curvature).max()))


@every_path
def test_position_is_continuous_and_sides_differ_in_curvature_only(path):
    for b in path.breaks:
        left, right = path.evaluate(b, "left"), path.evaluate(b, "right")
        assert np.array_equal(left.x, right.x)
        assert np.array_equal(left.tangent, right.tangent)
        assert np.abs(left.curvature - right.curvature).max() > 0.1
        for side, shift in ((left, -1e-9), (right, 1e-9)):
            beside = path.evaluate(b + shift)
            np.testing.assert_allclose(side.curvature, beside.curvature, atol=1e-4)  # 1e-9 × curvature² ≤ 2e-6
            np.testing.assert_allclose(side.x, beside.x, atol=2e-9)
    away = np.linspace(0.0, path.length, 7)[1:-1]
    away = away[[np.abs(path.breaks - p).min(initial=1.0) > 1e-6 for p in away]]
    for one, other in zip(path.evaluate(away, "left"), path.evaluate(away, "right"), strict=True):
        assert np.array_equal(one, other)


@every_path
def test_shapes_and_domain(path):
    assert path.evaluate(0.0).x.shape == (path.dimension,)
    assert path.evaluate(np.zeros((2, 3))).curvature.shape == (2, 3, path.dimension)
    assert path.evaluate(np.zeros(0)).tangent.shape == (0, path.dimension)
    with pytest.raises(InputError, match=r"p = .* m is outside \[0, "):
        path.evaluate(path.length * 1.001)
    with pytest.raises(InputError, match="side is 'both'"):
        path.evaluate(0.0, "both")


def test_line_meets_its_ends_exactly():
    line = Line([0.15, 0.4], [0.25, -0.7])
    assert line.length == pytest.approx(np.sqrt(0.01 + 1.21), rel=1e-15)
    assert np.array_equal(line.evaluate(line.length).x, [0.25, -0.7])


def test_circle_runs_counter_clockwise_for_a_positive_sweep():
    circle = circle_path([0.25, 0.185], 0.2, np.pi)
    assert circle.length == pytest.approx(0.4 * np.pi, rel=1e-15)
    np.testing.assert_allclose(circle.evaluate(0.0).x, [0.05, 0.185], atol=1e-16)
    np.testing.assert_allclose(circle.evaluate(0.1 * np.pi).x, [0.25, -0.015], atol=1e-15)
    clockwise = circle_path([0.25, 0.185], 0.2, np.pi, -2 * np.pi)
    np.testing.assert_allclose(clockwise.evaluate(0.1 * np.pi).x, [0.25, 0.385], atol=1e-15)


def test_appended_constant_stays():
    point = PATHS["appended"].evaluate(np.linspace(0.0, 0.2, 5))
    assert point.x.shape == (5, 3)
    assert np.all(point.x[:, 2] == 0.3)
    assert np.all(point.tangent[:, 2] == 0.0)
    assert np.all(point.curvature[:, 2] == 0.0)
    np.testing.assert_array_equal(with_constant(Line([0, 0], [1, 0]), [1, 2]).evaluate(0.5).x, [0.5, 0, 1, 2])


def test_chain_of_own_segments_and_its_breaks():
    """Two half circles of one radius in the same sense: a joint without a jump; then an S-bend: a jump."""
    first = circle_path([0, 0], 1.0, 0.0, np.pi)
    same = circle_path([0, 0], 1.0, np.pi, np.pi / 2)
    s_bend = circle_path([0, -2], 1.0, np.pi / 2, -np.pi / 2)
    chain = ChainedPath([first, same, s_bend])
    np.testing.assert_allclose(chain.breaks, [1.5 * np.pi], rtol=1e-15)
    nested = ChainedPath([ChainedPath([first, same]), s_bend])
    np.testing.assert_array_equal(nested.breaks, chain.breaks)
    before, after = (chain.evaluate(chain.breaks[0], side).curvature for side in ("left", "right"))
    np.testing.assert_allclose(before, [0, 1], atol=1e-15)
    np.testing.assert_allclose(after, [0, -1], atol=1e-15)


def test_arc_tangent_to_a_chain_keeps_inner_breaks():
    corner = corner_path([0, 0], [1, 0], 1.0, 0.5)
    end = corner.evaluate(corner.length)
    longer = ChainedPath([corner, Line(end.x, end.x + end.tangent)])
    np.testing.assert_array_equal(longer.breaks, corner.breaks)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Line([1, 2], [1, 2]), r"starts and ends at \[1.0, 2.0\]"),
        (lambda: Line([1, 2], [1, 2, 3]), r"end has shape \(3,\), expected \(2,\)"),
        (lambda: circle_path([0, 0], -0.2), r"radius is -0\.2 m, expected a positive number"),
        (lambda: circle_path([0, 0], 0.2, sweep=0.0), "sweep is 0 rad"),
        (lambda: circle_path([0, 0, 0], 0.2), r"centre has shape \(3,\)"),
        (lambda: Arc([0, 0], 1.0, [1, 0], [0.5, 1], 1.0), r"miss orthonormality by 0\.5"),
        (lambda: ChainedPath([]), "at least one segment"),
        (lambda: ChainedPath([Line([0, 0], [1, 0]), Line([1, 0], [1, 1])]), r"unit tangents by 1\.41"),
        (lambda: ChainedPath([Line([0, 0], [1, 0]), Line([1.1, 0], [2, 0])]), r"positions differ by 0\.1 m"),
        (lambda: ChainedPath([Line([0, 0], [1, 0]), Line([1, 0, 0], [2, 0, 0])]), "have 2 and 3 coordinates"),
        (lambda: with_constant(Line([0, 0], [1, 0]), np.nan), "values has 1 value"),
    ],
)
def test_bad_paths_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
