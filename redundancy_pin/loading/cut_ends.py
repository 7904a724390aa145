"""Whether it matters which joint closes a loop: a ball that turns about one axis only does what a hinge does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

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


def about_several_axes(robot: Robot, ends: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Return those pairs of frames that turn against each other about several axes, or one that is not fixed in them.

    Where two frames meet in a ball and turn about one axis only, a hinge along that axis allows the same motions: in a
    planar loop, and in a spherical one with its ball away from the centre. The test is the rank of the relative angular
    velocities, in the axes of the first frame, of all motions that the loops leave free, at the reference and at a few
    configurations near it. An axis that stays fixed in the first frame is fixed in the second.

    Args:
        robot: its reference is closed.
        ends: names of two links each, in which a loop is cut.

    Example:
        >>> about_several_axes(robot, [("coupler_tip", "rocker_tip")])
        ()
    """
    motions = list(_motions(robot)) if ends else []
    return tuple(pair for pair in ends if not _is_single(_relative_turns(robot, motions, pair)[0]))


def common_axis(robot: Robot, ends: tuple[str, str]) -> Array | None:
    """Return the axis (3,), of length 1, about which two frames turn against each other; None for several or none.

    It is in the axes of the first frame, where it stays fixed. Motions are those of ``about_several_axes``.
    """
    values, axes = _relative_turns(robot, list(_motions(robot)), ends)
    axis: Array = axes[0]
    return axis if values[0] > FILE_TOLERANCE and _is_single(values) else None


def branches_meet(robot: Robot, q: Array) -> bool:
    """Return whether closure rows depend on one another at q (nq,) that do not at the reference, as links in a line do.

    Example:
        >>> branches_meet(robot, pin.neutral(robot.model))  # of a parallelogram that is flat there
        True
    """
    rows = ConstraintSystem(robot).closure_rows(q)
    return len(independent_columns(rows.T, EXACT)) < len(rows)


def _is_single(values: Array) -> bool:
    """Return whether singular values (3,) are those of one direction, to the rounding of a file."""
    return bool((values[1:] <= FILE_TOLERANCE * values[0]).all())


def _motions(robot: Robot) -> Iterator[tuple[Array, Array]]:
    """Yield configurations (nq,) and the free joint velocities (f, nv) there, the reference first."""
    system = ConstraintSystem(robot)
    for q in closed_neighbours(system, np.array(robot.q_reference), *_AROUND):
        motions = free_motions(system, q)
        velocities = np.zeros((len(motions), robot.model.nv))
        velocities[:, system.pose_columns] = motions * system.step_unit
        yield q, velocities


def _relative_turns(robot: Robot, motions: Sequence[tuple[Array, Array]], ends: tuple[str, str]) -> tuple[Array, Array]:
    """Return singular values (3,) and right singular vectors (3, 3) of the second frame's turns against the first.

    The turns are the relative angular velocities of all motions, in axes of the first frame, rad/s.
    """
    model, data, turns = robot.model, robot.model.createData(), []
    indices = [find_link_index(model, name) for name in ends]
    for q, velocities in motions:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        first, second = (
            pin.getFrameJacobian(model, data, index, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[3:] for index in indices
        )
        turns.append(velocities @ (second - first).T @ data.oMf[indices[0]].rotation)
    values, axes = np.linalg.svd(np.concatenate(turns))[1:]
    return values, axes
