"""What a timing law is, arc length as a function of time, and the simplest: rest to rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.domain import inside, positive
from redundancy_pin.trajectory.polynomials import (
    Polynomial,
    rest_to_rest_345,
    rest_to_rest_4567,
    time_of_value,
)


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


class TimingLaw(Protocol):
    """Arc length p(t) from p(0) = 0 to p(duration) = length, increasing, with continuous p̈."""

    @property
    def length(self) -> float:
        """Arc length at the end, m."""

    @property
    def duration(self) -> float:
        """Time at the end, s."""

    def evaluate(self, t: ArrayLike) -> TimingPoint:
        """Return p, ṗ, p̈ at times t (scalar or any shape, s).

        Raises:
            InputError: t outside [0, duration].
        """

    def time_at(self, p: float) -> float:
        """Return the time, s, at which arc length p, m, is reached.

        Raises:
            InputError: p outside [0, length].
        """

    def scaled(self, factor: float) -> TimingLaw:
        """Return the same law run ``factor`` times as fast: p(factor · t).

        Raises:
            InputError: factor not positive.
        """


@dataclass(frozen=True)
class RestToRest:
    """A single polynomial from rest to rest over the whole length.

    Attributes:
        length: arc length, m.
        duration: s.
        shape: "3-4-5" (Parsa 2014, eq. 1.10) or "4-5-6-7" (no jerk at the ends either).

    Raises:
        InputError: length or duration not positive, unknown shape.
    """

    length: float
    duration: float
    shape: Literal["3-4-5", "4-5-6-7"] = "3-4-5"

    def __post_init__(self) -> None:
        positive(self.length, "length", "m")
        positive(self.duration, "duration", "s")
        if self.shape not in ("3-4-5", "4-5-6-7"):
            raise InputError(f"shape is {self.shape!r}, expected '3-4-5' or '4-5-6-7'.", shape=self.shape)

    @property
    def polynomial(self) -> Polynomial:
        """The polynomial p(t), m."""
        law = rest_to_rest_345 if self.shape == "3-4-5" else rest_to_rest_4567
        return law(0.0, self.duration, 0.0, self.length)

    def evaluate(self, t: ArrayLike) -> TimingPoint:
        """Return p, ṗ, p̈ at times t; see ``TimingLaw.evaluate``."""
        polynomial = self.polynomial
        return TimingPoint(polynomial(t), polynomial(t, 1), polynomial(t, 2))

    def time_at(self, p: float) -> float:
        """Return the time, s, at which arc length p, m, is reached; see ``TimingLaw.time_at``."""
        return time_of_value(self.polynomial, float(inside(p, 0.0, self.length, "p", "m")))

    def scaled(self, factor: float) -> RestToRest:
        """Return the same law run ``factor`` times as fast."""
        return RestToRest(self.length, self.duration / positive(factor, "factor", "(ratio)"), self.shape)
