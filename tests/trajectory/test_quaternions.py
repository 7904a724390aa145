"""Quaternions as functions of time against scipy's rotations and differences of rotation matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from redundancy_pin.trajectory.quaternions import (
    angular_rates,
    poses_of,
    quaternion_rates,
    quaternions_of,
    turns_between,
)

STEP = 1e-4
"""s; central differences of matrices that change at rates of about one are off by 1e-8, and by rounding of 1e-8."""


def turning(t, omega, alpha):
    """A rotation matrix with a given rate and second rate, in world axes, at t = 0: to the third order in t."""
    return Rotation.from_rotvec(omega * t + 0.5 * alpha * t**2).as_matrix()


def axial(matrix):
    return 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])


@pytest.mark.parametrize("seed", range(5))
def test_rates_of_quaternions_are_those_of_matrices(seed):
    """Of the Taylor series of a quaternion of any length, and back: 1e-12 is rounding, 1e-6 that of differences."""
    dice = np.random.default_rng(seed)
    q = dice.normal(size=(3, 4)) * [[1.0], [0.4], [3.0]]
    omega, alpha = dice.normal(size=(2, 3, 3))
    first, second = quaternion_rates(q, omega, alpha)
    # the length stays: so do the first and second derivatives of its square
    np.testing.assert_allclose((q * first).sum(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose((q * second + first**2).sum(axis=1), 0.0, atol=1e-12)
    for found, given in zip(angular_rates(q, first, second), (omega, alpha), strict=True):
        np.testing.assert_allclose(found, given, atol=1e-12)
    # any number of axes before the last
    stacked = [np.stack([each, each[::-1]]) for each in (q, omega, alpha)]
    more = quaternion_rates(*stacked)
    for found, one in zip((*more, *angular_rates(stacked[0], *more)), (first, second, omega, alpha), strict=True):
        np.testing.assert_allclose(found, np.stack([one, one[::-1]]), atol=1e-12)
    for k in range(3):
        before, here, after = (
            Rotation.from_quat(q[k] + first[k] * t + 0.5 * second[k] * t**2).as_matrix() for t in (-STEP, 0.0, STEP)
        )
        np.testing.assert_allclose(axial((after - before) / (2.0 * STEP) @ here.T), omega[k], atol=1e-6)
        # of R'' = ([alpha] + [omega]^2) R the axial part is alpha
        np.testing.assert_allclose(axial((after - 2.0 * here + before) / STEP**2 @ here.T), alpha[k], atol=1e-6)
        np.testing.assert_allclose(after, turning(STEP, omega[k], alpha[k]) @ here, atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_rates_of_a_quaternion_whose_length_changes(seed):
    """The same rotation, longer and longer: what is added along the quaternion does not turn it."""
    dice = np.random.default_rng(seed)
    q, omega, alpha = dice.normal(size=(2, 4)), *dice.normal(size=(2, 2, 3))
    first, second = quaternion_rates(q, omega, alpha)
    # s q with s = 1.3, s' = 0.7, s'' = -0.4
    longer = 1.3 * q, 0.7 * q + 1.3 * first, -0.4 * q + 2.0 * 0.7 * first + 1.3 * second
    for found, given in zip(angular_rates(*longer), (omega, alpha), strict=True):
        np.testing.assert_allclose(found, given, atol=1e-12)


def test_quaternions_of_rotations_go_on_without_a_jump():
    """Twice round, where scipy's change their sign; the angle between two is that of scipy's rotation vector."""
    angles = np.linspace(0.0, 4.0 * np.pi, 41)
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    rotations = Rotation.from_rotvec(angles[:, None] * axis)
    quaternions = quaternions_of(rotations.as_matrix())
    np.testing.assert_allclose(Rotation.from_quat(quaternions).as_matrix(), rotations.as_matrix(), atol=1e-12)
    sign = np.sign(quaternions[0, 3])
    expected = np.column_stack([np.sin(0.5 * angles)[:, None] * axis, np.cos(0.5 * angles)])
    np.testing.assert_allclose(sign * quaternions, expected, atol=1e-12)
    np.testing.assert_allclose(turns_between(quaternions), 0.1 * np.pi, atol=1e-12)


def test_turns_between_random_quaternions_are_those_of_scipy():
    q = np.random.default_rng(1).normal(size=(40, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    rotations = Rotation.from_quat(q)
    np.testing.assert_allclose(turns_between(q), (rotations[1:] * rotations[:-1].inv()).magnitude(), atol=1e-12)


def test_poses_have_rotations_and_origins():
    dice = np.random.default_rng(2)
    origins, q = dice.normal(size=(2, 3, 3)), 2.5 * dice.normal(size=(2, 3, 4))
    poses = poses_of(origins, q)
    for pose, origin, one in zip(poses.reshape(-1, 4, 4), origins.reshape(-1, 3), q.reshape(-1, 4), strict=True):
        np.testing.assert_allclose(pose[:3, :3], Rotation.from_quat(one).as_matrix(), atol=1e-14)
        np.testing.assert_array_equal(pose[:3, 3], origin)
        np.testing.assert_array_equal(pose[3], [0.0, 0.0, 0.0, 1.0])
