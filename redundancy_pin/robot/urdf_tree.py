"""A second reader of URDFs, by their specification: what urdfdom would leave out or guess is an error here.

urdfdom drops an inertial element that it cannot parse and goes on, so that a typing error makes a massless link.
"""

from __future__ import annotations

import difflib
import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array
from redundancy_pin.errors import ModelFileError, did_you_mean
from redundancy_pin.robot.xml_files import Element, parsed_text

MOST_LINKS = 2000
"""Links of a robot: urdfdom looks each up among all."""

DEEPEST_CHAIN = 200
"""Links in a row. urdfdom and Pinocchio go down by recursion: 10,000 end the process where the stack has 8 MB."""

MOST_FREEDOMS = 120
"""Joint velocities. Pinocchio's data grow with their cube: 0.1 GB with 100 of them, 1.6 GB with 300."""

_LARGEST = 1e100
"""Lengths, masses, and inertias beyond it are refused as infinite: their products are."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)

_FREEDOMS = {"fixed": 0, "revolute": 1, "continuous": 1, "prismatic": 1, "planar": 3, "floating": 6}

_PARTS: Mapping[str, tuple[str, ...]] = {
    "robot": ("link", "joint", "material", "transmission", "gazebo"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic", "dynamics", "calibration", "safety_controller"),
    "inertial": ("origin", "mass", "inertia"),
}
_ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "axis": ("xyz",),
    "parent": ("link",),
    "child": ("link",),
    "limit": ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"),
}

_TRIANGLE_TOLERANCE = 1e-6
"""A moment of inertia may exceed the sum of the other two by this fraction: files carry six digits."""

_ROUNDING = 1e-9
"""Relative difference of what two readers make of the same numbers."""

_NOTHING = 1e-15
"""SI units. Pinocchio takes a mass below 2e-16 kg for that where it divides by it, to find a centre of mass."""


@dataclass(frozen=True)
class LinkEntry:
    """A link of a file.

    Attributes:
        name: its name.
        mass: kg.
        centre: (3,) centre of mass in the frame of the link, m.
        inertia: (3, 3) about the centre of mass, in the axes of the link, kg·m².
    """

    name: str
    mass: float
    centre: Array
    inertia: Array


@dataclass(frozen=True)
class JointEntry:
    """A joint of a file: its (4, 4) placement in the frame of the parent link, its axis of length 1, its limits."""

    name: str
    kind: str
    parent: str
    child: str
    placement: Array
    axis: Array
    limits: Mapping[str, float]


@dataclass(frozen=True)
class Tree:
    """The links of a file by name, its joints, each after those that carry it, and the lines of both."""

    root: str
    links: Mapping[str, LinkEntry]
    joints: tuple[JointEntry, ...]
    lines: Mapping[tuple[str, str], int]


def read_tree(urdf: str, path: Path) -> Tree:
    """Read a URDF.

    Args:
        urdf: its text.
        path: the file that it comes from, for messages.

    Raises:
        ModelFileError: naming the file, the line, and the link or joint: numbers that are none, elements that are
            missing, there twice or misspelt; names that are; masses and inertias that no body has; links that make no
            tree; a joint that mimics another; more links or freedoms than a model may have.
    """
    return _Reader(path).tree(parsed_text(urdf, str(path)))


class _Reader:
    """Reads one file; its messages name it."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def refuse(self, element: Element, message: str, remedy: str = "", **details: object) -> NoReturn:
        """Refuse the file, at the line of an element."""
        place = f"line {element.line}" + (" of what xacro makes of it" if self._path.suffix == ".xacro" else "")
        if self._path.name not in message:
            place = f"{self._path.name}, {place}"
        raise ModelFileError(
            f"{message} ({place}).",
            remedy=remedy or "Correct the URDF, or the xacro arguments it is made from.",
            path=str(self._path),
            line=element.line,
            **details,
        )

    def tree(self, robot: Element) -> Tree:
        if robot.tag != "robot":
            self.refuse(robot, f"The top element of {self._path.name} is <{_short(robot.tag)}>, not <robot>")
        self._require_known_parts(robot, "The robot")
        elements = {kind: list(_children(robot, kind)) for kind in ("link", "joint")}
        if len(elements["link"]) > MOST_LINKS:
            count = len(elements["link"])
            self.refuse(robot, f"The robot has {count} links, more than the {MOST_LINKS} that a model may have")
        for kind, listed in elements.items():
            self._require_names(kind, listed)
        links = {str(element.get("name")): self._link(element) for element in elements["link"]}
        joints = {str(element.get("name")): self._joint(element, links) for element in elements["joint"]}
        freedoms = sum(_FREEDOMS[joint.kind] for joint in joints.values())
        if freedoms > MOST_FREEDOMS:
            self.refuse(robot, f"The joints have {freedoms} freedoms, more than the {MOST_FREEDOMS} of a model")
        return self._in_order(robot, links, elements["joint"], joints)

    def _require_names(self, kind: str, elements: Sequence[Element]) -> None:
        lines: dict[str, int] = {}
        for element in elements:
            name = element.get("name")
            if not name or not name.isprintable() or name != name.strip():
                self.refuse(element, f"A {kind} has the name {_short(repr(name))}")
            if len(name) > 255:
                self.refuse(element, f"The {kind} {_short(name)!r} has a name of {len(name)} characters")
            if kind == "joint" and name == "universe":
                self.refuse(element, "A joint has the name 'universe', which Pinocchio gives to the world", name=name)
            if name in lines:
                self.refuse(element, f"There are two {kind}s {name!r}, the first in line {lines[name]}", name=name)
            lines[name] = element.line

    def _link(self, element: Element) -> LinkEntry:
        name = str(element.get("name"))
        owner = f"The link {name!r} of {self._path.name}"
        self._require_known_parts(element, owner)
        inertial = self._one(element, "inertial", owner)
        if inertial is None:
            return LinkEntry(name, 0.0, np.zeros(3), np.zeros((3, 3)))
        self._require_known_parts(inertial, owner)
        mass = self._one(inertial, "mass", owner)
        if mass is None:
            self.refuse(inertial, f"{owner} has no mass", link=name)
        inertia = self._one(inertial, "inertia", owner)
        if inertia is None:
            self.refuse(inertial, f"{owner} has no inertia", link=name)
        kilograms = self._number(mass, "value", f"{owner} has the mass", link=name)
        if kilograms < 0.0:
            self.refuse(mass, f"{owner} has a negative mass, {kilograms:g} kg", link=name)
        matrix = np.array(
            [
                [
                    self._number(inertia, key := "i" + "".join(sorted(a + b)), f"{owner} has the {key}", link=name)
                    for b in "xyz"
                ]
                for a in "xyz"
            ]
        )
        moments = np.linalg.eigvalsh(matrix)
        allowed = _TRIANGLE_TOLERANCE * float(np.abs(moments).max())
        if moments[0] < -allowed or moments[2] > moments[0] + moments[1] + allowed:
            text = np.array2string(moments, precision=4)
            self.refuse(inertia, f"{owner} has principal moments of inertia {text} that no body can have", link=name)
        placement = self._placement(inertial, owner, link=name)
        turn = placement[:3, :3]
        return LinkEntry(name, kilograms, placement[:3, 3], turn @ matrix @ turn.T)

    def _joint(self, element: Element, links: Mapping[str, LinkEntry]) -> JointEntry:
        name, kind = str(element.get("name")), element.get("type", "")
        owner = f"The joint {name!r} of {self._path.name}"
        if kind not in _FREEDOMS:
            hint = did_you_mean(kind, _FREEDOMS)
            remedy = f"{hint}There are: {', '.join(_FREEDOMS)}."
            self.refuse(element, f"{owner} has the type {_short(kind)!r}", remedy, joint=name)
        self._require_known_parts(element, owner)
        if element.find("mimic") is not None:
            remedy = "Build the coupling as a loop, or make the joint free or fixed."
            self.refuse(element, f"{owner} mimics another, which closed chains do not cover", remedy, joint=name)
        ends = []
        for role in ("parent", "child"):
            part = self._one(element, role, owner)
            link = "" if part is None else part.get("link", "")
            if link not in links:
                what = f"the {role} {_short(link)!r}, which is no link" if link else f"no {role}"
                self.refuse(element, f"{owner} has {what}", did_you_mean(link, links), joint=name, link=link)
            ends.append(link)
        axis = np.array([1.0, 0.0, 0.0])  # as the specification has it
        given = self._one(element, "axis", owner)
        # urdfdom looks at no axis of the other kinds
        if given is not None and kind not in ("fixed", "floating"):
            axis = np.array(self._triple(given, "xyz", f"{owner} has the axis", joint=name))
            length = float(np.linalg.norm(axis))
            if not length > 0.0:
                self.refuse(given, f"{owner} has an axis of length zero", joint=name)
            axis = axis / length
        if kind == "planar" and axis[2] != 1.0:
            self.refuse(
                element, f"{owner} is planar about another axis than z, which Pinocchio does not know", joint=name
            )
        limits = self._limits(element, kind, owner, name)
        return JointEntry(name, kind, ends[0], ends[1], self._placement(element, owner, joint=name), axis, limits)

    def _limits(self, element: Element, kind: str, owner: str, name: str) -> Mapping[str, float]:
        limit = self._one(element, "limit", owner)
        if limit is None:
            if kind in ("revolute", "prismatic"):
                self.refuse(element, f"{owner} is {kind} and has no <limit>", joint=name)
            return {}
        return {
            key: self._number(limit, key, f"{owner} has the {key} limit", sys.float_info.max, joint=name)
            if key in limit.attrib or key in ("effort", "velocity")
            else 0.0
            for key in ("lower", "upper", "effort", "velocity")
        }

    def _placement(self, element: Element, owner: str, **details: str) -> Array:
        """Return the (4, 4) placement that the origin of an element gives."""
        placement: Array = np.eye(4)
        origin = self._one(element, "origin", owner)
        if origin is not None:
            if "quat_xyzw" in origin.attrib:
                self.refuse(origin, f"{owner} has an origin with quat_xyzw", "Write the rotation as rpy.", **details)
            if "xyz" in origin.attrib:
                placement[:3, 3] = self._triple(origin, "xyz", f"{owner} has an origin with xyz", **details)
            if "rpy" in origin.attrib:
                angles = self._triple(origin, "rpy", f"{owner} has an origin with rpy", **details)
                placement[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
        return placement

    def _triple(self, element: Element, key: str, what: str, **details: str) -> list[float]:
        text = element.get(key, "")
        numbers = [_as_number(part, _LARGEST) for part in text.split()]
        if len(numbers) != 3 or None in numbers:
            remedy = "Write three numbers with blanks between them."
            self.refuse(element, f"{what} {_short(text)!r}, which is not three finite numbers", remedy, **details)
        return [number for number in numbers if number is not None]

    def _number(self, element: Element, key: str, what: str, most: float = _LARGEST, **details: str) -> float:
        text = element.get(key)
        number = _as_number((text or "").strip(), most)
        if number is None:
            shown = text if text is None else _short(text)
            self.refuse(element, f"{what} {shown!r}, which is not a finite number", **details)
        return number

    def _one(self, element: Element, tag: str, owner: str) -> Element | None:
        """Return a part of which there is at most one, its attributes known."""
        parts = list(_children(element, tag))
        if len(parts) > 1:
            self.refuse(parts[1], f"{owner} has <{tag}> {len(parts)} times")
        known = _ATTRIBUTES.get(tag, ())
        for key in parts[0].attrib if parts and known else ():
            if key not in known and (hint := did_you_mean(key.lower(), known)):
                self.refuse(parts[0], f"{owner} has <{tag}> with the attribute {_short(key)!r}", hint.strip())
        return parts[0] if parts else None

    def _require_known_parts(self, element: Element, owner: str) -> None:
        """Refuse what is nearly, but not quite, an element that counts: it would be passed over."""
        known = _PARTS[element.tag]
        for part in element:
            if part.tag not in known and (hint := _nearly(part.tag, known)):
                line = part if isinstance(part, Element) else element
                self.refuse(line, f"{owner} has an element <{_short(part.tag)}>", f"Did you mean {hint!r}?")

    def _in_order(
        self,
        robot: Element,
        links: Mapping[str, LinkEntry],
        elements: Sequence[Element],
        joints: Mapping[str, JointEntry],
    ) -> Tree:
        """Return the tree, from its root outwards."""
        carried: dict[str, str] = {}
        outwards: dict[str, list[JointEntry]] = {name: [] for name in links}
        for element, joint in zip(elements, joints.values(), strict=True):
            if joint.child in carried:
                what = (
                    f"The link {joint.child!r} is the child of two joints, {carried[joint.child]!r} and {joint.name!r}"
                )
                remedy = "Cut the loop: give the second joint a link of its own, and close it in the declaration."
                self.refuse(element, what, remedy, link=joint.child)
            carried[joint.child] = joint.name
            outwards[joint.parent].append(joint)
        roots = [name for name in links if name not in carried]
        if len(roots) > 1:
            names = ", ".join(map(repr, roots[:5]))
            remedy = "Join them by joints: a robot has one link that no joint carries."
            self.refuse(
                robot, f"The links are no tree: {names} are carried by no joint", remedy, links=tuple(roots[:5])
            )
        ordered: list[JointEntry] = []
        level, depth = roots, 0
        while level:
            if depth > DEEPEST_CHAIN:
                self.refuse(robot, f"More than {DEEPEST_CHAIN} links follow on one another", "Shorten the chain.")
            made = [joint for name in level for joint in outwards[name]]
            ordered += made
            level, depth = [joint.child for joint in made], depth + 1
        if len(ordered) + 1 < len(links) or not links:
            reached = {*roots, *(joint.child for joint in ordered)}
            circle = [name for name in links if name not in reached]
            if not circle:
                self.refuse(robot, "The robot has no links")
            names = ", ".join(map(repr, circle[:5]))
            remedy = "Cut the circle at a joint and close it in the declaration."
            self.refuse(robot, f"The links {names} carry one another in a circle", remedy, links=tuple(circle[:5]))
        lines = {(part.tag, str(part.get("name"))): part.line for part in robot if isinstance(part, Element)}
        return Tree(roots[0], links, tuple(ordered), lines)


def require_same(tree: Tree, model: pin.Model, path: Path) -> None:
    """Check that Pinocchio's model has the joints, axes, limits, frames and masses of the file.

    Raises:
        ModelFileError: naming the joint or link and the quantity that differs.
    """
    same = _Comparison(path)
    names = [str(name) for name in model.names]
    moving = [joint.name for joint in tree.joints if joint.kind != "fixed"]
    if sorted(names[1:]) != sorted(moving):
        raise same.refusal("the list of moving joints", sorted(names[1:]), sorted(moving))
    # each link: the moving joint that carries it, and where it is in the frame of that joint
    places: dict[str, tuple[int, Array]] = {tree.root: (0, np.eye(4))}
    for joint in tree.joints:
        carrier, place = places[joint.parent]
        placement = place @ joint.placement
        places[joint.child] = (carrier, placement)
        if joint.kind != "fixed":
            index = names.index(joint.name)
            places[joint.child] = (index, np.eye(4))
            what = f"of the joint {joint.name!r}"
            same.require(f"the parent {what}", int(model.parents[index]), carrier)
            same.require(f"the placement {what}", model.jointPlacements[index].homogeneous, placement)
            _require_same_joint(same, model, model.joints[index], joint)
    bodies: list[list[LinkEntry]] = [[] for _ in names]
    for link, (index, place) in places.items():
        bodies[index].append(_moved(tree.links[link], place))
        frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
        same.require(f"the joint that carries the link {link!r}", int(frame.parentJoint), index)
        same.require(f"the placement of the link {link!r}", frame.placement.homogeneous, place)
    for index, links in enumerate(bodies):
        what = f"of the body that {names[index]!r} carries" if index else "of the base"
        mass = math.fsum(link.mass for link in links)
        lever = sum((link.mass * link.centre for link in links), np.zeros(3))
        inertia = sum((_about_origin(link) for link in links), np.zeros((3, 3)))
        built = model.inertias[index]
        same.require(f"the mass {what}", built.mass, mass, scale=mass)
        same.require(f"mass times centre of mass {what}", built.mass * built.lever, lever, scale=mass)
        body = LinkEntry("", built.mass, built.lever, built.inertia)
        scale = mass + float(np.abs(inertia).max())
        same.require(f"the inertia {what}", _about_origin(body), inertia, scale=scale)


def _require_same_joint(same: _Comparison, model: pin.Model, built: pin.JointModel, joint: JointEntry) -> None:
    what = f"of the joint {joint.name!r}"
    same.require(f"the number of freedoms {what}", built.nv, _FREEDOMS[joint.kind])
    if built.nv != 1:
        return
    data, still = built.createData(), np.zeros(3)
    built.calc(data, pin.neutral(model), np.zeros(model.nv))
    twist = (joint.axis, still) if joint.kind == "prismatic" else (still, joint.axis)
    same.require(f"the axis {what}", np.ravel(data.S), np.concatenate(twist))
    if joint.limits:
        same.require(f"the effort limit {what}", model.upperEffortLimit[built.idx_v], joint.limits["effort"])
        same.require(f"the velocity limit {what}", model.upperVelocityLimit[built.idx_v], joint.limits["velocity"])
    if joint.limits and joint.kind != "continuous":  # of which Pinocchio bounds cosine and sine instead
        same.require(f"the lower limit {what}", model.lowerPositionLimit[built.idx_q], joint.limits["lower"])
        same.require(f"the upper limit {what}", model.upperPositionLimit[built.idx_q], joint.limits["upper"])


class _Comparison:
    """Compares what Pinocchio made of a file with what the file says."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def require(self, what: str, of_model: object, of_file: object, scale: float = 0.0) -> None:
        """Require numbers or arrays to be equal but for rounding; ``scale``: the size of what they were made from."""
        here, there = np.asarray(of_model, dtype=float), np.asarray(of_file, dtype=float)
        allowed = _NOTHING + _ROUNDING * max(scale, float(np.abs(there).max(initial=0.0)))
        if here.shape != there.shape or not bool((np.abs(here - there) <= allowed).all()):
            raise self.refusal(what, here.tolist(), there.tolist())

    def refusal(self, what: str, of_model: object, of_file: object) -> ModelFileError:
        return ModelFileError(
            f"Pinocchio does not read {self._path.name} as it stands: {what} is {of_model} in its model, "
            f"{of_file} in the file.",
            remedy="Write that part of the URDF in the plainest form, and report it.",
            path=str(self._path),
            what=what,
        )


def _moved(link: LinkEntry, place: Array) -> LinkEntry:
    turn = place[:3, :3]
    return LinkEntry(link.name, link.mass, place[:3, 3] + turn @ link.centre, turn @ link.inertia @ turn.T)


def _about_origin(link: LinkEntry) -> Array:
    """Return the (3, 3) inertia about the origin (Steiner)."""
    c = np.asarray(link.centre)
    moved: Array = np.asarray(link.inertia) + link.mass * (c @ c * np.eye(3) - np.outer(c, c))
    return moved


def _as_number(text: str, most: float) -> float | None:
    number = float(text) if _NUMBER.fullmatch(text) else math.nan
    return number if abs(number) <= most else None


def _children(element: Element, tag: str) -> Iterator[Element]:
    return (part for part in element if part.tag == tag and isinstance(part, Element))


def _nearly(name: str, known: Sequence[str]) -> str:
    """Return the name that another is a misspelling of; empty for names of extensions, which are far from all."""
    return next(iter(difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.8)), "")


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:77]}..."
