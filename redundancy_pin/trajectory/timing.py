"""Polynomials from boundary conditions, and timing laws: arc length as a function of time, of one piece or of many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly, PchipInterpolator, PPoly

from redundancy_pin.arrays import ROUNDING, Array, Frozen, Side, assign, checked, frozen, inside, one_of, positive
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, first_times


def boundary_polynomial(
    t0: float, t1: float, start: Sequence[ArrayLike], end: Sequence[ArrayLike]
) -> PiecewisePolynomial:
    """Return the polynomial of least degree with given derivatives at both ends (Parsa 2014, eqs 1.5 and 1.9).

    Six conditions give a quintic, eight (with jerk) a septic; the two ends need not have equally many.

    Args:
        t0: start of the interval, s.
        t1: end of the interval, s, after t0.
        start: value, first, second, ... derivative at t0; each a scalar or all (k,), unit / s^order.
        end: the same at t1, of any length.

    Returns:
        A function of one piece with k values; one value for scalars.

    Raises:
        InputError: t1 is not after t0, no condition at all, different shapes, or values that are not finite.

    Example:
        >>> rp.trajectory.boundary_polynomial(0.0, 2.0, [0.0, 0.0], [1.0, 0.0])(1.0)
        array([0.5])
    """
    first, last = float(t0), float(t1)
    if not (np.isfinite(last - first) and last > first):
        raise InputError(f"The interval [{first:.9g}, {last:.9g}] s is empty.", remedy="Pass t0 < t1.", t0=t0, t1=t1)
    if len(start) + len(end) == 0:
        raise InputError("No boundary condition.", remedy="Pass at least one value at t0 or t1.")
    shapes = {np.shape(value) for value in (*start, *end)}
    if len(shapes) > 1:
        raise InputError(
            f"The boundary conditions have different shapes: {sorted(shapes)}.",
            remedy="Pass a scalar for each, or an array of one and the same length for each.",
        )
    conditions = [
        np.reshape([checked(np.ravel(y), f"{name}[{j}]", ("k",)) for j, y in enumerate(values)], (len(values), -1))
        if len(values)
        else np.zeros((0, int(np.prod(next(iter(shapes))))))
        for name, values in (("start", start), ("end", end))
    ]
    return PiecewisePolynomial.from_bernstein(BPoly.from_derivatives([first, last], conditions).c, [first, last])


def rest_to_rest_345(t0: float, t1: float, start: ArrayLike, end: ArrayLike) -> PiecewisePolynomial:
    """Return the 3-4-5 polynomial: at rest without acceleration at both ends (Parsa 2014, eq. 1.10).

    ``start`` and ``end`` are the values, scalar or (k,), at t0 and t1, s.

    Raises:
        InputError: as ``boundary_polynomial``.

    Example:
        >>> rp.trajectory.rest_to_rest_345(0.0, 1.0, [0.0], [1.0])(0.5)
        array([0.5])
    """
    return _rest_to_rest(t0, t1, start, end, zeros=2)


def rest_to_rest_4567(t0: float, t1: float, start: ArrayLike, end: ArrayLike) -> PiecewisePolynomial:
    """Return the 4-5-6-7 polynomial: at rest without acceleration or jerk at both ends; see ``rest_to_rest_345``.

    Example:
        >>> rp.trajectory.rest_to_rest_4567(0.0, 1.0, [0.0], [1.0])(0.5)
        array([0.5])
    """
    return _rest_to_rest(t0, t1, start, end, zeros=3)


def _rest_to_rest(t0: float, t1: float, start: ArrayLike, end: ArrayLike, zeros: int) -> PiecewisePolynomial:
    rest = [np.zeros(np.shape(start))] * zeros
    return boundary_polynomial(t0, t1, [start, *rest], [end, *rest])


class TimingPoint(NamedTuple):
    """A timing law at some times.

    Attributes:
        p: (...) arc length, m.
        pd: (...) speed, m/s.
        pdd: (...) tangential acceleration, m/s².
    """

    p: Array
    pd: Array
    pdd: Array


@dataclass(frozen=True, init=False, eq=False)
class TimingLaw(Frozen):
    """Arc length p(t) from p(0) = 0 to p(duration) = length, in polynomial pieces; p and ṗ are continuous.

    It is kept in Bernstein form, which meets values and rates at both ends of a piece exactly: at rest is at rest.

    Attributes:
        curve: p(t), m, as scipy's type; it does not decrease.
        length: arc length at the end, m.
        least_duration: of a law of ``fastest_law`` the least time, s, of laws whose acceleration may jump: no law under
            the same limits takes less; None of others.
    """

    curve: BPoly = field(repr=False)
    length: float
    least_duration: float | None

    def __init__(self, curve: BPoly, length: float, least_duration: float | None = None) -> None:
        assign(self, curve=curve, length=length, least_duration=least_duration)

    @staticmethod
    def of(curve: PiecewisePolynomial, length: float) -> TimingLaw:
        """Return the law of a function of time with a single value, p(t), m."""
        return TimingLaw(BPoly.from_power_basis(PPoly(curve.coefficients[:, :, 0], curve.edges)), length)

    @property
    def duration(self) -> float:
        """Time at the end, s."""
        return float(self.curve.x[-1])

    @property
    def knots(self) -> Array:
        """(c,) inner times at which pieces meet and a higher derivative may jump, s."""
        return frozen(self.curve.x[1:-1])

    def evaluate(self, t: ArrayLike, side: Side = "right") -> TimingPoint:
        """Return p, ṗ, p̈ at times t (scalar or any shape, s); ``side`` decides where p̈ jumps.

        Raises:
            InputError: t outside [0, duration], or another side.
        """
        one_of(side, "side", ("left", "right"))
        times = inside(t, 0.0, self.duration, "t", "s")
        if side == "left":  # the float before an edge is in the piece before it
            times = np.nextafter(times, 0.0)
        p, pd, pdd = (np.asarray(self.curve(times, order)) for order in range(3))
        return TimingPoint(np.clip(p, 0.0, self.length), pd, pdd)

    def time_at(self, p: float) -> float:
        """Return the time, s, at which arc length p, m, is reached.

        Raises:
            InputError: p outside [0, length].
        """
        return float(first_times(self.curve, inside(p, 0.0, self.length, "p", "m")))

    def scaled(self, factor: float) -> TimingLaw:
        """Return the same law run ``factor`` times as fast: p(factor · t).

        Raises:
            InputError: factor not positive.
        """
        return TimingLaw(BPoly(self.curve.c, self.curve.x / positive(factor, "factor", "(ratio)")), self.length)


@dataclass(frozen=True, init=False, eq=False)
class RestToRest(TimingLaw):
    """A single polynomial from rest to rest over the whole length.

    Attributes:
        length: arc length, m.
        duration: s.
        shape: "3-4-5" (Parsa 2014, eq. 1.10) or "4-5-6-7" (no jerk at the ends either).

    Raises:
        InputError: length or duration not positive, unknown shape.

    Example:
        >>> rp.trajectory.RestToRest(0.5, duration=2.0).duration
        2.0
    """

    shape: Literal["3-4-5", "4-5-6-7"]

    def __init__(self, length: float, duration: float, shape: Literal["3-4-5", "4-5-6-7"] = "3-4-5") -> None:
        zeros = {"3-4-5": [0.0] * 2, "4-5-6-7": [0.0] * 3}
        if shape not in zeros:
            raise InputError(f"shape is {shape!r}, expected '3-4-5' or '4-5-6-7'.", shape=shape)
        total, end = positive(length, "length", "m"), positive(duration, "duration", "s")
        curve = BPoly.from_derivatives([0.0, end], [[0.0, *zeros[shape]], [total, *zeros[shape]]])
        super().__init__(curve, total)
        assign(self, shape=shape)

    def scaled(self, factor: float) -> RestToRest:
        """Return the same law run ``factor`` times as fast; see ``TimingLaw.scaled``."""
        return RestToRest(self.length, self.duration / positive(factor, "factor", "(ratio)"), self.shape)


LEAST_RAMP_FRACTION = 0.4
"""A quintic ramp shorter than this fraction of v T runs backwards; see ``SpeedProfile``."""


@dataclass(frozen=True, init=False, eq=False)
class SpeedProfile(TimingLaw):
    """Ramp up, cruise, ramp down (Parsa 2014, sections 3.2 and 4.2.2).

    The ramp up is the quintic in arc length from (0, 0, 0) to (ℓ, v, 0) in time T, the ramp down its mirror image.
    With κ = t/T and λ = ℓ/(v T),

        ṗ / v = κ² [30 λ (1 − κ)² − 12 + 28 κ − 15 κ²]

    is never negative if and only if λ ≥ 0.4 (the bracket at κ = 0). It rises all the way for 0.4 ≤ λ ≤ 0.6; a longer
    ramp overshoots the cruising speed, see ``peak_speed``. λ = 1/2, the default, leaves ṗ/v = 3κ² − 2κ³, symmetric
    about half speed at half time.

    Attributes:
        length: arc length of the whole path, m.
        speed: cruising speed v, m/s.
        ramp_time: duration T of the ramp up, s.
        ramp_length: arc length ℓ of the ramp up, m; v T / 2 when left out.
        end_ramp_time: duration of the ramp down, s; as the ramp up when left out.
        end_ramp_length: arc length of the ramp down, m. When left out: as the ramp up if the times are
            equal, else half of speed times end_ramp_time.

    Raises:
        InputError: a value that is not positive, a ramp length that would run backwards (with the admissible
            range), or a path too short for both ramps (with the lengths).

    Example:
        >>> rp.trajectory.SpeedProfile(0.5, 0.2, 0.1).duration
        2.6
    """

    speed: float
    ramp_time: float
    ramp_length: float
    end_ramp_time: float
    end_ramp_length: float

    def __init__(
        self,
        length: float,
        speed: float,
        ramp_time: float,
        ramp_length: float | None = None,
        end_ramp_time: float | None = None,
        end_ramp_length: float | None = None,
    ) -> None:
        total = positive(length, "length", "m")
        v = positive(speed, "speed", "m/s")
        time_up = positive(ramp_time, "ramp_time", "s")
        up = 0.5 * v * time_up if ramp_length is None else positive(ramp_length, "ramp_length", "m")
        time_down = time_up if end_ramp_time is None else positive(end_ramp_time, "end_ramp_time", "s")
        if end_ramp_length is not None:
            down = positive(end_ramp_length, "end_ramp_length", "m")
        else:
            down = up if time_down == time_up else 0.5 * v * time_down
        _require_forward("ramp_length", up, v, time_up, total)
        _require_forward("end_ramp_length", down, v, time_down, total)
        if up + down > total * (1.0 + ROUNDING):
            message = (
                f"The path is too short: it is {total:.6g} m long, and reaching {v:g} m/s takes {up:.6g} m, "
                f"stopping {down:.6g} m."
            )
            remedy = "Lower the speed, shorten the ramps, or lengthen the path."
            raise InputError(message, remedy=remedy, length=total, ramp_length=up, end_ramp_length=down)
        assign(self, speed=v, ramp_time=time_up, ramp_length=up, end_ramp_time=time_down, end_ramp_length=down)
        ends = np.cumsum([0.0, time_up, max(total - up - down, 0.0) / v, time_down])
        states = np.array([(0.0, 0.0, 0.0), (up, v, 0.0), (total - down, v, 0.0), (total, 0.0, 0.0)])
        kept = [0, 1, 2, 3] if ends[2] > ends[1] else [0, 1, 3]
        super().__init__(BPoly.from_derivatives(ends[kept], states[kept]), total)

    @property
    def cruise_time(self) -> float:
        """Duration at constant speed, s."""
        return max(self.length - self.ramp_length - self.end_ramp_length, 0.0) / self.speed

    @property
    def peak_speed(self) -> float:
        """Largest speed, m/s: the cruising speed unless a ramp overshoots it (λ > 0.6).

        p̈ ∝ κ (1 − κ) [(60 λ − 24) − (120 λ − 60) κ], whose last root is the peak.
        """
        up = _peak(self.ramp_length / (self.speed * self.ramp_time))
        return max(up, _peak(self.end_ramp_length / (self.speed * self.end_ramp_time))) * self.speed

    def scaled(self, factor: float) -> SpeedProfile:
        """Return the same law run ``factor`` times as fast; see ``TimingLaw.scaled``."""
        f = positive(factor, "factor", "(ratio)")
        up, down = self.ramp_time / f, self.end_ramp_time / f
        return SpeedProfile(self.length, f * self.speed, up, self.ramp_length, down, self.end_ramp_length)

    def evaluate(self, t: ArrayLike, side: Side = "right") -> TimingPoint:
        """Return p, ṗ, p̈ at times t; see ``TimingLaw.evaluate``. While it cruises nothing accelerates, exactly."""
        ramps, times = super().evaluate(t, side), np.asarray(t, dtype=np.float64)
        cruises = (times >= self.ramp_time) & (times <= self.ramp_time + self.cruise_time)
        p = self.ramp_length + self.speed * (times - self.ramp_time)
        exact = p, np.full(times.shape, self.speed), np.zeros(times.shape)
        return TimingPoint(*(np.where(cruises, one, other) for one, other in zip(exact, ramps, strict=True)))


def _peak(fraction: float) -> float:
    """Return the largest ṗ/v of a ramp of length ``fraction`` · v T."""
    if fraction <= 1.5 * LEAST_RAMP_FRACTION:
        return 1.0
    k = (60.0 * fraction - 24.0) / (120.0 * fraction - 60.0)
    return float(k**2 * (30.0 * fraction * (1.0 - k) ** 2 - 12.0 + 28.0 * k - 15.0 * k**2))


def _require_forward(name: str, ramp: float, speed: float, time: float, length: float) -> None:
    least = LEAST_RAMP_FRACTION * speed * time
    if ramp < least * (1.0 - ROUNDING):
        message = f"{name} = {ramp:.6g} m is too short: the ramp to {speed:g} m/s in {time:g} s would start backwards."
        remedy = (
            f"Admissible is {least:.6g} m (0.4 v T) to {length:.6g} m (the path); up to "
            f"{1.5 * least:.6g} m (0.6 v T) it does not overshoot the speed."
        )
        raise InputError(message, remedy=remedy, name=name, least=least, most=length)


def uniform_law(length: float, duration: float) -> TimingLaw:
    """Return p = length · t / duration: the law of a path that is a function of time itself."""
    return TimingLaw(BPoly([[0.0], [length]], [0.0, duration]), length)


def law_through_speeds(lengths: ArrayLike, speeds: ArrayLike) -> TimingLaw:
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


def _law(p: Array, v: Array, a: Array) -> TimingLaw | None:
    """Return the law with speeds and accelerations (N,) at arc lengths; None if it would run backwards."""
    mean, bend, length = 0.5 * (v[1:] + v[:-1]), (a[:-1] - a[1:]) / 12.0, np.diff(p)
    inner = mean**2 + 4.0 * bend * length
    if (inner < 0.0).any():
        return None
    T = 2.0 * length / (mean + np.sqrt(inner))  # the root that is there without accelerations too
    edges = np.concatenate([[0.0], np.cumsum(T)])
    speed = np.stack([v[:-1], v[:-1] + T * a[:-1] / 3.0, v[1:] - T * a[1:] / 3.0, v[1:]])  # Bernstein
    control = np.concatenate([np.zeros((1, len(T))), np.cumsum(speed, axis=0)]) * T / 4.0 + p[:-1] - p[0]
    least, _ = PiecewisePolynomial.from_bernstein(control[:, :, None], edges).derivative().ranges()
    return TimingLaw(BPoly(control, edges), float(p[-1] - p[0])) if least.min() >= -1e-12 * v.max() else None
