"""Independent coordinates: read them off a configuration, take differences, move between them; and working modes.

A working mode says which of its inverse displacements each leg is in.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, BoolArray, IntArray, checked, read_only
from redundancy_pin.kinematics.closure import ConstraintState
from redundancy_pin.kinematics.tree import motion_subspace
from redundancy_pin.robot import AXES, Robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.named import is_pose
from redundancy_pin.robot.types import slides


def coordinates(robot: Robot, state: ConstraintState) -> Array:
    """Return the independent coordinates of configurations: (N, n), or poses (N, 4, 4).

    A single rotation is the angle, in (−π, π], by which the platform frame is turned about that base axis: for rz the
    angle of the frame's x axis from the base's x axis. Where that axis is normal to the plane the next one in the
    plane serves, so that any mounting of the frame will do.
    """
    if robot.platform is None:
        return np.stack([joint_position(robot, name, state.q) for name in robot.independent_joints], axis=1)
    frame = robot.platform.frame
    rotation, origin = state.pose.frame_rotation[frame], state.pose.frame_origin[frame]
    if robot.platform.is_pose:
        poses = np.zeros((origin.shape[1], 4, 4))
        poses[:, :3, :3] = rotation.transpose(2, 0, 1)
        poses[:, :3, 3] = origin.T
        poses[:, 3, 3] = 1.0
        return poses
    # without samples there is nothing to read off: any axis will do
    axes = measured_axes(robot, rotation[:, :, 0] if rotation.shape[2] else np.eye(3))
    parts = [origin[i] if k < 0 else np.arctan2(rotation[j, k], rotation[i, k]) for i, j, k in axes]
    return np.stack(parts, axis=1)


def measured_axes(robot: Robot, rotation: Array) -> list[tuple[int, int, int]]:
    """Return how each coordinate of a platform is read off its placement.

    An angle in the plane of the base axes i and j is that of one of the platform's axes: (i, j, axis). A translation
    along the base axis k is (k, k, −1).

    Args:
        robot: the robot; nothing is returned where it has no platform.
        rotation: (3, 3) any orientation that the platform takes.
    """
    axes = []
    for is_rotation, k in (divmod(AXES.index(axis), 3) for axis in (robot.platform.axes if robot.platform else ())):
        i, j = (k + 1) % 3, (k + 2) % 3
        in_plane = np.hypot(rotation[i], rotation[j]) > _IN_PLANE
        column = next((axis for axis in (i, j) if in_plane[axis]), k)
        axes.append((i, j, column) if is_rotation else (k, k, -1))
    return axes


_IN_PLANE = 0.5
"""Length of the part of a unit axis in the plane of rotation from which it serves to measure the angle. It does not
change as the platform turns: a platform with one rotation does not tilt."""


def difference(robot: Robot, target: Array, start: Array) -> Array:
    """Return (N, n) the increment from ``start`` to ``target``, or (n,) from one to the other.

    Angles of the platform and of continuous joints go the short way round; between poses it is a translation of the
    origin and a world-aligned rotation vector.
    """
    if target.ndim == 3:
        from scipy.spatial.transform import Rotation

        rotation = Rotation.from_matrix(target[:, :3, :3] @ start[:, :3, :3].transpose(0, 2, 1))
        delta = np.concatenate([target[:, :3, 3] - start[:, :3, 3], rotation.as_rotvec()], axis=1)
        return delta[:, pose_rows(robot)]
    delta = target - start
    turns = angle_columns(robot)
    if turns:
        delta[..., turns] = (delta[..., turns] + np.pi) % (2.0 * np.pi) - np.pi
    return delta


def distance(robot: Robot, target: Array, start: Array) -> Array:
    """Return (N,) how far platform coordinates are apart, m; rotations count times the characteristic length."""
    apart: Array = np.linalg.norm(difference(robot, target, start) * row_scale(robot), axis=1)
    return apart


def moved(robot: Robot, start: Array, increment: Array) -> Array:
    """Return the coordinates reached from ``start`` by an increment as returned by ``difference``."""
    if start.ndim == 3:
        from scipy.spatial.transform import Rotation

        full = np.zeros((len(start), 6))
        full[:, pose_rows(robot)] = increment
        result: Array = start.copy()
        result[:, :3, 3] += full[:, :3]
        result[:, :3, :3] = Rotation.from_rotvec(full[:, 3:]).as_matrix() @ start[:, :3, :3]
        return result
    return start + increment


@lru_cache(maxsize=64)
def row_scale(robot: Robot) -> Array:
    """Return (n,) the characteristic length for rotations and 1 for translations among the independent coordinates."""
    return read_only(np.where(turning_coordinates(robot), robot.characteristic_length, 1.0))


def turning_coordinates(robot: Robot) -> list[bool]:
    """Return which of the n independent coordinates are rotations."""
    if robot.platform is not None:
        return [axis.startswith("r") for axis in robot.platform.axes]
    return [is_revolute(robot, name) for name in robot.independent_joints]


@lru_cache(maxsize=64)
def column_scale(robot: Robot) -> Array:
    """Return (m,) the characteristic length for revolute main actuators and 1 for prismatic ones."""
    turning = [is_revolute(robot, name) for name in robot.actuated]
    return read_only(np.where(turning, robot.characteristic_length, 1.0))


@lru_cache(maxsize=64)
def velocity_scale(robot: Robot) -> Array:
    """Return (nv,) the length that turns each tree velocity into m/s: the characteristic length for rotations."""
    return read_only(np.where(turning_velocities(robot), robot.characteristic_length, 1.0))


@lru_cache(maxsize=64)
def turning_velocities(robot: Robot) -> BoolArray:
    """Return (nv,) which tree velocities are rotations."""
    model = robot.model
    turning = np.zeros(model.nv, dtype=bool)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for index in range(1, model.njoints):
        joint = model.joints[index]
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        turning[columns] = np.abs(motion_subspace(model, data, index)[3:]).max(axis=0) > 0
    return read_only(turning)


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


def joint_position(robot: Robot, name: str, q: Array) -> Array:
    """Return (N,) positions of a joint of one freedom, m or rad; a continuous joint's lies in (−π, π]."""
    joint = find_joint(robot.model, name)
    if joint.nq == 2:
        angle: Array = np.arctan2(q[:, joint.idx_q + 1], q[:, joint.idx_q])
        return angle
    return q[:, joint.idx_q]


def reference_coordinates(robot: Robot, numbers: tuple[float, ...]) -> Array:
    """Return declared reference coordinates as (1, n), or as a pose (1, 4, 4) from xyz and rpy."""
    if is_pose(robot):
        from scipy.spatial.transform import Rotation

        pose: Array = np.eye(4)[None].copy()
        pose[0, :3, 3] = numbers[:3]
        pose[0, :3, :3] = Rotation.from_euler("xyz", numbers[3:]).as_matrix()
        return pose
    return np.array(checked(numbers, "reference", (robot.n,)))[None]


def pose_rows(robot: Robot) -> list[int]:
    """Return which components of a twist the platform's velocities are; none without a platform."""
    return [AXES.index(axis) for axis in robot.platform.axes] if robot.platform else []


def is_revolute(robot: Robot, name: str) -> bool:
    """Return whether a joint of one freedom turns."""
    return not slides(find_joint(robot.model, name))


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
    revolute indicator joint, q (m) of a prismatic one, times the declared sign.

    Args:
        robot: the robot; without declared modes the result has no columns.
        q: (N, nq) configurations.
    """
    columns, sines, signs = mode_indicators(robot)
    value = q.take(columns, 1)
    signed: Array = signs * np.where(sines, np.sin(value), value)
    return signed


@lru_cache(maxsize=64)
def mode_indicators(robot: Robot) -> tuple[IntArray, BoolArray, Array]:
    """Return what tells the mode of each leg, (legs,) each: a number of q, whether its sine counts, and the sign."""
    modes, legs = robot.working_modes, []
    for name, sign in zip(modes.joints, modes.signs, strict=True) if modes else ():
        joint = find_joint(robot.model, name)
        # of a continuous joint the second number is the sine
        legs.append((joint.idx_q + (joint.nq == 2), joint.nq == 1 and is_revolute(robot, name), sign))
    columns, sines, signs = zip(*legs, strict=True) if legs else ((), (), ())
    return np.array(columns, dtype=np.intp), np.array(sines, dtype=bool), np.array(signs, dtype=np.float64)


def working_modes(robot: Robot, q: Array) -> IntArray:
    """Return (N, legs) the working mode of configurations, ±1 a leg, 0 exactly between the two."""
    return np.sign(mode_indicator(robot, q)).astype(np.intp)


def in_working_mode(robot: Robot, q: Array) -> BoolArray:
    """Return (N,) whether configurations are in the robot's own working mode (true where it declares none)."""
    wanted = np.array(robot.working_mode, dtype=float)
    result: BoolArray = (mode_indicator(robot, q) * wanted > 0.0).all(axis=1)
    return result


def all_working_modes(robot: Robot) -> tuple[tuple[int, ...], ...]:
    """Return every working mode of a robot, (+1, …, +1) first; one empty mode where none is declared."""
    legs = len(robot.working_modes.joints) if robot.working_modes else 0
    return tuple(itertools.product((1, -1), repeat=legs))


def mode_name(mode: tuple[int, ...]) -> str:
    """Return a mode as text, ``(1, -1, 1)`` as ``"+-+"``."""
    return "".join("+" if sign > 0 else "-" for sign in mode)
