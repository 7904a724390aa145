"""Weights of the quadratic regulator by Bryson's rule: one over the square of what is acceptable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.coordinates import row_scale
from redundancy_pin.simulation.reference import MotionReference


@dataclass(frozen=True, eq=False)
class LqrWeights:
    """Cost rates of the regulator: ∫ δzᵀ Q δz + δuᵀ R δu dt.

    Attributes:
        Q: (2d, 2d) of δz = (δx, δs, δẋ, δṡ).
        R: (m + k, m + k) of δu = (δτ, δF).
    """

    Q: Array
    R: Array


def bryson_weights(
    reference: MotionReference,
    *,
    position: float = 1e-3,
    carrier: float = 1e-2,
    bandwidth: float = 30.0,
    effort: ArrayLike | None = None,
    carrier_force: ArrayLike | None = None,
) -> LqrWeights:
    """Return diagonal weights 1 / (acceptable deviation)² (Bryson and Ho 1975, section 5.2).

    Args:
        reference: the motion; its largest efforts are the acceptable deviations of efforts unless given.
        position: acceptable error of the platform, m; rotations get this over the characteristic length, rad.
        carrier: acceptable error of the carriers, m.
        bandwidth: acceptable errors of speeds are this, rad/s, times those of positions.
        effort: scalar or (m,) acceptable deviation of the main efforts, N or N·m, for example their limit less their
            planned peak.
        carrier_force: scalar or (k,) the same for the carriers, N.

    Raises:
        InputError: a value that is not positive, or of the wrong shape.
    """
    for name, value in (("position", position), ("carrier", carrier), ("bandwidth", bandwidth)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value}.", remedy="Pass a positive, finite number.", name=name)
    robot = reference.robot
    both = _largest_loads(reference)
    main = _acceptable(effort, both[: robot.m], "effort")
    carriers = _acceptable(carrier_force, both[robot.m :], "carrier_force")
    place = np.concatenate([position / row_scale(robot), np.full(robot.k, carrier)])
    state = np.concatenate([place, bandwidth * place])
    return LqrWeights(frozen(np.diag(state**-2.0)), frozen(np.diag(np.concatenate([main, carriers]) ** -2.0)))


LEAST_SHARE = 0.05
"""An actuator that a plan hardly uses may still deviate by this share of the largest of its kind."""


def _largest_loads(reference: MotionReference) -> Array:
    middles = 0.5 * (reference.edges[:-1] + reference.edges[1:])
    largest: Array = np.abs([np.concatenate(reference.loads(float(t))) for t in middles]).max(axis=0)
    return largest


def _acceptable(given: ArrayLike | None, largest: Array, name: str) -> Array:
    if given is None:
        top = float(largest.max(initial=0.0))
        return np.maximum(largest, LEAST_SHARE * top if top > 0.0 else 1.0)
    values = np.atleast_1d(np.asarray(given, dtype=float))
    if values.shape not in ((1,), largest.shape) or not (np.isfinite(values) & (values > 0.0)).all():
        raise InputError(f"{name} is {given!r}.", remedy=f"Pass one positive number, or {len(largest)}.", name=name)
    return np.broadcast_to(values, largest.shape)
