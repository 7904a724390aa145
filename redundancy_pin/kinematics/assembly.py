"""Assembly: closed configurations, by damped Newton on many samples at once, and the velocities the closures allow.

Velocity level: v = Γ ẋ. The matrix K stacks the constraint Jacobian over the rows of the independent velocities,
without the carrier columns: K v = (0, ẋ). Its inverse gives Γ (its last n columns) and the accelerations; it is
singular exactly where the platform velocity does not determine the joint velocities: a type I (serial) singularity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

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
    IntArray,
    rows_of,
)
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.closure import RESTORED, ConstraintState, ConstraintSystem, constraint_system
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


@dataclass(frozen=True, eq=False)
class Assembly:
    """N configurations, and what proves that they may be used; made by ``assemble`` and ``evaluated``.

    Grids, random starts and the singularities of many configurations take these. One configuration at a time is a
    ``ClosedState``.

    Attributes:
        system: closures and platform rows of the robot.
        state: closures and Jacobians at the configurations.
        K: (N, r + n, p) K without units. Combinations of all closure rows take the place of independent ones that lose
            rank, if they keep it.
        residual: (N,) largest absolute residual, m: of independent rows, or of these combinations beyond the rounding
            of a file, of dependent rows beyond it, and the distance to the target coordinates; where a hinge or weld is
            closed the wrong way round, the angle between its axes. Angles count times the characteristic length.
    """

    system: ConstraintSystem
    state: ConstraintState
    K: Array
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
    def _inverse(self) -> Array:
        """(N, p, r + n) K⁻¹ without units; where K has more rows than columns, which agree, by least squares."""
        return inverses(self.K)

    @cached_property
    def margin(self) -> Array:
        """(N,) lower bound of the smallest singular value of K without units, within a factor √p of it.

        It is 0 below ``SINGULAR_MARGIN``: at a type I singularity.
        """
        # 1 / σ_min is the 2-norm of the scaled inverse; the Frobenius norm bounds it within √p, without decomposition
        with np.errstate(over="ignore"):  # next to a singularity, where the margin is zero all the same
            size = np.sqrt(np.einsum("nij,nij->n", self._inverse, self._inverse))
        return np.where(size < 1.0 / SINGULAR_MARGIN, 1.0 / np.where(size > 0.0, size, np.inf), 0.0)

    @cached_property
    def gamma(self) -> Array:
        """(N, nv, n) Γ: velocity of the tree per unit of each independent velocity, NaN at a type I singularity."""
        system, robot = self.system, self.system.robot
        gamma = np.zeros((len(self.q), robot.model.nv, robot.n))
        unit = system.step_unit[:, None] / coordinate_unit(robot)
        gamma[:, system.pose_columns] = self._inverse[:, :, len(system.rows) :] * unit
        gamma[np.ix_(self.margin == 0.0, system.pose_columns)] = np.nan
        return gamma

    @property
    def regular(self) -> BoolArray:
        """(N,) closed, and no type I singularity."""
        return self.closed & (self.margin > 0.0)

    @property
    def singular(self) -> BoolArray:
        """(N,) closed, at a type I singularity."""
        singular: BoolArray = self.closed & (self.margin == 0.0)
        return singular

    @cached_property
    def in_mode(self) -> BoolArray:
        """(N,) in the robot's own working mode, closed or not."""
        return in_working_mode(self.system.robot, self.q)

    @property
    def usable(self) -> BoolArray:
        """(N,) closed, regular and in the robot's own working mode."""
        return self.regular & self.in_mode


ROUNDED_RESIDUAL = 1e-3 * CLOSURE_TOLERANCE
"""Residual that is rounding, characteristic lengths or rad: a step that does not shorten it is not halved. So is a
Newton step ten times as long."""

_HALVED = 0.02
"""Largest deviation from 1/2 of the ratio of two Newton steps that counts as convergence to a double root."""


def assemble(
    system: ConstraintSystem,
    guess: Array,
    target: Array | None = None,
    *,
    rank_tolerance: float = RANK_TOLERANCE,
    max_iterations: int = 50,
    shortest_step: float = 2.0**-12,
) -> Assembly:
    """Close the chains from guesses, by Newton with a backtracking line search on the residual.

    With ``target`` the independent coordinates are prescribed. Without it the smallest change of the guess closes the
    loops: rows may depend on one another, and frames may be turned far away from each other. Steps of a rank-deficient
    system are of least norm. Nothing is returned silently unclosed: see ``closed`` and ``residual``.

    Args:
        system: closures and platform rows of the robot.
        guess: (N, nq) starting configurations; carriers keep their positions.
        target: (N, n) coordinates or (N, 4, 4) poses, base frame, m and rad.
        rank_tolerance: as of ``newton``, without a target. The configuration closes the independent combinations of
            rows, and the residual is its distance from the others.
        max_iterations: as of ``newton``.
        shortest_step: as of ``newton``.

    Example:
        >>> assemble(system, np.array(robot.q_reference)[None], x[None]).closed
        array([ True])
    """

    def linearise(q: Array, samples: IntArray) -> tuple[Array, Array]:
        return _equations(system, system.evaluate(q), None if target is None else target[samples])

    q = newton(
        system,
        linearise,
        guess,
        rank_tolerance=rank_tolerance if target is None else None,
        max_iterations=max_iterations,
        shortest_step=shortest_step,
    )
    return evaluated(system, q, target)


def evaluated(system: ConstraintSystem, q: Array, target: Array | None = None) -> Assembly:
    """Return configurations (N, nq) as they are; arguments as of ``assemble``.

    Example:
        >>> evaluated(system, np.array(robot.q_reference)[None]).margin
    """
    state, r = system.evaluate(q), len(system.rows)
    missing, K, left_open = _equations(system, state, target)[0], system.relative(state.K), np.zeros(len(q))
    if system.has_dependent_rows:
        whole = system.every.evaluate(q)
        rows, phi, least = system.combined_rows(whole)
        own = np.linalg.svd(K[:, :r], compute_uv=False).min(axis=1, initial=np.inf)
        restored = least > np.maximum(RESTORED * own, FILE_TOLERANCE)
        K[restored, :r] = rows[restored]
        # rows of rounded numbers contradict each other: closed in either is closed, and combinations of neighbouring
        # poses, which a follower closes, are as far off as the rows contradict
        phi[np.abs(phi) <= system.robot.dependent_residual] = 0.0
        closer = restored & (np.abs(phi).max(axis=1, initial=0.0) < np.abs(missing[:, :r]).max(axis=1, initial=0.0))
        missing[closer, :r] = phi[closer]
        left_open = system.beyond_rounding(whole.phi)
    worst, misaligned = np.abs(missing).max(axis=1, initial=0.0), system.misalignment(state)
    worst = np.where(misaligned > TURNED_OVER, np.maximum(worst, misaligned), worst)
    return Assembly(system, state, K, np.maximum(system.robot.characteristic_length * worst, left_open))


def newton(
    system: ConstraintSystem,
    linearise: Callable[[Array, IntArray], tuple[Array, Array]],
    guess: Array,
    *,
    rank_tolerance: float | None = None,
    max_iterations: int = 50,
    shortest_step: float = 2.0**-12,
) -> Array:
    """Return the configurations (N, nq) at which Newton's method with a backtracking line search ends.

    This is the damped method, for starts from afar and for many samples at once. The undamped one of followers,
    ``LoopSolver.close``, is a separate loop, because neither serves the other's purpose: one pose nearby takes 0.2 to
    0.3 ms with it and 0.8 to 1.4 ms here, of two hundred poses each takes 25 µs (five-bar) to 140 µs (Gough platform)
    here and 0.2 to 0.3 ms there.

    Args:
        system: closures of the robot; it selects the velocities that move.
        linearise: of configurations (M, nq), and their numbers (M,) among the samples, the distance to the goal
            (M, e) and its negative derivatives by the pose columns (M, e, p), both without units.
        guess: (N, nq) starting configurations; carriers keep their positions.
        rank_tolerance: combinations of equations with smaller singular values count as redundant. Steps are of least
            norm. If left out, regular square systems are solved directly.
        max_iterations: bound on Newton iterations.
        shortest_step: fraction of a Newton step below which the line search gives up on a sample.
    """
    q, robot = np.array(guess, dtype=float), system.robot
    active, taken = np.arange(len(q)), np.zeros(len(q), dtype=np.intp)
    residual, matrix = linearise(q, active)
    begins = np.ones(len(q), dtype=bool)
    step, longest, scale, size = np.zeros((len(q), robot.model.nv)), *np.ones((3, len(q)))
    while len(active):
        if begins.any():
            step[begins] = _newton_step(system, matrix[begins], residual[begins], rank_tolerance)
            before = longest[begins]
            longest[begins] = np.abs(step[begins] / velocity_unit(robot)).max(axis=1, initial=0.0)
            # steps that halve lead to a double root, a leg at full stretch, which is twice as far (Rall 1966)
            double = np.abs(longest[begins] - 0.5 * before) < _HALVED * before
            # beyond 1 rad or characteristic length the linear model of a turn is useless
            scale[begins] = np.where(double, 2.0, 1.0) / np.maximum(longest[begins], 1.0)
            size[begins] = np.linalg.norm(residual[begins], axis=1)
        tried = integrate(robot.model, q[active], step * scale[:, None])
        residual, matrix = linearise(tried, active)
        decrease = np.linalg.norm(residual, axis=1) <= (1.0 - _SUFFICIENT_DECREASE * scale) * size
        decrease |= longest < SETTLED_STEP  # a step at rounding level is taken whole
        stalled = ~decrease & ((scale < shortest_step) | (size < ROUNDED_RESIDUAL))
        accepted = decrease | stalled
        kept = accepted & ~stalled  # a step that no fraction of makes better is not taken
        q[active[kept]] = tried[kept]
        taken += accepted
        finished = accepted & (stalled | (longest * scale < SETTLED_STEP) | (taken >= max_iterations))
        begins = accepted & ~finished
        scale = np.where(accepted, scale, 0.5 * scale)
        if finished.any():
            parts = (active, taken, residual, matrix, begins, step, longest, scale, size)
            active, taken, residual, matrix, begins, step, longest, scale, size = (part[~finished] for part in parts)
    return q


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
    given = evaluated(constraint_system(robot), rows_of(q, name, ("N", robot.model.nq)))
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


def _equations(system: ConstraintSystem, state: ConstraintState, target: Array | None) -> tuple[Array, Array]:
    """Return the residual of closed loops, and of a target (N, n), as ``newton`` takes it."""
    if target is not None:
        off = difference(system.robot, target, coordinates(system.robot, state))
        residual, rows = np.concatenate([-state.phi, off], axis=1), state.K
    else:
        phi, jacobian = system.rotation_rows(state)
        residual, rows = -phi, jacobian[:, :, system.pose_columns]
    return residual / system.equation_unit[: residual.shape[1]], system.relative(rows)


def _newton_step(system: ConstraintSystem, matrix: Array, residual: Array, rank_tolerance: float | None) -> Array:
    """Return (N, nv) steps, rad and m; carriers stay."""
    solution = np.full((len(residual), len(system.pose_columns)), np.nan)
    if rank_tolerance is None and matrix.shape[1] == matrix.shape[2]:
        solution = _unless_singular(np.linalg.solve, matrix, residual[:, :, None])[:, :, 0]
    rest = ~np.isfinite(solution).all(axis=1)
    if rest.any():
        left, values, right = np.linalg.svd(matrix[rest], full_matrices=False)
        least = smallest_independent(values.max(axis=1, initial=0.0, keepdims=True), rank_tolerance or RANK_TOLERANCE)
        count = values > least
        parts = np.einsum("ner,ne->nr", left, residual[rest]) * count / np.where(count, values, 1.0)
        solution[rest] = np.einsum("nrp,nr->np", right, parts)
    step = np.zeros((len(residual), system.robot.model.nv))
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


def inverses(matrices: Array) -> Array:
    """Return stacked inverses, NaN where a matrix is exactly singular; of more rows than columns, by least squares."""
    if matrices.shape[-2] > matrices.shape[-1]:
        return np.asarray(np.linalg.pinv(matrices), dtype=np.float64)
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
