"""Forward kinematics of a Pinocchio tree for many configurations at once.

Pinocchio evaluates one configuration a call; from Python the call costs more than the arithmetic. Here the samples are
array columns, and joints of one kind at one depth of the tree, as the legs of a robot have them, are placed together: a
loop visits such groups. Component-major layout: vectors are (3, L, N), rotations (3, 3, L, N) for L joints, so every
operation runs over contiguous samples.

Velocities are spatial vectors in world coordinates, (linear, angular): the velocity of the body's point that is at the
world origin, and the angular velocity. With J_j the column of a joint's freedom j (constant in the frame of its body),

    V_child = V_parent + Σ J_j v_j,     A_child = A_parent + Σ (J_j v̇_j + V_child × J_j v_j),

where (v, ω) × (m, μ) = (ω × m + v × μ, ω × μ); see Featherstone, "Rigid Body Dynamics Algorithms", 2008, chapter 2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, IntArray, read_only
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.robot.lookup import find_link

T = TypeVar("T")

_Parts = tuple["Array | float | None", ...]
"""Components of constants, one an element of a group: a number where all are equal, None where they are zero."""


@dataclass(frozen=True, eq=False)
class _Source:
    """Where the parents of a group's elements are: group and place of each, none where it is the world."""

    parents: list[tuple[int, int]]
    places: slice | IntArray
    """Of them, where all are in one group."""

    def of(self, placed: Sequence[Array]) -> Array:
        """Return (..., L, N) what was placed, (..., L', N) a group."""
        first = self.parents[0][0]
        if all(group == first for group, _ in self.parents):
            return placed[first][..., self.places, :]
        return np.stack([placed[group][..., k, :] for group, k in self.parents], axis=-2)


@dataclass(frozen=True, eq=False)
class _Fixed:
    """L placements that do not move on their parents: of joints, before they move, or of frames."""

    source: _Source
    rotation: tuple[_Parts, ...] | None
    """Columns; None for the identity."""
    translation: _Parts
    constant: tuple[Array, Array] | None
    """(3, 3, L, 1) and (3, L, 1), where the parent is the world."""

    def place(self, rotations: Sequence[Array], origins: Sequence[Array]) -> tuple[Array, Array]:
        """Return rotations (3, 3, L, N) and origins (3, L, N), in world coordinates."""
        if self.constant is not None:
            return self.constant
        rotation, origin = self.source.of(rotations), self.source.of(origins)
        if any(part is not None for part in self.translation):
            origin = origin + _apply(rotation, self.translation)
        return (rotation if self.rotation is None else _times_constant(rotation, self.rotation)), origin


@dataclass(frozen=True, eq=False)
class _Joints:
    """L joints of one kind at one depth of the tree: first their translations, then what turns.

    Attributes:
        fixed: where they begin.
        q, v: (L,) indices of each coordinate and of each velocity.
        linear, angular: directions of the translations and axes of the rotations, in the joint frames.
        principal: number of the only component of the axis that is not zero; −1 where there are more.
    """

    fixed: _Fixed
    q: tuple[slice | IntArray, ...]
    v: tuple[slice | IntArray, ...]
    linear: tuple[_Parts, ...]
    angular: tuple[_Parts, ...]
    principal: int
    skew: tuple[tuple[_Parts, ...], tuple[_Parts, ...]] | None
    """The cross product with an axis that is not principal, and its square: Rodrigues."""

    def turned(self, base: Array, q: list[Array]) -> Array:
        """Return rotations (3, 3, L, N) turned by an angle, by its cosine and sine, or by a quaternion; (L, N) each."""
        if not q:
            return base
        shape = (3, 3, *q[0].shape)
        if len(q) == 4:
            from scipy.spatial.transform import Rotation

            own = Rotation.from_quat(np.stack(q, axis=-1).reshape(-1, 4)).as_matrix().transpose(1, 2, 0).reshape(shape)
            about: Array = np.einsum("ijln,jkln->ikln", np.broadcast_to(base, shape), own)
            return about
        cosine, sine = q if len(q) == 2 else (np.cos(q[0]), np.sin(q[0]))
        if self.skew is None:
            k = self.principal
            i, j, sign = (k + 1) % 3, (k + 2) % 3, self.angular[0][k]
            sine = sine if sign is None else sine * sign
            turned = np.empty(shape)
            turned[:, k] = base[:, k]
            turned[:, i] = base[:, i] * cosine + base[:, j] * sine
            turned[:, j] = base[:, j] * cosine - base[:, i] * sine
            return turned
        once, twice = (_times_constant(base, matrix) for matrix in self.skew)
        result: Array = base + once * sine + twice * (1.0 - cosine)
        return result


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
        at = {name: find_link(model, name) for name in frames}
        chains = {name: [int(j) for j in model.supports[one.parentJoint] if j > 0] for name, one in at.items()}
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        joints = [_joint(model, data, j) for j in sorted(set().union(*chains.values()))]
        span = {joint.number: joint.v for joint in joints}
        self.support = {name: tuple(column for j in chain for column in span[j]) for name, chain in chains.items()}
        """Velocity indices each frame depends on."""
        place: dict[int, tuple[int, int]] = {}
        self._joints: list[_Joints] = []
        for group in _grouped(joints, lambda joint: (len(model.supports[joint.number]), *joint.kind)):
            self._joints.append(_joints(group, place))
            place |= {joint.number: (len(self._joints) - 1, k) for k, joint in enumerate(group)}
        self._names = tuple(at)
        numbers: dict[int, int] = {}  # of the frames of each joint: those of equal number are placed together
        ends = []
        for name, frame in at.items():
            joint = int(frame.parentJoint)
            numbers[joint] = numbers.get(joint, 0) + 1
            rotation, translation = frame.placement.rotation.copy(), frame.placement.translation.copy()
            ends.append((self._names.index(name), joint, rotation, translation, numbers[joint]))
        kinds = _grouped(ends, lambda e: (place[e[1]][0] if e[1] else -1, e[4], bool((e[2] == np.eye(3)).all())))
        self._ends = [([e[0] for e in group], _fixed([e[1:4] for e in group], place)) for group in kinds]

    def pose(self, q: Array) -> TreePose:
        """Place the frames at (N, nq) configurations."""
        columns = np.ascontiguousarray(q.T)
        samples = columns.shape[1]
        rotations: list[Array] = []
        origins: list[Array] = []
        jacobian = np.zeros((6, self._nv, samples))
        for joints in self._joints:
            base, origin = joints.fixed.place(rotations, origins)
            slides = len(joints.linear)
            for direction, at in zip(joints.linear, joints.q[:slides], strict=True):
                origin = origin + _apply(base, direction) * columns[at]
            rotation = joints.turned(base, [columns[at] for at in joints.q[slides:]])
            for direction, at in zip(joints.linear, joints.v[:slides], strict=True):
                jacobian[:3, at] = _apply(rotation, direction)
            for about, at in zip(joints.angular, joints.v[slides:], strict=True):
                jacobian[3:, at] = axis = _apply(rotation, about)
                jacobian[:3, at] = cross(origin, axis)
            rotations.append(_wide(rotation, samples))
            origins.append(_wide(origin, samples))
        placements: list[tuple[Array, Array]] = [(columns, columns)] * len(self._names)
        for numbers, fixed in self._ends:
            turned, origin = (_wide(part, samples) for part in fixed.place(rotations, origins))
            for k, number in enumerate(numbers):
                placements[number] = turned[:, :, k], origin[:, k]
        by_name = dict(zip(self._names, placements, strict=True))
        frame_rotation, frame_origin = ({name: one[k] for name, one in by_name.items()} for k in (0, 1))
        return TreePose(frame_rotation, frame_origin, jacobian, samples)

    def motions(self, pose: TreePose, v: Array) -> dict[str, tuple[Array, Array]]:
        """Return by frame name its spatial velocity V and its spatial acceleration A at v̇ = 0, (6, N) each.

        Args:
            pose: from ``pose``.
            v: (N, nv) tree velocities.
        """
        rates = np.ascontiguousarray(v.T)
        velocities: list[Array] = []
        accelerations: list[Array] = []
        for joints in self._joints:
            first, *others = (pose.jacobian[:, at] * rates[at] for at in joints.v)
            own = sum(others, first)
            if joints.fixed.constant is not None:
                velocities.append(own)
                accelerations.append(_spatial_cross(own, own))
            else:
                velocities.append(joints.fixed.source.of(velocities) + own)
                accelerations.append(joints.fixed.source.of(accelerations) + _spatial_cross(velocities[-1], own))
        motions = [(np.zeros((6, pose.samples)),) * 2] * len(self._names)
        for numbers, fixed in self._ends:
            if fixed.constant is None:
                velocity, acceleration = fixed.source.of(velocities), fixed.source.of(accelerations)
                for k, number in enumerate(numbers):
                    motions[number] = velocity[:, k], acceleration[:, k]
        return dict(zip(self._names, motions, strict=True))


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
    # as the joint has it, exact: a Jacobian has come back from the world with rounding
    columns: Array = np.reshape(data.joints[index].S, (6, model.joints[index].nv))
    return columns


_COVERED = ("JointModelR", "JointModelP", "JointModelSpherical", "JointModelFreeFlyer", "JointModelTranslation")
"""Beginnings of the names of joints whose q is translations along the subspace's linear columns, then one angle, its
cosine and sine, or a quaternion."""


class _Joint(NamedTuple):
    """One joint of the tree: its number and its parent's, its indices, its place, and its translations and axes."""

    number: int
    parent: int
    q: range
    v: range
    rotation: Array
    translation: Array
    linear: Array
    """(3, t) directions of its t translations, in the joint frame."""
    angular: Array
    """(3, nv_joint − t) axes of its rotations, in the joint frame."""

    @property
    def kind(self) -> tuple[int, ...]:
        """Coordinates, translations, and which component alone the axis of its rotation has, or −1."""
        axis = np.flatnonzero(self.angular[:, :1])
        return len(self.q), self.linear.shape[1], int(axis[0]) if len(axis) == 1 else -1


def _joint(model: pin.Model, data: pin.Data, index: int) -> _Joint:
    joint = model.joints[index]
    kind = str(joint.shortname())
    subspace = motion_subspace(model, data, index)
    sliding, turning = (np.abs(part).max(axis=0) > 0 for part in (subspace[:3], subspace[3:]))
    if not kind.startswith(_COVERED) or kind == "JointModelSphericalZYX" or (sliding & turning).any():
        raise UnsupportedRobotError(
            f"Joint {model.names[index]!r} has type {kind}, which closed-chain kinematics does not cover.",
            remedy="Build it from revolute, continuous, prismatic, planar, ball or floating joints.",
            joint=model.names[index],
            type=kind,
        )
    placement = model.jointPlacements[index]
    return _Joint(
        index,
        int(model.parents[index]),
        range(joint.idx_q, joint.idx_q + joint.nq),
        range(joint.idx_v, joint.idx_v + joint.nv),
        placement.rotation.copy(),
        placement.translation.copy(),
        subspace[:3, sliding].copy(),
        subspace[3:, turning].copy(),
    )


def _grouped(elements: Iterable[T], key: Callable[[T], Any]) -> list[list[T]]:
    """Return the elements with equal keys together, smallest key first."""
    return [list(group) for _, group in groupby(sorted(elements, key=key), key)]


def _joints(group: list[_Joint], place: Mapping[int, tuple[int, int]]) -> _Joints:
    """Return joints of one kind as one; ``place`` has group and place of their parents."""
    one, axes = group[0], np.stack([joint.angular for joint in group], axis=-1)
    principal, skew = one.kind[-1], None
    if axes.shape[1] == 1 and principal < 0:
        matrices = np.array([[[0, -z, y], [z, 0, -x], [-y, x, 0]] for x, y, z in axes[:, 0].T])
        skew = _columns(matrices), _columns(matrices @ matrices)
    return _Joints(
        _fixed([(joint.parent, joint.rotation, joint.translation) for joint in group], place),
        tuple(_index([joint.q[k] for joint in group]) for k in range(len(one.q))),
        tuple(_index([joint.v[k] for joint in group]) for k in range(len(one.v))),
        tuple(_parts(directions) for directions in np.stack([joint.linear for joint in group], axis=-1).swapaxes(0, 1)),
        tuple(_parts(each) for each in axes.swapaxes(0, 1)),
        principal,
        skew,
    )


def _fixed(elements: list[tuple[int, Array, Array]], place: Mapping[int, tuple[int, int]]) -> _Fixed:
    """Return placements: the joint each is on, its rotation, its translation. All are on the world, or none is."""
    rotation, translation = np.stack([e[1] for e in elements]), np.stack([e[2] for e in elements], axis=-1)
    constant = None
    on = [place[e[0]] for e in elements if e[0]]
    if not on:
        constant = read_only(rotation.transpose(1, 2, 0)[..., None].copy()), read_only(translation[..., None].copy())
    source = _Source(on, _index([k for _, k in on]) if on else slice(0))
    same = bool((rotation == np.eye(3)).all())
    return _Fixed(source, None if same else _columns(rotation), _parts(translation), constant)


def _index(numbers: list[int]) -> slice | IntArray:
    """Return numbers as a slice where they are equally spaced: it makes a view and no copy."""
    step = numbers[1] - numbers[0] if len(numbers) > 1 else 1
    if step > 0 and numbers == list(range(numbers[0], numbers[0] + step * len(numbers), step)):
        return slice(numbers[0], numbers[-1] + 1, step)
    return np.array(numbers, dtype=np.intp)


def _parts(vectors: Array) -> _Parts:
    """Return the components of L constant vectors (3, L)."""

    def part(values: Array) -> Array | float | None:
        if (values != values[0]).any():
            return read_only(values[:, None].copy())
        return float(values[0]) or None

    return tuple(map(part, vectors))


def _columns(matrices: Array) -> tuple[_Parts, ...]:
    """Return the columns of L constant matrices (L, 3, 3)."""
    return tuple(_parts(matrices[:, :, k].T) for k in range(3))


def _wide(array: Array, samples: int) -> Array:
    """Return what is the same at all samples, (..., 1), as (..., N)."""
    return array if array.shape[-1] == samples else np.broadcast_to(array, (*array.shape[:-1], samples))


def _apply(rotation: Array, parts: _Parts) -> Array:
    """Return R v for rotations (3, 3, L, N) and L constant vectors; it may share memory with R."""
    result: Array | None = None
    for k, component in enumerate(parts):
        if component is not None:
            unscaled = isinstance(component, float) and component == 1.0
            part = rotation[:, k] if unscaled else rotation[:, k] * component
            result = part if result is None else result + part
    return np.zeros((3, *rotation.shape[2:])) if result is None else result


def _times_constant(rotation: Array, columns: tuple[_Parts, ...]) -> Array:
    """Return R C for rotations (3, 3, L, N) and L constant matrices."""
    return np.stack([_apply(rotation, parts) for parts in columns], axis=1)
