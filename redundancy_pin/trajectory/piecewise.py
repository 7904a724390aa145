"""Carrier motion as a piecewise polynomial of time."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np
from numpy.polynomial import chebyshev, legendre

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.trajectory import Polynomial, Side

NODES = 16
"""Nodes a piece. Smooth motions of a second then need a few dozen pieces for twelve digits."""

LEAST_WIDTH = 1e-7
"""Pieces narrower than this fraction of the interval are not divided: only an undeclared kink gets there, and an error
over so short a time has no consequence."""

MOST_PIECES = 20_000
"""Past this the function is noise at the tolerance asked for, and what has been reached is kept."""


@dataclass(frozen=True, eq=False)
class PiecewiseChebyshev:
    """A function from time to C numbers.

    Attributes:
        edges: (P + 1,) ends of the pieces, s.
        coefficients: (P, 16, C) Chebyshev coefficients of each piece.
    """

    edges: Array
    coefficients: Array

    def __call__(self, t: Array, side: Side = "right") -> Array:
        """Return the values (N, C) at (N,) times inside the interval; ``side`` decides on the edge of two pieces."""
        times = np.asarray(t, dtype=np.float64)
        piece = np.clip(np.searchsorted(self.edges, times, side=side) - 1, 0, len(self.edges) - 2)
        left, right = self.edges[piece], self.edges[piece + 1]
        x = ((2.0 * times - left - right) / (right - left))[:, None]
        later = np.zeros((len(times), self.coefficients.shape[2]))
        last = later.copy()
        for j in range(self.coefficients.shape[1] - 1, 0, -1):  # Clenshaw
            last, later = self.coefficients[piece, j] + 2.0 * x * last - later, last
        value: Array = self.coefficients[piece, 0] + x * last - later
        return value


def fit(
    function: Callable[[Array], Array], edges: Array, knots: Array, scale: Callable[[Array], Array], tolerance: float
) -> PiecewiseChebyshev:
    """Interpolate a function, dividing the pieces until their last coefficients fall below a tolerance.

    Args:
        function: from (N,) strictly increasing times inside the pieces to (N, C) values.
        edges: (P + 1,) ends of the first pieces, s: the ends of the interval and every known jump in between.
        knots: (c,) times at which pieces are preferably divided, s.
        scale: from (N, C) values of the first pieces to the (C,) sizes that the tolerance is a fraction of.
        tolerance: largest allowed last coefficients, as a fraction of the scale.
    """
    nodes = np.sort(chebyshev.chebpts1(NODES))
    to_coefficients = np.linalg.inv(chebyshev.chebvander(nodes, NODES - 1))
    left, right = edges[:-1], edges[1:]
    least = LEAST_WIDTH * (edges[-1] - edges[0])
    done: list[tuple[Array, Array]] = []
    size: Array | None = None
    count = 0
    while len(left):
        times = 0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * nodes
        values = function(times.ravel())
        if size is None:
            size = scale(values)
        coefficients = np.einsum("dn,pnc->pdc", to_coefficients, values.reshape(len(left), NODES, -1))
        tail = (np.abs(coefficients[:, -3:]).max(axis=1) / size).max(axis=1)
        count += len(left)
        divide = (tail > tolerance) & (right - left > least) & (count < MOST_PIECES)
        done.append((left[~divide], coefficients[~divide]))
        middle = np.array([preferred_middle(a, b, knots) for a, b in zip(left[divide], right[divide], strict=True)])
        left, right = (
            np.sort(np.concatenate([left[divide], middle])),
            np.sort(np.concatenate([middle, right[divide]])),
        )
    starts = np.concatenate([part[0] for part in done])
    order = np.argsort(starts)
    return PiecewiseChebyshev(
        read_only(np.append(starts[order], edges[-1])),
        read_only(np.concatenate([part[1] for part in done])[order]),
    )


def preferred_middle(left: float, right: float, knots: Array) -> float:
    """Return where to divide an interval: the knot nearest to its middle, or the middle if there is none inside."""
    middle = 0.5 * (left + right)
    slack = 1e-3 * (right - left)
    inside = knots[np.searchsorted(knots, left + slack) : np.searchsorted(knots, right - slack)]
    return float(inside[np.abs(inside - middle).argmin()]) if len(inside) else middle


@dataclass(frozen=True, eq=False)
class CarrierPath:
    """Positions of the carriers as Legendre series on consecutive intervals.

    Attributes:
        edges: (P + 1,) ends of the intervals, s.
        series: (P, d, k) Legendre coefficients of s on each interval, over x = −1 … 1, m.
    """

    edges: Array
    series: Array

    @staticmethod
    def of_polynomial(polynomial: Polynomial) -> CarrierPath:
        """Return the path of a polynomial with values (k,)."""
        series = _legendre_from_bernstein(polynomial.degree) @ polynomial.control
        return CarrierPath(read_only(np.array([polynomial.t0, polynomial.t1])), read_only(series[None]))

    @property
    def start(self) -> float:
        """First time, s."""
        return float(self.edges[0])

    @property
    def end(self) -> float:
        """Last time, s."""
        return float(self.edges[-1])

    def __call__(self, times: Array, side: Side = "right") -> CarrierMotion:
        """Return the motion at (N,) times inside the path; ``side`` decides where s̈ jumps."""
        t = np.asarray(times, dtype=np.float64)
        piece = np.clip(np.searchsorted(self.edges, t, side=side) - 1, 0, len(self.series) - 1)
        left, width = self.edges[piece], np.diff(self.edges)[piece]
        x = np.clip(2.0 * (t - left) / width - 1.0, -1.0, 1.0)
        parts: list[Array] = []
        series: Array = self.series
        for order in range(3):
            basis = legendre.legvander(x, series.shape[1] - 1)
            factor = (2.0 / width) ** order
            parts.append(factor[:, None] * np.einsum("nd,ndk->nk", basis, series[piece]))
            series = np.asarray(legendre.legder(series, axis=1), dtype=np.float64)
        return CarrierMotion(*parts)

    def extremes(self) -> Array:
        """Return the inner times, s, at which some s, ṡ or s̈ has a local extreme."""
        found = [self._stationary(order, i) for order in range(3) for i in range(self.series.shape[2])]
        return np.unique(np.concatenate(found))

    def peaks(self) -> Array:
        """Return the inner times, s, at which some s, ṡ or s̈ is largest or smallest, if it is so inside only."""
        found = []
        for order in range(3):
            for i in range(self.series.shape[2]):
                times = np.concatenate([[self.start, self.end], self._stationary(order, i)])
                motion = self(times)
                value = (motion.s, motion.sd, motion.sdd)[order][:, i]
                for signed in (value, -value):
                    best = int(signed.argmax())
                    if signed[best] > signed[:2].max() + _STANDS_OUT * np.abs(value).max():
                        found.append(times[best])
        return np.unique(found)

    def _stationary(self, order: int, carrier: int) -> Array:
        """Return the inner times at which the derivative of that order of one carrier has a zero rate."""
        rates = np.asarray(legendre.legder(self.series[:, :, carrier], order + 1, axis=1))
        middle, half = 0.5 * (self.edges[1:] + self.edges[:-1]), 0.5 * np.diff(self.edges)
        found = [m + h * _real_roots(rate) for m, h, rate in zip(middle, half, rates, strict=True)]
        return np.concatenate(found)


_STANDS_OUT = 1e-6
"""A peak counts if it exceeds both ends by this fraction; less is no peak worth a sample."""


def _real_roots(series: Array) -> Array:
    """Return the roots of a Legendre series inside (−1, 1); none for a series that is zero to rounding."""
    size = np.abs(series)
    if size.max() == 0.0:
        return np.empty(0)
    kept = series[: int(np.flatnonzero(size > 1e-14 * size.max())[-1]) + 1]
    roots = legendre.legroots(kept)
    real = roots.real[np.abs(roots.imag) < 1e-9]
    inside: Array = real[np.abs(real) < 1.0]
    return inside


@lru_cache(maxsize=8)
def _legendre_from_bernstein(degree: int) -> Array:
    """Return the (d, d) matrix from the Bernstein to the Legendre coefficients of a polynomial: it interpolates it."""
    x, _ = legendre.leggauss(degree + 1)
    kappa, j = 0.5 * (x[:, None] + 1.0), np.arange(degree + 1)
    bernstein = np.array([comb(degree, i) for i in j]) * kappa**j * (1.0 - kappa) ** (degree - j)
    return read_only(np.linalg.solve(legendre.legvander(x, degree), bernstein))


JUMP = 1e-6
"""Difference at the end of a piece, relative to the largest value, from which a function jumps there."""


class Series:
    """A function of time as Chebyshev series in pieces, for one instant at a time.

    A simulation asks for the efforts of one instant after the other; at that, numpy's functions for arrays of instants
    take ten times as long.

    Args:
        edges: (P + 1,) ends of the pieces, s.
        coefficients: (P, D + 1, C) coefficients of each piece.
    """

    def __init__(self, edges: Array, coefficients: Array) -> None:
        self.edges, self.coefficients = edges, coefficients
        self._edges: list[float] = edges.tolist()
        self._starts = self._edges[:-1]
        self._pieces = list(coefficients)
        self._orders = np.arange(float(coefficients.shape[1]))

    def __call__(self, t: float) -> Array:
        """Return the values (C,) at time t, s; after a jump there, and outside the pieces those at their ends."""
        piece = max(bisect_right(self._starts, t) - 1, 0)
        left, right = self._edges[piece], self._edges[piece + 1]
        x = min(max((2.0 * t - left - right) / (right - left), -1.0), 1.0)
        value: Array = np.cos(self._orders * math.acos(x)).dot(self._pieces[piece])
        return value

    def jumps(self) -> Array:
        """Return the inner ends of pieces, s, at which the function jumps."""
        signs = (-1.0) ** self._orders[:, None]
        begins, ends = (signs * self.coefficients).sum(axis=1), self.coefficients.sum(axis=1)
        size = np.abs(ends).max(axis=0, initial=0.0)
        apart = (np.abs(begins[1:] - ends[:-1]) > JUMP * size).any(axis=1)
        found: Array = self.edges[1:-1][apart]
        return found
