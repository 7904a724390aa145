"""The options of the stepwise planner, checked, and the box that limits leave for accelerations in one step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, positive
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.carrier_return import stoppable_speed
from redundancy_pin.planners.limits import Limits, ResolvedLimits
from redundancy_pin.robot import CarrierLimits, Robot

_EMPTY = 1e-9
"""A box that is empty by less than this fraction of the accelerations involved is one point: a limit that is met
exactly leaves a rounding error."""


@dataclass(frozen=True)
class AccelerationBox:
    """What the carriers must keep to at every step.

    Attributes:
        carriers: (k,) names.
        limits: (k,) track, speed, acceleration and force of each; the planner keeps to the first three.
        anticipate: whether a carrier is kept able to stop before the end of its track.
        rest_at: time by which all must be at rest, s; infinite for none.
    """

    carriers: tuple[str, ...]
    limits: tuple[CarrierLimits, ...]
    anticipate: bool
    rest_at: float
    _bounds: tuple[tuple[float, float, float, float], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # plain tuples: the box is asked for at every step
        bounds = tuple((limit.lower, limit.upper, limit.speed, limit.acceleration) for limit in self.limits)
        object.__setattr__(self, "_bounds", bounds)

    def box(self, t: float, step: float, s: Sequence[float], sd: Sequence[float]) -> tuple[list[float], list[float]]:
        """Return the smallest and largest s̈ of each carrier in a step (Parsa 2014, eqs. 4.2 to 4.4).

        With backward differences ṡ' = ṡ + h s̈ and s' = s + h ṡ' the limits of the track, the speed and the
        acceleration are one box. Two more bounds may narrow it: a carrier must be able to stop before its track ends
        (``anticipate``) and by the time ``rest_at``. Both give way to the largest deceleration, so they never empty it.

        ``t``: time at the end of the step, s; ``step``: length h of the step, s; ``s`` (k,) positions before the step,
        m; ``sd`` (k,) speeds before the step, m/s.
        """
        lower, upper = [], []
        for j, (first, last, fastest, a) in enumerate(self._bounds):
            position, speed = s[j], sd[j]
            reach = a * step
            least, most = max(speed - reach, -fastest), min(speed + reach, fastest)
            behind, ahead = position - first, last - position
            if most * step > ahead:
                most = ahead / step
            if -least * step > behind:
                least = -behind / step
            if self.anticipate:
                if most > 0.0 and (step + 0.5 * most / a) * most > ahead:
                    most = min(most, max(stoppable_speed(ahead, step, a), speed - reach))
                if least < 0.0 and (step - 0.5 * least / a) * -least > behind:
                    least = max(least, min(-stoppable_speed(behind, step, a), speed + reach))
            if self.rest_at < math.inf:
                left = a * max(self.rest_at - t, 0.0)
                most = min(most, max(left, speed - reach))
                least = max(least, min(-left, speed + reach))
            low, high = max((least - speed) / step, -a), min((most - speed) / step, a)
            if low > high:
                low = high = self._single(j, t, step, position, speed, low, high)
            lower.append(low)
            upper.append(high)
        return lower, upper

    def _single(self, j: int, t: float, step: float, s: float, sd: float, lower: float, upper: float) -> float:
        """Return the one acceleration left where rounding emptied the box."""
        bounds = self.limits[j]
        if lower - upper <= _EMPTY * (abs(lower) + abs(upper)):
            return min(max(0.5 * (lower + upper), -bounds.acceleration), bounds.acceleration)
        a = bounds.acceleration
        braked = sd - math.copysign(min(abs(sd), a * step), sd)
        reached = s + step * braked
        beyond = max(reached - bounds.upper, bounds.lower - reached)
        excess = abs(braked) - bounds.speed
        if beyond > excess:
            what, amount, unit = "track", float(beyond), "m"
            text = f"braked by {a:g} m/s² it would still be {beyond:.3g} m beyond the end of its track"
        else:
            what, amount, unit = "speed", float(excess), "m/s"
            text = f"braked by {a:g} m/s² it would still be {excess:.3g} m/s above its speed limit"
        message = (
            f"{self.carriers[j]} cannot keep its limits at t = {t:.6g} s: it arrives at s = {s:.6g} m with "
            f"{sd:.6g} m/s, and {text}."
        )
        remedy = "Use anticipate=True, a larger lam, higher limits, or a gentler motion."
        raise InfeasiblePlanError(
            message, remedy=remedy, constraint=what, carrier=self.carriers[j], time=t, amount=amount, unit=unit
        )


Active = Literal["always", "accelerating"]
"""When the optimiser works: at every step, or only while the platform accelerates."""

Stop = Literal["after", "within"]
"""When the carriers are brought to rest: after the motion, with the platform held, or by its last sample."""


@dataclass(frozen=True, eq=False)
class Settings:
    """Checked options of ``plan_stepwise``; see there.

    ``limits``: of the carriers; ``box``: what they leave in a step.
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
    """Return the settings of ``plan_stepwise`` after checking every one."""
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
