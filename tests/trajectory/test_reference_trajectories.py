"""The thesis's trajectories against the times and places stated in it (Parsa 2014, sections 3.2, 3.3, 4.2.2, 4.3)."""

import numpy as np
import pytest
from scipy.optimize import brentq

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import reference


def _condition_number(x):
    """cot(γ/2), γ the acute angle between the legs from (0, 0) and (0.5, 0) to x."""
    first, second = np.arctan2(x[1], x[0]), np.arctan2(x[1], x[0] - 0.5)
    sine, cosine = abs(np.sin(first - second)), abs(np.cos(first - second))
    return (1.0 + cosine) / sine


def test_circle_lasts_as_long_as_stated_and_closes():
    circle = reference.circle()
    assert circle.duration == pytest.approx(2.68, abs=5e-4)
    assert circle.timing.duration - circle.timing.end_ramp_time == pytest.approx(2.48, abs=5e-4)
    np.testing.assert_allclose(circle.evaluate(0.0).x, [0.05, 0.185], atol=1e-15)
    np.testing.assert_allclose(circle.evaluate(circle.duration).x, [0.05, 0.185], atol=1e-15)
    assert np.linalg.norm(circle.evaluate(0.2).xd) == pytest.approx(0.5, rel=1e-13)
    assert circle.evaluate(0.2).xd[1] < 0.0  # counter-clockwise: down from the leftmost point
    assert len(circle.breaks) == 0


@pytest.mark.parametrize(
    ("speed", "threshold", "enter", "leave"),
    [(0.5, 5, 0.38, 0.97), (0.75, 5, 0.26, 0.67), (0.5, 20, 0.47, 0.89)],
)
def test_circle_enters_and_leaves_the_singular_region_when_stated(speed, threshold, enter, leave):
    """This is what the ramp length is inferred from: with v T / 2 the times would be 50 ms off."""
    circle = reference.circle(speed)
    rebuilt = [
        brentq(lambda t: _condition_number(circle.evaluate(t).x) - threshold, t - 0.035, t + 0.035)
        for t in (enter, leave)
    ]
    np.testing.assert_allclose(rebuilt, [enter, leave], atol=0.012)  # stated with two digits, in steps


def test_circle_ramps_can_be_chosen():
    symmetric = reference.circle(ramp_length=0.05)
    assert symmetric.timing.end_ramp_length == 0.05
    assert symmetric.duration == pytest.approx(0.4 + (0.4 * np.pi - 0.1) / 0.5, rel=1e-14)
    assert reference.circle(end_ramp_length=0.06).timing.end_ramp_length == 0.06
    slow = reference.circle(ramp_time=0.4)
    assert slow.timing.ramp_length == pytest.approx(0.765 * 0.5 * 0.4)
    assert reference.circle().timing.peak_speed == pytest.approx(0.5 * 1.135, rel=1e-3)


def test_line_goes_where_stated():
    line = reference.line()
    length = np.hypot(0.1, 1.1)
    assert line.duration == pytest.approx(2.0 + (length - 0.1) / 0.1, rel=1e-14)
    np.testing.assert_array_equal(line.evaluate(line.duration).x, [0.25, -0.7])
    assert np.linalg.norm(line.evaluate(1.0).xd) == pytest.approx(0.1, rel=1e-13)
    crossing = brentq(lambda t: line.evaluate(t).x[1], 2.0, 8.0)
    assert line.evaluate(crossing).x[0] == pytest.approx(0.186, abs=5e-4)
    # The forces begin to decrease at 3.5 s, 0.36 s before the condition number reaches 4; read off a figure.
    threshold = brentq(lambda t: _condition_number(line.evaluate(t).x) - 4.0, 2.0, 4.4)
    assert threshold - 0.36 == pytest.approx(3.5, abs=0.1)


@pytest.mark.parametrize("radius", [0.025, 0.013])
def test_corner_times(radius):
    corner = reference.corner(radius)
    turn = radius * np.pi / 2 / 0.2
    np.testing.assert_allclose(corner.breaks, [0.8, 0.8 + turn], rtol=1e-13)
    assert corner.duration == pytest.approx(1.6 + turn, rel=1e-13)
    if radius == 0.025:
        np.testing.assert_allclose([corner.breaks[1], corner.duration], [0.996, 1.80], atol=0.004)
    start, end = corner.evaluate(0.0).x, corner.evaluate(corner.duration).x
    np.testing.assert_array_equal(start, [1.0, 0.4, 0.0])
    np.testing.assert_allclose(end, [1.0 - radius - 0.12, 0.4 + 0.12 + radius, 0.0], rtol=1e-14)
    np.testing.assert_allclose(corner.evaluate(0.6).xd, [0.0, 0.2, 0.0], atol=1e-14)
    np.testing.assert_allclose(corner.evaluate(1.2).xd, [-0.2, 0.0, 0.0], atol=1e-14)


def test_corner_keeps_its_orientation():
    motion = reference.corner(alpha=0.3).sample(0.01)
    assert np.all(motion.x[:, 2] == 0.3)
    assert np.all(motion.xd[:, 2] == 0.0)


def test_square_closes_and_brakes_as_its_last_corner_ends():
    square = reference.square()
    np.testing.assert_allclose(square.evaluate(0.0).x, [1.0, 0.4, 0.0], atol=1e-15)
    np.testing.assert_allclose(square.evaluate(square.duration).x, [1.0, 0.4, 0.0], atol=1e-15)
    np.testing.assert_allclose(square.evaluate(0.4).xd, [0.0, 0.2, 0.0], atol=1e-14)
    assert len(square.breaks) == 8
    assert square.breaks[-1] == pytest.approx(square.duration - 0.2, rel=1e-13)
    assert square.duration == pytest.approx(0.4 + (4 * 0.17 + 0.05 * np.pi - 0.04) / 0.2, rel=1e-13)
    x = square.sample(1e-3).x
    np.testing.assert_allclose(np.ptp(x[:, :2], axis=0), 0.22, atol=1e-6)
    assert x[:, 0].max() == pytest.approx(1.0, abs=1e-12)  # the start is on the right side


def test_square_corners_are_where_the_text_has_its_carriers_at_the_limit():
    """Speed limits at 1.0 and 2.11 s belong to corners, the return at 1.1 s to a straight (20 ms reading error)."""
    enter, leave = reference.square().breaks.reshape(4, 2).T
    assert enter[0] < 1.0 < leave[0]
    assert leave[0] < 1.1 < enter[1]
    assert enter[1] < 2.11 < leave[1] + 0.02
    small_enter, small_leave = reference.square(side=0.12).breaks.reshape(4, 2).T
    assert not any(a < 1.0 < b + 0.02 for a, b in zip(small_enter, small_leave, strict=True))


def test_square_with_another_ramp_length_starts_elsewhere_on_its_side():
    square = reference.square(ramp_length=0.018)
    np.testing.assert_allclose(square.evaluate(square.duration).x, [1.0, 0.4, 0.0], atol=1e-15)
    assert square.breaks[-1] == pytest.approx(square.duration - 0.2, rel=1e-13)
    assert square.breaks[0] == pytest.approx(0.2 + (0.17 - 2 * 0.018) / 0.2, rel=1e-13)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: reference.circle(speed=-1.0), "speed is -1 m/s"),
        (lambda: reference.circle(ramp_length=0.01), "Admissible is 0.04 m"),
        (lambda: reference.line(speed=2.0), "path is too short"),
        (lambda: reference.corner(straight=0.0), "straight is 0 m"),
        (lambda: reference.square(radius=0.0), "radius is 0 m"),
        (lambda: reference.square(ramp_time=2.0), "not on the straight part"),
    ],
)
def test_bad_numbers_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
