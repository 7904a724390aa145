"""The motion of the platform as a function of time: of a trajectory, of samples, or read from a file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, Frozen, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion, require_consistent
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.quaternions import (
    angular_rates,
    poses_of,
    quaternion_rates,
    quaternions_of,
    turns_between,
)

DENSE = 1e-9
"""Rounding of the accelerations of the quintic, relative to the largest, from which samples count as dense: at 0.4 m
and 1 m/s² about 2 ms apart."""

MOST_TURN = 3.0
"""Between two samples of a pose, rad: at half a turn its sense is not determined."""

PLATFORM_TOLERANCE = 1e-12
"""Of the polynomials that stand for a trajectory in a file, relative to the largest x, ẋ and ẍ."""


class TimedTrajectory(Protocol):
    """What a planner needs of a trajectory.

    It begins at zero, or at ``start``, s. ``knots``, (c,) times at which a higher derivative jumps, s, and ``exact``,
    false where it is not smooth in between, help to resolve it where it has them.
    """

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


FEW = 9
"""Times up to which a function of time is evaluated one by one."""


@dataclass(frozen=True, eq=False)
class Motion(Frozen):
    """A platform motion over an interval, from a trajectory or from polynomials.

    Attributes:
        source: the trajectory, or polynomials with the values x (n, or 16 of a pose, row by row), ẋ and ẍ (n each).
        start, end: first and last time, s.
        moves_until: time from which on the platform rests, s; the end but where carriers move on.
        breaks: (b,) inner times at which the acceleration jumps, s.
        knots: (c,) inner times at which a higher derivative jumps, s, if known.
        exact: whether it is smooth between breaks and knots to machine precision; false for a sampled motion.
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
        """(e,) both ends and, in order, known times at which it is not smooth, s."""
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

    def states_at(self, times: Array) -> tuple[Array, Array, Array]:
        """Return x (N, n), or (N, 4, 4), ẋ and ẍ (N, n) at (N,) times, s, no two alike: the values of ``sample_at``.

        Nobody looks at them again, as a ``PlatformMotion`` does: for those who ask for a few instants again and again.
        """
        source = self.source
        if not isinstance(source, PiecewisePolynomial):
            motion = self.sample_at(times)
            return motion.x, motion.xd, motion.xdd
        n, is_pose = _coordinates(source.coefficients.shape[2])
        held = self.moves_until != self.end and times[-1] >= self.moves_until
        inside = np.minimum(times, self.moves_until) if held else times
        # of few times one by one is sooner done than all at once
        values = np.array([source.at(t) for t in inside.tolist()]) if len(times) <= FEW else source(inside)
        if held:
            values[times >= self.moves_until, -2 * n :] = 0.0
        x, xd, xdd = values[:, : -2 * n], values[:, -2 * n : -n], values[:, -n:]
        return x.reshape(-1, 4, 4) if is_pose else x, xd, xdd

    def _moving(self, times: Array, before: BoolArray) -> PlatformMotion:
        if not isinstance(self.source, PiecewisePolynomial):
            return self.source.sample_at(times)
        n, is_pose = _coordinates(self.source.coefficients.shape[2])
        x, xd, xdd = np.split(_with_jumps(self.source, times, before, n), [-2 * n, -n], axis=1)
        return PlatformMotion(times, x.reshape(-1, 4, 4) if is_pose else x, xd, xdd, check_rates=False)

    def prolonged_until(self, end: float) -> Motion:
        """Return the motion with the platform at rest at its end, until a later time, s."""
        if not end > self.end:
            return self
        return replace(self, end=end, breaks=frozen(np.append(self.breaks, self.end)))

    @cached_property
    def polynomials(self) -> PiecewisePolynomial:
        """x, ẋ and ẍ side by side, without the time at rest; polynomials of a trajectory are fitted."""
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


def as_motion(motion: PlatformMotion | TimedTrajectory | Motion) -> Motion:
    """Return a trajectory or a sampled motion as a function of time.

    A trajectory gives its own exact motion. Between the samples of a motion the result is the quintic that matches
    x, ẋ, ẍ at both ends; its acceleration is off by O(Δt⁴). Where samples are so dense that the rounding of x shows in
    it, velocity and acceleration are those of the cubic that matches ẋ and ẍ, off by O(Δt³). Of poses these are
    polynomials of the origin and of the quaternion.

    Raises:
        InputError: samples that are no motion (``require_consistent``), or of a single instant; something else.
    """
    if isinstance(motion, PlatformMotion):
        require_consistent(motion)
        return _from_samples(motion)
    if isinstance(motion, Motion):
        return motion
    if not is_timed(motion):
        raise InputError(
            f"{type(motion).__name__} was given for the motion.",
            remedy="Pass a trajectory, such as trajectory.reference.circle(), or a PlatformMotion.",
        )
    start, end = float(getattr(motion, "start", 0.0)), float(motion.duration)
    breaks, knots = (
        frozen([t for t in times if start < t < end]) for times in (motion.breaks, getattr(motion, "knots", ()))
    )
    return Motion(motion, start, end, end, breaks, knots, getattr(motion, "exact", True))


def _from_samples(motion: PlatformMotion) -> Motion:
    if motion.t[0] == motion.t[-1]:
        raise InputError("The motion has a single instant.", remedy="Pass at least two samples.")
    values = _in_quaternions(motion) if motion.is_pose else (motion.x, motion.xd, motion.xdd)
    position = PiecewisePolynomial.through(motion.t, *values)
    velocity = position.derivative()
    edges = position.edges
    # second differences of positions that are rounded themselves, over h²; 60 is the factor of the quintic
    rounding = 60.0 * np.finfo(float).eps * np.abs(motion.x).max() / np.median(np.diff(edges)) ** 2
    # of the motion, not of its samples: between two at rest there may be one
    largest = max(np.abs(motion.xdd).max(), np.abs(position.derivative(2).ranges()).max())
    if rounding > DENSE * largest:
        velocity = PiecewisePolynomial.through(motion.t, *values[1:])
    polynomials = position.hstack(velocity).hstack(velocity.derivative())
    breaks = frozen(motion.t[motion.jumps])
    knots = frozen(np.setdiff1d(edges[1:-1], breaks))
    source = _PosesBetween(polynomials, breaks) if motion.is_pose else polynomials
    return Motion(source, float(edges[0]), float(edges[-1]), float(edges[-1]), breaks, knots, False)


def _in_quaternions(motion: PlatformMotion) -> tuple[Array, Array, Array]:
    """Return origins and quaternions (N, 7) of poses, m, and their first and second derivatives.

    Raises:
        InputError: samples half a turn apart, or a pose without six rates.
    """
    if motion.xd.shape[1] != 6:
        raise InputError(
            f"The poses have {motion.xd.shape[1]} rates: nothing says how the origin moves between the samples.",
            remedy="Pass a trajectory.",
        )
    q = quaternions_of(motion.x[:, :3, :3])
    angle = turns_between(q)
    k = int(angle.argmax())
    if angle[k] > MOST_TURN:
        raise InputError(
            f"The platform turns by {angle[k]:.4g} rad between its samples at {motion.t[k]:.6g} and "
            f"{motion.t[k + 1]:.6g} s: nothing says which way round.",
            remedy="Sample the motion more densely.",
            time=float(motion.t[k]),
        )
    turning = (q, *quaternion_rates(q, motion.xd[:, 3:], motion.xdd[:, 3:]))
    moving = (motion.x[:, :3, 3], motion.xd[:, :3], motion.xdd[:, :3])
    x, xd, xdd = (np.concatenate(pair, axis=1) for pair in zip(moving, turning, strict=True))
    return x, xd, xdd


@dataclass(frozen=True, eq=False)
class _PosesBetween(Frozen):
    """A motion of poses between samples.

    Attributes:
        numbers: origin and quaternion, m and 1, their rates and second derivatives (21), as polynomials.
        breaks: (b,) times at which the acceleration jumps, s.
    """

    numbers: PiecewisePolynomial
    breaks: Array

    @property
    def duration(self) -> float:
        """Last time, s."""
        return self.numbers.end

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at (N,) increasing times, s; a break that occurs twice gets both accelerations."""
        t = np.asarray(times, dtype=np.float64)
        values = _with_jumps(self.numbers, t, np.append(t[1:] == t[:-1], False), 7)
        (p, q), (v, qd), (a, qdd) = (np.split(part, [3], axis=1) for part in np.split(values, 3, axis=1))
        omega, alpha = angular_rates(q, qd, qdd)
        return PlatformMotion(t, poses_of(p, q), np.concatenate([v, omega], axis=1), np.concatenate([a, alpha], axis=1))


def _with_jumps(source: PiecewisePolynomial, times: Array, before: BoolArray, last: int) -> Array:
    """Return the values at (N,) times, s, the last columns of those ``before`` a jump from the left: it is one state.

    The others are bit for bit the same from both sides.
    """
    values = source(times)
    values[before, -last:] = source(times[before], "left")[:, -last:]
    return values


def _coordinates(columns: int) -> tuple[int, bool]:
    """Return the number n of coordinates of x, ẋ, ẍ side by side, and whether x is a pose: 16 + 2 · 6 numbers.

    Three times n is never 28.
    """
    return (6, True) if columns == 28 else (columns // 3, False)
