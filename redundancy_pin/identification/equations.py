"""The weighted equations of an identification, W τ = f(π), and their solution; nothing is divided by W.

With E = (W, 0; 0, 1) of motors and carriers, readings u of the efforts, factors k and offsets o of the sensors, and c
the noise in the coefficients of the splines through the positions,

    E (k u − o) = f(π, motion less c) + E k ε + η,    ε ~ N(0, Σ) of readings,    η ~ N(0, S) left out of f.

Parameters and c are estimated together by Gauss and Newton's method, c with the covariance of the splines, and the
columns of factors from readings without their estimated noise (total least squares): noise in the regressor gives no
bias. Σ, of each record, is what makes the residuals those of simulated noise, S a small part of E Σ Eᵀ: at a type II
singularity a row of E is zero, and says uᵀ f(π) = 0 with no noise of readings in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.sparse import block_array, block_diag, diags_array
from scipy.sparse.linalg import splu

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.rnea import RneaAlongMotion, RneaDynamics
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.identification.base import BaseParameters
from redundancy_pin.identification.parameters import IN_JOINT, INERTIAL, Parameter, tilted, with_inertias
from redundancy_pin.identification.records import Records, SmoothMotion
from redundancy_pin.identification.regressor import chain_projection, chain_regressor, gravity_effort
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import JointForces, Robot
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint

_ITERATIONS = 15
_SETTLED = 0.02
"""Change of estimates and of their standard deviations in an iteration, in standard deviations, of a solution."""

_SINGULAR = 0.03
"""Standard deviation of η relative to that of E k ε along the motion: the error of splines where E ε vanishes."""

_EXACT = 1e-3
"""Noise of readings relative to their size, at least: splines do not follow forces more exactly."""

_DRAWS = 16
"""Draws of simulated residuals: what the estimation itself takes off residuals and correlates in them."""

_ROUNDING = 1e-15
"""Least eigenvalue of the scaled information, relative to its largest."""

_LEAST_SHARE = 0.1
"""Variance of an estimate relative to that by white noise, at least."""

COLLAPSED = 1e-3
"""Factors of all readings below which the equations are solved by none at all."""


@dataclass(frozen=True, eq=False)
class Measured:
    """A record of N samples: r rows of equations, d drives, c measured columns.

    Attributes:
        along: the motion of the tree as measured, carriers at zero.
        smooth: the motion of platform and carriers as measured.
        E: (N, r, d).
        reading: (N, d) u.
        noise: (d,) standard deviation of u about splines, N or N·m.
        projection: (N, nv, r) velocities of the tree per rate of a row.
        per_rate: (N, nv, c) velocities of the tree per measured rate.
    """

    along: RneaAlongMotion
    smooth: SmoothMotion
    E: Array
    reading: Array
    noise: Array
    projection: Array
    per_rate: Array


@dataclass(frozen=True, eq=False)
class Rows:
    """The equations of a record, linearised.

    Attributes:
        record: what was measured.
        E: (N, r, d) E k.
        right: (N, r) what Y times the deviations from the given robot is to be, but for noise.
        Y: (N, r, b) derivatives by the parameters, sensors included.
        by_rates: (N, r, c) derivatives of f by measured rates, and by accelerations.
        coefficients: (c K,) c, in standard deviations of the measured columns.
        clean: (N, d) u without its estimated noise.
        noise: (d,) standard deviation of u, N or N·m.
    """

    record: Measured
    E: Array
    right: Array
    Y: Array
    by_rates: tuple[Array, Array]
    coefficients: Array
    clean: Array
    noise: Array

    @property
    def driven(self) -> Array:
        """(N, r) generalised forces of the readings, E k u, N or N·m."""
        return read_only(np.einsum("Nrd,Nd->Nr", self.E, self.record.reading))

    def by_positions(self, L: Array) -> Any:
        """Return D (r N, c K), sparse, the derivatives of f by c, weighted by L (N, r, r)."""
        smooth = self.record.smooth
        first, second = (np.einsum("Nrs,Nsc->rcN", L, part * smooth.noise) for part in self.by_rates)
        rate, acceleration = smooth.basis
        return block_array(
            [
                [diags_array(v) @ rate + diags_array(a) @ acceleration for v, a in zip(of_v, of_a, strict=True)]
                for of_v, of_a in zip(first, second, strict=True)
            ],
            format="csr",
        )


def whitening(E: Array, noise: Array, left_out: float = _SINGULAR) -> Array:
    """Return (N, r, r) L⁻¹ with L Lᵀ = E Σ Eᵀ + S, for readings with standard deviations (d,); S relative to E Σ Eᵀ."""
    covariance = np.einsum("Nrd,d,Nsd->Nrs", E, noise**2, E)
    covariance += np.diag(left_out**2 * np.diagonal(covariance.mean(axis=0)))
    result: Array = np.linalg.inv(np.linalg.cholesky(covariance))
    return result


@dataclass(frozen=True, eq=False)
class Part:
    """The weighted equations of a record, solved.

    Attributes:
        rows: the equations, with c and clean readings.
        L: (N, r, r) weights.
        A: (N, r, b) weighted Y.
        white: (N, r) weighted residuals.
        drawn: (N, r, draws) the same of simulated noise.
    """

    rows: Rows
    L: Array
    A: Array
    white: Array
    drawn: Array

    @property
    def noise(self) -> Array:
        """(d,) standard deviation of the readings, for which residuals are as large as simulated ones, N or N·m."""
        by_reading = self.L @ self.rows.E
        seen = (np.einsum("Nrd,Nr->Nd", by_reading, self.white) ** 2).sum(axis=0)
        drawn = (np.einsum("Nrd,Nrs->Nds", by_reading, self.drawn) ** 2).sum(axis=(0, 2)) / _DRAWS
        result: Array = np.maximum(self.rows.noise * np.sqrt(seen / drawn), least_noise(self.rows.record.reading))
        return result

    def lagged(self, lag: int) -> tuple[Array, Array]:
        """Return (r, r) Σ w(t) w(t + lag)ᵀ of the weighted residuals, and of simulated white noise."""
        early, late = slice(len(self.white) - lag), slice(lag, None)
        drawn: Array = np.tensordot(self.drawn[early], self.drawn[late], ((0, 2), (0, 2))) / _DRAWS
        return self.white[early].T @ self.white[late], drawn

    @property
    def rest(self) -> Array:
        """(N, r) what is left, N or N·m."""
        return read_only(np.linalg.solve(self.L, self.white[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class Solution:
    """The estimates.

    Attributes:
        parts: the records.
        change: (b,) deviations of the base parameters from the given robot.
        information: (b, b) inverse of their covariance where noise is white.
        converged: whether the estimates maximise the likelihood.
    """

    parts: tuple[Part, ...]
    change: Array
    information: Array
    converged: bool = False

    @property
    def deviation(self) -> Array:
        """(b,) standard deviations of the estimates where noise is white."""
        scale = np.sqrt(np.diagonal(self.information))
        scaled = np.linalg.inv(self.information / np.outer(scale, scale))
        result: Array = np.sqrt(np.abs(np.diagonal(scaled))) / scale
        return result

    @property
    def whiteness(self) -> Array:
        """(r,) correlation of the weighted residuals from sample to sample, less the one of simulated noise."""
        squares, products = (
            np.diagonal(sum(np.array(part.lagged(lag)) for part in self.parts), axis1=1, axis2=2) for lag in (0, 1)
        )
        result: Array = np.clip(np.subtract(*products / np.where(squares, squares, 1.0)), -1.0, 1.0)
        return result

    def weight(self, lags: int) -> Array:
        """Return (b, b) F with (Fᵀ F)⁻¹ the covariance of the estimates, correlation of the residuals included.

        The covariance is H⁻¹ M H⁻¹, M = H + Σ (1 − |l|/lags) Aᵀ (Γ_l − Γ_l°) A, with Bartlett's weights (Newey and West
        1987, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix").
        Γ_l are the covariances of the residuals of a record at lag l, Γ_l° those that white noise would have in this
        estimation. Of their differences the part is taken that is not by chance (Stein's shrinkage).
        """
        M = self.information.copy()
        if not len(M):
            return M
        for part in self.parts:
            lagged, count = [part.lagged(lag) for lag in range(lags)], len(part.white)
            excess = [(1.0 - lag / lags) * (found - drawn) / count for lag, (found, drawn) in enumerate(lagged)]
            by_chance = sum(own.size * (1.0 - lag / lags) ** 2 / count for lag, own in enumerate(excess))
            share = max(0.0, 1.0 - by_chance / max(sum(float((own**2).sum()) for own in excess), by_chance))
            for lag, own in enumerate(excess):
                late = np.einsum("rs,Nsb->Nrb", share * own, part.A[lag:]).reshape(-1, len(M))
                product = part.A.reshape(-1, len(M))[: len(late)].T @ late
                M += product + product.T if lag else product
        # relative to H, so that no noise of Γ makes a variance negative
        scale = np.sqrt(np.diagonal(self.information))
        known, axes = np.linalg.eigh(self.information / np.outer(scale, scale))
        size = np.sqrt(np.maximum(known, _ROUNDING * known[-1]))  # of what a motion hardly shows, rounding is left
        M = (axes / size).T @ (M / np.outer(scale, scale)) @ (axes / size)
        values, vectors = np.linalg.eigh(0.5 * (M + M.T))
        result: Array = (vectors.T / np.sqrt(np.maximum(values, _LEAST_SHARE))[:, None]) @ (axes * size).T * scale
        return result


def least_noise(readings: Array) -> Array:
    """Return (d,) the least standard deviation that is supposed of readings (N, d)."""
    size = np.sqrt((readings**2).mean(axis=0))
    result: Array = _EXACT * np.maximum(size, _EXACT * (size.max(initial=0.0) or 1.0))
    return result


def measure(robot: Robot, record: Records, smooth: SmoothMotion, carried: bool) -> Measured:
    """Return a record with the motion of the tree; rows of carrier forces where ``carried``.

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
    n, r = robot.n, robot.n + (robot.k if carried else 0)
    E = np.zeros((len(along.q), r, robot.m + r - n))
    E[:, :n, : robot.m] = along.tree.W
    E[:, n:, robot.m :] = np.eye(r - n)
    projection = chain_projection(robot, along.gamma)
    per_rate = np.concatenate([along.gamma @ smooth.jacobian, projection[:, :, n:]], axis=2)
    reading = record.efforts[smooth.kept, : E.shape[2]]
    noise = np.maximum(smooth.effort_noise[: E.shape[2]], least_noise(reading))
    return Measured(along, smooth, E, reading, noise, projection[:, :, :r], per_rate)


def linearise(
    record: Measured,
    parameters: Sequence[Parameter],
    values: Array,
    columns: Sequence[int],
    before: Rows | None = None,
) -> Rows:
    """Return the equations of a record in some of the parameters about values (p,) of all of them.

    Values need not belong to real bodies. ``before`` has the noise that was estimated; that about splines without.
    """
    robot, smooth, tree = record.along.robot, record.smooth, record.along.tree
    drives = [*robot.actuated, *robot.carriers]
    coefficients = np.zeros(len(smooth.noise) * smooth.gram.shape[0]) if before is None else before.coefficients
    # splines through readings have less noise than they: a start from which factors are found
    smoothed = smooth.efforts(record.along.motion.t)[:, : record.E.shape[2]]
    clean = smoothed if before is None else before.clean
    deviation = record.noise if before is None else before.noise
    noise = coefficients.reshape(len(smooth.noise), -1).T * smooth.noise
    rate, acceleration = (part @ noise for part in smooth.basis)
    v, a = (was + np.einsum("Nvc,Nc->Nv", record.per_rate, by) for was, by in ((tree.v, rate), (tree.a, acceleration)))
    carried, own = smooth.carriers, slice(smooth.jacobian.shape[2], None)
    carriers = CarrierMotion(
        carried.s, carried.sd + rate[:, own], carried.sdd + acceleration[:, own], check_rates=False
    )
    factors, tilt = np.ones(record.E.shape[2]), np.zeros(3)
    for k in columns:
        if parameters[k].kind == "factor":
            factors[drives.index(parameters[k].of)] = values[k]
        elif parameters[k].kind.startswith("tilt"):
            tilt["xyz".index(parameters[k].kind[-1])] = values[k]
    now = tilted(robot, tilt)
    along = RneaAlongMotion(replace(tree, robot=now, v=read_only(v), a=read_only(a)))
    model = with_inertias(now, parameters, values)
    chosen = [parameters[k] for k in columns]
    dynamic = [p for p in chosen if p.kind in INERTIAL or p.kind in IN_JOINT]
    r = record.E.shape[1]
    Y = [chain_regressor(along, dynamic, carriers)[:, :r]]
    right = np.einsum("Nrd,Nd->Nr", record.E, record.reading + (factors - 1.0) * (record.reading - clean))
    right -= np.concatenate(along.forces(carriers), axis=1)[:, :r]
    for p in chosen[len(dynamic) :]:
        if p.kind == "factor":
            column = -record.E[:, :, drives.index(p.of)] * clean[:, [drives.index(p.of)]]
        elif p.kind == "offset":
            column = record.E[:, :, drives.index(p.of)]
        else:
            axis = "xyz".index(p.kind[-1])
            turned = pin.exp3(tilt) @ np.cross(pin.Jexp3(tilt)[:, axis], robot.gravity)
            column = np.einsum("Nvr,Nv->Nr", record.projection, gravity_effort(model, tree.q, turned))
            right += column * tilt[axis]
        Y.append(column[:, :, None])
    by_rates = _derivatives(now, model, parameters, values, along.tree_motion(carriers), record.per_rate)
    first, second = (record.projection.transpose(0, 2, 1) @ part for part in by_rates)
    return Rows(
        record, record.E * factors, right, np.concatenate(Y, axis=2), (first, second), coefficients, clean, deviation
    )


def _derivatives(
    robot: Robot,
    model: pin.Model,
    parameters: Sequence[Parameter],
    values: Array,
    motion: tuple[Array, Array, Array],
    per_rate: Array,
) -> tuple[Array, Array]:
    """Return (N, nv, c) derivatives of the tree's efforts by measured rates, and by accelerations (which is M Γ')."""
    sought = {(p.of, p.kind.replace(" ", "_")): value for p, value in zip(parameters, values, strict=True)}
    declared = {load.joint: load for load in of_kind(robot.loads, JointForces)}
    damping, rotors = np.zeros(motion[1].shape), np.zeros(model.nv)
    for name in {*declared, *(p.of for p in parameters if p.kind in IN_JOINT)}:
        joint, load = find_joint(model, name), declared.get(name, JointForces(name))
        if joint.nv != 1:
            continue
        own = {kind: sought.get((name, kind), getattr(load, kind)) for kind in ("damping", "friction", "rotor_inertia")}
        speeds = motion[1][:, joint.idx_v]
        slow = JointForces(name, friction=1.0, friction_speed=load.friction_speed).resistance_rate(speeds)
        damping[:, joint.idx_v] = own["damping"] + own["friction"] * slow
        rotors[joint.idx_v] = own["rotor_inertia"] * load.gear**2
    by_rate, by_acceleration, data = np.empty(per_rate.shape), np.empty(per_rate.shape), model.createData()
    for i, state in enumerate(zip(*motion, strict=True)):
        _, by_v, mass = pin.computeRNEADerivatives(model, data, *state)
        # Pinocchio fills the upper triangle of the mass matrix only
        mass = np.triu(mass) + np.triu(mass, 1).T + np.diag(rotors)
        by_rate[i], by_acceleration[i] = (by_v + np.diag(damping[i])) @ per_rate[i], mass @ per_rate[i]
    return by_rate, by_acceleration


def solve(base: BaseParameters, records: Sequence[Measured]) -> Solution:
    """Return the estimates of largest likelihood, parameters and noise of positions, and noise of efforts, in turns."""
    lead = [int(k) for k in base.independent]
    factors = [k for k in lead if base.parameters[k].kind == "factor"]
    found = _least_squares([linearise(one, base.parameters, base.standard, lead) for one in records])
    for _ in range(_ITERATIONS):
        before, values = found, base.standard_values(found.change)
        if factors and np.abs(values[factors]).max() < COLLAPSED:
            return found
        try:
            with np.errstate(all="raise", under="ignore"):
                # residuals tell factors only where the noise of the readings is known without them
                known = [p.rows if factors else replace(p.rows, noise=p.noise) for p in found.parts]
                found = _least_squares([linearise(k.record, base.parameters, values, lead, k) for k in known])
        except (RuntimeError, ArithmeticError, np.linalg.LinAlgError):  # of numbers that have become infinite
            return before
        if not np.isfinite(found.change).all():
            return before
        moved = np.maximum(np.abs(found.change - before.change), np.abs(found.deviation - before.deviation))
        if (moved <= _SETTLED * found.deviation).all():
            return replace(found, converged=True)
    return found


def _least_squares(rows: Sequence[Rows]) -> Solution:
    """Return parameters and c of least weighted squares, c eliminated record by record.

    With D the weighted derivatives by c and P the inverse of its covariance, residuals have the covariance
    V = 1 + D P⁻¹ Dᵀ, and V⁻¹ = 1 − D (DᵀD + P)⁻¹ Dᵀ.
    """
    b = rows[0].Y.shape[2]
    information, right, equations = np.zeros((b, b)), np.zeros(b), []
    rng = np.random.default_rng(0)
    for one in rows:
        smooth, L = one.record.smooth, whitening(one.E, one.noise)
        A = np.einsum("Nrs,Nsb->rNb", L, one.Y).reshape(one.right.size, b)
        D = one.by_positions(L)
        y = np.einsum("Nrs,Ns->rN", L, one.right).ravel() + D @ one.coefficients
        factor = splu((D.T @ D + block_diag([smooth.gram] * len(smooth.noise))).tocsc(), permc_spec="MMD_AT_PLUS_A")
        VA = A - D @ factor.solve(D.T @ A)
        information += A.T @ VA
        right += VA.T @ y
        # simulated V⁻¹ e of residuals e with covariance V
        efforts = rng.standard_normal((len(y), _DRAWS))
        positions = rng.standard_normal((len(smooth.noise), smooth.everywhere.shape[0], _DRAWS))
        by_positions = np.concatenate([smooth.everywhere.T @ one for one in positions])
        drawn = efforts - D @ factor.solve(D.T @ efforts + by_positions)
        equations.append((one, L, A, D, y, factor, VA, drawn))
    if not (np.diagonal(information) > 0.0).all():
        raise np.linalg.LinAlgError("information lost in rounding")
    scale = np.sqrt(np.diagonal(information))
    scaled = information / np.outer(scale, scale)
    change = np.linalg.solve(scaled, right / scale) / scale
    in_draws = sum((A.T @ drawn for _, _, A, *_, drawn in equations), np.zeros((b, _DRAWS)))
    fitted = np.linalg.solve(scaled, in_draws / scale[:, None]) / scale[:, None]
    parts = []
    for one, L, A, D, y, factor, VA, drawn in equations:
        count = len(L)
        left = y - A @ change
        coefficients = factor.solve(D.T @ left)
        white = (left - D @ coefficients).reshape(-1, count).T
        noisy = one.noise**2 * np.einsum("Nrd,Nsr,Ns->Nd", one.E, L, white)
        solved = replace(one, coefficients=coefficients, clean=one.record.reading - noisy)
        simulated = (drawn - VA @ fitted).reshape(*white.T.shape, _DRAWS).swapaxes(0, 1)
        parts.append(Part(solved, L, A.reshape(*white.T.shape, b).swapaxes(0, 1), white, simulated))
    return Solution(tuple(parts), change, information)
