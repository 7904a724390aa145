"""The weighted equations of an identification, W τ = f(π), and their solution; nothing is divided by W.

With E = (W, 0; 0, 1) of motors and carriers, efforts u = (τ, carrier force), deviations δ of the base parameters from
the robot that is given, and c the noise in the coefficients of the splines through the positions,

    E u − f₀ = Y δ + D c + E ε + η,    ε ~ N(0, Σ) of the efforts,    η ~ N(0, S) of what the model leaves out of f.

δ and c are estimated together, c with the covariance of the splines (total least squares); Y and f₀ are evaluated
again at the corrected rates, which takes the bias of noise in the regressor away. D has the noise of velocities and
accelerations; what that of positions does to Γ and W is smaller by the speed over the cut-off frequency and is left
out. Σ and S, diagonal, are those of largest likelihood, in turns with δ. At a
type II singularity a row of E is zero, and says uᵀ Y δ = −uᵀ f₀ with no noise of the efforts in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize
from scipy.sparse import block_array, block_diag, diags_array
from scipy.sparse.linalg import splu

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.rnea import RneaAlongMotion, RneaDynamics
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.identification.base import BaseParameters
from redundancy_pin.identification.parameters import (
    INERTIAL,
    OF_SENSORS,
    Parameter,
    joint_forces,
    parameters_of,
    unit_load,
)
from redundancy_pin.identification.records import Records, SmoothMotion
from redundancy_pin.identification.regressor import chain_projection, chain_regressor
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import Robot

_ROUNDS = 12
_SETTLED = 0.02
"""Change of estimates and of their standard deviations in a round, in standard deviations, of a solution."""

_FLOOR = 1e-6
"""Standard deviation of η relative to the size of f, at least: the rounding of kinematics and splines."""

_PROBES = 16
"""Random signs that estimate the number of freedoms that c takes (Hutchinson 1990)."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The equations of one record of N samples, r rows each, and what they are linearised about.

    Attributes:
        measured: the motion of the tree as measured, carriers at zero.
        smooth: the motion of platform and carriers as measured.
        E: (N, r, d).
        effort: (N, d) u.
        clean: (N, d) u without its estimated noise.
        prior: (N, r) f₀.
        Y: (N, r, b).
        by_rates: (N, r, c) derivatives of f by measured rates, and by accelerations.
        coefficients: (c K,) noise of the splines, in standard deviations of the columns.
    """

    measured: RneaAlongMotion
    smooth: SmoothMotion
    E: Array
    effort: Array
    clean: Array
    prior: Array
    Y: Array
    by_rates: tuple[Array, Array]
    coefficients: Array

    @property
    def driven(self) -> Array:
        """(N, r) E u."""
        result: Array = np.einsum("Nrd,Nd->Nr", self.E, self.effort)
        return result

    def by_positions(self, L: Array) -> Any:
        """Return D (r N, c K), sparse, weighted by L (N, r, r)."""
        first, second = (np.einsum("Nrs,Nsc->Nrc", L, part) * self.smooth.noise for part in self.by_rates)
        _, rate, acceleration = self.smooth.basis
        blocks = [
            [
                diags_array(first[:, i, j]) @ rate + diags_array(second[:, i, j]) @ acceleration
                for j in range(first.shape[2])
            ]
            for i in range(first.shape[1])
        ]
        return block_array(blocks, format="csr")


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations: of the efforts (d,), and of what the model leaves out of f (r,); N or N·m."""

    effort: Array
    model: Array

    def whitening(self, E: Array) -> Array:
        """Return (N, r, r) L⁻¹ with L Lᵀ = E Σ Eᵀ + S."""
        covariance = np.einsum("Nrd,d,Nsd->Nrs", E, self.effort**2, E) + np.diag(self.model**2)
        result: Array = np.linalg.inv(np.linalg.cholesky(covariance))
        return result


@dataclass(frozen=True, eq=False)
class Solution:
    """The estimates.

    Attributes:
        rows: the equations, about the corrected motion.
        change: (b,) δ.
        information: (b, b) inverse of its covariance.
        rest: (N, r) what is left, all records.
        residual: (N, r) the same, whitened.
        freedom: part of the residuals that is free.
        noise: the standard deviations that were supposed.
        converged: whether estimates and variances are those of largest likelihood.
    """

    rows: tuple[Rows, ...]
    change: Array
    information: Array
    rest: Array
    residual: Array
    freedom: float
    noise: Noise
    converged: bool = False

    @property
    def deviation(self) -> Array:
        """(b,) standard deviations of δ."""
        return np.sqrt(np.diagonal(np.linalg.inv(self.information)))


def rows_of_records(
    robot: Robot, record: Records, smooth: SmoothMotion, parameters: Sequence[Parameter], carried: bool
) -> Rows:
    """Return the equations of a record in all parameters, about the motion as measured.

    Raises:
        InputError: the positions are no motion of the robot.
    """
    try:
        along = RneaDynamics(robot).along(smooth.motion)
    except (UnreachablePoseError, SingularPoseError, WorkingModeError) as error:
        raise InputError(
            f"The positions of {record!r} are no motion of {robot.name}: {error.message}",
            remedy="Check order, sign, zero and unit of the encoders.",
        ) from error
    r, columns = robot.n + (robot.k if carried else 0), len(smooth.noise)
    E = np.zeros((len(along.q), r, robot.m + r - robot.n))
    E[:, : robot.n, : robot.m] = along.tree.W
    E[:, robot.n :, robot.m :] = np.eye(r - robot.n)
    efforts = [record.effort[smooth.kept], record.carrier_force[smooth.kept]]
    still = np.zeros((len(E), r, columns))
    effort, coefficients = np.concatenate(efforts, axis=1)[:, : E.shape[2]], np.zeros(columns * smooth.gram.shape[0])
    bare = Rows(along, smooth, E, effort, effort, E[:, :, 0], E[:, :, :0], (still, still), coefficients)
    return _with_forces(bare, along, smooth.carriers, parameters)


def first_noise(rows: Sequence[Rows]) -> Noise:
    """Return the noise to start from: 5 % of the efforts."""
    effort, driven, prior = (
        np.sqrt((np.concatenate(parts) ** 2).mean(axis=0))
        for parts in zip(*((one.effort, one.driven, one.prior) for one in rows), strict=True)
    )
    size = np.hypot(driven, prior)
    least = _FLOOR * max(float(size.max(initial=0.0)), 1e-100)
    return Noise(0.05 * np.maximum(effort, least), np.maximum(_FLOOR * size, _FLOOR * least))


def solve(robot: Robot, base: BaseParameters, rows: Sequence[Rows]) -> Solution:
    """Return the estimates of largest likelihood, by weighted total least squares and variances in turns."""
    start = first_noise(rows)
    found = _least_squares(rows, start)
    for _ in range(_ROUNDS):
        before = found
        noise, converged = _likeliest(found, floor=start.model)
        values = base.standard_values(found.change)
        try:
            found = _least_squares([_corrected(robot, base, one, values) for one in found.rows], noise)
        except (RuntimeError, np.linalg.LinAlgError):  # of splu, where numbers have become infinite
            return before
        if not np.isfinite(found.change).all():
            return before
        old, new = before.deviation, found.deviation
        moved = np.maximum(np.abs(found.change - before.change), np.abs(new - old))
        if converged and (moved <= _SETTLED * new).all():
            return replace(found, converged=True)
    return found


def _with_forces(rows: Rows, along: RneaAlongMotion, carriers: CarrierMotion, parameters: Sequence[Parameter]) -> Rows:
    """Return the equations with f₀ and Y along a motion; E factor (u − offset) = f has columns E and −E u."""
    r, drives = rows.E.shape[1], [*along.robot.actuated, *along.robot.carriers]
    prior = np.concatenate(along.forces(carriers), axis=1)[:, :r]
    own = [p for p in parameters if p.kind not in OF_SENSORS]
    columns = [chain_regressor(along, own, carriers)[:, :r]]
    for p in parameters[len(own) :]:
        j = drives.index(p.of)
        columns.append((rows.E[:, :, j] * (1.0 if p.kind == "offset" else -rows.clean[:, j : j + 1]))[:, :, None])
    return replace(rows, prior=prior, Y=np.concatenate(columns, axis=2))


def _corrected(robot: Robot, base: BaseParameters, rows: Rows, values: Array) -> Rows:
    """Return the equations about rates without the estimated noise of positions, by the dynamics of ``values`` (p,)."""
    smooth, tree, r = rows.smooth, rows.measured.tree, rows.prior.shape[1]
    projection = chain_projection(robot, tree.gamma)
    # velocities of the tree per measured rate
    per_rate = np.concatenate([tree.gamma @ smooth.jacobian, projection[:, :, robot.n :]], axis=2)
    noise = rows.coefficients.reshape(len(smooth.noise), -1).T * smooth.noise
    rate, acceleration = (part @ noise for part in smooth.basis[1:])
    v, a = (before + (per_rate @ part[:, :, None])[..., 0] for before, part in ((tree.v, rate), (tree.a, acceleration)))
    along = RneaAlongMotion(replace(tree, v=read_only(v), a=read_only(a)))
    carried, moved = smooth.carriers, slice(smooth.jacobian.shape[2], None)
    carriers = CarrierMotion(
        carried.s, carried.sd + rate[:, moved], carried.sdd + acceleration[:, moved], check_rates=False
    )
    rows = _with_forces(rows, along, carriers, [base.parameters[k] for k in base.independent])
    derivatives = _derivatives(robot, base.parameters, values, along.tree_motion(carriers), per_rate)
    first, second = (projection[:, :, :r].transpose(0, 2, 1) @ part for part in derivatives)
    return replace(rows, by_rates=(first, second))


def _derivatives(
    robot: Robot, parameters: Sequence[Parameter], values: Array, motion: tuple[Array, Array, Array], per_rate: Array
) -> tuple[Array, Array]:
    """Return (N, nv, c) derivatives of the tree's efforts by measured rates, and by accelerations (which is M Γ').

    They are sums of regressors: values (p,) need not be those of real bodies. Efforts are quadratic in v, so that
    central differences are exact. Of a rotor in a moving link the part that turns about the joint counts.

    Args:
        robot: the given robot.
        parameters: the p parameters that are sought.
        values: (p,) their estimates.
        motion: q (N, nq), v and a (N, nv) of the tree.
        per_rate: (N, nv, c) Γ' of velocities per measured rate.
    """
    estimates = {p.name: float(value) for p, value in zip(parameters, values, strict=True)}
    (q, v, _), model = motion, robot.model.copy()
    model.gravity.setZero()
    data, still, inertial = model.createData(), np.zeros(model.nv), np.zeros(10 * len(robot.bodies))
    damping, rotors = np.zeros(v.shape), np.array(model.armature)
    for p in parameters_of(robot, ["*"]):
        value, column = estimates.get(p.name, p.value), model.joints[p.joint].idx_v
        if p.kind in INERTIAL:
            inertial[10 * (p.joint - 1) + INERTIAL.index(p.kind)] = value
        elif p.kind in ("damping", "friction") and value:
            damping[:, column] += value * unit_load(robot, p).resistance_rate(v[:, column])
        elif p.kind == "rotor inertia":
            rotors[column] += value * joint_forces(robot, p.of).gear ** 2
    by_rate, by_acceleration = damping[:, :, None] * per_rate, rotors[:, None] * per_rate
    for i, j in np.ndindex(len(q), per_rate.shape[2]):
        way = per_rate[i, :, j]
        by_acceleration[i, :, j] += pin.computeJointTorqueRegressor(model, data, q[i], still, way) @ inertial
        for sign in (0.5, -0.5):
            moved = v[i] + 2.0 * sign * way
            by_rate[i, :, j] += sign * (pin.computeJointTorqueRegressor(model, data, q[i], moved, still) @ inertial)
    return by_rate, by_acceleration


def _least_squares(rows: Sequence[Rows], noise: Noise) -> Solution:
    """Return δ and c of least weighted squares, c eliminated record by record."""
    b = rows[0].Y.shape[2]
    information, right, parts, taken = np.zeros((b, b)), np.zeros(b), [], float(b)
    signs = np.random.default_rng(0)
    for one in rows:
        L = noise.whitening(one.E)
        A = np.einsum("Nrs,Nsb->rNb", L, one.Y).reshape(one.prior.size, b)
        D = one.by_positions(L)
        y = np.einsum("Nrs,Ns->rN", L, one.driven - one.prior).ravel() + D @ one.coefficients
        prior = block_diag([one.smooth.gram] * len(one.smooth.noise), format="csc")
        factor = splu((D.T @ D + prior).tocsc(), permc_spec="MMD_AT_PLUS_A")
        DA, Dy = D.T @ A, D.T @ y
        information += A.T @ A - DA.T @ factor.solve(DA)
        right += A.T @ y - DA.T @ factor.solve(Dy)
        probes = D.T @ signs.choice([-1.0, 1.0], (D.shape[0], _PROBES))
        taken += float((probes * factor.solve(probes)).sum()) / _PROBES
        parts.append((one, L, A, D, y, factor, DA, Dy))
    scale = np.sqrt(np.diagonal(information)) if b else np.ones(0)
    change = np.linalg.solve(information / np.outer(scale, scale), right / scale) / scale
    solved, rest, residual = [], [], []
    for one, L, A, D, y, factor, DA, Dy in parts:
        coefficients = factor.solve(Dy - DA @ change)
        white = (y - A @ change - D @ coefficients).reshape(-1, len(one.E)).T
        noisy = noise.effort**2 * np.einsum("Nrd,Nsr,Ns->Nd", one.E, L, white)
        solved.append(replace(one, coefficients=coefficients, clean=one.effort - noisy))
        residual.append(white)
        rest.append(np.linalg.solve(L, white[..., None])[..., 0])
    count = sum(part.size for part in rest)
    return Solution(
        tuple(solved),
        change,
        information,
        np.concatenate(rest),
        np.concatenate(residual),
        max(count - taken, 1.0) / count,
        noise,
    )


def _likeliest(solution: Solution, floor: Array) -> tuple[Noise, bool]:
    """Return the noise of largest likelihood for the residuals of a solution, and whether it was found."""
    E, rest = np.concatenate([one.E for one in solution.rows]), solution.rest / np.sqrt(solution.freedom)
    effort, model = solution.noise.effort, np.maximum(solution.noise.model, 10.0 * floor)
    drives, low = len(effort), np.log(np.concatenate([1e-6 * effort, floor]))

    def cost(logs: Array) -> tuple[float, Array]:
        both = np.exp(logs)
        L = Noise(both[:drives], both[drives:]).whitening(E)
        white = np.einsum("Nrs,Ns->Nr", L, rest)
        back, inverse = np.einsum("Nsr,Ns->Nr", L, white), np.einsum("Nsr,Nst->Nrt", L, L)
        value = -2.0 * np.log(np.einsum("Nrr->Nr", L)).sum() + (white**2).sum()
        by_effort = np.einsum("Nrd,Nrs,Nsd->d", E, inverse, E) - (np.einsum("Nr,Nrd->Nd", back, E) ** 2).sum(axis=0)
        by_model = np.einsum("Nrr->r", inverse) - (back**2).sum(axis=0)
        gradient = 2.0 * both**2 * np.concatenate([by_effort, by_model])
        return float(value) / len(rest), gradient / len(rest)

    start = np.maximum(np.log(np.concatenate([effort, model])), low)
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=[(least, None) for least in low])
    both = np.exp(found.x)
    return Noise(both[:drives], both[drives:]), bool(found.success)
