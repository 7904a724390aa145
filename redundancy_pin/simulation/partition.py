"""Which tree velocities are independent: a choice by rank, made anew as the machine moves.

Coordinate partitioning (Wehage and Haug 1982): r of the pose velocities depend on the others through J_c. The dependent
ones are the first r pivots of a QR factorisation with column exchange, so their block of J_c is as well conditioned as
the pose allows. That needs full row rank of J_c and nothing else: neither type I nor type II singularities matter, for
the choice looks at neither the platform nor the actuators.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from redundancy_pin.arrays import RANK_TOLERANCE, Array, IntArray
from redundancy_pin.errors import SingularPoseError


@dataclass(frozen=True, eq=False)
class Partition:
    """Dependent and independent tree velocities.

    Attributes:
        dependent: (r,) velocity indices solved for from J_c v = 0.
        independent: (d,) the others that are free to move.
        prescribed: (p,) those whose motion is given (carriers driven by motion).
    """

    dependent: IntArray
    independent: IntArray
    prescribed: IntArray


def choose(jacobian: Array, scale: Array, pose_columns: IntArray, free: IntArray, prescribed: IntArray) -> Partition:
    """Choose the dependent velocities.

    Args:
        jacobian: (r, nv) J_c.
        scale: (nv,) length that turns each velocity into m/s.
        pose_columns: (p,) velocities that move the pose.
        free: further velocities that are always independent: carriers driven by force.
        prescribed: carriers driven by motion.

    Raises:
        SingularPoseError: J_c has lost row rank: the closures do not determine how the machine moves on.
    """
    rows = len(jacobian)
    if rows == 0:
        return Partition(np.empty(0, dtype=np.intp), np.concatenate([pose_columns, free]), prescribed)
    scaled = np.asfortranarray(jacobian[:, pose_columns] / scale[pose_columns])
    triangle, order, *_ = lapack.dgeqp3(scaled, overwrite_a=1)
    diagonal = np.abs(triangle.diagonal())
    if diagonal[-1] <= RANK_TOLERANCE * diagonal[0]:
        raise SingularPoseError(
            f"The {rows} closure rows have lost rank (smallest pivot {diagonal[-1]:.3g} of {diagonal[0]:.3g}): the "
            "machine can move on in more than one way.",
            remedy="Choose lengths or a motion that keep away from this pose.",
            pivots=diagonal.tolist(),
        )
    order = pose_columns[order - 1]
    return Partition(order[:rows], np.concatenate([order[rows:], free]), prescribed)
