"""The settings of the stepwise planner, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeGuard, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked, frozen
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.stepwise_limits import StepLimits, require_inside, resolve_limits
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.domain import positive

Active = Literal["always", "accelerating"]
"""When the optimiser works: at every step, or only while the platform accelerates."""

Stop = Literal["after", "within"]
"""When the carriers are brought to rest: after the motion, with the platform held, or by its last sample."""


@dataclass(frozen=True, eq=False)
class StepwiseSettings:
    """Settings of ``plan_stepwise``; see there.

    Attributes:
        lam: fraction of the baseline effort to aim at.
        active: when the optimiser works.
        limits: limits of the carriers.
        start, datum: (k,) positions, m.
        return_time: s, or "shortest".
        stop: when the carriers are brought to rest.
        brake_time: s.
        least_margin: smallest accepted margin of W.
        between: points between two samples at which the plan is checked.
    """

    lam: float
    active: Active
    limits: StepLimits
    start: Array
    datum: Array
    return_time: float | Literal["shortest"]
    stop: Stop
    brake_time: float
    least_margin: float
    between: int

    @property
    def parameters(self) -> dict[str, object]:
        """The settings as plain data, for the plan."""
        limits = self.limits.limits
        return {
            "lam": self.lam,
            "active": self.active,
            "start": tuple(self.start.tolist()),
            "datum": tuple(self.datum.tolist()),
            "speed": tuple(limit.speed for limit in limits),
            "acceleration": tuple(limit.acceleration for limit in limits),
            "track": tuple((limit.lower, limit.upper) for limit in limits),
            "anticipate": self.limits.anticipate,
            "return_time": self.return_time,
            "stop": self.stop,
            "brake_time": self.brake_time,
            "least_margin": self.least_margin,
            "between": self.between,
        }


def checked_settings(
    robot: Robot,
    motion: PlatformMotion,
    *,
    lam: float,
    active: Active,
    start: ArrayLike,
    datum: ArrayLike,
    return_time: float | Literal["shortest"],
    stop: Stop,
    brake_time: float,
    anticipate: bool,
    speed: ArrayLike | None,
    acceleration: ArrayLike | None,
    track: ArrayLike | None,
    least_margin: float,
    between: int,
) -> StepwiseSettings:
    """Return the settings of ``plan_stepwise`` after checking every one.

    Raises:
        InputError: a setting out of its domain; names it.
        InfeasiblePlanError: a start or datum off the track.
    """
    fraction = _number(lam, "lam")
    if not 0.0 <= fraction <= 1.0:
        raise InputError(f"lam is {fraction:g}, expected a number in [0, 1].", name="lam", value=fraction)
    _one_of(active, "active", get_args(Active))
    _one_of(stop, "stop", get_args(Stop))
    if isinstance(return_time, str):
        _one_of(return_time, "return_time", ("shortest",))
    else:
        return_time = positive(return_time, "return_time", "s")
    if len(motion) < 2 or not motion.t[-1] > motion.t[0]:
        raise InputError("The motion has a single instant.", remedy="Pass a motion of at least two instants.")
    if isinstance(between, bool) or not isinstance(between, int) or between < 0:
        raise InputError(f"between is {between}, expected 0 or a positive whole number.", name="between")
    rest_at = float(motion.t[-1]) if stop == "within" else math.inf
    resolved = resolve_limits(robot, speed, acceleration, track)
    if not isinstance(anticipate, bool):
        raise InputError(f"anticipate is {anticipate!r}, expected True or False.", name="anticipate")
    limits = StepLimits(robot.carriers, resolved, anticipate, rest_at)
    if stop == "within" and any(math.isinf(limit.acceleration) for limit in resolved):
        raise InputError(
            'stop="within" needs acceleration limits: without them nothing says when to brake.',
            remedy='Declare or pass acceleration limits, or use stop="after".',
        )
    return StepwiseSettings(
        fraction,
        active,
        limits,
        frozen(require_inside(start, "start", limits)),
        frozen(require_inside(datum, "datum", limits)),
        return_time,
        stop,
        positive(brake_time, "brake_time", "s"),
        positive(least_margin, "least_margin", ""),
        int(between),
    )


def target_effort(
    robot: Robot, motion: PlatformMotion, lam: float, baseline: Dynamics | ArrayLike | None
) -> tuple[Array, Array | None]:
    """Return (N, m) λ τ̂, and τ̂ itself where there is a baseline.

    Raises:
        InputError: λ > 0 without a baseline, or one that does not fit the robot or the motion.
        InfeasiblePlanError: the baseline has no finite efforts somewhere.
    """
    shape = (len(motion), robot.m)
    if baseline is None:
        if lam > 0.0:
            raise InputError(
                f"lam = {lam:g} asks for a fraction of the baseline effort, and there is no baseline.",
                remedy='Pass baseline=VirtualWork(load_robot("3rrr", carriers=False)) or an array (N, m).',
            )
        return np.zeros(shape), None
    if is_dynamics(baseline):
        other = baseline.robot
        if (other.n, other.m) != (robot.n, robot.m):
            raise InputError(
                f"The baseline robot has n, m = {other.n}, {other.m}; {robot.name} has {robot.n}, {robot.m}.",
                remedy="Pass the same mechanism without carriers.",
            )
        tau = distribute(baseline.reduce(motion)).tau
        bad = np.flatnonzero(~np.isfinite(tau).all(axis=1))
        if len(bad):
            raise InfeasiblePlanError(
                f"The baseline robot has no finite efforts at t = {motion.t[bad[0]]:.6g} s.",
                remedy="Use lam = 0, which needs no baseline.",
                constraint="baseline",
                time=float(motion.t[bad[0]]),
            )
    else:
        tau = checked(cast(ArrayLike, baseline), "baseline", shape)
    return lam * tau, tau


def is_dynamics(baseline: Dynamics | ArrayLike) -> TypeGuard[Dynamics]:
    """Return whether a baseline is a backend, rather than efforts."""
    return isinstance(getattr(baseline, "robot", None), Robot)


def _number(value: float, name: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is {value!r}, expected a number.", name=name) from error


def _one_of(value: object, name: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise InputError(f"{name} is {value!r}.", remedy=f"Use one of {', '.join(allowed)}.", name=name, value=value)
