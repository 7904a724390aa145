"""Polynomials through any boundary conditions: values and derivatives at both ends of an interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly
from scipy.optimize import brentq

from redundancy_pin.arrays import Array, checked, inside, read_only
from redundancy_pin.errors import InputError


@dataclass(frozen=True, eq=False)
class Polynomial:
    """A scalar or vector polynomial of time on one interval.

    It is kept in Bernstein form on κ = (t − t0)/(t1 − t0): boundary values are met to rounding, however short
    or late the interval, where a power basis in t loses digits.

    Attributes:
        t0, t1: ends of the interval, s.
        control: (degree + 1, ...) Bernstein coefficients, in the unit of the value; the trailing axes
            are those of the value.
    """

    t0: float
    t1: float
    control: Array

    @property
    def degree(self) -> int:
        """Formal degree: one less than the number of boundary conditions."""
        return len(self.control) - 1

    @property
    def coefficients(self) -> Array:
        """(degree + 1, ...) coefficients of κ⁰, κ¹, ... with κ = (t − t0)/(t1 − t0)."""
        orders = range(self.degree + 1)
        return read_only(np.array([comb(self.degree, j) * np.diff(self.control, n=j, axis=0)[0] for j in orders]))

    @cached_property
    def _bernstein(self) -> BPoly:
        return BPoly(self.control[:, None], [self.t0, self.t1])

    def __call__(self, t: ArrayLike, derivative: int = 0) -> Array:
        """Return the value, or a derivative by time.

        Args:
            t: time, s, scalar or any shape, inside [t0, t1].
            derivative: order of the derivative, 0 for the value.

        Returns:
            Array of the shape of ``t`` followed by the shape of the value, unit of the value / s^derivative.

        Raises:
            InputError: a time outside the interval, or a negative order.
        """
        if derivative < 0:
            raise InputError(f"derivative is {derivative}, expected 0 or more.", derivative=derivative)
        times = inside(t, self.t0, self.t1, "t", "s")
        if derivative > self.degree:
            return np.zeros(times.shape + self.control.shape[1:])
        return np.asarray(self._bernstein(times, derivative))


def boundary_polynomial(t0: float, t1: float, start: Sequence[ArrayLike], end: Sequence[ArrayLike]) -> Polynomial:
    """Return the polynomial of least degree with given derivatives at both ends (Parsa 2014, eqs 1.5 and 1.9).

    Six conditions give a quintic, eight (with jerk) a septic; the two ends need not have equally many.

    Args:
        t0: start of the interval, s.
        t1: end of the interval, s, after t0.
        start: value, first, second, ... derivative at t0; each a scalar or all (k,), unit / s^order.
        end: the same at t1, of any length.

    Raises:
        InputError: t1 is not after t0, no condition at all, different shapes, or values that are not finite.
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
    shape = shapes.pop()
    conditions = [
        np.reshape([checked(np.ravel(y), f"{name}[{j}]", ("k",)) for j, y in enumerate(values)], (-1, *shape))
        if len(values)
        else np.zeros((0, *shape))
        for name, values in (("start", start), ("end", end))
    ]
    control = BPoly.from_derivatives([first, last], conditions).c[:, 0]
    return Polynomial(first, last, read_only(control.copy()))


def rest_to_rest_345(t0: float, t1: float, start: ArrayLike, end: ArrayLike) -> Polynomial:
    """Return the 3-4-5 polynomial: at rest without acceleration at both ends (Parsa 2014, eq. 1.10).

    ``start`` and ``end`` are the values, scalar or (k,), at t0 and t1, s.

    Raises:
        InputError: as ``boundary_polynomial``.
    """
    return _rest_to_rest(t0, t1, start, end, zeros=2)


def rest_to_rest_4567(t0: float, t1: float, start: ArrayLike, end: ArrayLike) -> Polynomial:
    """Return the 4-5-6-7 polynomial: at rest without acceleration or jerk at both ends; see ``rest_to_rest_345``."""
    return _rest_to_rest(t0, t1, start, end, zeros=3)


def time_of_value(law: Polynomial, p: float) -> float:
    """Return the time, s, at which an increasing scalar polynomial takes a value; beyond its range the nearer end."""
    if p <= float(law(law.t0)):
        return law.t0
    if p >= float(law(law.t1)):
        return law.t1
    return float(brentq(lambda t: float(law(t)) - p, law.t0, law.t1, xtol=1e-300, rtol=4.0 * np.finfo(float).eps))


def _rest_to_rest(t0: float, t1: float, start: ArrayLike, end: ArrayLike, zeros: int) -> Polynomial:
    rest = [np.zeros(np.shape(start))] * zeros
    return boundary_polynomial(t0, t1, [start, *rest], [end, *rest])
