"""Straight motion of a spatial platform from one pose to another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array, checked, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory.domain import Side, inside, require_side
from redundancy_pin.trajectory.sampling import sample_times
from redundancy_pin.trajectory.timing import TimingLaw
from redundancy_pin.trajectory.trajectory import TrajectoryPoint

_HALF_TURN_MARGIN = 1e-6
"""Rotations this close to a half turn, rad, have no usable axis: rounding of 1e-9 in the pose (the tolerance of a
pose) would tilt it by 1e-3."""


@dataclass(frozen=True, init=False, eq=False)
class PoseTrajectory:
    """The position moves on a straight line while the platform turns about an axis fixed in the world.

    With κ = p(t)/length: position p0 + κ d, rotation exp(κ [φ]×) R0, twist κ̇ (d, φ) and its rate κ̈ (d, φ), in
    world-aligned axes at the platform origin. All of it is continuous: there are no breaks.

    Attributes:
        start, end: (4, 4) homogeneous poses in the base frame, m.
        timing: the timing law; only the fraction p / length of it is used, so its length may be
            one, the distance in metres, or the angle in radians.
        screw: (6,) displacement d, m, and rotation vector φ, rad, world axes.

    Raises:
        InputError: not homogeneous poses, or poses half a turn apart.
    """

    start: Array
    end: Array
    timing: TimingLaw
    screw: Array

    def __init__(self, start: ArrayLike, end: ArrayLike, timing: TimingLaw) -> None:
        poses = np.stack([checked(start, "start", (4, 4)), checked(end, "end", (4, 4))])
        # The motion checks that both are poses; nothing else here would.
        PlatformMotion([0.0, 1.0], poses, np.zeros((2, 6)), np.zeros((2, 6)))
        turn = Rotation.from_matrix(poses[1, :3, :3] @ poses[0, :3, :3].T).as_rotvec()
        angle = float(np.linalg.norm(turn))
        if angle > np.pi - _HALF_TURN_MARGIN:
            raise InputError(
                f"The poses are {angle:.9g} rad apart: at half a turn the axis is not determined.",
                remedy="Go through a pose in between.",
                angle=angle,
            )
        object.__setattr__(self, "start", frozen(poses[0]))
        object.__setattr__(self, "end", frozen(poses[1]))
        object.__setattr__(self, "timing", timing)
        object.__setattr__(self, "screw", frozen(np.concatenate([poses[1, :3, 3] - poses[0, :3, 3], turn])))

    @property
    def duration(self) -> float:
        """Total time, s."""
        return self.timing.duration

    @property
    def dimension(self) -> int:
        """Number of rates: six."""
        return 6

    @property
    def breaks(self) -> Array:
        """(0,) the acceleration does not jump."""
        return frozen([])

    def evaluate(self, t: ArrayLike, side: Side = "right") -> TrajectoryPoint:
        """Return poses (..., 4, 4), twists (..., 6) and their rates (..., 6) at times t, s.

        Raises:
            InputError: t outside [0, duration].
        """
        require_side(side)
        times = inside(t, 0.0, self.duration, "t", "s")
        kappa, rate, acceleration = (part.ravel()[:, None] / self.timing.length for part in self.timing.evaluate(times))
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        pose[:, :3, :3] = Rotation.from_rotvec(kappa * self.screw[3:]).as_matrix() @ self.start[:3, :3]
        pose[:, :3, 3] = self.start[:3, 3] + kappa * self.screw[:3]
        shape = (*times.shape, 6)
        return TrajectoryPoint(
            pose.reshape(*times.shape, 4, 4),
            (rate * self.screw).reshape(shape),
            (acceleration * self.screw).reshape(shape),
        )

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at (N,) strictly increasing times, s.

        Raises:
            InputError: times outside [0, duration] or not increasing.
        """
        instants = inside(checked(np.asarray(times), "times", ("N",)), 0.0, self.duration, "times", "s")
        return PlatformMotion(instants, *self.evaluate(instants))

    def sample(
        self, dt: float | None = None, *, times: ArrayLike | None = None, two_sided: bool = True
    ) -> PlatformMotion:
        """Return the motion sampled every ``dt`` seconds or at given times; see ``Trajectory.sample``.

        Raises:
            InputError: both or none of ``dt`` and ``times``, or times outside [0, duration] or not increasing.
        """
        return self.sample_at(sample_times(self.duration, self.breaks, dt, times, two_sided))

    def scaled(self, factor: float) -> PoseTrajectory:
        """Return the same motion run ``factor`` times as fast.

        Raises:
            InputError: factor not positive.
        """
        return PoseTrajectory(self.start, self.end, self.timing.scaled(factor))
