"""Assembly: closed configurations, by damped Newton on many samples at once, and the velocities the closures allow.

Velocity level: v = Γ ẋ. The matrix K stacks the constraint Jacobian over the rows of the independent velocities,
without the carrier columns: K v = (0, ẋ). Its inverse gives Γ (its last n columns) and the accelerations; it is
singular exactly where the platform velocity does not determine the joint velocities: a type I (serial) singularity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import (
    CLOSURE_TOLERANCE,
    FILE_TOLERANCE,
    RANK_TOLERANCE,
    SINGULAR_MARGIN,
    Array,
    BoolArray,
    rows_of,
)
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import coordinates, difference, in_working_mode
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import closure_tolerance, coordinate_unit, velocity_unit

SETTLED_STEP = 1e-8
"""A Newton step this small (rad, or characteristic lengths) leaves an error of its square: below rounding."""

_SUFFICIENT_DECREASE = 1e-4
"""Armijo's constant: part of the decrease that the linear model promises (Nocedal and Wright, "Numerical Optimization",
2006, section 3.1)."""

TURNED_OVER = 1.0
"""Axes further apart than this (rad) at the end of Newton have closed the wrong way round, which takes π/2 or more."""


class Projection(NamedTuple):
    """What the inverse of K says at N configurations.

    Attributes:
        gamma: (N, nv, n) tree velocity per unit of each independent velocity; carrier rows are zero. NaN at a type I
            singularity.
        margin: (N,) lower bound of the smallest singular value of K in scaled units, within a factor √p of it; 0 where
            it is below ``SINGULAR_MARGIN``: at a type I singularity.
    """

    gamma: Array
    margin: Array


@dataclass(frozen=True, eq=False)
class Assembly:
    """N configurations that Newton reached, and what proves that they may be used.

    Attributes:
        system: closures and platform rows of the robot.
        state: closures and Jacobians at the configurations.
        residual: (N,) largest absolute residual, m: closure rows and the distance to the target coordinates; where a
            hinge or weld is closed the wrong way round, the angle between its axes. Angles count times the
            characteristic length.
    """

    system: ConstraintSystem
    state: ConstraintState
    residual: Array

    @property
    def q(self) -> Array:
        """(N, nq) configurations."""
        return self.state.q

    @property
    def closed(self) -> BoolArray:
        """(N,) whether the residual is below the closure tolerance."""
        return self.residual < closure_tolerance(self.system.robot)

    @cached_property
    def projection(self) -> Projection:
        """Γ and margins."""
        return project(self.system, self.state)

    @property
    def gamma(self) -> Array:
        """(N, nv, n) velocities per unit of each independent velocity."""
        return self.projection.gamma

    @property
    def regular(self) -> BoolArray:
        """(N,) closed, and no type I singularity."""
        return self.closed & (self.projection.margin > 0.0)

    @property
    def singular(self) -> BoolArray:
        """(N,) closed, at a type I singularity."""
        singular: BoolArray = self.closed & (self.projection.margin == 0.0)
        return singular

    @cached_property
    def in_mode(self) -> BoolArray:
        """(N,) in the robot's own working mode, closed or not."""
        return in_working_mode(self.system.robot, self.q)

    @property
    def usable(self) -> BoolArray:
        """(N,) closed, regular and in the robot's own working mode."""
        return self.regular & self.in_mode


_ROUNDED = 1e-3 * CLOSURE_TOLERANCE
"""Residual that is rounding, characteristic lengths or rad: a step that does not shorten it is not halved."""

_HALVED = 0.02
"""Largest deviation from 1/2 of the ratio of two Newton steps that counts as convergence to a double root."""


def assemble(
    system: ConstraintSystem,
    guess: Array,
    target: Array | None = None,
    *,
    rank_tolerance: float | None = None,
    max_iterations: int = 50,
    shortest_step: float = 2.0**-12,
) -> Assembly:
    """Close the chains from guesses, by Newton with a backtracking line search on the residual.

    With ``target`` the independent coordinates are prescribed, without it the smallest change of the guess closes the
    loops. Steps of a rank-deficient system are of least norm. Nothing is returned silently unclosed: see ``closed`` and
    ``residual``.

    This is the damped Newton method, for starts from afar and for many poses at once. The undamped one of followers,
    ``LoopSolver.close``, closes one pose from a configuration nearby in a fifth of the time. Two hundred poses take two
    to eight times as long with it, one after another.

    Args:
        system: closures and platform rows of the robot.
        guess: (N, nq) starting configurations; carriers keep their positions.
        target: (N, n) coordinates or (N, 4, 4) poses, base frame, m and rad.
        rank_tolerance: of loops alone: rows may depend on one another, and frames may be turned far away from each
            other. Combinations of rows with smaller singular values, without unit, count as redundant. The
            configuration closes the others, and the residual says how far it misses these.
        max_iterations: bound on Newton iterations.
        shortest_step: fraction of a Newton step below which the line search gives up on a sample.

    Example:
        >>> assemble(system, np.array(robot.q_reference)[None], x[None]).closed
        array([ True])
    """
    q, robot = np.array(guess, dtype=float), system.robot
    active, taken = np.arange(len(q)), np.zeros(len(q), dtype=np.intp)
    far = rank_tolerance is not None
    residual, matrix, state = _linearise(system, q, target, far)
    end = residual.copy()
    finished = np.full(len(q), max_iterations == 0)
    step, longest, scale, size = np.zeros((len(q), robot.model.nv)), *np.ones((3, len(q)))
    begins = ~finished
    while True:
        if begins.any():
            step[begins] = _newton_step(system, matrix[begins], residual[begins], rank_tolerance)
            before = longest[begins]
            longest[begins] = np.abs(step[begins] / velocity_unit(robot)).max(axis=1, initial=0.0)
            # steps that halve lead to a double root, a leg at full stretch, which is twice as far (Rall 1966)
            double = np.abs(longest[begins] - 0.5 * before) < _HALVED * before
            # beyond 1 rad or characteristic length the linear model of a turn is useless
            scale[begins] = np.where(double, 2.0, 1.0) / np.maximum(longest[begins], 1.0)
            size[begins] = np.linalg.norm(residual[begins], axis=1)
        active, taken, step, longest, scale, size = (
            part[~finished] for part in (active, taken, step, longest, scale, size)
        )
        if not len(active):
            break
        tried = integrate(robot.model, q[active], step * scale[:, None])
        residual, matrix, new = _linearise(system, tried, None if target is None else target[active], far)
        decrease = np.linalg.norm(residual, axis=1) <= (1.0 - _SUFFICIENT_DECREASE * scale) * size
        decrease |= longest < SETTLED_STEP  # a step at rounding level is taken whole
        stalled = ~decrease & ((scale < shortest_step) | (size < _ROUNDED))
        accepted = decrease | stalled
        kept = accepted & ~stalled  # a step that no fraction of makes better is not taken
        q[active[kept]] = tried[kept]
        taken += accepted
        finished = accepted & (stalled | (longest * scale < SETTLED_STEP) | (taken >= max_iterations))
        begins = accepted & ~finished
        scale = np.where(accepted, scale, 0.5 * scale)
        if finished.any():
            if (stalled & finished).any():  # the configuration before the step is where it ends
                residual, _, new = _linearise(system, q[active], None if target is None else target[active], far)
            state.overwrite(active[finished], new, finished)
            end[active[finished]] = residual[finished]
    worst = np.abs(end).max(axis=1, initial=0.0)
    misaligned = system.misalignment(state)
    worst = np.where(misaligned > TURNED_OVER, np.maximum(worst, misaligned), worst)
    return Assembly(system, state, system.robot.characteristic_length * worst)


def closed_configurations(robot: Robot, q: ArrayLike, name: str = "q") -> Assembly:
    """Return configurations from a user, (N, nq) or (nq,), evaluated where they are.

    Args:
        robot: the robot.
        q: configurations, m and rad.
        name: what to call them in an error.

    Raises:
        InputError: wrong shape, values that are not finite, or a configuration that is not closed, or closed the wrong
            way round; carries its closure residual, m.

    Example:
        >>> closed_configurations(robot, robot.q_reference).regular
        array([ True])
    """
    given = assemble(constraint_system(robot), rows_of(q, name, ("N", robot.model.nq)), max_iterations=0)
    bad = np.flatnonzero(~given.closed)
    if len(bad):
        k, residual = int(bad[0]), float(given.residual[bad[0]])
        raise InputError(
            f"Configuration {k} of {name} is not closed: its closure residual is {residual:.3g} m ({len(bad)} of "
            f"{len(given.q)} are not closed).",
            remedy="Pass configurations of inverse_kinematics, forward_kinematics or assembly_modes.",
            sample=k,
            residual=residual,
        )
    return given


def project(system: ConstraintSystem, state: ConstraintState) -> Projection:
    """Invert K at evaluated configurations; where it has more rows than columns, which agree, by least squares."""
    robot, columns, K = system.robot, system.pose_columns, system.relative(state.K)
    overdetermined = K.shape[1] > len(columns)
    inverse = np.asarray(np.linalg.pinv(K), dtype=np.float64) if overdetermined else inverses(K)
    # 1 / σ_min is the 2-norm of the scaled inverse; the Frobenius norm bounds it within √p and needs no decomposition
    with np.errstate(over="ignore"):  # next to a singularity, where the margin is zero all the same
        size = np.sqrt(np.einsum("nij,nij->n", inverse, inverse))
    margin = np.where(size < 1.0 / SINGULAR_MARGIN, 1.0 / np.where(size > 0.0, size, np.inf), 0.0)
    gamma = np.zeros((len(inverse), robot.model.nv, robot.n))
    gamma[:, columns] = inverse[:, :, len(system.rows) :] * (system.step_unit[:, None] / coordinate_unit(robot))
    gamma[np.ix_(margin == 0.0, columns)] = np.nan
    return Projection(gamma, margin)


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


def _linearise(
    system: ConstraintSystem, q: Array, target: Array | None, far: bool
) -> tuple[Array, Array, ConstraintState]:
    """Return what Newton's method solves at configurations (N, nq), and the configurations evaluated.

    The residuals (N, e) are what is missing to the goal, the matrix (N, e, p) their negative derivatives by the pose
    columns, both without units; ``far``: angles in place of sines, where frames are turned far away from each other.
    """
    state = system.evaluate(q)
    if target is not None:
        off = difference(system.robot, target, coordinates(system.robot, state))
        residual, rows = np.concatenate([-state.phi, off], axis=1), state.K
    else:
        phi, jacobian = system.rotation_rows(state) if far else (state.phi, state.Jc)
        residual, rows = -phi, jacobian[:, :, system.pose_columns]
    return residual / system.equation_unit[: residual.shape[1]], system.relative(rows), state


def _newton_step(system: ConstraintSystem, matrix: Array, residual: Array, rank_tolerance: float | None) -> Array:
    """Return (N, nv) steps, rad and m; carriers stay. With a tolerance, smaller singular values count as zero."""
    step = np.zeros((len(residual), system.robot.model.nv))
    if rank_tolerance is None:
        solution = _solve(matrix, residual)
    else:
        left, values, right = np.linalg.svd(matrix, full_matrices=False)
        count = values > smallest_independent(values.max(axis=1, initial=0.0, keepdims=True), rank_tolerance)
        parts = np.einsum("ner,ne->nr", left, residual) * count / np.where(count, values, 1.0)
        solution = np.einsum("nrp,nr->np", right, parts)
    step[:, system.pose_columns] = solution * system.step_unit
    return step


def smallest_independent(largest: Array, tolerance: float) -> Array:
    """Return below which size combinations of rows, rad or characteristic lengths, count as redundant.

    Args:
        largest: (...) size of the largest of them. Where all are contradictions of a file (a door on two hinges whose
            axes coincide except for rounding), all are redundant.
        tolerance: relative to the largest, where that is smaller than 1.
    """
    return np.where(largest > min(tolerance, FILE_TOLERANCE), tolerance * np.minimum(largest, 1.0), np.inf)


def _solve(matrix: Array, rhs: Array) -> Array:
    """Return (N, p) the solutions of square regular systems, and those of least norm of all others."""
    solution = np.full((len(rhs), matrix.shape[2]), np.nan)
    if matrix.shape[1] == matrix.shape[2]:
        solution = _unless_singular(np.linalg.solve, matrix, rhs[:, :, None])[:, :, 0]
    rest = ~np.isfinite(solution).all(axis=1)
    if rest.any():
        solution[rest] = np.einsum("nvr,nr->nv", np.linalg.pinv(matrix[rest], rcond=RANK_TOLERANCE), rhs[rest])
    return solution


def inverses(matrices: Array) -> Array:
    """Return stacked inverses, NaN where a matrix is exactly singular."""
    return _unless_singular(np.linalg.inv, matrices)


def _unless_singular(operation: Callable[..., Array], *stacks: Array) -> Array:
    """Return what an operation of LAPACK makes of stacks, the first of matrices; NaN where one is exactly singular."""
    try:
        return np.asarray(operation(*stacks), dtype=np.float64)
    except np.linalg.LinAlgError:  # LAPACK gives up on the whole stack for one
        regular = np.linalg.slogdet(stacks[0])[0] != 0.0
        result = np.full(stacks[-1].shape, np.nan)
        result[regular] = operation(*(stack[regular] for stack in stacks))
        return result
