import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from trajectory_checks import clear_of, differentiate

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import (
    Line,
    PiecewisePolynomial,
    RestToRest,
    SpeedProfile,
    TimingLaw,
    Trajectory,
    corner_path,
    reference,
    rounded_polygon,
    through_points,
    with_constant,
)

CORNER = reference.corner()
V, R = 0.2, 0.025


def _rest_to_rest_zigzag():
    path = rounded_polygon([[0, 0, 0], [1, 0, 0.2], [1, 1, 0.1], [2, 1, 0.9]], 0.1, closed=False)
    return Trajectory(path, RestToRest(path.length, 3.0, "4-5-6-7"))


def _spline():
    path = with_constant(through_points([[0, 0], [1, 0]]), 0.2)
    return Trajectory(path, SpeedProfile(path.length, 0.7, 0.3))


TRAJECTORIES = {
    "circle": (reference.circle(), [0.2, reference.circle().duration - 0.2]),
    "line": (reference.line(), [1.0, reference.line().duration - 1.0]),
    "corner": (CORNER, [0.4, CORNER.duration - 0.4]),
    "square": (reference.square(), [0.2, reference.square().duration - 0.2]),
    "zigzag": (_rest_to_rest_zigzag(), []),
    "spline": (_spline(), [0.3, _spline().duration - 0.3]),
}
every_trajectory = pytest.mark.parametrize(("trajectory", "inner"), TRAJECTORIES.values(), ids=TRAJECTORIES.keys())


@every_trajectory
def test_rates_are_the_derivatives_up_to_the_edge_of_every_break(trajectory, inner):
    step = 5e-4
    knots = sorted({0.0, *np.round(inner, 12), *np.round(trajectory.breaks, 12), trajectory.duration})
    knots = [a for a, b in zip(knots, [*knots[1:], np.inf], strict=True) if b - a > 1e-9]
    t = clear_of(knots, step, 60)
    point = trajectory.evaluate(t)
    # Truncation: (ω step)^8 with ω = v / r ≤ 10 rad/s is 1e-18; rounding 1e-16 / step.
    np.testing.assert_allclose(
        point.xd, differentiate(lambda s: trajectory.evaluate(s).x, t, step), atol=1e-11 + 1e-12 * trajectory.duration
    )
    np.testing.assert_allclose(point.xdd, differentiate(lambda s: trajectory.evaluate(s).xd, t, step), atol=1e-10)


@every_trajectory
def test_breaks_are_two_sided_and_nothing_else_jumps(trajectory, inner):
    motion = trajectory.sample(1e-3)
    assert motion.t[-1] == trajectory.duration
    np.testing.assert_array_equal(motion.t[motion.jumps], trajectory.breaks)
    second = np.flatnonzero(motion.jumps)
    for k in second:
        assert np.array_equal(motion.x[k], motion.x[k - 1])
        assert np.array_equal(motion.xd[k], motion.xd[k - 1])
    # Ten times finer, continuous changes shrink tenfold and jumps stay.
    coarse, fine = _changes(motion), _changes(trajectory.sample(1e-4))
    assert fine[0] < 0.15 * coarse[0]
    np.testing.assert_allclose(fine[1], coarse[1], rtol=1e-12)
    assert np.all(coarse[1] > 0.1)


def _changes(motion):
    """Largest change of acceleration between neighbours that are no jump, and the jumps themselves."""
    change = np.abs(np.diff(motion.xdd, axis=0)).max(axis=1)
    return change[~motion.jumps[1:]].max(), change[motion.jumps[1:]]


def test_jump_is_v_squared_over_r_towards_the_centre():
    for t, centre in ((CORNER.breaks[0], [-1, 0, 0]), (CORNER.breaks[1], [0, -1, 0])):
        before, after = CORNER.evaluate(t, "left").xdd, CORNER.evaluate(t, "right").xdd
        sign = 1.0 if t == CORNER.breaks[0] else -1.0
        np.testing.assert_allclose(after - before, sign * V**2 / R * np.array(centre), atol=1e-12)


def test_each_side_is_the_limit_from_that_side():
    for t in CORNER.breaks:
        for side, shift in (("left", -1e-9), ("right", 1e-9)):
            np.testing.assert_allclose(CORNER.evaluate(t, side).xdd, CORNER.evaluate(t + shift).xdd, atol=1e-7)
            # Half an ulp decides: the nearest floats around the break already see their own side.
            beside = CORNER.evaluate(np.nextafter(t, t + shift))
            np.testing.assert_allclose(CORNER.evaluate(t, side).xdd, beside.xdd, atol=1e-12)


@examples(30)
@given(st.floats(0.01, 0.05), st.floats(0.05, 0.6), st.floats(0.05, 0.3))
def test_sides_hold_next_to_breaks_wherever_rounding_puts_them(radius, speed, straight):
    ramp = 0.5 * straight
    path = corner_path([0.3, 0.7], [0.6, 0.8], straight, radius)
    trajectory = Trajectory(path, SpeedProfile(path.length, speed, ramp / (0.5 * speed)))
    assert len(trajectory.breaks) == 2
    first, last = trajectory.breaks
    size = speed**2 / radius
    for t, inside_arc in (
        (np.nextafter(first, 0), False),
        (np.nextafter(first, 9e9), True),
        (np.nextafter(last, 0), True),
        (np.nextafter(last, 9e9), False),
    ):
        assert np.linalg.norm(trajectory.evaluate(t).xdd) == pytest.approx(size if inside_arc else 0.0, abs=1e-9 * size)


def test_no_jump_where_the_speed_is_zero():
    """The polygon starts where an arc ends: at rest, so nothing jumps there; seven of eight joints remain."""
    path = rounded_polygon([[0, 0], [1, 0], [1, 1], [0, 1]], 0.2, start=0.2)
    trajectory = Trajectory(path, RestToRest(path.length, 2.0))
    assert len(trajectory.breaks) == 7
    assert len(trajectory.sample(0.03)) == 68 + 2 * 7


class _CautiousLine:
    """A user's path that declares a break where nothing jumps."""

    length, dimension, breaks = 1.0, 2, np.array([0.5])

    def evaluate(self, p, side="right"):
        return Line([0, 0], [1, 0]).evaluate(p, side)


def test_a_declared_break_without_a_jump_is_no_break():
    trajectory = Trajectory(_CautiousLine(), RestToRest(1.0, 1.0))
    assert len(trajectory.breaks) == 0
    assert not trajectory.sample(0.1).jumps.any()


def test_sampling_in_steps_ends_exactly_and_makes_no_sliver():
    line = Trajectory(Line([0, 0], [1, 0]), RestToRest(1.0, 0.7))
    np.testing.assert_allclose(line.sample(0.1).t, np.arange(8) * 0.1, atol=1e-15)
    assert line.sample(0.1).t[-1] == 0.7
    np.testing.assert_allclose(line.sample(0.3).t, [0.0, 0.3, 0.6, 0.7], atol=1e-15)
    np.testing.assert_array_equal(line.sample(5.0).t, [0.0, 0.7])
    # The corner's first break, at 0.8 s, falls on a multiple of the step but for rounding: one pair, no third.
    motion = CORNER.sample(0.1)
    assert np.sum(np.abs(motion.t - 0.8) < 1e-6) == 2
    steps = np.diff(motion.t)
    assert steps[steps > 0].min() > 1e-3
    assert len(motion) == 18 + 1 + 1 + 2


def test_one_sided_sampling_takes_the_acceleration_after():
    motion = CORNER.sample(times=[0.5, CORNER.breaks[0], 0.9], two_sided=False)
    assert len(motion) == 3
    np.testing.assert_allclose(motion.xdd[1], [-(V**2) / R, 0, 0], atol=1e-12)
    assert not CORNER.sample(0.1, two_sided=False).jumps.any()


def test_given_times_get_the_breaks_between_them():
    motion = CORNER.sample(times=[0.5, 0.9])
    np.testing.assert_array_equal(motion.t, [0.5, CORNER.breaks[0], CORNER.breaks[0], 0.9])
    assert len(CORNER.sample(times=[0.1, 0.5])) == 2
    np.testing.assert_array_equal(CORNER.sample(times=CORNER.breaks).t, np.repeat(CORNER.breaks, 2))


def test_sample_at_takes_the_times_as_they_are():
    t = CORNER.breaks[0]
    motion = CORNER.sample_at([0.1, t, t, 0.9, 1.2])
    np.testing.assert_array_equal(motion.t, [0.1, t, t, 0.9, 1.2])
    np.testing.assert_array_equal(motion.xdd[1], CORNER.evaluate(t, "left").xdd)
    np.testing.assert_array_equal(motion.xdd[2], CORNER.evaluate(t, "right").xdd)
    np.testing.assert_array_equal(motion.x[3], CORNER.evaluate(0.9).x)


def test_evaluate_keeps_shapes():
    assert CORNER.evaluate(0.5).x.shape == (3,)
    assert CORNER.evaluate(np.zeros((2, 5))).xdd.shape == (2, 5, 3)
    assert CORNER.dimension == 3


def test_time_scaling_keeps_the_path_and_squares_the_acceleration():
    fast = CORNER.scaled(3.0)
    t = np.linspace(0.0, CORNER.duration, 400)
    slow_point, fast_point = CORNER.evaluate(t), fast.evaluate(np.clip(t / 3.0, 0.0, fast.duration))
    np.testing.assert_allclose(fast.breaks, CORNER.breaks / 3.0, rtol=1e-14)
    np.testing.assert_allclose(fast_point.x, slow_point.x, atol=1e-14)
    np.testing.assert_allclose(fast_point.xd, 3.0 * slow_point.xd, atol=1e-12)
    np.testing.assert_allclose(fast_point.xdd, 9.0 * slow_point.xdd, atol=1e-10)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Trajectory(Line([0, 0], [1, 0]), RestToRest(1.1, 1.0)), "path is 1 m long, the timing law 1.1 m"),
        (lambda: CORNER.sample(), "either dt or times"),
        (lambda: CORNER.sample(0.1, times=[0.0, 0.1]), "either dt or times"),
        (lambda: CORNER.sample(0.0), "dt is 0 s, expected a positive number"),
        (lambda: CORNER.sample("often"), "dt is 'often', expected a number of s"),
        (lambda: CORNER.sample(1e-9), r"dt = 1e-09 s makes 1\.8e\+09 samples"),
        (lambda: CORNER.sample(times=[0.2, 0.1]), "strictly increasing"),
        (lambda: CORNER.sample(times=[]), "strictly increasing"),
        (lambda: CORNER.sample(times=[0.2, 3.0]), r"times = 3 s is outside \[0, 1\.79"),
        (lambda: CORNER.sample_at([0.2, 3.0]), r"times = 3 s is outside"),
        (lambda: CORNER.sample_at([0.2, 0.1]), "Time does not increase"),
        (lambda: CORNER.evaluate(-1.0), r"t = -1 s is outside"),
        (lambda: CORNER.evaluate(0.1, "up"), "side is 'up'"),
    ],
)
def test_bad_calls_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_a_law_whose_acceleration_jumps_where_the_path_bends_has_both_sides():
    """Uniform acceleration to the end of the straight, then constant speed on the arc: a jump of both."""
    path, speed = corner_path((0.0, 0.0), (1.0, 0.0), 0.5, 0.1), 0.4
    t = np.array([0.0, 2.0 * 0.5 / speed, 2.0 * 0.5 / speed + (path.length - 0.5) / speed])
    rate = 0.5 * speed**2 / 0.5
    p, pd, pdd = np.array([[0.0, 0.5, path.length], [0.0, speed, speed], [rate, 0.0, 0.0]])[:, :, None]
    trajectory = Trajectory(path, TimingLaw.of(PiecewisePolynomial.taylor(t, p, pd, pdd), path.length))
    np.testing.assert_allclose(trajectory.breaks[0], t[1], rtol=1e-14)
    before, after = (trajectory.evaluate(trajectory.breaks[0], side) for side in ("left", "right"))
    np.testing.assert_allclose(before.xdd, [rate, 0.0], atol=1e-12)
    np.testing.assert_allclose(after.xdd, [0.0, speed**2 / 0.1], atol=1e-12)
    np.testing.assert_array_equal([*before.x, *before.xd], [*after.x, *after.xd])
    both = trajectory.sample_at([0.3, *trajectory.breaks[[0, 0]], 2.7])
    np.testing.assert_array_equal(both.xdd[1:3], [before.xdd, after.xdd])
