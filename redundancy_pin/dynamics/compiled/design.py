"""Design parameters: which of a model's numbers they change, and how much.

Results depend on a parameter through the numbers of the loaded model alone (``parameters.numbers_of``). Here are the
derivatives of those, a column for each parameter; the rest of the way is casadi's.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, Frozen, IntArray, frozen
from redundancy_pin.dynamics.allocation import ROUNDING
from redundancy_pin.dynamics.compiled.parameters import motion_subspaces, numbers_of, places_of
from redundancy_pin.errors import InputError, UnsupportedRobotError, did_you_mean
from redundancy_pin.robot import Payload, Robot
from redundancy_pin.robot.build import read_robot
from redundancy_pin.robot.declaration import parse, read_declaration
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_link, has_link
from redundancy_pin.robot.model_files import open_model
from redundancy_pin.robot.shipped import declaration_path

_STEP = 0.01
"""Step of the differences, relative to the parameter: of order six they err by 1e-12/140 of its seventh derivative, and
by 1e-14 in rounding. Sums, products and powers up to the sixth are exact; up to the third, five values are enough."""


@dataclass(frozen=True, eq=False)
class Design(Frozen):
    """Derivatives of a model's numbers by d design parameters.

    Attributes:
        names: the parameters.
        columns: (F, d) derivatives of ``parameters.numbers_of(robot).values`` by the parameters.
    """

    names: tuple[str, ...]
    columns: Array


def design_of(robot: Robot, names: Sequence[str], *, trust: bool = False) -> Design:
    """Return how the numbers of a robot's model depend on parameters.

    A parameter is a number of its xacro file (``"distal_length"``), or one of the model's own:

    - ``"JOINT.mass"``, of the body that the joint moves, at fixed centre and inertia about the centre
      (``with_parameters`` takes links, and scales a link's inertia with its mass);
    - ``"JOINT.centre.x"``, ``.y``, ``.z`` in the joint's frame, at fixed mass and inertia about the centre;
    - ``"JOINT.inertia.xx"``, ``.xy``, ... about the centre, axes of the joint's frame;
    - ``"JOINT.origin.x"``, ..., ``.rx``, ``.ry``, ``.rz``: the joint's frame moved along its parent's axes, or turned
      about its own; ``"LINK.origin.x"``, ... likewise for a link of a closure or of the platform;
    - ``"ROD.length"`` of a rod that closes a loop.

    The model's own are exact. For a number of the xacro file the file is loaded four to six times with changed
    arguments, without closing its loops, and the model's numbers are differenced, to order six: smooth functions to
    1e-14 or so. Steps are a hundredth of the number; of a number that is 0, of the robot's characteristic length, or of
    1 if that is less. All other arguments are fixed, also arguments whose defaults would follow.

    Args:
        robot: the robot.
        names: the parameters.
        trust: as in ``load_robot``, for a xacro file that was loaded so.

    Raises:
        InputError: an unknown parameter, or one that is not a number.
        UnsupportedRobotError: a parameter that changes the axis, the type or the number of joints; a number of the
            xacro file of a robot that was not loaded from one, or whose masses, lengths or model were changed since.

    Example:
        >>> design = design_of(load_robot("3rrr"), ["distal_length", "elbow_1.mass"])
        >>> design.columns.shape[1]
        2
    """
    return _design(robot, tuple(names), trust)


@lru_cache(maxsize=64)
def _design(robot: Robot, names: tuple[str, ...], trust: bool) -> Design:
    columns = [by_xacro(robot, name, trust) if name in robot.parameters else by_model(robot, name) for name in names]
    return Design(names, frozen(np.array(columns).reshape(len(names), len(numbers_of(robot).values)).T))


# --- the model's own numbers ------------------------------------------------------------------------------------------

_OF_FRAMES = ("x", "y", "z", "rx", "ry", "rz")


def by_model(robot: Robot, name: str) -> Array:
    """Return the derivatives (F,) by one number of the model itself."""
    owner, what, axis = _split(name)
    model, numbers, places = robot.model, numbers_of(robot), places_of(robot)
    names = list(model.names)
    joint = names.index(owner) if owner in names else 0
    column = np.zeros(len(numbers.values))
    frame = ("joint", joint) if joint else ("link", owner)
    if what == "origin" and axis in _OF_FRAMES and (*frame, "origin") in places:
        along = np.eye(3)[_OF_FRAMES.index(axis) % 3]
        if axis in "xyz":
            column[places[(*frame, "origin")]] = along
        else:
            at = places[(*frame, "rotation")]
            column[at] = (numbers.values[at].reshape(3, 3) @ pin.skew(along)).ravel()
        return column
    rods = [i for i, each in enumerate(robot.closures) if each.is_rod and f"{each.name}.length" == name]
    if rods:
        column[places["rod", rods[0]]] = 1.0
        return column
    slope = _inertial_slope(model.inertias[joint], what, axis) if joint else None
    if slope is not None:
        column[places["joint", joint, "body"]] = slope
        return column
    hint = ""
    if what in ("mass", "centre", "inertia") and has_link(model, owner):
        moving = model.names[find_link(model, owner).parentJoint]
        hint = f"{owner} is a link, moved by the joint {moving}: '{moving}{name.removeprefix(owner)}'. "
    arguments = [key for key, value in robot.parameters.items() if not isinstance(value, (bool, str))]
    raise InputError(
        f"{robot.name} has no design parameter {name!r}.",
        remedy=f"{hint or did_you_mean(name, arguments)}Its numbers: {', '.join(arguments) or 'none'}; of the tree "
        "JOINT.mass, JOINT.centre.x, JOINT.inertia.xx, JOINT.origin.x or .rx; of closures and platform LINK.origin.x "
        "or .rx; of rods ROD.length.",
        parameter=name,
    )


def _inertial_slope(body: pin.Inertia, what: str, axis: str) -> Array | None:
    """Return the derivatives (10,) of Pinocchio's dynamic parameters by a number of a body, or None."""
    mass, centre = float(body.mass), np.array(body.lever)
    slope, about = np.zeros(10), np.zeros((3, 3))
    if what == "mass" and not axis:
        slope[0], slope[1:4] = 1.0, centre
        about = centre @ centre * np.eye(3) - np.outer(centre, centre)
    elif what == "centre" and axis in ("x", "y", "z"):
        along = np.eye(3)["xyz".index(axis)]
        slope[1:4] = mass * along
        about = mass * (2.0 * (along @ centre) * np.eye(3) - np.outer(along, centre) - np.outer(centre, along))
    elif what == "inertia" and len(axis) == 2 and set(axis) <= set("xyz"):
        i, j = ("xyz".index(letter) for letter in axis)
        about[i, j] = about[j, i] = 1.0
    else:
        return None
    slope[4:] = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]  # xx, xy, yy, xz, yz, zz
    return slope


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


def by_xacro(robot: Robot, name: str, trust: bool) -> Array:
    """Return the derivatives (F,) by a number of the xacro file, as differences of models with changed arguments."""
    _require_number(robot, name)
    value = float(robot.parameters[name])
    # at zero the unit is not known: small for a length of the machine, and for an angle
    step = _STEP * (abs(value) or min(1.0, robot.characteristic_length))
    loaded = {0: _reloaded(robot, trust)}
    for size in (5, 7):
        # at zero to one side: a negative mass or length would be refused
        offsets = np.arange(size) - (size // 2 if value else 0)
        loaded |= {i: _reloaded(robot, trust, (name, value + i * step)) for i in offsets.tolist() if i not in loaded}
        numbers = _numbers_of_all(robot, name, [loaded[i] for i in offsets.tolist()], loaded[0])
        bend = np.abs(np.diff(numbers, 4, axis=0)).max(axis=0)
        if (bend <= ROUNDING * np.abs(numbers).max(axis=0)).all():
            break  # a polynomial of degree three, as a mass times a length squared: five values are enough
    column: Array = _difference_weights(offsets) @ numbers / step
    # rounding: what is left of it would cost as much as a derivative
    column[np.abs(column) <= ROUNDING * np.abs(numbers).max(axis=0) / step] = 0.0
    return column


def _numbers_of_all(robot: Robot, name: str, loaded: Sequence[Robot], unchanged: Robot) -> Array:
    """Return (r, F) the numbers of the models of robots that were loaded with other values of a parameter."""
    if len({repr(each.loads) for each in loaded}) == 1:
        loaded = [dataclasses.replace(each, loads=robot.loads) for each in loaded]
        unchanged = dataclasses.replace(unchanged, loads=robot.loads)
    elif repr(unchanged.loads) != repr(robot.loads):
        raise UnsupportedRobotError(
            f"The parameter {name!r} changes loads of the file of {robot.name}, which was given other loads.",
            remedy="Differentiate the robot as it was loaded, or by parameters that change no loads.",
            parameter=name,
        )
    if not np.array_equal(numbers_of(unchanged).values, numbers_of(robot).values):
        raise UnsupportedRobotError(
            f"Masses, lengths or the model of {robot.name} were changed after it was loaded, and {name!r} is read from "
            "its file.",
            remedy="Change arguments of the file only, or name the tree's own numbers, such as JOINT.mass.",
            parameter=name,
        )
    return np.array([numbers_of(each).values for each in loaded])


def _difference_weights(offsets: IntArray) -> Array:
    """Return the weights of values at these offsets in the first derivative at 0, exact for polynomials."""
    size = len(offsets)
    powers = np.vander(offsets.astype(float), size, increasing=True).T
    return np.asarray(np.linalg.solve(powers, np.eye(size)[1]))


@lru_cache(maxsize=64)
def _reloaded(robot: Robot, trust: bool, changed: tuple[str, float] | None = None) -> Robot:
    """Return the robot with a changed argument, chains not closed: joints, frames and bodies are all that is used."""
    path = declaration_path(robot.source)
    file = read_declaration(path)
    with file.naming():
        arguments = {**robot.parameters, **dict([changed] if changed else [])}
        parameters, read = open_model(path.parent / file.data["urdf"], arguments, trust=trust)
        declaration = parse({"reference": {}, **file.data}, parameters)
        mechanism = read(declaration.joint_types, ())
        mechanism.model.gravity.linear = robot.gravity
        other = read_robot(declaration, mechanism, parameters=parameters, mode=robot.working_mode or None)
    if changed and not _alike(robot, other):
        name, value = changed
        raise UnsupportedRobotError(
            f"The parameter {name!r} changes the joints of {robot.name}, their axes or their number (at {value:g}).",
            remedy="Differentiate by parameters that move joints and change masses and lengths.",
            parameter=name,
        )
    return dataclasses.replace(other, characteristic_length=robot.characteristic_length)


def _alike(robot: Robot, changed: Robot) -> bool:
    one, other = robot.model, changed.model
    if list(one.names) != list(other.names) or one.nq != other.nq:
        return False
    tolerance = math.sqrt(np.finfo(float).eps) * _STEP
    ours, theirs = (np.concatenate(motion_subspaces(each), axis=1) for each in (robot, changed))
    return bool(np.allclose(ours, theirs, rtol=0.0, atol=tolerance))
