"""Parameters of real bodies: positive densities, and friction that takes power.

A body has a positive density where its pseudo-inertia J is positive definite (Wensing, Kim and Slotine 2018, "Linear
matrix inequalities for physically consistent inertial parameter identification"). J is linear in the parameters, so
that the nearest real bodies are the one minimum of a convex problem, found by a barrier −log det J and Newton's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, IntArray, read_only
from redundancy_pin.identification.base import BaseParameters
from redundancy_pin.identification.parameters import INERTIAL, NOT_NEGATIVE, Parameter, parameters_of
from redundancy_pin.robot import Robot

_NEAR = 1e-3
"""Weight of the distance from the given robot, in relative sizes: it decides what the motions leave open."""

_THIN = 1e-4
"""Least eigenvalue of a scaled pseudo-inertia to start from, relative to its largest."""

_BARRIERS = np.logspace(0.0, -12.0, 25)
"""Weights of the barrier, relative to squared standard deviations; the last is small against ``_NEAR``²."""

_STEPS = 60
_DONE = 1e-9
"""Newton decrement, relative to the barrier's weight, of a minimum."""

_ROUGHLY = 1e-3
"""The same, where rounding hides a further descent."""

_SHORTEST = 1e-9
"""Part of a Newton step below which rounding hides a descent."""


def _unit_pseudo_inertias() -> Array:
    """Return (10, 4, 4) pseudo-inertias of the ten parameters: (½ tr I − I, m c; m cᵀ, m)."""
    J = np.zeros((10, 4, 4))
    J[0, 3, 3] = 1.0
    for i in range(3):
        J[1 + i, i, 3] = J[1 + i, 3, i] = 1.0
    for k, (i, j) in zip(range(4, 10), ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), strict=True):
        J[k, :3, :3] = 0.5 * np.eye(3) * (i == j)
        J[k, i, j] -= 1.0
        J[k, j, i] = J[k, i, j]
    return read_only(J)


_UNITS = _unit_pseudo_inertias()


@dataclass(frozen=True, eq=False)
class _Body:
    """A body with sought parameters, in units of the robot's mass and length.

    Attributes:
        where: (s,) which of the parameters are its.
        units: (s, 4, 4) derivatives of its pseudo-inertia J by them.
        held: (4, 4) what the others make of J.
    """

    where: IntArray
    units: Array
    held: Array

    def pseudo_inertia(self, scaled: Array) -> Array:
        """Return J (4, 4) for scaled parameters (p,)."""
        result: Array = self.held + np.tensordot(scaled[self.where], self.units, 1)
        return result

    def is_positive(self, scaled: Array) -> bool:
        """Return whether J is positive definite."""
        return bool(np.linalg.eigvalsh(self.pseudo_inertia(scaled))[0] > 0.0)


def _bodies(robot: Robot, parameters: Sequence[Parameter]) -> list[_Body]:
    listed, everything = [], [p for p in parameters_of(robot, ["*"]) if p.kind in INERTIAL]
    for joint in dict.fromkeys(p.joint for p in parameters if p.kind in INERTIAL):
        where = np.array([k for k, p in enumerate(parameters) if p.kind in INERTIAL and p.joint == joint])
        sought = [INERTIAL.index(parameters[k].kind) for k in where]
        ten = np.array([p.value / p.size for p in everything if p.joint == joint])
        ten[sought] = 0.0
        listed.append(_Body(where, _UNITS[sought], np.tensordot(ten, _UNITS, 1)))
    return listed


def unphysical(robot: Robot, base: BaseParameters, values: Array) -> tuple[str, ...]:
    """Return the names of parameters (p,) and bodies that no real robot has.

    A body that is none in the given robot, such as a thin one of a flat model, is judged by its mass alone.
    """
    bad = [p.name for p, value in zip(base.parameters, values, strict=True) if p.kind in NOT_NEGATIVE and value < 0.0]
    for body in _bodies(robot, base.parameters):
        if body.is_positive(base.standard / base.sizes) and not body.is_positive(values / base.sizes):
            bad.append(f"pseudo-inertia of {base.parameters[body.where[0]].of}")
    return tuple(bad)


def nearest_physical(robot: Robot, base: BaseParameters, values: Array, information: Array) -> tuple[Array, bool]:
    """Return (p,) parameters of real bodies whose base parameters explain the records best, and whether they are found.

    Minimises (β − values)ᵀ information (β − values), β = combination · parameters, plus a little of the distance from
    the given robot, with J of every body positive definite, and masses, friction, springs and rotors positive. A body
    whose held parameters allow no positive J keeps a positive mass.

    Args:
        robot: the given robot.
        base: the base parameters.
        values: (b,) base parameters of the linear fit.
        information: (b, b) inverse of their covariance.
    """
    factor = np.linalg.cholesky(information).T
    by_scaled, target, given = factor @ (base.combination * base.sizes), factor @ values, base.standard / base.sizes
    start, held = given.copy(), []
    positive = np.array([p.kind in NOT_NEGATIVE for p in base.parameters], dtype=bool)
    start[positive] = np.maximum(start[positive], _THIN)
    for body in _bodies(robot, base.parameters):
        if len(body.where) == len(INERTIAL):
            start[body.where] = _thickened(body.pseudo_inertia(given))
        if body.is_positive(start):
            held.append(body)
    rows = np.concatenate([by_scaled, _NEAR * np.eye(len(given))])
    aim, found = np.concatenate([target, _NEAR * given]), True
    for weight in _BARRIERS:
        start, found = _newton(start, rows, aim, float(weight), held, np.flatnonzero(positive))
    return base.sizes * start, found


def _newton(
    start: Array, rows: Array, aim: Array, weight: float, bodies: Sequence[_Body], positive: IntArray
) -> tuple[Array, bool]:
    """Return the minimum of ½|rows y − aim|² − weight (Σ log det J + Σ log y of positive ones), and if it is found."""

    def cost(y: Array) -> float:
        if (y[positive] <= 0.0).any() or not all(body.is_positive(y) for body in bodies):
            return np.inf
        logs = np.log(y[positive]).sum() + sum(np.linalg.slogdet(body.pseudo_inertia(y))[1] for body in bodies)
        return float(0.5 * ((rows @ y - aim) ** 2).sum() - weight * logs)

    y, now = start, cost(start)
    for _ in range(_STEPS):
        # with J = L Lᵀ and U_k = L⁻¹ J_k L⁻ᵀ the barrier has the gradient −Uᵀ vec 1 and the Hessian Uᵀ U
        U = [np.zeros((len(positive), len(y)))]
        U[0][np.arange(len(positive)), positive] = 1.0 / y[positive]
        for body in bodies:
            inverse = np.linalg.inv(np.linalg.cholesky(body.pseudo_inertia(y)))
            U.append(np.zeros((16, len(y))))
            U[-1][:, body.where] = (inverse @ body.units @ inverse.T).reshape(-1, 16).T
        ones = np.concatenate([np.ones(len(positive)), np.tile(np.eye(4).ravel(), len(bodies))])
        A = np.concatenate([rows, np.sqrt(weight) * np.concatenate(U)])
        step = np.linalg.lstsq(A, np.concatenate([aim - rows @ y, np.sqrt(weight) * ones]), rcond=None)[0]
        decrement = float(((A @ step) ** 2).sum())
        if decrement <= _DONE * weight:
            return y, True
        length = 1.0
        while cost(y + length * step) > now - 0.1 * length * decrement and length > _SHORTEST:
            length *= 0.5
        if length <= _SHORTEST:
            return y, decrement <= _ROUGHLY * weight
        y, now = y + length * step, cost(y + length * step)
    return y, False


def _thickened(J: Array) -> Array:
    """Return (10,) parameters of the body with pseudo-inertia J (4, 4), its eigenvalues raised to positive ones."""
    values, vectors = np.linalg.eigh(J)
    J = (vectors * np.maximum(values, _THIN * max(values[-1], _THIN))) @ vectors.T
    inertia = np.trace(J[:3, :3]) * np.eye(3) - J[:3, :3]
    return np.concatenate([[J[3, 3]], J[:3, 3], inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
