"""Zeros, touches and minima of a function of time: the one finder of singular instants and of windows around them.

A function here takes (N,) increasing times, s, and returns (N,) values. It is continuous, and sampled so densely that
it has at most one dip between two samples, which shows in the samples next to it. Steps with a value that is not finite
are not searched. Sign changes are found by Brent's method; zeros of even multiplicity, and pairs of zeros within one
step, by the minimum of the function's size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from redundancy_pin.arrays import Array, BoolArray, runs

Function = Callable[[Array], Array]

ZOOM = 32
"""Subdivisions of a bracket in the search of a minimum: each iteration narrows it sixteenfold, in one call."""


@dataclass(frozen=True)
class Zero:
    """A zero of a function.

    Attributes:
        t: time, s: to machine precision where the sign changes, to its square root where the function touches zero.
        until: equal to ``t``, or the time until which the function stays at zero.
        crosses: whether the sign changes.
    """

    t: float
    until: float
    crosses: bool


@dataclass(frozen=True)
class Interval:
    """An interval of time in which a function is below zero.

    Attributes:
        start, end: s.
        open_start, open_end: whether the function is below zero at the first, or at the last sampled time.
    """

    start: float
    end: float
    open_start: bool = False
    open_end: bool = False


def zeros(function: Function, times: Array, tolerance: float) -> list[Zero]:
    """Return the zeros of a function in order of time: crossed, touched, or stayed at.

    Args:
        function: see the module; signed, so that crossed zeros are distinguished from touched ones.
        times: (N,) increasing times, the samples.
        tolerance: size at which a minimum, or a sample, counts as zero.

    Example:
        >>> zeros(lambda t: np.cos(t), np.linspace(0.0, 2.0, 9), 1e-9)
        [Zero(t=1.5707963267948966, until=1.5707963267948966, crosses=True)]
    """
    value = function(times)
    finite = np.isfinite(value)
    zero = finite & (np.abs(value) <= tolerance)
    result = [one for run in runs(zero) for one in _at_samples(function, times, value, *run, tolerance)]
    inside = finite & ~zero
    joined = inside[:-1] & inside[1:]
    same = joined & (np.sign(value[:-1]) == np.sign(value[1:]))
    for k in np.flatnonzero(joined & ~same):
        result.append(_crossing(function, times[k], times[k + 1]))
    for low, high in _brackets(np.where(finite, np.abs(value), np.inf), same, tolerance):
        result += _dip(function, times[low], times[high], float(np.sign(value[low])), tolerance)
    result.sort(key=lambda one: one.t)
    # a dip between two samples of equal value is met from both
    apart = float(np.diff(times).min(initial=np.inf)) / ZOOM
    return [
        one
        for k, one in enumerate(result)
        if k == 0 or one.crosses or result[k - 1].crosses or one.t - result[k - 1].until > apart
    ]


def minima(function: Function, times: Array, interesting: float) -> list[tuple[float, float]]:
    """Return (time, value) of the local minima of a function that may fall below ``interesting``.

    A dip is skipped if the slopes next to it cannot reach that value. A minimum is exact to machine precision, also if
    it is sharp, as a singular value at zero is.

    Args:
        function: see the module.
        times: (N,) increasing times, the samples.
        interesting: minima above this value are not needed.
    """
    value = function(times)
    lowest: list[tuple[float, float]] = []
    for low, high in _brackets(value, np.ones(len(times) - 1, dtype=bool), interesting):
        best = _minimum(function, times[low], times[high])
        if not lowest or best[0] > lowest[-1][0]:
            lowest.append(best)
    return lowest


def below_zero(function: Function, times: Array) -> list[Interval]:
    """Return the intervals over which a function is below zero, their ends by Brent's method.

    Args:
        function: see the module.
        times: (N,) increasing times, the samples.
    """
    dips = np.array([t for t, value in minima(function, times, 0.0) if value < 0.0])
    grid = np.union1d(times, dips)
    intervals = []
    for first, stop in runs(function(grid) < 0.0):
        open_start, open_end = first == 0, stop == len(grid)
        start = float(grid[0]) if open_start else root(function, grid[first - 1], grid[first])
        end = float(grid[-1]) if open_end else root(function, grid[stop - 1], grid[stop])
        intervals.append(Interval(start, end, open_start, open_end))
    return intervals


def root(function: Function, a: float, b: float) -> float:
    """Return the time between ``a`` and ``b`` at which a function changes sign, to machine precision."""
    return float(brentq(lambda t: float(function(np.array([t]))[0]), a, b, xtol=1e-15 * (b - a), rtol=1e-15))


def _crossing(function: Function, a: float, b: float) -> Zero:
    t = root(function, a, b)
    return Zero(t, t, True)


def _dip(function: Function, a: float, b: float, sign: float, tolerance: float) -> list[Zero]:
    """Return the zeros of a function that has one sign at both ends: none, a touch, or a pair of crossings."""
    t, lowest = _minimum(function, a, b, sign)
    if lowest < -tolerance:
        return [_crossing(function, a, t), _crossing(function, t, b)]
    return [Zero(t, t, False)] if lowest <= tolerance else []


def _at_samples(function: Function, times: Array, value: Array, first: int, stop: int, tolerance: float) -> list[Zero]:
    """Turn consecutive samples at zero into a crossing that hit a sample, a touch, a stay, or a pair of crossings."""
    low, high = max(first - 1, 0), min(stop, len(times) - 1)  # the samples next to them
    enters, leaves = first > 0 and bool(np.isfinite(value[low])), stop < len(times) and bool(np.isfinite(value[high]))
    crosses = enters and leaves and bool(value[low] * value[high] < 0.0)
    if stop - first <= 2 and crosses:
        return [_crossing(function, times[low], times[high])]
    if stop - first <= 2:
        at = float(times[first + int(np.argmin(np.abs(value[first:stop])))])
        touch = Zero(at, at, False)
        t, lowest = _minimum(function, times[low], times[high], float(np.sign(value[low if enters else high])))
        if not lowest < -tolerance:
            return [touch]
        # a second zero lies between this sample and its neighbour
        start = _crossing(function, times[low], t) if enters else touch
        return [start, _crossing(function, t, times[high]) if leaves else touch]

    def excess(at: Array) -> Array:
        return np.abs(function(at)) - tolerance

    entered, left = float(times[first]), float(times[stop - 1])
    if enters and abs(value[first]) < tolerance:
        entered = root(excess, times[low], entered)
    if leaves and abs(value[stop - 1]) < tolerance:
        left = root(excess, left, times[high])
    return [Zero(entered, left, crosses)]


def _brackets(value: Array, joined: BoolArray, interesting: float) -> Iterator[tuple[int, int]]:
    """Yield the samples on both sides of each local minimum that may fall below ``interesting``.

    Args:
        value: (N,) samples.
        joined: (N − 1,) whether the step between two samples may be searched.
        interesting: see ``minima``.
    """
    # next to a sign change there is no dip: the function continues to fall through zero
    left = np.append(np.inf, np.where(joined | np.isinf(value[:-1]), value[:-1], -np.inf))
    right = np.append(np.where(joined | np.isinf(value[1:]), value[1:], -np.inf), np.inf)
    for i in np.flatnonzero(np.isfinite(value) & (value <= left) & (value <= right)).tolist():
        low, high = i - int(np.isfinite(left[i])), i + int(np.isfinite(right[i]))
        # by convexity of a dip: between two samples it falls by less than twice its fall outside of them
        fall = 2.0 * (max(value[low], value[high]) - value[i])
        # in the first or last step nothing is outside on one side, and the step before gives its slope
        if i in (0, len(value) - 1) and len(value) > 2:
            fall = max(fall, value[2 if i == 0 else i - 2] - value[1 if i == 0 else i - 1])
        if value[i] - fall <= interesting:
            yield low, high


def _minimum(function: Function, a: float, b: float, sign: float = 1.0) -> tuple[float, float]:
    """Return time and value of the minimum of ``sign`` times a function, by zooming in on the lowest of many samples.

    Parabolic searches stop at the square root of machine precision, which suits smooth minima only.
    """
    best, least = (a, np.inf), 1e-15 * max(abs(a), abs(b))
    while True:
        times = np.unique(np.linspace(a, b, ZOOM + 1))
        values = sign * function(times)
        i = int(np.where(np.isfinite(values), values, np.inf).argmin())
        if values[i] < best[1]:
            best = (float(times[i]), float(values[i]))
        narrower = (float(times[max(i - 1, 0)]), float(times[min(i + 1, len(times) - 1)]))
        if not narrower[1] - narrower[0] < b - a or b - a < least:
            return best
        a, b = narrower
