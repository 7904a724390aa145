"""What a feasibility map is of: a robot, a motion, two parameters, limits, and planners."""

from __future__ import annotations

import difflib
import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from redundancy_pin.errors import InputError
from redundancy_pin.experiments.backends import BACKENDS, VIRTUAL_WORK
from redundancy_pin.experiments.feasibility.axis import Axis
from redundancy_pin.experiments.feasibility.robots import loaded
from redundancy_pin.experiments.trajectories import TRAJECTORIES
from redundancy_pin.robot import Robot

LIMITS: Mapping[str, str] = {
    "stroke": "length of every track, about its middle, m",
    "max_speed": "speed of the carriers, m/s",
    "max_acceleration": "acceleration of the carriers, m/s²",
    "max_jerk": "jerk of the carriers, m/s³ (whole-trajectory only)",
    "max_effort": "main efforts, N or N·m",
    "max_carrier_force": "forces of the carriers' actuators, N",
}
"""Limits that a map may vary or fix, with what they are."""

SWITCH_OFF, STEPWISE, WHOLE = "switch-off", "stepwise", "whole-trajectory"

Value = float | bool | str


@dataclass(frozen=True, eq=False)
class MapProblem:
    """A feasibility map to be computed.

    Attributes:
        robot: a shipped robot or the path of a declaration.
        x, y: the two parameters.
        trajectory: a key of ``TRAJECTORIES``: a path of the thesis, or points or a polygon of the user's own.
        options: its options: numbers, and lists of numbers for points and vertices; speed ramps are v T / 2 long unless
            ``ramp_length`` is given.
        settings: arguments of the robot.
        mode: working mode, ±1 a leg; the robot's own when empty.
        gravity: (3,) m/s²; the robot's own when left out.
        backend: a key of ``BACKENDS``.
        limits: by name of ``LIMITS``; the robot's own where left out.
        planners: their names on the command line, in the order of the picture.
        parameters: by planner, keywords that replace those of ``planning.TRIES``.

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
    backend: str = VIRTUAL_WORK
    limits: Mapping[str, float] = field(default_factory=dict)
    planners: tuple[str, ...] = (SWITCH_OFF, WHOLE)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _require(self.trajectory, tuple(TRAJECTORIES), "trajectory")
        _require(self.backend, tuple(BACKENDS), "backend")
        for name in (*self.planners, *self.parameters):
            _require(name, (SWITCH_OFF, STEPWISE, WHOLE), "planner")
        if not self.planners or len(set(self.planners)) < len(self.planners):
            raise InputError(
                f"The planners are {', '.join(self.planners) or 'none'}.",
                remedy="Name each planner once, at least one.",
            )
        keys = inspect.signature(TRAJECTORIES[self.trajectory]).parameters
        for name in self.options:
            _require(name, tuple(keys), f"option of the {self.trajectory}")
        for name, key in keys.items():
            if key.default is key.empty and name not in (*self.options, self.x.name, self.y.name):
                raise InputError(f"The {self.trajectory} lacks the option {name!r}.", remedy=f"Add {name}.", name=name)
        for name in self.limits:
            _require(name, tuple(LIMITS), "limit")
        if self.x.name == self.y.name:
            raise InputError(f"Both axes are {self.x.name}.", remedy="Vary two different parameters.")
        for axis in (self.x, self.y):
            for given in (self.options, self.limits, self.settings):
                if axis.name in given:
                    raise InputError(
                        f"{axis.name} is an axis of the map and has the fixed value {given[axis.name]!r}.",
                        remedy="Leave one of them out.",
                    )
        positive = {**self.options, **self.limits} | {axis.name: axis.values[0] for axis in (self.x, self.y)}
        for name, value in positive.items():
            if isinstance(value, (bool, list, tuple)):  # points, vertices, closed
                continue
            if name in (*self.trajectory_keys, *LIMITS) and name != "alpha" and not value > 0.0:
                raise InputError(f"{name} is {value}, expected a positive number.", remedy=_meaning(name), name=name)
            if not math.isfinite(value):
                raise InputError(f"{name} is {value}.", remedy="Leave out what has no limit.", name=name)

    @property
    def loaded(self) -> Robot:
        """The robot, with its own limits and the arguments that are not varied.

        Raises:
            RedundancyPinError: it does not load.
        """
        return loaded(self.robot, self.mode, self.gravity, tuple(sorted(self.settings.items())))

    @property
    def has_baseline(self) -> bool:
        """Whether the robot can be loaded without carriers, as a baseline."""
        return isinstance(self.loaded.parameters.get("carriers"), bool)

    @property
    def trajectory_keys(self) -> tuple[str, ...]:
        """Options of the trajectory that are numbers."""
        keys = inspect.signature(TRAJECTORIES[self.trajectory]).parameters
        return tuple(name for name in keys if name not in ("start", "points", "vertices", "closed"))

    def at(self, x: float, y: float) -> tuple[dict[str, Value], dict[str, Any], dict[str, float]]:
        """Return the arguments of the robot, the options of the trajectory and the limits of a cell."""
        robot, trajectory, limits = dict(self.settings), dict(self.options), dict(self.limits)
        for axis, value in ((self.x, x), (self.y, y)):
            if axis.name in self.trajectory_keys:
                trajectory[axis.name] = value
            elif axis.name in LIMITS:
                limits[axis.name] = value
            else:
                robot[axis.name] = value
        return robot, trajectory, limits

    def identity(self) -> dict[str, Any]:
        """Return everything a cell depends on but its place, as plain data: maps that share it share their cells."""
        return {
            "robot": self.robot,
            "axes": [self.x.name, self.y.name],
            "trajectory": self.trajectory,
            "options": dict(sorted(self.options.items())),
            "settings": dict(sorted(self.settings.items())),
            "mode": list(self.mode),
            "gravity": None if self.gravity is None else list(self.gravity),
            "backend": self.backend,
            "limits": dict(sorted(self.limits.items())),
            "parameters": {name: dict(sorted(self.parameters.get(name, {}).items())) for name in self.parameters},
        }


def known_axes(problem: MapProblem, arguments: Mapping[str, Value]) -> tuple[str, ...]:
    """Return the parameters a map of this robot and trajectory may vary."""
    numbers = [
        name for name, value in arguments.items() if isinstance(value, (int, float)) and not isinstance(value, bool)
    ]
    return (*problem.trajectory_keys, *LIMITS, *numbers)


def require_axes(problem: MapProblem, arguments: Mapping[str, Value]) -> None:
    """Check that both axes are parameters of the trajectory, limits, or numeric arguments of the robot.

    Args:
        problem: the problem.
        arguments: of the robot, with their defaults.

    Raises:
        InputError: one is not, with the nearest one that is.
    """
    for axis in (problem.x, problem.y):
        _require(axis.name, known_axes(problem, arguments), f"parameter of {problem.robot} on the {problem.trajectory}")


def _require(name: str, known: Sequence[str], what: str) -> None:
    if name not in known:
        close = difflib.get_close_matches(str(name), known, n=1)
        hint = f"Did you mean {close[0]!r}? " if close else ""
        raise InputError(f"{name!r} is no {what}.", remedy=f"{hint}There are {', '.join(known)}.", name=name)


def _meaning(name: str) -> str:
    return f"It is the {LIMITS[name]}." if name in LIMITS else "Trajectories take SI units."
