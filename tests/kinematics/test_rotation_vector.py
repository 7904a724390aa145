"""Rates of rotation vectors against finite differences of the rotation matrix."""

import numpy as np
from scipy.spatial.transform import Rotation
from trajectory_checks import differentiate

from redundancy_pin.kinematics.rotation_vector import angular_rates, vector_rates

SIZE = np.array([[0.9, -1.4, 1.1], [0.7, 1.3, -0.8]])


def vector(t):
    """Return φ (N, 3), φ̇ and φ̈; angles go from zero to more than half a turn."""
    t = np.asarray(t)[:, None]
    return (
        2.4 * np.sin(t) * SIZE[0] + t**2 * SIZE[1],
        2.4 * np.cos(t) * SIZE[0] + 2.0 * t * SIZE[1],
        -2.4 * np.sin(t) * SIZE[0] + 2.0 * SIZE[1],
    )


def spin(t):
    step = 1e-3

    def turned(s):
        return Rotation.from_rotvec(vector(s)[0]).as_matrix()

    rate = differentiate(turned, t, step) @ turned(t).transpose(0, 2, 1)  # Ṙ Rᵀ = [ω]×
    return np.stack([rate[:, 2, 1], rate[:, 0, 2], rate[:, 1, 0]], axis=1)


def test_rates_are_those_of_the_rotation_and_back():
    t = np.array([0.0, 1e-3, 0.3, 0.8, 1.1])
    phi, phid, phidd = vector(t)
    assert np.linalg.norm(phi, axis=1).max() > 3.3
    omega, alpha = angular_rates(phi, phid, phidd)
    np.testing.assert_allclose(omega, spin(t), atol=1e-9)

    def exact(s):
        return angular_rates(*vector(s))[0]

    np.testing.assert_allclose(alpha, differentiate(exact, t, 1e-3), atol=1e-8)
    back = vector_rates(phi, omega, alpha)
    np.testing.assert_allclose(back[0], phid, atol=1e-11)
    np.testing.assert_allclose(back[1], phidd, atol=1e-10)
