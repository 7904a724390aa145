"""Timing laws made of polynomial pieces: one that meets given speeds, and whatever else is put together of pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from redundancy_pin.arrays import Array, Frozen, assign, checked, inside, positive, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.timing import TimingPoint


@dataclass(frozen=True, init=False, eq=False)
class PiecewiseLaw(Frozen):
    """Arc length as polynomials of time, continuous up to its second derivative.

    Attributes:
        polynomials: p(t) with a single value, from t = 0; increasing.
        length: arc length at the end, m.
    """

    polynomials: PiecewisePolynomial
    length: float

    def __init__(self, polynomials: PiecewisePolynomial, length: float) -> None:
        assign(self, polynomials=polynomials, length=length)

    @property
    def duration(self) -> float:
        """Time at the end, s."""
        return self.polynomials.end

    @property
    def knots(self) -> Array:
        """(c,) times at which p's third derivative may jump, s."""
        return self.polynomials.edges[1:-1]

    def evaluate(self, t: ArrayLike) -> TimingPoint:
        """Return p, ṗ, p̈ at times t; see ``TimingLaw.evaluate``."""
        times = inside(t, 0.0, self.duration, "t", "s")
        p, pd, pdd = (self.polynomials.derivative(order)(times.ravel()).reshape(times.shape) for order in range(3))
        return TimingPoint(np.clip(p, 0.0, self.length), pd, pdd)

    def time_at(self, p: float) -> float:
        """Return the time, s, at which arc length p, m, is reached; see ``TimingLaw.time_at``."""
        place = float(inside(p, 0.0, self.length, "p", "m"))
        edges = self.polynomials.edges
        reached = np.append(self.polynomials(edges[:-1])[:, 0], self.length)
        k = int(np.clip(np.searchsorted(reached, place, side="right") - 1, 0, len(edges) - 2))
        a, b = float(edges[k]), float(edges[k + 1])

        def beyond(t: float) -> float:
            return float(self.polynomials.at(t)[0]) - place

        if beyond(a) >= 0.0 or beyond(b) <= 0.0:
            return a if beyond(a) >= 0.0 else b
        return float(brentq(beyond, a, b, xtol=1e-300, rtol=4.0 * np.finfo(float).eps))

    def scaled(self, factor: float) -> PiecewiseLaw:
        """Return the same law run ``factor`` times as fast."""
        faster = positive(factor, "factor", "(ratio)")
        powers = faster ** np.arange(len(self.polynomials.coefficients))[::-1, None, None]
        edges = read_only(self.polynomials.edges / faster)
        return PiecewiseLaw(PiecewisePolynomial(edges, read_only(self.polynomials.coefficients * powers)), self.length)


def uniform_law(length: float, duration: float) -> PiecewiseLaw:
    """Return p = length · t / duration: the law of a path that is a function of time itself."""
    coefficients = np.array([[[length / duration]], [[0.0]]])
    return PiecewiseLaw(PiecewisePolynomial(read_only(np.array([0.0, duration])), read_only(coefficients)), length)


def law_through_speeds(lengths: ArrayLike, speeds: ArrayLike) -> PiecewiseLaw:
    """Return the law that passes arc lengths (N,), m, at speeds (N,), m/s, with continuous acceleration.

    Between two of them the speed is the cubic of time with given values and accelerations at both ends, and the
    duration T is that which covers the distance: T (v0 + v1)/2 + T² (a0 − a1)/12 = Δp. The accelerations are half the
    slopes of the monotone cubic of v² over p, so that speeds of uniform acceleration give just that; they are zero at
    both ends of the path.

    Raises:
        InputError: lengths that do not increase, negative speeds, or two of zero in a row.
    """
    p = checked(lengths, "lengths", ("N",))
    v = checked(speeds, "speed", (len(p),))
    if len(p) < 2 or (np.diff(p) <= 0.0).any():
        raise InputError("Arc lengths must increase.", remedy="Pass at least two, in order.")
    if (v < 0.0).any():
        k = int(v.argmin())
        raise InputError(f"speed[{k}] is {v[k]:g} m/s.", remedy="Speeds along the path are not negative.", index=k)
    rest = np.flatnonzero((v[1:] == 0.0) & (v[:-1] == 0.0))
    if len(rest):
        k = int(rest[0])
        raise InputError(
            f"speed[{k}] and speed[{k + 1}] are zero: the second point is never reached.",
            remedy="Give one of them a speed.",
            index=k,
        )
    slopes = 0.5 * PchipInterpolator(p, v**2).derivative()(p) if len(p) > 2 else np.zeros(2)
    slopes[[0, -1]] = 0.0
    for share in (1.0, 0.5, 0.0):  # without accelerations at the points the speed is monotone between them
        law = _law(p, v, share * slopes)
        if law is not None:
            return law
    raise InputError("No law has these speeds.", remedy="Space the points more evenly.")


def _law(p: Array, v: Array, a: Array) -> PiecewiseLaw | None:
    """Return the law with speeds and accelerations (N,) at arc lengths; None where it would run backwards."""
    mean, bend, gap = 0.5 * (v[1:] + v[:-1]), (a[:-1] - a[1:]) / 12.0, np.diff(p)
    inner = mean**2 + 4.0 * bend * gap
    if (inner < 0.0).any():
        return None
    T = 2.0 * gap / (mean + np.sqrt(inner))  # the root that is there without accelerations too
    edges = np.concatenate([[0.0], np.cumsum(T)])
    speed = np.stack([v[:-1], v[:-1] + T * a[:-1] / 3.0, v[1:] - T * a[1:] / 3.0, v[1:]])  # Bernstein
    control = np.concatenate([np.zeros((1, len(T))), np.cumsum(speed, axis=0)]) * T / 4.0 + p[:-1] - p[0]
    polynomials = PiecewisePolynomial.from_bernstein(control[:, :, None], edges)
    least, _ = polynomials.derivative().ranges()
    return PiecewiseLaw(polynomials, float(p[-1] - p[0])) if least.min() >= -1e-12 * v.max() else None
