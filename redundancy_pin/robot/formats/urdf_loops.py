"""Loops, couplings and motors of a URDF, in the words of each program that has added them to the format.

| element | of |
|---|---|
| ``<loop>``, ``<coupling>`` | URDF+ (generalized_rbda) |
| ``<constraint>`` | the proposal for urdfdom, joint_state_transformer |
| ``<loop_joint>`` | Isaac Sim, Drake of old |
| ``<gazebo><joint>`` | Gazebo: SDF in a URDF; the joint is where its child is when all joints are at zero |
| ``<drake:ball_constraint>``, ``<drake:distance_constraint>`` of infinite stiffness | Drake |
| ``closing_NAME_1``, ``closing_NAME_2`` | links of onshape-to-robot and placo, at one point when closed |
| ``<mimic>`` | URDF |
| ``<transmission>``, ``<ros2_control>`` | ROS: driven joints |

All loops of a file are read, or none: one that is not understood, or has one end only, is an error that names it. Other
elements that a program has added are passed over with a note.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import DeclarationError, did_you_mean, one_of, shown
from redundancy_pin.robot.formats.mechanism import NOT_IN_FORCE, SAME_DIRECTION, not_understood
from redundancy_pin.robot.formats.sdf_frames import SdfPart
from redundancy_pin.robot.formats.urdf_parts import UrdfPart
from redundancy_pin.robot.formats.xml_files import DRAKE, ZEROS
from redundancy_pin.robot.lookup import find_link_index, joint_names, link_names
from redundancy_pin.robot.loop_joints import LOOP_KINDS, LoopJoint, joint_between, placed
from redundancy_pin.robot.types import Coupling

_ENDS = {
    "loop": ("predecessor", "successor"),
    "constraint": ("parent", "child"),
    "loop_joint": ("link1", "link2"),
}
"""Elements that are loops, and those in them that name the two links."""

_STATED = (*_ENDS, "coupling", "drake:ball_constraint", "drake:distance_constraint", "transmission", "ros2_control")
"""Elements beside links and joints that are read: one that is nearly called so is an error."""

_WITHOUT_MECHANICS = ("material", "sensor", "fixed_frame", "plugin", "collision_filter_group")
"""Elements beside links and joints that change nothing in the mechanics."""

_FORCES = ("linear_spring_damper", "linear_bushing_rpy")
"""Forces of Drake between two links."""

_FORCES_OF_GAZEBO = ("springStiffness", "springReference", "implicitSpringDamper", "gravity", "turnGravityOff")
"""Elements of Gazebo that change forces on a link or joint."""

_IN_MODEL = "use_parent_model_frame"
"""Flag of an axis of Gazebo up to SDF 1.6."""

_CLOSING = re.compile(r"closing_(.+)_([12])")


@dataclass(frozen=True)
class Loops:
    """Content of the extensions of a URDF.

    Attributes:
        joints: what closes the loops.
        couplings: joints that follow others, those that mimic not among them.
        motors: names of joints that are driven.
        armature: by joint, the inertia of its rotor times the square of its gear ratio, kg·m² or kg, as Drake has it.
        closing: pairs of links that are at one point when closed, by a joint that the file does not name.
        notes: elements that are passed over.
    """

    joints: tuple[LoopJoint, ...]
    couplings: tuple[Coupling, ...]
    motors: tuple[str, ...]
    armature: Mapping[str, float]
    closing: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def read_loops(robot: UrdfPart, carriers: Mapping[str, tuple[str, str]], model: pin.Model) -> Loops:
    """Read the extensions of a URDF.

    Args:
        robot: its top element.
        carriers: by link, the joint that carries it and the parent link of that; the root is not among them.
        model: the tree, in which links are frames.

    Raises:
        ModelFileError: naming the file, the line, and the element.
    """
    links = set(link_names(model))
    joints, couplings, motors, notes = list[LoopJoint](), list[Coupling](), list[str](), list[str]()
    armature: dict[str, float] = {}
    moving = set(joint_names(model))
    for part in robot.parts():
        tag = part.tag.removeprefix(DRAKE)
        if tag in _ENDS and part.tag == tag:
            joints.append(_loop(part, links))
            ends = ("parent", "child", *_ENDS[tag])
            notes += _left_out(part, (*ends, "parent_origin", "child_origin", "parent_axis", "child_axis", "axis"))
        elif tag == "coupling":
            couplings.append(_coupling(part, carriers, moving))
        elif tag in ("ball_constraint", "distance_constraint") and part.tag != tag:
            joints.append(_of_drake(part, tag, links))
        elif tag in ("transmission", "ros2_control"):
            driven = _driven(part)
            motors += [name for name in driven if name not in motors]
            if inertia := _rotor_inertia(part):
                armature |= dict.fromkeys(driven, inertia)
        elif tag == "gazebo":
            for each in part.parts("joint"):
                joints.append(_of_gazebo(each, model, links))
                notes += _left_out(each, ("parent", "child", "pose", "axis"))
                notes += [note for axis in each.parts("axis") for note in _left_out(axis, ("xyz", _IN_MODEL))]
            forces = [each.place for each in part.parts() if _changes_forces(each)]
            notes += [f"{NOT_IN_FORCE} {place} of Gazebo." for place in forces]
        elif tag in _FORCES:
            notes.append(f"{NOT_IN_FORCE} {part.place} of Drake.")
        elif tag not in ("link", "joint", *_WITHOUT_MECHANICS):
            if near := difflib.get_close_matches(tag.lower(), _STATED, n=1, cutoff=0.8):
                robot.refuse(f"The robot has an element {part.place}", f"Did you mean {near[0]!r}?")
            notes.append(not_understood(part.place))
    for name in [name for name in motors if name not in moving]:
        if name in {joint for joint, _ in carriers.values()}:
            motors.remove(name)
            notes.append(f"The joint {name!r}, which a transmission or ros2_control drives, is fixed here.")
        else:
            remedy = did_you_mean(name, sorted(moving)).strip() or "Name a joint that moves."
            robot.refuse(f"A transmission or ros2_control drives {name!r}, which is no joint that moves", remedy)
    names = [joint.name for joint in joints]
    if twice := {name for name in names if names.count(name) > 1}:
        robot.refuse(f"Two loops have the name {sorted(twice)[0]!r}")
    closing = _closing(robot, links)
    return Loops(tuple(joints), tuple(couplings), tuple(motors), armature, closing, tuple(notes))


def _changes_forces(part: UrdfPart) -> bool:
    """Return whether an element of Gazebo changes forces: gravity that is on does not."""
    usual = ("1", "true") if part.tag == "gravity" else ZEROS
    return part.tag in _FORCES_OF_GAZEBO and part.content().lower() not in usual


def _left_out(part: UrdfPart, known: tuple[str, ...]) -> list[str]:
    """Return notes on elements of a joint that closes a loop, such as limits and friction, except zeros."""
    return [
        f"{NOT_IN_FORCE} {each.place}, of a joint that closes a loop."
        for each in part.parts()
        if each.tag not in (*known, *_WITHOUT_MECHANICS)
        and any(
            text not in ZEROS
            for inner in each.element.iter()
            for text in (*inner.attrib.values(), (inner.text or "").strip())
        )
    ]


def _loop(part: UrdfPart, links: set[str]) -> LoopJoint:
    """Return a loop whose ends are two elements, each with its place in it or next to it."""
    name = part.name()
    kind = LOOP_KINDS.get(part.text_of("type"), "")
    if not kind:
        remedy = one_of(part.text_of("type"), LOOP_KINDS, "There are")
        part.refuse(f"{part.owner} has the type {part.text_of('type')!r}", remedy)
    ends = [end for tag in _ENDS[part.tag] for end in part.parts(tag)]  # Isaac's manual has link1 twice
    ends = ends or [end for tag in ("parent", "child") for end in part.parts(tag)]
    if len(ends) != 2:
        part.refuse(f"{part.owner} has {len(ends)} ends", f"Name two links, by {' and '.join(_ENDS[part.tag])}.")
    names, places = [], []
    for end, side in zip(ends, ("parent", "child"), strict=True):
        names.append(_link(end, end.text_of("link"), links))
        beside = part.one(f"{side}_origin")
        if "xyz" in end.attributes or "rpy" in end.attributes:
            places.append(end.pose())
        else:
            places.append(beside.pose() if beside else end.placement())
    return _joint(part, name, kind, names, places, _axes(part))


def _axes(part: UrdfPart) -> list[Array]:
    """Return the axis of a loop in each of its two frames."""
    given = [part.one(tag) for tag in ("parent_axis", "child_axis")]
    both = part.one("axis")
    if both is not None and "frame" in both.attributes and both.text_of("frame") != "parent":
        both.refuse(f"{part.owner} has an axis in the frame of {both.text_of('frame')!r}", "Write it in the parent's.")
    default = both.triple("xyz", "the axis") if both else np.array([1.0, 0.0, 0.0])  # as a joint's of a URDF
    return [each.triple("xyz", "the axis") if each else default for each in given]


def _joint(
    part: UrdfPart, name: str, kind: str, links: list[str], places: list[Array], axes: list[Array], length: float = 0.0
) -> LoopJoint:
    """Return a joint that closes a loop; what makes none is refused at its line."""
    try:
        return joint_between(name, kind, (links[0], links[1]), places, axes, length)
    except DeclarationError as error:
        part.refuse(error.message.rstrip("."), error.remedy)


def _of_drake(part: UrdfPart, tag: str, links: set[str]) -> LoopJoint:
    """Return a ball, or a rod of constant length for an infinite stiffness; any other stiffness is a spring."""
    names, places, kind, length = [], [], "ball", 0.0
    for body, point in (("body_A", "p_AP"), ("body_B", "p_BQ")):
        end = part.required(f"{DRAKE}{tag}_{body}")
        names.append(_link(end, end.text_of("name"), links))
        at = part.required(f"{DRAKE}{tag}_{point}").triple("value", "a point")
        places.append(placed(np.eye(3), at))
    if tag == "distance_constraint":
        kind, length = "rod", part.required(f"{DRAKE}{tag}_distance").number("value", "distance")
        stiffness = part.required(f"{DRAKE}{tag}_stiffness").text_of("value").strip()
        if stiffness.lower() not in ("inf", "infinity"):
            remedy = 'Write value="inf" for a rod, or a spring in a robot.yaml.'
            part.refuse(f"{part.owner} has the stiffness {stiffness!r}: it is a spring", remedy)
        if not length > 0.0:
            part.refuse(f"{part.owner} has the distance {length:g}", "Write a positive one.")
    return _joint(part, f"{kind} {' = '.join(names)}", kind, names, places, [np.eye(3)[2]] * 2, length)


def _of_gazebo(part: UrdfPart, model: pin.Model, links: set[str]) -> LoopJoint:
    """Return a loop of Gazebo: its frame is given in the child, and there in the parent at the zero configuration."""
    name, kind = part.name(), LOOP_KINDS.get(part.text_of("type"), "")
    if not kind or kind == "universal":
        part.refuse(f"{part.owner} has the type {part.text_of('type')!r}", f"There are: {', '.join(LOOP_KINDS)}.")
    parent, child = (_link(part, part.required(role).content(), links) for role in ("parent", "child"))
    in_sdf = SdfPart(part.element, part.path, part.owner, version=11)  # Gazebo reads it as its newest, 1.11
    if in_sdf.relative_to():
        part.required("pose").refuse(f"{part.owner} has a pose with relative_to", "Write it relative to the child.")
    place = in_sdf.pose()
    axis = part.one("axis")
    direction = axis.required("xyz") if axis else None
    along = direction.numbers(direction.content(), 3, "an axis") if direction else np.eye(3)[2]
    if direction and direction.attributes:
        direction.refuse(f"{part.owner} has an axis in another frame", "Write it in the frame of the joint.")
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    at = {link: data.oMf[find_link_index(model, link)] for link in (parent, child)}
    flag = axis.one(_IN_MODEL) if axis else None
    if flag and flag.content().lower() not in ZEROS:
        in_joint = (at[child].rotation @ place[:3, :3]).T @ along
        if np.linalg.norm(in_joint - along) > SAME_DIRECTION * np.linalg.norm(along):
            remedy = f"Write it in the frame of the joint, {shown(in_joint.round(9).tolist())}, without <{_IN_MODEL}>."
            flag.refuse(f"{part.owner} has an axis in the frame of the model, which only old versions know", remedy)
    in_parent = (at[parent].actInv(at[child]) * pin.SE3(place)).homogeneous
    return _joint(part, name, kind, [parent, child], [in_parent, place], [along, along])


def _coupling(part: UrdfPart, carriers: Mapping[str, tuple[str, str]], moving: set[str]) -> Coupling:
    """Return a coupling of URDF+: ratio times the angles to the predecessor are those to the successor.

    Both are sums over the joints from the nearest link that carries both.
    """
    name, ratio = part.name(), part.required("ratio").number("value", "ratio")
    chains = []
    for tag in ("predecessor", "successor"):
        end = part.required(tag)
        link, chain = _link(end, end.text_of("link"), {*carriers, *(parent for _, parent in carriers.values())}), []
        while link in carriers:
            joint, link = carriers[link]
            chain.append(joint)
        chains.append([joint for joint in chain if joint in moving])
    common = set(chains[0]) & set(chains[1])
    first, second = ([joint for joint in chain if joint not in common] for chain in chains)
    if not first or not second:
        part.refuse(f"{part.owner} couples links between which nothing moves", "Name links of two branches.")
    own, *others = second
    (of, *more) = first
    also = (*((joint, ratio) for joint in more), *((joint, -1.0) for joint in others))
    return Coupling(name, own, of, (0.0, ratio), also)


def _driven(part: UrdfPart) -> list[str]:
    """Return the joints that a transmission names, or the joints of ros2_control that take commands."""
    names = []
    for joint in part.deep("joint"):
        name = joint.text_of("name") or joint.content()
        if part.tag == "transmission" or joint.parts("command_interface"):
            names.append(name)
    return names


def _rotor_inertia(part: UrdfPart) -> float:
    """Return the inertia of the rotor of a transmission as its joint feels it, as in Drake; 0 without one."""
    values = {}
    for key, default in (("rotor_inertia", 0.0), ("gear_ratio", 1.0)):
        given = part.deep(DRAKE + key)
        values[key] = given[0].number("value", key) if given else default
        if values[key] < 0.0:
            given[0].refuse(f"{part.owner} has a negative {key}, {values[key]:g}")
    return values["gear_ratio"] ** 2 * values["rotor_inertia"]


def _closing(robot: UrdfPart, links: set[str]) -> tuple[tuple[str, str], ...]:
    """Return the pairs of links closing_NAME_1 and closing_NAME_2."""
    ends: dict[str, dict[str, str]] = {}
    for link in sorted(links):
        if match := _CLOSING.fullmatch(link):
            ends.setdefault(match[1], {})[match[2]] = link
    for name, pair in ends.items():
        if len(pair) != 2:
            (only,) = pair.values()
            robot.refuse(f"The link {only!r} has no other end, closing_{name}_1 or _2", "Add it, or rename the link.")
    return tuple((pair["1"], pair["2"]) for pair in ends.values())


def _link(part: UrdfPart, name: str, links: set[str]) -> str:
    if name not in links:
        what = f"names {name!r}, which is no link" if name else "names no link"
        part.refuse(f"{part.owner} {what}", did_you_mean(name, sorted(links)).strip() or "Name a link of the file.")
    return name
