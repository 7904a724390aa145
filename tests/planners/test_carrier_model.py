"""The interpolants of the planners: exact against the backend, and dips that hide between samples."""

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin import PlatformMotion, RneaDynamics, VirtualWork, load_robot
from redundancy_pin.planners.carrier_model import Actuation, TimedModel, carrier_model
from redundancy_pin.singularities.roots import below_zero, minima
from redundancy_pin.trajectory import Line, SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial


def test_model_is_that_of_the_backend():
    """At random times: relative to each group of coefficients, ten times the tolerance of the interpolation."""
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr", cylinder_mass=0.3, piston_mass=0.2)), reference.circle()
    motion = as_motion(trajectory)
    times = np.sort(np.random.default_rng(3).uniform(0.0, trajectory.duration, 2000))
    model = TimedModel.of(dynamics, motion, 0.0, trajectory.duration).at(times)
    exact = carrier_model(dynamics.along(trajectory.sample_at(times)))
    for name in ("W", "f0", "f_terms", "force0", "force_terms"):
        ours, theirs = getattr(model, name), getattr(exact, name)
        assert np.abs(ours - theirs).max() <= 1e-11 * np.abs(theirs).max()
    W = Actuation.along(dynamics, motion).at(times)
    assert np.abs(W - exact.W).max() <= 1e-10


def test_jump_has_two_sides():
    """The 3-RRR corner: the acceleration jumps where the straight meets the arc, and f with it."""
    dynamics, trajectory = VirtualWork(zoo.robot_of("3rrr")), reference.corner()
    t = trajectory.breaks[:1]
    model = TimedModel.of(dynamics, as_motion(trajectory), 0.6, 1.2)
    both = dynamics.along(trajectory.sample_at(np.repeat(t, 2))).reduce()
    for side, expected in (("left", both.f[0]), ("right", both.f[1])):
        np.testing.assert_allclose(model.at(t, side).f0[0], expected, atol=1e-10)
    assert np.abs(both.f[0] - both.f[1]).max() > 0.1


def test_undeclared_kink_is_resolved():
    def function(t):
        return np.stack([np.abs(t - 0.3217), np.exp(t)], axis=1)

    fitted = PiecewisePolynomial.fit(
        function, np.array([0.0, 1.0]), np.empty(0), lambda v: np.abs(v).max(axis=0), 1e-12
    )
    t = np.linspace(0.0, 1.0, 10_001)
    assert np.abs(fitted(t) - function(t)).max() < 1e-7  # the width of the narrowest piece
    away = np.abs(t - 0.3217) > 1e-6
    assert np.abs(fitted(t) - function(t))[away].max() < 1e-11


@examples(100)
@given(centre=st.floats(0.05, 0.95), width=st.floats(1e-7, 0.02), slope=st.floats(0.1, 10.0))
def test_short_window_is_not_missed(centre, width, slope):
    """A sharp dip, as the smallest singular value makes it: below zero over a width far below the sampling."""

    def function(t):
        return slope * (np.abs(t - centre) - width)

    intervals = below_zero(function, np.linspace(0.0, 1.0, 33))
    assert len(intervals) == 1
    assert intervals[0].start == pytest.approx(centre - width, abs=1e-12)
    assert intervals[0].end == pytest.approx(centre + width, abs=1e-12)
    ((t, value),) = minima(lambda times: np.abs(times - centre), np.linspace(0.0, 1.0, 33), 1e-9)
    assert t == pytest.approx(centre, abs=1e-14)
    assert value < 1e-14


@examples(100)
@given(centre=st.floats(0.1, 0.9), depth=st.floats(1e-9, 1e-3))
def test_shallow_smooth_dip_is_not_missed(centre, depth):
    intervals = below_zero(lambda t: (t - centre) ** 2 - depth, np.linspace(0.0, 1.0, 33))
    assert len(intervals) == 1
    assert intervals[0].end - intervals[0].start == pytest.approx(2.0 * np.sqrt(depth), rel=1e-6)


def test_intervals_at_the_ends_are_open():
    intervals = below_zero(lambda t: 0.25 - np.abs(t - 0.5), np.linspace(0.0, 1.0, 33))
    assert [(i.open_start, i.open_end) for i in intervals] == [(True, False), (False, True)]
    assert intervals[0].end == pytest.approx(0.25, abs=1e-14)


def test_sampled_motion_keeps_both_sides_of_a_jump():
    trajectory = reference.corner()
    exact = trajectory.sample(1e-2)
    t = np.repeat(trajectory.breaks, 2)
    jump = exact.xdd[np.flatnonzero(exact.jumps)] - exact.xdd[np.flatnonzero(exact.jumps) - 1]
    motion = as_motion(exact)
    both = motion.sample_at(t)
    np.testing.assert_allclose(both.xdd[1::2] - both.xdd[::2], jump, atol=1e-9)  # rounding of x over Δt²
    np.testing.assert_array_equal(motion.breaks, trajectory.breaks)
    assert np.abs(jump).max() > 1.0


@pytest.mark.parametrize("dt", [1e-4, 5e-4, 1e-3, 2e-3, 1e-2])
def test_samples_however_dense_give_the_acceleration(dt):
    """Between the samples, on an exact circle: Δt³ x⁗' or the rounding of x over Δt², whichever the form leaves."""
    trajectory = reference.circle()
    motion = as_motion(trajectory.sample(dt))
    t = np.random.default_rng(1).uniform(0.5, 2.3, 500)
    t.sort()
    exact, ours = trajectory.sample_at(t), motion.sample_at(t)
    assert np.abs(ours.x - exact.x).max() < 1e-12
    assert np.abs(ours.xd - exact.xd).max() < 1e-10
    assert np.abs(ours.xdd - exact.xdd).max() < 3e-9


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 2e-3, 5e-3, 1e-2])
def test_samples_of_a_slow_motion_give_the_acceleration_too(dt):
    """The rounding of x is the more beside the acceleration, the slower the motion: 60 eps |x| / Δt² of the quintic."""
    rate, radius = 0.5, 0.4

    def circle(t):
        place = radius * np.stack([np.cos(rate * t), np.sin(rate * t)], axis=1)
        return PlatformMotion(t, place, rate * place[:, ::-1] * [-1.0, 1.0], -(rate**2) * place)

    times = np.sort(np.random.default_rng(1).uniform(0.0, 2.0, 3000))
    ours = as_motion(circle(np.arange(0.0, 2.0 + dt, dt))).sample_at(times)
    assert np.abs(ours.xdd - circle(times).xdd).max() < 1e-9 * rate**2 * radius


def test_between_samples_at_rest_there_is_a_motion():
    """The quintic from rest to rest, all of it: velocity and acceleration too, although no sample has any."""
    still, length, duration = np.zeros((2, 2)), 0.1, 0.5
    motion = as_motion(PlatformMotion(np.array([0.0, duration]), np.array([[0.0, 0.3], [length, 0.3]]), still,
                                              still))  # fmt: skip
    ours = motion.sample_at(np.array([0.1, 0.25]))
    u = ours.t / duration
    np.testing.assert_allclose(ours.x[:, 0], length * u**3 * (10.0 - 15.0 * u + 6.0 * u**2), atol=1e-14)
    np.testing.assert_allclose(ours.xd[:, 0], length / duration * 30.0 * (u * (1.0 - u)) ** 2, atol=1e-13)
    np.testing.assert_allclose(
        ours.xdd[:, 0], length / duration**2 * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u), atol=1e-12
    )


def test_the_worst_condition_number_is_that_of_dense_samples():
    """Beside a singularity, by the singular values of W as the backend gives it."""
    dynamics = RneaDynamics(load_robot("2rpr"))
    line = Line((0.1, 0.05), (0.4, 0.03))
    beside = Trajectory(line, SpeedProfile(line.length, 0.1, 0.1))
    actuation = Actuation.along(dynamics, as_motion(beside))
    reduced = dynamics.along(beside.sample_at(np.linspace(0.0, beside.duration, 4001))).reduce()
    values = np.linalg.svd(reduced.W / reduced.row_scale[:, None] / reduced.column_scale, compute_uv=False)
    condition = values[:, 0] / values[:, -1]
    assert actuation.worst("condition") == pytest.approx(condition.max(), rel=1e-5)
    assert actuation.worst("margin") == pytest.approx(values[:, -1].min(), rel=1e-5)
