"""Rotations as functions of time: unit quaternions x, y, z, w, and the angular velocity and acceleration of them.

Of a quaternion q(t) of any length, with ω and α in world axes and q* its conjugate,

    q̇ = ω q / 2,   q̈ = (α q + ω q̇)/2,   ω = 2 Im(q̇ q*)/|q|²,   α = [2 Im(q̈ q*) − 2 (q·q̇) ω]/|q|².

No angle is special; interpolated quaternions are normalised.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array

HALF_TURN_MARGIN = 1e-6
"""Rotations this close to a half turn, rad, have no usable axis: rounding of 1e-9 in the pose (the tolerance of a
pose) would tilt it by 1e-3."""


def quaternions_of(rotations: Array) -> Array:
    """Return (N, 4) quaternions of rotations (N, 3, 3), each of the sign that is nearer to the one before."""
    quaternions: Array = Rotation.from_matrix(rotations).as_quat()
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    quaternions[1:] *= np.cumprod(flips)[:, None]
    return quaternions


def turns_between(quaternions: Array) -> Array:
    """Return (N − 1,) the angles by which one quaternion (N, 4) is turned from the one before, rad, at most π."""
    apart: Array = np.linalg.norm(_imaginary(quaternions[1:], quaternions[:-1]), axis=1)
    angles: Array = 2.0 * np.arctan2(apart, np.abs((quaternions[1:] * quaternions[:-1]).sum(axis=1)))
    return angles


def poses_of(origins: Array, quaternions: Array) -> Array:
    """Return homogeneous poses (..., 4, 4) of origins (..., 3), m, and quaternions (..., 4) of any length."""
    poses = np.zeros((*origins.shape[:-1], 4, 4))
    poses[..., :3, :3] = Rotation.from_quat(quaternions.reshape(-1, 4)).as_matrix().reshape(*origins.shape, 3)
    poses[..., :3, 3], poses[..., 3, 3] = origins, 1.0
    return poses


def quaternion_rates(q: Array, omega: Array, alpha: Array) -> tuple[Array, Array]:
    """Return q̇ and q̈ (..., 4) of quaternions (..., 4) that turn with ω and α (..., 3), rad/s and rad/s²."""
    first = 0.5 * _product(omega, q)
    return first, 0.5 * (_product(alpha, q) + _product(omega, first))


def angular_rates(q: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Return ω and α (..., 3) of quaternions (..., 4) and their derivatives by time, or by another parameter."""
    square = (q**2).sum(axis=-1, keepdims=True)
    omega = 2.0 * _imaginary(first, q) / square
    return omega, 2.0 * (_imaginary(second, q) - (q * first).sum(axis=-1, keepdims=True) * omega) / square


def _product(vector: Array, q: Array) -> Array:
    """Return the product (..., 4) of a quaternion without real part and another."""
    imaginary = q[..., 3:] * vector + np.cross(vector, q[..., :3])
    return np.concatenate([imaginary, -(vector * q[..., :3]).sum(axis=-1, keepdims=True)], axis=-1)


def _imaginary(a: Array, b: Array) -> Array:
    """Return (..., 3) the imaginary part of a b* of quaternions (..., 4)."""
    product: Array = b[..., 3:] * a[..., :3] - a[..., 3:] * b[..., :3] - np.cross(a[..., :3], b[..., :3])
    return product
