"""The box that limits leave for the carriers' accelerations in one step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_return import stoppable_speed
from redundancy_pin.robot import CarrierLimits

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

        Args:
            t: time at the end of the step, s.
            step: length h of the step, s.
            s: (k,) positions before the step, m.
            sd: (k,) speeds before the step, m/s.

        Raises:
            InfeasiblePlanError: the limits leave nothing; names the carrier, the time and the amount.
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
        """Return the one acceleration left where rounding emptied the box.

        Raises:
            InfeasiblePlanError: it is empty by more than rounding.
        """
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
        raise InfeasiblePlanError(
            f"{self.carriers[j]} cannot keep its limits at t = {t:.6g} s: it arrives at s = {s:.6g} m with "
            f"{sd:.6g} m/s, and {text}.",
            remedy="Use anticipate=True, a larger lam, higher limits, or a gentler motion.",
            constraint=what,
            carrier=self.carriers[j],
            time=t,
            amount=amount,
            unit=unit,
        )
