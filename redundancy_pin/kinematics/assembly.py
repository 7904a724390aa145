"""Assembly: find configurations that close the chains, by damped Newton on many samples at once."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, IntArray
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, joint_position

_SETTLED_STEP = 1e-8
"""A Newton step this small (rad, m) leaves an error of its square: below rounding."""

_SUFFICIENT_DECREASE = 1e-4

_LONGEST_STEP = 1.0
"""Longest Newton step, rad or m: beyond it the linear model says nothing about a revolute joint."""

_TURNED_OVER = 1.0
"""Axes further apart than this (rad) at the end of Newton have closed the wrong way round, which takes π/2 or more."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """What Newton reached.

    Attributes:
        q: (N, nq) configurations.
        state: closures and Jacobians there.
        gap: (N,) largest absolute residual left, m or rad: closure rows and the distance to the target coordinates;
            where a hinge or weld is closed the wrong way round, the angle by which its axes are off.
        closed: (N,) whether the gap is below the closure tolerance.
    """

    q: Array
    state: ConstraintState
    gap: Array
    closed: BoolArray


def assemble(
    system: ConstraintSystem,
    guess: Array,
    target: Array | None = None,
    *,
    actuated: Array | None = None,
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
        max_iterations: bound on Newton iterations.
        shortest_step: fraction of a Newton step below which the line search gives up on a sample.
    """
    q = np.array(guess, dtype=float)
    everyone = np.arange(len(q))
    active, state = everyone, system.evaluate(q)
    residual = _residual(system, state, target, actuated)
    for _ in range(max_iterations):
        step = _newton_step(system, state, residual, target is not None, actuated is not None)
        goal = _rows(target, active), _rows(actuated, active)
        search = _line_search(system, q[active], step, residual, *goal, shortest_step)
        state, residual = search.state, search.residual
        q[active] = state.q
        done = search.stalled | (search.longest < _SETTLED_STEP)
        if done.all():
            break
        if 2 * done.sum() > len(done):
            active, residual = active[~done], residual[~done]
            state = system.evaluate(q[active])
    if len(active) < len(everyone):
        state = system.evaluate(q)
        residual = _residual(system, state, target, actuated)
    gap = np.abs(residual).max(axis=1, initial=0.0)
    misaligned = system.misalignment(state)
    gap = np.where(misaligned > _TURNED_OVER, np.maximum(gap, misaligned), gap)
    return Assembly(q, state, gap, gap < CLOSURE_TOLERANCE)


def integrate(model: pin.Model, q: Array, step: Array) -> Array:
    """Return q ⊕ step for (N, nq) configurations and (N, nv) tangent steps."""
    if model.nq == model.nv:
        return q + step
    return np.array([pin.integrate(model, a, b) for a, b in zip(q, step, strict=True)])


def configuration_difference(model: pin.Model, q0: Array, q1: Array) -> Array:
    """Return (N, nv) the tangent step from q0 to q1."""
    if model.nq == model.nv:
        return q1 - q0
    return np.array([pin.difference(model, a, b) for a, b in zip(q0, q1, strict=True)])


def _rows(values: Array | None, rows: IntArray) -> Array | None:
    return None if values is None else values[rows]


def _residual(system: ConstraintSystem, state: ConstraintState, target: Array | None, actuated: Array | None) -> Array:
    parts = [-state.phi]
    if target is not None:
        parts.append(difference(system.robot, target, coordinates(system.robot, state)))
    if actuated is not None:
        model = system.robot.model
        names = system.robot.actuated
        off = actuated - np.stack([joint_position(system.robot, name, state.q) for name in names], axis=1)
        endless = [model.joints[model.getJointId(name)].nq == 2 for name in names]
        off[:, endless] = (off[:, endless] + np.pi) % (2.0 * np.pi) - np.pi
        parts.append(off)
    return np.concatenate(parts, axis=1)


def _newton_step(
    system: ConstraintSystem, state: ConstraintState, residual: Array, with_target: bool, with_actuated: bool
) -> Array:
    robot = system.robot
    blocks = [state.Jc]
    if with_target:
        blocks.append(state.Jx)
    if with_actuated:
        selection = np.zeros((robot.m, robot.model.nv))
        selection[np.arange(robot.m), robot.actuated_velocity] = 1.0
        blocks.append(np.broadcast_to(selection, (len(residual), *selection.shape)))
    matrix = np.concatenate(blocks, axis=1)[:, :, system.pose_columns]
    step = np.zeros((len(residual), robot.model.nv))
    step[:, system.pose_columns] = _solve(matrix, residual)
    return step


def _solve(matrix: Array, rhs: Array) -> Array:
    if matrix.shape[1] == matrix.shape[2]:
        with contextlib.suppress(np.linalg.LinAlgError):  # an exactly singular sample spoils the whole stack
            solution = np.asarray(np.linalg.solve(matrix, rhs[:, :, None])[:, :, 0], dtype=np.float64)
            if np.isfinite(solution).all():
                return solution
    inverse = np.asarray(np.linalg.pinv(matrix, rcond=1e-10), dtype=np.float64)
    result: Array = (inverse @ rhs[:, :, None])[:, :, 0]
    return result


@dataclass(frozen=True, eq=False)
class _Search:
    state: ConstraintState
    residual: Array
    longest: Array
    stalled: BoolArray


def _line_search(
    system: ConstraintSystem,
    q: Array,
    step: Array,
    residual: Array,
    target: Array | None,
    actuated: Array | None,
    shortest_step: float,
) -> _Search:
    """Halve the step where it does not shorten the residual; a step at rounding level is taken as it is."""
    model = system.robot.model
    size = np.linalg.norm(residual, axis=1)
    longest = np.abs(step).max(axis=1, initial=0.0)
    scale = 1.0 / np.maximum(longest / _LONGEST_STEP, 1.0)
    fine = longest < _SETTLED_STEP
    while True:
        state = system.evaluate(integrate(model, q, step * scale[:, None]))
        new = _residual(system, state, target, actuated)
        ok = fine | (np.linalg.norm(new, axis=1) <= (1.0 - _SUFFICIENT_DECREASE * scale) * size)
        stalled = ~ok & (scale < shortest_step)
        if (ok | stalled).all():
            return _Search(state, new, longest * scale, stalled)
        scale = np.where(ok | stalled, scale, scale / 2.0)
