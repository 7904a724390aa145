"""The numbers of the programme of least time: how f depends on speed and acceleration along the path, at nodes on it.

The nodes are places p on the path, so that W, its lost directions and all coefficients are numbers; unknown are the
speed ṗ and the acceleration p̈ there, the motion of the carriers, the efforts, and the duration of each step. With
ẋ = x' ṗ and ẍ = x'' ṗ² + x' p̈ each coefficient of ``CarrierModel`` is a combination of 1, ṗ, ṗ² and p̈: four speeds
and accelerations determine them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.carrier_model import (
    OTHER_TERMS,
    CarrierModel,
    carrier_model,
    terms,
    turns,
)
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.optimal.mesh import Grid, near_singular
from redundancy_pin.planners.optimal.objectives import Scales
from redundancy_pin.planners.optimal.problem import (
    PathTiming,
    Problem,
    Reader,
    Task,
    at_pace,
    scales_of,
    stacked_powers,
)
from redundancy_pin.planners.optimal.settings import Settings
from redundancy_pin.robot.scales import turning_velocities
from redundancy_pin.trajectory.paths import Path

_ZERO_COEFFICIENT = 1e-11
"""Coefficients below this fraction of the largest are none: they would be entries of the Jacobian."""


def read_model(along: DynamicsAlongMotion, dynamics: Dynamics) -> CarrierModel:
    """Read the coefficients off a backend along the path at unit speed (its derivatives are those by p).

    Raises:
        UnsupportedRobotError: f has other terms, as of dry friction, of carriers that carry one another, or of time.
    """
    motion, robot = along.motion, dynamics.robot

    def at(speed: float, acceleration: float, later: float = 0.0) -> CarrierModel:
        xdd = motion.xdd * speed**2 + motion.xd * acceleration
        there = dynamics.along(PlatformMotion(motion.t + later, motion.x, motion.xd * speed, xdd, check_rates=False))
        return carrier_model(there, turning=turns(robot), check=bool(robot.k))

    # terms of different units are compared as forces, at positions and rates of the size of the robot
    length = robot.characteristic_length
    place = np.where(turning_velocities(robot)[robot.carrier_velocity], 1.0, length)
    rest, ahead, back, push = at(0.0, 0.0), at(1.0, 0.0), at(-1.0, 0.0), at(0.0, 1.0 / length)
    other = at(0.7, -1.3 / length, 0.37)
    by_term = np.stack(terms(place, place / length, place / length**2, rest.f_terms.shape[-1], np), axis=-1)
    parts = {}
    for load in ("f", "force"):
        size = 1e-300
        for name, unit in ((f"{load}0", np.ones(1)), (f"{load}_terms", np.abs(by_term))):
            still, plus, minus, pushed, last = (
                np.asarray(getattr(one, name)) * unit for one in (rest, ahead, back, push, other)
            )
            split = np.stack([still, 0.5 * (plus - minus), 0.5 * (plus + minus) - still, pushed - still], axis=-1)
            size = max(size, float(np.abs(split).max(initial=0.0)))
            over = tuple(range(split.ndim - (2 if name.endswith("_terms") else 1)))
            split[..., np.abs(split).max(axis=over, initial=0.0) <= _ZERO_COEFFICIENT * size] = 0.0
            deviation = float(np.abs(split @ np.array([1.0, 0.7, 0.49, -1.3]) - last).max(initial=0.0)) / size
            parts[name] = split / unit[..., None] * np.array([1.0, 1.0, 1.0, length])
            if deviation > OTHER_TERMS:
                message = f"f of {robot.name} is not a sum of 1, ṗ, ṗ² and p̈ along the path: "
                raise UnsupportedRobotError(
                    f"{message}it deviates by {deviation:.2g}.",
                    remedy="Leave dry friction and loads that depend on time out, or plan at a given speed.",
                )
    return replace(rest, **parts)


SPEEDS = np.geomspace(1e-3, 1e3, 121)
"""Mean speeds of a first guess that are tried, lengths of the path per second."""

USED = 0.9
"""Largest share of the limits of efforts and rates that the first guess may take."""

AT_REST = 1.05
"""The same, of the least share at any speed, which may be more than ``USED`` where the robot carries its weight."""

FAR = 100.0
"""Limit of an effort over the size of efforts, from which it is not the size of efforts: the rates limit the time."""


@dataclass(frozen=True, eq=False)
class PathTask(Task):
    """A path whose timing is planned; the motion of the task runs along it at unit speed."""

    path: Path

    @property
    def slows_at_ends(self) -> bool:
        """Whether nodes are closer together towards both ends: all but laps begin and end at rest."""
        return not self.settings.lap

    @cached_property
    def read(self) -> Reader:
        """What reads the coefficients off the backend."""
        return partial(read_model, dynamics=self.dynamics)

    def sized(
        self, grid: Grid, model: CarrierModel, parked: ReducedDynamics, rate: Array, before: Problem | None
    ) -> tuple[Scales, PathTiming | None]:
        """Return sizes, with the speed that the parked robot may reach, and the sizes of the timing."""
        settings, end = self.settings, self.source.end
        fastest, place = fastest_speed(rate, settings.limits), grid.t / grid.t[-1]
        if before is None or before.timing is None:
            speed, exceeded = _first_speed(model, parked, settings, place * end, fastest)
            acceleration = 2.0 * speed**2 / end
            scales = _scales(model, settings, parked, end, speed, acceleration)
        else:
            speed, acceleration, scales = before.timing.speed, before.timing.acceleration, before.scales
            exceeded = before.timing.exceeded_parked
        steps = np.where(grid.h > 0.0, scales.duration * np.diff(np.arccos(1.0 - 2.0 * place)) / np.pi, scales.duration)
        return scales, PathTiming(speed, acceleration, steps, fastest, exceeded)


def fastest_speed(rate: Array, limits: ResolvedLimits) -> Array:
    """Return (M,) the largest ṗ that limits of the actuators' rates allow, m/s, of (M, m) rates at unit speed."""
    fastest: Array = (limits.actuator_speed / np.maximum(np.abs(rate), 1e-300)).min(axis=1, initial=1e300)
    return fastest


def _first_speed(
    model: CarrierModel, parked: ReducedDynamics, settings: Settings, places: Array, fastest: Array
) -> tuple[float, tuple[str, ...]]:
    """Return the largest mean speed of a harmonic motion along the path that the parked robot can follow, m/s.

    Also returns the kinds of limits that may have to give way, as it exceeds one at any speed.
    """
    length, regular = places[-1], ~near_singular(parked)
    inverse, place = np.linalg.pinv(model.W[regular]), places / places[-1]
    limit = np.where(np.isfinite(settings.limits.effort), settings.limits.effort, np.inf)

    def use(speed: float) -> float:
        """Return the largest share of the limits that harmonic motion of a mean speed has of them."""
        pd, pdd = speed * np.sqrt(4.0 * place * (1.0 - place)), 2.0 * speed**2 / length * (1.0 - 2.0 * place)
        tau = np.einsum("nmi,ni->nm", inverse, at_pace(model, stacked_powers(pd, pdd)).f0[regular])
        return max(float(np.abs(tau / limit).max(initial=0.0)), float((pd / fastest).max()))

    speeds = length * SPEEDS
    uses = np.array([use(speed) for speed in speeds])
    # under gravity the load at rest may be more than that: the fastest speed that hardly needs more than the slowest
    speed = float(speeds[np.flatnonzero(uses <= max(USED, AT_REST * uses.min()))[-1]])
    if (np.abs(model.force0[..., 0]) > settings.limits.carrier_force).any():
        return speed, ("effort", "carrier_force")
    return speed, () if uses.min() <= 1.0 else ("effort",)


def _scales(
    model: CarrierModel, settings: Settings, parked: ReducedDynamics, length: float, speed: float, acceleration: float
) -> Scales:
    """Return sizes from the limits, and from the parked robot at a speed and acceleration along the path."""
    at_speed = at_pace(model, stacked_powers(np.full(len(model.t), speed), acceleration))
    duration = 0.5 * np.pi * length / speed
    scales = scales_of(at_speed, settings, parked, duration, np.ones((1, 1)))
    near = settings.limits.effort[settings.limits.effort < FAR * scales.tau]
    tau = float(near.min()) if len(near) else scales.tau
    return replace(scales, tau=tau, row=scales.row * max(1.0, tau / scales.tau))
