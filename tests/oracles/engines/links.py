"""A robot as any multibody engine can take it: links on single joints that all act along z, and closures between them.

Engines differ in the joint axes they allow; z is in all of them. Every joint frame of the Pinocchio tree is therefore
turned so that its axis is z, and placements, inertias and closure frames are read in the turned frames. Joint
coordinates stay what they are: radians or metres along the declared axis, zero where Pinocchio has zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics.tree import motion_subspace
from redundancy_pin.robot import Robot

GROUND = -1
"""Index of the base among the links."""

_PURE = 1e-12
"""Part of a motion subspace, of length 1, that counts as zero: URDF axes are normalised in double precision."""


@dataclass(frozen=True, eq=False)
class Link:
    """One moving body and the joint that carries it.

    Attributes:
        name: name of the joint.
        parent: index of the link it moves on, or ``GROUND``.
        kind: whether it turns about z or slides along z of its own frame.
        rotation, translation: (3, 3) and (3,) m, the joint frame in the frame of the parent at coordinate zero.
        mass: kg.
        centre: (3,) centre of mass in the link frame, m.
        inertia: (3, 3) about the centre of mass, link axes, kg·m².
        position: where the coordinate stands in q; two entries (cosine, sine) for a continuous joint.
        velocity: its index in v.
    """

    name: str
    parent: int
    kind: Literal["revolute", "prismatic"]
    rotation: Array
    translation: Array
    mass: float
    centre: Array
    inertia: Array
    position: slice
    velocity: int


@dataclass(frozen=True, eq=False)
class FrameOnLink:
    """A frame fixed to a link.

    Attributes:
        link: index of the link, or ``GROUND``.
        rotation, translation: (3, 3) and (3,) m, in the frame of the link.
    """

    link: int
    rotation: Array
    translation: Array


@dataclass(frozen=True, eq=False)
class LinkClosure:
    """A closure between two links.

    Attributes:
        name: name of the closure.
        a, b: its frames.
        axes, length: as in ``robot.Closure``.
    """

    name: str
    a: FrameOnLink
    b: FrameOnLink
    axes: tuple[str, ...]
    length: float


@dataclass(frozen=True, eq=False)
class LinkTree:
    """A robot for an engine; link i is joint i + 1 of the Pinocchio tree.

    Attributes:
        robot: the robot.
        links: its moving bodies, parents first.
        closures: its closures.
        gravity: (3,) m/s², world frame.
        driven: (m + k,) velocity indices of main actuators, then carriers.
    """

    robot: Robot
    links: tuple[Link, ...]
    closures: tuple[LinkClosure, ...]
    gravity: Array

    @property
    def driven(self) -> tuple[int, ...]:
        """Velocity indices of the main actuators, then the carriers: the order of efforts."""
        return tuple(int(i) for i in (*self.robot.actuated_velocity, *self.robot.carrier_velocity))

    def from_q(self, q: Array) -> Array:
        """Return (links,) joint coordinates from a configuration (nq,); a continuous joint starts in (−π, π]."""
        return np.array([_coordinate(q[link.position]) for link in self.links])

    def to_q(self, coordinates: Array) -> Array:
        """Return (N, nq) configurations from (N, links) joint coordinates."""
        q = np.empty((len(coordinates), self.robot.model.nq))
        for column, link in zip(coordinates.T, self.links, strict=True):
            continuous = link.position.stop - link.position.start == 2
            q[:, link.position] = np.stack([np.cos(column), np.sin(column)] if continuous else [column], axis=1)
        return q

    def from_v(self, v: Array) -> Array:
        """Return (links,) joint rates from a velocity (nv,)."""
        return np.array([v[link.velocity] for link in self.links])

    def to_v(self, rates: Array) -> Array:
        """Return (N, nv) velocities from (N, links) joint rates."""
        v = np.empty((len(rates), self.robot.model.nv))
        v[:, [link.velocity for link in self.links]] = rates
        return v


def link_tree(robot: Robot) -> LinkTree:
    """Translate a robot.

    Raises:
        UnsupportedRobotError: a joint that neither turns about nor slides along one axis.
    """
    model = robot.model
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    turns = [np.eye(3)]
    """Rotation from the turned frame of each joint to Pinocchio's."""
    links = []
    for index in range(1, model.njoints):
        joint = model.joints[index]
        kind, axis = _axis(model, data, index)
        turn = _z_to(axis)
        turns.append(turn)
        parent = int(model.parents[index])
        placement, inertia = model.jointPlacements[index], model.inertias[index]
        links.append(
            Link(
                name=str(model.names[index]),
                parent=parent - 1,
                kind=kind,
                rotation=read_only(turns[parent].T @ placement.rotation @ turn),
                translation=read_only(turns[parent].T @ placement.translation),
                mass=float(inertia.mass),
                centre=read_only(turn.T @ inertia.lever),
                inertia=read_only(turn.T @ inertia.inertia @ turn),
                position=slice(int(joint.idx_q), int(joint.idx_q + joint.nq)),
                velocity=int(joint.idx_v),
            )
        )

    def frame(name: str) -> FrameOnLink:
        entry = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        turn = turns[int(entry.parentJoint)]
        return FrameOnLink(
            int(entry.parentJoint) - 1,
            read_only(turn.T @ entry.placement.rotation),
            read_only(turn.T @ entry.placement.translation),
        )

    closures = tuple(LinkClosure(c.name, frame(c.frame_a), frame(c.frame_b), c.axes, c.length) for c in robot.closures)
    return LinkTree(robot, tuple(links), closures, robot.gravity)


def _axis(model: pin.Model, data: pin.Data, index: int) -> tuple[Literal["revolute", "prismatic"], Array]:
    joint = model.joints[index]
    if joint.nv == 1:
        subspace = motion_subspace(model, data, index)[:, 0]
        slide, turn = subspace[:3], subspace[3:]
        if np.abs(turn).max() < _PURE:
            return "prismatic", slide
        if np.abs(slide).max() < _PURE:
            return "revolute", turn
    raise UnsupportedRobotError(
        f"Joint {str(model.names[index])!r} has type {joint.shortname()}, which is not translated for outside engines.",
        remedy="Build it from revolute, continuous and prismatic joints.",
        joint=str(model.names[index]),
        type=str(joint.shortname()),
    )


def _z_to(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is the unit vector ``axis``."""
    first = np.eye(3)[int(np.abs(axis).argmin())]
    x = np.cross(first, axis)
    x /= np.linalg.norm(x)
    if axis[2] > 1.0 - _PURE:
        return np.eye(3)  # leave what is along z already as it is
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _coordinate(entries: Array) -> float:
    return float(entries[0]) if len(entries) == 1 else float(np.arctan2(entries[1], entries[0]))
