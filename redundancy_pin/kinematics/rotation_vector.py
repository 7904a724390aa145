"""Rotation vectors as functions of time: R(t) = exp([φ(t)]×) R₀, and the angular velocity and acceleration of it.

With ω and α in world axes (R₀ is turned from the left), θ = |φ|, b = (1 − cos θ)/θ² and c = (θ − sin θ)/θ³,

    ω = φ̇ + b φ × φ̇ + c φ × (φ × φ̇),
    α = φ̈ + b φ × φ̈ + c φ × (φ × φ̈) + ḃ φ × φ̇ + ċ φ × (φ × φ̇) + c φ̇ × (φ × φ̇),

which is the left Jacobian of SO(3) and its rate. All four coefficients are power series in θ², so no angle is special.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.polynomial import Polynomial

from redundancy_pin.arrays import Array

_TERMS = 16
"""Of the series: up to a whole turn the first one left out is below rounding."""

_B, _C = (Polynomial([(-1.0) ** k / factorial(2 * k + first) for k in range(_TERMS)]) for first in (2, 3))


def angular_rates(phi: Array, phid: Array, phidd: Array) -> tuple[Array, Array]:
    """Return ω and α (N, 3), rad/s and rad/s², world axes, from rotation vectors (N, 3), rad, and their derivatives."""
    return _jacobian(phi, phid), _jacobian(phi, phidd) + _bias(phi, phid)


def vector_rates(phi: Array, omega: Array, alpha: Array) -> tuple[Array, Array]:
    """Return φ̇ and φ̈ (N, 3) of rotation vectors (N, 3), rad, shorter than a turn, from ω and α (N, 3), world axes."""
    jacobian = np.stack([_jacobian(phi, np.broadcast_to(axis, phi.shape)) for axis in np.eye(3)], axis=2)
    inverse = np.linalg.inv(jacobian)
    phid: Array = np.einsum("nij,nj->ni", inverse, omega)
    phidd: Array = np.einsum("nij,nj->ni", inverse, alpha - _bias(phi, phid))
    return phid, phidd


def _jacobian(phi: Array, rate: Array) -> Array:
    """Return the left Jacobian at φ times a vector, (N, 3)."""
    square = (phi * phi).sum(axis=1, keepdims=True)
    turned = np.cross(phi, rate)
    product: Array = rate + _B(square) * turned + _C(square) * np.cross(phi, turned)
    return product


def _bias(phi: Array, phid: Array) -> Array:
    """Return what α has of φ̇, (N, 3): the rate of the left Jacobian times φ̇."""
    square = (phi * phi).sum(axis=1, keepdims=True)
    rate = 2.0 * (phi * phid).sum(axis=1, keepdims=True)  # of θ²
    turned = np.cross(phi, phid)
    along: Array = _B.deriv()(square) * rate * turned
    along += _C.deriv()(square) * rate * np.cross(phi, turned) + _C(square) * np.cross(phid, turned)
    return along
