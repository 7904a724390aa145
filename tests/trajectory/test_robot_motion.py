"""Interpolation of sampled motions: exact for quintics, and of the declared order for turns."""

from __future__ import annotations

import numpy as np
import pytest
import zoo

from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.robot_motion import robot_motion


def test_a_quintic_is_reproduced_exactly() -> None:
    rng = np.random.default_rng(1)
    polynomials = [np.polynomial.Polynomial(rng.uniform(-1.0, 1.0, 6)) for _ in range(2)]

    def at(t, order):
        return np.stack([p.deriv(order)(t) if order else p(t) for p in polynomials], axis=1)

    t = np.array([0.0, 0.3, 1.1, 1.5])
    law = robot_motion(zoo.robot_of("2rpr"), PlatformMotion(t, at(t, 0), at(t, 1), at(t, 2)))
    times = np.linspace(0.0, 1.5, 40)
    np.testing.assert_allclose(law.sample_at(times).x, at(times, 0), atol=1e-13)
    assert (law.start, law.end) == (0.0, 1.5)


def test_angles_that_wrap_take_the_short_way() -> None:
    """Samples on both sides of ±π belong together; halfway the platform is at π, not at zero."""
    x = np.array([[0.8, 0.5, np.pi - 0.1], [0.8, 0.5, -np.pi + 0.1]])
    rate = np.array([[0.0, 0.0, 0.2], [0.0, 0.0, 0.2]])
    law = robot_motion(zoo.robot_of("3rrr"), PlatformMotion([0.0, 1.0], x, rate, 0 * rate))
    assert law.sample_at(np.array([0.5])).x[0, 2] == pytest.approx(np.pi)


def test_a_trajectory_is_asked_for_its_own_coordinates() -> None:
    trajectory = reference.circle()
    times = np.array([0.1, 0.9, 2.0])
    np.testing.assert_array_equal(
        robot_motion(zoo.robot_of("2rpr"), trajectory).sample_at(times).x, trajectory.sample_at(times).x
    )


def test_a_turn_between_poses_is_a_rotation_that_passes_through_the_samples() -> None:
    motion = zoo.smooth_motion(zoo.robot_of("gough"), seed=2).at(np.linspace(0.0, 1.0, 8))
    law = robot_motion(zoo.robot_of("gough"), motion)
    np.testing.assert_allclose(law.sample_at(motion.t).x, motion.x, atol=1e-14)
    between = law.sample_at(np.linspace(0.0, 1.0, 33)).x[:, :3, :3]
    np.testing.assert_allclose(between @ between.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (33, 3, 3)), atol=1e-14)


def test_a_single_instant_is_refused() -> None:
    two_sided = PlatformMotion([1.0, 1.0], [[0.2, 0.2]] * 2, [[0.0, 0.0]] * 2, [[0.0, 0.0], [1.0, 0.0]])
    with pytest.raises(InputError, match="single instant"):
        robot_motion(zoo.robot_of("2rpr"), two_sided)
