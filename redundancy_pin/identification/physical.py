"""Parameters of real bodies: positive densities, and friction that takes power.

A body has a positive density where its pseudo-inertia J is positive definite (Wensing, Kim and Slotine 2018, "Linear
matrix inequalities for physically consistent inertial parameter identification"). J is linear in the parameters, so
that the nearest real bodies are the one minimum of a convex problem, found by a barrier −log det J and Newton's method.
In log-Cholesky coordinates scipy's least squares do not settle at thin bodies.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import InputError
from redundancy_pin.identification.base import BaseParameters
from redundancy_pin.identification.parameters import INERTIAL, NOT_NEGATIVE, Parameter, parameters_of, with_inertias
from redundancy_pin.robot import Robot

_NEAR = 1e-3
"""Weight of the distance from the given robot, in relative sizes: it decides what the motions leave open."""

_SOLID = np.diag([1e-6, 1e-6, 1e-6, 1e-4])
"""Pseudo-inertia of a small solid, in masses and lengths of the robot, that a thin or massless body starts with."""

_THIN = 1e-4
"""Least mass, friction, stiffness and rotor to start from, in scales of the robot."""

_BARRIERS = np.logspace(0.0, -12.0, 25)
"""Weights of the barrier, relative to squared standard deviations; the last is small against ``_NEAR``²."""

_GAP = 1e-3
"""Duality gap of the nearest real bodies, squared standard deviations."""

_STEPS = 60
_DONE = 1e-9
"""Newton decrement, relative to the barrier's weight, of a minimum."""

_CLOSE = 0.05
"""Newton decrement, relative to the barrier's weight, below which whole steps converge."""

_SHORTEST = 1e-9
"""Part of a Newton step below which rounding hides a descent."""

_UNITS = np.array([pin.PseudoInertia.FromDynamicParameters(unit).toMatrix() for unit in np.eye(10)])
"""(10, 4, 4) J per parameter, in which it is linear."""

_ROUNDING = 1e-9
"""Eigenvalue of a pseudo-inertia, relative to its largest, that is rounding."""


def require_whole_bodies(robot: Robot, parameters: Sequence[Parameter]) -> None:
    """Raise InputError where some of the ten of a body are sought, except its mass alone."""
    for body, kinds in _sought(parameters).items():
        missing = [p.name for p in _ten(robot, body) if p.kind not in kinds]
        if missing and kinds != ["mass"]:
            raise InputError(
                f"physical=True seeks real bodies, and {body} is sought in part: {', '.join(kinds)}.",
                remedy=f"Add {', '.join(missing)}, or seek its mass alone.",
                body=body,
            )


def unphysical(robot: Robot, base: BaseParameters, values: Array) -> tuple[str, ...]:
    """Return the names of parameters (p,) and bodies that no real robot has.

    A body without positive density in the given robot, such as a thin one of a flat model, is compared with that one.
    """
    bad = [p.name for p, value in zip(base.parameters, values, strict=True) if p.kind in NOT_NEGATIVE and value < 0.0]
    after, parts = with_inertias(robot, base.parameters, values), _sought(base.parameters)
    for body, kinds in parts.items():
        index = _ten(robot, body)[0].joint
        given, found = (least_eigenvalue(model.inertias[index]) for model in (robot.model, after))
        whole = len(kinds) == len(INERTIAL)
        if found <= 0.0 < given or (not whole and found < min(given, 0.0) - _ROUNDING):
            bad.append(f"pseudo-inertia of {body}")
    return tuple(bad)


def nearest_physical(base: BaseParameters, values: Array, weight: Array) -> tuple[Array, bool]:
    """Return (p,) parameters of real bodies whose base parameters explain the records best, and whether they are found.

    Minimises |F (β − values)|², β = combination · parameters, plus a little of the distance from the given robot, over
    bodies with positive definite J, and masses, friction, springs and rotors that are positive.

    Args:
        base: the base parameters; bodies are whole, or their mass alone is sought.
        values: (b,) base parameters of the linear fit.
        weight: (b, b) F, with covariance (Fᵀ F)⁻¹.
    """
    given = base.standard / base.sizes
    rows = np.concatenate([weight @ (base.combination * base.sizes), _NEAR * np.eye(len(given))])
    aim = np.concatenate([weight @ values, _NEAR * given])
    positive = np.flatnonzero([p.kind in NOT_NEGATIVE for p in base.parameters])
    y, bodies, gap = given.copy(), [], np.inf
    y[positive] = np.maximum(y[positive], _THIN)
    for body, kinds in _sought(base.parameters).items():
        if len(kinds) == len(INERTIAL):
            own = np.flatnonzero([p.of == body and p.kind in INERTIAL for p in base.parameters])
            bodies.append(own)
            y[own] = _inside(given[own])
    for barrier in _BARRIERS.tolist():
        try:
            y, found = _newton(y, rows, aim, barrier, bodies, positive)
        except np.linalg.LinAlgError:
            found = False
        if not found:  # rounding, or no minimum
            break
        gap = barrier * (4 * len(bodies) + len(positive))
    return base.sizes * y, gap <= _GAP


def _newton(
    y: Array, rows: Array, aim: Array, barrier: float, bodies: Sequence[IntArray], positive: IntArray
) -> tuple[Array, bool]:
    """Return the minimum of ½|rows y − aim|² − barrier (Σ log det J + Σ log y of positive ones), and if it is found."""

    def cost(y: Array) -> float:
        spectra = np.array([np.linalg.eigvalsh(np.tensordot(y[own], _UNITS, 1)) for own in bodies])
        if (y[positive] <= 0.0).any() or (spectra <= 0.0).any():
            return np.inf
        logs = np.log(y[positive]).sum() + np.log(spectra).sum()
        return float(0.5 * ((rows @ y - aim) ** 2).sum() - barrier * logs)

    now = cost(y)
    for _ in range(_STEPS):
        # with J = L Lᵀ and U_k = L⁻¹ J_k L⁻ᵀ the barrier has the gradient −Uᵀ vec 1 and the Hessian Uᵀ U
        U = [np.zeros((len(positive), len(y)))]
        U[0][np.arange(len(positive)), positive] = 1.0 / y[positive]
        for own in bodies:
            inverse = np.linalg.inv(np.linalg.cholesky(np.tensordot(y[own], _UNITS, 1)))
            U.append(np.zeros((16, len(y))))
            U[-1][:, own] = (inverse @ _UNITS @ inverse.T).reshape(-1, 16).T
        ones = np.concatenate([np.ones(len(positive)), np.tile(np.eye(4).ravel(), len(bodies))])
        A = np.concatenate([rows, np.sqrt(barrier) * np.concatenate(U)])
        step = np.linalg.lstsq(A, np.concatenate([aim - rows @ y, np.sqrt(barrier) * ones]), rcond=None)[0]
        decrement = float(((A @ step) ** 2).sum())
        if decrement <= _DONE * barrier:
            return y, True
        length = 1.0
        # near the minimum of a self-concordant function a whole step is safe, where rounding hides that it descends
        while (
            decrement > _CLOSE * barrier
            and cost(y + length * step) > now - 0.1 * length * decrement
            and length > _SHORTEST
        ):
            length *= 0.5
        if length <= _SHORTEST:
            return y, False
        y, now = y + length * step, cost(y + length * step)
    return y, False


def _sought(parameters: Sequence[Parameter]) -> dict[str, list[str]]:
    """Return which of the ten are sought of each body."""
    result: dict[str, list[str]] = {}
    for p in parameters:
        if p.kind in INERTIAL:
            result.setdefault(p.of, []).append(p.kind)
    return result


def _ten(robot: Robot, body: str) -> list[Parameter]:
    return [p for p in parameters_of(robot, ["*"]) if p.of == body and p.kind in INERTIAL]


def least_eigenvalue(inertia: pin.Inertia) -> float:
    """Return the least eigenvalue of a pseudo-inertia relative to the largest."""
    values = np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(inertia).toMatrix())
    return float(values[0] / max(abs(values[0]), values[-1], 1e-300))


def _inside(ten: Array) -> Array:
    """Return (10,) parameters of a body, a small solid added where the density is not positive."""
    values, vectors = np.linalg.eigh(np.tensordot(ten, _UNITS, 1))
    if values[0] > _ROUNDING * abs(values[-1]):
        return ten
    J = (vectors * np.maximum(values, 0.0)) @ vectors.T + _SOLID
    result: Array = pin.PseudoInertia.FromMatrix(J).toDynamicParameters()
    return result
