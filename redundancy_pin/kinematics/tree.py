"""Forward kinematics of a Pinocchio tree for many configurations at once.

Pinocchio evaluates one configuration a call; from Python the call costs more than the arithmetic. Here the joints are
visited in a loop and the samples are array columns. Component-major layout: vectors are (3, N), rotations (3, 3, N), so
every operation runs over contiguous samples.

Velocities are spatial vectors in world coordinates, (linear, angular): the velocity of the body's point that is at the
world origin, and the angular velocity. With J_j the column of a joint's freedom j (constant in the frame of its body),

    V_child = V_parent + Σ J_j v_j,     A_child = A_parent + Σ (J_j v̇_j + V_child × J_j v_j),

where (v, ω) × (m, μ) = (ω × m + v × μ, ω × μ); see Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapter 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.errors import UnsupportedRobotError


@dataclass(frozen=True, eq=False)
class _Joint:
    """One joint of the tree: first its translations, along ``linear``, then what turns, about ``angular``."""

    index: int
    parent: int
    q: slice
    v: slice
    rotation: Array
    translation: Array
    linear: Array
    """(3, t) directions of its t translations, in the joint frame."""
    angular: Array
    """(3, nv_joint − t) axes of its rotations, in the joint frame."""


@dataclass(frozen=True, eq=False)
class _Frame:
    joint: int
    rotation: Array
    translation: Array


@dataclass(frozen=True, eq=False)
class TreePose:
    """The tree at N configurations, in world coordinates.

    Attributes:
        frame_rotation, frame_origin: by frame name, (3, 3, N) and (3, N) m.
        jacobian: (6, nv, N) the spatial velocity that one unit of each v gives to the bodies behind its joint; zero for
            joints that none of the frames depends on.
        samples: N.
    """

    frame_rotation: dict[str, Array]
    frame_origin: dict[str, Array]
    jacobian: Array
    samples: int


class TreeKinematics:
    """Batched kinematics of the frames that closures and platform use.

    Args:
        model: the Pinocchio tree.
        frames: names of the frames (links) to follow.

    Raises:
        UnsupportedRobotError: a joint on the way has a type this module does not cover.
    """

    def __init__(self, model: pin.Model, frames: Sequence[str]) -> None:
        self._nv = model.nv
        self._frames = {name: _frame(model, name) for name in frames}
        chains = {name: [int(j) for j in model.supports[one.joint] if j > 0] for name, one in self._frames.items()}
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        self._joints = tuple(_joint(model, data, j) for j in sorted(set().union(*chains.values())))
        span = {joint.index: range(joint.v.start, joint.v.stop) for joint in self._joints}
        self.support = {name: tuple(column for j in chain for column in span[j]) for name, chain in chains.items()}
        """Velocity indices each frame depends on."""

    def pose(self, q: Array) -> TreePose:
        """Place the frames at (N, nq) configurations."""
        columns = np.ascontiguousarray(q.T)
        samples = columns.shape[1]
        rotations: dict[int, Array] = {0: np.broadcast_to(np.eye(3)[:, :, None], (3, 3, samples))}
        origins: dict[int, Array] = {0: np.zeros((3, samples))}
        jacobian = np.zeros((6, self._nv, samples))
        for joint in self._joints:
            base = _times_constant(rotations[joint.parent], joint.rotation)
            origin = origins[joint.parent] + _apply(rotations[joint.parent], joint.translation)
            slides = joint.linear.shape[1]
            for place, position in enumerate(columns[joint.q][:slides]):
                direction = _apply(base, joint.linear[:, place])
                origin = origin + direction * position
            rotation = _turned(base, joint.angular, columns[joint.q][slides:])
            rotations[joint.index], origins[joint.index] = rotation, origin
            for place, column in enumerate(range(joint.v.start, joint.v.stop)):
                if place < slides:
                    jacobian[:3, column] = _apply(rotation, joint.linear[:, place])
                else:
                    jacobian[3:, column] = axis = _apply(rotation, joint.angular[:, place - slides])
                    cross(origin, axis, jacobian[:3, column])
        frame_rotation, frame_origin = {}, {}
        for name, frame in self._frames.items():
            frame_rotation[name] = _times_constant(rotations[frame.joint], frame.rotation)
            frame_origin[name] = origins[frame.joint] + _apply(rotations[frame.joint], frame.translation)
        return TreePose(frame_rotation, frame_origin, jacobian, samples)

    def motions(self, pose: TreePose, v: Array) -> dict[str, tuple[Array, Array]]:
        """Return by frame name its spatial velocity V and its spatial acceleration A at v̇ = 0, (6, N) each.

        Args:
            pose: from ``pose``.
            v: (N, nv) tree velocities.
        """
        rates = np.ascontiguousarray(v.T)
        still = np.zeros((6, pose.samples))
        motion = {0: (still, still)}
        for joint in self._joints:
            own = still
            for column in range(joint.v.start, joint.v.stop):
                own = own + pose.jacobian[:, column] * rates[column]
            velocity, acceleration = motion[joint.parent]
            velocity = velocity + own
            motion[joint.index] = velocity, acceleration + _spatial_cross(velocity, own)
        return {name: motion[frame.joint] for name, frame in self._frames.items()}


_FEW = 300
NEXT, AFTER = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])


def cross(a: Array, b: Array, out: Array | None = None) -> Array:
    """Return the cross product of (3, ...) vectors; numpy's own takes ten times as long on a few, twice on many."""
    if b.size < _FEW:  # the number of calls counts, and not that of products
        products = a.take(NEXT, 0) * b.take(AFTER, 0)
        return np.subtract(products[:3], products[3:], out=out)
    result = np.empty(np.broadcast_shapes(a.shape, b.shape)) if out is None else out
    result[0] = a[1] * b[2] - a[2] * b[1]
    result[1] = a[2] * b[0] - a[0] * b[2]
    result[2] = a[0] * b[1] - a[1] * b[0]
    return result


def _spatial_cross(one: Array, other: Array) -> Array:
    angular = cross(one[3:], other[3:])
    return np.concatenate([cross(one[3:], other[:3]) + cross(one[:3], other[3:]), angular])


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


_COVERED = ("JointModelR", "JointModelP", "JointModelSpherical", "JointModelFreeFlyer", "JointModelTranslation")
"""Beginnings of the names of joints whose q is translations along the subspace's linear columns, then one angle, its
cosine and sine, or a quaternion."""


def _joint(model: pin.Model, data: pin.Data, index: int) -> _Joint:
    joint = model.joints[index]
    kind = str(joint.shortname())
    subspace = motion_subspace(model, data, index)
    sliding, turning = (np.abs(part).max(axis=0) > 0 for part in (subspace[:3], subspace[3:]))
    if not kind.startswith(_COVERED) or kind == "JointModelSphericalZYX" or (sliding & turning).any():
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
        slice(joint.idx_q, joint.idx_q + joint.nq),
        slice(joint.idx_v, joint.idx_v + joint.nv),
        read_only(placement.rotation.copy()),
        read_only(placement.translation.copy()),
        read_only(subspace[:3, sliding].copy()),
        read_only(subspace[3:, turning].copy()),
    )


def _turned(base: Array, axes: Array, q: Array) -> Array:
    """Return rotations (3, 3, N) turned by q: an angle (1, N), its cosine and sine (2, N), a quaternion (4, N)."""
    if len(q) == 0:
        return base
    if len(q) == 4:
        from scipy.spatial.transform import Rotation

        about: Array = np.einsum("ijn,njk->ikn", base, Rotation.from_quat(q.T).as_matrix())
        return about
    axis = axes[:, 0]
    cosine, sine = q if len(q) == 2 else (np.cos(q[0]), np.sin(q[0]))
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
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])  # Rodrigues
    result: Array = base + _times_constant(base, skew) * sine + _times_constant(base, skew @ skew) * (1.0 - cosine)
    return result


def _apply(rotation: Array, vector: Array) -> Array:
    """Return R v for rotations (3, 3, N) and one constant vector (3,); it may share memory with R."""
    result: Array | None = None
    for k, component in enumerate(vector.tolist()):
        if component != 0.0:
            part = rotation[:, k] if component == 1.0 else rotation[:, k] * component
            result = part if result is None else result + part
    return np.zeros((3, rotation.shape[2])) if result is None else result


def _times_constant(rotation: Array, constant: Array) -> Array:
    """Return R C for rotations (3, 3, N) and one constant matrix (3, 3)."""
    if (constant == np.eye(3)).all():
        return rotation
    return np.stack([_apply(rotation, constant[:, k]) for k in range(3)], axis=1)
