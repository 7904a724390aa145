"""The options of the stepwise planner, and the box that limits leave for accelerations in one step.

In one step of length h a carrier takes a new speed v' and moves by h v' (backward differences, Parsa 2014, eqs. 4.3
and 4.4). Say it has the distance g to the end of its track in front of it and can be braked by at most a. It may take
the speed v' if what is left after the step suffices to stop: h v' + v'²/(2a) ≤ g. Braking by a keeps this true: with
v' = max(v − a h, 0) the step is at most (v² − v'²)/(2a). So a carrier that starts inside the set never leaves its
track, whatever the lengths of the steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any, Literal, get_args

import numpy as np

from redundancy_pin.arrays import Array, positive
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.limits import Limits, ResolvedLimits, fraction, one_of, return_duration, whole
from redundancy_pin.robot import CarrierLimits, Robot

_EMPTY = 1e-9
"""A box that is empty by less than this fraction of the accelerations involved is one point: a limit that is met
exactly leaves a rounding error."""


def stoppable_speed(gap: float, step: float, deceleration: float) -> float:
    """Return the largest speed, m/s, from which a carrier can still be stopped before the end of its track.

    It is the root of h v + v²/(2a) = gap, or 0 where the gap, m, is not positive; h is the step, s, and a the largest
    deceleration, m/s², infinite if there is no limit.
    """
    if gap <= 0.0:
        return 0.0
    if not math.isfinite(deceleration) or not math.isfinite(gap):
        return gap / step
    slowed = deceleration * step
    # the rationalised root: the plain one cancels where the gap is small
    return 2.0 * deceleration * gap / (slowed + math.sqrt(slowed * slowed + 2.0 * deceleration * gap))


@dataclass(frozen=True)
class AccelerationBox:
    """What the carriers must keep to at every step.

    ``carriers`` (k,) names; ``limits`` (k,) track, speed, acceleration and force of each; the planner keeps to the
    first three; ``anticipate``: whether a carrier is kept able to stop before the end of its track; ``rest_at``: time
    by which all must be at rest, s; infinite for none.
    """

    carriers: tuple[str, ...]
    limits: tuple[CarrierLimits, ...]
    anticipate: bool
    rest_at: float

    @cached_property
    def _bounds(self) -> tuple[tuple[float, float, float, float], ...]:
        """Plain tuples: they are read at every step."""
        return tuple((limit.lower, limit.upper, limit.speed, limit.acceleration) for limit in self.limits)

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
    """Checked options of ``plan_stepwise``; see there. Numbers and names a plan has among its parameters."""

    limits: ResolvedLimits
    lam: float
    active: Active
    start: Array
    datum: Array
    anticipate: bool
    return_time: float | Literal["shortest"]
    stop: Stop
    brake_time: float
    least_margin: float
    between: int

    @property
    def parameters(self) -> dict[str, object]:
        """The settings as plain data, for the plan."""
        own = {field.name: getattr(self, field.name) for field in fields(self)[1:]}
        own |= {name: tuple(own[name].tolist()) for name in ("start", "datum")}
        return {**own, **self.limits.parameters()}

    def box(self, end: float) -> AccelerationBox:
        """Return what the carriers must keep to in a motion that ends at a time, s."""
        limits = self.limits
        return AccelerationBox(
            limits.names, limits.of_carriers, self.anticipate, end if self.stop == "within" else math.inf
        )


def checked_settings(robot: Robot, limits: Limits, **options: Any) -> Settings:
    """Return the settings of ``plan_stepwise`` after checking every one; ``options`` are the fields but ``limits``."""
    for name, allowed in (("active", get_args(Active)), ("stop", get_args(Stop)), ("anticipate", (True, False))):
        one_of(options[name], name, allowed)
    for name in ("jerk", "carrier_force", "effort"):
        if getattr(limits, name) is not None:
            raise InputError(
                f"The stepwise planner keeps to no limit of {name}.",
                remedy="Leave it out, or use plan_whole_trajectory.",
                name=name,
            )
    resolved = limits.resolved(robot)
    if options["stop"] == "within" and np.isinf(resolved.acceleration).any():
        raise InputError(
            'stop="within" needs acceleration limits: without them nothing says when to brake.',
            remedy='Declare or pass acceleration limits, or use stop="after".',
        )
    checks: dict[str, Callable[[Any, str], object]] = {
        "lam": fraction,
        "between": partial(whole, least=0, most=1000),
        "start": resolved.on_track,
        "datum": resolved.on_track,
        "return_time": return_duration,
        "brake_time": partial(positive, unit="s"),
        "least_margin": partial(positive, unit=""),
    }
    return Settings(resolved, **{**options, **{name: check(options[name], name) for name, check in checks.items()}})
