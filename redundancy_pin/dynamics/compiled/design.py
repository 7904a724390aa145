"""Design parameters: which of a tree's numbers they change, and how much.

Results depend on a parameter through numbers of the loaded tree alone: placements of joints and frames, masses, first
moments and inertias. Here are the derivatives of those, a column for each parameter; the rest of the way is casadi's.

Inertial parameters are mass m, first moment m c and inertia about the joint's origin, in which forces are linear: they
stay differentiable at bodies without mass.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from redundancy_pin.arrays import Array, Frozen, IntArray, frozen
from redundancy_pin.errors import InputError, RedundancyPinError, UnsupportedRobotError, did_you_mean
from redundancy_pin.robot import Payload, Robot, Spring, Wrench
from redundancy_pin.robot.build import build
from redundancy_pin.robot.declaration import parse, read_declaration
from redundancy_pin.robot.formats.duals import Dual, derivatives_kept, read
from redundancy_pin.robot.formats.xacro_engine import expand
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint_index, find_link
from redundancy_pin.robot.urdf import declaration_path, render

_STEP = 0.01
"""Step of the differences, relative to the parameter: of order six they err by 1e-12/140 of its seventh derivative, and
by 1e-14 in rounding. Sums, products and powers up to the sixth are exact."""

_NODES = 6


@dataclass(frozen=True, eq=False)
class Design(Frozen):
    """Derivatives of a tree's numbers by d design parameters.

    Attributes:
        names: the parameters.
        placements: by joint or link, (6, d): its frame's displacement, m, in its parent's axes (of a link its joint's),
            then its rotation vector, rad, in its own axes.
        inertias: by joint, (13, d): mass, kg, first moment m c, kg m (3), and inertia about the joint's origin, kg m²,
            row by row (9), all in the axes of the joint's frame.
    """

    names: tuple[str, ...]
    placements: Mapping[str, Array]
    inertias: Mapping[str, Array]


class _Numbers(NamedTuple):
    """Numbers of one tree, by name."""

    placements: dict[str, pin.SE3]
    inertias: dict[str, Array]


def design_of(robot: Robot, names: Sequence[str], *, trust: bool = False) -> Design:
    """Return how a robot's tree depends on parameters.

    A parameter is a number of its xacro file (``"distal_length"``), or one of the tree's own:

    - ``"JOINT.mass"``, of the body that the joint moves, its centre and inertia about the centre held;
    - ``"JOINT.centre.x"``, ``.y``, ``.z`` in the joint's frame, mass and inertia about the centre held;
    - ``"JOINT.inertia.xx"``, ``.xy``, ... about the centre, axes of the joint's frame;
    - ``"JOINT.origin.x"``, ..., ``.rx``, ``.ry``, ``.rz``: the joint's frame moved along its parent's axes, or turned
      about its own; ``"LINK.origin.x"``, ... likewise for a link of a closure or of the platform.

    The tree's own are exact, and so are numbers of the xacro file: it is expanded once with dual numbers
    (``robot.formats.duals``), of which placements and inertias are put together in complex steps. Where the file does
    more with a number than has a derivative (rounds it, say, or writes it by a layout), or expands by Python alone
    (``trust``), it is loaded seven times or less with changed arguments, and placements and inertias are differenced,
    to order six: smooth functions to 1e-14 or so. All other arguments are held, also those whose defaults would follow.

    Args:
        robot: the robot.
        names: the parameters.
        trust: as in ``load_robot``, for a xacro file that was loaded so.

    Raises:
        InputError: an unknown parameter, or one that is not a number.
        UnsupportedRobotError: a parameter that changes the axis, the type or the number of joints, or of a robot that
            was not loaded from a file.
    """
    return _design(robot, tuple(names), trust)


@lru_cache(maxsize=64)
def _design(robot: Robot, names: tuple[str, ...], trust: bool) -> Design:
    of_file = tuple(name for name in names if name in robot.parameters)
    for name in of_file:
        _require_number(robot, name)
    try:
        exact = by_duals(robot, of_file)
    except (RedundancyPinError, ValueError, LookupError):  # the file does more with its numbers than has derivatives
        exact = {}
    columns = [
        exact[name] if name in exact else by_xacro(robot, name, trust) if name in of_file else by_tree(robot, name)
        for name in names
    ]
    own = _numbers(robot)
    placements, inertias = (
        {
            key: frozen(np.stack([column[part].get(key, np.zeros(size)) for column in columns], axis=1))
            for key in (own.placements, own.inertias)[part]
            if any(key in column[part] for column in columns)
        }
        for part, size in ((0, 6), (1, 13))
    )
    return Design(names, MappingProxyType(placements), MappingProxyType(inertias))


Complex = NDArray[np.complex128]

_Column = tuple[dict[str, Array], dict[str, Array]]


def links_of(robot: Robot) -> list[str]:
    """Return the links whose frames closures, the platform, wrenches and springs are made of."""
    links = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
    links += [robot.platform.frame] if robot.platform else []
    links += [load.frame for load in of_kind(robot.loads, Wrench)]
    links += [name for load in of_kind(robot.loads, Spring) for name in (load.frame_a, load.frame_b)]
    return list(dict.fromkeys(links))


def _numbers(robot: Robot) -> _Numbers:
    model = robot.model
    placements = {str(model.names[i]): model.jointPlacements[i] for i in range(1, model.njoints)}
    for link in links_of(robot):
        placements[link] = find_link(model, link).placement
    return _Numbers(placements, {str(model.names[i]): _moments(model.inertias[i]) for i in range(1, model.njoints)})


def _moments(body: pin.Inertia) -> Array:
    """Return (13,) mass, first moment and inertia about the origin."""
    mass, centre = body.mass, np.array(body.lever) if body.mass else np.zeros(3)
    about = np.array(body.inertia) + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([[mass], mass * centre, about.ravel()])


# --- the tree's own numbers -------------------------------------------------------------------------------------------

_OF_FRAMES = ("x", "y", "z", "rx", "ry", "rz")


def by_tree(robot: Robot, name: str) -> _Column:
    """Return the derivatives of placements and inertias by one number of the tree itself."""
    numbers = _numbers(robot)
    owner, what, axis = _split(name)
    if what == "origin" and owner in numbers.placements and axis in _OF_FRAMES:
        return {owner: np.eye(6)[_OF_FRAMES.index(axis)]}, {}
    if owner in numbers.inertias:
        body = robot.model.inertias[find_joint_index(robot.model, owner)]
        mass, centre = body.mass, np.array(body.lever) if body.mass else np.zeros(3)
        if what == "mass" and not axis:
            about = centre @ centre * np.eye(3) - np.outer(centre, centre)
            return {}, {owner: np.concatenate([[1.0], centre, about.ravel()])}
        if what == "centre" and axis in ("x", "y", "z"):
            along = np.eye(3)["xyz".index(axis)]
            about = 2.0 * (along @ centre) * np.eye(3) - np.outer(along, centre) - np.outer(centre, along)
            return {}, {owner: mass * np.concatenate([[0.0], along, about.ravel()])}
        if what == "inertia" and len(axis) == 2 and set(axis) <= set("xyz"):
            i, j = ("xyz".index(letter) for letter in axis)
            about = np.zeros((3, 3))
            about[i, j] = about[j, i] = 1.0
            return {}, {owner: np.concatenate([np.zeros(4), about.ravel()])}
    arguments = [key for key, value in robot.parameters.items() if not isinstance(value, (bool, str))]
    raise InputError(
        f"{robot.name} has no design parameter {name!r}.",
        remedy=f"{did_you_mean(name, arguments)}Its numbers: {', '.join(arguments) or 'none'}; of the tree JOINT.mass, "
        "JOINT.centre.x, JOINT.inertia.xx, JOINT.origin.x or .rx; LINK.origin.x or .rx of closures and platform.",
        parameter=name,
    )


def _split(name: str) -> tuple[str, str, str]:
    """Return owner, quantity and axis; names of joints may have dots."""
    parts = name.split(".")
    if parts[-1] == "mass":
        return ".".join(parts[:-1]), "mass", ""
    return (".".join(parts[:-2]), parts[-2], parts[-1]) if len(parts) > 2 else ("", "", "")


# --- numbers of the xacro file ----------------------------------------------------------------------------------------


def _require_number(robot: Robot, name: str) -> None:
    value = robot.parameters[name]
    if isinstance(value, (bool, str)):
        raise InputError(
            f"The parameter {name!r} of {robot.name} is {value!r}: nothing can be differentiated by it.",
            remedy="Name parameters that are numbers.",
            parameter=name,
        )
    if of_kind(robot.loads, Payload):
        raise UnsupportedRobotError(
            f"{robot.name} has a payload, which {name!r} may move on its link: that derivative is not known.",
            remedy="Name the tree's own numbers, such as JOINT.mass and JOINT.origin.x.",
            parameter=name,
        )
    if not robot.source:
        raise UnsupportedRobotError(
            f"{robot.name} was not loaded from a file, so how it depends on {name!r} is not known.",
            remedy="Name the tree's own numbers, such as JOINT.mass and JOINT.origin.x.",
            parameter=name,
        )


def by_duals(robot: Robot, names: tuple[str, ...]) -> dict[str, _Column]:
    """Return exact derivatives by numbers of the xacro file, which is expanded once, with dual numbers.

    Raises:
        ValueError: a parameter changes more than places and masses, or the tree is another than the robot has.
        ModelFileError: the file makes something of a number that has no derivative here.
    """
    if not names:
        return {}
    file = read_declaration(declaration_path(robot.source))
    for name in names:
        value = float(robot.parameters[name])
        other = {**robot.parameters, name: value + _STEP * (abs(value) or 1.0)}
        if repr(parse(file.data, other).loads) != repr(parse(file.data, robot.parameters).loads):
            raise ValueError(name)
    source = declaration_path(robot.source).parent / file.data["urdf"]
    own, units = _numbers(robot), np.eye(len(names))
    with derivatives_kept():
        given = {
            key: str(value).lower() if isinstance(value, bool) else str(value)
            for key, value in robot.parameters.items()
        } | {name: str(Dual(float(robot.parameters[name]), unit)) for name, unit in zip(names, units, strict=True)}
        urdf, _ = expand(source, given, trust=False)
        trees = [_marked_tree(urdf, i) for i in range(len(names))]
    columns = {}
    for name, (places, bodies) in zip(names, trees, strict=True):
        if set(own.inertias) != set(bodies):
            raise ValueError(name)
        placements, inertias = dict[str, Array](), dict[str, Array]()
        for key, here in own.placements.items():
            R, p = places[key]
            _require_same(R, here.rotation)
            _require_same(p, here.translation)
            turn = here.rotation.T @ R.imag / _COMPLEX
            placements[key] = np.concatenate([p.imag / _COMPLEX, [turn[2, 1], turn[0, 2], turn[1, 0]]])
        for key, moments in own.inertias.items():
            _require_same(bodies[key], moments)
            inertias[key] = bodies[key].imag / _COMPLEX
        columns[name] = _moving(placements), _moving(inertias)
    return columns


_COMPLEX = 1e-30
"""Step into the complex numbers, beside which nothing is lost: derivatives to rounding."""

_SAME = 1e-9
"""Relative difference of what two readers make of the same numbers."""

_RIGID = ("axis", "mimic", "dynamics")
"""Elements of a joint whose numbers no parameter may change."""


def _moving(columns: dict[str, Array]) -> dict[str, Array]:
    return {key: column for key, column in columns.items() if column.any()}


def _require_same(one: Complex, other: Array) -> None:
    if not np.allclose(one.real, other, rtol=_SAME, atol=_SAME * float(np.abs(other).max(initial=0.0))):
        raise ValueError("The tree is another than the robot's.")


def _marked_tree(urdf: str, i: int) -> tuple[dict[str, tuple[Complex, Complex]], dict[str, Complex]]:
    """Return placements of joints and links in the frame of the joint that carries them, and moments by joint.

    Each number has its derivative by parameter ``i`` as imaginary part, times ``_COMPLEX``.
    """
    root = ElementTree.fromstring(urdf)

    def numbers(element: ElementTree.Element | None, key: str, count: int) -> Complex:
        texts = (element.get(key) if element is not None else None) or " ".join(["0"] * count)
        values = [read(text) for text in texts.split()]
        return np.array(
            [complex(x, _COMPLEX * x.dot[i] if isinstance(x, Dual) else 0.0) for x in values if x is not None]
        )

    def origin(element: ElementTree.Element) -> tuple[Complex, Complex]:
        at = element.find("origin")
        (sr, sp, sy), (cr, cp, cy) = (wave(numbers(at, "rpy", 3)) for wave in (np.sin, np.cos))
        turn = np.array(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )
        return turn, numbers(at, "xyz", 3)

    joints = {_end(joint, "child"): joint for joint in root.findall("joint")}
    for joint in joints.values():
        for element in (part for tag in _RIGID for part in joint.findall(tag)):
            if any(isinstance(read(text), Dual) for value in element.attrib.values() for text in value.split()):
                raise ValueError(f"{joint.get('name')} changes")
    places: dict[str, tuple[Complex, Complex]] = {}
    carrying: dict[str, str] = {}

    def placed(link: str) -> tuple[Complex, Complex]:
        """Return where a link is in the frame of the joint that carries it."""
        if link not in joints:
            carrying[link] = ""
            return places.setdefault(link, _here())
        if link not in places:
            joint = joints[link]
            parent, name = _end(joint, "parent"), str(joint.get("name"))
            R, p = placed(parent)
            turn, offset = origin(joint)
            at = R @ turn, p + R @ offset
            if joint.get("type") == "fixed":
                carrying[link], places[link] = carrying[parent], at
            else:
                carrying[link], places[name] = name, at
                places[link] = _here()
        return places[link]

    bodies: dict[str, Complex] = {
        str(joint.get("name")): np.zeros(13, complex) for joint in joints.values() if joint.get("type") != "fixed"
    }
    for link in root.findall("link"):
        name, inertial = str(link.get("name")), link.find("inertial")
        R, p = placed(name)
        if inertial is None or not carrying[name]:
            continue
        turn, centre = origin(inertial)
        (mass,) = numbers(inertial.find("mass"), "value", 1)
        about = np.array(
            [[numbers(inertial.find("inertia"), "i" + "".join(sorted(a + b)), 1)[0] for b in "xyz"] for a in "xyz"]
        )
        R, c = R @ turn, p + R @ centre
        inertia = R @ about @ R.T + mass * (c @ c * np.eye(3) - np.outer(c, c))
        bodies[carrying[name]] += np.concatenate([[mass], mass * c, inertia.ravel()])
    return places, bodies


def _here() -> tuple[Complex, Complex]:
    return np.eye(3, dtype=np.complex128), np.zeros(3, dtype=np.complex128)


def _end(joint: ElementTree.Element, role: str) -> str:
    end = joint.find(role)
    return "" if end is None else str(end.get("link"))


def by_xacro(robot: Robot, name: str, trust: bool) -> _Column:
    """Return differences, for files that do more with their numbers than has derivatives."""
    value = float(robot.parameters[name])
    # at zero to one side: a negative mass or length would be refused
    offsets = np.arange(-3, 4) if value else np.arange(_NODES + 1)
    step = _STEP * (abs(value) if value else 1.0)
    weights = _difference_weights(offsets) / step
    used = [(float(weight), float(value + i * step)) for i, weight in zip(offsets, weights, strict=True) if weight]
    others = [_reloaded(robot, name, at, trust) for _, at in used]
    if len({repr(other.loads) for other in others}) > 1:
        raise UnsupportedRobotError(
            f"The parameter {name!r} changes friction, rotors or springs of {robot.name}, by which nothing is known.",
            remedy="Differentiate by parameters that move joints and change masses and lengths.",
            parameter=name,
        )
    trees = [(weight, _numbers(other)) for (weight, _), other in zip(used, others, strict=True)]
    own = _numbers(robot)
    placements = {
        key: sum((weight * _moved(placement, tree.placements[key]) for weight, tree in trees), np.zeros(6))
        for key, placement in own.placements.items()
    }
    inertias = {key: sum((weight * tree.inertias[key] for weight, tree in trees), np.zeros(13)) for key in own.inertias}
    return _without_rounding(placements, 1.0 / step), _without_rounding(inertias, 1.0 / step)


def _difference_weights(offsets: IntArray) -> Array:
    """Return the weights of values at these offsets in the first derivative at 0, exact for polynomials."""
    size = len(offsets)
    powers = np.vander(offsets.astype(float), size, increasing=True).T
    weights: Array = np.linalg.solve(powers, np.eye(size)[1])
    weights[np.abs(weights) < 1e-12] = 0.0  # the value itself has none in central differences
    return weights


def _moved(here: pin.SE3, there: pin.SE3) -> Array:
    turn = pin.log3(here.rotation.T @ there.rotation)
    return np.concatenate([there.translation - here.translation, turn])


def _without_rounding(columns: dict[str, Array], size: float) -> dict[str, Array]:
    """Return the columns in which more than rounding is left, and zeros where nothing else is: they cost nothing."""
    kept = {}
    for key, column in columns.items():
        column[np.abs(column) < 1e-14 * size] = 0.0
        if column.any():
            kept[key] = column
    return kept


def _reloaded(robot: Robot, name: str, value: float, trust: bool) -> Robot:
    """Return the robot with another argument, chains not closed: joints, frames and bodies are all that is used."""
    path = declaration_path(robot.source)
    file = read_declaration(path)
    with file.naming():
        source = path.parent / file.data["urdf"]
        urdf, parameters = render(source, {**robot.parameters, name: value}, trust=trust)
        other = build(parse(file.data, parameters), path, urdf, parameters, None, None)
    if not _alike(robot.model, other.model):
        raise UnsupportedRobotError(
            f"The parameter {name!r} changes the joints of {robot.name}, their axes or their number (at {value:g}).",
            remedy="Differentiate by parameters that move joints and change masses and lengths.",
            parameter=name,
        )
    return other


def _alike(one: pin.Model, other: pin.Model) -> bool:
    if list(one.names) != list(other.names) or one.nq != other.nq:
        return False
    tolerance = math.sqrt(np.finfo(float).eps) * _STEP
    return bool(np.allclose(_axes(one), _axes(other), rtol=0.0, atol=tolerance)) and bool(
        np.allclose(one.armature, other.armature)
    )


def _axes(model: pin.Model) -> Array:
    """Return (6, nv) the joints' motion subspaces, side by side."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    columns = []
    for index in range(1, model.njoints):
        joint = model.joints[index]
        local = np.reshape(pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL), (6, model.nv))
        columns.append(local[:, joint.idx_v : joint.idx_v + joint.nv])
    return np.concatenate(columns, axis=1)
