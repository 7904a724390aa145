"""Read a URDF: Pinocchio makes the tree of it, and what Pinocchio leaves out is read here.

Left out are loops and couplings (``urdf_loops``), friction, motors and whether a link has a mass at all. Everything is
checked by the specification first, as urdfdom drops an inertial element that it cannot parse, so that a typing
error makes a massless link. An element that is not understood is an error or a note with its line.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from redundancy_pin.errors import DeclarationError, did_you_mean, one_of, shortened
from redundancy_pin.robot.formats.mechanism import (
    MOST_FREEDOMS,
    NOT_IN_FORCE,
    SIX,
    LinkEntry,
    Mechanism,
    impossible_moments,
    in_a_row,
    mimic_coupling,
    not_understood,
)
from redundancy_pin.robot.formats.urdf_loops import read_loops
from redundancy_pin.robot.formats.urdf_parts import FRICTION, UrdfPart
from redundancy_pin.robot.formats.xml_files import DRAKE, FORMATS, ZEROS, parsed_text, remedy_of_format
from redundancy_pin.robot.inertia import negative_inertia
from redundancy_pin.robot.loads import JointForces
from redundancy_pin.robot.lookup import find_joint, find_link, has_joint
from redundancy_pin.robot.loop_joints import LoopJoint
from redundancy_pin.robot.types import Coupling

DEEPEST_CHAIN = 200
"""Links in a row. urdfdom and Pinocchio go down by recursion: 10,000 end the process where the stack has 8 MB."""

_VERSIONS = ("", "1.0", "1.1", "1.2")
"""Versions of the format. Later ones add shapes and quaternions, which are read or refused whatever the version."""

_FREEDOMS = {"fixed": 0, "revolute": 1, "continuous": 1, "prismatic": 1, "planar": 3, "floating": 6}

_JOINTS_OF_DRAKE = {"ball": "ball", "universal": "universal_xy", "planar": "three_joints"}
"""Types of ``<drake:joint>``, and what such a joint is replaced by."""


@dataclass(frozen=True)
class JointEntry:
    """A joint of the file, its numbers checked.

    Attributes:
        name, kind: its name and its type.
        parent, child: names of the links that it joins.
        is_bounded: whether it has limits of position: 0 and 0, or none at all, stand for "not known".
        dynamics: damping, N·s/m or N·m·s, and friction, N or N·m, those that are not zero.
        mimic: the coupling to the joint that it follows.
    """

    name: str
    kind: str
    parent: str
    child: str
    is_bounded: bool
    dynamics: Mapping[str, float]
    mimic: Coupling | None


@dataclass(frozen=True)
class Urdf:
    """Content of a URDF.

    Attributes:
        text: the file, after xacro.
        top: its top element.
        root: the link that no joint carries.
        links: by name.
        joints: each after those that carry it.
        independent: names of the joints that URDF+ marks as independent; empty if it marks no joint.
        notes: elements that are passed over.
    """

    text: str
    top: UrdfPart
    root: str
    links: Mapping[str, LinkEntry]
    joints: tuple[JointEntry, ...]
    independent: tuple[str, ...]
    notes: tuple[str, ...]


def read_urdf(text: str, path: Path) -> Urdf:
    """Read a URDF.

    Args:
        text: its text.
        path: the file that it comes from, for messages.

    Raises:
        ModelFileError: naming the file, the line, and the link or joint: numbers that are none, elements that are
            missing, there twice or misspelt; names that are; negative masses and moments of inertia; links that make no
            tree; a joint that mimics none; more links or freedoms than a model may have.
    """
    robot, notes = UrdfPart(parsed_text(text, str(path)), path, "The robot"), list[str]()
    if robot.element.tag != "robot":
        known = FORMATS.get(robot.element.tag)
        what = f": it is {known}" if known else ""
        top = f"The top element of {path.name} is <{shortened(robot.element.tag)}>, not <robot>{what}"
        robot.refuse(top, remedy_of_format(known) if known else "")
    if (version := robot.text_of("version")) not in _VERSIONS:
        robot.refuse(f"The robot has the version {shortened(version)!r} of URDF", "There are 1.0, 1.1 and 1.2.")
    if _needs_world(robot):
        text = '<link name="world"/></robot'.join(text.rsplit("</robot", 1))
        notes.append("The link 'world', which the file does not have, is the ground.")
        robot = replace(robot, element=parsed_text(text, str(path)))
    robot.unknown_parts()  # those that are no slips of the pen are read by urdf_loops
    parts = {kind: robot.named(kind) for kind in ("link", "joint")}
    links = {name: _link(name, part) for name, part in parts["link"].items()}
    joints = {name: _joint(name, part, links) for name, part in parts["joint"].items()}
    for name, joint in joints.items():
        followed = joint.mimic and joint.mimic.of
        if followed and (followed == name or followed not in joints or not _FREEDOMS[joints[followed].kind]):
            remedy = did_you_mean(followed, joints).strip() or "Name another joint, which moves."
            parts["joint"][name].refuse(f"{parts['joint'][name].owner} mimics {followed!r}, which it cannot", remedy)
    freedoms = sum(_FREEDOMS.get(joint.kind, 3) for joint in joints.values())
    if freedoms > MOST_FREEDOMS:
        robot.refuse(f"The joints have {freedoms} freedoms, more than the {MOST_FREEDOMS} of a model")
    ordered = _in_order(robot, links, joints, parts["joint"])
    marks = {name: part.text_of("independent").lower() for name, part in parts["joint"].items()}
    for name, mark in marks.items():
        if mark not in ("", "true", "false"):
            parts["joint"][name].refuse(
                f"{parts['joint'][name].owner} has independent={mark!r}", "Write true or false."
            )
    independent = [joint.name for joint in ordered[2] if _FREEDOMS.get(joint.kind, 3) and marks[joint.name] != "false"]
    notes += _passed_over(parts)
    return Urdf(text, robot, *ordered, tuple(independent) if any(marks.values()) else (), tuple(notes))


def _needs_world(robot: UrdfPart) -> bool:
    """Return whether a joint is on the link ``world``, which Drake has without a ``<link>``."""
    joints = (*robot.children("joint"), *robot.children(DRAKE + "joint"))
    parents = {parent.get("link") for joint in joints for parent in joint.findall("parent")}
    return "world" in parents and "world" not in {each.get("name") for each in robot.children("link")}


def _passed_over(parts: Mapping[str, Mapping[str, UrdfPart]]) -> list[str]:
    """Return notes on elements and attributes of links and joints that are not in the specification."""
    notes, lines = [], dict[str, list[str]]()
    for part in (*parts["link"].values(), *parts["joint"].values()):
        inertial = part.one("inertial")
        for key, tag, line in (*part.unknown_attributes(), *(inertial.unknown_attributes() if inertial else ())):
            lines.setdefault(f"{key!r} of <{tag}>", []).append(str(line))
        for each in (*part.unknown_parts(), *(inertial.unknown_parts() if inertial else ())):
            if each.tag != "joint_properties":
                notes.append(not_understood(each.place))
            elif any(each.text_of(key) not in ZEROS for key in FRICTION):  # of onshape-to-robot
                notes.append(f"{NOT_IN_FORCE} friction by {each.place}.")
    notes += [not_understood(f"{what} in line {', '.join(where)}") for what, where in lines.items()]
    return notes


WITHOUT_INERTIAL = "Links without <inertial> count as massless:"
"""How the note begins that names them."""


def _without_inertial(file: Urdf, model: pin.Model, carriers: Mapping[str, tuple[str, str]]) -> list[str]:
    """Return a note that names the moving links whose mass the file does not state; nothing if there are none.

    These are links with a shape, and bodies (links between two moving joints, with all links fixed to them) of which no
    link has an ``<inertial>``. A mark, a link without shape that is fixed to another, is not among them; nor is a link
    that the file states to be massless, by an ``<inertial>`` of mass zero.

    Args:
        file: the URDF.
        model: the tree.
        carriers: by link, the joint that carries it and its parent link.
    """
    bodies = {name: find_link(model, name).parentJoint for name in file.links}
    stated = {bodies[name] for name, link in file.links.items() if link.has_inertial}
    names = [
        name
        for name, link in file.links.items()
        if bodies[name] and not link.has_inertial  # the ground is body 0
        if link.has_shape or (bodies[name] not in stated and (name == file.root or has_joint(model, carriers[name][0])))
    ]
    remedy = "Give each an <inertial>; one with mass 0 states that the link is massless."
    return [f"{WITHOUT_INERTIAL} {', '.join(names)}. {remedy}"] if names else []


def _link(name: str, part: UrdfPart) -> LinkEntry:
    inertial = part.one("inertial")
    has_shape = any(child.tag in ("visual", "collision") for child in part.element)
    if inertial is None:
        return LinkEntry(name, 0.0, np.zeros(3), np.zeros((3, 3)), False, has_shape)
    mass, inertia = inertial.required("mass"), inertial.required("inertia")
    kilograms = mass.number("value", "mass")
    matrix = np.array([[inertia.number("i" + "".join(sorted(a + b))) for b in "xyz"] for a in "xyz"])
    if what := negative_inertia(kilograms, matrix):
        (mass if kilograms < 0.0 else inertia).refuse(f"{part.owner} has {what}")
    placement = inertial.placement()
    turn = placement[:3, :3]
    return LinkEntry(name, kilograms, placement[:3, 3], turn @ matrix @ turn.T, True, has_shape)


def _joint(name: str, part: UrdfPart, links: Mapping[str, LinkEntry]) -> JointEntry:
    kind, known = part.element.get("type", ""), _JOINTS_OF_DRAKE if part.tag == DRAKE + "joint" else _FREEDOMS
    if kind not in known:
        part.refuse(f"{part.owner} has the type {shortened(kind)!r}", one_of(kind, known, "There are"))
    if part.tag == DRAKE + "joint":
        kind = _JOINTS_OF_DRAKE[kind]
    part.unknown_parts()
    ends = []
    for role in ("parent", "child"):
        end = part.one(role)
        link = "" if end is None else end.element.get("link", "")
        if link not in links:
            what = f"the {role} {shortened(link)!r}, which is no link" if link else f"no {role}"
            part.refuse(f"{part.owner} has {what}", did_you_mean(link, links), link=link)
        ends.append(link)
    axis = np.array([1.0, 0.0, 0.0])  # as the specification has it
    given = part.one("axis")
    # urdfdom looks at no axis of the other kinds
    if given is not None and kind in (*_SINGLE, "planar"):
        axis = given.triple("xyz", "the axis")
        if not axis.any():
            given.refuse(f"{part.owner} has an axis of length zero")
    if kind == "planar" and axis[2] != np.linalg.norm(axis):
        part.refuse(f"{part.owner} is planar about another axis than z, which Pinocchio does not know")
    part.placement()  # Pinocchio reads it too, and is not strict
    return JointEntry(name, kind, ends[0], ends[1], _is_bounded(part, kind), _dynamics(part), _mimic(name, kind, part))


def _mimic(name: str, kind: str, part: UrdfPart) -> Coupling | None:
    given = part.one("mimic")
    if given is None or not _FREEDOMS.get(kind, 3):  # a joint that is fixed follows nothing, whatever it says
        return None
    if not (of := given.element.get("joint", "")):
        given.refuse(f"{part.owner} has a mimic without the name of a joint")
    keys = [key for key in ("multiplier", "offset") if key in given.attributes]
    return mimic_coupling(name, of, **{key: given.number(key, f"{key} of its mimic") for key in keys})


def _dynamics(part: UrdfPart) -> Mapping[str, float]:
    """Return damping and friction of a joint, those that are not zero."""
    given = part.one("dynamics")
    friction = {} if given is None else {key: given.number(key) for key in FRICTION if key in given.element.attrib}
    for key, value in friction.items():
        if value < 0.0 and given is not None:
            given.refuse(f"{part.owner} has a negative {key}, {value:g}")
    return {key: value for key, value in friction.items() if value}


def _is_bounded(part: UrdfPart, kind: str) -> bool:
    """Return whether a joint has limits of position."""
    limit = part.one("limit")
    if limit is None:
        if kind in ("revolute", "prismatic"):
            part.refuse(f"{part.owner} is {kind} and has no <limit>")
        return False
    limits = {
        key: limit.number(key, f"{key} limit", sys.float_info.max)
        if key in limit.element.attrib or key in ("effort", "velocity")
        else 0.0
        for key in ("lower", "upper", "effort", "velocity")
    }
    for key in ("effort", "velocity"):
        if limits[key] < 0.0 and kind in _SINGLE:  # Pinocchio passes over it for the other kinds
            limit.refuse(f"{part.owner} has a negative {key} limit, {limits[key]:g}")
    return limits["lower"] < limits["upper"]


def _in_order(
    robot: UrdfPart, links: Mapping[str, LinkEntry], joints: Mapping[str, JointEntry], parts: Mapping[str, UrdfPart]
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


# --- Pinocchio's model ------------------------------------------------------------------------------------------------


_TREE = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("origin", "parent", "child", "axis", "limit"),
}
"""What makes the tree: urdfdom complains on the error stream of what it does not know in shapes and extensions."""


def _tree(file: Urdf, kinds: Mapping[str, str], base: str) -> pin.Model:
    """Return Pinocchio's model of a URDF, in which every link is a frame.

    Joints that will be replaced are floating ones here, so that they carry a separate body.
    """
    robot = ElementTree.Element("robot", {"name": file.top.text_of("name") or "robot"})
    for part in file.top.element:
        if part.tag in ("link", "joint", DRAKE + "joint"):
            robot.append(_reduced(part))
            if part.tag != "link" and (kind := kinds.get(part.get("name", ""))):
                robot[-1].set("type", "fixed" if kind == "fixed" else "floating")
    text = ElementTree.tostring(robot, encoding="unicode")
    return pin.buildModelFromXML(text, pin.JointModelFreeFlyer()) if base == "free" else pin.buildModelFromXML(text)


def _reduced(element: ElementTree.Element) -> ElementTree.Element:
    attributes = {key: value for key, value in element.attrib.items() if ":" not in key and key != "xmlns"}
    result = ElementTree.Element(element.tag.removeprefix(DRAKE), attributes)
    for part in element:
        if part.tag in _TREE.get(result.tag, ()):
            result.append(_reduced(part))
    return result


ROWS_OF_JOINTS: Mapping[str, tuple[str, ...]] = {
    "six_joints": SIX,
    "three_joints": ("x", "y", "rz"),
    **{f"universal_{one}{two}": (f"r{one}", f"r{two}") for one in "xyz" for two in "xyz" if one != two},
}
"""Joints of one freedom in a row, in place of a floating, a planar and a universal joint: the last turns about the
first axis of its frame, then about the second."""

KINDS = ("ball", "fixed", *ROWS_OF_JOINTS)
"""What a joint of the file can be replaced by."""

_SINGLE = ("revolute", "continuous", "prismatic")


def urdf_mechanism(
    file: Urdf, name: str, *, kinds: Mapping[str, str] = MappingProxyType({}), base: str = "fixed"
) -> Mechanism:
    """Return what a URDF describes.

    Args:
        file: the URDF.
        name: of the mechanism.
        kinds: by joint, its replacement, one of ``KINDS``.
        base: "free" to let the root move, by six joints.

    Raises:
        DeclarationError: an unknown joint.
        ModelFileError: what ``urdf_loops`` does not know, or does not find the other end of.
    """
    named = {joint.name: joint for joint in file.joints}
    if unknown := [own for own in kinds if own not in named]:
        remedy = one_of(unknown[0], named)
        raise DeclarationError(f"The URDF has no joint {unknown[0]!r}.", remedy=remedy, name=unknown[0])
    kinds = {joint.name: joint.kind for joint in file.joints if joint.kind in _JOINTS_OF_DRAKE.values()} | {**kinds}
    model = _tree(file, kinds, base)
    carriers = {joint.child: (joint.name, joint.parent) for joint in file.joints}
    loops = read_loops(file.top, carriers, model)
    couplings = (*(joint.mimic for joint in file.joints if joint.mimic), *loops.couplings)
    counted = {name for each in couplings for name in each.joints}
    replaced: dict[str, list[tuple[str, pin.JointModel]]] = {}
    if base == "free":
        replaced["root_joint"] = in_a_row(file.root, SIX)
    for joint in file.joints:
        kind = kinds.get(joint.name, "")
        if kind == "ball":
            replaced[joint.name] = [(joint.name, pin.JointModelSpherical())]
        elif kind in ROWS_OF_JOINTS:
            replaced[joint.name] = in_a_row(joint.name, ROWS_OF_JOINTS[kind])
    single = {joint.name for joint in file.joints if joint.kind in _SINGLE and joint.name not in kinds}
    for each in couplings:
        if not {*each.joints} <= single:
            raise DeclarationError(
                f"The coupling {each.name!r} is of joints that are replaced, or have several freedoms.",
                remedy="Couple joints of one freedom.",
                name=each.name,
            )
    forces = tuple(
        JointForces(joint.name, **joint.dynamics) for joint in file.joints if joint.dynamics and joint.name in single
    )
    lost = [
        joint
        for joint in file.joints
        if joint.dynamics and joint.name not in single and kinds.get(joint.name, joint.kind) != "fixed"
    ]
    notes = [f"Friction of the joint {joint.name} is not in force: it has several freedoms." for joint in lost]
    notes += [
        *_without_inertial(file, model, carriers),
        *impossible_moments(file.links.values()),
        *file.notes,
        *loops.notes,
    ]
    for driven, inertia in loops.armature.items():
        model.armature[find_joint(model, driven).idx_v] = inertia
    marked = tuple(LoopJoint(" = ".join(pair), "ball", pair) for pair in loops.closing)
    independent = _independent(file, kinds, base)
    if independent and not loops.motors:
        notes.append("The file does not say what is driven: taken are the joints that it marks as independent.")
    made = Mechanism(
        name,
        model,
        pin.neutral(model),
        (*loops.joints, *marked),
        couplings,
        loops.motors or tuple(name for name in independent if name in named),
        forces,
        tuple(notes),
        file.text,
        independent,
        _marks(file, kinds),
        tuple(each.name for each in marked),
    )
    for joint in file.joints:
        if joint.kind in ("revolute", "prismatic") and joint.name in single and not joint.is_bounded:
            at = find_joint(model, joint.name).idx_q
            model.lowerPositionLimit[at], model.upperPositionLimit[at] = -np.inf, np.inf
    return (made.with_joints(replaced) if replaced else made).counting_turns(counted)


def _marks(file: Urdf, kinds: Mapping[str, str]) -> Mapping[str, float]:
    """Return the links that are fixed to another one and carry none that moves, with their masses, kg."""
    carries, marks = set[str](), list[str]()
    for joint in reversed(file.joints):  # each comes before the one that carries it
        if kinds.get(joint.name, joint.kind) == "fixed" and joint.child not in carries:
            marks.append(joint.child)
        else:
            carries.add(joint.parent)
    return {name: file.links[name].mass for name in reversed(marks)}


def _independent(file: Urdf, kinds: Mapping[str, str], base: str) -> tuple[str, ...]:
    """Return the joints that URDF+ marks as independent, of one freedom each; joints of a moving base too."""
    names = [name for name, _ in in_a_row(file.root, SIX)] if base == "free" and file.independent else []
    for name in file.independent:
        rows = ROWS_OF_JOINTS.get(kinds.get(name, ""), ())
        names += [row for row, _ in in_a_row(name, rows)] if rows else [name]
    return tuple(name for name in names if kinds.get(name) != "fixed")


SEVERAL_FREEDOMS = {"floating": "six_joints", "planar": "three_joints"}
"""What stands for a joint of several freedoms where no declaration says it: independent joints have one each."""
