"""The two functions of time: a piecewise polynomial with any number of values, and the motion of the platform.

Polynomials are scipy's ``PPoly``: on each piece powers of the time since its left end. They come from values at
Chebyshev points by way of Chebyshev coefficients, which are small where a smooth function is resolved, so that the
powers are as accurate as the Chebyshev series itself: values to 1e-15, first and second derivatives digit for digit the
same (degree 15, measured; a tail of 1e-6 costs 1e-10). Bernstein coefficients are no better there, all as large as the
function, and eighteen times slower to evaluate.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import comb
from typing import Protocol, TypeGuard

import numpy as np
from numpy.polynomial import Chebyshev, Legendre, Polynomial, chebyshev
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, Side, frozen, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.rotation_vector import angular_rates, vector_rates
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_consistent, require_sampled

DEGREE = 15
"""Of the pieces of a fit. Smooth motions of a second then need a few dozen pieces for twelve digits."""

LEAST_WIDTH = 1e-7
"""Pieces narrower than this fraction of the interval are not divided: only an undeclared kink gets there, and an error
over so short a time has no consequence."""

MOST_PIECES = 20_000
"""Past this the function is noise at the tolerance asked for, and what has been reached is kept."""

SHIFT = 1e-13
"""m; a position off by less is not shifted to be continuous."""

JUMP = 1e-6
"""Difference at the end of a piece, relative to the largest value, from which a function jumps there."""

STANDS_OUT = 1e-6
"""A peak counts if it exceeds both ends by this fraction; less is no peak worth a sample."""

LEAST_KNOT_DISTANCE = 1e-4
"""Of the knots of a path, as a fraction of the duration: towards a cusp they come closer and closer."""

DENSE = 1e-9
"""Rounding of the accelerations of the quintic, relative to the largest, from which samples count as dense: at 0.4 m
and 1 m/s² about 2 ms apart."""

MOST_TURN = 3.0
"""Between two samples of a pose, rad: at half a turn its sense is not determined."""

PLATFORM_TOLERANCE = 1e-12
"""Of the polynomials that stand for a trajectory in a file, relative to the largest x, ẋ and ẍ."""


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial(Frozen):
    """A function from time to C numbers that is a polynomial on each of P pieces.

    Outside the pieces it has the values at their ends.

    Attributes:
        edges: (P + 1,) ends of the pieces, s.
        coefficients: (D + 1, P, C) of the powers of the time since the left end, the highest first, as in ``PPoly``.
    """

    edges: Array
    coefficients: Array

    @property
    def start(self) -> float:
        """First time, s."""
        return float(self.edges[0])

    @property
    def end(self) -> float:
        """Last time, s."""
        return float(self.edges[-1])

    @cached_property
    def ppoly(self) -> PPoly:
        """The same as scipy's type."""
        return PPoly.construct_fast(self.coefficients, self.edges)

    def __call__(self, t: ArrayLike, side: Side = "right") -> Array:
        """Return the values (N, C) at (N,) times, s; ``side`` decides at the edge of two pieces."""
        times = np.asarray(t, dtype=np.float64)
        if side == "left":  # PPoly is continuous from the right: the float before an edge is in the piece before it
            with np.errstate(under="ignore"):  # beside zero it is the smallest number there is
                times = np.nextafter(times, -np.inf)
        # not clip: NaN in place of extrapolation would be as slow
        values: Array = self.ppoly(np.minimum(np.maximum(times, self.edges[0]), self.edges[-1]))
        return values

    @cached_property
    def _by_piece(self) -> tuple[list[float], list[float], list[Array], Array]:
        """Left ends, right ends, (D + 1, C) coefficients of each piece, and exponents."""
        each = [np.ascontiguousarray(piece) for piece in np.swapaxes(self.coefficients, 0, 1)]
        edges = self.edges.tolist()
        return edges[:-1], edges[1:], each, np.arange(len(self.coefficients) - 1.0, -1.0, -1.0)

    def at(self, t: float) -> Array:
        """Return the values (C,) at one time, s, in a few microseconds: a third of what ``PPoly`` takes."""
        left, right, pieces, exponents = self._by_piece
        i = max(bisect_right(left, t) - 1, 0)
        return (min(max(t, left[i]), right[i]) - left[i]) ** exponents @ pieces[i]

    def derivative(self, order: int = 1) -> PiecewisePolynomial:
        """Return the derivative of an order, unit of the values / s^order."""
        if order == 0:
            return self
        return PiecewisePolynomial(self.edges, read_only(self.ppoly.derivative(order).c))

    def beside(self, other: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return a function on the same pieces with the values of this one and then those of the other."""
        parts = _padded([self.coefficients, other.coefficients])
        return PiecewisePolynomial(self.edges, read_only(np.concatenate(parts, axis=2)))

    def jumps(self) -> Array:
        """Return the inner edges, s, at which a value jumps."""
        inner = self.edges[1:-1]
        before, after = self(inner, "left"), self(inner)
        apart = np.abs(after - before) > JUMP * np.abs(before).max(axis=0, initial=0.0)
        result: Array = inner[apart.any(axis=1)]
        return result

    def extremes(self) -> Array:
        """Return the inner times, s, at which some value has a local extreme inside a piece."""
        return np.unique(np.concatenate([np.empty(0), *self._stationary()]))

    def peaks(self) -> Array:
        """Return the inner times, s, at which some value is largest or smallest, if it is so inside only."""
        peaks = []
        for column, stationary in enumerate(self._stationary()):
            times = np.concatenate([self.edges[[0, -1]], stationary])
            value = self(times)[:, column]
            for signed in (value, -value):
                best = int(signed.argmax())
                if signed[best] > signed[:2].max() + STANDS_OUT * np.abs(value).max():
                    peaks.append(times[best])
        return np.unique(peaks)

    def ranges(self) -> tuple[Array, Array]:
        """Return the least and the largest values (P, C) on each piece, both ends included."""
        ends = np.stack([self(self.edges[:-1]), self(self.edges[1:], "left")])
        least, most = ends.min(axis=0), ends.max(axis=0)
        for column, times in enumerate(self._stationary()):
            # a carrier that comes to rest does so at the very end, which is in the last piece
            piece = np.minimum(np.searchsorted(self.edges, times, side="right"), len(self.edges) - 1) - 1
            value = self(times)[:, column]
            np.minimum.at(least[:, column], piece, value)
            np.maximum.at(most[:, column], piece, value)
        return least, most

    def _stationary(self) -> list[Array]:
        """Return, for each of the C values, the times inside the interval at which its rate is zero, s."""
        roots = np.atleast_1d(self.ppoly.derivative().roots(discontinuity=False, extrapolate=False))
        # scipy reports a piece that stands still as its left end and NaN
        return [np.asarray(times)[np.isfinite(np.asarray(times, dtype=float))] for times in roots]

    def until(self, end: float) -> PiecewisePolynomial:
        """Return the function up to a time, s, inside the pieces."""
        last = int(np.searchsorted(self.edges, end, side="left"))
        edges = np.append(self.edges[:last], min(end, self.end))
        return PiecewisePolynomial(read_only(edges), self.coefficients[:, : len(edges) - 1])

    @staticmethod
    def constant(value: Array, start: float, end: float) -> PiecewisePolynomial:
        """Return the values (C,) from one time to another, s."""
        return PiecewisePolynomial(frozen([start, end]), frozen(value)[None, None])

    @staticmethod
    def from_bernstein(control: Array, edges: ArrayLike) -> PiecewisePolynomial:
        """Return the polynomials of (D + 1, P, C) Bernstein coefficients on P pieces between (P + 1,) edges, s."""
        fixed = frozen(edges)
        # differences from the first value before the rest: they are exact where the polynomial hardly moves
        powers = np.tensordot(_from_bernstein(len(control) - 1), control - control[0], axes=1)
        powers[0] = control[0]
        width = np.diff(fixed) ** np.arange(len(powers))[:, None]
        return PiecewisePolynomial(fixed, read_only((powers / width[:, :, None])[::-1].copy()))

    @staticmethod
    def hermite(edges: ArrayLike, start: tuple[Array, ...], end: tuple[Array, ...]) -> PiecewisePolynomial:
        """Return the quintics with given values and first and second derivatives at both ends of every piece.

        ``edges`` (P + 1,) ends of the pieces, s; ``start``: three (P, C) values, rates and second derivatives where the
        pieces begin; ``end``: the same where they end; it need not be where the next one begins.
        """
        h = np.diff(np.asarray(edges))[:, None]
        (x0, v0, a0), (x1, v1, a1) = start, end
        control = (
            x0,
            x0 + h * v0 / 5.0,
            x0 + 2.0 * h * v0 / 5.0 + h * h * a0 / 20.0,
            x1 - 2.0 * h * v1 / 5.0 + h * h * a1 / 20.0,
            x1 - h * v1 / 5.0,
            x1,
        )
        return PiecewisePolynomial.from_bernstein(np.stack(control), edges)

    @staticmethod
    def linear(t: Array, values: Array) -> PiecewisePolynomial:
        """Return what is linear between (M, C) values at (M,) times, s; a time that occurs twice has two values."""
        left = np.flatnonzero(np.diff(t) > 0.0)
        slope = (values[left + 1] - values[left]) / np.diff(t)[left, None]
        return PiecewisePolynomial(frozen(np.append(t[left], t[-1])), read_only(np.stack([slope, values[left]])))

    @staticmethod
    def linear_acceleration(t: Array, s: Array, sd: Array, sdd: Array) -> PiecewisePolynomial:
        """Return the cubics with s̈ linear between (M,) nodes; a time that occurs twice has two accelerations.

        ``t`` (M,) times, s; ``s`` (M, C) values at the nodes; those at the end of a step are not looked at; ``sd`` (M,
        C) their rates; the same; ``sdd`` (M, C) their second derivatives.
        """
        left = np.flatnonzero(np.diff(t) > 0.0)
        jerk = (sdd[left + 1] - sdd[left]) / np.diff(t)[left, None]
        powers = np.stack([jerk / 6.0, 0.5 * sdd[left], sd[left], s[left]])
        return PiecewisePolynomial(frozen(np.append(t[left], t[-1])), read_only(powers))

    @staticmethod
    def constant_acceleration(t: Array, s: Array, sd: Array, sdd: Array) -> PiecewisePolynomial:
        """Return the parabolas of steps whose s̈ is that at their end, from s and ṡ where they begin.

        ``t`` (M,) increasing times, s; ``s`` (M, C) values; from backward differences, the parabola ends short of that
        at the end of its step; ``sd`` (M, C) their rates; ``sdd`` (M, C) their second derivatives.
        """
        powers = np.stack([0.5 * sdd[1:], sd[:-1], s[:-1]])
        return PiecewisePolynomial(frozen(t), read_only(powers))

    @staticmethod
    def joined(parts: Sequence[PiecewisePolynomial]) -> PiecewisePolynomial:
        """Return functions as one, each beginning where the one before it ends."""
        padded = _padded([part.coefficients for part in parts])
        edges = np.concatenate([parts[0].edges, *(part.edges[1:] for part in parts[1:])])
        return PiecewisePolynomial(read_only(edges), read_only(np.concatenate(padded, axis=1)))

    def made_continuous(self) -> PiecewisePolynomial:
        """Return the function with its pieces shifted so that each begins with the value the one before it ends with.

        What differs by rounding only is left as it is.
        """
        inner = self.edges[1:-1]
        gaps = np.cumsum(self(inner, "left") - self(inner), axis=0)
        gaps[np.abs(gaps) < SHIFT] = 0.0
        coefficients = self.coefficients.copy()
        coefficients[-1, 1:] += gaps
        return PiecewisePolynomial(self.edges, read_only(coefficients))

    @staticmethod
    def from_values(edges: Array, values: Array) -> PiecewisePolynomial:
        """Return the polynomials of degree D through (P, D + 1, C) values at the times of ``chebyshev_times``."""
        return PiecewisePolynomial.from_series(edges, chebyshev_series(values))

    @staticmethod
    def from_series(
        edges: Array, series: Array, basis: type[Chebyshev] | type[Legendre] = Chebyshev
    ) -> PiecewisePolynomial:
        """Return the polynomials of (P, D + 1, C) coefficients of a basis over x = −1 … 1 on each piece."""
        powers = np.einsum("dj,pjc->dpc", _to_powers(basis, series.shape[1] - 1), series)
        width = np.diff(edges) ** np.arange(len(powers))[:, None]
        return PiecewisePolynomial(read_only(np.array(edges)), read_only((powers / width[:, :, None])[::-1].copy()))

    @staticmethod
    def fit(
        function: Callable[[Array], Array],
        edges: Array,
        knots: Array,
        scale: Callable[[Array], Array],
        tolerance: float,
    ) -> PiecewisePolynomial:
        """Interpolate a function, dividing the pieces until their last Chebyshev coefficients fall below a tolerance.

        ``function``: from (N,) strictly increasing times inside the pieces to (N, C) values; ``edges`` (P + 1,) ends of
        the first pieces, s: the ends of the interval and every known jump in between; ``knots`` (c,) times at which
        pieces are preferably divided, s; ``scale``: from (N, C) values of the first pieces to the (C,) sizes that the
        tolerance is a fraction of; ``tolerance``: largest allowed last coefficients, as a fraction of the scale.
        """
        left, right = edges[:-1], edges[1:]
        least = LEAST_WIDTH * (edges[-1] - edges[0])
        starts: list[Array] = []
        pieces: list[Array] = []
        size: Array | None = None
        while len(left):
            values = function(chebyshev_points(left, right, DEGREE))
            size = scale(values) if size is None else size
            series = chebyshev_series(values.reshape(len(left), DEGREE + 1, -1))
            tail = (np.abs(series[:, -3:]).max(axis=1) / size).max(axis=1)
            count = sum(map(len, starts)) + len(left)
            divide = (tail > tolerance) & (right - left > least) & (count < MOST_PIECES)
            starts.append(left[~divide])
            pieces.append(series[~divide])
            middle = np.array([preferred_middle(a, b, knots) for a, b in zip(left[divide], right[divide], strict=True)])
            left, right = (
                np.sort(np.concatenate([left[divide], middle])),
                np.sort(np.concatenate([middle, right[divide]])),
            )
        begins = np.concatenate(starts)
        order = np.argsort(begins)
        return PiecewisePolynomial.from_series(np.append(begins[order], edges[-1]), np.concatenate(pieces)[order])


def carriers_at(position: PiecewisePolynomial, times: ArrayLike, side: Side = "right") -> CarrierMotion:
    """Return the motion of carriers whose positions (k,) are a function of time, at (N,) times, s."""
    return CarrierMotion(*(position.derivative(order)(times, side) for order in range(3)), check_rates=False)


def chebyshev_times(edges: Array, degree: int = DEGREE) -> Array:
    """Return (P (D + 1),) times, s, at which values determine a polynomial of degree D on each of P pieces."""
    return chebyshev_points(edges[:-1], edges[1:], degree)


def chebyshev_points(left: Array, right: Array, degree: int) -> Array:
    """Return ``chebyshev_times`` of P pieces, however they lie, from their (P,) left and right ends, s."""
    nodes = np.sort(chebyshev.chebpts1(degree + 1))
    return (0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * nodes).ravel()


def chebyshev_series(values: Array) -> Array:
    """Return (P, D + 1, C) Chebyshev coefficients of the values at the times of ``chebyshev_times``."""
    series: Array = np.einsum("dn,pnc->pdc", _to_series(values.shape[1] - 1), values)
    return series


def preferred_middle(left: float, right: float, knots: Array) -> float:
    """Return where to divide an interval: the knot nearest to its middle, or the middle if there is none inside."""
    middle = 0.5 * (left + right)
    slack = 1e-3 * (right - left)
    inside = knots[np.searchsorted(knots, left + slack) : np.searchsorted(knots, right - slack)]
    return float(inside[np.abs(inside - middle).argmin()]) if len(inside) else middle


class TimedTrajectory(Protocol):
    """What a planner needs of a trajectory."""

    @property
    def duration(self) -> float:
        """Total time, s."""

    @property
    def breaks(self) -> Array:
        """(b,) times at which the acceleration jumps, s."""

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at (N,) increasing times; a break that occurs twice gets both accelerations."""


def is_timed(motion: object) -> TypeGuard[TimedTrajectory]:
    """Return whether a motion can be evaluated at any time, rather than being samples."""
    return all(hasattr(motion, name) for name in ("duration", "breaks", "sample_at"))


@dataclass(frozen=True, eq=False)
class ContinuousMotion(Frozen):
    """A platform motion over an interval, from a trajectory or from polynomials.

    Attributes:
        source: the trajectory, or polynomials with the values x (n, or 16 of a pose, row by row), ẋ and ẍ (n each).
        start, end: first and last time, s.
        moves_until: time from which on the platform is held where it is then, s; the end but where carriers move on.
        breaks: (b,) inner times at which the acceleration jumps, s.
        knots: (c,) inner times at which a higher derivative jumps, s, as far as they are known.
        exact: whether it is smooth between breaks and knots to rounding; not so a sampled motion.
    """

    source: TimedTrajectory | PiecewisePolynomial
    start: float
    end: float
    moves_until: float
    breaks: Array
    knots: Array
    exact: bool

    @property
    def kinks(self) -> Array:
        """(e,) both ends and, in order, where it is not smooth in between as far as that is known, s."""
        inner = np.concatenate([self.breaks, self.knots]) if self.exact else self.breaks
        return np.unique(np.concatenate([[self.start], inner, [self.end]]))

    def sample_at(self, times: Array) -> PlatformMotion:
        """Return the motion at (N,) increasing times, s.

        A break that occurs twice gets the acceleration before and after the jump, a single one that after it.
        """
        before = np.append(times[1:] == times[:-1], False)
        if self.moves_until == self.end:
            return self._moving(times, before)
        moving = (times < self.moves_until) | (before & (times == self.moves_until))
        # a motion has samples: that of the last instant is repeated where the platform is held
        there = self._moving(np.append(times[moving], self.moves_until), np.append(before[moving], False))
        x, still = np.asarray(there.x), np.zeros((int((~moving).sum()), there.xd.shape[1]))
        return PlatformMotion(
            times,
            np.concatenate([x[:-1], np.repeat(x[-1:], len(still), axis=0)]),
            np.concatenate([there.xd[:-1], still]),
            np.concatenate([there.xdd[:-1], still]),
            check_rates=False,
        )

    def _moving(self, times: Array, before: BoolArray) -> PlatformMotion:
        if not isinstance(self.source, PiecewisePolynomial):
            return self.source.sample_at(times)
        values = self.source(times)
        n, is_pose = _coordinates(values.shape[1])
        x, xd, xdd = values[:, : -2 * n], values[:, -2 * n : -n], values[:, -n:]
        xdd[before] = self.source(times[before], "left")[:, -n:]
        return PlatformMotion(times, x.reshape(-1, 4, 4) if is_pose else x, xd, xdd, check_rates=False)

    def prolonged_until(self, end: float) -> ContinuousMotion:
        """Return the motion with the platform held where it is at the end, until a later time, s."""
        if not end > self.end:
            return self
        return replace(self, end=end, breaks=frozen(np.append(self.breaks, self.end)))

    @cached_property
    def polynomials(self) -> PiecewisePolynomial:
        """x, ẋ and ẍ side by side, without the time in which the platform is held; those of a trajectory are fitted."""
        if isinstance(self.source, PiecewisePolynomial):
            return self.source
        trajectory = self.source
        inner = self.breaks[self.breaks < self.moves_until]
        edges = np.unique(np.concatenate([[self.start], inner, self.knots, [self.moves_until]]))

        def values(times: Array) -> Array:
            motion = trajectory.sample_at(times)
            return np.concatenate([motion.x.reshape(len(times), -1), motion.xd, motion.xdd], axis=1)

        def scale(values: Array) -> Array:
            n, _ = _coordinates(values.shape[1])
            sizes = [np.full(part.shape[1], np.abs(part).max()) for part in np.split(values, [-2 * n, -n], axis=1)]
            largest: Array = np.maximum(np.concatenate(sizes), np.finfo(float).tiny)
            return largest

        return PiecewisePolynomial.fit(values, edges, self.knots, scale, PLATFORM_TOLERANCE)


def continuous_motion(motion: PlatformMotion | TimedTrajectory) -> ContinuousMotion:
    """Return a trajectory or a sampled motion as a function of time.

    A trajectory is asked for its own exact motion. Between the samples of a motion stands the quintic that matches
    x, ẋ, ẍ at both ends; its acceleration is off by O(Δt⁴). Where samples are so dense that the rounding of x shows in
    it, velocity and acceleration are those of the cubic that matches ẋ and ẍ, off by O(Δt³). Of poses these are
    polynomials of the origin and of the rotation vector from the left sample.

    Raises:
        InputError: samples that are no motion (``require_consistent``), or of a single instant.
    """
    if isinstance(motion, PlatformMotion):
        require_consistent(motion)
        return _from_samples(motion)
    if not is_timed(motion):
        require_sampled(motion)
    end = float(motion.duration)
    inner = [float(t) for t in motion.breaks if 0.0 < t < end]
    knots = [t for t in _knots(motion) if 0.0 < t < end]
    return ContinuousMotion(motion, 0.0, end, end, frozen(inner), frozen(knots), True)


def _knots(motion: TimedTrajectory) -> list[float]:
    """Return the times, s, at which the jerk jumps, and those beside a cusp of the path, where little is smooth."""
    timing, lengths = getattr(motion, "timing", None), getattr(getattr(motion, "path", None), "knots", ())
    ramps = getattr(timing, "knots", ())
    along = np.array([timing.time_at(float(p)) for p in lengths]) if timing is not None else np.empty(0)
    if len(along):
        apart = np.diff(along, prepend=0.0) > LEAST_KNOT_DISTANCE * motion.duration
        along = along[apart]
    return sorted({*map(float, ramps), *along.tolist()})


def _from_samples(motion: PlatformMotion) -> ContinuousMotion:
    left = np.flatnonzero(np.diff(motion.t) > 0.0)
    if len(left) == 0:
        raise InputError("The motion has a single instant.", remedy="Pass at least two samples.")
    right = left + 1
    edges = np.append(motion.t[left], motion.t[-1])
    h = np.diff(edges)[:, None]
    if motion.is_pose:
        start, end = _local_ends(motion, left, right)
    else:
        start, end = ((motion.x[at], motion.xd[at], motion.xdd[at]) for at in (left, right))
    position = PiecewisePolynomial.hermite(edges, start, end)
    velocity = position.derivative()
    acceleration = velocity.derivative()
    # second differences of positions that are rounded themselves, over h²; 60 is the factor of the quintic
    rounding = 60.0 * np.finfo(float).eps * np.abs(motion.x).max() / np.median(h) ** 2
    # of the motion, not of its samples: between two at rest there may be one
    largest = max(np.abs(motion.xdd).max(), np.abs(position.derivative(2).ranges()).max())
    if rounding > DENSE * largest:
        (_, v0, a0), (_, v1, a1) = start, end
        cubic = np.stack([v0, v0 + h * a0 / 3.0, v1 - h * a1 / 3.0, v1])
        velocity = PiecewisePolynomial.from_bernstein(cubic, edges)
        acceleration = velocity.derivative()
    polynomials = position.beside(velocity).beside(acceleration)
    breaks = frozen(motion.t[motion.jumps])
    knots = frozen(np.setdiff1d(edges[1:-1], breaks))
    source = _PosesBetween(polynomials, breaks, motion.x[left, :3, :3]) if motion.is_pose else polynomials
    return ContinuousMotion(source, float(edges[0]), float(edges[-1]), float(edges[-1]), breaks, knots, False)


def _local_ends(motion: PlatformMotion, left: IntArray, right: IntArray) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Return origin and rotation vector from the left sample (P, 6), and two derivatives, at both ends of each piece.

    Raises:
        InputError: samples half a turn apart, or a pose without six rates.
    """
    if motion.xd.shape[1] != 6:
        raise InputError(
            f"The poses have {motion.xd.shape[1]} rates: nothing says how the origin moves between the samples.",
            remedy="Pass a trajectory.",
        )
    p, R = motion.x[:, :3, 3], motion.x[:, :3, :3]
    turn = Rotation.from_matrix(R[right] @ R[left].transpose(0, 2, 1)).as_rotvec()
    angle = np.linalg.norm(turn, axis=1)
    if angle.max() > MOST_TURN:
        k = int(left[angle.argmax()])
        raise InputError(
            f"The platform turns by {angle.max():.4g} rad between its samples at {motion.t[k]:.6g} and "
            f"{motion.t[k + 1]:.6g} s: nothing says which way round.",
            remedy="Sample the motion more densely.",
            time=float(motion.t[k]),
        )

    def ends(at: IntArray, origin: Array, phi: Array) -> tuple[Array, ...]:
        twist, rate = motion.xd[at], motion.xdd[at]
        turning = (phi, *vector_rates(phi, twist[:, 3:], rate[:, 3:]))
        moving = (origin, twist[:, :3], rate[:, :3])
        return tuple(np.concatenate(pair, axis=1) for pair in zip(moving, turning, strict=True))

    return ends(left, p[left], np.zeros_like(turn)), ends(right, p[right], turn)


@dataclass(frozen=True, eq=False)
class _PosesBetween(Frozen):
    """A motion of poses between samples: origin and rotation vector from the left sample as polynomials.

    Attributes:
        local: on each of P pieces origin and rotation vector, m and rad, their rates and second derivatives (18).
        breaks: (b,) times at which the acceleration jumps, s.
        rotations: (P, 3, 3) of the samples that the pieces begin with.
    """

    local: PiecewisePolynomial
    breaks: Array
    rotations: Array

    @property
    def duration(self) -> float:
        """Last time, s."""
        return self.local.end

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at (N,) increasing times, s; a break that occurs twice gets both accelerations."""
        t = np.asarray(times, dtype=np.float64)
        values, before = self.local(t), np.append(t[1:] == t[:-1], False)
        piece = np.clip(np.searchsorted(self.local.edges, t, side="right") - 1, 0, len(self.rotations) - 1)
        # the piece before a jump ends there
        values[before], piece[before] = self.local(t[before], "left"), np.maximum(piece[before] - 1, 0)
        (p, phi), (v, phid), (a, phidd) = (np.split(part, 2, axis=1) for part in np.split(values, 3, axis=1))
        omega, alpha = angular_rates(phi, phid, phidd)
        x = np.tile(np.eye(4), (len(t), 1, 1))
        x[:, :3, :3] = Rotation.from_rotvec(phi).as_matrix() @ self.rotations[piece]
        x[:, :3, 3] = p
        xd, xdd = np.concatenate([v, omega], axis=1), np.concatenate([a, alpha], axis=1)
        x[before], xd[before] = x[1:][before[:-1]], xd[1:][before[:-1]]  # bit for bit: it is one state
        return PlatformMotion(t, x, xd, xdd)


def _padded(coefficients: list[Array]) -> list[Array]:
    """Return coefficients (D + 1, P, C) with as many powers as the longest."""
    most = max(map(len, coefficients))
    return [np.pad(part, ((most - len(part), 0), (0, 0), (0, 0))) for part in coefficients]


def _coordinates(columns: int) -> tuple[int, bool]:
    """Return the number n of coordinates of x, ẋ, ẍ side by side, and whether x is a pose: 16 + 2 · 6 numbers.

    Three times n is never 28.
    """
    return (6, True) if columns == 28 else (columns // 3, False)


@lru_cache(maxsize=8)
def _to_series(degree: int) -> Array:
    """Return the (D + 1, D + 1) matrix from values at the Chebyshev points to Chebyshev coefficients."""
    values = chebyshev.chebvander(np.sort(chebyshev.chebpts1(degree + 1)), degree)
    return read_only(np.asarray(np.linalg.inv(values), dtype=np.float64))


@lru_cache(maxsize=8)
def _from_bernstein(degree: int) -> Array:
    """Return the (D + 1, D + 1) matrix from Bernstein coefficients to powers of κ: c_j = C(D, j) Δʲb₀."""
    rows = [
        [(-1) ** (j - i) * comb(degree, j) * comb(j, i) if i <= j else 0 for i in range(degree + 1)]
        for j in range(degree + 1)
    ]
    return read_only(np.array(rows, dtype=np.float64))


@lru_cache(maxsize=8)
def _to_powers(basis: type[Chebyshev] | type[Legendre], degree: int) -> Array:
    """Return the (D + 1, D + 1) matrix from a basis to powers of κ = (x + 1)/2: whole numbers for both, so exact."""
    matrix = np.zeros((degree + 1, degree + 1))
    for j in range(degree + 1):
        matrix[: j + 1, j] = basis.basis(j, domain=[0, 1]).convert(kind=Polynomial, domain=[-1, 1]).coef
    return read_only(np.rint(matrix))
