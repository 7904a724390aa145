"""Timing laws made of polynomial pieces: one that meets given speeds, and whatever else is put together of pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly, PchipInterpolator

from redundancy_pin.arrays import Array, Frozen, checked, frozen, positive
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.timing import PolynomialLaw


@dataclass(frozen=True, eq=False)
class PiecewiseLaw(Frozen, PolynomialLaw):
    """Arc length as polynomials of time, continuous up to its second derivative.

    Attributes:
        curve: p(t), m, from t = 0; increasing.
        length: arc length at the end, m.
    """

    curve: BPoly
    length: float

    @property
    def duration(self) -> float:
        """Time at the end, s."""
        return float(self.curve.x[-1])

    @property
    def knots(self) -> Array:
        """(c,) times at which p's third derivative may jump, s."""
        return frozen(self.curve.x[1:-1])

    def scaled(self, factor: float) -> PiecewiseLaw:
        """Return the same law run ``factor`` times as fast."""
        return PiecewiseLaw(BPoly(self.curve.c, self.curve.x / positive(factor, "factor", "(ratio)")), self.length)


def uniform_law(length: float, duration: float) -> PiecewiseLaw:
    """Return p = length · t / duration: the law of a path that is a function of time itself."""
    return PiecewiseLaw(BPoly([[0.0], [length]], [0.0, duration]), length)


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
    least, _ = PiecewisePolynomial.from_bernstein(control[:, :, None], edges).derivative().ranges()
    return PiecewiseLaw(BPoly(control, edges), float(p[-1] - p[0])) if least.min() >= -1e-12 * v.max() else None
