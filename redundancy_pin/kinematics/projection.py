"""Velocity level: the tree velocities that the closures allow, v = Γ ẋ.

The matrix K stacks the constraint Jacobian over the rows of the independent velocities, without the carrier columns:
K v = (0, ẋ). Its inverse gives Γ (its last n columns) and the accelerations; it is singular exactly where the platform
velocity does not determine the joint velocities: a type I (serial) singularity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.coordinates import row_scale, velocity_scale

SINGULAR_MARGIN = float(np.sqrt(2.0 * CLOSURE_TOLERANCE))
"""Scaled margin below which a pose counts as a type I singularity. At a stretched leg two configurations meet in a
square root: one that is closed to within the tolerance is known no better than this."""

_HOPELESS = 1e12
"""Condition number that no matrix K with a margin above ``SINGULAR_MARGIN`` comes near."""


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


def project(system: ConstraintSystem, state: ConstraintState) -> Projection:
    """Invert K.

    Args:
        system: closures and platform rows of the robot.
        state: evaluated configurations.
    """
    robot = system.robot
    stacked = np.concatenate([state.Jc, state.Jx], axis=1)[:, :, system.pose_columns]
    inverse = _inverse(stacked)
    lengths = velocity_scale(robot)[system.pose_columns]
    closure_rows = [robot.characteristic_length if row.rotation else 1.0 for _, row in system.rows]
    rows = np.concatenate([closure_rows, row_scale(robot)])
    with np.errstate(over="ignore"):
        size = np.sqrt(np.einsum("nij,i,j->n", inverse**2, lengths**2, 1.0 / rows**2))
    margin = np.where(size < 1.0 / SINGULAR_MARGIN, 1.0 / np.where(size > 0.0, size, np.inf), 0.0)
    inverse[margin == 0.0] = np.nan
    gamma = np.zeros((len(stacked), robot.model.nv, robot.n))
    gamma[:, system.pose_columns] = inverse[:, :, len(system.rows) :]
    return Projection(inverse, gamma, margin)


def _inverse(matrices: Array) -> Array:
    """Return stacked inverses, NaN where a matrix is exactly singular."""
    try:
        return np.asarray(np.linalg.inv(matrices), dtype=np.float64)
    except np.linalg.LinAlgError:
        singular = np.linalg.cond(matrices) > _HOPELESS
        safe = np.where(singular[:, None, None], np.eye(matrices.shape[1]), matrices)
        result = np.asarray(np.linalg.inv(safe), dtype=np.float64)
        result[singular] = np.nan
        return result
