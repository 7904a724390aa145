"""Close loops from afar, with rows that may be redundant: where files put their joints says little of where they meet.

Newton's method on the rows ends at the wrong side of a hinge or a weld whose frames start turned away, as rotation rows
are sines. Levenberg–Marquardt's on angles, the rotation vector between the frames, leads to the right side; Newton ends
it.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.assembly import assemble, integrate
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.multistart import SEED, draw_starts
from redundancy_pin.kinematics.tree import frame_placement
from redundancy_pin.robot import AXES, Closure, Robot
from redundancy_pin.robot.lookup import find_link_index

_SPREADS = np.linspace(0.2, 1.5, 30)
"""rad or characteristic lengths: how far further starts are away, up to a quarter turn."""

_STEPS = 100
"""Most steps of either method: half a turn takes Levenberg–Marquardt's seven, where nothing is in the way. Newton's
converges linearly where redundant rows lose rank."""

_NEAR = 1e-3
"""Characteristic lengths or rad: the residual from which Newton goes on, which converges from ten times that."""

_LONGEST = 0.5
"""rad or characteristic lengths: the longest step of a joint, of which the linear model is right to an eighth."""

_NO_GAIN = 1e-5
"""Least relative decrease of the residual per step: slower, the method is at a minimum that is open."""


def closed_near(robot: Robot, q: Array, tolerance: float = CLOSURE_TOLERANCE) -> Array:
    """Return the closed configuration (nq,) that the smallest changes of q lead to.

    Args:
        robot: its closure rows may be redundant.
        q: (nq,) where to begin.
        tolerance: largest closure residual, in characteristic lengths; larger where redundant rows agree except for
            rounding.

    Raises:
        DeclarationError: the loops do not close from there; carries the smallest residual, m.

    Example:
        >>> q = closed_near(robot, pin.neutral(robot.model))
    """
    system, rng = ConstraintSystem(robot), np.random.default_rng(SEED)
    tolerance *= robot.characteristic_length
    closed, best = close(system, q)
    if best < tolerance:
        return closed
    for spread in (0.0, *_SPREADS):
        near, _, size = brought_near(system, draw_starts(system, q, 1, rng, turn=spread, slide=spread)[0])
        best = min(best, size)
        if size < _NEAR * robot.characteristic_length:
            closed, gap = close(system, near)
            if gap < tolerance:
                return closed
            best = min(best, gap)
    raise DeclarationError(
        f"The loops of {robot.name} do not close near the reference: the closure residual is {best:.3g} m.",
        remedy="Name a reference that is nearer to a closed configuration, or correct the closures.",
        gap=best,
    )


def close(system: ConstraintSystem, q: Array) -> tuple[Array, float]:
    """Return what Newton's method reaches from q (nq,) where rows may be redundant, and the closure residual, m."""
    reached = assemble(system, q[None], redundant=True, max_iterations=_STEPS)
    closed: Array = reached.q[0]
    return closed, float(reached.gap[0])


def brought_near(system: ConstraintSystem, q: Array) -> tuple[Array, int, float]:
    """Return what Levenberg–Marquardt's method reaches from q (nq,), its number of steps, and the residual, m."""
    model, columns, weight, unit = system.robot.model, system.pose_columns, 1.0 / system.closure_unit, system.step_unit
    state, damping, count = system.evaluate(q[None]), 1e-2, 0
    error, rows = _angles(system, state)
    size = float(np.linalg.norm(weight * error))
    while size > _NEAR and count < _STEPS and damping < 1e6:
        count += 1
        matrix = weight[:, None] * rows[:, columns] * unit
        normal = matrix.T @ matrix
        normal += (damping * float(np.trace(normal)) / len(normal) + np.finfo(float).tiny) * np.eye(len(normal))
        step = np.zeros((1, model.nv))
        change = -np.linalg.solve(normal, matrix.T @ (weight * error))
        change *= min(1.0, _LONGEST / max(float(np.abs(change).max()), np.finfo(float).tiny))
        step[0, columns] = change * unit
        tried = system.evaluate(integrate(model, state.q, step))
        new, new_rows = _angles(system, tried)
        new_size = float(np.linalg.norm(weight * new))
        if not new_size < size:
            damping *= 4.0
            continue
        gain = size - new_size
        state, error, rows, size, damping = tried, new, new_rows, new_size, max(damping / 3.0, 1e-9)
        if gain < _NO_GAIN * size:
            break
    reached: Array = state.q[0]
    return reached, count, size * system.robot.characteristic_length


def _angles(system: ConstraintSystem, state: ConstraintState) -> tuple[Array, Array]:
    """Return (r,) what is open and (r, nv) what it changes by, angles in place of the sines of hinges and welds."""
    error, rows, first = state.phi[0].copy(), state.Jc[0].copy(), 0
    for closure in system.robot.closures:
        turning = [k for k in range(3) if AXES[3 + k] in closure.axes]
        if len(turning) > 1:
            at = [first + closure.axes.index(AXES[3 + k]) for k in turning]
            vector, relative = _turn(system, state, closure, turning)
            error[at], rows[at] = vector[turning], relative[turning]
        first += len(closure.axes)
    return error, rows


def _turn(
    system: ConstraintSystem, state: ConstraintState, closure: Closure, turning: list[int]
) -> tuple[Array, Array]:
    """Return (3,) the rotation vector from frame a to b, of a hinge that of its axes, and (3, nv) its rate."""
    frames = closure.frame_a, closure.frame_b
    A, B = (frame_placement(state.vectors[:, 0], find_link_index(system.robot.model, each))[0] for each in frames)
    relative: Array = A.T @ (state.columns[0, 3:] * (system.support[frames[1]] - system.support[frames[0]]))
    if len(turning) == 3:
        return pin.log3(A.T @ B), relative
    free = 3 - sum(turning)
    axis = A.T @ B[:, free]
    normal = np.cross(np.eye(3)[free], axis)
    sine = float(np.linalg.norm(normal))
    direction = normal / sine if sine > 1e-9 else np.eye(3)[turning[0]]  # opposite: any way round
    return direction * np.arctan2(sine, axis[free]), relative
