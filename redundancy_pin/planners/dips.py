"""Where a continuous function of time has its dips, and where it is below zero, also between the samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from redundancy_pin.arrays import Array

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
