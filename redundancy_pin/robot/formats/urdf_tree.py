"""A second reader of URDFs, by their specification: what urdfdom would leave out or guess is an error here.

urdfdom drops an inertial element that it cannot parse and goes on, so that a typing error makes a massless link.
"""

from __future__ import annotations

import difflib
import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import NoReturn

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import LARGEST, Array
from redundancy_pin.errors import ModelFileError, did_you_mean
from redundancy_pin.robot.formats.xml_files import FORMATS, Element, parsed_text
from redundancy_pin.robot.lookup import find_link
from redundancy_pin.robot.types import Coupling

MOST_LINKS = 2000
"""Links of a robot: urdfdom looks each up among all."""

DEEPEST_CHAIN = 200
"""Links in a row. urdfdom and Pinocchio go down by recursion: 10,000 end the process where the stack has 8 MB."""

MOST_FREEDOMS = 120
"""Joint velocities. Pinocchio's data grow with their cube: 0.1 GB with 100 of them, 1.6 GB with 300."""


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)

_FREEDOMS = {"fixed": 0, "revolute": 1, "continuous": 1, "prismatic": 1, "planar": 3, "floating": 6}

_PARTS: Mapping[str, tuple[str, ...]] = {
    "robot": ("link", "joint", "material", "transmission", "gazebo"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic", "dynamics", "calibration", "safety_controller"),
    "inertial": ("origin", "mass", "inertia"),
}
_FRICTION = ("damping", "friction")

_ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "axis": ("xyz",),
    "parent": ("link",),
    "child": ("link",),
    "dynamics": _FRICTION,
    "limit": ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"),
    "mimic": ("joint", "multiplier", "offset"),
}

_TRIANGLE_TOLERANCE = 1e-6
"""A moment of inertia may exceed the sum of the other two by this fraction: files carry six digits."""

_NO_MOMENT = 1e-12
"""kg·m². Less is zero: exporters leave products of 1e-35 beside moments of nothing, as for iCub's head."""

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
        has_inertial: whether the file states mass and inertia; what it does not state is zero.
        has_shape: whether a URDF gives the link a visual or collision element.
    """

    name: str
    mass: float
    centre: Array
    inertia: Array
    has_inertial: bool = True
    has_shape: bool = False


@dataclass(frozen=True)
class JointEntry:
    """A joint of a file: its (4, 4) placement in the frame of the parent link, its axis of length 1, its limits.

    ``dynamics``: its damping, N·s/m or N·m·s, and friction, N or N·m, where the file gives them. ``mimic``: what it
    follows.
    """

    name: str
    kind: str
    parent: str
    child: str
    placement: Array
    axis: Array
    limits: Mapping[str, float]
    dynamics: Mapping[str, float] = field(default_factory=dict)
    mimic: Coupling | None = None


@dataclass(frozen=True)
class Tree:
    """The links of a file by name, its joints, each after those that carry it, and the lines of both."""

    root: str
    links: Mapping[str, LinkEntry]
    joints: tuple[JointEntry, ...]
    lines: Mapping[tuple[str, str], int]

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """What the joints that mimic others follow."""
        return tuple(joint.mimic for joint in self.joints if joint.mimic)


def read_tree(urdf: str, path: Path) -> Tree:
    """Read a URDF.

    Args:
        urdf: its text.
        path: the file that it comes from, for messages.

    Raises:
        ModelFileError: naming the file, the line, and the link or joint: numbers that are none, elements that are
            missing, there twice or misspelt; names that are; negative masses and moments of inertia; links that make no
            tree; a joint that mimics none; more links or freedoms than a model may have.
    """
    robot = _Part(parsed_text(urdf, str(path)), path, "The robot")
    if robot.element.tag != "robot":
        known = FORMATS.get(robot.element.tag)
        what = f": it is {known}" if known else ""
        remedy = "Convert it to URDF, or call it .xml, .mjcf or .sdf." if known else ""
        robot.refuse(f"The top element of {path.name} is <{_short(robot.element.tag)}>, not <robot>{what}", remedy)
    robot.require_known_parts()
    parts = {kind: robot.named(kind) for kind in ("link", "joint")}
    links = {name: _link(name, part) for name, part in parts["link"].items()}
    joints = {name: _joint(name, part, links) for name, part in parts["joint"].items()}
    for name, joint in joints.items():
        followed = joint.mimic and joint.mimic.of
        if followed and (followed == name or followed not in joints or not _FREEDOMS[joints[followed].kind]):
            remedy = did_you_mean(followed, joints).strip() or "Name another joint, which moves."
            parts["joint"][name].refuse(f"{parts['joint'][name].owner} mimics {followed!r}, which it cannot", remedy)
    freedoms = sum(_FREEDOMS[joint.kind] for joint in joints.values())
    if freedoms > MOST_FREEDOMS:
        robot.refuse(f"The joints have {freedoms} freedoms, more than the {MOST_FREEDOMS} of a model")
    lines = {(kind, name): part.element.line for kind in parts for name, part in parts[kind].items()}
    return Tree(*_in_order(robot, links, joints, parts["joint"]), lines)


@dataclass(frozen=True)
class _Part:
    """An element, the file that it is in, and the link or joint that it belongs to: for messages and their details."""

    element: Element
    path: Path
    owner: str
    details: Mapping[str, str] = field(default_factory=dict)

    def refuse(self, message: str, remedy: str = "", **details: object) -> NoReturn:
        """Refuse the file, at the line of the element."""
        line = self.element.line
        place = f"line {line}" + (" of what xacro makes of it" if self.path.suffix == ".xacro" else "")
        raise ModelFileError(
            f"{message} ({place if self.path.name in message else f'{self.path.name}, {place}'}).",
            remedy=remedy or "Correct the URDF, or the xacro arguments it is made from.",
            path=str(self.path),
            line=line,
            **self.details,
            **details,
        )

    def named(self, kind: str) -> dict[str, _Part]:
        """Return the links or joints of the robot by their names, which are checked."""
        parts: dict[str, _Part] = {}
        for element in _children(self.element, kind):
            name = element.get("name", "")
            part = _Part(element, self.path, f"The {kind} {name!r} of {self.path.name}", {kind: name})
            unnamed = _Part(element, self.path, f"A {kind}")
            if not name or not name.isprintable() or name != name.strip():
                unnamed.refuse(f"A {kind} has the name {_short(repr(element.get('name')))}")
            if len(name) > 255:
                unnamed.refuse(f"The {kind} {_short(name)!r} has a name of {len(name)} characters")
            if kind == "joint" and name == "universe":
                unnamed.refuse("A joint has the name 'universe', which Pinocchio gives to the world", name=name)
            if name in parts:
                first = parts[name].element.line
                unnamed.refuse(f"There are two {kind}s {name!r}, the first in line {first}", name=name)
            parts[name] = part
        if kind == "link" and len(parts) > MOST_LINKS:
            self.refuse(f"The robot has {len(parts)} links, more than the {MOST_LINKS} that a model may have")
        return parts

    def one(self, tag: str) -> _Part | None:
        """Return a part of which there is at most one, its attributes known."""
        parts = [_Part(element, self.path, self.owner, self.details) for element in _children(self.element, tag)]
        if len(parts) > 1:
            parts[1].refuse(f"{self.owner} has <{tag}> {len(parts)} times")
        known = _ATTRIBUTES.get(tag, ())
        for key in parts[0].element.attrib if parts and known else ():
            if key not in known and (hint := did_you_mean(key.lower(), known)):
                parts[0].refuse(f"{self.owner} has <{tag}> with the attribute {_short(key)!r}", hint.strip())
        return parts[0] if parts else None

    def required(self, tag: str) -> _Part:
        """Return a part that has to be there."""
        return self.one(tag) or self.refuse(f"{self.owner} has no {tag}")

    def require_known_parts(self) -> None:
        """Refuse what is nearly, but not quite, an element that counts: it would be passed over."""
        known = _PARTS[self.element.tag]
        for part in self.element:
            # names of extensions are far from all
            if part.tag not in known and (near := difflib.get_close_matches(part.tag.lower(), known, n=1, cutoff=0.8)):
                place = replace(self, element=part) if isinstance(part, Element) else self
                place.refuse(f"{self.owner} has an element <{_short(part.tag)}>", f"Did you mean {near[0]!r}?")

    def number(self, key: str, what: str = "", most: float = LARGEST) -> float:
        """Return the number of an attribute."""
        text = self.element.get(key)
        number = _as_number((text or "").strip(), most)
        if number is None:
            shown = text if text is None else _short(text)
            self.refuse(f"{self.owner} has the {what or key} {shown!r}, which is not a finite number")
        return number

    def triple(self, key: str, what: str) -> Array:
        """Return the (3,) numbers of an attribute."""
        text = self.element.get(key, "")
        numbers = [_as_number(part, LARGEST) for part in text.split()]
        if len(numbers) != 3 or None in numbers:
            remedy = "Write three numbers with blanks between them."
            self.refuse(f"{self.owner} has {what} {_short(text)!r}, which is not three finite numbers", remedy)
        return np.array(numbers, dtype=float)

    def placement(self) -> Array:
        """Return the (4, 4) placement that the origin of the element gives."""
        placement: Array = np.eye(4)
        origin = self.one("origin")
        given = {} if origin is None else origin.element.attrib
        if origin is not None and "quat_xyzw" in given:
            origin.refuse(f"{self.owner} has an origin with quat_xyzw", "Write the rotation as rpy.")
        if origin is not None and "xyz" in given:
            placement[:3, 3] = origin.triple("xyz", "an origin with xyz")
        if origin is not None and "rpy" in given:
            placement[:3, :3] = _turned(*origin.triple("rpy", "an origin with rpy"))
        return placement


def impossible_moments(links: Iterable[LinkEntry]) -> tuple[str, ...]:
    """Return a note on each link whose largest principal moment of inertia exceeds the sum of the other two.

    No body has such moments, but files have. With masses and moments that are not negative the mass matrix still has
    no negative eigenvalue, so that they are taken as they stand; negative ones are refused.
    """
    notes = []
    for link in links:
        moments = np.linalg.eigvalsh(link.inertia)
        allowed = _TRIANGLE_TOLERANCE * float(np.abs(moments).max()) + _NO_MOMENT
        if moments[2] > moments[0] + moments[1] + allowed:
            text = np.array2string(moments, precision=4)
            notes.append(
                f"The link {link.name!r} has principal moments of inertia {text} that no body can have, the largest "
                "exceeds the sum of the other two; taken as they stand."
            )
    return tuple(notes)


WITHOUT_INERTIAL = "Links without <inertial> count as massless:"
"""How the note begins that names them."""


def links_without_inertial(
    tree: Tree, kinds: Mapping[str, str] = MappingProxyType({}), *, root_moves: bool = False
) -> tuple[str, ...]:
    """Return a note that names the moving links whose mass the file does not state; none if there are no such links.

    These are links with a shape, and bodies (links between two moving joints, with all links fixed to them) of which no
    link has an ``<inertial>``. A mark, a link without shape that is fixed to another, is not among them; nor is a link
    that the file states to be massless, by an ``<inertial>`` of mass zero.

    Args:
        tree: the tree of the file.
        kinds: by joint, the kind that replaces the one of the file.
        root_moves: whether the root of the tree is not fixed to the ground.
    """
    body = {tree.root: tree.root}
    for joint in tree.joints:
        is_fixed = kinds.get(joint.name, joint.kind) == "fixed"
        body[joint.child] = body[joint.parent] if is_fixed else joint.child
    stated = {body[name] for name, link in tree.links.items() if link.has_inertial}
    names = [
        name
        for name, link in tree.links.items()
        if (root_moves or body[name] != tree.root)
        and not link.has_inertial
        and (link.has_shape or (body[name] == name and name not in stated))
    ]
    remedy = "Give each an <inertial>; one with mass 0 states that the link is massless."
    return (f"{WITHOUT_INERTIAL} {', '.join(names)}. {remedy}",) if names else ()


def _link(name: str, part: _Part) -> LinkEntry:
    part.require_known_parts()
    inertial = part.one("inertial")
    has_shape = any(child.tag in ("visual", "collision") for child in part.element)
    if inertial is None:
        return LinkEntry(name, 0.0, np.zeros(3), np.zeros((3, 3)), False, has_shape)
    inertial.require_known_parts()
    mass, inertia = inertial.required("mass"), inertial.required("inertia")
    kilograms = mass.number("value", "mass")
    if kilograms < 0.0:
        mass.refuse(f"{part.owner} has a negative mass, {kilograms:g} kg")
    matrix = np.array([[inertia.number("i" + "".join(sorted(a + b))) for b in "xyz"] for a in "xyz"])
    moments = np.linalg.eigvalsh(matrix)
    allowed = _TRIANGLE_TOLERANCE * float(np.abs(moments).max()) + _NO_MOMENT
    if moments[0] < -allowed:
        text = np.array2string(moments, precision=4)
        inertia.refuse(f"{part.owner} has principal moments of inertia {text} that no body can have: a negative one")
    placement = inertial.placement()
    turn = placement[:3, :3]
    return LinkEntry(name, kilograms, placement[:3, 3], turn @ matrix @ turn.T, True, has_shape)


def _joint(name: str, part: _Part, links: Mapping[str, LinkEntry]) -> JointEntry:
    kind = part.element.get("type", "")
    if kind not in _FREEDOMS:
        remedy = f"{did_you_mean(kind, _FREEDOMS)}There are: {', '.join(_FREEDOMS)}."
        part.refuse(f"{part.owner} has the type {_short(kind)!r}", remedy)
    part.require_known_parts()
    ends = []
    for role in ("parent", "child"):
        end = part.one(role)
        link = "" if end is None else end.element.get("link", "")
        if link not in links:
            what = f"the {role} {_short(link)!r}, which is no link" if link else f"no {role}"
            part.refuse(f"{part.owner} has {what}", did_you_mean(link, links), link=link)
        ends.append(link)
    axis = np.array([1.0, 0.0, 0.0])  # as the specification has it
    given = part.one("axis")
    # urdfdom looks at no axis of the other kinds
    if given is not None and kind not in ("fixed", "floating"):
        axis = given.triple("xyz", "the axis")
        length = float(np.linalg.norm(axis))
        if not length > 0.0:
            given.refuse(f"{part.owner} has an axis of length zero")
        axis = axis / length
    if kind == "planar" and axis[2] != 1.0:
        part.refuse(f"{part.owner} is planar about another axis than z, which Pinocchio does not know")
    placement, limits, dynamics = part.placement(), _limits(part, kind), _dynamics(part)
    return JointEntry(name, kind, ends[0], ends[1], placement, axis, limits, dynamics, _mimic(name, kind, part))


def _mimic(name: str, kind: str, part: _Part) -> Coupling | None:
    given = part.one("mimic")
    if given is None or not _FREEDOMS[kind]:  # a joint that is fixed follows nothing, whatever it says
        return None
    if not (of := given.element.get("joint", "")):
        given.refuse(f"{part.owner} has a mimic without the name of a joint")
    multiplier, offset = (
        given.number(key, f"{key} of its mimic") if key in given.element.attrib else default
        for key, default in (("multiplier", 1.0), ("offset", 0.0))
    )
    return Coupling(f"{name} of {of}", name, of, (offset, multiplier))


def _dynamics(part: _Part) -> Mapping[str, float]:
    """Return damping and friction of a joint, those that are not zero."""
    given = part.one("dynamics")
    friction = {} if given is None else {key: given.number(key) for key in _FRICTION if key in given.element.attrib}
    for key, value in friction.items():
        if value < 0.0 and given is not None:
            given.refuse(f"{part.owner} has a negative {key}, {value:g}")
    return {key: value for key, value in friction.items() if value}


def _limits(part: _Part, kind: str) -> Mapping[str, float]:
    limit = part.one("limit")
    if limit is None:
        if kind in ("revolute", "prismatic"):
            part.refuse(f"{part.owner} is {kind} and has no <limit>")
        return {}
    return {
        key: limit.number(key, f"{key} limit", sys.float_info.max)
        if key in limit.element.attrib or key in ("effort", "velocity")
        else 0.0
        for key in ("lower", "upper", "effort", "velocity")
    }


def _in_order(
    robot: _Part, links: Mapping[str, LinkEntry], joints: Mapping[str, JointEntry], parts: Mapping[str, _Part]
) -> tuple[str, Mapping[str, LinkEntry], tuple[JointEntry, ...]]:
    """Return the root, the links, and the joints from the root outwards."""
    carried: dict[str, str] = {}
    outwards: dict[str, list[JointEntry]] = {name: [] for name in links}
    for name, joint in joints.items():
        if joint.child in carried:
            what = f"The link {joint.child!r} is the child of two joints, {carried[joint.child]!r} and {name!r}"
            remedy = "Cut the loop: give the second joint a link of its own, and close it in the declaration."
            replace(parts[name], details={}).refuse(what, remedy, link=joint.child)
        carried[joint.child] = name
        outwards[joint.parent].append(joint)
    roots = [name for name in links if name not in carried]
    if len(roots) > 1:
        names = ", ".join(map(repr, roots[:5]))
        remedy = "Join them by joints: a robot has one link that no joint carries."
        robot.refuse(f"The links are no tree: {names} are carried by no joint", remedy, links=tuple(roots[:5]))
    ordered: list[JointEntry] = []
    level, depth = roots, 0
    while level:
        if depth > DEEPEST_CHAIN:
            robot.refuse(f"More than {DEEPEST_CHAIN} links follow on one another", "Shorten the chain.")
        made = [joint for name in level for joint in outwards[name]]
        ordered += made
        level, depth = [joint.child for joint in made], depth + 1
    reached = {*roots, *(joint.child for joint in ordered)}
    circle = [name for name in links if name not in reached]
    if circle:
        names = ", ".join(map(repr, circle[:5]))
        remedy = "Cut the circle at a joint and close it in the declaration."
        robot.refuse(f"The links {names} carry one another in a circle", remedy, links=tuple(circle[:5]))
    if not links:
        robot.refuse("The robot has no links")
    return roots[0], links, tuple(ordered)


def require_same(tree: Tree, model: pin.Model, path: Path) -> None:
    """Check that Pinocchio's model has the joints, axes, limits, frames and masses of the file.

    Raises:
        ModelFileError: naming the joint or link and the quantity that differs.
    """

    def refuse(what: str, of_model: object, of_file: object) -> NoReturn:
        raise ModelFileError(
            f"Pinocchio does not read {path.name} as it stands: {what} is {of_model} in its model, "
            f"{of_file} in the file.",
            remedy="Write that part of the URDF in the plainest form, and report it.",
            path=str(path),
            what=what,
        )

    names = [str(name) for name in model.names]
    moving = [joint.name for joint in tree.joints if joint.kind != "fixed"]
    if sorted(names[1:]) != sorted(moving):
        refuse("the list of moving joints", sorted(names[1:]), sorted(moving))
    for what, of_model, of_file, scale in _pairs(tree, model, names):
        here, there = np.asarray(of_model, dtype=float), np.asarray(of_file, dtype=float)
        allowed = _NOTHING + _ROUNDING * max(scale, float(np.abs(there).max(initial=0.0)))
        if here.shape != there.shape or not bool((np.abs(here - there) <= allowed).all()):
            refuse(what, here.tolist(), there.tolist())


def _pairs(tree: Tree, model: pin.Model, names: list[str]) -> Iterator[tuple[str, object, object, float]]:
    """Give what has to be equal: its name, its values in the model and in the file, the size that rounding is of."""
    # each link: the moving joint that carries it, and where it is in the frame of that joint
    places: dict[str, tuple[int, Array]] = {tree.root: (0, np.eye(4))}
    for joint in tree.joints:
        carrier, place = places[joint.parent]
        placement = place @ joint.placement
        places[joint.child] = (carrier, placement)
        if joint.kind != "fixed":
            index, what = names.index(joint.name), f"of the joint {joint.name!r}"
            places[joint.child] = (index, np.eye(4))
            yield f"the parent {what}", int(model.parents[index]), carrier, 0.0
            yield f"the placement {what}", model.jointPlacements[index].homogeneous, placement, 0.0
            for quantity, of_model, of_file in _of_joint(model, model.joints[index], joint):
                yield f"the {quantity} {what}", of_model, of_file, 0.0
    bodies = np.zeros((len(names), 4, 4))
    for name, (index, place) in places.items():
        link = tree.links[name]
        bodies[index] += place @ _pseudo_inertia(link.mass, link.centre, link.inertia) @ place.T
        frame = find_link(model, name)
        yield f"the joint that carries the link {name!r}", int(frame.parentJoint), index, 0.0
        yield f"the placement of the link {name!r}", frame.placement.homogeneous, place, 0.0
    for index, body in enumerate(bodies):
        what = f"of the body that {names[index]!r} carries" if index else "of the base"
        inertia = model.inertias[index]
        built, mass = _pseudo_inertia(inertia.mass, inertia.lever, inertia.inertia), float(body[3, 3])
        yield f"the mass {what}", built[3, 3], mass, mass
        yield f"mass times centre of mass {what}", built[3, :3], body[3, :3], mass
        yield f"the inertia {what}", built[:3, :3], body[:3, :3], mass + float(np.abs(body[:3, :3]).max())


def _of_joint(model: pin.Model, built: pin.JointModel, joint: JointEntry) -> Iterator[tuple[str, object, object]]:
    yield "number of freedoms", built.nv, _FREEDOMS[joint.kind]
    if built.nv != 1:
        return
    data, still = built.createData(), np.zeros(3)
    built.calc(data, pin.neutral(model), np.zeros(model.nv))
    twist = (joint.axis, still) if joint.kind == "prismatic" else (still, joint.axis)
    yield "axis", np.ravel(data.S), np.concatenate(twist)
    if joint.limits:
        yield "effort limit", model.upperEffortLimit[built.idx_v], joint.limits["effort"]
        yield "velocity limit", model.upperVelocityLimit[built.idx_v], joint.limits["velocity"]
    if joint.limits and joint.kind != "continuous":  # of which Pinocchio bounds cosine and sine instead
        yield "lower limit", model.lowerPositionLimit[built.idx_q], joint.limits["lower"]
        yield "upper limit", model.upperPositionLimit[built.idx_q], joint.limits["upper"]


def _pseudo_inertia(mass: float, centre: Array, inertia: Array) -> Array:
    """Return the (4, 4) integral of r rᵀ dm with r = (x, y, z, 1): a placement T makes T P Tᵀ of it.

    ``inertia`` is about the centre of mass, in the axes of the frame; ½ tr(I) 1 - I is the integral of x xᵀ dm.
    """
    pseudo = np.zeros((4, 4))
    pseudo[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia + mass * np.outer(centre, centre)
    pseudo[:3, 3] = pseudo[3, :3] = mass * np.asarray(centre)
    pseudo[3, 3] = mass
    return pseudo


def _turned(roll: float, pitch: float, yaw: float) -> Array:
    """Return the rotation (3, 3) of angles about the fixed axes x, y, z in that order, rad: R_z R_y R_x."""
    (a, b, c), (x, y, z) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, a, -x], [0.0, x, a]])
    about_y = np.array([[b, 0.0, y], [0.0, 1.0, 0.0], [-y, 0.0, b]])
    about_z = np.array([[c, -z, 0.0], [z, c, 0.0], [0.0, 0.0, 1.0]])
    turn: Array = about_z @ about_y @ about_x
    return turn


def _as_number(text: str, most: float) -> float | None:
    number = float(text) if _NUMBER.fullmatch(text) else math.nan
    return number if abs(number) <= most else None


def _children(element: Element, tag: str) -> Iterator[Element]:
    return (part for part in element if part.tag == tag and isinstance(part, Element))


def _short(text: str) -> str:
    return text if len(text) <= 80 else f"{text[:77]}..."
