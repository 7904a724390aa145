"""Changes of a robot that its files have no arguments for: masses and lengths in its URDF, limits of its joints."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked, require_type
from redundancy_pin.errors import InputError, one_of, shown
from redundancy_pin.robot.formats.xml_files import DRAKE
from redundancy_pin.robot.joint_ranges import ROUNDING
from redundancy_pin.robot.lookup import find_joint, find_link
from redundancy_pin.robot.types import Robot

_INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_CARRIER_LIMITS = ("lower", "upper", "speed", "acceleration", "force")
_JOINT_LIMITS = ("lower", "upper", "speed", "effort")


def changed_urdf(urdf: str, masses: Mapping[str, float], lengths: Mapping[str, Any]) -> str:
    """Return a URDF with other masses of links and other places of joints.

    Args:
        urdf: its text.
        masses: kg, by link; the moments of inertia of a link grow as its mass does, its centre stays.
        lengths: by joint, its distance from the joint before it, m, in the direction that it has; or (3,) its place in
            the frame of its parent link, m. Links keep masses, centres and moments of inertia.

    Raises:
        InputError: an unknown name, a negative mass, a link without mass, a direction that is none.
    """
    root = ElementTree.fromstring(urdf)
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


def require_still_joined(before: Robot, after: Robot) -> None:
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


def with_limits(
    robot: Robot,
    limits: Mapping[str, Mapping[str, float]] | None = None,
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    speed: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    force: ArrayLike | None = None,
) -> Robot:
    """Return a robot with other limits of its carriers and joints; what is left out stays.

    Args:
        robot: the robot, as ``load_robot`` returns it.
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
        >>> slow = with_limits(load_robot("3rrr"), {"elbow_1": {"upper": 2.5}}, speed=0.5)
    """
    require_type(robot, Robot, "A robot", "Pass load_robot(...).")
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
