"""Read SDF, the models of Gazebo: links in frames of their own, and joints between them, loops included.

A tree is taken out of the joints, each link by its first parent; a link that has no parent left is carried the other
way round. Every other joint closes a loop. A gearbox, a screw and ``<mimic>`` couple joints. Versions from 1.3 on; what
changes the mechanics and is not covered is refused by name, file and line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, decimal
from redundancy_pin.errors import shown
from redundancy_pin.robot.formats.mechanism import (
    MOST_FREEDOMS,
    NOT_IN_FORCE,
    SAME_DIRECTION,
    SIX,
    UNLIMITED,
    LinkEntry,
    Mechanism,
    impossible_moments,
    in_a_row,
    mimic_coupling,
    six_positions,
)
from redundancy_pin.robot.formats.sdf_frames import WORLD, Frame, Frames, SdfPart
from redundancy_pin.robot.formats.xml_files import ZEROS
from redundancy_pin.robot.inertia import negative_inertia
from redundancy_pin.robot.loads import JointForces
from redundancy_pin.robot.lookup import find_joint, has_joint
from redundancy_pin.robot.loop_joints import LOOP_KINDS, LoopJoint, joint_between
from redundancy_pin.robot.rebuild import joint_along, rebuilt
from redundancy_pin.robot.types import Coupling

_UNLIMITED = 1e15
"""SDF writes 1e16 where there is no limit, and −1 for speeds and efforts."""

_AXES_IN_MODEL, _ALWAYS_IN_MODEL = 6, 4
"""Up to version 1.6 an axis may say that it is in the frame of the model; up to 1.4 it is."""

_MOMENTS = ("ixx", "iyy", "izz")

_AXES = {
    "revolute": 1,
    "continuous": 1,
    "prismatic": 1,
    "screw": 1,
    "universal": 2,
    "revolute2": 2,
    "gearbox": 2,
    "ball": 0,
    "fixed": 0,
}
"""Types of joints, and the number of their axes."""

_SOFT = ("cfm", "cfm_damping", "implicit_spring_damper", "max_force")
"""Elements of a joint's <physics><ode> that soften or drive it, and of its <suspension>."""


def read_sdf(path: Path, *, named: Sequence[str] = (), base: str = "fixed") -> Mechanism:
    """Read a model of Gazebo, or a world with one model that moves.

    Args:
        path: the file.
        named: joints that the tree must contain, as driven ones; one of them that closes a loop ends in a weld.
        base: "fixed" to fix the first link, or the one on the world, at its pose; "free" to let it move.

    Raises:
        ModelFileError: naming file and line: the file is no SDF, or has an element that this reader does not cover.
    """
    return _Reader(Frames(path), base).mechanism(named)


@dataclass(frozen=True)
class _Step:
    """A joint of one degree of freedom, or a ball, of which a joint of the file consists.

    Attributes:
        name: what to call it.
        kind: "revolute", "prismatic" or "ball".
        axis: (3,) of length 1, in the axes of the model that moves.
        limits: as ``UNLIMITED``.
    """

    name: str
    kind: str
    axis: Array
    limits: Mapping[str, float] = field(default_factory=lambda: UNLIMITED)


@dataclass(frozen=True)
class _Joint:
    """A joint of the file.

    Attributes:
        frame: its element and the scope of its names.
        name: what to call it.
        kind: its type.
        parent, child: full names of the links that it joins, or "world".
        place: (4, 4) in the model that moves.
        axes: (3,) of length 1, in the axes of that model.
        steps: its parts, from its parent to its child.
        turns: names of the steps of its axes.
    """

    frame: Frame
    name: str
    kind: str
    parent: str
    child: str
    place: Array
    axes: tuple[Array, ...] = ()
    steps: tuple[_Step, ...] = ()
    turns: tuple[str, ...] = ()


class _Reader:
    """State of reading one file."""

    def __init__(self, frames: Frames, base: str) -> None:
        self.frames, self._base = frames, base
        self.notes: list[str] = []
        self.loads: dict[str, JointForces] = {}
        self.couplings: list[Coupling] = []
        self._ignored: dict[str, list[str]] = {}
        self._assumed: list[str] = []
        self.model = pin.Model()
        self.model.name, self.model.gravity.linear = frames.main, frames.gravity
        self.model.addBodyFrame(WORLD, 0, pin.SE3.Identity(), 0)
        self._carriers: dict[str, tuple[int, pin.SE3]] = {WORLD: (0, pin.SE3.Identity())}
        """By full name of a link, the joint of the tree that carries it, and its place there."""

    def mechanism(self, named: Sequence[str]) -> Mechanism:
        """Return what the file describes."""
        frames = self.frames
        links = {full: self._link(frame) for full, frame in frames.links.items()}
        self.notes += impossible_moments(links.values())
        joints = {full: self._joint(full, frame) for full, frame in frames.joints.items()}
        hinged = [joint for joint in joints.values() if joint.kind != "gearbox"]
        for joint in joints.values():
            if joint.kind == "gearbox":
                self.couplings.append(self._gears(joint, hinged))
            self._couple_axes(joint, joints)
        tree, loops = self._spanning(hinged)
        start: dict[str, float] = {}
        for above, turned_round, carrier, carried in tree:
            if above is None:
                start = self._root(links[carried], carried)
            else:
                index, place = self._add_joint(above, carrier, turned_round=turned_round)
                self._add_link(links[carried], carried, index, place * self._from(above, carried))
        counted = {*named, *self.loads, *(name for coupling in self.couplings for name in coupling.joints)}
        loop_joints = tuple(self._loop_joint(joint, counted) for joint in loops)
        self._add_marks()
        model, _ = rebuilt(self.model)
        self._report()
        q: Array = pin.neutral(model)
        for name, value in start.items():
            q[find_joint(model, name).idx_q] = value
        return Mechanism(
            frames.main,
            model,
            q,
            loop_joints,
            tuple(self.couplings),
            forces=tuple(self.loads.values()),
            notes=tuple(self.notes),
        )

    # --- links and joints ---------------------------------------------------------------------------------------------

    def _link(self, frame: Frame) -> LinkEntry:
        part, name = frame.part, self.frames.name(frame.full)
        if not part.flag("gravity", default=True):
            part.refuse(f"{part.owner} has no gravity, which is not covered")
        if part.flag("kinematic") or part.flag("enable_wind"):
            part.refuse(f"{part.owner} is kinematic or in the wind, which is not covered")
        decay = part.one("velocity_decay")
        if decay and any(decay.value(key, 0.0) for key in ("linear", "angular")):
            self._ignored.setdefault("velocity decay", []).append(name)
        inertial = part.one("inertial")
        tensor = inertial.one("inertia") if inertial else None
        mass, inertia, place = 1.0, np.eye(3), np.eye(4)
        if inertial:
            if inertial.text_of("auto") not in ZEROS or inertial.relative_to():
                remedy = "Write mass and inertia, in the frame of the link."
                inertial.refuse(f"{part.owner} has an inertial by its shapes, or in another frame", remedy)
            place, mass = inertial.pose(), inertial.value("mass", 1.0)
        if tensor:
            keys = ["i" + "".join(sorted(one + other)) for one in "xyz" for other in "xyz"]
            values = [tensor.value(key, 1.0 if key in _MOMENTS else 0.0) for key in keys]
            inertia = np.array(values).reshape(3, 3)
        missing = [key for key in _MOMENTS if tensor is None or not tensor.says(key)]
        if missing or inertial is None or not inertial.says("mass"):
            self._assumed.append(name)
        if what := negative_inertia(mass, inertia):
            part.refuse(f"{part.owner} has {what}", "Correct it.")
        turn = place[:3, :3]
        return LinkEntry(name, mass, place[:3, 3], turn @ inertia @ turn.T)

    def _joint(self, full: str, frame: Frame) -> _Joint:
        part, name = frame.part, self.frames.name(full)
        for ode in part.deep("ode"):
            softened = [*ode.parts(), *(each for inner in ode.parts("suspension") for each in inner.parts())]
            if any(each.tag in _SOFT and each.content().lower() not in ZEROS for each in softened):
                self._ignored.setdefault("<ode>", []).append(name)
        if (kind := part.text_of("type")) not in _AXES:
            what = f"{part.owner} has the type {shown(kind)}, which is not covered"
            part.refuse(what, f"Covered are {', '.join(_AXES)}.")
        parent, child = (self.frames.end(frame, role) for role in ("parent", "child"))
        if parent == child:
            part.refuse(f"{part.owner} joins {self.frames.name(parent)!r} to itself", "Name two links.")
        joint = _Joint(frame, name, kind, parent, child, self.frames.place(frame.full, self.frames.main))
        names = {1: (name,), 2: (f"{name}_1", f"{name}_2")}.get(_AXES[kind], ())
        axes, steps = [], []
        for number, tag in enumerate(("axis", "axis2")):
            axis = part.one(tag)
            if axis is None:
                if number < _AXES[kind]:
                    part.refuse(f"{part.owner} has no {tag}", "Add it.")
                continue
            self._read_forces(axis, name, names[number] if number < len(names) and kind != "gearbox" else "")
            if axis.value("initial_position", 0.0):
                self.notes.append(f"The initial position of {name!r} is not read: joints are at zero where links are.")
            if 0 < _AXES[kind] <= number:
                self.notes.append(f"The second axis of {name!r}, which is {kind}, is left out.")
            if number < _AXES[kind]:  # a ball may have axes, which say its damping
                axes.append(self._direction(axis, frame, joint.place))
                limits = self._limits(axis, kind)
                steps.append(_Step(names[number], "prismatic" if kind == "prismatic" else "revolute", axes[-1], limits))
        if len(steps) == 1 and (end := steps[0].limits["lower"]) == steps[0].limits["upper"]:
            if end:
                part.refuse(f"{part.owner} is held at {end:g}, not where the model has it", "Move the links there.")
            self.notes.append(f"The joint {name!r} has the limits 0 and 0: it is fixed.")
            self.loads.pop(name, None)  # a joint that does not move bears its own spring
            return replace(joint, kind="fixed")
        if kind == "screw":
            steps.insert(0, _Step(f"{name}_slide", "prismatic", axes[0]))
            self.couplings.append(Coupling(f"thread of {name}", f"{name}_slide", name, (0.0, self._lead(part))))
        if kind == "ball":
            steps.append(_Step(name, "ball", np.zeros(3)))
        if kind == "gearbox":
            return replace(joint, axes=tuple(axes))
        return replace(joint, axes=tuple(axes), steps=tuple(steps), turns=names)

    def _direction(self, axis: SdfPart, frame: Frame, place: Array) -> Array:
        """Return (3,) an axis in the axes of the model that moves."""
        given, main = axis.one("xyz"), self.frames.main
        vector = given.numbers(given.content(), 3, "an axis") if given else np.array([0.0, 0.0, 1.0])
        if not (length := float(np.linalg.norm(vector))):
            axis.refuse(f"{axis.owner} has an axis of length zero", "Correct it.")
        turn = place[:3, :3]
        if given and (unknown := set(given.attributes) - {"expressed_in"}):
            given.refuse(f"{axis.owner} has an axis with {', '.join(sorted(unknown))}", "Write expressed_in.")
        if given and (named := given.text_of("expressed_in")):
            turn = self.frames.place(self.frames.find(frame.scope, named, given), main)[:3, :3]
        if axis.flag("use_parent_model_frame", default=axis.version <= _ALWAYS_IN_MODEL):
            if axis.version > _AXES_IN_MODEL:
                axis.refuse(f"{axis.owner} has use_parent_model_frame, no part of SDF 1.7", "Write expressed_in.")
            turn = self.frames.place(frame.scope.frame, main)[:3, :3]
        direction: Array = turn @ vector / length
        return direction

    def _limits(self, axis: SdfPart, kind: str) -> dict[str, float]:
        result = dict(UNLIMITED)
        limit = axis.one("limit")
        if limit is None:
            return result
        for key in UNLIMITED:
            try:
                value = decimal(limit.text(key, "inf") or "inf")
            except ValueError:
                value = math.nan
            if math.isnan(value):
                limit.refuse(f"{axis.owner} has the {key} {shown(limit.text(key))}, which is no number", "Correct it.")
            is_end = key in ("lower", "upper")
            if abs(value) < _UNLIMITED and (kind != "continuous" if is_end else value >= 0.0):
                result[key] = value
        if result["lower"] > result["upper"]:
            what = f"{axis.owner} has the limits {result['lower']:g} and {result['upper']:g}"
            limit.refuse(f"{what}, the lower above the upper", "Correct them.")
        return result

    def _read_forces(self, axis: SdfPart, joint: str, step: str) -> None:
        """Read damping, friction and spring of an axis; they act on a step, or are ignored if its name is empty."""
        dynamics = axis.one("dynamics")
        if dynamics is None:
            return
        damping, friction, stiffness = (dynamics.value(key, 0.0) for key in ("damping", "friction", "spring_stiffness"))
        if min(damping, friction, stiffness) < 0.0:
            dynamics.refuse(f"{axis.owner} has negative friction or stiffness", "Correct it.")
        if step and (damping or friction or stiffness):
            rest = dynamics.value("spring_reference", 0.0)
            self.loads[step] = JointForces(step, damping, friction, stiffness=stiffness, rest=rest)
        elif damping or friction or stiffness:
            self._ignored.setdefault("dynamics", []).append(joint)

    # --- couplings ----------------------------------------------------------------------------------------------------

    def _lead(self, part: SdfPart) -> float:
        """Return how far a screw moves along its axis as it turns about it, m/rad.

        ``screw_thread_pitch`` is in m per turn of a right-handed thread, the older ``thread_pitch`` in rad/m of a
        left-handed one.
        """
        if part.one("screw_thread_pitch") or not part.one("thread_pitch"):
            return part.value("screw_thread_pitch") / (2.0 * math.pi)
        if not (pitch := part.value("thread_pitch")):
            part.refuse(f"{part.owner} has a thread_pitch of zero", "Correct it.")
        return -1.0 / pitch

    def _couple_axes(self, joint: _Joint, joints: Mapping[str, _Joint]) -> None:
        """Add the coupling of <mimic>: follower = multiplier · (leader − reference) + offset."""
        scope = joint.frame.scope
        for number, tag in enumerate(("axis", "axis2")):
            axis = joint.frame.part.one(tag)
            if axis is None or (mimic := axis.one("mimic")) is None:
                continue
            leader, which = joints.get(scope.prefix + mimic.text_of("joint")), mimic.text_of("axis") or "axis"
            turns = dict(zip(("axis", "axis2"), leader.turns if leader and leader is not joint else (), strict=False))
            if which not in turns or number >= len(joint.turns):
                what = f"{mimic.owner} mimics the {shown(which)} of {shown(mimic.text_of('joint'))}, which it cannot"
                mimic.refuse(what, "Name another joint of one or two axes.")
            law = {key: mimic.value(key) for key in ("multiplier", "offset", "reference") if mimic.one(key)}
            self.couplings.append(mimic_coupling(joint.turns[number], turns[which], **law))

    def _gears(self, gear: _Joint, joints: Iterable[_Joint]) -> Coupling:
        """Return θ₂ = −ratio θ₁: angles from the reference body to parent (θ₁, about axis) and child (about axis2)."""
        part, frames = gear.frame.part, self.frames
        reference = frames.body(frames.find(gear.frame.scope, part.text("gearbox_reference_body"), part))
        ratio, ends = part.value("gearbox_ratio", 1.0), []
        for link, axis in zip((gear.parent, gear.child), gear.axes, strict=True):
            between = [
                joint
                for joint in joints
                if {joint.parent, joint.child} == {reference, link} and joint.kind in ("revolute", "continuous")
            ]
            along = float(between[0].axes[0] @ axis) if between else 0.0
            if abs(abs(along) - 1.0) > SAME_DIRECTION:
                ends_named = f"from {frames.name(reference)!r} to {frames.name(link)!r}"
                part.refuse(
                    f"{part.owner} needs a hinge about its axis {ends_named}", "Add it, or correct the gearbox."
                )
            sense = 1.0 if between[0].parent == reference else -1.0
            ends.append((between[0].name, math.copysign(1.0, along) * sense))
        (of, first), (name, second) = ends
        return Coupling(gear.name, name, of, (0.0, -ratio * first * second))

    # --- the tree -----------------------------------------------------------------------------------------------------

    def _spanning(self, joints: list[_Joint]) -> tuple[list[tuple[_Joint | None, bool, str, str]], list[_Joint]]:
        """Return the tree, each joint with whether it is reversed, its carrier and the link it carries; and the rest.

        A root without a joint to the world is carried by it, by no joint.
        """
        links = self.frames.links
        first: dict[str, _Joint] = {}
        for joint in joints:
            first.setdefault(joint.child, joint)
        tree: list[tuple[_Joint | None, bool, str, str]] = []
        reached, rest = {WORLD}, list(joints)
        while True:
            forward = (j for j in rest if j.parent in reached and j.child not in reached and first[j.child] is j)
            backward = (j for j in rest if (j.parent in reached) != (j.child in reached))
            if above := next(forward, None) or next(backward, None):
                back = above.parent not in reached
                carrier, carried = (above.child, above.parent) if back else (above.parent, above.child)
                tree.append((above, back, carrier, carried))
                rest.remove(above)
            elif left := [full for full in links if full not in reached]:
                if tree:
                    part = links[left[0]].part
                    part.refuse(f"{part.owner} is joined to nothing that is joined to the base", "Add a joint.")
                carried = next((full for full in left if full not in first), left[0])
                tree.append((None, False, WORLD, carried))
            else:
                return tree, rest
            reached.add(carried)

    def _where(self, full: str) -> pin.SE3:
        """Return the placement of a link, or the world, in the model that moves."""
        return pin.SE3(self.frames.place(full, self.frames.main))

    def _from(self, joint: _Joint, full: str) -> pin.SE3:
        """Return the placement of a link at the origin of a joint, in axes parallel to the moving model's."""
        return pin.SE3(np.eye(3), joint.place[:3, 3]).actInv(self._where(full))

    def _root(self, link: LinkEntry, full: str) -> dict[str, float]:
        """Put the root where the model has it, fixed or free; return the positions of the joints that carry it."""
        place = self._where(WORLD).actInv(self._where(full))
        if self._base == "fixed":
            self.notes.append(
                f"The link {link.name!r}, which nothing joins to the world, is held; base=free lets it move."
            )
            self._add_link(link, full, 0, place)
            return {}
        index, row = 0, in_a_row(link.name, SIX)
        for name, joint in row:
            index = int(self.model.addJoint(index, joint, pin.SE3.Identity(), name))
        self._add_link(link, full, index, pin.SE3.Identity())
        return dict(zip((name for name, _ in row), six_positions(place), strict=True))

    def _add_joint(self, joint: _Joint, carrier: str, *, turned_round: bool) -> tuple[int, pin.SE3]:
        """Add a joint to the tree; turned round, it moves the same way about the opposite axis.

        Returns:
            The joint of the tree that carries the moved link, and the place of its origin there.
        """
        index, place = self._carriers[carrier]
        place, part = place * self._from(joint, carrier).inverse(), joint.frame.part
        for step in joint.steps[::-1] if turned_round else joint.steps:
            if self.model.nv >= MOST_FREEDOMS:
                part.refuse(f"{part.owner} is beyond the {MOST_FREEDOMS} degrees of freedom that a model may have")
            if has_joint(self.model, step.name):
                part.refuse(f"{part.owner} needs the name {step.name!r}, which is taken", "Choose another.")
            index = self._add_step(replace(step, axis=-step.axis) if turned_round else step, index, place)
            place = pin.SE3.Identity()
        return index, place

    def _add_step(self, step: _Step, carrier: int, place: pin.SE3) -> int:
        if step.kind == "ball":
            return int(self.model.addJoint(carrier, pin.JointModelSpherical(), place, step.name))
        bounds = [np.array([step.limits[key]]) for key in ("effort", "velocity", "lower", "upper")]
        # without a sign of zero: joints along an axis of their frame are Pinocchio's own kinds
        return int(self.model.addJoint(carrier, joint_along(step.kind, step.axis + 0.0), place, step.name, *bounds))

    def _add_link(self, link: LinkEntry, full: str, index: int, place: pin.SE3) -> None:
        self._carriers[full] = index, place
        if link.mass or link.inertia.any():
            body = pin.Inertia(link.mass, link.centre, np.zeros((3, 3)))
            body.inertia = link.inertia  # as written: Pinocchio's constructor refuses what is negative by rounding
            self.model.appendBodyToJoint(index, body, place)
        self.model.addBodyFrame(link.name, index, place, 0)

    def _add_marks(self) -> None:
        """Add the frames that the file names, except the world's."""
        for full in self.frames.marks:
            if full.startswith(f"{self.frames.main}::"):
                body = self.frames.body(full)
                index, place = self._carriers[body]
                place = place * self._where(body).actInv(self._where(full))
                self.model.addBodyFrame(self.frames.name(full), index, place, 0)

    def _loop_joint(self, joint: _Joint, counted: set[str]) -> LoopJoint:
        """Return a joint that closes a loop, in a frame with its z axis along the joint's.

        One whose position counts, or that is of no kind that closes loops, is added to the tree; its end, which weighs
        nothing, is welded to the child.
        """
        kind, ends, axes = LOOP_KINDS.get(joint.kind, ""), (joint.parent, joint.child), joint.axes
        is_skew = kind == "universal" and abs(axes[0] @ axes[1]) > SAME_DIRECTION
        if not kind or is_skew or not counted.isdisjoint(step.name for step in joint.steps):
            index, place = self._add_joint(joint, joint.parent, turned_round=False)
            end = f"{joint.name}::end"
            self.model.addBodyFrame(end, index, place * self._from(joint, joint.child), 0)
            return LoopJoint(joint.name, "weld", (end, self.frames.name(joint.child)))
        # rows of a ball or weld are along the joint's own axes
        place = pin.SE3(np.eye(3) if axes else joint.place[:3, :3], joint.place[:3, 3])
        places = [self._where(end).actInv(place).homogeneous for end in ends]
        if limited := [step.name for step in joint.steps if step.limits != UNLIMITED]:
            self.notes.append(f"The limits of {', '.join(limited)}, which closes a loop, are left out.")
        names = self.frames.name(ends[0]), self.frames.name(ends[1])
        along = axes or (np.eye(3)[2],)
        return joint_between(joint.name, kind, names, places, (along[0], along[-1]))

    def _report(self) -> None:
        """Add notes on the forces of the file that are active, and on ignored content."""
        if names := ", ".join(self.loads):
            self.notes.append(f"In force: damping, friction and springs of {names}.")
        if self._assumed:
            what = "Of mass and moments of inertia the file leaves something out, which are SDF's own 1 kg and 1 kg·m²:"
            self.notes.append(f"{what} {', '.join(self._assumed)}.")
        if listed := "; ".join(f"{what} of {', '.join(names)}" for what, names in self._ignored.items()):
            self.notes.append(f"{NOT_IN_FORCE} {listed}.")
        if any(frame.part.parts("collision") for frame in self.frames.links.values()):
            self.notes.append("Contacts are not modelled.")
        self.notes += self.frames.notes
