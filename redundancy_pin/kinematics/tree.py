"""Forward kinematics of a Pinocchio tree for many configurations at once.

Pinocchio evaluates one configuration a call; from Python the call costs more than the arithmetic. Here the joints are
visited in a loop and the samples are array columns. Component-major layout: vectors are (3, N), rotations (3, 3, N), so
every operation runs over contiguous samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.errors import UnsupportedRobotError

_SCALAR_JOINTS = ("JointModelR", "JointModelP")
_UNBOUNDED = "JointModelRUB", "JointModelRevoluteUnbounded"


@dataclass(frozen=True, eq=False)
class _Joint:
    """One joint of the tree, with what the recursion needs of it."""

    index: int
    parent: int
    kind: str
    q: slice
    v: slice
    placement_rotation: Array
    placement_translation: Array
    linear: Array
    """(3, nv_joint) linear part of the motion subspace, in the joint frame."""
    angular: Array
    """(3, nv_joint) angular part of the motion subspace, in the joint frame."""


@dataclass(frozen=True, eq=False)
class _Frame:
    joint: int
    rotation: Array
    translation: Array


@dataclass(frozen=True, eq=False)
class TreePose:
    """Placements of joints and frames at N configurations (world frame).

    Attributes:
        joint_rotation, joint_origin: by joint index, (3, 3, N) and (3, N) m.
        frame_rotation, frame_origin: by frame name, (3, 3, N) and (3, N) m.
        axis_linear, axis_angular: by velocity index, (3, N): the velocity that one unit of v gives at the joint's
            origin, and the angular velocity; None where the part is zero.
        samples: N.
    """

    joint_rotation: dict[int, Array]
    joint_origin: dict[int, Array]
    frame_rotation: dict[str, Array]
    frame_origin: dict[str, Array]
    axis_linear: dict[int, Array | None]
    axis_angular: dict[int, Array | None]
    samples: int


@dataclass(frozen=True, eq=False)
class FrameAcceleration:
    """Velocity of a frame and its acceleration at zero q̈ (world axes, frame origin).

    Attributes:
        velocity, angular_velocity: (3, N), m/s and rad/s.
        bias, angular_bias: (3, N), classical acceleration for v̇ = 0, m/s² and rad/s².
    """

    velocity: Array
    angular_velocity: Array
    bias: Array
    angular_bias: Array


class TreeKinematics:
    """Batched kinematics of the frames that closures and platform use.

    Args:
        model: the Pinocchio tree.
        frames: names of the frames (links) to follow.

    Raises:
        UnsupportedRobotError: a joint on the way has a type this module does not cover.
    """

    def __init__(self, model: pin.Model, frames: Sequence[str]) -> None:
        self._frames = {name: _frame(model, name) for name in frames}
        needed: set[int] = set()
        for frame in self._frames.values():
            needed.update(int(j) for j in model.supports[frame.joint] if j > 0)
        reference = model.createData()
        pin.computeJointJacobians(model, reference, pin.neutral(model))
        self._joints = tuple(_joint(model, reference, index) for index in sorted(needed))
        by_index = {joint.index: joint for joint in self._joints}
        self.support: dict[str, tuple[int, ...]] = {}
        """Velocity indices each frame depends on."""
        self._joint_of: dict[int, int] = {}
        for joint in self._joints:
            for column in range(joint.v.start, joint.v.stop):
                self._joint_of[column] = joint.index
        for name, frame in self._frames.items():
            chain = [by_index[int(j)] for j in model.supports[frame.joint] if j > 0]
            self.support[name] = tuple(c for joint in chain for c in range(joint.v.start, joint.v.stop))

    def pose(self, q: Array) -> TreePose:
        """Place joints and frames.

        Args:
            q: (N, nq) configurations.
        """
        columns = np.ascontiguousarray(q.T)
        samples = columns.shape[1]
        rotations: dict[int, Array] = {0: np.broadcast_to(np.eye(3)[:, :, None], (3, 3, samples))}
        origins: dict[int, Array] = {0: np.zeros((3, samples))}
        linear: dict[int, Array | None] = {}
        angular: dict[int, Array | None] = {}
        for joint in self._joints:
            base = _times_constant(rotations[joint.parent], joint.placement_rotation)
            origin = origins[joint.parent] + _apply(rotations[joint.parent], joint.placement_translation)
            rotation, offset = _joint_motion(joint, columns[joint.q], base)
            rotations[joint.index] = rotation
            origins[joint.index] = origin if offset is None else origin + offset
            for local, column in enumerate(range(joint.v.start, joint.v.stop)):
                lin, ang = joint.linear[:, local], joint.angular[:, local]
                linear[column] = _apply(rotation, lin) if lin.any() else None
                angular[column] = _apply(rotation, ang) if ang.any() else None
        frame_rotation = {
            name: _times_constant(rotations[frame.joint], frame.rotation) for name, frame in self._frames.items()
        }
        frame_origin = {
            name: origins[frame.joint] + _apply(rotations[frame.joint], frame.translation)
            for name, frame in self._frames.items()
        }
        return TreePose(rotations, origins, frame_rotation, frame_origin, linear, angular, samples)

    def frame_columns(self, pose: TreePose, name: str) -> dict[int, tuple[Array, Array | None]]:
        """Return the columns of a frame's Jacobian: velocity index -> linear (3, N), angular (3, N) or None.

        World-aligned axes at the frame origin (Pinocchio's LOCAL_WORLD_ALIGNED).
        """
        result: dict[int, tuple[Array, Array | None]] = {}
        for column in self.support[name]:
            lin, ang = pose.axis_linear[column], pose.axis_angular[column]
            if ang is None:
                result[column] = (lin if lin is not None else np.zeros((3, pose.samples)), None)
            else:
                lever = pose.frame_origin[name] - pose.joint_origin[self._joint_of[column]]
                moved = cross(ang, lever)
                result[column] = (moved if lin is None else lin + moved, ang)
        return result

    def accelerations(self, pose: TreePose, v: Array) -> dict[str, FrameAcceleration]:
        """Return velocity and zero-q̈ acceleration of each frame.

        Args:
            pose: from ``pose``.
            v: (N, nv) tree velocities.
        """
        rates = np.ascontiguousarray(v.T)
        zero = np.zeros((3, pose.samples))
        velocity, omega = {0: zero}, {0: zero}
        bias, alpha = {0: zero}, {0: zero}
        for joint in self._joints:
            parent, index = joint.parent, joint.index
            slide, spin = zero, zero
            for column in range(joint.v.start, joint.v.stop):
                lin, ang = pose.axis_linear[column], pose.axis_angular[column]
                slide = slide if lin is None else slide + lin * rates[column]
                spin = spin if ang is None else spin + ang * rates[column]
            arm = pose.joint_origin[index] - pose.joint_origin[parent]
            turn = cross(omega[parent], arm)
            omega[index] = omega[parent] + spin
            velocity[index] = velocity[parent] + turn + slide
            # the relative velocity is carried by the parent and turns with the child
            bias[index] = (
                bias[parent]
                + cross(alpha[parent], arm)
                + cross(omega[parent], turn + slide)
                + cross(omega[index], slide)
            )
            alpha[index] = alpha[parent] + cross(omega[parent], spin)
        result = {}
        for name, frame in self._frames.items():
            arm = pose.frame_origin[name] - pose.joint_origin[frame.joint]
            turn = cross(omega[frame.joint], arm)
            result[name] = FrameAcceleration(
                velocity[frame.joint] + turn,
                omega[frame.joint],
                bias[frame.joint] + cross(alpha[frame.joint], arm) + cross(omega[frame.joint], turn),
                alpha[frame.joint],
            )
        return result


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of (3, N) vectors; numpy's own copies its operands first."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    result[0] = a[1] * b[2] - a[2] * b[1]
    result[1] = a[2] * b[0] - a[0] * b[2]
    result[2] = a[0] * b[1] - a[1] * b[0]
    return result


def motion_subspace(model: pin.Model, data: pin.Data, index: int) -> Array:
    """Return (6, nv_joint) the motion subspace of a joint, in its own frame: linear rows, then angular ones.

    Args:
        model: the Pinocchio tree.
        data: its data, after ``pin.computeJointJacobians``.
        index: index of the joint.
    """
    joint = model.joints[index]
    jacobian = pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL)
    # for a tree of one freedom the binding returns a vector
    columns: Array = np.reshape(jacobian, (6, model.nv))[:, joint.idx_v : joint.idx_v + joint.nv]
    return columns


def _frame(model: pin.Model, name: str) -> _Frame:
    frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
    placement = frame.placement
    return _Frame(int(frame.parentJoint), read_only(placement.rotation.copy()), read_only(placement.translation.copy()))


def _joint(model: pin.Model, data: pin.Data, index: int) -> _Joint:
    joint = model.joints[index]
    kind = joint.shortname()
    known = kind.startswith(_SCALAR_JOINTS) or kind in (
        "JointModelSpherical",
        "JointModelFreeFlyer",
        "JointModelPlanar",
        "JointModelTranslation",
    )
    subspace = motion_subspace(model, data, index)
    helical = ((np.abs(subspace[:3]).max(axis=0) > 0) & (np.abs(subspace[3:]).max(axis=0) > 0)).any()
    if not known or helical:
        raise UnsupportedRobotError(
            f"Joint {model.names[index]!r} has type {kind}, which closed-chain kinematics does not cover.",
            remedy="Build it from revolute, continuous, prismatic, planar or floating joints.",
            joint=model.names[index],
            type=kind,
        )
    placement = model.jointPlacements[index]
    return _Joint(
        index,
        int(model.parents[index]),
        kind,
        slice(joint.idx_q, joint.idx_q + joint.nq),
        slice(joint.idx_v, joint.idx_v + joint.nv),
        read_only(placement.rotation.copy()),
        read_only(placement.translation.copy()),
        read_only(subspace[:3].copy()),
        read_only(subspace[3:].copy()),
    )


def _joint_motion(joint: _Joint, q: Array, base: Array) -> tuple[Array, Array | None]:
    """Return the rotation of the joint frame (3, 3, N) and its displacement (3, N), world axes."""
    if joint.kind.startswith(_UNBOUNDED):
        return _rotate(base, joint.angular[:, 0], q[0], q[1]), None
    if joint.kind.startswith("JointModelP") and joint.kind != "JointModelPlanar":
        return base, _apply(base, joint.linear[:, 0]) * q[0]
    if joint.kind.startswith("JointModelR"):
        return _rotate(base, joint.angular[:, 0], np.cos(q[0]), np.sin(q[0])), None
    if joint.kind == "JointModelTranslation":
        return base, _apply_varying(base, q)
    if joint.kind == "JointModelPlanar":
        offset = _apply_varying(base, np.stack([q[0], q[1], np.zeros_like(q[0])]))
        return _rotate(base, np.array([0.0, 0.0, 1.0]), q[2], q[3]), offset
    turned = np.einsum("ijn,jkn->ikn", base, _quaternion_rotation(q[-4:]))
    return turned, _apply_varying(base, q[:3]) if joint.kind == "JointModelFreeFlyer" else None


def _rotate(base: Array, axis: Array, cosine: Array, sine: Array) -> Array:
    """Return ``base`` turned about a constant local axis (Rodrigues)."""
    principal = np.flatnonzero(axis)
    if len(principal) == 1:
        k = int(principal[0])
        i, j = (k + 1) % 3, (k + 2) % 3
        sine = sine * axis[k]
        turned = np.empty((3, 3, base.shape[2]))
        turned[:, k] = base[:, k]
        turned[:, i] = base[:, i] * cosine + base[:, j] * sine
        turned[:, j] = base[:, j] * cosine - base[:, i] * sine
        return turned
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return base + _times_constant(base, skew) * sine + _times_constant(base, skew @ skew) * (1.0 - cosine)


def _quaternion_rotation(q: Array) -> Array:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _apply(rotation: Array, vector: Array) -> Array:
    """Return R v for rotations (3, 3, N) and one constant vector (3,)."""
    result = np.zeros((3, rotation.shape[2]))
    for k in np.flatnonzero(vector):
        result += rotation[:, k] * vector[k]
    return result


def _apply_varying(rotation: Array, vectors: Array) -> Array:
    """Return R v for rotations (3, 3, N) and vectors (3, N)."""
    turned: Array = rotation[:, 0] * vectors[0] + rotation[:, 1] * vectors[1] + rotation[:, 2] * vectors[2]
    return turned


def _times_constant(rotation: Array, constant: Array) -> Array:
    """Return R C for rotations (3, 3, N) and one constant matrix (3, 3)."""
    if np.array_equal(constant, np.eye(3)):
        return rotation
    return np.stack([_apply(rotation, constant[:, k]) for k in range(3)], axis=1)
