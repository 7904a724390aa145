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

from redundancy_pin.arrays import CLOSURE_TOLERANCE, RANK_TOLERANCE, Array, BoolArray, read_only
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, in_working_mode, joint_position
from redundancy_pin.robot.joint_ranges import out_of_range
from redundancy_pin.robot.lookup import find_joint
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

    @cached_property
    def in_range(self) -> BoolArray:
        """(N,) all joints within their ranges, each configuration by itself, closed or not."""
        return read_only(~out_of_range(self.system.robot, self.q, motion=False))

    @property
    def usable(self) -> BoolArray:
        """(N,) closed, regular and in the robot's own working mode."""
        return self.regular & self.in_mode


def assemble(
    system: ConstraintSystem,
    guess: Array,
    target: Array | None = None,
    *,
    actuated: Array | None = None,
    redundant: bool = False,
    max_iterations: int = 50,
    shortest_step: float = 2.0**-12,
) -> Assembly:
    """Close the chains from a guess, by Newton with a backtracking line search on the residual.

    With ``target`` the independent coordinates are prescribed (inverse displacement), with ``actuated`` the main
    actuators (forward displacement), with neither the smallest change of the guess closes the loops. Steps of a
    rank-deficient system are minimum-norm. Nothing is returned silently unclosed: see ``closed`` and ``gap``.

    Args:
        system: closures and platform rows of the robot.
        guess: (N, nq) starting configurations; carriers keep their positions.
        target: (N, n) coordinates or (N, 4, 4) poses, base frame, m and rad.
        actuated: (N, m) positions of the main actuators, m or rad.
        redundant: closure rows may depend on one another: steps are of least norm in scaled units.
        max_iterations: bound on Newton iterations.
        shortest_step: fraction of a Newton step below which the line search gives up on a sample.
    """
    everything = equations = _Equations(system, target, actuated, redundant)
    q = np.array(guess, dtype=float)
    active, state = np.arange(len(q)), system.evaluate(q)
    residual = equations.residual(state)
    done = np.zeros(len(q), dtype=bool)
    for _ in range(max_iterations):
        step = equations.newton_step(state, residual)
        step[done] = 0.0  # a sample ends where it would end alone, whatever the others need
        reached = _line_search(equations, q[active], step, residual, shortest_step)
        state, residual = reached.state, reached.residual
        q[active] = state.q
        done |= reached.stalled | (reached.longest < SETTLED_STEP)
        if done.all():
            break
        if 2 * done.sum() > len(done):  # go on with the rest alone; to leave out fewer costs more than it saves
            active, residual = active[~done], residual[~done]
            ends, positions = (None if goal is None else goal[active] for goal in (target, actuated))
            equations = _Equations(system, ends, positions, redundant)
            state, done = system.evaluate(q[active]), done[~done]
    if len(active) < len(q):
        state = system.evaluate(q)
        residual = everything.residual(state)
    gap = system.gap(residual, everything.unit)
    misaligned = system.misalignment(state)
    gap = np.where(misaligned > TURNED_OVER, np.maximum(gap, system.robot.characteristic_length * misaligned), gap)
    return Assembly(system, state, gap)


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


@dataclass(frozen=True, eq=False)
class _Equations:
    """What Newton solves: the closures and, where prescribed, the coordinates and the actuators' positions."""

    system: ConstraintSystem
    target: Array | None
    actuated: Array | None
    redundant: bool

    @cached_property
    def unit(self) -> Array:
        """(e,) the characteristic length, m, for residuals that are lengths, 1 for angles."""
        system = self.system
        parts = [system.closure_unit if self.target is None else system.equation_unit]
        if self.actuated is not None:
            parts.append(velocity_unit(system.robot)[system.robot.actuated_velocity])
        return np.concatenate(parts)

    def residual(self, state: ConstraintState) -> Array:
        """Return (N, e) what is missing to the goal, m and rad."""
        robot = self.system.robot
        parts = [-state.phi]
        if self.target is not None:
            parts.append(difference(robot, self.target, coordinates(robot, state)))
        if self.actuated is not None:
            off = self.actuated - np.stack([joint_position(robot, name, state.q) for name in robot.actuated], axis=1)
            # a continuous joint takes the shorter arc: its positions a turn apart are one
            endless = [find_joint(robot.model, name).nq == 2 for name in robot.actuated]
            off[:, endless] = (off[:, endless] + np.pi) % (2.0 * np.pi) - np.pi
            parts.append(off)
        return np.concatenate(parts, axis=1)

    def newton_step(self, state: ConstraintState, residual: Array) -> Array:
        """Return (N, nv) the steps; carriers stay."""
        robot, columns = self.system.robot, self.system.pose_columns
        matrix = state.K if self.target is not None else state.Jc[:, :, columns]
        if self.actuated is not None:
            selection = np.broadcast_to(self.system.selection[:, columns], (len(residual), robot.m, len(columns)))
            matrix = np.concatenate([matrix, selection], axis=1)
        step = np.zeros((len(residual), robot.model.nv))
        unit, matrix = self.system.step_unit, matrix * (self.system.step_unit / self.unit[:, None])
        step[:, columns] = _solve(matrix, residual / self.unit, regular=not self.redundant) * unit
        return step


class _Reached(NamedTuple):
    state: ConstraintState
    residual: Array
    longest: Array
    stalled: BoolArray


def _line_search(equations: _Equations, q: Array, step: Array, residual: Array, shortest_step: float) -> _Reached:
    """Halve the step where it does not shorten the residual; a step at rounding level is taken whole.

    No joint moves by more than 1 rad or characteristic length: beyond that the linear model of a turn is useless.
    """
    system = equations.system
    size = np.linalg.norm(residual / equations.unit, axis=1)
    longest = np.abs(step / velocity_unit(system.robot)).max(axis=1, initial=0.0)
    scale = 1.0 / np.maximum(longest, 1.0)
    fine = longest < SETTLED_STEP
    while True:
        state = system.evaluate(integrate(system.robot.model, q, step * scale[:, None]))
        new = equations.residual(state)
        ok = fine | (np.linalg.norm(new / equations.unit, axis=1) <= (1.0 - _SUFFICIENT_DECREASE * scale) * size)
        stalled = ~ok & (scale < shortest_step)
        if (ok | stalled).all():
            return _Reached(state, new, longest * scale, stalled)
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
