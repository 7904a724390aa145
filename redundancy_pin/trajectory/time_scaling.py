"""Time scaling: a motion along its path at another speed, x(σ(t)), with a path time σ.

Its rates are ẋ = x′ σ̇ and ẍ = x″ σ̇² + x′ σ̈, ′ the derivative by σ (J. M. Hollerbach, Dynamic scaling of manipulator
trajectories, 1984). Of poses x′ and x″ are the velocities of the origin and the angular ones; the same holds for them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly

from redundancy_pin.arrays import Array, Frozen, frozen, read_only
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, first_times

FOR_EVER = 1e9
"""Until when the last rate holds, s."""

SAME = 1e-9
"""Knots that differ by less are one, s: changes of σ̇ begin where ticks do, as other knots may."""

SNAP = 1e-12
"""From a jump of the acceleration, relative to the time: it is at the jump, which rounding may have left."""


@dataclass(frozen=True, eq=False)
class TimeScaling(Frozen):
    """The time σ of a motion as a function of the clock's, which does not fall: σ, σ̇ and σ̈ are continuous.

    Attributes:
        curve: σ (1,), s; of degree one in its last piece, which has no end.
    """

    curve: PiecewisePolynomial

    @staticmethod
    def none(start: float) -> TimeScaling:
        """Return σ = t from a time on, s."""
        line = np.array([1.0, start])[:, None, None]
        return TimeScaling(PiecewisePolynomial(frozen([start, start + FOR_EVER]), read_only(line)))

    @property
    def start(self) -> float:
        """First time, s; before it σ̇ is constant."""
        return self.curve.start

    @property
    def settled(self) -> float:
        """From when on σ̇ is constant, s."""
        return float(self.curve.edges[-2])

    @property
    def final_rate(self) -> float:
        """σ̇ from then on."""
        return float(self.curve.coefficients[-2, -1, 0])

    @property
    def rates(self) -> tuple[float, float]:
        """The least and the largest σ̇."""
        least, most = self.curve.derivative().ranges()
        return float(least.min()), float(most.max())

    def at(self, times: ArrayLike) -> tuple[Array, Array, Array]:
        """Return σ, s, σ̇ and σ̈, 1/s, (N,) each, at (N,) times, s."""
        t = np.asarray(times, dtype=np.float64)
        sigma, rate, bend = (self.curve.ppoly(np.maximum(t, self.start), order)[:, 0] for order in range(3))
        early = np.minimum(t - self.start, 0.0)
        return sigma + rate * early, rate, np.where(early < 0.0, 0.0, bend)

    def time_at(self, sigma: float) -> float:
        """Return when σ is reached, s; infinite if never."""
        edges = self.curve.edges
        first, settled = self.curve(edges[[0, -2]])[:, 0].tolist()
        if first < sigma <= settled:
            return float(first_times(PPoly(self.curve.coefficients[:, :, 0], self.curve.edges), sigma))
        # outside σ̇ is constant: what it is at the start, and its last value
        place, reached, rate = (
            (edges[0], first, float(self.at(edges[:1])[1][0]))
            if sigma <= first
            else (edges[-2], settled, self.final_rate)
        )
        return float(place + (sigma - reached) / rate) if rate > 0.0 else float(np.copysign(np.inf, sigma - reached))

    def changed(self, t: float, rate: float, duration: float, since: float = -np.inf) -> TimeScaling:
        """Return the same up to a time, s, after which σ̇ goes over to another rate within a duration, s.

        σ̇ is cubic in between. What is before ``since`` is forgotten.
        """
        begin = min(max(self.start, since), t)
        (sigma,), (v,), (a,) = (part.tolist() for part in self.at([t]))
        h, change = duration, rate - v
        # σ̇ = v + a u + c u² + d u³, at u = h the new rate, its derivative zero there
        c, d = 3.0 * change / h**2 - 2.0 * a / h, a / h**2 - 2.0 * change / h**3
        ahead = np.zeros((5, 2, 1))
        ahead[:, 0, 0] = d / 4.0, c / 3.0, a / 2.0, v, sigma
        ahead[3:, 1, 0] = rate, sigma + h * (v + h * (a / 2.0 + h * (c / 3.0 + h * d / 4.0)))
        new = PiecewisePolynomial(frozen([t, t + h, t + h + FOR_EVER]), read_only(ahead))
        return TimeScaling(PiecewisePolynomial.joined([self.curve.between(begin, t), new]) if begin < t else new)


def scaled_rates(by_sigma: Array, twice: Array, rate: Array, bend: Array) -> tuple[Array, Array]:
    """Return ẋ and ẍ (N, n) of the derivatives x′ and x″ (N, n) by σ, with σ̇ and σ̈ (N,)."""
    return by_sigma * rate[:, None], twice * (rate**2)[:, None] + by_sigma * bend[:, None]


@dataclass(frozen=True, eq=False)
class ScaledMotion(Frozen):
    """A motion along its path at another speed: a ``TimedTrajectory``.

    Attributes:
        motion: in its own time σ.
        scaling: σ of time; from ``start`` on σ begins with the motion.
    """

    motion: Motion
    scaling: TimeScaling

    @property
    def start(self) -> float:
        """When it begins, s."""
        return self.scaling.time_at(self.motion.start)

    @property
    def duration(self) -> float:
        """When it ends, s; infinite if never."""
        return self.scaling.time_at(self.motion.end)

    @property
    def breaks(self) -> Array:
        """(b,) times at which the acceleration jumps, s."""
        return frozen([self.scaling.time_at(t) for t in self.motion.breaks.tolist()])

    @property
    def knots(self) -> Array:
        """(c,) times at which a higher derivative of the motion jumps, and where σ̇ begins or ends to change, s."""
        own = [self.scaling.time_at(t) for t in self.motion.knots.tolist()]
        knots = np.union1d(own, self.scaling.curve.edges[1:-1])
        knots = knots[np.diff(knots, prepend=-np.inf) > SAME]
        return frozen(knots[np.abs(knots[:, None] - [self.start, *self.breaks, self.duration]).min(axis=1) > SAME])

    @property
    def exact(self) -> bool:
        """Whether it is smooth between breaks and knots to machine precision."""
        return self.motion.exact

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at (N,) increasing times, s; a break that occurs twice gets both accelerations."""
        t = np.asarray(times, dtype=np.float64)
        sigma, rate, bend = self.scaling.at(t)
        breaks = self.motion.breaks
        if len(breaks):
            nearest = breaks[np.abs(sigma[:, None] - breaks).argmin(axis=1)]
            sigma = np.where(np.abs(sigma - nearest) <= SNAP * np.maximum(1.0, np.abs(nearest)), nearest, sigma)
        sigma = np.clip(sigma, self.motion.start, self.motion.end)
        once, place = np.unique(sigma, return_inverse=True)  # where it stands, or next to
        there = self.motion.sample_at(once)
        curved = there.xdd[place]
        for i in np.flatnonzero(t[1:] == t[:-1]):
            curved[i] = self.motion.sample_at(sigma[[i, i]]).xdd[0]
        xd, xdd = scaled_rates(there.xd[place], curved, rate, bend)
        return PlatformMotion(t, there.x[place], xd, xdd, check_rates=False)
