"""Random robots of random size, in random smooth motion: shipped models with their arguments drawn."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array
from redundancy_pin.crosscheck.states import RandomStates
from redundancy_pin.errors import DeclarationError, RedundancyPinError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.coordinates import all_working_modes
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.loading import load_robot, load_with
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale

_HARMONICS = 3
_SPREAD = 0.2
"""Relative spread of lengths and masses around their defaults: wide enough to unmask a parameter read wrongly, narrow
enough that most draws still close."""
TRIES = 60
"""Draws before an error."""


class Masses(Enum):
    """What becomes of masses that are zero by default."""

    ALL = "all positive"
    SOME = "some positive"
    ZERO_STAYS_ZERO = "zero"


@dataclass(frozen=True, eq=False)
class Wave:
    """A smooth random function of time, a sum of harmonics, with exact derivatives.

    Attributes:
        mean: (n,) value around which it swings.
        amplitude, phase: (h, n); frequency: (h,), rad/s.
    """

    mean: Array
    amplitude: Array
    phase: Array
    frequency: Array

    def __call__(self, t: Array, order: int = 0) -> Array:
        """Return (N, n) values, or derivatives of the given order, at times (N,)."""
        angle = self.frequency[None, :, None] * t[:, None, None] + self.phase[None] + 0.5 * np.pi * order
        scaled = self.amplitude * (self.frequency**order)[:, None]
        return np.asarray((scaled[None] * np.sin(angle)).sum(axis=1) + (self.mean if order == 0 else 0.0))


@dataclass(frozen=True, eq=False)
class RandomCase:
    """A robot with random parameters and mode, in random motion of platform and carriers.

    Attributes:
        robot: the robot.
        t: (N,) times at which it is looked at, s.
        path: motion of the independent coordinates (three translations and two angles for poses).
        tracks: motion of the carriers.
    """

    robot: Robot
    t: Array
    path: Wave
    tracks: Wave

    def motion(self, t: Array) -> PlatformMotion:
        """Return the platform motion at strictly increasing times (N,)."""
        value, rate, acceleration = (self.path(t, order) for order in range(3))
        if self.robot.platform is None or not self.robot.platform.is_pose:
            return PlatformMotion(t, value, rate, acceleration)
        return _pose_motion(t, value, rate, acceleration)

    def carriers(self, t: Array) -> CarrierMotion:
        """Return the carrier motion at times (N,)."""
        return CarrierMotion(*(self.tracks(t, order) for order in range(3)))

    @property
    def states(self) -> RandomStates:
        """The states at its times, as the cross-check takes them."""
        return RandomStates(self.robot, self.motion(self.t), self.carriers(self.t))


def random_case(
    source: str,
    samples: int,
    seed: int,
    index: int = 0,
    *,
    carriers: bool | None = None,
    masses: Masses = Masses.SOME,
) -> RandomCase:
    """Return one case of so many states; cases of different ``index`` are independent draws.

    ``carriers`` forces the argument of that name, and ``masses`` says which of those that are zero by default get a
    positive value.
    """
    # the first draw has its carriers, so that nothing about carriers goes unchecked by chance
    with_carriers = True if carriers is None and index == 0 else carriers
    rng = np.random.default_rng([seed, index])
    for attempt in range(TRIES):
        try:
            robot = random_robot(source, rng, with_carriers, masses)
        except DeclarationError:
            continue  # these lengths do not close in this mode: draw again
        case = _random_motion(robot, samples, rng, amplitude=0.6 * 0.9**attempt)
        try:
            inverse_kinematics(robot, case.motion(np.linspace(0.0, case.t[-1], 200)))
            inverse_kinematics(robot, case.motion(case.t))  # these are farther apart in places
        except RedundancyPinError:
            continue  # the motion leaves the workspace: draw again, smaller
        return case
    raise AssertionError(f"no motion of {source} in {TRIES} draws")


def random_robot(
    source: str, rng: np.random.Generator, carriers: bool | None = None, masses: Masses = Masses.SOME
) -> Robot:
    """Load a robot with random arguments, gravity and working mode; DeclarationError where the lengths do not close."""
    nominal = _nominal(source)
    arguments: dict[str, object] = {}
    for name, value in nominal.parameters.items():
        if name == "carriers":  # other flags stay: what they bring may have no closed form
            arguments[name] = carriers if carriers is not None else bool(rng.random() < 0.8)
        elif isinstance(value, float) and value != 0.0:
            arguments[name] = value * rng.uniform(1.0 - _SPREAD, 1.0 + _SPREAD)
        elif isinstance(value, float) and name.endswith("_mass"):
            present = masses is Masses.ALL or (masses is Masses.SOME and rng.random() < 0.7)
            arguments[name] = rng.uniform(0.1, 1.0) if present else 0.0
    modes = all_working_modes(nominal)
    mode = modes[int(rng.integers(len(modes)))] or None
    return load_with(source, arguments, gravity=tuple(rng.normal(0.0, 6.0, 3)), working_mode=mode)


@lru_cache
def _nominal(source: str) -> Robot:
    return load_robot(source)


def _random_motion(robot: Robot, samples: int, rng: np.random.Generator, amplitude: float) -> RandomCase:
    home = follower(robot).home.x
    is_pose = home.ndim == 2
    centre = np.concatenate([home[:3, 3], [0.0, 0.0]]) if is_pose else home
    size = (
        robot.characteristic_length * np.array([1, 1, 1, 0.5, 0.5])
        if is_pose
        else robot.characteristic_length / row_scale(robot)
    )
    share = rng.dirichlet(np.ones(_HARMONICS))[:, None] * amplitude * size * rng.uniform(0.2, 1.0, len(size))
    path = Wave(
        centre + 0.3 * amplitude * size * rng.uniform(-1.0, 1.0, len(size)),
        share,
        rng.uniform(0.0, 2.0 * np.pi, share.shape),
        rng.uniform(1.0, 6.0, _HARMONICS),
    )
    half = np.array([0.5 * (limit.upper - limit.lower) for limit in robot.carrier_limits])
    middle = np.array([0.5 * (limit.upper + limit.lower) for limit in robot.carrier_limits])
    waves = rng.dirichlet(np.ones(_HARMONICS))[:, None] * half * rng.uniform(0.3, 0.95, robot.k)
    tracks = Wave(middle, waves, rng.uniform(0.0, 2.0 * np.pi, waves.shape), rng.uniform(1.0, 8.0, _HARMONICS))
    return RandomCase(robot, np.sort(rng.uniform(0.0, 6.0, samples)), path, tracks)


def _pose_motion(t: Array, value: Array, rate: Array, acceleration: Array) -> PlatformMotion:
    """Turn three translations and two angles into poses R = R_z(a) R_y(b) with world-aligned twists."""
    a, b = value[:, 3], value[:, 4]
    poses = np.zeros((len(t), 4, 4))
    poses[:, :3, :3] = Rotation.from_euler("ZY", np.stack([a, b], axis=1)).as_matrix()
    poses[:, :3, 3], poses[:, 3, 3] = value[:, :3], 1.0
    zero, one = np.zeros_like(a), np.ones_like(a)
    z_axis = np.stack([zero, zero, one], axis=1)
    y_turned = np.stack([-np.sin(a), np.cos(a), zero], axis=1)
    y_rate = -np.stack([np.cos(a), np.sin(a), zero], axis=1) * rate[:, 3:4]
    omega = rate[:, 3:4] * z_axis + rate[:, 4:5] * y_turned
    alpha = acceleration[:, 3:4] * z_axis + acceleration[:, 4:5] * y_turned + rate[:, 4:5] * y_rate
    return PlatformMotion(
        t, poses, np.concatenate([rate[:, :3], omega], axis=1), np.concatenate([acceleration[:, :3], alpha], axis=1)
    )
