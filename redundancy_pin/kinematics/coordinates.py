"""Independent coordinates: read them off a configuration, take differences, move between them; and working modes.

A working mode selects one inverse displacement of each leg.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, Protocol, TypeAlias

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, BoolArray, IntArray, checked
from redundancy_pin.kinematics.tree import motion_subspace
from redundancy_pin.robot import AXES, Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.scales import is_revolute, row_scale
from redundancy_pin.robot.types import joint_position


class PlacedTree(Protocol):
    """A tree at one configuration or at N: a ``ClosedChain`` or a ``ConstraintState``."""

    @property
    def q(self) -> Array:
        """(nq,) or (N, nq) configurations."""

    def placement(self, frame: str) -> tuple[Array, Array]:
        """Return rotation (3, 3) or (3, 3, N) and origin (3,) or (3, N), m, of a link by its name."""


def coordinates(robot: Robot, tree: PlacedTree) -> Array:
    """Return the independent coordinates of a placed tree, (n,) or (N, n); poses, (4, 4) or (N, 4, 4).

    See ``Platform``.
    """
    if robot.platform is None:
        return np.array([joint_position(joint, tree.q) for joint in _independent(robot)]).T
    rotation, origin = tree.placement(robot.platform.frame)
    if robot.platform.is_pose:
        poses = np.zeros((*tree.q.shape[:-1], 4, 4))
        poses[..., :3, :3] = rotation.T.swapaxes(-1, -2)
        poses[..., :3, 3] = origin.T
        poses[..., 3, 3] = 1.0
        return poses
    # numpy's functions take ten times as long for one number
    atan2, hypot = (math.atan2, math.hypot) if tree.q.ndim == 1 else (np.arctan2, np.hypot)
    parts: list[Any] = []
    for sine, cosine in readings(robot):
        if cosine is None:
            parts.append(origin[sine[0]])
        elif cosine == sine:
            parts.append(atan2(-rotation[sine], hypot(rotation[0, 0], rotation[1, 0])))
        else:
            parts.append(atan2(rotation[sine], rotation[cosine]))
    return np.array(parts).T


Entry: TypeAlias = tuple[int, int]
"""Row and column of a rotation matrix."""


@lru_cache(maxsize=64)
def readings(robot: Robot) -> list[tuple[Entry, Entry | None]]:
    """Return how each coordinate of a platform is read off its placement (R, p); nothing without a platform.

    An angle has the entries of R that are its sine and its cosine, times one positive number. For the pitch they are
    one entry: its sine is −R[2, 0], its cosine the length of R[0, 0] and R[1, 0]. A translation along the base axis k
    is ((k, k), None).
    """
    result: list[tuple[Entry, Entry | None]] = []
    platform = robot.platform
    for is_rotation, k in (divmod(AXES.index(axis), 3) for axis in (platform.axes if platform else ())):
        i, j = (k + 1) % 3, (k + 2) % 3
        if not is_rotation or platform is None:
            result.append(((k, k), None))
        elif len(platform.rotations) == 1:
            result.append(((j, platform.pointer), (i, platform.pointer)))
        else:
            result.append({0: ((2, 1), (2, 2)), 1: ((2, 0), (2, 0)), 2: ((1, 0), (0, 0))}[k])
    return result


def difference(robot: Robot, target: Array, start: Array) -> Array:
    """Return (N, n) the increment from ``start`` to ``target``, or (n,) from one to the other.

    Angles of the platform and of continuous joints go the short way round; between poses it is a translation of the
    origin and a world-aligned rotation vector.
    """
    if is_pose(robot) and target.ndim == 2:
        turn = pin.log3(target[:3, :3].dot(start[:3, :3].T))
        return np.concatenate([target[:3, 3] - start[:3, 3], turn])[pose_rows(robot)]
    if is_pose(robot):
        turned = target[:, :3, :3] @ start[:, :3, :3].transpose(0, 2, 1)
        turns = np.reshape([pin.log3(each) for each in turned], (len(turned), 3))
        delta = np.concatenate([target[:, :3, 3] - start[:, :3, 3], turns], axis=1)
        return delta[:, pose_rows(robot)]
    delta = target - start
    columns = delta.T  # a view: (n, N), or (n,)
    for k in angle_columns(robot):
        columns[k] = (columns[k] + np.pi) % (2.0 * np.pi) - np.pi
    return delta


def distance(robot: Robot, target: Array, start: Array) -> Array:
    """Return (N,) how far platform coordinates are apart, m; rotations count times the characteristic length."""
    apart: Array = np.linalg.norm(difference(robot, target, start) * row_scale(robot), axis=1)
    return apart


def moved(robot: Robot, start: Array, increment: Array) -> Array:
    """Return the coordinates reached from ``start`` by an increment as returned by ``difference``."""
    if not is_pose(robot):
        return start + increment
    full = np.zeros((*start.shape[:-2], 6))
    full[..., pose_rows(robot)] = increment
    result: Array = start.copy()
    result[..., :3, 3] += full[..., :3]
    if start.ndim == 2:
        result[:3, :3] = pin.exp3(full[3:]).dot(start[:3, :3])
    else:
        result[:, :3, :3] = np.reshape([pin.exp3(each) for each in full[:, 3:]], (-1, 3, 3)) @ start[:, :3, :3]
    return result


@lru_cache(maxsize=64)
def with_independent_joints(robot: Robot, joints: tuple[str, ...]) -> Robot:
    """Return the robot with the positions of joints as its independent coordinates, in place of its platform.

    Its inverse kinematics lead from these joints to all others: with the motors, they are the forward kinematics.

    Args:
        robot: the robot.
        joints: as many as the robot has degrees of freedom, of one freedom each.
    """
    return replace(robot, platform=None, independent_joints=joints, working_modes=None, working_mode=())


def gravity_acts(robot: Robot) -> bool:
    """Return whether gravity can move anything: not if it is zero, nor if it is normal to all that a planar tree does.

    Where every joint turns about the direction of gravity, or slides normal to it, no body rises or falls.
    """
    model, size = robot.model, float(np.linalg.norm(robot.gravity))
    if size == 0.0:
        return False
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    down = robot.gravity / size
    for index in range(1, model.njoints):
        joint = model.joints[index]
        turned = data.oMi[index].rotation
        columns = motion_subspace(model, data, index)
        slides, turns = turned @ columns[:3], turned @ columns[3:]
        across = np.abs(np.cross(turns.T, down)).max(initial=0.0)
        if max(across, np.abs(down @ slides[:, : joint.nv]).max(initial=0.0)) > _NORMAL:
            return True
    return False


_NORMAL = 1e-6
"""Sine of an angle that counts as zero: of axes written with six digits."""


@lru_cache(maxsize=64)
def _independent(robot: Robot) -> list[pin.JointModel]:
    """Return the independent joints."""
    return [find_joint(robot.model, name) for name in robot.independent_joints]


def reference_coordinates(robot: Robot, numbers: tuple[float, ...]) -> Array:
    """Return declared reference coordinates as (1, n), or as a pose (1, 4, 4) from xyz and rpy."""
    if is_pose(robot):
        pose: Array = np.eye(4)[None].copy()
        pose[0, :3, 3] = numbers[:3]
        pose[0, :3, :3] = pin.rpy.rpyToMatrix(*numbers[3:])
        return pose
    return np.array(checked(numbers, "reference", (robot.n,)))[None]


@lru_cache(maxsize=64)
def pose_rows(robot: Robot) -> list[int]:
    """Return which components of a twist the platform's velocities are; none without a platform."""
    return [AXES.index(axis) for axis in robot.platform.axes] if robot.platform else []


@lru_cache(maxsize=64)
def angle_columns(robot: Robot) -> list[int]:
    """Columns known up to full turns: platform angles and continuous joints; a bounded joint counts its turns."""
    if robot.platform is not None:
        return [k for k, axis in enumerate(robot.platform.axes) if axis.startswith("r")]
    model = robot.model
    return [k for k, name in enumerate(robot.independent_joints) if find_joint(model, name).nq == 2]


# --- working modes ----------------------------------------------------------------------------------------------------


def mode_indicator(robot: Robot, q: Array) -> Array:
    """Return (N, legs) the signed distance of each leg from the change of its working mode.

    Positive in mode +1, negative in mode −1, zero where the two meet (a type I singularity of that leg): sin(q) of a
    revolute indicator joint, q over the characteristic length of a prismatic one, times the declared sign.

    Args:
        robot: the robot; without declared modes the result has no columns.
        q: (N, nq) configurations.
    """
    columns, sines, signs, units = mode_indicators(robot)
    value = q.take(columns, 1)
    signed: Array = signs * np.where(sines, np.sin(value), value / units)
    return signed


@lru_cache(maxsize=64)
def mode_indicators(robot: Robot) -> tuple[IntArray, BoolArray, Array, Array]:
    """Return the mode indicators of each leg, (legs,) each: a number of q, whether its sine counts, sign and unit."""
    modes, legs = robot.working_modes, []
    for name, sign in zip(modes.joints, modes.signs, strict=True) if modes else ():
        joint = find_joint(robot.model, name)
        # of a continuous joint the second number is the sine
        unit = 1.0 if is_revolute(robot, name) else robot.characteristic_length
        legs.append((joint.idx_q + (joint.nq == 2), joint.nq == 1 and is_revolute(robot, name), sign, unit))
    columns, sines, signs, units = zip(*legs, strict=True) if legs else ((), (), (), ())
    numbers = np.array(signs, dtype=np.float64), np.array(units, dtype=np.float64)
    return np.array(columns, dtype=np.intp), np.array(sines, dtype=bool), *numbers


def working_modes(robot: Robot, q: Array) -> IntArray:
    """Return (N, legs) the working mode of configurations, ±1 a leg, 0 exactly between the two."""
    return np.sign(mode_indicator(robot, q)).astype(np.intp)


def in_working_mode(robot: Robot, q: Array) -> BoolArray:
    """Return (N,) whether configurations are in the robot's own working mode (true if none is declared)."""
    wanted = np.array(robot.working_mode, dtype=float)
    result: BoolArray = (mode_indicator(robot, q) * wanted > 0.0).all(axis=1)
    return result


def all_working_modes(robot: Robot) -> tuple[tuple[int, ...], ...]:
    """Return every working mode of a robot, (+1, …, +1) first; one empty mode if none is declared."""
    legs = len(robot.working_modes.joints) if robot.working_modes else 0
    return tuple(itertools.product((1, -1), repeat=legs))


def mode_name(mode: tuple[int, ...]) -> str:
    """Return a mode as text, ``(1, -1, 1)`` as ``"+-+"``."""
    return "".join("+" if sign > 0 else "-" for sign in mode)
