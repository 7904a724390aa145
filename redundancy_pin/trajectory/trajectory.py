"""A path and a timing law: the motion of the platform, exact in every derivative."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, checked, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory.domain import Side, inside, require_side
from redundancy_pin.trajectory.paths import Path
from redundancy_pin.trajectory.sampling import before_jump, sample_times
from redundancy_pin.trajectory.timing import TimingLaw

_LENGTH_TOLERANCE = 1e-9
"""How far, relative to the path, the length of a timing law may be off: a length typed with nine digits passes."""


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


@dataclass(frozen=True, init=False, eq=False)
class Trajectory:
    """A path travelled by a timing law: x(p(t)), ẋ = x' ṗ, ẍ = x' p̈ + x'' ṗ².

    Where x'' jumps by Δ (a straight meets an arc) and the speed is not zero, the acceleration jumps by
    Δ ṗ². Such instants stay jumps: ``evaluate`` takes the side, ``sample`` gives both.

    Attributes:
        path: the path.
        timing: the timing law; its length is that of the path.
        breaks: (b,) times at which the acceleration jumps, s.

    Raises:
        InputError: path and timing law have different lengths.
    """

    path: Path
    timing: TimingLaw
    breaks: Array
    _break_length: Array
    _break_time: Array

    def __init__(self, path: Path, timing: TimingLaw) -> None:
        if abs(path.length - timing.length) > _LENGTH_TOLERANCE * path.length:
            raise InputError(
                f"The path is {path.length:.9g} m long, the timing law {timing.length:.9g} m.",
                remedy="Make the timing law with length=path.length.",
                path_length=path.length,
                timing_length=timing.length,
            )
        lengths = frozen(path.breaks)
        instants = frozen([timing.time_at(min(float(p), timing.length)) for p in lengths])
        change = path.evaluate(lengths, "right").curvature - path.evaluate(lengths, "left").curvature
        jump = np.abs(change).max(axis=1, initial=0.0) * timing.evaluate(instants).pd ** 2
        for name, value in (
            ("path", path),
            ("timing", timing),
            ("breaks", frozen(instants[jump > 0.0])),
            ("_break_length", lengths),
            ("_break_time", instants),
        ):
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        """Total time, s."""
        return self.timing.duration

    @property
    def dimension(self) -> int:
        """Number n of platform coordinates."""
        return self.path.dimension

    def evaluate(self, t: ArrayLike, side: Side = "right") -> TrajectoryPoint:
        """Return x, ẋ, ẍ at times t.

        Args:
            t: time, s, scalar or any shape.
            side: which acceleration to give at a break: that before ("left") or after ("right").
                x and ẋ are bit-equal from both sides.

        Returns:
            Arrays of the shape of ``t`` followed by (n,).

        Raises:
            InputError: t outside [0, duration].
        """
        require_side(side)
        times = inside(t, 0.0, self.duration, "t", "s")
        flat = times.ravel()
        point = self._evaluate(flat, np.full(flat.shape, side == "left"))
        return TrajectoryPoint(*(part.reshape(*times.shape, self.dimension) for part in point))

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at given times; nothing is inserted.

        Args:
            times: (N,) increasing times, s. An instant may occur twice if it is one of ``breaks``: the first gets
                the acceleration before the jump, the second that after it. A single one gets that after it.

        Raises:
            InputError: times outside [0, duration] or not increasing.
        """
        instants = inside(checked(np.asarray(times), "times", ("N",)), 0.0, self.duration, "times", "s")
        return PlatformMotion(instants, *self._evaluate(instants, before_jump(instants)))

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

    def scaled(self, factor: float) -> Trajectory:
        """Return the same path travelled ``factor`` times as fast; inertial forces grow with factor².

        Raises:
            InputError: factor not positive.
        """
        return Trajectory(self.path, self.timing.scaled(factor))

    def _evaluate(self, times: Array, before: BoolArray) -> TrajectoryPoint:
        """Evaluate at (N,) times; ``before`` (N,) asks for the left limit where a time is a break.

        The segment of the path is chosen by the time, not by the arc length: p(t) is only as exact as
        its rounding, and must not slip across a break.
        """
        law = self.timing.evaluate(times)
        passed = np.searchsorted(self._break_time, times, side="right")
        lower = np.concatenate([[0.0], self._break_length])[passed]
        upper = np.concatenate([self._break_length, [self.path.length]])[passed]
        on_break = np.concatenate([[-np.inf], self._break_time])[passed] == times
        p = np.where(on_break, lower, np.clip(law.p, lower, upper))
        x, tangent, curvature = self.path.evaluate(p, "right")
        left = np.flatnonzero((on_break & before) | (~on_break & (p == upper)))
        curvature[left] = self.path.evaluate(p[left], "left").curvature
        pd, pdd = law.pd[:, None], law.pdd[:, None]
        return TrajectoryPoint(x, tangent * pd, tangent * pdd + curvature * pd**2)
