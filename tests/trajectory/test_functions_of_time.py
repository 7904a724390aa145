"""Functions of time: accuracy of the powers, both sides of a jump, extremes, and the platform in polynomials."""

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import chebyshev
from scipy.interpolate import BPoly
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from zoo import robot_of, smooth_motion

from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, first_times

EDGES = np.array([0.7, 0.75, 0.9])


def waves(t):
    return np.stack([np.sin(20.0 * t + 0.3), np.exp(-3.0 * t)], axis=1)


@pytest.fixture(scope="module")
def fitted():
    return PiecewisePolynomial.fit(waves, EDGES, np.empty(0), lambda v: np.ones(v.shape[1]), 1e-13)


def test_twelve_digits_survive_as_in_the_chebyshev_series(fitted):
    t = np.random.default_rng(0).uniform(*EDGES[[0, -1]], 2000)
    assert np.abs(fitted(t) - waves(t)).max() < 1e-14
    assert np.abs(fitted.derivative()(t)[:, 0] - 20.0 * np.cos(20.0 * t + 0.3)).max() < 20.0 * 1e-11
    assert np.abs(fitted.derivative(2)(t)[:, 0] + 400.0 * np.sin(20.0 * t + 0.3)).max() < 400.0 * 1e-9
    np.testing.assert_allclose([fitted.at(time) for time in t[:50]], fitted(t[:50]), rtol=0.0, atol=1e-15)


@examples(50)
@given(seed=st.integers(0, 10**6), tail=st.sampled_from([1e-12, 1e-9, 1e-6]))
def test_powers_are_the_series_they_come_from(seed, tail):
    rng = np.random.default_rng(seed)
    series = rng.normal(size=(1, 16, 1)) * np.maximum(0.1 ** np.arange(16.0), tail)[None, :, None]
    x = np.linspace(-1.0, 1.0, 101)
    ours = PiecewisePolynomial.from_series(np.array([3.0, 3.01]), series)(3.0 + 0.005 * (x + 1.0))
    # powers are up to 3e11 times the tail and cancel; a rounding of t, of so short a piece, is 1e-13
    expected = chebyshev.chebval(x, series[0, :, 0])
    np.testing.assert_allclose(ours[:, 0], expected, rtol=0.0, atol=1e-12 + 2e-4 * tail)


def test_an_edge_has_two_sides_and_outside_are_the_ends():
    steps = PiecewisePolynomial.joined([PiecewisePolynomial.constant(np.array([v]), v, v + 1.0) for v in (0.0, 1.0)])
    assert [float(steps(np.array([1.0]), side)[0, 0]) for side in ("left", "right")] == [0.0, 1.0]
    assert steps.jumps().tolist() == [1.0]
    assert steps(np.array([-5.0, 9.0]))[:, 0].tolist() == [0.0, 1.0]
    assert steps.remove_offsets().jumps().size == 0
    np.testing.assert_array_equal(steps.between(0.0, 1.5).edges, [0.0, 1.0, 1.5])


@examples(30)
@given(seed=st.integers(0, 10**6))
def test_a_function_between_two_times_is_the_same_there(seed):
    rng = np.random.default_rng(seed)
    edges = np.cumsum(rng.uniform(0.1, 1.0, 5))
    whole = PiecewisePolynomial(edges, rng.normal(size=(int(rng.integers(1, 6)), 4, 2)))
    at_edges = edges[[int(rng.integers(0, 2)), int(rng.integers(2, 5))]]
    for start, end in (np.sort(rng.uniform(edges[0], edges[-1], 2)), at_edges, (at_edges[0], edges[2] + 0.01)):
        part, times = whole.between(start, end), rng.uniform(start, end, 20)
        assert [part.start, part.end] == [start, end]
        np.testing.assert_allclose(part(times), whole(times), rtol=0.0, atol=1e-13)
    behind = whole.between(edges[-1] + 1.0, edges[-1] + 2.0)
    np.testing.assert_allclose(behind.at(behind.start), whole.at(edges[-1]), rtol=0.0, atol=1e-13)


@examples(40)
@given(seed=st.integers(0, 10**6), start=st.sampled_from([0.0, -3.0, 1e3]))
def test_first_times_are_those_of_brentq(seed, start):
    """Of random functions that rise, with pieces of all widths and a rate of zero at some ends of pieces."""
    dice = np.random.default_rng(seed)
    edges = start + np.concatenate([[0.0], np.cumsum(10.0 ** dice.uniform(-3.0, 0.0, 4))])
    rates = dice.uniform(0.0, 1.0, 5) * dice.integers(0, 2, 5)
    control = np.zeros((4, 4))
    for k, width in enumerate(np.diff(edges)):  # Bernstein coefficients that rise make a curve that rises
        rise = width * np.array([rates[k], dice.uniform(0.1, 1.0), rates[k + 1]]) / 3.0
        control[:, k] = (control[-1, k - 1] if k else 0.0) + np.concatenate([[0.0], np.cumsum(rise)])
    curve = BPoly(control, edges)
    wanted = np.concatenate([dice.uniform(0.0, control[-1, -1], 20), control[0], control[-1, -1:]])
    found = first_times(curve, wanted)
    assert found.shape == wanted.shape
    for value, t in zip(wanted[:20], found[:20], strict=True):
        expected = brentq(lambda t, value=value: curve(t) - value, *edges[[0, -1]], xtol=1e-300, rtol=9e-16)
        # next to a rate of zero a rounding of the value moves its time by the square root
        assert abs(t - expected) <= 1e-7 * np.ptp(edges)
        assert abs(curve(t) - value) <= 4e-16 * max(value, np.finfo(float).eps) + 1e-15 * np.abs(edges).max()
    np.testing.assert_array_equal(found[20:], edges)
    np.testing.assert_array_equal(first_times(curve, [-1.0, 1e9]), edges[[0, -1]])


def test_extremes_peaks_and_ranges_against_dense_samples(fitted):
    dense = np.linspace(*EDGES[[0, -1]], 200_001)
    values = fitted(dense)
    least, most = fitted.ranges()
    np.testing.assert_allclose(most.max(axis=0), values.max(axis=0), atol=1e-9)
    np.testing.assert_allclose(least.min(axis=0), values.min(axis=0), atol=1e-9)
    turning = dense[1:-1][np.diff(np.sign(np.diff(values[:, 0]))) != 0]
    np.testing.assert_allclose(fitted.extremes(), turning, atol=2e-6)
    assert set(fitted.peaks()) <= set(fitted.extremes())


def turning():
    end = np.eye(4)
    end[:3, :3], end[:3, 3] = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), [0.1, 0.0, 0.2]
    return reference.pose(np.eye(4), end)


@pytest.mark.parametrize("make", [reference.corner, reference.circle, turning])
def test_a_trajectory_in_polynomials_is_the_trajectory(make):
    trajectory = make()
    exact = as_motion(trajectory)
    t = np.sort(np.concatenate([np.linspace(0.0, trajectory.duration, 997), exact.breaks, exact.breaks]))
    ours = type(exact)(exact.polynomials, exact.start, exact.end, exact.moves_until, exact.breaks, exact.knots, True)
    mine, theirs = ours.sample_at(t), exact.sample_at(t)
    for part in ("x", "xd", "xdd"):
        size = np.abs(getattr(theirs, part)).max()
        np.testing.assert_allclose(getattr(mine, part), getattr(theirs, part), rtol=0.0, atol=1e-10 * size)


def test_a_held_platform_stays_where_it_is():
    motion = as_motion(reference.corner())
    later = motion.prolonged_until(motion.end + 1.0)
    assert (later.breaks[-1], later.end) == (motion.end, motion.end + 1.0)
    samples = later.sample_at(np.array([0.5, motion.end, motion.end, motion.end + 0.5]))
    np.testing.assert_array_equal(samples.x[2], samples.x[1])
    assert not samples.xd[2:].any()
    assert not samples.xdd[2:].any()


def ends_moving():
    return reference.corner().sample(0.01)[:90]


@pytest.mark.parametrize("make", [reference.corner, turning, ends_moving])
def test_states_are_the_values_of_the_samples(make):
    exact = as_motion(make())
    polynomials = type(exact)(
        exact.polynomials, exact.start, exact.end, exact.moves_until, exact.breaks, exact.knots, True
    )
    held = () if make is ends_moving else (polynomials.prolonged_until(exact.end + 1.0),)
    for motion in (exact, polynomials, *held):
        end = exact.end
        for times in ([0.5, 0.7], [end - 0.2, motion.end], [end], [0.1, *exact.breaks], [end - 1e-9, end]):
            t = np.array(times)
            samples = motion.sample_at(t)
            for got, name in zip(motion.states_at(t), ("x", "xd", "xdd"), strict=True):
                # summed up otherwise: powers in place of Horner's rule
                np.testing.assert_allclose(got, getattr(samples, name), rtol=1e-13, atol=1e-13)


def test_quintics_have_the_given_values_and_derivatives_at_both_ends():
    random = np.random.default_rng(5)
    edges = np.array([0.3, 0.5, 1.3, 1.4])
    given = random.normal(size=(3, 6, 2))  # both sides of two jumps
    quintics = PiecewisePolynomial.through(np.repeat(edges, [1, 2, 2, 1]), *given)
    for order in range(3):
        rate = quintics.derivative(order)
        np.testing.assert_allclose(rate(edges[:-1]), given[order, ::2], rtol=0.0, atol=1e-11)
        # second differences of values of order one over pieces of 0.1 s, one ulp of time before the end
        np.testing.assert_allclose(rate(edges[1:], "left"), given[order, 1::2], rtol=0.0, atol=1e-9)


def tumbling(step):
    """Return a motion about all three axes, fast enough to turn by up to 0.2 rad a step, and its samples."""
    exact = smooth_motion(robot_of("gough"), 1, scale=2.0, speed=12.0)
    return exact, exact.at(np.arange(0.0, 1.0 + 0.5 * step, step))


def pose_errors(step):
    exact, samples = tumbling(step)
    t = np.linspace(0.0, samples.t[-1], 499)
    ours, theirs = as_motion(samples).sample_at(t), exact.at(t)
    return [np.abs(getattr(ours, part) - getattr(theirs, part)).max() for part in ("x", "xd", "xdd")]


def test_poses_between_samples_have_the_orders_of_a_quintic():
    coarse, fine = np.array(pose_errors(0.05)), np.array(pose_errors(0.025))
    orders = np.log2(coarse / fine)
    np.testing.assert_allclose(orders, [6.0, 5.0, 4.0], atol=0.7)
    assert (fine < [1e-7, 1e-5, 1e-3]).all()


def test_dense_samples_of_poses_do_not_show_their_rounding():
    position, speed, acceleration = pose_errors(5e-4)
    assert position < 1e-14
    assert speed < 1e-10
    assert acceleration < 1e-7  # second differences would leave 60 · 2e-16 / 2.5e-7 = 5e-8 of noise, and more


def test_an_acceleration_of_poses_that_jumps_has_two_sides():
    _, samples = tumbling(0.05)
    twice = np.insert(np.arange(len(samples)), 8, 7)  # the sample at 0.35 s
    kick = np.where(np.arange(len(twice))[:, None] == 8, [0.0, 0.0, 1.0, 0.0, 2.0, 0.0], 0.0)
    motion = PlatformMotion(samples.t[twice], samples.x[twice], samples.xd[twice], samples.xdd[twice] + kick)
    continuous = as_motion(motion)
    assert continuous.breaks.tolist() == [samples.t[7]]
    there = continuous.sample_at(np.array([0.0, samples.t[7], samples.t[7], 0.5]))
    np.testing.assert_allclose(there.xdd[2] - there.xdd[1], kick[8], atol=1e-9)
    np.testing.assert_allclose(there.xdd[1], samples.xdd[7], atol=1e-9)


def test_poses_that_do_not_say_which_way_they_turn_are_refused():
    turned = np.tile(np.eye(4), (2, 1, 1))
    turned[1, :3, :3] = Rotation.from_rotvec([0.0, 0.0, 3.1]).as_matrix()
    with pytest.raises(InputError, match=r"turns by 3.1 rad between its samples at 0 and 1 s.*more densely"):
        as_motion(PlatformMotion([0.0, 1.0], turned, np.zeros((2, 6)), np.zeros((2, 6))))


@pytest.mark.parametrize(("start", "length"), [(-1.0, 2.0), (-2.0, 2.0), (0.0, 2.0), (100.0, 2.0), (-1000.0, 2000.0)])
def test_a_kink_that_is_not_declared_is_resolved(start, length):
    """Pieces are halved until they are 1e-7 of the interval wide."""
    kink = start + 0.637 * length

    def function(t):
        return np.abs(t - kink)[:, None] / length * [1.0, -0.5]

    found = PiecewisePolynomial.fit(
        function, np.array([start, start + length]), np.empty(0), lambda values: np.abs(values).max(axis=0), 1e-13
    )
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
