"""Platform coordinates as a function of time, from a trajectory or from the samples of a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.coordinates import difference, require_matching
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import AXES, Robot


class TimedMotion(Protocol):
    """What kinematics needs of a trajectory: a duration, and samples at any times in [0, duration]."""

    @property
    def duration(self) -> float:
        """Total time, s."""

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at (N,) increasing times, s."""


@dataclass(frozen=True, eq=False)
class PositionLaw:
    """Platform coordinates over time.

    Attributes:
        start, end: first and last time, s.
        at: from (N,) increasing times in [start, end] to (N, n) coordinates or (N, 4, 4) poses.
    """

    start: float
    end: float
    at: Callable[[Array], Array]


def position_law(robot: Robot, source: PlatformMotion | TimedMotion) -> PositionLaw:
    """Return the platform coordinates of a trajectory or a sampled motion as a function of time.

    A trajectory is asked for its own exact coordinates. Between the samples of a motion the coordinates are the quintic
    that matches x, ẋ, ẍ at both ends (error O(Δt⁶)); the orientation of a pose is the cubic in the rotation vector from
    the left sample that matches orientation and angular velocity at both ends (error O(Δt⁴)).

    Raises:
        InputError: the motion does not have the robot's coordinates, or has a single instant only.
    """
    if not isinstance(source, PlatformMotion):
        trajectory = source
        require_matching(robot, trajectory.sample_at([0.0]))
        return PositionLaw(0.0, float(trajectory.duration), lambda times: trajectory.sample_at(times).x)
    require_matching(robot, source)
    if source.t[-1] == source.t[0]:
        raise InputError(
            "The motion has a single instant: nothing is crossed between samples.",
            remedy="Pass at least two samples, or classify the configuration.",
        )
    interpolate = _poses(robot, source) if source.is_pose else _coordinates(robot, source)
    return PositionLaw(float(source.t[0]), float(source.t[-1]), interpolate)


def _coordinates(robot: Robot, motion: PlatformMotion) -> Callable[[Array], Array]:
    step = np.diff(motion.t)
    left = np.flatnonzero(step > 0.0)  # the two halves of a two-sided sample belong to different intervals
    right = left + 1
    change = difference(robot, motion.x[right], motion.x[left])
    return _quintic(motion, left, motion.x[left], motion.x[left] + change, motion.xd, motion.xdd)


def _quintic(
    motion: PlatformMotion,
    left: IntArray,
    x0: Array,
    x1: Array,
    xd: Array,
    xdd: Array,
) -> Callable[[Array], Array]:
    """Return the piecewise quintic through (I, n) interval ends, in Bernstein form."""
    right = left + 1
    h = (motion.t[right] - motion.t[left])[:, None]
    control = np.stack(
        [
            x0,
            x0 + h * xd[left] / 5.0,
            x0 + 2.0 * h * xd[left] / 5.0 + h * h * xdd[left] / 20.0,
            x1 - 2.0 * h * xd[right] / 5.0 + h * h * xdd[right] / 20.0,
            x1 - h * xd[right] / 5.0,
            x1,
        ]
    )
    polynomial = BPoly(control, np.append(motion.t[left], motion.t[-1]))
    return lambda times: np.asarray(polynomial(times))


def _poses(robot: Robot, motion: PlatformMotion) -> Callable[[Array], Array]:
    rows = [AXES.index(axis) for axis in robot.platform.axes] if robot.platform else []
    rate, acceleration = np.zeros((len(motion), 6)), np.zeros((len(motion), 6))
    rate[:, rows], acceleration[:, rows] = motion.xd, motion.xdd
    left = np.flatnonzero(np.diff(motion.t) > 0.0)
    right = left + 1
    h = (motion.t[right] - motion.t[left])[:, None]
    R = motion.x[:, :3, :3]
    turn = Rotation.from_matrix(R[right] @ R[left].transpose(0, 2, 1)).as_rotvec()
    end_rate = _rotation_vector_rate(turn, rate[right, 3:])
    position = _quintic(motion, left, motion.x[left, :3, 3], motion.x[right, :3, 3], rate[:, :3], acceleration[:, :3])
    control = np.stack([np.zeros_like(turn), h * rate[left, 3:] / 3.0, turn - h * end_rate / 3.0, turn])
    knots = np.append(motion.t[left], motion.t[-1])
    rotation_vector = BPoly(control, knots)

    def at(times: Array) -> Array:
        interval = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(left) - 1)
        poses = np.zeros((len(times), 4, 4))
        poses[:, :3, :3] = Rotation.from_rotvec(rotation_vector(times)).as_matrix() @ R[left[interval]]
        poses[:, :3, 3] = position(times)
        poses[:, 3, 3] = 1.0
        return poses

    return at


def _rotation_vector_rate(phi: Array, omega: Array) -> Array:
    """Return φ̇ (N, 3) of R = exp([φ]×) R0 that turns with the world-axes angular velocity ω (N, 3).

    The inverse of the left Jacobian of SO(3): φ̇ = ω − ½ φ×ω + (1 − (θ/2) cot(θ/2))/θ² φ×(φ×ω), θ = |φ|.
    """
    theta = np.linalg.norm(phi, axis=1, keepdims=True)
    half = 0.5 * np.maximum(theta, _SMALL_ANGLE)
    factor = np.where(theta > _SMALL_ANGLE, (1.0 - half / np.tan(half)) / (4.0 * half**2), 1.0 / 12.0)
    turned = np.cross(phi, omega)
    result: Array = omega - 0.5 * turned + factor * np.cross(phi, turned)
    return result


_SMALL_ANGLE = 1e-4
"""Below it the first term of the series, 1/12, is exact to 1e-11 and the closed form loses digits."""
