"""A robot with other masses, lengths, xacro arguments or limits than its files have."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked
from redundancy_pin.errors import InputError, one_of, shown
from redundancy_pin.loading.files import RobotLike, as_robot, load_with
from redundancy_pin.loading.mechanism import OpenedModel, select_rows, warn_once
from redundancy_pin.loading.reference import close_reference
from redundancy_pin.robot import Robot
from redundancy_pin.robot.declaration import read_declaration
from redundancy_pin.robot.formats.xml_files import DRAKE, parsed_text
from redundancy_pin.robot.joint_ranges import ROUNDING
from redundancy_pin.robot.loads import Load
from redundancy_pin.robot.lookup import find_joint, find_link, joint_names
from redundancy_pin.robot.model_files import is_model_file, is_urdf, mechanism_of_urdf
from redundancy_pin.robot.propose import propose
from redundancy_pin.robot.rebuild import LIMITS
from redundancy_pin.robot.shipped import declaration_path

_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_CARRIER_LIMITS = ("lower", "upper", "speed", "acceleration", "force")
_JOINT_LIMITS = ("lower", "upper", "speed", "effort")


def with_parameters(
    robot: RobotLike,
    /,
    *,
    masses: Mapping[str, float] | None = None,
    lengths: Mapping[str, Any] | None = None,
    **arguments: object,
) -> Robot:
    """Return a robot with other masses, lengths or xacro arguments, closed and checked as when it was loaded.

    Gravity, working mode and loads stay; limits too, unless xacro arguments are given. A robot whose masses or
    lengths are changed has no closed form any more (``VirtualWork`` refuses it): that is written in the arguments.

    Args:
        robot: a robot, or its name or path.
        masses: kg, by link; the moments of inertia of a link grow as its mass does, its centre stays. (Derivatives
            by ``"JOINT.mass"`` hold the inertia about the centre: ``dynamics.compiled.design_of``.)
        lengths: by joint, its distance from the joint before it, m; or (3,) its place in the frame of its parent
            link, m. This moves joints and frames only: masses, centres and moments of inertia of the links stay as
            they were; ``notes`` and the log name them. Xacro arguments of a file change both.
        **arguments: xacro arguments, as of ``load_robot``; the others stay.

    Raises:
        InputError: unknown names, values out of their domain, a robot that was not loaded from a URDF, or lengths
            that part a frame of a closure or the platform from a joint or frame at the same place.
        DeclarationError: the chains do not close at the declared reference any more.

    Example:
        >>> heavier = rp.with_parameters("four_bar", masses={"rocker_link": 2.5})
    """
    robot = as_robot(robot)
    masses, lengths = {} if masses is None else masses, {} if lengths is None else lengths
    path = declaration_path(robot.source) if robot.source else None
    file = None if path is None or is_model_file(path) else read_declaration(path)
    if path is None or not is_urdf(path if file is None else Path(file.data["urdf"])):
        raise InputError(
            f"{robot.name} was not loaded from a URDF.",
            remedy="Change its Pinocchio model, or its file, and make the robot of that.",
        )
    mode = robot.working_mode or None
    if arguments:
        if any(note.startswith(_CHANGED) for note in robot.notes):
            raise InputError(
                f"Masses or lengths of {robot.name} are changed already; its arguments would be read from its files.",
                remedy="Give the arguments first, or all in one call.",
            )
        loads = robot.loads
        robot = load_with(
            robot.source, {**robot.parameters, **arguments}, gravity=robot.gravity.tolist(), working_mode=mode
        )
        robot = _with_added(robot, loads)
    if not (masses or lengths):
        return robot
    with nullcontext() if file is None else file.naming():
        roles = {"actuated": list(robot.actuated), "independent": {"joints": list(robot.independent_joints)}}
        data = {"urdf": path.name, **roles} if file is None else file.data
        declaration = OpenedModel(path, data, robot.parameters).declaration()
        mechanism = mechanism_of_urdf(
            _changed_urdf(robot.urdf, masses, lengths),
            path.parent / declaration.urdf,
            robot.parameters,
            None if file is None else declaration.joint_types,
        )
        if file is None:  # ends of loops that were found stay ends; the reference is the nearest closed configuration
            stated = {joint.name for joint in mechanism.loop_joints}
            found = [f"{each.frame_a},{each.frame_b}" for each in robot.closures if each.name not in stated]
            mechanism = propose(mechanism, close=found, is_open=True).mechanism
            # balls that moved freely when the robot was loaded
            mechanism = mechanism.with_hinges({*joint_names(mechanism.model)} - {*joint_names(robot.model)})
            mechanism = replace(mechanism, start=np.array(robot.q_reference))
        new, dropped = select_rows(
            declaration,
            mechanism,
            gravity=robot.gravity.tolist(),
            parameters=robot.parameters,
            source=robot.source,
            mode=mode,
            rods={each.name: each.length for each in robot.closures},
        )
        new = replace(
            new,
            name=robot.name,
            urdf_folder=robot.urdf_folder,
            carrier_limits=robot.carrier_limits,
            own_meshes_only=robot.own_meshes_only,
            closed_form=None,  # it is written in the arguments, which say something else now
            notes=(*robot.notes, f"{_CHANGED} {', '.join([*masses, *lengths])}", *_lengths_only(robot, lengths)),
        )
        for attribute in LIMITS:
            setattr(new.model, attribute, getattr(robot.model, attribute))
        if lengths:
            _require_still_joined(robot, new)
            new = close_reference(new, declaration, robot.parameters, dropped)
        else:  # masses close no loop: the reference is that of the robot
            new = replace(new, q_reference=robot.q_reference, characteristic_length=robot.characteristic_length)
        return _with_added(new, robot.loads)


def _with_added(robot: Robot, loads: tuple[Load, ...]) -> Robot:
    """Return a robot that was read again, with the loads that were added later: it has the loads of its files."""
    added = loads[len(robot.loads) :]
    return robot.loaded(*added) if added else robot


_CHANGED = "changed since it was loaded:"
"""How a note begins that says so."""


def _lengths_only(robot: Robot, lengths: Iterable[str]) -> tuple[str, ...]:
    """Return a note that lengths change no masses, and log it; nothing without lengths."""
    if not (names := ", ".join(lengths)):
        return ()
    note = f"The lengths at {names} move joints and frames: links keep masses, centres and moments of inertia."
    warn_once(f"{robot.name}: {note}")
    return (note,)


def _changed_urdf(urdf: str, masses: Mapping[str, float], lengths: Mapping[str, Any]) -> str:
    """Return a URDF with other masses of links and other places of joints.

    Args:
        urdf: its text.
        masses: kg, by link; the moments of inertia of a link grow as its mass does, its centre stays.
        lengths: by joint, its distance from the joint before it, m, in the direction that it has; or (3,) its place in
            the frame of its parent link, m. Links keep masses, centres and moments of inertia.

    Raises:
        InputError: an unknown name, a negative mass, a link without mass, a length without direction.
    """
    root = parsed_text(urdf, "The URDF")
    links = {str(link.get("name")): link for link in root.findall("link")}
    joints = {str(joint.get("name")): joint for tag in ("joint", DRAKE + "joint") for joint in root.findall(tag)}
    for name, value in _items(masses, "masses"):
        moved = joints[name].find("child").get("link") if name in joints and name not in links else ""  # type: ignore[union-attr]
        _scale_mass(_named(name, links, "link", f"The joint {name} moves {moved}. " if moved else ""), name, value)
    for name, value in _items(lengths, "lengths"):
        _place(_named(name, joints, "joint"), name, value)
    return ElementTree.tostring(root, encoding="unicode")


def _items(values: Mapping[str, Any], what: str) -> list[tuple[str, Any]]:
    if not isinstance(values, Mapping):
        raise InputError(
            f"{what} is {shown(values)}, not a mapping.", remedy=f"Pass {what}={{name: value}}.", name=what
        )
    return list(values.items())


def _named(name: str, known: Mapping[str, Any], what: str, hint: str = "") -> Any:
    if name not in known:
        raise InputError(
            f"The robot has no {what} {shown(name)}.",
            remedy=f"{hint}{one_of(name, known)}",
            name=name,
        )
    return known[name]


def _number(value: Any, name: str, fits: Callable[[float], bool], wanted: str) -> float:
    try:
        number = math.nan if isinstance(value, (str, bool)) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not fits(number):
        raise InputError(f"{name} is {shown(value)}, expected {wanted}.", remedy="Use SI units.", name=name)
    return number


def _scale_mass(link: Any, name: str, value: Any) -> None:
    mass = _number(value, f"The mass of {name}", lambda m: 0.0 <= m < math.inf, "a number of kg that is not negative")
    inertial = link.find("inertial")
    there = 0.0 if inertial is None else float(inertial.find("mass").get("value"))
    if not there > 0.0:
        raise InputError(
            f"The link {name!r} has no mass, and nothing says how a mass of it would be spread.",
            remedy="Give it an <inertial> in the URDF, or a mass to another link.",
            name=name,
        )
    inertial.find("mass").set("value", repr(mass))
    inertia = inertial.find("inertia")
    for key in _INERTIA:
        inertia.set(key, repr(float(inertia.get(key, "0")) * mass / there))


def _place(joint: Any, name: str, value: Any) -> None:
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(joint, "origin")
    place = np.array([float(part) for part in origin.get("xyz", "0 0 0").split()])
    if np.ndim(np.asarray(value, dtype=object)) == 1:
        place = np.array(checked(value, f"The place of {name}", (3,)))
    else:
        length = _number(value, f"The length to {name}", lambda d: 0.0 <= d < math.inf, "a length in m, or (x, y, z)")
        own = float(np.linalg.norm(place))
        if own == 0.0:
            raise InputError(
                f"The joint {name!r} sits on the joint before it: its length has no direction.",
                remedy="Pass its place, (x, y, z).",
                name=name,
            )
        place = place * (length / own)
    origin.set("xyz", " ".join(repr(part) for part in place.tolist()))


def _require_still_joined(before: Robot, after: Robot) -> None:
    """Check that other lengths leave the frames of closures and platform where the same joints and frames are.

    A frame at the end of a rod, and a joint or another frame that is there too, are two places in the file: a length
    that moves one of them makes another mechanism.

    Raises:
        InputError: naming the frame, what was there, and the distance between them now.
    """
    closures = (name for each in before.closures for name in (each.frame_a, each.frame_b))
    frames = dict.fromkeys((*closures, *((before.platform.frame,) if before.platform else ())))
    places = [_places(robot.model) for robot in (before, after)]
    slack = ROUNDING * before.characteristic_length
    for frame in frames:
        own = [find_link(robot.model, frame) for robot in (before, after)]
        for name, (body, place) in places[0].items():
            if body != own[0].parentJoint or np.linalg.norm(place - own[0].placement.translation) > slack:
                continue
            apart = float(np.linalg.norm(places[1][name][1] - own[1].placement.translation))
            if apart > slack:
                mount = after.model.frames[own[1].parentFrame].name
                raise InputError(
                    f"The frame {frame!r} and the joint {name!r} were at one place, and are {apart:.4g} m apart now.",
                    remedy=f"Pass the lengths of both: {mount!r} and {name!r}.",
                    name=frame,
                    distance=apart,
                )


def _places(model: pin.Model) -> dict[str, tuple[int, Array]]:
    """Return by joint, fixed ones too, the index of the body that it is on, and its place (3,) on that body, m."""
    places = {
        str(model.names[index]): (int(model.parents[index]), model.jointPlacements[index].translation)
        for index in range(1, model.njoints)
    }
    fixed = (frame for frame in model.frames if frame.type == pin.FrameType.FIXED_JOINT)
    return {**places, **{frame.name: (int(frame.parentJoint), frame.placement.translation) for frame in fixed}}


# --- limits -----------------------------------------------------------------------------------------------------------


def with_limits(
    robot: RobotLike,
    limits: Mapping[str, Mapping[str, float]] | None = None,
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    speed: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    force: ArrayLike | None = None,
) -> Robot:
    """Return a robot with other limits of its carriers and joints; others stay.

    Args:
        robot: a robot, or its name or path.
        limits: by joint, such as ``{"carrier_1": {"upper": 0.3}, "elbow_1": {"lower": -2.5, "effort": 20.0}}``: of
            a carrier "lower", "upper", "speed", "acceleration", "force"; of another joint "lower", "upper",
            "speed", "effort".
        lower: scalar or (k,) where the tracks of all carriers begin, m.
        upper: scalar or (k,) where they end, m.
        speed: scalar or (k,) their largest |ṡ|, m/s; infinite for no limit.
        acceleration: scalar or (k,) their largest |s̈|, m/s².
        force: scalar or (k,) their largest force, N.

    Raises:
        InputError: unknown names, tracks that end before they begin, or limits that are not positive.

    Example:
        >>> slow = rp.with_limits("3rrr", {"elbow_1": {"upper": 2.5}}, speed=0.5)
    """
    robot = as_robot(robot)
    each = {"lower": lower, "upper": upper, "speed": speed, "acceleration": acceleration, "force": force}
    wanted: dict[str, dict[str, Any]] = {name: {} for name in robot.carriers}
    for key, numbers in each.items():
        if numbers is None:
            continue
        given = np.asarray(numbers, dtype=object)  # rows of different lengths are objects, and no numbers: said below
        if given.shape not in ((), (robot.k,)):
            raise InputError(
                f"{key} has shape {given.shape}; {robot.name} has k = {robot.k} carriers.",
                remedy="Pass one number, or one for each carrier.",
                name=key,
            )
        for name, value in zip(robot.carriers, np.broadcast_to(given, (robot.k,)), strict=True):
            wanted[name][key] = value
    for name, entries in _items(limits or {}, "limits"):
        wanted.setdefault(name, {}).update(_items(entries, f"The limits of {name}"))
    model, tracks = robot.model.copy(), dict(zip(robot.carriers, robot.carrier_limits, strict=True))
    for name, entries in wanted.items():
        joint = find_joint(model, name)
        values = {key: _limit(joint, name, key, value, carries=name in tracks) for key, value in entries.items()}
        if name in tracks:
            tracks[name] = track = replace(tracks[name], **values)
            values = {"lower": track.lower, "upper": track.upper}  # what else reads the model sees the same
        _set_limits(model, joint, name, values)
    return replace(robot, model=model, carrier_limits=tuple(tracks.values()))


def _limit(joint: pin.JointModel, name: str, key: str, value: Any, *, carries: bool) -> float:
    """Return one limit of a joint as a number that it may have."""
    known = _CARRIER_LIMITS if carries else _JOINT_LIMITS
    if key not in known:
        raise InputError(
            f"The joint {name!r} has no limit {shown(key)}.",
            remedy=one_of(key, known),
            name=key,
        )
    if joint.nv != 1 or (joint.nq != 1 and key in ("lower", "upper")):
        raise InputError(
            f"The joint {name!r} has no {key} limit: it is {'continuous' if joint.nv == 1 else 'of several freedoms'}.",
            remedy="Leave it out.",
            name=key,
        )
    if key not in ("lower", "upper"):
        return _number(value, f"{key} of {name}", lambda most: most > 0.0, "a positive number, or infinity for none")
    if carries:
        return _number(value, f"{key} of {name}", math.isfinite, "a finite number")
    return _number(value, f"{key} of {name}", lambda place: not math.isnan(place), "a number")


def _set_limits(model: pin.Model, joint: pin.JointModel, name: str, values: Mapping[str, float]) -> None:
    """Set limits of a joint in a model: of position both at once, of speed and effort both ways."""
    for key in ("speed", "effort"):
        if key in values:
            what = "Velocity" if key == "speed" else "Effort"
            getattr(model, f"upper{what}Limit")[joint.idx_v] = values[key]
            getattr(model, f"lower{what}Limit")[joint.idx_v] = -values[key]
    if not {"lower", "upper"} & set(values):
        return
    at = joint.idx_q
    low, high = model.lowerPositionLimit[at], model.upperPositionLimit[at]
    if not low < high:  # a URDF says so where it knows no limits: one that is set does not put the other in force
        low, high = -math.inf, math.inf
    low, high = values.get("lower", low), values.get("upper", high)
    if not low < high:
        raise InputError(f"The joint {name!r} runs from {low:g} to {high:g}.", remedy="Pass lower < upper.", name=name)
    model.lowerPositionLimit[at], model.upperPositionLimit[at] = low, high
