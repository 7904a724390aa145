"""What a model file describes in any format: a tree, what closes its loops, what drives it, where it starts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import ModelFileError
from redundancy_pin.robot.formats.urdf_tree import MOST_FREEDOMS, MOST_LINKS, JointEntry, LinkEntry
from redundancy_pin.robot.loads import JointForces
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.types import AXES, Closure, Coupling

_ALIGNED = {
    "revolute": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRevoluteUnaligned),
    "prismatic": (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPrismaticUnaligned),
}
FREEDOMS = {"fixed": 0, "revolute": 1, "prismatic": 1, "ball": 3}
"""Kinds of joints, and the freedoms of each; what has others is made of these."""

NOT_IN_FORCE = "Not in force, though the file says it:"
"""How the note begins that names forces which are left out."""

UNLIMITED = {"lower": -np.inf, "upper": np.inf, "effort": np.inf, "velocity": np.inf}


@dataclass(frozen=True)
class Mechanism:
    """What a file describes.

    Attributes:
        name: of the model.
        links: the bodies and frames by name, the first of them the world.
        joints: each after those that carry it.
        closures: what closes the loops.
        couplings: joints that follow others.
        actuated: names of the joints that are driven.
        gravity: (3,) m/s².
        start: positions of joints at the file's own configuration, rad or m; (4,) of a ball, x, y, z, w.
        forces: friction and springs in joints of one freedom, in force.
        armature: inertia of rotors by joint, kg·m² or kg, in force.
        notes: what is not in force though the file says it, and what is taken in one of several ways.
        driven_is_said: whether the file says what is driven; else ``actuated`` are joints that may be.
        shapes: a URDF with the shapes of the bodies, for drawing only.
    """

    name: str
    links: Mapping[str, LinkEntry]
    joints: tuple[JointEntry, ...]
    closures: tuple[Closure, ...]
    actuated: tuple[str, ...]
    gravity: Array
    start: Mapping[str, float | Array] = field(default_factory=dict)
    armature: Mapping[str, float] = field(default_factory=dict)
    forces: tuple[JointForces, ...] = ()
    notes: tuple[str, ...] = ()
    shapes: str = ""
    drives_declared: bool = True
    couplings: tuple[Coupling, ...] = ()

    def model(self, path: str) -> pin.Model:
        """Return Pinocchio's model, its joints depth first; every link is a frame of it.

        Raises:
            ModelFileError: more links or freedoms than a model may have.
        """
        freedoms = sum(FREEDOMS[joint.kind] for joint in self.joints)
        for count, most, what in ((freedoms, MOST_FREEDOMS, "freedoms"), (len(self.links), MOST_LINKS, "bodies")):
            if count > most:
                raise ModelFileError(
                    f"{path}: the model has {count} {what}, more than the {most} that one may have.",
                    remedy="Take out what is no part of the mechanism.",
                    path=path,
                )
        model = pin.Model()
        model.name = self.name
        model.gravity.linear = self.gravity
        root = next(iter(self.links))
        places = {root: (0, pin.SE3.Identity())}
        model.addBodyFrame(root, 0, pin.SE3.Identity(), 0)
        for joint in self._depth_first():
            carrier, place = places[joint.parent]
            place = place * pin.SE3(joint.placement)
            if joint.kind != "fixed":
                carrier, place = _added(model, joint, carrier, place), pin.SE3.Identity()
                columns = model.joints[carrier]
                rotor = self.armature.get(joint.name, 0.0)
                armature = model.armature
                armature[columns.idx_v : columns.idx_v + columns.nv] = rotor
                model.armature = armature
            places[joint.child] = carrier, place
            link = self.links[joint.child]
            if link.mass or link.inertia.any():
                model.appendBodyToJoint(carrier, pin.Inertia(link.mass, link.centre, link.inertia), place)
            model.addBodyFrame(joint.child, carrier, place, 0)
        return model

    def _depth_first(self) -> Iterator[JointEntry]:
        """Give the joints so that what a joint carries follows it: Pinocchio's mass matrix is wrong otherwise."""
        above: dict[str, list[JointEntry]] = {}
        for joint in reversed(self.joints):
            above.setdefault(joint.parent, []).append(joint)
        waiting = above.get(next(iter(self.links)), [])
        while waiting:
            joint = waiting.pop()
            yield joint
            waiting += above.get(joint.child, [])

    def with_hinges(self, names: Sequence[str]) -> Mechanism:
        """Return the mechanism with three hinges (yaw, pitch, roll) in place of each of some ball joints."""
        joints: list[JointEntry] = []
        links, start = dict(self.links), {name: value for name, value in self.start.items() if name not in names}
        for joint in self.joints:
            if joint.name not in names:
                joints.append(joint)
                continue
            parent, placement = joint.parent, joint.placement
            turn = pin.Quaternion(np.asarray(self.start.get(joint.name, (0.0, 0.0, 0.0, 1.0)))).toRotationMatrix()
            for axis, angle in zip("zyx", angles(turn), strict=True):
                name = f"{joint.name}_r{axis}"
                child = joint.child if axis == "x" else f"{name}::link"
                links.setdefault(child, LinkEntry(child, 0.0, np.zeros(3), np.zeros((3, 3))))
                direction = np.eye(3)["xyz".index(axis)]
                joints.append(JointEntry(name, "revolute", parent, child, placement, direction, UNLIMITED))
                parent, placement, start[name] = child, np.eye(4), angle
        armature = {name: value for name, value in self.armature.items() if not (value and name in names)}
        if len(armature) < len(self.armature):
            raise ModelFileError(
                f"A ball joint of {self.name} that moves freely has an armature, which is not covered.",
                remedy="Make it of three hinges.",
            )
        damped = [load.joint for load in self.forces if load.joint in names]
        left_out = (f"{NOT_IN_FORCE} damping of {', '.join(damped)}.",) if damped else ()
        forces = tuple(load for load in self.forces if load.joint not in names)
        note = f"Ball joints that move freely are three hinges each (singular at a pitch of 90°): {', '.join(names)}."
        return replace(
            self,
            links=links,
            joints=tuple(joints),
            start=start,
            armature=armature,
            forces=forces,
            notes=(*self.notes, *left_out, note),
        )

    def configuration(self, model: pin.Model) -> Array:
        """Return (nq,) the configuration that the file starts from."""
        q: Array = pin.neutral(model)
        for name, value in self.start.items():
            joint = find_joint(model, name)
            q[joint.idx_q : joint.idx_q + joint.nq] = value
        return q


def _added(model: pin.Model, joint: JointEntry, carrier: int, place: pin.SE3) -> int:
    if joint.kind == "ball":
        return int(model.addJoint(carrier, pin.JointModelSpherical(), place, joint.name))
    *aligned, unaligned = _ALIGNED[joint.kind]
    along = np.flatnonzero(joint.axis == 1.0)
    kind = aligned[int(along[0])]() if len(along) == 1 else unaligned(joint.axis)
    limits = [np.array([joint.limits[key]]) for key in ("velocity", "lower", "upper")]
    number = int(model.addJoint(carrier, kind, place, joint.name, np.array([np.inf]), *limits))
    column, effort = model.joints[number].idx_v, joint.limits["effort"]
    # efforts may all be of one sign, and addJoint takes the least for minus the most
    for name, bound in (("lower", joint.limits.get("effort_lower", -effort)), ("upper", effort)):
        bounds = getattr(model, f"{name}EffortLimit")
        bounds[column] = bound
        setattr(model, f"{name}EffortLimit", bounds)
    return number


def six_joints(name: str, parent: str, child: str, place: Array) -> tuple[list[JointEntry], dict[str, float]]:
    """Return the joints of a free body, three slides and three hinges, as independent joints have one freedom each.

    Args:
        name: of the body or its joint; the joints are NAME_x to NAME_rx.
        parent: the link that does not move.
        child: the link of the body.
        place: (4, 4) where it is; the positions of the joints that put it there are returned too, x to rz.
    """
    yaw, pitch, roll = angles(place[:3, :3])
    values = dict(zip(AXES, (*place[:3, 3].tolist(), roll, pitch, yaw), strict=True))
    joints = []
    for axis in ("x", "y", "z", "rz", "ry", "rx"):
        joint, direction = f"{name}_{axis}", np.eye(3)["xyz".index(axis[-1])]
        kind, link = "revolute" if len(axis) == 2 else "prismatic", child if axis == "rx" else f"{name}_{axis}::link"
        joints.append(JointEntry(joint, kind, parent, link, np.eye(4), direction, UNLIMITED))
        parent = link
    return joints, {f"{name}_{axis}": value for axis, value in values.items()}


def placed(rotation: Array, translation: Array) -> Array:
    """Return the (4, 4) placement of a rotation (3, 3) and a translation (3,)."""
    placement: Array = np.eye(4)
    placement[:3, :3], placement[:3, 3] = rotation, translation
    return placement


def angles(turn: Array) -> tuple[float, float, float]:
    """Return yaw, pitch and roll of a rotation (3, 3), R_z R_y R_x, rad."""
    pitch = math.atan2(-turn[2, 0], math.hypot(turn[0, 0], turn[1, 0]))
    if math.hypot(turn[0, 0], turn[1, 0]) < 1e-12:  # any yaw will do
        return math.atan2(-turn[0, 1], turn[1, 1]), pitch, 0.0
    return math.atan2(turn[1, 0], turn[0, 0]), pitch, math.atan2(turn[2, 1], turn[2, 2])


def moved_to(placement: Array, link: LinkEntry) -> LinkEntry:
    """Return a link's mass as seen from the frame in which its own frame has a placement (4, 4)."""
    turn = placement[:3, :3]
    centre = turn @ link.centre + placement[:3, 3]
    return LinkEntry(link.name, link.mass, centre, turn @ link.inertia @ turn.T)


def combined_mass(name: str, parts: list[LinkEntry]) -> LinkEntry:
    """Return the mass of several parts, all in one frame."""
    mass = sum(part.mass for part in parts)
    if not mass > 0.0:
        return LinkEntry(name, 0.0, np.zeros(3), sum((part.inertia for part in parts), np.zeros((3, 3))))
    centre: Array = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part in parts:
        away = part.centre - centre
        inertia += part.inertia + part.mass * (away @ away * np.eye(3) - np.outer(away, away))
    return LinkEntry(name, mass, centre, inertia)


def drawn(shapes: Mapping[str, Sequence[str]]) -> str:
    """Return a URDF that holds nothing but shapes: each link on the base, as only its name counts for a picture.

    Args:
        shapes: elements ``visual`` of each link.
    """
    if not shapes:
        return ""
    from xml.sax.saxutils import quoteattr  # which imports http and ssl

    parts = ["<robot name='shapes'><link name='redundancy_pin::base'/>"]
    for number, (link, visuals) in enumerate(shapes.items()):
        parts.append(f"<link name={quoteattr(link)}>{''.join(visuals)}</link><joint name='at_{number}' type='fixed'>")
        parts.append(f"<parent link='redundancy_pin::base'/><child link={quoteattr(link)}/></joint>")
    return "".join(parts) + "</robot>"
