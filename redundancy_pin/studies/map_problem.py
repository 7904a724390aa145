"""What a feasibility map is of: a robot, a motion, two parameters that vary, limits, and planners."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal, cast

import numpy as np

from redundancy_pin.arrays import require_few
from redundancy_pin.errors import InputError, did_you_mean
from redundancy_pin.io.json_data import json_data
from redundancy_pin.planners.registry import PLANNERS, STEPWISE, SWITCH_OFF, WHOLE
from redundancy_pin.robot import Robot
from redundancy_pin.studies import case
from redundancy_pin.studies.case import Case, options_of
from redundancy_pin.trajectory.reference import TRAJECTORIES

Scale = Literal["linear", "log"]


LIMITS: Mapping[str, str] = {
    "stroke": "length of every track, about its middle, m",
    "max_speed": "speed of the carriers, m/s",
    "max_acceleration": "acceleration of the carriers, m/s²",
    "max_jerk": "jerk of the carriers, m/s³ (whole-trajectory only)",
    "max_effort": "main efforts, N or N·m",
    "max_carrier_force": "forces of the carriers' actuators, N",
}
"""Limits that a map may vary or fix, with what they are."""

ATTEMPTS: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    SWITCH_OFF: tuple(
        {"threshold": threshold, "return_time": duration}
        for threshold in (5.0, 10.0, 20.0)
        for duration in (0.4, "shortest")
    ),
    STEPWISE: tuple({"dt": 5e-3, "lam": lam} for lam in (0.0, 0.5, 1.0)),
    WHOLE: ({"dt": 1e-2, "seconds": 20.0},),
}
"""Parameters of each planner, in turn until a plan keeps every limit.

Of switching off, the thresholds of the thesis's circle, each with its return and, where that breaks a limit, with the
shortest return that breaks none. Of the stepwise planner, its fractions of the efforts without carriers.
"""

_OF_THE_MAP = ("effort", "jerk", "track", "speed", "acceleration", "carrier_force", "baseline", "progress")
"""Keywords of planners that a map sets itself, or that are no plain data."""

_NO_NUMBERS = ("start", "end", "points", "vertices", "closed", "shape")
"""Options of trajectories that are points, poses or names."""

_DIGITS = 12
"""Significant digits of a value: the same value of two grids is then the same number, and is computed once."""

MOST_VALUES = 10_000
"""Of an axis."""

Value = float | bool | str


@dataclass(frozen=True)
class Axis:
    """A parameter and the values it takes.

    Attributes:
        name: a key of the trajectory, a limit (``LIMITS``), or an argument of the robot.
        values: increasing, SI units.
        scale: how the picture spaces them, and how the border is bisected.

    Raises:
        InputError: fewer than two values, values that are not finite or do not increase, or a logarithmic scale with
            values that are not positive.
    """

    name: str
    values: tuple[float, ...]
    scale: Scale = "linear"

    def __post_init__(self) -> None:
        try:
            values = tuple(_rounded(value) for value in self.values)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"The values of {self.name} are {self.values!r}, not numbers.", remedy="Pass numbers, SI units."
            ) from error
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "name", self.name.strip().replace("-", "_"))
        if len(values) < 2 or not all(math.isfinite(value) for value in values):
            raise InputError(f"{self.name} has the values {values}.", remedy="Pass at least two finite values.")
        if any(b <= a for a, b in pairwise(values)):
            raise InputError(f"The values of {self.name} do not increase: {values}.", remedy="Sort them, each once.")
        if self.scale not in ("linear", "log"):
            raise InputError(f"The scale of {self.name} is {self.scale!r}.", remedy="Use linear or log.")
        if self.scale == "log" and values[0] <= 0.0:
            raise InputError(f"{self.name} = {values[0]:g} has no logarithm.", remedy="Use positive values, or linear.")

    def middle(self, low: float, high: float) -> float:
        """Return the value half way between two, on the scale of the axis."""
        return _rounded(math.sqrt(low * high) if self.scale == "log" else 0.5 * (low + high))

    def edges(self, values: Sequence[float]) -> list[float]:
        """Return the len(values) + 1 edges of tiles around values of this axis.

        Tiles meet half way; the outermost reach as far beyond the grid as its first and last step go half way inside,
        but not across zero: a stroke or a speed has no values there.
        """
        first, last = self._beyond(self.values[0], self.values[1]), self._beyond(self.values[-1], self.values[-2])
        return [first, *(self.middle(a, b) for a, b in pairwise(values)), last]

    def _beyond(self, end: float, neighbour: float) -> float:
        if self.scale == "log":
            return end * math.sqrt(end / neighbour)
        beyond = end + 0.5 * (end - neighbour)
        return beyond if beyond * end > 0.0 else 0.0


def spaced(name: str, low: float, high: float, count: int, scale: Scale = "linear") -> Axis:
    """Return an axis of ``count`` values from ``low`` to ``high``, evenly spaced on a scale.

    Raises:
        InputError: as ``Axis``.
    """
    Axis(name, (low, high), scale)  # names what is wrong with the ends
    require_few(count, MOST_VALUES, "An axis has {} values", "Ask for fewer.")
    values = np.geomspace(low, high, max(count, 1)) if scale == "log" else np.linspace(low, high, max(count, 1))
    return Axis(name, tuple(values.tolist()), scale)


def parse_axis(text: str) -> Axis:
    """Return the axis that ``NAME=LOW:HIGH:COUNT``, with ``:log`` at the end or without, or ``NAME=V,V,...`` describes.

    Raises:
        InputError: text of another form, or as ``Axis``.
    """
    name, _, rest = text.partition("=")
    low, *others = (part.strip() for part in rest.split(":"))
    try:
        if not name.strip() or (others[2:] not in ([], ["log"], ["linear"])):
            raise ValueError(text)
        if not others:
            return Axis(name, tuple(float(value) for value in low.split(",")))
        high, count, *scale = others
        return spaced(name, float(low), float(high), int(count), "log" if scale == ["log"] else "linear")
    except InputError:
        raise
    except ValueError as error:
        raise InputError(
            f"{text!r} is no axis.", remedy="Write speed=0.2:2.0:10, stroke=0.05:1:12:log, or radius=0.013,0.025."
        ) from error


@dataclass(frozen=True, eq=False)
class MapProblem:
    """A feasibility map to be computed.

    Attributes:
        robot: a shipped robot or the path of a declaration.
        x, y: the two parameters.
        trajectory: a key of ``TRAJECTORIES``: a path of the thesis, or points, a polygon or poses of the user's own.
        options: its options: numbers, and lists of numbers for points and vertices; speed ramps are v T / 2 long unless
            ``ramp_length`` is given.
        settings: arguments of the robot.
        mode: working mode, ±1 a leg; the robot's own when empty.
        gravity: (3,) m/s²; the robot's own when left out.
        backend: a key of ``BACKENDS``.
        limits: by name of ``LIMITS``; the robot's own where left out.
        planners: their names on the command line, in the order of the picture.
        parameters: by planner, keywords that replace those of ``ATTEMPTS``.
        trust: as for ``load_robot``.

    Raises:
        InputError: an unknown name, with the nearest known one; a value out of its domain; or the same parameter twice.
    """

    robot: str
    x: Axis
    y: Axis
    trajectory: str
    options: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Value] = field(default_factory=dict)
    mode: tuple[int, ...] = ()
    gravity: tuple[float, ...] | None = None
    backend: str = case.VIRTUAL_WORK
    limits: Mapping[str, float] = field(default_factory=dict)
    planners: tuple[str, ...] = (SWITCH_OFF, WHOLE)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    trust: bool = False

    def __post_init__(self) -> None:
        _require([self.trajectory], tuple(TRAJECTORIES), "trajectory")
        _require([self.backend], tuple(case.BACKENDS), "backend")
        _require((*self.planners, *self.parameters), (SWITCH_OFF, STEPWISE, WHOLE), "planner")
        if not self.planners or len(set(self.planners)) < len(self.planners):
            named = ", ".join(self.planners) or "none"
            raise InputError(f"The planners are {named}.", remedy="Name each planner once, at least one.")
        keys = self._keys
        _require(self.options, tuple(keys), f"option of the {self.trajectory}")
        for name, key in keys.items():
            if key.default is key.empty and name not in (*self.options, self.x.name, self.y.name):
                raise InputError(f"The {self.trajectory} lacks the option {name!r}.", remedy=f"Add {name}.", name=name)
        _require(self.limits, tuple(LIMITS), "limit")
        if self.x.name == self.y.name:
            raise InputError(f"Both axes are {self.x.name}.", remedy="Vary two different parameters.")
        fixed = {**self.options, **self.limits, **self.settings}
        for axis in (axis for axis in (self.x, self.y) if axis.name in fixed):
            message = f"{axis.name} is an axis of the map and has the fixed value {fixed[axis.name]!r}."
            raise InputError(message, remedy="Leave one of them out.")
        lowest = {axis.name: axis.values[0] for axis in (self.x, self.y)}
        for name, value in {**self.options, **self.limits, **lowest}.items():
            if name in _NO_NUMBERS:
                continue
            if name in (*self.trajectory_keys, *LIMITS) and name != "alpha" and not value > 0.0:
                meaning = f"It is the {LIMITS[name]}." if name in LIMITS else "Trajectories take SI units."
                raise InputError(f"{name} is {value}, expected a positive number.", remedy=meaning, name=name)
            if not math.isfinite(value):
                raise InputError(f"{name} is {value}.", remedy="Leave out what has no limit.", name=name)

    @property
    def unvaried(self) -> Case:
        """The robot on its trajectory, with the arguments and options that are not varied."""
        machine: dict[str, Any] = {"working_mode": self.mode, "gravity": self.gravity, "trust": self.trust}
        return Case("unvaried", self.robot, self.trajectory, arguments=case.options(**self.settings), **machine)

    @property
    def loaded(self) -> Robot:
        """The robot, with its own limits and the arguments that are not varied."""
        return self.unvaried.load_robot()

    @property
    def has_baseline(self) -> bool:
        """Whether the robot can be loaded without carriers, as a baseline."""
        return self.unvaried.has_baseline

    @property
    def trajectory_keys(self) -> tuple[str, ...]:
        """Options of the trajectory that are numbers."""
        return tuple(name for name in self._keys if name not in _NO_NUMBERS)

    @property
    def _keys(self) -> Mapping[str, inspect.Parameter]:
        return inspect.signature(TRAJECTORIES[self.trajectory]).parameters

    def require_names(self) -> None:
        """Check that axes and parameters mean something to the robot and the planners.

        Raises:
            InputError: an axis that is no parameter of the trajectory, no limit and no numeric argument of the robot;
                or a parameter that is no keyword of its planner, or one that a map sets itself.
            RedundancyPinError: the robot does not load.
        """
        arguments = [name for name, value in self.loaded.parameters.items() if type(value) in (int, float)]
        known = (*self.trajectory_keys, *LIMITS, *arguments)
        _require((self.x.name, self.y.name), known, f"parameter of {self.robot} on the {self.trajectory}")
        for planner, given in self.parameters.items():
            if given.get("lam", 0.0) > 0.0 and not self.has_baseline:
                raise InputError(
                    f"lam = {given['lam']:g} needs a baseline, and {self.robot} cannot be loaded without carriers.",
                    remedy="Leave lam out.",
                )
            names = [name for name in options_of(PLANNERS[planner]) if name not in _OF_THE_MAP]
            hint = "Limits are those of the map (max_effort, stroke, ...). " if {*given} & {*_OF_THE_MAP} else ""
            _require(given, names, f"parameter of {planner} in a map", hint)

    def attempts(self, planner: str) -> Iterator[dict[str, Any]]:
        """Give the parameters of a planner in turn: those of the problem in place of the usual ones, none twice."""
        seen: list[dict[str, Any]] = []
        for usual in ATTEMPTS[planner]:
            settings = {**usual, **self.parameters.get(planner, {})}
            if settings not in seen and (not usual.get("lam") or self.has_baseline):
                seen.append(settings)
                yield settings

    def at(self, x: float, y: float) -> tuple[dict[str, Value], dict[str, Any], dict[str, float]]:
        """Return the arguments of the robot, the options of the trajectory and the limits of a cell."""
        robot, path, limits = dict(self.settings), dict(self.options), dict(self.limits)
        for axis, value in ((self.x, x), (self.y, y)):
            of = path if axis.name in self.trajectory_keys else limits if axis.name in LIMITS else robot
            of[axis.name] = value
        return robot, path, limits

    def case(self, planner: str, x: float, y: float, settings: Mapping[str, Any]) -> Case:
        """Return what is to be planned in a cell, with some parameters of the planner."""
        robot, path, limits = self.at(x, y)
        if self.trajectory == "circle" and "ramp_length" not in path:
            # 3-4-5 in speed, as the ramps of the other paths are anyway
            speed, ramp_time = (path.get(name, self._keys[name].default) for name in ("speed", "ramp_time"))
            path["ramp_length"] = 0.5 * speed * ramp_time
        given = dict(settings)
        dt = given.pop("dt", 1e-3)
        if planner == WHOLE:
            given |= {"effort": limits.get("max_effort"), "jerk": limits.get("max_jerk")}
        parts = {"path_options": path, "options": given, "arguments": robot, "limits": limits}
        changed: dict[str, Any] = {name: case.options(**part) for name, part in parts.items()}
        kind = cast("case.Planner", planner.replace("-", "_"))
        return replace(self.unvaried, name=f"{planner}, {x:g}, {y:g}", planner=kind, dt=dt, **changed)

    def identity(self) -> dict[str, Any]:
        """Return everything a cell depends on but its place, as plain data: maps that share it share their cells."""
        names = ("robot", "axes", "trajectory", "options", "settings", "mode", "gravity", "backend", "limits",
                 "parameters")  # fmt: skip
        return dict(json_data({name: getattr(self, name) for name in names}))

    @property
    def axes(self) -> tuple[str, str]:
        """Names of the two parameters."""
        return self.x.name, self.y.name


@dataclass(frozen=True)
class Preset:
    """What a map is of where nothing else is given: motion, axes as text, planner of the thesis, limits, options."""

    trajectory: str
    x: str
    y: str
    thesis: str
    limits: Mapping[str, float] = field(default_factory=dict)
    options: Mapping[str, float] = field(default_factory=dict)


PRESETS: Mapping[str, Preset] = {
    "2rpr": Preset("circle", "speed=0.2:2.0:10", "stroke=0.1:1.2:12", SWITCH_OFF),
    # a corner has no singularity: it is the limit of the torques that separates one planner from the other
    "3rrr": Preset("corner", "speed=0.06:0.3:9", "stroke=0.2:2.0:10", STEPWISE, {"max_effort": 5.0}),
}
"""By the robot's name. The 3-RRR may use 5 N·m: its corner at 0.2 m/s needs 3.0 N·m without carriers."""

OTHER = Preset("line", "speed=0.1:1.0:10", "stroke=0.1:1.0:10", STEPWISE)
"""For robots of the user's own, whose trajectory has to be named anyway."""


def _require(names: Iterable[str], known: Sequence[str], what: str, hint: str = "") -> None:
    for name in names:
        if name not in known:
            remedy = f"{did_you_mean(name, known)}{hint}Known: {', '.join(known)}."
            raise InputError(f"{name!r} is no {what}.", remedy=remedy, name=name)


def _rounded(value: float) -> float:
    return float(f"{float(value):.{_DIGITS}g}")
