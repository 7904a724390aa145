"""The interpolants of the planners: exact against the backend, and dips that hide between samples."""

import numpy as np
import pytest
import zoo

from redundancy_pin import RneaDynamics, VirtualWork, load_robot
from redundancy_pin.planners.carrier_model import Actuation, TimedModel, carrier_model
from redundancy_pin.trajectory import Line, SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.continuous_motion import as_motion


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


@pytest.mark.parametrize("dt", [1e-4, 1e-2])
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


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_the_worst_condition_number_and_margin_are_those_of_dense_samples(name):
    """Beside a singularity, by the singular values of W as the backend gives it: two of them, and three."""
    dynamics = RneaDynamics(load_robot(name))
    line = Line((0.1, 0.05), (0.4, 0.03))
    beside = Trajectory(line, SpeedProfile(line.length, 0.1, 0.1)) if name == "2rpr" else reference.corner()
    actuation = Actuation.along(dynamics, as_motion(beside))
    reduced = dynamics.along(beside.sample_at(np.linspace(0.0, beside.duration, 1001))).reduce()
    values = np.linalg.svd(reduced.W / reduced.row_scale[:, None] * reduced.column_scale, compute_uv=False)
    condition = values[:, 0] / values[:, -1]
    assert actuation.worst("condition") == pytest.approx(condition.max(), rel=1e-5)
    assert actuation.worst("margin") == pytest.approx(values[:, -1].min(), rel=1e-5)
