"""The options of the stepwise planner, checked, and the efforts it aims at."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeGuard, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked, positive
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.limits import Limits, ResolvedLimits
from redundancy_pin.planners.stepwise.box import AccelerationBox
from redundancy_pin.robot import Robot

Active = Literal["always", "accelerating"]
"""When the optimiser works: at every step, or only while the platform accelerates."""

Stop = Literal["after", "within"]
"""When the carriers are brought to rest: after the motion, with the platform held, or by its last sample."""


@dataclass(frozen=True, eq=False)
class Settings:
    """Checked options of ``plan_stepwise``; see there.

    Attributes:
        limits: of the carriers.
        box: what they leave in a step.
    """

    limits: ResolvedLimits
    box: AccelerationBox
    lam: float
    active: Active
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
        return {
            "lam": self.lam,
            "active": self.active,
            "start": tuple(self.start.tolist()),
            "datum": tuple(self.datum.tolist()),
            **self.limits.parameters(),
            "anticipate": self.box.anticipate,
            "return_time": self.return_time,
            "stop": self.stop,
            "brake_time": self.brake_time,
            "least_margin": self.least_margin,
            "between": self.between,
        }


def checked_settings(
    robot: Robot,
    motion: PlatformMotion,
    limits: Limits,
    *,
    lam: float,
    active: Active,
    start: ArrayLike,
    datum: ArrayLike,
    return_time: float | Literal["shortest"],
    stop: Stop,
    brake_time: float,
    anticipate: bool,
    least_margin: float,
    between: int,
) -> Settings:
    """Return the settings of ``plan_stepwise`` after checking every one.

    Raises:
        InputError: a setting out of its domain; names it.
        InfeasiblePlanError: a start or datum off the track.
    """
    try:
        fraction = float(lam)
    except (TypeError, ValueError) as error:
        raise InputError(f"lam is {lam!r}, expected a number.", name="lam") from error
    if not 0.0 <= fraction <= 1.0:
        raise InputError(f"lam is {fraction:g}, expected a number in [0, 1].", name="lam", value=fraction)
    choices: list[tuple[str, object, tuple[str, ...]]] = [("active", active, get_args(Active))]
    choices.append(("stop", stop, get_args(Stop)))
    if isinstance(return_time, str):
        choices.append(("return_time", return_time, ("shortest",)))
    for name, value, allowed in choices:
        if value not in allowed:
            raise InputError(
                f"{name} is {value!r}.", remedy=f"Use one of {', '.join(allowed)}.", name=name, value=value
            )
    if len(motion) < 2 or not motion.t[-1] > motion.t[0]:
        raise InputError("The motion has a single instant.", remedy="Pass a motion of at least two instants.")
    if isinstance(between, bool) or not isinstance(between, int) or between < 0:
        raise InputError(f"between is {between}, expected 0 or a positive whole number.", name="between")
    if not isinstance(anticipate, bool):
        raise InputError(f"anticipate is {anticipate!r}, expected True or False.", name="anticipate")
    for name in ("jerk", "carrier_force", "effort"):
        if getattr(limits, name) is not None:
            raise InputError(
                f"The stepwise planner keeps to no limit of {name}.",
                remedy="Leave it out, or use plan_whole_trajectory.",
                name=name,
            )
    resolved = limits.resolved(robot)
    if stop == "within" and np.isinf(resolved.acceleration).any():
        raise InputError(
            'stop="within" needs acceleration limits: without them nothing says when to brake.',
            remedy='Declare or pass acceleration limits, or use stop="after".',
        )
    rest_at = float(motion.t[-1]) if stop == "within" else math.inf
    return Settings(
        limits=resolved,
        box=AccelerationBox(robot.carriers, resolved.of_carriers, anticipate, rest_at),
        lam=fraction,
        active=active,
        start=resolved.on_track(start, "start"),
        datum=resolved.on_track(datum, "datum"),
        return_time=return_time if isinstance(return_time, str) else positive(return_time, "return_time", "s"),
        stop=stop,
        brake_time=positive(brake_time, "brake_time", "s"),
        least_margin=positive(least_margin, "least_margin", ""),
        between=between,
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
