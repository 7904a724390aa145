"""When the main actuators are to be off: where the actuation matrix is too close to singular."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import brentq

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.kinematics.spectrum import scaled, spectrum_of
from redundancy_pin.planners.dips import Interval, below_zero, minima, sampling
from redundancy_pin.planners.timed_model import TimedActuation

Measure = Literal["condition", "margin"]

LARGEST_CONDITION = 1e6
"""Beyond it the times at which W reaches a threshold are lost in the rounding of W."""

SINGULAR = 1e-9
"""A smallest singular value below this fraction of the largest along the motion is zero."""


CLOSEST = 1e-6
"""Fraction of the motion within which two crossings count as one."""


class Measured:
    """How near to a type II singularity W is along a motion, and where it is nearer than a threshold.

    Args:
        actuation: W over time.
        reduced: any samples of the same robot, for the scales.
        measure: "condition": windows are where the condition number of the scaled W exceeds the threshold (that of
            the Jacobian for the 2-RPR, Parsa 2014, section 3.2); "margin": where its smallest singular value is below.
        threshold: for the condition number above 1, for the margin positive.

    Raises:
        InputError: another measure, or a threshold out of range.
    """

    def __init__(self, actuation: TimedActuation, reduced: ReducedDynamics, measure: Measure, threshold: float) -> None:
        if measure not in ("condition", "margin"):
            raise InputError(f"measure is {measure!r}.", remedy="Pass 'condition' or 'margin'.", measure=measure)
        lower, upper = (1.0, LARGEST_CONDITION) if measure == "condition" else (0.0, np.inf)
        if not lower < threshold < upper:
            raise InputError(
                f"threshold is {threshold}, but a {measure} between {lower:g} and {upper:g} is needed.",
                remedy="The thesis works with condition numbers from 4 to 20.",
                threshold=threshold,
            )
        self._actuation, self._measure, self._threshold = actuation, measure, threshold
        self._scales = reduced.row_scale, reduced.column_scale
        edges = actuation.interpolant.edges
        self._times = sampling(edges, float(edges[0]), float(edges[-1]))

    def windows(self) -> list[Interval]:
        """Return the intervals in which W is nearer to singular than the threshold."""
        return below_zero(self._excess, self._times)

    def singular_instants(self) -> list[float]:
        """Return the times, s, at which the motion crosses or touches a type II singularity."""
        found = [t for t, value in minima(self._relative_margin, self._times, SINGULAR) if value < SINGULAR]
        rows, columns = self._actuation.at(self._times[:1]).shape[1:]
        return sorted([*found, *self._crossings_beside(found)]) if rows == columns else found

    def _crossings_beside(self, found: list[float]) -> list[float]:
        """Return the crossings that a search for dips of the margin passes over: two close together leave one dip."""
        start, end = float(self._times[0]), float(self._times[-1])
        close = CLOSEST * (end - start)
        beside = [t + side for t in found for side in (-close, close) if start < t + side < end]
        times = np.union1d(self._times, beside)
        sign = np.sign(self._determinant(times))
        return [
            float(brentq(lambda t: float(self._determinant(np.array([t]))[0]), times[i], times[i + 1], xtol=1e-15))
            for i in np.flatnonzero(sign[1:] * sign[:-1] < 0.0)
            if not any(times[i] <= t <= times[i + 1] for t in found)
        ]

    def worst(self) -> float:
        """Return the largest condition number (infinite at a singularity), or the smallest margin, along the motion."""
        lowest = min(value for _, value in minima(self._excess, self._times, np.inf))
        if self._measure == "margin":
            return lowest + self._threshold
        relative_margin = lowest + 1.0 / self._threshold
        return 1.0 / relative_margin if relative_margin > SINGULAR else float("inf")

    def _determinant(self, times: Array) -> Array:
        value: Array = np.linalg.det(self._actuation.at(times))
        return value

    def _relative_margin(self, times: Array) -> Array:
        spectrum = spectrum_of(scaled(self._actuation.at(times), *self._scales))
        value: Array = spectrum.singular_values[:, -1] / spectrum.singular_values[:, 0]
        return value

    def _excess(self, times: Array) -> Array:
        """Return a continuous function that is negative inside the windows, also at the singularity itself."""
        if self._measure == "condition":
            return self._relative_margin(times) - 1.0 / self._threshold
        return spectrum_of(scaled(self._actuation.at(times), *self._scales)).margin - self._threshold


def require_inside(window: Interval, start: float, end: float, ramp_down: float) -> None:
    """Check that a window begins late enough for its ramp-down, and ends before the motion does.

    Raises:
        InfeasiblePlanError: it does not; carries the constraint, the time and the amount.
    """
    if window.open_start:
        raise InfeasiblePlanError(
            f"The motion begins at t = {start:.6g} s inside the region in which the actuators have to be off.",
            remedy="Start the motion further from the singularity, or move the threshold.",
            constraint="ramp_down",
            time=start,
            amount=ramp_down,
        )
    earliest = window.start - ramp_down
    if earliest < start:
        missing = start - earliest
        raise InfeasiblePlanError(
            f"The actuators have to be off from t = {window.start:.6g} s and need {ramp_down:g} s to ramp down, "
            f"but the motion begins at {start:.6g} s: {missing:.3g} s are missing.",
            remedy="Start the motion further from the singularity, shorten ramp_down, or move the threshold.",
            constraint="ramp_down",
            time=window.start,
            amount=missing,
        )
    if window.open_end:
        raise InfeasiblePlanError(
            f"The motion ends at t = {end:.6g} s inside the region in which the actuators have to be off.",
            remedy="End the motion further from the singularity, or move the threshold.",
            constraint="window_end",
            time=end,
            amount=end - window.start,
        )
