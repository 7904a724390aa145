"""A platform motion that can be asked for at any time, from a trajectory or from samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly

from redundancy_pin.arrays import Array, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory import SpeedProfile

DENSE = 1e-9
"""Rounding of the accelerations of the quintic, relative to the largest, from which samples count as dense: at 0.4 m
and 1 m/s² about 2 ms apart."""


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


@dataclass(frozen=True, eq=False)
class ContinuousMotion:
    """A platform motion over an interval.

    Attributes:
        start, end: first and last time, s.
        breaks: (b,) inner times at which the acceleration jumps, s.
        knots: (c,) inner times at which a higher derivative jumps, s, as far as they are known.
        exact: whether it is smooth between breaks and knots to rounding; not so a sampled motion.
        sample_at: from (N,) increasing times, s, to the motion there. A break that occurs twice gets the acceleration
            before and after the jump, a single one that after it.
    """

    start: float
    end: float
    breaks: Array
    knots: Array
    exact: bool
    sample_at: Callable[[Array], PlatformMotion]


def continuous_motion(motion: PlatformMotion | TimedTrajectory) -> ContinuousMotion:
    """Return a trajectory or a sampled motion as a function of time.

    A trajectory is asked for its own exact motion. Between the samples of a motion stands the quintic that matches
    x, ẋ, ẍ at both ends; its acceleration is off by O(Δt⁴). Where samples are so dense that the rounding of x shows in
    it, velocity and acceleration are those of the cubic that matches ẋ and ẍ, off by O(Δt³).

    Raises:
        InputError: a sampled motion with a single instant, or of poses.
    """
    if isinstance(motion, PlatformMotion):
        return _from_samples(motion)
    trajectory, end = motion, float(motion.duration)
    inner = [float(t) for t in trajectory.breaks if 0.0 < t < end]
    timing = getattr(trajectory, "timing", None)
    knots = []
    if isinstance(timing, SpeedProfile):  # the jerk jumps where a ramp meets the cruise
        knots = [t for t in (timing.ramp_time, timing.ramp_time + timing.cruise_time) if 0.0 < t < end]
    return ContinuousMotion(0.0, end, frozen(inner), frozen(knots), True, trajectory.sample_at)


def _from_samples(motion: PlatformMotion) -> ContinuousMotion:
    if motion.is_pose:
        raise InputError(
            "A sampled motion of poses cannot be planned for: nothing says how it turns between the samples.",
            remedy="Pass a trajectory.",
        )
    left = np.flatnonzero(np.diff(motion.t) > 0.0)
    if len(left) == 0:
        raise InputError("The motion has a single instant.", remedy="Pass at least two samples.")
    right = left + 1
    h = (motion.t[right] - motion.t[left])[:, None]
    x0, v0, a0 = motion.x[left], motion.xd[left], motion.xdd[left]
    x1, v1, a1 = motion.x[right], motion.xd[right], motion.xdd[right]
    edges = np.append(motion.t[left], motion.t[-1])
    position = quintics(edges, (x0, v0, a0), (x1, v1, a1))
    velocity = position.derivative()
    acceleration = velocity.derivative()
    # second differences of positions that are rounded themselves, over h²; 60 is the factor of the quintic
    rounding = 60.0 * np.finfo(float).eps * np.abs(motion.x).max() / np.median(h) ** 2
    # of the motion, not of its samples: between two at rest there may be one
    largest = max(np.abs(motion.xdd).max(), np.abs(acceleration.c).max())
    if rounding > DENSE * largest:
        velocity = BPoly(np.stack([v0, v0 + h * a0 / 3.0, v1 - h * a1 / 3.0, v1]), edges)
        acceleration = velocity.derivative()
    breaks = frozen(motion.t[motion.jumps])
    before = frozen(motion.xdd[np.flatnonzero(motion.jumps) - 1])

    def sample_at(times: Array) -> PlatformMotion:
        xdd = np.array(acceleration(times))
        first_of_two = np.flatnonzero(np.append(times[1:] == times[:-1], False))
        xdd[first_of_two] = before[np.searchsorted(breaks, times[first_of_two])]
        return PlatformMotion(times, position(times), velocity(times), xdd)

    inner = np.setdiff1d(edges[1:-1], breaks)
    return ContinuousMotion(float(edges[0]), float(edges[-1]), breaks, frozen(inner), False, sample_at)


def quintics(edges: Array, start: tuple[Array, Array, Array], end: tuple[Array, Array, Array]) -> BPoly:
    """Return the piecewise quintic with given values, first and second derivatives at both ends of every piece.

    Args:
        edges: (P + 1,) ends of the pieces, s.
        start: (P, n) values, rates and second derivatives where the pieces begin.
        end: the same where they end; it need not be where the next one begins.
    """
    h = np.diff(edges)[:, None]
    (x0, v0, a0), (x1, v1, a1) = start, end
    control = (
        x0,
        x0 + h * v0 / 5.0,
        x0 + 2.0 * h * v0 / 5.0 + h * h * a0 / 20.0,
        x1 - 2.0 * h * v1 / 5.0 + h * h * a1 / 20.0,
        x1 - h * v1 / 5.0,
        x1,
    )
    return BPoly(np.stack(control), edges)
