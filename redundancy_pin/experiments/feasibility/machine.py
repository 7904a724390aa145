"""From the parameters of a cell to a machine and a motion."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.experiments.backends import BACKENDS
from redundancy_pin.experiments.feasibility.problem import MapProblem
from redundancy_pin.experiments.feasibility.robots import loaded
from redundancy_pin.experiments.trajectories import TRAJECTORIES
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Machine:
    """What a planner gets.

    Attributes:
        dynamics: of the robot, with the limits of the cell in place of its own.
        trajectory: the platform motion.
        effort: limit of every main effort, N or N·m; None for none.
        jerk: limit of the carriers' jerk, m/s³; None for none.
        baseline: makes the dynamics of the same robot without carriers.
    """

    dynamics: Dynamics
    trajectory: Trajectory
    effort: float | None
    jerk: float | None
    baseline: Callable[[], Dynamics]


def machine(problem: MapProblem, x: float, y: float) -> Machine:
    """Return the machine of a cell.

    Raises:
        RedundancyPinError: the robot does not load with these arguments, or the motion cannot be made.
    """
    robot, trajectory, limits = problem.at(x, y)
    make = BACKENDS[problem.backend]
    found = loaded(problem.robot, problem.mode, problem.gravity, tuple(sorted(robot.items())))
    bare = tuple(sorted({**robot, "carriers": False}.items()))
    limited = replace(found, carrier_limits=tuple(with_limits(own, limits) for own in found.carrier_limits))
    return Machine(
        make(limited),
        make_trajectory(problem.trajectory, trajectory),
        limits.get("max_effort"),
        limits.get("max_jerk"),
        lambda: make(loaded(problem.robot, problem.mode, problem.gravity, bare)),
    )


def with_limits(own: CarrierLimits, limits: Mapping[str, float]) -> CarrierLimits:
    """Return the limits of a carrier with those of a map in place of its own.

    A stroke is the length of the track, about the middle of its own.
    """
    changed: dict[str, float] = {
        field: limits[name]
        for name, field in (
            ("max_speed", "speed"),
            ("max_acceleration", "acceleration"),
            ("max_carrier_force", "force"),
        )
        if name in limits
    }
    if "stroke" in limits:
        middle, half = 0.5 * (own.lower + own.upper), 0.5 * limits["stroke"]
        changed |= {"lower": middle - half, "upper": middle + half}
    return replace(own, **changed)


def make_trajectory(name: str, options: Mapping[str, Any]) -> Trajectory:
    """Return a trajectory; its speed ramps are v T / 2 long (3-4-5 in speed) unless a length is given.

    Raises:
        InputError: options that it does not take or that are out of their domain.
    """
    make = TRAJECTORIES[name]
    if name == "circle" and "ramp_length" not in options:  # the others have such ramps anyway
        defaults = inspect.signature(make).parameters
        speed, ramp_time = (options.get(key, defaults[key].default) for key in ("speed", "ramp_time"))
        options = {**options, "ramp_length": 0.5 * speed * ramp_time}
    return make(**options)
