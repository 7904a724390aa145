"""Slowing down: where no plan keeps every limit, the platform goes along its path more slowly, and faster again.

A reference governor (E. Gilbert, I. Kolmanovsky and K. T. Tan, 1995) in time: of some changes of σ̇, the speed along the
preview, the first counts that has a plan; mild ones are tried first. σ̈ is continuous, so that the efforts are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.planners.receding_horizon.command import Command, TickPlan
from redundancy_pin.planners.receding_horizon.constants import (
    CONVERGED,
    CREEPING,
    FASTER,
    FULL,
    HOLD,
    KEPT,
    LEAST_RATE,
    RISE,
    SLOWER,
)
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.planners.receding_horizon.tick import TickPlanner
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory.time_scaling import TimeScaling


class Slowing:
    """The platform's speed along what is known of its path.

    Args:
        ticks: plans ticks.
        horizon: s.

    Attributes:
        scaling: σ, the time of the preview, by the clock's; None as long as both are the same.
    """

    def __init__(self, ticks: TickPlanner, horizon: float) -> None:
        self.ticks, self.horizon = ticks, horizon
        self.scaling: TimeScaling | None = None
        self._held_until = -float("inf")

    def time_of(self, t: float) -> float:
        """Return which time of the preview the platform is at, s."""
        return t if self.scaling is None else float(self.scaling.at([t])[0][0])

    def shown(self, preview: Preview) -> Preview:
        """Return a preview in the time of the clock."""
        return preview if self.scaling is None else preview.scaled(self.scaling)

    def tick(self, t: float, given: tuple[Array | None, ...], preview: Preview) -> TickPlan:
        """Return a plan from a time on, and keep it, as ``TickPlanner.tick``; at another speed where that has none.

        ``preview``: in its own time.
        """
        ticks, kept, horizon = self.ticks, self.ticks.ahead, self.horizon
        scaling = TimeScaling.none(t) if self.scaling is None else self.scaling
        begins = self._from(t)
        (rate,), final = scaling.at([begins])[1], scaling.final_rate
        slowest, changes = min(rate, final), []
        if final < FULL and t >= self._held_until:
            self._held_until = t + HOLD * ticks.step
            more = (1.0, FASTER, CREEPING) if final < CREEPING else (1.0, FASTER)
            changes = [(min(final + by, 1.0), RISE) for by in more]
        changes.append((final, 0.0))  # as it is
        if slowest > 0.0:
            slower = ((factor * slowest, part) for factor, part in SLOWER)
            changes += [(wanted if wanted >= LEAST_RATE else 0.0, part) for wanted, part in slower]
        for wanted, part in dict.fromkeys(changes):
            other, ahead = self.scaling, kept
            if part:
                other = scaling.changed(begins, wanted, part * horizon, t - KEPT * ticks.step)
                least, most = other.rates
                if least < FULL - 1.0 or most > 2.0 - FULL:  # back along the path, or faster than the preview
                    continue
                ahead = kept.along(preview.scaled(other), t)
            plan = ticks.within_limits(ahead, t, min(t + horizon, ahead.preview.end), given)
            if plan is not None:
                if part:
                    self.scaling, self._held_until = other, t + HOLD * ticks.step
                return plan
        return ticks.tick(t, min(t + horizon, kept.preview.end), given)

    def told(self, command: Command, t: float) -> Command:
        """Return a command with the time of the preview, and whether the platform is slower than that."""
        if self.scaling is None:
            return command
        status, reason = command.status, command.reason
        if status is UpdateStatus.OK and min(self.scaling.final_rate, *self.scaling.at([t])[1]) < FULL:
            status = UpdateStatus.TIME_SCALED
            reason = f"the platform goes over to {self.scaling.final_rate:.1%} of the preview's speed"
            if self.scaling.final_rate < FULL:
                reason += ": with more of it no plan was found that keeps every limit"
        return replace(command, status=status, reason=reason, scaling=self.scaling)

    def _from(self, t: float) -> float:
        """Return from when on σ̇ may change, s: next to a singular instant the last plan goes on."""
        step, last, coming = self.ticks.step, self.ticks.last, self.ticks.ahead.roots
        if last is not None:  # of another preview, none has come into sight yet
            coming = np.append(coming, last.command.singular)
        near = coming[(coming > t - step) & (coming < t + CONVERGED * step)]
        return max(t, float(near.max()) + 0.5 * step) if len(near) else t
