"""The fit of dynamic parameters to measured motions: W τ = f(π), without dividing by W.

With E = (W, 0; 0, 1) of motors and carriers, efforts u = (τ, carrier force), and deviations δ of the base parameters
from those of the robot that is given,

    E u − f₀ = Y δ + E ε + η,    ε ~ N(0, Σ) of the efforts,    η ~ N(0, S) of what motion and model leave out of f.

Rows are weighted by (E Σ Eᵀ + S)⁻¹. At a type II singularity a row of E is zero, and says uᵀ Y δ = −uᵀ f₀ with no
noise of the efforts in it. The variances, diagonal, are those of largest likelihood, in turns with δ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from redundancy_pin.arrays import Array, Frozen, checked, read_only
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.identification.base import BaseParameters, base_parameters
from redundancy_pin.identification.parameters import parameters_of, standard_values, with_values
from redundancy_pin.identification.physical import nearest_physical
from redundancy_pin.identification.records import Records, SmoothMotion, require_matching, smooth_motion
from redundancy_pin.identification.regressor import chain_regressor
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot

_ROUNDS = 6
_FLOOR = 1e-6
"""Standard deviation of η relative to the size of f, at least: the rounding of kinematics and splines."""

_TOO_LITTLE = 1e-6
"""Singular value of the weighted, scaled regressor, relative to the largest, below which a motion shows nothing."""

_BETTER = 0.7
"""Part of the residual variance that is left if efforts are named otherwise, below which they are taken for that."""


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Frozen):
    """Identified parameters; made by ``identify``.

    Attributes:
        before: the robot that was given.
        base: the base parameters, their names and units.
        values: (b,) their estimates.
        covariance: (b, b) of the estimates.
        parameters_after: (p,) values of all parameters: the smallest change, relative to their sizes, that gives
            ``values``, or with ``physical`` the nearest of real bodies.
        t: (N,) time of the samples used, s.
        measured: (N, n + k) E u: generalised force of the platform's coordinates, and carrier forces, N and N·m.
        predicted: (N, n + k) the same by the estimates.
        residual: (N, n + k) their difference, whitened: standard normal where the model holds.
        effort_noise: (m,) or (m + k,) standard deviation of the efforts, N or N·m.
        model_noise: (n + k,) standard deviation of what is left out of f.
        position_noise: standard deviation of the positions about their splines, m and rad.
    """

    before: Robot
    base: BaseParameters
    values: Array
    covariance: Array
    parameters_after: Array
    t: Array
    measured: Array
    predicted: Array
    residual: Array
    effort_noise: Array
    model_noise: Array
    position_noise: Array

    def __repr__(self) -> str:
        """Return the table of the estimates."""
        rows = zip(self.base.names, self.values, self.standard_deviation, self.base.units, strict=True)
        lines = [f"{value:12.5g} ± {1.96 * std:.2g} {unit}: {name}" for name, value, std, unit in rows]
        return "\n".join([f"Fit of {self.before.name}: {len(self.t)} samples, {len(self.base)} parameters", *lines])

    @property
    def standard_deviation(self) -> Array:
        """(b,) of the estimates."""
        return read_only(np.sqrt(np.diagonal(self.covariance)))

    @property
    def intervals(self) -> Array:
        """(b, 2) 95 % intervals, values ± 1.96 standard deviations."""
        half = 1.959964 * self.standard_deviation
        return read_only(np.stack([self.values - half, self.values + half], axis=1))

    @property
    def correlation(self) -> Array:
        """(b, b) of the estimates."""
        std = self.standard_deviation
        return read_only(self.covariance / np.outer(std, std))

    @property
    def whiteness(self) -> Array:
        """(n + k,) correlation of the residuals with those one sample before.

        It is within ±1.96/√N where they are white. Where it is larger, by filtered noise or a force that the model does
        not have, the standard deviations are too small by about √((1 + r) / (1 − r)).
        """
        here, next_one = self.residual[:-1], self.residual[1:]
        return read_only((here * next_one).sum(axis=0) / (self.residual**2).sum(axis=0))

    @property
    def robot(self) -> Robot:
        """The robot with the estimates; what the motions do not show is as near to the given robot as it can be.

        Raises:
            InputError: a negative friction, damping, stiffness or rotor inertia; ``physical=True`` has none.
        """
        return with_values(self.before, self.base.parameters, self.parameters_after)


def identify(
    robot: RobotLike,
    records: Records | Sequence[Records],
    *,
    cut_off: float,
    parameters: Sequence[str] | None = None,
    physical: bool = False,
) -> Fit:
    """Return the dynamic parameters of a robot that explain measured motions, with their standard deviations.

    Args:
        robot: the robot as it is declared, or its name or path; parameters that are not identified keep its values.
        records: one measured motion or several.
        cut_off: Hz, of the splines through the positions: above the fastest motion, below the noise. Efforts are not
            filtered: their noise stays white.
        parameters: names or patterns of the parameters to identify, as of ``parameters_of``.
        physical: let ``fit.robot`` have bodies of positive density alone and no negative friction (log-Cholesky
            coordinates of the pseudo-inertias); ``values`` and their intervals stay those of the linear fit.

    Raises:
        InputError: records of another robot; efforts with the wrong sign, swapped or shifted in time; motions that do
            not show a parameter, which is named.

    Example:
        >>> fit = identify("five_bar", Records(t, effort, position), cut_off=20.0)
        >>> fit.values, fit.standard_deviation, fit.base.names
    """
    robot = as_robot(robot)
    listed = [records] if isinstance(records, Records) else list(records)
    cut = float(checked(cut_off, "cut_off", ()))
    if cut <= 0.0 or not listed:
        raise InputError(f"cut_off is {cut:g} Hz, of {len(listed)} records.", remedy="Pass records and a positive one.")
    for one in listed:
        require_matching(robot, one)
    carried = all(one.carrier_force.shape[1] for one in listed) and robot.k > 0
    base = base_parameters(robot, parameters_of(robot, parameters))
    smooth = [smooth_motion(robot, one, cut) for one in listed]
    equations = _Equations.of(robot, listed, smooth, base, carried)
    solution = equations.solve()
    equations.require_motion(solution, base)
    equations.require_named_efforts(robot)
    _require_in_time(listed, smooth, equations)
    values = base.values + solution.change
    standard = standard_values(base.parameters) + base.spread(solution.change)
    if physical:
        standard = nearest_physical(base, standard, values, solution.information)
    return Fit(
        before=robot,
        base=base,
        values=read_only(values),
        covariance=read_only(np.linalg.inv(solution.information)),
        parameters_after=read_only(standard),
        t=read_only(np.concatenate([part.motion.t for part in smooth])),
        measured=read_only(equations.driven),
        predicted=read_only(equations.prior + equations.Y @ solution.change),
        residual=read_only(solution.residual),
        effort_noise=read_only(solution.effort_noise),
        model_noise=read_only(solution.model_noise),
        position_noise=read_only(np.max([part.noise for part in smooth], axis=0)),
    )


@dataclass(frozen=True, eq=False)
class _Solution:
    """δ (b,), its information matrix (b, b), whitened residuals (N, r), and standard deviations of the noise."""

    change: Array
    information: Array
    residual: Array
    effort_noise: Array
    model_noise: Array


@dataclass(frozen=True, eq=False)
class _Equations:
    """E (N, r, d), efforts (N, d), f₀ (N, r) and Y (N, r, b) at N samples."""

    E: Array
    effort: Array
    prior: Array
    Y: Array

    @staticmethod
    def of(
        robot: Robot, records: list[Records], smooth: list[SmoothMotion], base: BaseParameters, carried: bool
    ) -> _Equations:
        chosen, rows = [base.parameters[k] for k in base.independent], robot.n + (robot.k if carried else 0)
        parts = []
        for one, part in zip(records, smooth, strict=True):
            try:
                along = RneaDynamics(robot).along(part.motion)
            except (UnreachablePoseError, SingularPoseError, WorkingModeError) as error:
                raise InputError(
                    f"The positions of {one!r} are no motion of {robot.name}: {error.message}",
                    remedy="Check order, sign, zero and unit of the encoders.",
                ) from error
            f, force = along.forces(part.carriers)
            E = np.zeros((len(f), rows, robot.m + rows - robot.n))
            E[:, : robot.n, : robot.m] = along.tree.W
            E[:, robot.n :, robot.m :] = np.eye(rows - robot.n)
            efforts, prior = [one.effort[part.kept]], [f]
            if carried:
                efforts.append(one.carrier_force[part.kept])
                prior.append(force)
            Y = chain_regressor(along, chosen, part.carriers)[:, :rows]
            parts.append((E, np.concatenate(efforts, axis=1), np.concatenate(prior, axis=1), Y))
        return _Equations(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    @property
    def driven(self) -> Array:
        """(N, r) E u."""
        result: Array = np.einsum("Nrd,Nd->Nr", self.E, self.effort)
        return result

    def whitening(self, effort_noise: Array, model_noise: Array) -> Array:
        """Return (N, r, r) L⁻¹ with L Lᵀ = E Σ Eᵀ + S."""
        covariance = np.einsum("Nrd,d,Nsd->Nrs", self.E, effort_noise**2, self.E) + np.diag(model_noise**2)
        result: Array = np.linalg.inv(np.linalg.cholesky(covariance))
        return result

    def solve(self, rounds: int = _ROUNDS) -> _Solution:
        """Return the estimates of largest likelihood, by weighted least squares and variances in turns."""
        size = np.sqrt((self.driven**2 + self.prior**2).mean(axis=0)) + 1e-300
        floor = _FLOOR * size
        level = np.sqrt((self.effort**2).mean(axis=0))
        effort_noise = 0.05 * np.where(level > 0.0, level, level.max(initial=1e-300))
        model_noise = floor
        for _ in range(rounds):
            change, information, _ = self._least_squares(effort_noise, model_noise)
            rest = self.driven - self.prior - self.Y @ change
            freedom = max(rest.size - len(change), 1) / rest.size
            before = np.concatenate([effort_noise, model_noise])
            effort_noise, model_noise = self._variances(rest / np.sqrt(freedom), effort_noise, model_noise, floor)
            now = np.concatenate([effort_noise, model_noise])
            if (np.abs(now - before) <= 1e-3 * before).all():
                break
        change, information, residual = self._least_squares(effort_noise, model_noise)
        return _Solution(change, information, residual, effort_noise, model_noise)

    def _least_squares(self, effort_noise: Array, model_noise: Array) -> tuple[Array, Array, Array]:
        L = self.whitening(effort_noise, model_noise)
        A = (L @ self.Y).reshape(-1, self.Y.shape[-1])
        b = np.einsum("Nrs,Ns->Nr", L, self.driven - self.prior)
        norms = np.linalg.norm(A, axis=0)
        norms[norms == 0.0] = 1.0
        change = np.linalg.lstsq(A / norms, b.ravel(), rcond=1e-12)[0] / norms
        return change, A.T @ A, b - (A @ change).reshape(b.shape)

    def _variances(self, rest: Array, effort_noise: Array, model_noise: Array, floor: Array) -> tuple[Array, Array]:
        """Return the standard deviations of largest likelihood for residuals (N, r)."""
        from scipy.optimize import minimize

        drives = len(effort_noise)
        low = np.log(np.concatenate([1e-6 * effort_noise, floor]))
        start = np.maximum(np.log(np.concatenate([effort_noise, np.maximum(model_noise, 10.0 * floor)])), low)

        def cost(logs: Array) -> tuple[float, Array]:
            both = np.exp(logs)
            L = self.whitening(both[:drives], both[drives:])
            white = np.einsum("Nrs,Ns->Nr", L, rest)
            back = np.einsum("Nsr,Ns->Nr", L, white)
            inverse = np.einsum("Nsr,Nst->Nrt", L, L)
            value = -2.0 * np.log(np.einsum("Nrr->Nr", L)).sum() + (white**2).sum()
            pulled = np.einsum("Nr,Nrd->Nd", back, self.E)
            by_effort = np.einsum("Nrd,Nrs,Nsd->d", self.E, inverse, self.E) - (pulled**2).sum(axis=0)
            by_model = np.einsum("Nrr->r", inverse) - (back**2).sum(axis=0)
            gradient = 2.0 * both**2 * np.concatenate([by_effort, by_model])
            return float(value) / len(rest), gradient / len(rest)

        found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=[(least, None) for least in low])
        both = np.exp(found.x)
        return both[:drives], both[drives:]

    def require_motion(self, solution: _Solution, base: BaseParameters) -> None:
        """Raise InputError where the motion shows less than the machine can, and name what it does not show."""
        L = self.whitening(solution.effort_noise, solution.model_noise)
        A = (L @ self.Y).reshape(-1, len(base)) * base.sizes[base.independent]
        norms = np.linalg.norm(A, axis=0)
        names = [base.parameters[k].name for k in base.independent]
        weak = norms <= 1e-9 * norms.max(initial=0.0)
        _, values, right = np.linalg.svd(A / np.where(weak, 1.0, norms), full_matrices=False)
        for value, direction in zip(values, right, strict=True):
            if value <= _TOO_LITTLE * values[0]:
                weak = weak | (np.abs(direction) > 0.3)
        if weak.any():
            named = ", ".join(name for name, one in zip(names, weak, strict=True) if one)
            raise InputError(
                f"The motion is too little: {int(weak.sum())} of {len(base)} parameters are not determined: {named}.",
                remedy="Record faster motions all over the workspace, or leave these out of parameters=...",
                condition=float(values[0] / values[-1]) if values[-1] else np.inf,
            )

    def require_named_efforts(self, robot: Robot) -> None:
        """Raise InputError where other signs of the efforts, or another order, explain them far better.

        Opposite efforts leave the same residuals, with all parameters of the other sign: which is meant says the robot
        as declared.
        """
        drives = [*robot.actuated, *robot.carriers][: self.effort.shape[1]]
        same, keep = np.ones(len(drives)), np.arange(len(drives))
        candidates = [(same, keep)]
        for k in range(len(drives) if len(drives) > 1 else 0):
            candidates.append((np.where(keep == k, -1.0, 1.0), keep))
        for j, k in combinations(range(len(drives)), 2):
            candidates.append((same, np.where(keep == j, k, np.where(keep == k, j, keep))))
        left = [self.misfit(signs * self.effort[:, order]) for signs, order in candidates]
        best = int(np.argmin(left))
        signs, order = candidates[best] if left[best] < _BETTER * left[0] else candidates[0]
        driven = replace(self, effort=signs * self.effort[:, order]).driven
        if (driven * self.prior).sum() < -0.5 * np.linalg.norm(driven) * np.linalg.norm(self.prior):
            signs = -signs
        wrong, said = [name for name, sign in zip(drives, signs, strict=True) if sign < 0.0], []
        if (order != keep).any():
            said.append(f"The efforts of {' and '.join(drives[k] for k in np.flatnonzero(order != keep))} are swapped")
        if wrong:
            said.append(f"{'The effort' if len(wrong) == 1 else 'Efforts'} of {', '.join(wrong)}: the sign is wrong")
        if said:
            raise InputError(
                f"{'. '.join(said)}. Put right, {left[best] / left[0]:.2g} of the residual variance is left.",
                remedy="Exchange the columns, or change the signs, of the records.",
                left=left[best] / left[0],
            )

    def misfit(self, effort: Array) -> float:
        """Return the variance that a fit leaves of other efforts: the geometric mean, by likelihood; relative to any.

        Whoever compares variances of several drives with weights must estimate them again, for a drive that is wrong
        has a large one.
        """
        other = replace(self, effort=effort)
        solved = other.solve(rounds=3)
        L = other.whitening(solved.effort_noise, solved.model_noise)
        logs = -2.0 * np.log(np.einsum("Nrr->Nr", L)) + solved.residual**2
        return float(np.exp(logs.mean()))


def _require_in_time(records: list[Records], smooth: list[SmoothMotion], equations: _Equations) -> None:
    """Raise InputError where efforts that are shifted by some samples fit far better."""
    best = equations.misfit(equations.effort)
    drives = equations.effort.shape[1]
    shifts = [2, 5, 12, 25]
    left = dict[int, float]()
    for shift in [*(-k for k in shifts), *shifts]:
        parts = []
        for one, part in zip(records, smooth, strict=True):
            both = np.concatenate([one.effort, one.carrier_force], axis=1)[:, :drives]
            first, last = part.kept.start + shift, part.kept.stop + shift
            parts.append(both[np.arange(first, last).clip(0, len(one) - 1)])
        left[shift] = equations.misfit(np.concatenate(parts))
    shift = min(left, key=lambda k: left[k])
    if left[shift] < _BETTER * best:
        seconds = float(np.median(np.diff(records[0].t)) * shift)
        raise InputError(
            f"The efforts are shifted in time against the positions, by about {seconds:.3g} s: shifted back, "
            f"{left[shift] / best:.2g} of the residual variance is left.",
            remedy="Correct the times of the efforts.",
            shift=seconds,
        )
