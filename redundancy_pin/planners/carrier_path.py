"""Carrier motion as a piecewise polynomial of time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np
from numpy.polynomial import legendre

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.trajectory import Polynomial, Side


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
