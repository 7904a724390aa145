"""Content of a model file in any format: a tree, its loop joints, its motors, its start configuration."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import ModelFileError
from redundancy_pin.robot.inertia import impossible_inertia
from redundancy_pin.robot.loads import JointForces
from redundancy_pin.robot.lookup import find_joint, find_joint_index, joint_names
from redundancy_pin.robot.loop_joints import LoopJoint
from redundancy_pin.robot.rebuild import axis_of, joint_along, rebuilt, span
from redundancy_pin.robot.types import Coupling

MOST_LINKS = 2000
"""Links of a robot: urdfdom looks each up among all."""

MOST_FREEDOMS = 120
"""Joint velocities. Pinocchio's data grow with their cube: 0.1 GB with 100 of them, 1.6 GB with 300."""

NOT_IN_FORCE = "Not in force, though the file says it:"
"""How the note begins that names forces which are left out."""

SAME_DIRECTION = 1e-6
"""Largest difference of two unit vectors that are one: files carry six digits."""

UNLIMITED = {"lower": -np.inf, "upper": np.inf, "effort": np.inf, "velocity": np.inf}


def not_understood(what: str) -> str:
    """Return a note on an element or attribute that is passed over."""
    return f"Passed over: {what}, which is not understood."


@dataclass(frozen=True, eq=False)
class Mechanism:
    """What a file describes.

    Attributes:
        name: of the model.
        model: the tree; every link is a frame of it. Its gravity, limits and rotors' inertias are in force.
        start: (nq,) the configuration that the file starts from.
        loop_joints: what closes the loops.
        couplings: joints that follow others.
        actuated: names of the joints that are driven; empty where the file states none.
        carriers: names of the carrier joints, which no file states.
        forces: friction and springs in joints of one freedom, in force.
        notes: on content of the file that is ignored, and on content that has several readings.
        shapes: a URDF with the shapes of the bodies, for drawing.
        independent: names of the joints that the file marks as independent; empty if it marks no joint.
        marks: links that are fixed to another one and carry none that moves, with their masses, kg: frames, parts, or
            ends of loops.
        presumed: names of those ``loop_joints`` whose ends the file names, but not their kind: balls stand for them.
    """

    name: str
    model: pin.Model
    start: Array
    loop_joints: tuple[LoopJoint, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    actuated: tuple[str, ...] = ()
    forces: tuple[JointForces, ...] = ()
    notes: tuple[str, ...] = ()
    shapes: str = ""
    independent: tuple[str, ...] = ()
    marks: Mapping[str, float] = field(default_factory=dict)
    presumed: tuple[str, ...] = ()
    carriers: tuple[str, ...] = ()

    def with_joints(
        self, replaced: Mapping[str, Sequence[tuple[str, pin.JointModel]]], start: Mapping[str, float] | None = None
    ) -> Mechanism:
        """Return the mechanism with other joints in place of some; see ``rebuild.rebuilt``.

        Args:
            replaced: by joint, its replacement.
            start: positions of new joints of one freedom, rad or m; 0 when left out.
        """
        model, at = rebuilt(self.model, replaced)
        q = pin.neutral(model)
        for index in range(1, self.model.njoints):
            if str(self.model.names[index]) not in replaced:
                q[span(model, at[index], "q")] = self.start[span(self.model, index, "q")]
        for name, value in (start or {}).items():
            q[find_joint(model, name).idx_q] = value
        freedoms = [{name: find_joint(each, name).nv for name in joint_names(each)} for each in (self.model, model)]
        same = {name for name, count in freedoms[0].items() if freedoms[1].get(name) == count}
        forces = tuple(load for load in self.forces if load.joint in same)
        return replace(self, model=model, start=q, forces=forces)

    def counting_turns(self, names: Collection[str]) -> Mechanism:
        """Return the mechanism with joints that count their turns in place of continuous ones among some.

        Cosine and sine, which Pinocchio has of the latter, forget the turns. Positions start within half a turn.
        """
        replaced: dict[str, list[tuple[str, pin.JointModel]]] = {}
        start: dict[str, float] = {}
        for index in range(1, self.model.njoints):
            name, joint = str(self.model.names[index]), self.model.joints[index]
            if name in names and (joint.nq, joint.nv) == (2, 1):
                replaced[name] = [(name, joint_along("revolute", axis_of(self.model, index)))]
                cosine, sine = self.start[span(self.model, index, "q")]
                start[name] = math.atan2(sine, cosine)
        return self.with_joints(replaced, start) if replaced else self

    def with_hinges(self, names: Collection[str]) -> Mechanism:
        """Return the mechanism with three hinges (yaw, pitch, roll) in place of some ball joints.

        Args:
            names: of ball joints, or of such hinges: ``ball_rz`` names the joint ``ball``; others are ignored.
        """
        balls = [
            ball
            for ball in joint_names(self.model)
            if find_joint(self.model, ball).nq == 4
            and not {ball, *(f"{ball}_r{axis}" for axis in "xyz")}.isdisjoint(names)
        ]
        if not balls:
            return self
        start: dict[str, float] = {}
        for name in balls:
            index = find_joint_index(self.model, name)
            if np.any(self.model.armature[span(self.model, index, "v")]):
                raise ModelFileError(
                    f"A ball joint of {self.name} that moves freely has an armature, which is not covered.",
                    remedy="Make it of three hinges.",
                )
            turn = pin.Quaternion(np.array(self.start[span(self.model, index, "q")])).toRotationMatrix()
            start |= zip((f"{name}_r{axis}" for axis in "xyz"), pin.rpy.matrixToRpy(turn).tolist(), strict=True)
        damped = [load.joint for load in self.forces if load.joint in balls]
        left_out = (f"{NOT_IN_FORCE} damping of {', '.join(damped)}.",) if damped else ()
        note = f"Ball joints that move freely are three hinges each (singular at a pitch of 90°): {', '.join(balls)}."
        made = self.with_joints({name: in_a_row(name, ("rz", "ry", "rx")) for name in balls}, start)
        return replace(made, notes=(*self.notes, *left_out, note))


SIX = ("x", "y", "z", "rz", "ry", "rx")
"""Slides and hinges in place of a free joint: independent joints have one degree of freedom each."""


def six_positions(place: pin.SE3) -> list[float]:
    """Return the positions of slides and hinges along ``SIX`` that put a body at a placement, m and rad."""
    return [*place.translation.tolist(), *pin.rpy.matrixToRpy(place.rotation)[::-1].tolist()]


def in_a_row(name: str, axes: Sequence[str]) -> list[tuple[str, pin.JointModel]]:
    """Return slides ("x") and hinges ("rx") along axes of a joint's frame, named after that joint."""
    return [
        (f"{name}_{axis}", joint_along("revolute" if len(axis) == 2 else "prismatic", np.eye(3)["xyz".index(axis[-1])]))
        for axis in axes
    ]


# --- links and joints of a file ----------------------------------------------------------------------


@dataclass(frozen=True)
class LinkEntry:
    """A link of a file.

    Attributes:
        name: its name.
        mass: kg.
        centre: (3,) centre of mass in the frame of the link, m.
        inertia: (3, 3) about the centre of mass, in the axes of the link, kg·m².
        has_inertial: whether the file states mass and inertia; both are zero otherwise.
        has_shape: whether a URDF gives the link a visual or collision element.
    """

    name: str
    mass: float
    centre: Array
    inertia: Array
    has_inertial: bool = True
    has_shape: bool = False


def impossible_moments(links: Iterable[LinkEntry]) -> tuple[str, ...]:
    """Return a note on each link whose largest principal moment of inertia exceeds the sum of the other two.

    No body has such moments, but files have. With masses and moments that are not negative the mass matrix still has
    no negative eigenvalue, so that they are taken as they stand; negative ones are refused.
    """
    return tuple(
        f"The link {link.name!r} has principal moments of inertia {moments} that no body can have, the largest "
        "exceeds the sum of the other two; taken as they stand."
        for link in links
        if (moments := impossible_inertia(link.inertia))
    )


def mimic_coupling(
    joint: str, of: str, multiplier: float = 1.0, offset: float = 0.0, reference: float = 0.0
) -> Coupling:
    """Return the coupling that <mimic> states: joint = multiplier · (of − reference) + offset, rad or m."""
    return Coupling(f"{joint} of {of}", joint, of, (offset - multiplier * reference, multiplier))


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
