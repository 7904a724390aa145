"""Read SDF, the models of Gazebo: links in the frame of the model, and joints between them, loops included.

A tree is taken out of the joints, each link by its first parent; a link that has no parent left is carried the other
way round. Every other joint closes a loop, by the rows of its own type; a gearbox couples two joints. A subset of the
format, from version 1.5 on; what else changes the mechanics is refused by name, file and line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from redundancy_pin.arrays import LARGEST, Array, decimal
from redundancy_pin.errors import ModelFileError, did_you_mean, shown
from redundancy_pin.robot.formats.mechanism import (
    NOT_IN_FORCE,
    UNLIMITED,
    JointEntry,
    LinkEntry,
    Mechanism,
    impossible_moments,
    mechanism_of_tree,
    six_joints,
)
from redundancy_pin.robot.formats.xml_files import Element, parsed
from redundancy_pin.robot.loads import JointForces
from redundancy_pin.robot.loop_joints import placed
from redundancy_pin.robot.types import Closure, Coupling

_SAME_DIRECTION = 1e-6
_UNLIMITED = 1e15
"""SDF writes 1e16 where there is no limit, and −1 for speeds and efforts."""

_PARTS = {
    "model": ("link", "joint", "pose", "self_collide", "static", "allow_auto_disable", "enable_wind", "plugin"),
    "link": (
        *("pose", "inertial", "visual", "collision", "self_collide", "kinematic", "gravity", "enable_wind", "sensor"),
        *("velocity_decay", "light", "must_be_base_link", "audio_sink", "audio_source", "projector"),
    ),
    "inertial": ("pose", "mass", "inertia"),
    "joint": (
        *("pose", "parent", "child", "axis", "axis2", "physics", "sensor"),
        *("gearbox_ratio", "gearbox_reference_body"),
    ),
    "axis": ("xyz", "limit", "dynamics", "use_parent_model_frame", "initial_position"),
    "limit": ("lower", "upper", "effort", "velocity", "stiffness", "dissipation"),
    "dynamics": ("damping", "friction", "spring_reference", "spring_stiffness"),
}
_KINDS = ("revolute", "continuous", "prismatic", "ball", "fixed", "universal", "gearbox")
_ROWS = {
    "revolute": ("x", "y", "z", "rx", "ry"),
    "continuous": ("x", "y", "z", "rx", "ry"),
    "prismatic": ("x", "y", "rx", "ry", "rz"),
    "ball": ("x", "y", "z"),
    "fixed": ("x", "y", "z", "rx", "ry", "rz"),
    "universal": ("x", "y", "z", "rz"),
}
"""Rows of a joint that closes a loop, in a frame with its z axis along the joint's."""


def read_sdf(path: Path, *, actuated: str = "", base: str = "fixed") -> Mechanism:
    """Read a model of Gazebo.

    Args:
        path: the file.
        actuated: names of the joints that are driven, with commas between; SDF itself does not say.
        base: "fixed" to hold the first link, or that on the world, where it is; "free" to let it move.

    Raises:
        ModelFileError: naming file and line: a file that is none, or what this reader does not know.
    """
    return _Reader(path, base).mechanism([name.strip() for name in actuated.split(",") if name.strip()])


@dataclass(frozen=True)
class _Joint:
    """A joint of the file, its frame and axes in that of the model."""

    element: Element
    name: str
    kind: str
    parent: str
    child: str
    frame: Array
    axes: tuple[Array, ...]
    limits: tuple[dict[str, float], ...]


class _Reader:
    """What is gathered on the way through a file."""

    def __init__(self, path: Path, base: str) -> None:
        self.path, self._base = path, base
        self.notes: list[str] = []
        self._forces: dict[str, list[str]] = {}
        self.loads: dict[str, JointForces] = {}
        root = parsed(path)
        if root.tag != "sdf":
            self.refuse(root, f"the top element is <{root.tag}>, not <sdf>", "Pass a model of Gazebo.")
        version = root.get("version", "")
        if not re.fullmatch(r"1\.(\d+)(\..*)?", version) or int(version.split(".")[1]) < 5:
            self.refuse(root, f"it is SDF of version {shown(version)}", "Write it as version 1.5 or newer.")
        self._in_model = int(version.split(".")[1]) <= 6
        """Whether an axis may say that it is in the frame of the model."""
        models = [child for child in root if isinstance(child, Element)]
        if len(models) != 1 or models[0].tag != "model":
            names = ", ".join(str(each.tag) for each in models[:5])
            self.refuse(root, f"it holds {names or 'nothing'}", "Pass a file with one <model>.")
        self.model = models[0]
        self._require_known(self.model)
        self.elements = {kind: self._named(kind) for kind in ("link", "joint")}
        if not self.elements["link"]:
            self.refuse(self.model, "the model has no links")
        self._resolving: list[str] = []
        if self.model.get("placement_frame") or self._relative_to(self.model, "world") != "world":
            # either puts the model elsewhere than its pose says, and turns it in gravity
            self.refuse(self.model, "the model has placement_frame, or a pose relative to a frame", "Say its own pose.")
        self.world = self._own_pose(self.model)
        self.places = {name: self._place(name) for name in self.elements["link"]}
        """Placement (4, 4) of each link in the model."""

    def refuse(self, element: Element, what: str, remedy: str = "") -> NoReturn:
        """Refuse the file, at the line of an element."""
        raise ModelFileError(
            f"{self.path.name}, line {element.line}: {what}.",
            remedy=remedy or "Take it out, or write the model without it.",
            path=str(self.path),
            line=element.line,
        )

    # --- elements -----------------------------------------------------------------------------------------------------

    def _require_known(self, element: Element, what: str = "") -> None:
        known = _PARTS["axis" if element.tag == "axis2" else str(element.tag)]
        for child in element:
            if child.tag not in known and isinstance(child, Element):
                name = what or f"the {element.tag}"
                self.refuse(child, f"{name} has <{child.tag}>, which is not covered", did_you_mean(child.tag, known))

    def _children(self, element: Element, tag: str) -> Iterator[Element]:
        return (child for child in element if child.tag == tag and isinstance(child, Element))

    def _one(self, element: Element, tag: str) -> Element | None:
        children = list(self._children(element, tag))
        if len(children) > 1:
            self.refuse(children[1], f"<{element.tag}> has <{tag}> {len(children)} times", "Leave one.")
        return children[0] if children else None

    def _named(self, kind: str) -> dict[str, Element]:
        result: dict[str, Element] = {}
        for element in self._children(self.model, kind):
            name = element.get("name", "")
            if not name or not name.isprintable() or name != name.strip() or len(name) > 255 or "::" in name:
                self.refuse(element, f"a {kind} has the name {shown(name)}", "Choose another.")
            if name in result or name in ("world", "universe", "__model__"):
                self.refuse(element, f"a {kind} has the name {name!r}, which is taken", "Choose another.")
            result[name] = element
        return result

    def _text(self, element: Element, tag: str, default: str | None = None) -> str:
        child = self._one(element, tag)
        text = default if child is None else (child.text or "").strip()
        if text is None or (child is not None and len(child)):
            self.refuse(element if child is None else child, f"<{element.tag}> has no {tag}", "Add it.")
        return text

    def _numbers(self, element: Element, text: str, count: int) -> Array:
        try:
            values = [decimal(part) for part in text.split()]
        except ValueError:
            values = []
        if len(values) != count or not all(abs(value) < LARGEST for value in values):
            self.refuse(element, f"{shown(text)} is not {count} finite number(s)", "Correct it.")
        return np.array(values)

    def _number(self, element: Element, tag: str, default: str | None = None) -> float:
        return float(self._numbers(self._one(element, tag) or element, self._text(element, tag, default), 1)[0])

    def _flag(self, element: Element, tag: str, default: str = "0") -> bool:
        text = self._text(element, tag, default) or default
        if text.lower() not in ("0", "1", "false", "true"):
            self.refuse(self._one(element, tag) or element, f"<{tag}> is {shown(text)}", "Write true or false.")
        return text.lower() in ("1", "true")

    # --- poses --------------------------------------------------------------------------------------------------------

    def _own_pose(self, element: Element) -> Array:
        """Return the (4, 4) placement that <pose> says, whatever it is relative to: R_z R_y R_x."""
        pose = self._one(element, "pose")
        if pose is None:
            return np.eye(4)
        if pose.get("rotation_format", "euler_rpy") != "euler_rpy" or pose.get("degrees", "false") != "false":
            self.refuse(pose, "a pose of another form than xyz and roll, pitch, yaw in radians", "Write it so.")
        if set(pose.attrib) - {"frame", "relative_to", "rotation_format", "degrees"}:
            self.refuse(pose, f"a pose with {', '.join(sorted(pose.attrib))}")
        x, y, z, roll, pitch, yaw = self._numbers(pose, (pose.text or "").strip() or "0 0 0 0 0 0", 6).tolist()
        (a, b, c), (sa, sb, sc) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
        about_x = np.array([[1.0, 0.0, 0.0], [0.0, a, -sa], [0.0, sa, a]])
        about_y = np.array([[b, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, b]])
        about_z = np.array([[c, -sc, 0.0], [sc, c, 0.0], [0.0, 0.0, 1.0]])
        return placed(about_z @ about_y @ about_x, np.array([x, y, z]))

    def _relative_to(self, element: Element, default: str) -> str:
        pose = self._one(element, "pose")
        given = "" if pose is None else pose.get("relative_to", pose.get("frame", ""))
        return given or default

    def _place(self, name: str, kinds: tuple[str, ...] = ("link", "joint")) -> Array:
        """Return the (4, 4) placement of a link or joint in the model; before SDF 1.7 both may have one name."""
        if name == "__model__":
            return np.eye(4)
        element = next((self.elements[kind][name] for kind in kinds if name in self.elements[kind]), None)
        if element is None or (key := f"{element.tag} {name}") in self._resolving or len(self._resolving) > 100:
            self.refuse(self.model, f"a pose is relative to {name!r}: no link or joint, or back to itself")
        default = "__model__" if element.tag == "link" else self._text(element, "child")
        self._resolving.append(key)
        within = self._relative_to(element, default)
        result: Array = self._place("__model__" if within == "world" else within) @ self._own_pose(element)
        self._resolving.pop()
        return result

    # --- links and joints ---------------------------------------------------------------------------------------------

    def _link(self, name: str) -> LinkEntry:
        element = self.elements["link"][name]
        self._require_known(element, f"the link {name!r}")
        if not self._flag(element, "gravity", "1"):
            self.refuse(element, f"the link {name!r} has no gravity, which is not covered")
        if self._flag(element, "kinematic") or self._flag(element, "enable_wind"):
            self.refuse(element, f"the link {name!r} is kinematic or in the wind, which is not covered")
        decay = self._one(element, "velocity_decay")
        if decay is not None and any(float(self._number(decay, key, "0")) for key in ("linear", "angular")):
            self._forces.setdefault("velocity decay", []).append(name)
        inertial = self._one(element, "inertial")
        if inertial is None or self._one(inertial, "mass") is None or self._one(inertial, "inertia") is None:
            remedy = "Say it: without, SDF takes 1 kg and 1 kg·m²."
            self.refuse(element, f"the link {name!r} has no inertial with mass and inertia", remedy)
        self._require_known(inertial, f"the inertial of {name!r}")
        if set(inertial.attrib) or self._relative_to(inertial, ""):
            self.refuse(inertial, f"the inertial of {name!r} has attributes, or a pose relative to another frame")
        tensor = self._one(inertial, "inertia")
        mass = self._number(inertial, "mass")
        inertia = np.zeros((3, 3))
        for i, first in enumerate("xyz"):
            for j, second in enumerate("xyz"):
                key = "i" + "".join(sorted(first + second))
                inertia[i, j] = self._number(tensor, key, "0" if i != j else None) if tensor is not None else 0.0
        moments = np.linalg.eigvalsh(inertia)
        if mass < 0.0 or moments[0] < -1e-12:
            self.refuse(inertial, f"the link {name!r} has the mass {mass:g} and the moments {moments}", "Correct it.")
        place = self._own_pose(inertial)
        turn = place[:3, :3]
        link = LinkEntry(name, mass, place[:3, 3], turn @ inertia @ turn.T)
        self.notes += impossible_moments([link])
        return link

    def _joint(self, name: str) -> _Joint:
        element = self.elements["joint"][name]
        kind = element.get("type", "")
        if kind not in _KINDS:
            remedy = f"Covered are {', '.join(_KINDS)}."
            self.refuse(element, f"the joint {name!r} has the type {shown(kind)}, which is not covered", remedy)
        self._require_known(element, f"the joint {name!r}")
        ends = []
        for role in ("parent", "child"):
            link = self._text(element, role)
            if link not in self.elements["link"] and link != "world":
                remedy = did_you_mean(link, self.elements["link"]).strip()
                self.refuse(element, f"the joint {name!r} has the {role} {shown(link)}, which is no link", remedy)
            ends.append(link)
        if ends[0] == ends[1]:
            self.refuse(element, f"the joint {name!r} has one link at both ends")
        frame, axes, limits = self._place(name, ("joint",)), [], []
        wanted = {"revolute": 1, "continuous": 1, "prismatic": 1, "universal": 2, "gearbox": 2}.get(kind, 0)
        for number, tag in enumerate(("axis", "axis2")):
            axis = self._one(element, tag)
            if axis is None and number < wanted:
                self.refuse(element, f"the joint {name!r} has no {tag}", "Add it.")
            if axis is None:
                continue
            self._require_known(axis, f"the joint {name!r}")
            self._read_forces(axis, name, kind)
            if self._number(axis, "initial_position", "0"):
                self.notes.append(f"The initial position of {name!r} is not read: joints are at zero where links are.")
            if number >= wanted:  # damping of a ball is said there; a direction means nothing
                continue
            axes.append(self._direction(axis, name, frame))
            limits.append(self._limits(axis, kind))
        if len(limits) == 1 and limits[0]["lower"] == limits[0]["upper"]:
            if limits[0]["lower"] != 0.0:
                self.refuse(
                    element, f"the joint {name!r} is held at {limits[0]['lower']:g}, not where the model has it"
                )
            self.notes.append(f"The joint {name!r} has the limits 0 and 0: it is fixed.")
            kind, axes, limits = "fixed", [], []
        return _Joint(element, name, kind, ends[0], ends[1], frame, tuple(axes), tuple(limits))

    def _direction(self, axis: Element, name: str, frame: Array) -> Array:
        given = self._one(axis, "xyz")
        vector = np.array([0.0, 0.0, 1.0]) if given is None else self._numbers(given, (given.text or "").strip(), 3)
        length = float(np.linalg.norm(vector))
        if not length > 1e-12:
            self.refuse(axis, f"the joint {name!r} has an axis of length zero", "Correct it.")
        turn = frame[:3, :3]
        if given is not None and given.get("expressed_in"):
            turn = self._place(given.get("expressed_in", ""))[:3, :3]
        if self._flag(axis, "use_parent_model_frame"):
            if not self._in_model:
                self.refuse(axis, "use_parent_model_frame is no part of SDF 1.7 and newer", "Say expressed_in.")
            turn = np.eye(3)
        direction: Array = turn @ vector / length
        return direction

    def _limits(self, axis: Element, kind: str) -> dict[str, float]:
        result = dict(UNLIMITED)
        limit = self._one(axis, "limit")
        if limit is None:
            return result
        self._require_known(limit)
        for key in UNLIMITED:
            if self._one(limit, key) is None:
                continue
            text = self._text(limit, key)
            value = math.inf if text.lower().lstrip("+-") in ("inf", "infinity") else self._number(limit, key)
            is_end = key in ("lower", "upper")
            if abs(value) < _UNLIMITED and (kind != "continuous" if is_end else value >= 0.0):
                result[key] = value
        if result["lower"] > result["upper"]:
            what = f"the limits {result['lower']:g} and {result['upper']:g}, the lower above the upper"
            self.refuse(limit, what, "Correct them.")
        return result

    def _read_forces(self, axis: Element, name: str, kind: str) -> None:
        dynamics = self._one(axis, "dynamics")
        if dynamics is None:
            return
        self._require_known(dynamics)
        damping, friction, stiffness = (
            self._number(dynamics, key, "0") for key in ("damping", "friction", "spring_stiffness")
        )
        if not (damping or friction or stiffness):
            return
        if kind not in ("revolute", "continuous", "prismatic"):
            self._forces.setdefault("dynamics", []).append(name)
            return
        if min(damping, friction, stiffness) < 0.0:
            self.refuse(dynamics, f"the joint {name!r} has negative friction or stiffness", "Correct it.")
        rest = self._number(dynamics, "spring_reference", "0")
        self.loads[name] = JointForces(name, damping, friction, stiffness=stiffness, rest=rest)

    # --- the mechanism ------------------------------------------------------------------------------------------------

    def mechanism(self, driven: list[str]) -> Mechanism:
        """Return what the file describes."""
        links = {name: self._link(name) for name in self.elements["link"]}
        joints = [self._joint(name) for name in self.elements["joint"]]
        gears = [joint for joint in joints if joint.kind == "gearbox"]
        tree, loops = self._spanning([joint for joint in joints if joint not in gears])
        self.links = {"world": LinkEntry("world", 0.0, np.zeros(3), np.zeros((3, 3)))}
        self.entries: list[JointEntry] = []
        start: dict[str, float | Array] = {}
        for joint, reversed_, carrier, carried in tree:
            if joint is None:
                start.update(self._root(carried, links[carried]))
            else:
                self._add(joint, reversed_, carrier, links[carried])
        closures = tuple(self._closure(joint) for joint in loops)
        moving = {entry.name: entry for entry in self.entries if entry.kind in ("revolute", "prismatic")}
        for name in driven:
            if name not in moving:
                remedy = f"{did_you_mean(name, moving)}Its joints of one freedom: {', '.join(moving)}."
                self.refuse(
                    self.model, f"actuated names {shown(name)}, which is no joint that moves in the tree", remedy
                )
        loads = tuple(load for load in self.loads.values() if load.joint in moving)
        cut = [name for name in self.loads if name not in moving]  # joints that close loops, or that are held
        if cut:
            self._forces.setdefault("dynamics", []).extend(cut)
        if loads:
            names = ", ".join(load.joint for load in loads)
            self.notes.append(f"In force: damping, friction and springs of {names}.")
        self._say()
        return mechanism_of_tree(
            self.model.get("name") or self.path.stem,
            self.links,
            tuple(self.entries),
            closures,
            tuple(driven) or self._candidates(moving.values()),
            np.array([0.0, 0.0, -9.81]),
            start,
            path=str(self.path),
            forces=loads,
            notes=tuple(self.notes),
            drives_declared=bool(driven),
            couplings=tuple(self._gears(gear, [joint for joint, *_ in tree if joint]) for gear in gears),
        )

    def _gears(self, gear: _Joint, joints: list[_Joint]) -> Coupling:
        """Return θ₂ = −ratio θ₁: angles from the reference body to parent (θ₁, about axis) and child (about axis2)."""
        reference, ratio = (
            self._text(gear.element, "gearbox_reference_body"),
            self._number(gear.element, "gearbox_ratio"),
        )
        ends = []
        for link, axis in zip((gear.parent, gear.child), gear.axes, strict=True):
            between = [joint for joint in joints if {joint.parent, joint.child} == {reference, link}]
            along = (
                float(between[0].axes[0] @ axis) if between and between[0].kind in ("revolute", "continuous") else 0.0
            )
            if abs(abs(along) - 1.0) > _SAME_DIRECTION:
                what = (
                    f"the gearbox {gear.name!r} needs a hinge of the tree about its axis from {reference!r} to {link!r}"
                )
                self.refuse(gear.element, what, "Add it, or correct the gearbox.")
            ends.append(
                (between[0].name, math.copysign(1.0, along) * (1.0 if between[0].parent == reference else -1.0))
            )
        (of, first), (name, second) = ends
        return Coupling(gear.name, name, of, (0.0, -ratio * first * second))

    def _spanning(self, joints: list[_Joint]) -> tuple[list[tuple[_Joint | None, bool, str, str]], list[_Joint]]:
        """Return the tree, each joint with whether it is turned round, its carrier and what it carries; and the rest.

        A root without a joint to the world is carried by it, by no joint.
        """
        first: dict[str, _Joint] = {}
        for joint in joints:
            first.setdefault(joint.child, joint)
        tree: list[tuple[_Joint | None, bool, str, str]] = []
        reached, rest = {"world"}, list(joints)

        def grow() -> None:
            while True:
                joint = next(
                    (j for j in rest if j.parent in reached and j.child not in reached and first[j.child] is j), None
                )
                joint = joint or next((j for j in rest if (j.parent in reached) != (j.child in reached)), None)
                if joint is None:
                    return
                back = joint.parent not in reached
                carrier, carried = (joint.child, joint.parent) if back else (joint.parent, joint.child)
                tree.append((joint, back, carrier, carried))
                reached.add(carried)
                rest.remove(joint)

        grow()
        while len(reached) <= len(self.elements["link"]):
            left = [name for name in self.elements["link"] if name not in reached]
            if tree:
                element = self.elements["link"][left[0]]
                self.refuse(element, f"the link {left[0]!r} is joined to nothing that is joined to the base")
            root = next((name for name in left if name not in first), left[0])
            tree.append((None, False, "world", root))
            reached.add(root)
            grow()
        return tree, rest

    def _root(self, name: str, link: LinkEntry) -> dict[str, float | Array]:
        """Put the root where the model has it, held or free."""
        self.links[name] = link
        place = self.world @ self.places[name]
        if self._base == "fixed":
            self.entries.append(JointEntry(f"{name}::fixed", "fixed", "world", name, place, np.zeros(3), {}))
            self.notes.append(f"The link {name!r}, which nothing joins to the world, is held; base=free lets it move.")
            return {}
        made, start = six_joints(name, "world", name, place)
        self.entries += made
        for entry in made[:-1]:
            self.links[entry.child] = LinkEntry(entry.child, 0.0, np.zeros(3), np.zeros((3, 3)))
        return dict(start)

    def _where(self, link: str) -> Array:
        """Return the (4, 4) placement of a link, or the world, in the model."""
        return np.asarray(np.linalg.inv(self.world) if link == "world" else self.places[link])

    def _add(self, joint: _Joint, back: bool, carrier: str, link: LinkEntry) -> None:
        """Add a joint to the tree; turned round, it moves the same way about the opposite axis."""
        parent = carrier
        at = np.linalg.inv(self._where(carrier)) @ placed(np.eye(3), joint.frame[:3, 3])
        behind = placed(np.eye(3), joint.frame[:3, 3])  # axes of the model, at the joint
        kind = {"continuous": "revolute"}.get(joint.kind, joint.kind)
        axes, limits = (joint.axes[::-1], joint.limits[::-1]) if back else (joint.axes, joint.limits)
        if kind == "universal":
            steps = [(f"{joint.name}_{i + 1}", "revolute") for i in ((1, 0) if back else (0, 1))]
        else:
            steps = [(joint.name, kind)] if kind != "fixed" else []
        for number, (name, step) in enumerate(steps):
            axis = np.zeros(3) if step == "ball" else axes[number] * (-1.0 if back else 1.0)
            child = f"{name}::link"
            self.links[child] = LinkEntry(child, 0.0, np.zeros(3), np.zeros((3, 3)))
            bounds = UNLIMITED if step == "ball" else limits[number]
            self.entries.append(JointEntry(name, step, parent, child, at, axis, bounds))
            parent, at = child, np.eye(4)
        rest = at @ np.linalg.inv(behind) @ self._where(link.name)
        self.links[link.name] = link
        self.entries.append(JointEntry(f"{link.name}::fixed", "fixed", parent, link.name, rest, np.zeros(3), {}))

    def _closure(self, joint: _Joint) -> Closure:
        if joint.kind == "universal":
            first, second = joint.axes
            normal = np.cross(second, first)
            if not np.linalg.norm(normal) > 1e-6 or abs(first @ second) > 1e-6:
                self.refuse(joint.element, f"the joint {joint.name!r} has axes that are not at right angles")
            turn = np.column_stack([second, first, normal])
        elif joint.axes:
            z = joint.axes[0]
            x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
            x = x / np.linalg.norm(x)
            turn = np.column_stack([x, np.cross(z, x), z])
        else:
            turn = joint.frame[:3, :3]
        place, names = placed(turn, joint.frame[:3, 3]), []
        for number, link in enumerate((joint.parent, joint.child)):
            names.append(f"{joint.name}::{number + 1}")
            self.links[names[-1]] = LinkEntry(names[-1], 0.0, np.zeros(3), np.zeros((3, 3)))
            at = np.linalg.inv(self._where(link)) @ place
            self.entries.append(JointEntry(f"{names[-1]}::fixed", "fixed", link, names[-1], at, np.zeros(3), {}))
        return Closure(joint.name, names[0], names[1], _ROWS[joint.kind])

    def _candidates(self, joints: Iterable[JointEntry]) -> tuple[str, ...]:
        """Return the joints that may be meant to be driven: with a limit of effort, else with bounds; no springs."""
        free = [joint for joint in joints if not (load := self.loads.get(joint.name)) or not load.stiffness]
        strong = [joint.name for joint in free if 0.0 < joint.limits["effort"] < math.inf]
        bounded = [joint.name for joint in free if math.isfinite(joint.limits["upper"])]
        return tuple(strong or bounded or [joint.name for joint in free])

    def _say(self) -> None:
        if self._flag(self.model, "static"):
            self.refuse(self.model, "the model is static: nothing of it moves")
        for plugin in self._children(self.model, "plugin"):
            self.notes.append(f"The plugin {plugin.get('name', '')!r} does not run.")
        listed = "; ".join(f"{what} of {', '.join(names)}" for what, names in self._forces.items())
        if listed:
            self.notes.append(f"{NOT_IN_FORCE} {listed}.")
        collisions = any(
            next(self._children(link, "collision"), None) is not None for link in self.elements["link"].values()
        )
        if collisions:
            self.notes.append("Contacts are not modelled.")
