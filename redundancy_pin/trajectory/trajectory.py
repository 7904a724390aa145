"""A path and a timing law: the motion of the platform, exact in every derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import (
    ROUNDING,
    Array,
    BoolArray,
    Frozen,
    Side,
    assign,
    checked,
    frozen,
    inside,
    positive,
    require_side,
)
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory.functions_of_time import first_times
from redundancy_pin.trajectory.paths import Path
from redundancy_pin.trajectory.timing import TimingLaw

Ends: TypeAlias = tuple[Literal["rest", "samples"], Literal["rest", "samples"]]
"""What holds at start and end of a motion through points: rest without acceleration, or the points' own rates."""

LEAST_KNOT_DISTANCE = 1e-4
"""Of the knots of a path, as a fraction of the duration: towards a cusp they come closer and closer."""

MOST_SAMPLES = 10_000_000
"""Samples made at once; more would fill the memory of a usual computer in the dynamics that follow."""


def sample_times(duration: float, breaks: Array, dt: float | None, times: ArrayLike | None, two_sided: bool) -> Array:
    """Return the times to sample at, s; a break occurs twice when it is to be two-sided.

    With ``dt``: 0, dt, 2 dt, ... and the duration, exactly. With ``times``: those. Two-sided, all breaks
    from the first time to the last are inserted twice, in place of a time that differs from one by rounding only,
    so that no step is as short as a rounding error.

    Raises:
        InputError: both or none of ``dt`` and ``times``, a dt that makes too many samples, times that
            do not increase or are outside [0, duration].
    """
    if (dt is None) == (times is None):
        raise InputError("Pass either dt or times.", remedy="dt=1e-3 samples every millisecond.")
    slack = ROUNDING * duration
    if dt is not None:
        step = positive(dt, "dt", "s")
        if duration / step > MOST_SAMPLES:
            raise InputError(
                f"dt = {step:g} s makes {duration / step:.3g} samples of {duration:.6g} s.",
                remedy=f"At most {MOST_SAMPLES} are made at once: use a larger dt, or sample a part with times. "
                f"Do times look like milliseconds? {duration:.6g} ms are {1e-3 * duration:.6g} s.",
                dt=step,
            )
        grid = step * np.arange(np.ceil(duration / step), dtype=np.float64)
        grid = np.append(grid[grid < duration - slack], duration)
    else:
        grid = inside(checked(np.asarray(times), "times", ("N",)), 0.0, duration, "times", "s")
        if len(grid) == 0 or (np.diff(grid) <= 0.0).any():
            raise InputError(
                "times must be a strictly increasing list of at least one time.",
                remedy="Sort the times and remove duplicates; jumps are made two-sided by themselves.",
            )
    if not two_sided or len(breaks) == 0:
        return grid
    within = breaks[(breaks >= grid[0] - slack) & (breaks <= grid[-1] + slack)]
    apart = np.abs(grid[:, None] - within[None, :]) > slack
    return np.sort(np.concatenate([grid[apart.all(axis=1)], within, within]))


_LENGTH_TOLERANCE = 1e-9
"""How far, relative to the path, the length of a timing law may be off: a length written with nine digits passes."""


class TrajectoryPoint(NamedTuple):
    """The state of the platform at some times.

    Attributes:
        x: (..., n) platform coordinates, m and rad; (..., 4, 4) for poses.
        xd: (..., n) their rate, m/s and rad/s; the twist for poses.
        xdd: (..., n) its rate, m/s² and rad/s².
    """

    x: Array
    xd: Array
    xdd: Array


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Trajectory(Frozen):
    """A path travelled by a timing law: x(p(t)), ẋ = x' ṗ, ẍ = x' p̈ + x'' ṗ².

    Where x'' jumps by Δ (a straight meets an arc) and the speed is not zero, the acceleration jumps by
    Δ ṗ². Such instants stay jumps: ``evaluate`` takes the side, ``sample`` gives both.

    Attributes:
        path: the path.
        timing: the timing law; its length is the length of the path.
        breaks: (b,) times at which the acceleration jumps, s.
        ends: of a motion through points with times, what holds at its start and its end: "rest" or "samples"
            (``from_points``); None otherwise.

    Raises:
        InputError: path and timing law have different lengths.

    Example:
        >>> path = rp.trajectory.Line([0.2, 0.6], [0.3, 0.6])
        >>> move = rp.trajectory.Trajectory(path, rp.trajectory.RestToRest(path.length, duration=1.0))
        >>> len(move.sample(dt=0.1))
        11
    """

    path: Path
    timing: TimingLaw
    breaks: Array
    ends: Ends | None
    _break_length: Array
    _break_time: Array

    def __init__(self, path: Path, timing: TimingLaw, *, ends: Ends | None = None) -> None:
        for part, what in ((path, "path"), (timing, "timing law")):
            if not (hasattr(part, "length") and hasattr(part, "evaluate")):
                raise InputError(
                    f"A {what} was expected, not {type(part).__name__}.",
                    remedy="A trajectory is a path, such as Line, and a timing law, such as RestToRest.",
                )
        if abs(path.length - timing.length) > _LENGTH_TOLERANCE * path.length:
            raise InputError(
                f"The path is {path.length:.9g} m long, the timing law {timing.length:.9g} m.",
                remedy="Make the timing law with length=path.length.",
                path_length=path.length,
                timing_length=timing.length,
            )
        lengths = frozen(path.breaks)
        instants = frozen(first_times(timing.curve, lengths))
        change = path.evaluate(lengths, "right").curvature - path.evaluate(lengths, "left").curvature
        jump = np.abs(change).max(axis=1, initial=0.0) * timing.evaluate(instants).pd ** 2
        assign(self, path=path, timing=timing, breaks=frozen(instants[jump > 0.0]), ends=ends)
        assign(self, _break_length=lengths, _break_time=instants)

    def __repr__(self) -> str:
        """Return path, duration and ends, not the arrays."""
        ends = f", ends={self.ends}" if self.ends else ""
        return f"{type(self).__name__}({type(self.path).__name__}, n={self.dimension}, {self.duration:g} s{ends})"

    @property
    def dimension(self) -> int:
        """Number n of platform coordinates; of the rates of poses: six."""
        return self.path.dimension

    @property
    def duration(self) -> float:
        """Total time, s."""
        return self.timing.duration

    @property
    def knots(self) -> Array:
        """(c,) inner times at which the jerk may jump, and those near a cusp of the path, where little is smooth, s."""
        along = first_times(self.timing.curve, getattr(self.path, "knots", ()))
        apart = np.diff(along, prepend=0.0) > LEAST_KNOT_DISTANCE * self.duration
        return frozen(np.union1d(self.timing.knots, along[apart]))

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at given times; nothing is inserted.

        Args:
            times: (N,) increasing times, s. An instant may occur twice if it is one of ``breaks``: the first gets
                the acceleration before the jump, the second that after it. A single one gets that after it.

        Raises:
            InputError: times outside [0, duration] or not increasing.
        """
        instants = inside(checked(np.asarray(times), "times", ("N",)), 0.0, self.duration, "times", "s")
        before_jump = np.append(instants[1:] == instants[:-1], False)
        return PlatformMotion(instants, *self._evaluate(instants, before_jump))

    def sample(
        self, dt: float | None = None, *, times: ArrayLike | None = None, two_sided: bool = True
    ) -> PlatformMotion:
        """Return the motion sampled every ``dt`` seconds or at given times, jumps included.

        Args:
            dt: sampling interval, s; the last sample falls on the duration, with a shorter last interval
                where dt does not divide it.
            times: (N,) strictly increasing times, s, instead of dt.
            two_sided: whether to insert every break between the first and the last sample as a
                two-sided sample: the same instant twice, equal x and ẋ, ẍ before and after the jump.

        Raises:
            InputError: both or none of ``dt`` and ``times``, or times outside [0, duration] or not increasing.
        """
        return self.sample_at(sample_times(self.duration, self.breaks, dt, times, two_sided))

    def evaluate(self, t: ArrayLike, side: Side = "right") -> TrajectoryPoint:
        """Return x, ẋ, ẍ at times t, s, of any shape: arrays of that shape followed by (n,); x of poses by (4, 4).

        At a break the acceleration is that before ("left") or after it ("right"); x and ẋ are bit-equal from both
        sides.

        Raises:
            InputError: t outside [0, duration].
        """
        require_side(side)
        times = inside(t, 0.0, self.duration, "t", "s")
        flat = times.ravel()
        point = self._evaluate(flat, np.full(flat.shape, side == "left"))
        return TrajectoryPoint(*(part.reshape(*times.shape, *part.shape[1:]) for part in point))

    def scaled(self, factor: float) -> Trajectory:
        """Return the same path travelled ``factor`` times as fast; inertial forces grow with factor².

        Raises:
            InputError: factor not positive.
        """
        return Trajectory(self.path, self.timing.scaled(factor), ends=self.ends)

    def _evaluate(self, times: Array, before: BoolArray) -> TrajectoryPoint:
        """Return x, ẋ, ẍ at times (N,), ``before`` the jump or after it."""
        p, pd, pdd = self.timing.evaluate(times)
        if before.any():
            pdd[before] = self.timing.evaluate(times[before], "left").pdd
        # The segment of the path is chosen by the time, not by the arc length: p(t) is only as exact as its rounding,
        # and must not slip across a break.
        passed = np.searchsorted(self._break_time, times, side="right")
        ends = np.array([0.0, *self._break_length, self.path.length])
        on_break = np.append(-np.inf, self._break_time)[passed] == times
        p = np.where(on_break, ends[passed], np.clip(p, ends[passed], ends[passed + 1]))
        x, tangent, curvature = self.path.evaluate(p, "right")
        left = np.flatnonzero((on_break & before) | (~on_break & (p == ends[passed + 1])))
        curvature[left] = self.path.evaluate(p[left], "left").curvature
        pd, pdd = pd[:, None], pdd[:, None]
        return TrajectoryPoint(x, tangent * pd, tangent * pdd + curvature * pd**2)
