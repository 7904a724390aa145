"""A path run through by a law that is a polynomial in each step: the platform's motion of a plan of least time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, Frozen, frozen
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import Path


@dataclass(frozen=True, eq=False)
class TimedPath(Frozen):
    """x(p(t)) of a path and a law p(t) whose second derivative may jump where the path's does.

    Attributes:
        path: the path.
        law: arc length p by time, m.
        breaks: (b,) times at which the path's curvature jumps, s.
    """

    path: Path
    law: PiecewisePolynomial
    breaks: Array

    @property
    def duration(self) -> float:
        """Total time, s."""
        return self.law.end

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at (N,) increasing times, s; a break that occurs twice gets both accelerations."""
        t = np.asarray(times, dtype=np.float64)
        before = np.append(t[1:] == t[:-1], False)
        p, pd, pdd = (self.law.derivative(order)(t) for order in range(3))
        pdd[before] = self.law.derivative(2)(t[before], "left")
        # the segment of the path is chosen by the time, for p is only as exact as its rounding
        ends, segment = np.array([0.0, *self.path.breaks, self.path.length]), np.searchsorted(self.breaks, t, "right")
        on = np.isin(t, self.breaks)
        place = np.where(on, ends[segment], np.clip(p[:, 0], ends[segment], ends[segment + 1]))
        x, tangent, curvature = self.path.evaluate(place, "right")
        left = np.flatnonzero(before | (~on & (place == ends[segment + 1])))
        curvature[left] = self.path.evaluate(place[left], "left").curvature
        return PlatformMotion(t, x, tangent * pd, tangent * pdd + curvature * pd**2, check_rates=False)


def timed(path: Path, law: PiecewisePolynomial, breaks: Array) -> ContinuousMotion:
    """Return the motion along a path as a function of time; ``breaks`` (b,) as of ``TimedPath``."""
    knots = np.setdiff1d(law.edges[1:-1], breaks)
    return ContinuousMotion(
        TimedPath(path, law, frozen(breaks)), law.start, law.end, law.end, frozen(breaks), frozen(knots), True
    )
