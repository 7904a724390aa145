"""When the main actuators are to be off: where the actuation matrix is too close to singular."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.kinematics.spectrum import scaled, spectrum_of
from redundancy_pin.planners.carrier_model import TimedActuation

SAMPLES_A_PIECE = 33
"""A piece of the interpolants is a polynomial of degree 15: its singular values have few dips, and a dip shows in the
samples on both sides of it."""

_ZOOM = 32
"""Subdivisions in the search of a minimum; each round narrows it sixteenfold."""


@dataclass(frozen=True)
class Interval:
    """An interval of time.

    Attributes:
        start, end: s.
        open_start, open_end: whether the function is below zero already at the start, or still at the end, of all time.
    """

    start: float
    end: float
    open_start: bool = False
    open_end: bool = False


def sampling(edges: Array, start: float, end: float) -> Array:
    """Return times that sample every piece densely, s; ``edges`` (P + 1,) are the ends of the pieces."""
    inner = edges[(edges > start) & (edges < end)]
    ends = np.concatenate([[start], inner, [end]])
    fraction = np.linspace(0.0, 1.0, SAMPLES_A_PIECE)[:-1]
    times: Array = np.append((ends[:-1, None] + np.diff(ends)[:, None] * fraction).ravel(), end)
    return times


def minima(function: Callable[[Array], Array], times: Array, interesting: float) -> list[tuple[float, float]]:
    """Return (time, value) of the local minima of a function that may fall below ``interesting``.

    A dip whose samples lie so far above it that the slopes beside it cannot reach it is left alone.

    Args:
        function: from (N,) times, s, to (N,) values.
        times: (N,) increasing times that sample it densely.
        interesting: minima above this value are not needed.
    """
    value = function(times)
    padded = np.concatenate([[np.inf], value, [np.inf]])
    lowest = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])
    found: list[tuple[float, float]] = []
    for i in np.flatnonzero(lowest):
        low, high = max(int(i) - 1, 0), min(int(i) + 1, len(times) - 1)
        drop = max(value[low] - value[i], value[high] - value[i])
        if value[i] - 2.0 * drop > interesting:
            continue
        best = _minimum(function, float(times[low]), float(times[high]))
        if not found or best[0] > found[-1][0]:
            found.append(best)
    return found


def below_zero(function: Callable[[Array], Array], times: Array) -> list[Interval]:
    """Return the intervals over which a continuous function is below zero, their ends by Brent's method.

    Args:
        function: from (N,) times, s, to (N,) values.
        times: (N,) increasing times that sample it densely.
    """
    dips = np.array([t for t, value in minima(function, times, 0.0) if value < 0.0])
    grid = np.union1d(times, dips)
    inside = function(grid) < 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    found = []
    for first, past in zip(edges[::2], edges[1::2], strict=True):
        open_start, open_end = first == 0, past == len(grid)
        start = grid[0] if open_start else _root(function, grid[first - 1], grid[first])
        end = grid[-1] if open_end else _root(function, grid[past - 1], grid[past])
        found.append(Interval(float(start), float(end), bool(open_start), bool(open_end)))
    return found


def _minimum(function: Callable[[Array], Array], a: float, b: float) -> tuple[float, float]:
    """Zoom in on the lowest of many samples: exact to rounding also at the sharp minimum of a singular value at zero.

    (Parabolic searches stop at the square root of rounding, which is right for smooth minima only.)
    """
    best = (a, np.inf)
    while True:
        times = np.linspace(a, b, _ZOOM + 1)
        values = function(times)
        i = int(values.argmin())
        if values[i] < best[1]:
            best = (float(times[i]), float(values[i]))
        narrower = (float(times[max(i - 1, 0)]), float(times[min(i + 1, _ZOOM)]))
        if not narrower[1] - narrower[0] < b - a or b - a < 1e-15 * max(abs(a), abs(b)):
            return best
        a, b = narrower


def _root(function: Callable[[Array], Array], a: float, b: float) -> float:
    return float(brentq(lambda t: float(function(np.array([t]))[0]), a, b, xtol=1e-15, rtol=1e-15))


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
