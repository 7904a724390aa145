"""Parameters of real bodies: positive densities, and friction that takes power.

A body has a positive density where its pseudo-inertia is positive definite. Log-Cholesky coordinates (Rucker and
Wensing 2022, "Smooth parameterization of rigid-body inertia") have no others, and cover all of them.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.identification.base import BaseParameters
from redundancy_pin.identification.parameters import INERTIAL, standard_values

_NEAR = 1e-3
"""Weight of the distance from the given robot, in relative sizes: it decides what the motions leave open."""

_THIN = 1e-4
"""Least eigenvalue of a pseudo-inertia to start from, relative to its largest."""

_MOST = 6.0
"""Largest change of a logarithm: a factor of 400 of a length or mass."""


def log_cholesky(inertia: pin.Inertia, size: float) -> Array:
    """Return (10,) the log-Cholesky coordinates of a body: U Uᵀ = pseudo-inertia, U upper triangular.

    Bodies that are thin, or none, have eigenvalues of the pseudo-inertia, lengths in ``size``, that are not positive:
    these are raised to 1e-4 of the largest.
    """
    scale = np.array([size, size, size, 1.0])
    values, vectors = np.linalg.eigh(pin.PseudoInertia.FromInertia(inertia).toMatrix() / np.outer(scale, scale))
    values = np.maximum(values, _THIN * values[-1])
    J = (vectors * values) @ vectors.T * np.outer(scale, scale)
    flipped = np.linalg.cholesky(J[::-1, ::-1])  # lower triangular of the reversed matrix
    U = flipped[::-1, ::-1]
    alpha = np.log(U[3, 3])
    d = np.log(np.diagonal(U)[:3]) - alpha
    s12, s13, s23 = (U[0, 1], U[0, 2], U[1, 2]) / U[3, 3]
    return np.array([alpha, *d, s12, s23, s13, *(U[:3, 3] / U[3, 3])])


def nearest_physical(base: BaseParameters, standard: Array, values: Array, information: Array) -> Array:
    """Return (p,) parameters of real bodies whose base parameters explain the records best.

    Minimises (β − values)ᵀ information (β − values), β = combination · parameters, plus a little of the distance from
    the linear fit. Bodies of which some of the ten parameters are held keep to the linear fit.

    Args:
        base: the base parameters.
        standard: (p,) parameters of the linear fit.
        values: (b,) base parameters of the linear fit.
        information: (b, b) inverse of their covariance.
    """
    from scipy.optimize import least_squares

    where: dict[int, dict[str, int]] = {}
    for k, p in enumerate(base.parameters):
        if p.kind in INERTIAL:
            where.setdefault(p.joint, {})[p.kind] = k
    bodies = [np.array([own[kind] for kind in INERTIAL]) for own in where.values() if len(own) == len(INERTIAL)]
    joints = np.array(
        [k for k, p in enumerate(base.parameters) if p.kind not in INERTIAL and p.kind != "preload"], dtype=np.intp
    )
    before, sizes = standard_values(base.parameters), base.sizes
    length = [np.sqrt(sizes[own[9]] / sizes[own[0]]) for own in bodies]
    starts = [
        log_cholesky(pin.Inertia.FromDynamicParameters(before[own]), size)
        for own, size in zip(bodies, length, strict=True)
    ]
    factor = np.linalg.cholesky(information).T

    def parameters(theta: Array) -> Array:
        result = standard.copy()
        for own, part in zip(bodies, theta[: 10 * len(bodies)].reshape(-1, 10), strict=True):
            result[own] = pin.LogCholeskyParameters(part).toDynamicParameters()
        result[joints] = theta[10 * len(bodies) :]
        return result

    def rest(theta: Array) -> Array:
        found = parameters(theta)
        return np.concatenate([factor @ (base.combination @ found - values), _NEAR * (found - before) / sizes])

    def jacobian(theta: Array) -> Array:
        by_theta = np.zeros((len(before), len(theta)))
        for j, (own, part) in enumerate(zip(bodies, theta[: 10 * len(bodies)].reshape(-1, 10), strict=True)):
            by_theta[own, 10 * j : 10 * j + 10] = pin.LogCholeskyParameters(part).calculateJacobian()
        by_theta[joints, 10 * len(bodies) + np.arange(len(joints))] = 1.0
        return np.concatenate([factor @ (base.combination @ by_theta), _NEAR * by_theta / sizes[:, None]])

    start = np.concatenate([*starts, np.maximum(standard[joints], 0.0)])
    # logarithms may change by _MOST, so that bodies that are thin in the given robot do not run off to minus infinity
    reach = np.tile([_MOST] * 4 + [np.inf] * 6, len(bodies))
    low = np.concatenate([start[: len(reach)] - reach, np.zeros(len(joints))])
    high = np.concatenate([start[: len(reach)] + reach, np.full(len(joints), np.inf)])
    inside = np.where(low == 0.0, np.maximum(start, 1e-9), start)
    found = least_squares(rest, inside, jacobian, bounds=(low, high), x_scale="jac", xtol=1e-12)
    return parameters(found.x)
