"""Assembly: closed configurations, by damped Newton on many samples at once, and the velocities the closures allow.

Velocity level: v = Γ ẋ. The matrix K stacks the constraint Jacobian over the rows of the independent velocities,
without the carrier columns: K v = (0, ẋ). Its inverse gives Γ (its last n columns) and the accelerations; it is
singular exactly where the platform velocity does not determine the joint velocities: a type I (serial) singularity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, RANK_TOLERANCE, Array, BoolArray
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, in_working_mode
from redundancy_pin.robot.scales import closure_tolerance, velocity_unit

SETTLED_STEP = 1e-8
"""A Newton step this small (rad, or characteristic lengths) leaves an error of its square: below rounding."""

_SUFFICIENT_DECREASE = 1e-4
"""Armijo's constant: part of the decrease that the linear model promises (Nocedal and Wright, "Numerical Optimization",
2006, section 3.1)."""

TURNED_OVER = 1.0
"""Axes further apart than this (rad) at the end of Newton have closed the wrong way round, which takes π/2 or more."""

SINGULAR_MARGIN = float(np.sqrt(2.0 * CLOSURE_TOLERANCE))
"""Scaled margin below which a pose counts as a type I singularity. At a stretched leg two configurations meet in a
square root: one that is closed to within the tolerance is known no better than this."""


@dataclass(frozen=True, eq=False)
class Projection:
    """The inverse of K at N configurations.

    Attributes:
        inverse: (N, p, r + n) inverse of K; p = r + n pose velocities. NaN at a type I singularity.
        gamma: (N, nv, n) tree velocity per unit of each independent velocity; carrier rows are zero.
        margin: (N,) lower bound of the smallest singular value of K in scaled units, within a factor √p of it; 0 where
            it is below ``SINGULAR_MARGIN``: at a type I singularity.
    """

    inverse: Array
    gamma: Array
    margin: Array


@dataclass(frozen=True, eq=False)
class Assembly:
    """N configurations that Newton reached, and what proves that they may be used.

    Attributes:
        system: closures and platform rows of the robot.
        state: closures and Jacobians at the configurations.
        gap: (N,) largest absolute residual, m: closure rows and the distance to the target coordinates; where a hinge
            or weld is closed the wrong way round, the angle between its axes. Angles count times the characteristic
            length.
    """

    system: ConstraintSystem
    state: ConstraintState
    gap: Array

    @property
    def q(self) -> Array:
        """(N, nq) configurations."""
        return self.state.q

    @property
    def closed(self) -> BoolArray:
        """(N,) whether the gap is below the closure tolerance."""
        return self.gap < closure_tolerance(self.system.robot)

    @cached_property
    def projection(self) -> Projection:
        """The inverse of K."""
        return project(self.system, self.state)

    @property
    def gamma(self) -> Array:
        """(N, nv, n) velocities per unit of each independent velocity."""
        return self.projection.gamma

    @property
    def regular(self) -> BoolArray:
        """(N,) closed, and no type I singularity."""
        return self.closed & (self.projection.margin > 0.0)

    @cached_property
    def in_mode(self) -> BoolArray:
        """(N,) in the robot's own working mode, closed or not."""
        return in_working_mode(self.system.robot, self.q)

    @property
    def usable(self) -> BoolArray:
        """(N,) closed, regular and in the robot's own working mode."""
        return self.regular & self.in_mode


def assemble(
    system: ConstraintSystem,
    guess: Array,
    target: Array | None = None,
    *,
    redundant: bool = False,
    max_iterations: int = 50,
    shortest_step: float = 2.0**-12,
) -> Assembly:
    """Close the chains from guesses, by Newton with a backtracking line search on the residual.

    With ``target`` the independent coordinates are prescribed, without it the smallest change of the guess closes the
    loops. Steps of a rank-deficient system are of least norm. Nothing is returned silently unclosed: see ``closed`` and
    ``gap``.

    Args:
        system: closures and platform rows of the robot.
        guess: (N, nq) starting configurations; carriers keep their positions.
        target: (N, n) coordinates or (N, 4, 4) poses, base frame, m and rad.
        redundant: of loops alone: rows may depend on one another, and frames may be turned far away from each other.
        max_iterations: bound on Newton iterations.
        shortest_step: fraction of a Newton step below which the line search gives up on a sample.

    Example:
        >>> assemble(system, np.array(robot.q_reference)[None], x[None]).closed
        array([ True])
    """
    q = np.array(guess, dtype=float)
    active, done = np.arange(len(q)), np.zeros(len(q), dtype=bool)
    equations = everything = _Equations(system, target, redundant)
    here = equations.at(q)
    for _ in range(max_iterations):
        step = here.newton_step(redundant)
        step[done] = 0.0  # a sample ends where it would end alone, whatever the others need
        here, longest, stalled = _line_search(equations, here, step, shortest_step)
        q[active] = here.state.q
        done |= stalled | (longest < SETTLED_STEP)
        if done.all():
            break
        if 2 * done.sum() > len(done):  # go on with the rest alone; to leave out fewer costs more than it saves
            active, done = active[~done], done[~done]
            equations = _Equations(system, None if target is None else target[active], redundant)
            here = equations.at(q[active])
    if len(active) < len(q):
        here = everything.at(q)
    gap = np.abs(here.residual).max(axis=1, initial=0.0)
    misaligned = system.misalignment(here.state)
    gap = np.where(misaligned > TURNED_OVER, np.maximum(gap, misaligned), gap)
    return Assembly(system, here.state, system.robot.characteristic_length * gap)


def project(system: ConstraintSystem, state: ConstraintState) -> Projection:
    """Invert K at evaluated configurations; where it has more rows than columns, which agree, by least squares."""
    robot, columns, K = system.robot, system.pose_columns, system.relative(state.K)
    overdetermined = K.shape[1] > len(columns)
    inverse = np.asarray(np.linalg.pinv(K), dtype=np.float64) if overdetermined else inverses(K)
    # 1 / σ_min is the 2-norm of the scaled inverse; the Frobenius norm bounds it within √p and needs no decomposition
    with np.errstate(over="ignore"):  # next to a singularity, where the margin is zero all the same
        size = np.sqrt(np.einsum("nij,nij->n", inverse, inverse))
    inverse *= system.step_unit[:, None] / system.equation_unit
    margin = np.where(size < 1.0 / SINGULAR_MARGIN, 1.0 / np.where(size > 0.0, size, np.inf), 0.0)
    inverse[margin == 0.0] = np.nan
    gamma = np.zeros((len(inverse), robot.model.nv, robot.n))
    gamma[:, columns] = inverse[:, :, len(system.rows) :]
    return Projection(inverse, gamma, margin)


def integrate(model: pin.Model, q: Array, step: Array) -> Array:
    """Return q ⊕ step for (N, nq) configurations and (N, nv) tangent steps."""
    if model.nq == model.nv:
        return q + step
    return np.array([pin.integrate(model, a, b) for a, b in zip(q, step, strict=True)]).reshape(len(q), model.nq)


def configuration_difference(model: pin.Model, q0: Array, q1: Array) -> Array:
    """Return (N, nv) the tangent step from q0 to q1."""
    if model.nq == model.nv:
        return q1 - q0
    return np.array([pin.difference(model, a, b) for a, b in zip(q0, q1, strict=True)]).reshape(len(q0), model.nv)


class _Linear(NamedTuple):
    """Equations linearised at N configurations.

    Attributes:
        system: closures and platform rows.
        state: the configurations.
        residual: (N, e) what is missing to the goal, in characteristic lengths and rad.
        matrix: (N, e, p) its negative derivative by the pose columns, without units.
    """

    system: ConstraintSystem
    state: ConstraintState
    residual: Array
    matrix: Array

    def newton_step(self, redundant: bool) -> Array:
        """Return (N, nv) steps, rad and m; carriers stay."""
        step = np.zeros((len(self.residual), self.system.robot.model.nv))
        solution = _solve(self.matrix, self.residual, regular=not redundant)
        step[:, self.system.pose_columns] = solution * self.system.step_unit
        return step


class _Equations(NamedTuple):
    """What Newton solves: the closures and, where prescribed, the coordinates (N, n) or poses (N, 4, 4)."""

    system: ConstraintSystem
    target: Array | None
    redundant: bool

    def at(self, q: Array) -> _Linear:
        """Linearise the equations at configurations (N, nq)."""
        system = self.system
        state, unit = system.evaluate(q), system.equation_unit
        if self.target is not None:
            off = difference(system.robot, self.target, coordinates(system.robot, state))
            residual, rows = np.concatenate([-state.phi, off], axis=1), state.K
        else:
            phi, jacobian = system.rotation_rows(state) if self.redundant else (state.phi, state.Jc)
            residual, rows, unit = -phi, jacobian[:, :, system.pose_columns], system.closure_unit
        return _Linear(system, state, residual / unit, rows * (system.step_unit / unit[:, None]))


def _line_search(
    equations: _Equations, here: _Linear, step: Array, shortest_step: float
) -> tuple[_Linear, Array, BoolArray]:
    """Halve the step where it does not shorten the residual; a step at rounding level is taken whole.

    No joint moves by more than 1 rad or characteristic length: beyond that the linear model of a turn is useless.

    Returns:
        The equations where it ends, the longest movement of a joint (N,), rad or characteristic lengths, and which
        samples stalled.
    """
    robot, size = equations.system.robot, np.linalg.norm(here.residual, axis=1)
    longest = np.abs(step / velocity_unit(robot)).max(axis=1, initial=0.0)
    scale = 1.0 / np.maximum(longest, 1.0)
    fine = longest < SETTLED_STEP
    while True:
        new = equations.at(integrate(robot.model, here.state.q, step * scale[:, None]))
        ok = fine | (np.linalg.norm(new.residual, axis=1) <= (1.0 - _SUFFICIENT_DECREASE * scale) * size)
        stalled = ~ok & (scale < shortest_step)
        if (ok | stalled).all():
            return new, longest * scale, stalled
        scale = np.where(ok | stalled, scale, scale / 2.0)


def _solve(matrix: Array, rhs: Array, *, regular: bool) -> Array:
    """Return (N, p) the solutions of square regular systems, and those of least norm of all others."""
    solution = np.full((len(rhs), matrix.shape[2]), np.nan)
    if regular and matrix.shape[1] == matrix.shape[2]:
        solution = np.einsum("nvr,nr->nv", inverses(matrix), rhs)
    rest = ~np.isfinite(solution).all(axis=1)
    if rest.any():
        solution[rest] = np.einsum("nvr,nr->nv", np.linalg.pinv(matrix[rest], rcond=RANK_TOLERANCE), rhs[rest])
    return solution


def inverses(matrices: Array) -> Array:
    """Return stacked inverses, NaN where a matrix is exactly singular."""
    try:
        return np.asarray(np.linalg.inv(matrices), dtype=np.float64)
    except np.linalg.LinAlgError:  # LAPACK gives up on the whole stack for one
        singular = np.linalg.slogdet(matrices)[0] == 0.0
        result = np.full(matrices.shape, np.nan)
        result[~singular] = np.linalg.inv(matrices[~singular])
        return result
