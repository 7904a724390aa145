"""Whether it matters which joint closes a loop: a ball that turns about one axis only does what a hinge does."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import FILE_TOLERANCE, Array
from redundancy_pin.kinematics.closing import closed_neighbours
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.mobility import free_motions, independent_columns
from redundancy_pin.kinematics.selection import EXACT
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_link_index

_AROUND = 4, 0.3
"""Number of configurations around the reference, and how far from it the joint is that moves farthest, rad or
characteristic lengths: an axis that is not fixed turns by about as much."""


def turning_axes(robot: Robot, ends: tuple[str, str]) -> Array:
    """Return (k, 3) orthonormal axes, in the first frame, about which two frames turn against each other.

    None where they do not turn; one where its direction is fixed in the first frame, and so in the second; several
    otherwise. Where two frames meet in a ball and turn about one axis, a hinge along that axis allows the same motions:
    in a planar loop, and in a spherical one with its ball away from the centre. The axes span the relative
    angular velocities of all motions that the loops leave free, at the reference and at a few configurations near it.

    Args:
        robot: its reference is closed.
        ends: names of two links, in which a loop is cut.

    Example:
        >>> len(turning_axes(robot, ("coupler_tip", "rocker_tip")))
        1
    """
    model, data, turns = robot.model, robot.model.createData(), []
    indices = [find_link_index(model, name) for name in ends]
    for q, velocities in _motions(robot):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        first, second = (
            pin.getFrameJacobian(model, data, index, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[3:] for index in indices
        )
        turns.append(velocities @ (second - first).T @ data.oMf[indices[0]].rotation)
    values, axes = np.linalg.svd(np.concatenate(turns))[1:]
    found: Array = axes[(values[0] > FILE_TOLERANCE) & (values > FILE_TOLERANCE * values[0])]
    return found


def branches_meet(robot: Robot, q: Array) -> bool:
    """Return whether closure rows depend on one another at q (nq,) that do not at the reference, as links in a line do.

    Example:
        >>> branches_meet(robot, pin.neutral(robot.model))  # of a parallelogram that is flat there
        True
    """
    rows = ConstraintSystem(robot).closure_rows(q)
    return len(independent_columns(rows.T, EXACT)) < len(rows)


@lru_cache(maxsize=1)  # of one robot several ends are looked at
def _motions(robot: Robot) -> list[tuple[Array, Array]]:
    """Return configurations (nq,) and the free joint velocities (f, nv) there, the reference first."""
    system, found = ConstraintSystem(robot), []
    for q in closed_neighbours(system, np.array(robot.q_reference), *_AROUND):
        motions = free_motions(system, q)
        velocities = np.zeros((len(motions), robot.model.nv))
        velocities[:, system.pose_columns] = motions * system.step_unit
        found.append((q, velocities))
    return found
