"""A trajectory by its name and values by key, or as one text: ``circle:speed=0.5``."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any, TypeGuard

from redundancy_pin.errors import InputError, did_you_mean, shown
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.trajectory.points import from_points
from redundancy_pin.trajectory.reference import TRAJECTORIES
from redundancy_pin.trajectory.trajectory import Trajectory

_WORDS = {"times": ("time-optimal",), "shape": ("3-4-5", "4-5-6-7")}
"""Values that are words, by key."""


def is_points_file(name: object) -> TypeGuard[str]:
    """Return whether the name of a trajectory names a file of points, CSV or JSON."""
    return isinstance(name, str) and name.lower().endswith((".csv", ".json"))


def split_trajectory(text: str) -> tuple[str, dict[str, object]]:
    """Return the name, or the file, and the values, as text, of ``name:key=value,...``.

    Raises:
        InputError: a part that is no ``key=value``, or a key twice.

    Example:
        >>> split_trajectory("circle:speed=0.5,ramp_time=0.2")
        ('circle', {'speed': '0.5', 'ramp_time': '0.2'})
    """
    file = re.match(r"(.*?\.(?:csv|json))(?::(.*))?$", text, re.IGNORECASE)
    name, rest = (file[1], file[2] or "") if file else text.partition(":")[::2]
    values: dict[str, object] = {}
    for pair in filter(None, rest.split(",")):
        key, separator, value = (part.strip() for part in pair.partition("="))
        if not separator:
            remedy = "Write circle:speed=0.5."
            if values:  # the rest of a row
                key = list(values)[-1]
                remedy = f"Commas part keys, blanks the numbers of one: '{key}={values[key]} {pair.strip()}'."
            raise InputError(f"{shown(pair)} of the trajectory is not KEY=VALUE.", remedy=remedy)
        if key in values:
            raise InputError(f"{key} of the trajectory is given twice.", remedy="Leave one of them out.", key=key)
        values[key] = value
    return name, values


_PLANAR = ("circle", "line", "corner", "square", "polygon")
"""Trajectories of a point in a plane, m, which joints do not follow."""


def trajectory_by_name(name: object, values: Mapping[str, object], robot: RobotLike | None = None) -> Trajectory:
    """Return a trajectory by its name in ``TRAJECTORIES``, or through the points of a file (``from_points``).

    Args:
        name: the name, or the path of a CSV or JSON file of points.
        values: keywords of what makes the trajectory. Text is read: a number, true or false, a row ``1.0 0.4``, rows
            ``1.0 0.4;1.0 0.5``, or words.
        robot: whose coordinates the columns of a file are.

    Raises:
        InputError: an unknown name or key, a key that is missing, or a value that cannot be read or is out of its
            domain.

    Example:
        >>> trajectory_by_name("circle", {"speed": "0.5"}).duration
        2.682...
    """
    make: Callable[..., Trajectory]
    if is_points_file(name):
        make = functools.partial(from_points, name, robot=robot)
    elif isinstance(name, str) and name in TRAJECTORIES:
        make = TRAJECTORIES[name]
    else:
        remedy = f"{did_you_mean(name, TRAJECTORIES)}Choose one of {', '.join(TRAJECTORIES)}, or a CSV or JSON file."
        raise InputError(f"The trajectory is {shown(name)}.", remedy=remedy, value=name)
    if robot is not None and name in _PLANAR and (machine := as_robot(robot)).platform is None:
        axes = ", ".join(machine.independent_joints)
        raise InputError(
            f"The trajectory {name} leads a point along x and y, m; the coordinates of {machine.name} are joints: "
            f"{axes}.",
            remedy="Declare `independent: {platform: LINK, axes: [x, y]}`, or give points of these joints.",
            value=name,
        )
    known = {key: one for key, one in inspect.signature(make).parameters.items() if key != "robot"}
    for key in values.keys() - known.keys():
        remedy = f"{did_you_mean(key, known)}It takes {', '.join(known)}."
        raise InputError(f"The trajectory {name} has no key {shown(key)}.", remedy=remedy, key=key)
    for key, one in known.items():
        if one.default is inspect.Parameter.empty and key not in values:
            raise InputError(f"The trajectory {name} lacks the key {key!r}.", remedy=f"Add {key}.", key=key)
    return make(**{key: _read(key, value, str(name)) for key, value in values.items()})


def _read(key: str, value: object, name: str) -> Any:
    if isinstance(value, (bool, list)) or value is None:
        return value
    if not isinstance(value, str):
        if isinstance(value, (int, float)):
            return float(value)
        raise InputError(
            f"{key} of the trajectory {name} is {shown(value)}.", remedy="Write a number or a list.", key=key
        )
    if value in ("true", "false"):
        return value == "true"
    if value in _WORDS.get(key, ()):
        return value
    if key == "ends":
        words = value.split()
        return words[0] if len(words) == 1 else words
    try:
        # commas part the pairs of a trajectory: rows have blanks and semicolons
        rows = [[float(part) for part in row.split()] for row in value.split(";") if row.strip()]
    except ValueError:
        rows = []
    if not rows:
        wanted = "Write a number, a row such as 1.0 0.4, or rows such as 1.0 0.4;1.0 0.5."
        raise InputError(
            f"{key} of the trajectory {name} is {shown(value)}, neither a number nor rows.", remedy=wanted, key=key
        )
    return rows if ";" in value else rows[0][0] if len(rows[0]) == 1 else rows[0]
