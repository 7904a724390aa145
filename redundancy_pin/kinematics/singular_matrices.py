"""The matrices whose rank decides on singularities, without units.

With J_c the constraint Jacobian, J_x the rows of the independent velocities and S the selection of the main actuators,
all without the carrier columns:

- K = [J_c; J_x] maps joint velocities to platform velocities and loses rank at a type I singularity;
- T = [J_c; S] is what is left to move with locked actuators and loses rank at a type II singularity;
- W = Γᵀ Sᵀ maps actuator efforts to platform forces. Where K is regular T K⁻¹ = [I 0; * Wᵀ]: W lacks as much rank as T.

Lengths are made comparable by one number, the robot's characteristic length L: every rotation (of a joint, of the
platform, in a closure row) counts as the motion, in metres, of a point at distance L from its axis.
"""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.coordinates import column_scale, row_scale, velocity_scale
from redundancy_pin.kinematics.spectrum import SIGN_TIE


def serial_matrix(system: ConstraintSystem, state: ConstraintState) -> Array:
    """Return (N, p, p) the matrix K in scaled units, D_r K D_v⁻¹; its last n rows are the platform's."""
    stacked = np.concatenate([state.Jc, state.Jx], axis=1)
    return _scaled(system, stacked, np.concatenate([_closure_scale(system), row_scale(system.robot)]))


def locked_matrix(system: ConstraintSystem, state: ConstraintState) -> Array:
    """Return (N, r + m, p) the matrix T in scaled units, D_r T D_v⁻¹; its last m rows are the actuators'."""
    robot = system.robot
    selection = np.zeros((robot.m, robot.model.nv))
    selection[np.arange(robot.m), robot.actuated_velocity] = 1.0
    stacked = np.concatenate([state.Jc, np.broadcast_to(selection, (len(state.q), *selection.shape))], axis=1)
    return _scaled(system, stacked, np.concatenate([_closure_scale(system), column_scale(robot)]))


def actuation_matrix(system: ConstraintSystem, serial: Array) -> Array:
    """Return (N, n, m) the scaled actuation matrix D_x⁻¹ W D_a; NaN where K is exactly singular.

    Args:
        system: closures and platform rows.
        serial: (N, p, p) from ``serial_matrix``.
    """
    robot = system.robot
    columns = np.searchsorted(system.pose_columns, robot.actuated_velocity)
    right = np.zeros((serial.shape[1], robot.n))
    right[len(system.rows) :] = np.eye(robot.n)
    try:
        gamma = np.asarray(np.linalg.solve(serial, np.broadcast_to(right, (len(serial), *right.shape))), dtype=float)
    except np.linalg.LinAlgError:
        # LAPACK gives up on the whole stack for one exactly singular sample
        singular = np.linalg.matrix_rank(serial) < serial.shape[1]
        safe = np.where(singular[:, None, None], np.eye(serial.shape[1]), serial)
        gamma = np.asarray(np.linalg.solve(safe, np.broadcast_to(right, (len(safe), *right.shape))), dtype=float)
        gamma[singular] = np.nan
    by_row: Array = gamma[:, columns].transpose(0, 2, 1)
    return by_row


def signed_margin(W: Array) -> Array:
    """Return (N,) the smallest singular value of W with the sign of its determinant.

    Unlike the margin itself it changes sign where a type II singularity is crossed, and smoothly. Where W is not
    square (m ≠ n) there is no determinant and the sign is +1.

    Args:
        W: (N, n, m) scaled actuation matrices; NaN gives NaN.
    """
    finite = np.isfinite(W).all(axis=(1, 2))
    result = np.full(len(W), np.nan)
    result[finite] = np.linalg.svd(W[finite], compute_uv=False)[:, -1]
    if W.shape[1] == W.shape[2]:
        result[finite] *= np.where(np.linalg.det(W[finite]) < 0.0, -1.0, 1.0)
    return result


def oriented(vectors: Array) -> Array:
    """Return (N, n) vectors with the sign that makes the largest component positive (the first of those that tie)."""
    size = np.abs(vectors)
    leading = (size >= (1.0 - SIGN_TIE) * size.max(axis=1, keepdims=True)).argmax(axis=1)
    flipped = np.take_along_axis(vectors, leading[:, np.newaxis], axis=1) < 0.0
    return read_only(np.where(flipped, -vectors, vectors) + 0.0)  # no negative zeros


def _closure_scale(system: ConstraintSystem) -> Array:
    return np.array([system.robot.characteristic_length if row.rotation else 1.0 for _, row in system.rows])


def _scaled(system: ConstraintSystem, stacked: Array, rows: Array) -> Array:
    columns = velocity_scale(system.robot)[system.pose_columns]
    result: Array = stacked[:, :, system.pose_columns] * (rows[:, None] / columns)
    return result
