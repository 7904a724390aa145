"""Problem files: everything a planner needs, in YAML with strict keys; ``docs/problem.yaml`` is an example."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from redundancy_pin.cli.keys import require_choice, require_known
from redundancy_pin.cli.options import RobotOptions
from redundancy_pin.cli.plan_parameters import PLANNERS
from redundancy_pin.cli.plan_problem import Problem, problem
from redundancy_pin.cli.plan_trajectory import make_trajectory
from redundancy_pin.cli.plan_values import number, numbers, word
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot.description import shipped_robots
from redundancy_pin.studies.case import RNEA
from redundancy_pin.trajectory import Trajectory, from_csv

_ROBOT_KEYS = ("robot", "set", "mode", "gravity")
_KEYS = ("planner", *_ROBOT_KEYS, "backend", "trajectory", "motion", "step", "parameters", "baseline")


def read_problem(path: str | Path) -> Problem:
    """Read a problem file.

    Robots and motions given by path are looked for from the folder of the file.

    Raises:
        InputError: missing or unreadable file, broken YAML, unknown or missing keys, values of the wrong kind.
        RedundancyPinError: whatever loading the robot or the motion raises.
    """
    place = Path(path).expanduser()
    data = _read_yaml(place)
    require_known(data, _KEYS, f"the problem {place.name}")
    for key in ("planner", "robot"):
        if key not in data:
            raise InputError(f"The problem {place.name} lacks the key {key!r}.", remedy=f"Add {key}: ....", key=key)
    planner = require_choice(data["planner"], tuple(PLANNERS), "the planner")
    baseline = data.get("baseline")
    return problem(
        planner,
        _robot(data, place.parent),
        word("backend", data.get("backend", RNEA)),
        _motion(data, place),
        _mapping(data.get("parameters", {}), "parameters"),
        baseline=None if baseline is None else _baseline(_mapping(baseline, "baseline"), data, place.parent),
        step=None if data.get("step") is None else number("step", data["step"]),
    )


def _read_yaml(path: Path) -> Mapping[str, Any]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"The problem {path} cannot be read: {error.strerror}.", remedy="Correct the path.", path=str(path)
        ) from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{path} is not YAML: {error}", remedy="Repair the file.", path=str(path)) from error
    if not isinstance(data, Mapping):
        raise InputError(f"{path} holds no mapping of keys.", remedy=f"Its keys: {', '.join(_KEYS)}.", path=str(path))
    return data


def _motion(data: Mapping[str, Any], path: Path) -> PlatformMotion | Trajectory:
    if ("trajectory" in data) == ("motion" in data):
        raise InputError(
            f"The problem {path.name} needs either a trajectory or a motion.",
            remedy="Write trajectory: {name: circle, speed: 0.6}, or motion: file.csv.",
        )
    if "motion" in data:
        return from_csv(path.parent / word("motion", data["motion"]))
    options = dict(_mapping(data["trajectory"], "trajectory"))
    if "name" not in options:
        raise InputError("The trajectory lacks the key 'name'.", remedy="Write {name: circle, speed: 0.6}.")
    return make_trajectory(options.pop("name"), options)


def _robot(data: Mapping[str, Any], folder: Path) -> RobotOptions:
    """Return the robot options of a mapping, from its typed values."""
    mode, gravity = data.get("mode"), data.get("gravity")
    settings = _mapping(data.get("set", {}), "set")
    for name, value in settings.items():
        if not isinstance(value, (bool, int, float, str)):
            raise InputError(f"{name} in `set` is {value!r}.", remedy="Write a number, true, false or text.", key=name)
    if gravity is not None:
        vector = numbers("gravity", gravity)
        gravity = ",".join(repr(float(g)) for g in vector.ravel()) if hasattr(vector, "ravel") else str(vector)
    return RobotOptions(
        _source(word("robot", data["robot"]), folder),
        tuple(f"{name}={value}" for name, value in settings.items()),
        None if mode is None else word("mode", mode),
        gravity,
    )


def _baseline(given: Mapping[str, Any], data: Mapping[str, Any], folder: Path) -> RobotOptions:
    """Return the baseline robot: the robot of the problem, with what ``baseline`` says in place of its own."""
    require_known(given, _ROBOT_KEYS, "the baseline")
    own = {} if "robot" in given else {key: data[key] for key in _ROBOT_KEYS if key in data}
    settings = {**_mapping(own.get("set", {}), "set"), **_mapping(given.get("set", {}), "set")}
    return _robot({**own, **given, "set": settings}, folder)


def _source(text: str, folder: Path) -> str:
    return text if text in shipped_robots() or Path(text).is_absolute() else str(folder / text)


def _mapping(value: object, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{name} is {value!r}, not a mapping.", remedy=f"Write {name}: {{key: value}}.", key=name)
    return value
