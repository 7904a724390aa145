"""Functions of time: piecewise polynomials with any number of values.

They are scipy's ``PPoly``: on each piece powers of the time since its left end. They come from values at
Chebyshev points by way of Chebyshev coefficients, which are small where a smooth function is resolved, so that the
powers are as accurate as the Chebyshev series itself: values to 1e-15, first and second derivatives digit for digit the
same (degree 15, measured; a tail of 1e-6 costs 1e-10). Bernstein coefficients are no better there, all as large as the
function, and eighteen times slower to evaluate.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import comb, factorial, perm

import numpy as np
from numpy.polynomial import Chebyshev, Legendre, Polynomial, chebyshev
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly, PPoly

from redundancy_pin.arrays import Array, Frozen, IntArray, Side, frozen, read_only
from redundancy_pin.motion import CarrierMotion

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

MOST_NEWTON_STEPS, MOST_BISECTIONS = 12, 80
"""Steps until an instant is known to rounding: by Newton's method, then in all. Bisection alone takes 53 in a piece."""

STANDS_OUT = 1e-6
"""A peak counts if it exceeds both ends by this fraction; less is no peak worth a sample."""


@dataclass(frozen=True, eq=False)
class PiecewisePolynomial(Frozen):
    """A function from time to C numbers that is a polynomial on each of P pieces.

    Outside the pieces it has the values at their ends.

    Attributes:
        edges: (P + 1,) ends of the pieces, s.
        coefficients: (D + 1, P, C) of the powers of the time since the left end, the highest first, as in ``PPoly``.

    Example:
        >>> ramp = rp.trajectory.PiecewisePolynomial(np.array([0.0, 2.0]), np.array([[[3.0]], [[1.0]]]))
        >>> ramp(1.0)
        array([4.])
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

    def __call__(self, t: ArrayLike, side: Side = "right", order: int = 0) -> Array:
        """Return the values, or a derivative, at times of any shape, s: an array of that shape followed by (C,).

        ``side`` decides at the edge of two pieces; ``order``: of the derivative, unit of the values / s^order.
        """
        times = np.asarray(t, dtype=np.float64)
        if side == "left":  # PPoly is continuous from the right: the float before an edge is in the piece before it
            with np.errstate(under="ignore"):  # beside zero it is the smallest number there is
                times = np.nextafter(times, -np.inf)
        # not clip: NaN in place of extrapolation would be as slow
        values: Array = self.ppoly(np.minimum(np.maximum(times, self.edges[0]), self.edges[-1]), order)
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
        values: Array = ((min(max(t, left[i]), right[i]) - left[i]) ** exponents).dot(pieces[i])  # sooner than @
        return values

    def derivative(self, order: int = 1) -> PiecewisePolynomial:
        """Return the derivative of an order, unit of the values / s^order."""
        if order == 0:
            return self
        return PiecewisePolynomial(self.edges, read_only(self.ppoly.derivative(order).c))

    def hstack(self, other: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return a function on the same pieces with the values of this one, then of the other."""
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

    def between(self, start: float, end: float) -> PiecewisePolynomial:
        """Return the function between two times, s, of which the first may lie inside a piece, but not before all."""
        pieces = slice(self._piece(start), self._piece(end, "left") + 1)
        coefficients = self.coefficients[:, pieces].copy()
        shift = min(start, self.end) - self.edges[pieces.start]
        # Horner's rule again and again: powers of the time since the start
        for last in range(len(coefficients), 1, -1):
            for order in range(1, last):
                coefficients[order, 0] += shift * coefficients[order - 1, 0]
        edges = np.concatenate([[start], self.edges[pieces.start + 1 : pieces.stop], [end]])
        return PiecewisePolynomial(read_only(edges), read_only(coefficients))

    def _piece(self, t: float, side: Side = "right") -> int:
        return min(max(int(self.edges.searchsorted(t, side)) - 1, 0), len(self.edges) - 2)

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
    def through(t: Array, *derivatives: Array) -> PiecewisePolynomial:
        """Return the polynomials through samples: cubics of values and rates, quintics of second derivatives too.

        ``t`` (M,) times, s; one that occurs twice is a jump. ``derivatives``: (M, C) values, rates and so on.
        """
        left, degree = np.flatnonzero(np.diff(t) > 0.0), 2 * len(derivatives) - 1
        h = (t[left + 1] - t[left])[:, None]

        def control(at: IntArray, step: Array) -> list[Array]:
            # Δʲb at an end is the derivative of order j times hʲ (D − j)!/D!
            differences = [part[at] * (step**j / perm(degree, j)) for j, part in enumerate(derivatives)]
            zero = np.zeros_like(differences[0])
            return [sum((comb(i, j) * differences[j] for j in range(i + 1)), zero) for i in range(len(derivatives))]

        bernstein = np.stack([*control(left, h), *control(left + 1, -h)[::-1]])
        return PiecewisePolynomial.from_bernstein(bernstein, np.append(t[left], t[-1]))

    @staticmethod
    def taylor(t: Array, *derivatives: Array) -> PiecewisePolynomial:
        """Return the polynomials with given derivatives where each piece begins.

        ``t`` (M,) times at which one piece ends and the next begins, s; one that occurs twice makes no piece.
        ``derivatives``: (M, C) values, rates and so on at these times; ends of pieces are ignored.
        """
        left = np.flatnonzero(np.diff(t) > 0.0)
        powers = [part[left] / factorial(order) for order, part in enumerate(derivatives)]
        return PiecewisePolynomial(frozen(np.append(t[left], t[-1])), read_only(np.stack(powers[::-1])))

    @staticmethod
    def linear(t: Array, *derivatives: Array) -> PiecewisePolynomial:
        """Return ``taylor`` with the last of the derivatives linear between the times; a jump of it has two values."""
        step, change = np.diff(t)[:, None], np.diff(derivatives[-1], axis=0)
        slope = np.divide(change, step, out=np.zeros_like(change), where=step > 0.0)
        return PiecewisePolynomial.taylor(t, *derivatives, np.append(slope, slope[-1:], axis=0))

    @staticmethod
    def joined(parts: Sequence[PiecewisePolynomial]) -> PiecewisePolynomial:
        """Return functions as one, each beginning where the one before it ends."""
        padded = _padded([part.coefficients for part in parts])
        edges = np.concatenate([parts[0].edges, *(part.edges[1:] for part in parts[1:])])
        return PiecewisePolynomial(read_only(edges), read_only(np.concatenate(padded, axis=1)))

    def remove_offsets(self) -> PiecewisePolynomial:
        """Return the function with its pieces shifted so that each begins with the value the one before it ends with.

        What differs by rounding only is left as it is.
        """
        inner = self.edges[1:-1]
        jumps = np.cumsum(self(inner, "left") - self(inner), axis=0)
        jumps[np.abs(jumps) < SHIFT] = 0.0
        coefficients = self.coefficients.copy()
        coefficients[-1, 1:] += jumps
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


def first_times(curve: PPoly | BPoly, values: ArrayLike) -> Array:
    """Return when a function with one value, which does not fall, first reaches values of any shape, s.

    Newton's method, which ends at a rounding of the time; bisection where it is slow, as next to a rate of zero, or
    leaves its bracket. Values beyond both ends are reached at the ends.
    """
    wanted = np.asarray(values, dtype=np.float64)
    edges, reached = curve.x, curve(curve.x)
    piece = np.clip(np.searchsorted(reached, wanted, side="left") - 1, 0, len(edges) - 2)
    low, high = edges[piece], edges[piece + 1]
    before, after = reached[piece], reached[piece + 1]
    part = np.divide(wanted - before, after - before, out=np.zeros(wanted.shape), where=after > before)
    t = np.where(wanted >= after, high, low + (high - low) * np.clip(part, 0.0, 1.0))
    done = (wanted <= before) | (wanted >= after)
    for step in range(MOST_BISECTIONS):
        if done.all():
            break
        miss, rate = curve(t) - wanted, curve(t, 1)
        low, high = np.where(miss < 0.0, t, low), np.where(miss >= 0.0, t, high)
        newton = t - np.divide(miss, rate, out=np.full(wanted.shape, np.inf), where=rate > 0.0)
        fast = (newton >= low) & (newton <= high) & (step < MOST_NEWTON_STEPS)
        new = np.where(done, t, np.where(fast, newton, 0.5 * (low + high)))
        done |= np.abs(new - t) <= np.finfo(float).eps * np.abs(t)
        t = new
    return np.asarray(t)


def carriers_at(position: PiecewisePolynomial, times: ArrayLike, side: Side = "right") -> CarrierMotion:
    """Return the motion of carriers whose positions (k,) are a function of time, at (N,) times, s."""
    return CarrierMotion(*(position.derivative(order)(times, side) for order in range(3)), check_rates=False)


def chebyshev_times(edges: Array, degree: int = DEGREE) -> Array:
    """Return (P (D + 1),) times, s, at which values determine a polynomial of degree D on each of P pieces."""
    return chebyshev_points(edges[:-1], edges[1:], degree)


def chebyshev_points(left: Array, right: Array, degree: int) -> Array:
    """Return ``chebyshev_times`` of P pieces, however they lie, from their (P,) left and right ends, s."""
    return (0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * _nodes(degree)).ravel()


def chebyshev_series(values: Array) -> Array:
    """Return (P, D + 1, C) Chebyshev coefficients of the values at the times of ``chebyshev_times``."""
    series: Array = np.einsum("dn,pnc->pdc", _to_series(values.shape[1] - 1), values)
    return series


def preferred_middle(left: float, right: float, knots: Array) -> float:
    """Return where to divide an interval: the knot nearest to its middle, or the middle without an inner knot."""
    middle = 0.5 * (left + right)
    slack = 1e-3 * (right - left)
    inside = knots[np.searchsorted(knots, left + slack) : np.searchsorted(knots, right - slack)]
    return float(inside[np.abs(inside - middle).argmin()]) if len(inside) else middle


def _padded(coefficients: list[Array]) -> list[Array]:
    """Return coefficients (D + 1, P, C) with as many powers as the longest."""
    most = max(map(len, coefficients))
    missing = ((part, most - len(part)) for part in coefficients)  # np.pad takes twenty times as long
    return [np.concatenate([np.zeros((more, *part.shape[1:])), part]) if more else part for part, more in missing]


@lru_cache(maxsize=8)
def _nodes(degree: int) -> Array:
    """Return the (D + 1,) Chebyshev points, from -1 to 1."""
    return read_only(np.sort(chebyshev.chebpts1(degree + 1)))


@lru_cache(maxsize=8)
def _to_series(degree: int) -> Array:
    """Return the (D + 1, D + 1) matrix from values at the Chebyshev points to Chebyshev coefficients."""
    values = chebyshev.chebvander(_nodes(degree), degree)
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
