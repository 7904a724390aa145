"""Random robots in random smooth motion: the states every check is made on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, read_only
from redundancy_pin.errors import (
    DeclarationError,
    RedundancyPinError,
    SingularPoseError,
    UnreachablePoseError,
    WorkingModeError,
)
from redundancy_pin.kinematics.branch import BranchEnd, follower
from redundancy_pin.kinematics.closed_state import closed_around, typical_margin
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import all_working_modes, in_working_mode
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.loading import load_robot, load_with
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.status import SampleStatus

STATES_PER_CASE = 250
"""Most states that share one draw of parameters and one motion."""

FEWEST_CASES = 4
"""Draws of parameters and modes that even a small check makes, where it has the states."""

_HARMONICS = 3
_SPREAD = 0.2
"""Relative spread of lengths and masses around their defaults: wide enough to unmask a parameter read wrongly, narrow
enough that most draws still close."""
TRIES, _PLAIN_TRIES = 60, 55
"""Draws; of a robot that does not vary, those whose motion has to be far from singularities all along."""

_NEAR_SHARE = 0.1
"""Share of a robot's typical singularity margin of K below which a pose counts as near type I, if that is less than
``NEAR_SINGULAR_MARGIN``: short levers and many joints make small margins everywhere."""

REASONS: Mapping[str, str] = {
    "unreachable": "a pose is unreachable: the chains do not close",
    "branch_lost": "the branch is lost: another one is nearer, or in another working mode",
    "near_type_i": "near a type I singularity",
    "near_type_ii": "near a type II singularity",
    "not_singular": "the determinant of W is not zero to rounding",
    "not_closed": "the drawn lengths do not close",
    "underactuated": "fewer motors than degrees of freedom of the platform",
    "not_finite": "the forces of the independent joints are not finite",
    "ill_conditioned": "the forward dynamics have less than three digits",
    "massless": "a part of the tree moves no mass: forces do not say how fast it moves",
    "too_close": "too close in time to another state for differences",
    "no_carriers": "drawn without carriers",
    "refused": "refused for another reason",
}
"""Why states and motions are skipped, by the name of the reason."""


def reason_of(error: RedundancyPinError) -> str:
    """Return the reason (a key of ``REASONS``) for which a motion cannot be used."""
    kinds = {
        UnreachablePoseError: "unreachable",
        WorkingModeError: "branch_lost",
        SingularPoseError: "near_type_i",
        DeclarationError: "not_closed",
    }
    return kinds.get(type(error), "refused")


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
        skipped: how many motions were drawn before and not used, by reason (a key of ``REASONS``).
    """

    robot: Robot
    t: Array
    path: Wave
    tracks: Wave
    skipped: Mapping[str, int] = field(default_factory=dict)

    def motion(self, t: Array) -> PlatformMotion:
        """Return the platform motion at strictly increasing times (N,)."""
        value, rate, acceleration = (self.path(t, order) for order in range(3))
        if self.robot.platform is None or not self.robot.platform.is_pose:
            return PlatformMotion(t, value, rate, acceleration)
        return _pose_motion(t, value, rate, acceleration)

    def carriers(self, t: Array) -> CarrierMotion:
        """Return the carrier motion at times (N,)."""
        return CarrierMotion(*(self.tracks(t, order) for order in range(3)))


def batches(samples: int) -> tuple[int, ...]:
    """Return how many states each case holds, ``samples`` in all."""
    size = max(1, min(STATES_PER_CASE, -(-samples // FEWEST_CASES)))
    whole, rest = divmod(samples, size)
    return (size,) * whole + ((rest,) if rest else ())


def random_case(
    source: str,
    samples: int,
    seed: int,
    index: int = 0,
    *,
    vary: bool = True,
    carriers: bool | None = None,
    masses: Masses = Masses.SOME,
    trust: bool = False,
    settings: tuple[tuple[str, object], ...] = (),
) -> RandomCase:
    """Return one case of so many states; cases of different ``index`` are independent draws.

    A robot that may ``vary`` gets random arguments, gravity and working mode. ``carriers`` forces its argument of that
    name, and ``masses`` says which of those that are zero by default get a positive value. One that does not has the
    arguments of ``settings``.
    """
    # the first draw has its carriers, so that nothing about carriers goes unchecked by chance
    with_carriers = True if carriers is None and index == 0 else carriers
    rng = np.random.default_rng([seed, index])
    skipped: Counter[str] = Counter()
    # what does not vary is what its files say, draw after draw
    nominal = None if vary else load_with(source, dict(settings), trust=trust) if settings else _nominal(source, trust)
    for attempt in range(TRIES):
        try:
            robot = nominal or random_robot(source, rng, with_carriers, masses)
        except DeclarationError as error:
            skipped[reason_of(error)] += 1  # these lengths do not close in this mode: draw again
            continue
        if not vary and attempt % 2 and robot.working_modes is None:
            robot = _elsewhere(robot, rng)
        case = _random_motion(robot, samples, rng, amplitude=0.6 * 0.9**attempt)
        try:
            if not vary and attempt < _PLAIN_TRIES and (reason := _why_not_followed(case)):
                skipped[reason] += 1
                continue
            inverse_kinematics(robot, case.motion(np.linspace(0.0, case.t[-1], 200)))
            inverse_kinematics(robot, case.motion(case.t))  # these are farther apart in places
        except RedundancyPinError as error:
            skipped[reason_of(error)] += 1  # the swing leaves the workspace: draw again, smaller
            continue
        return replace(case, skipped=dict(skipped))
    why = "; ".join(f"{REASONS[reason]}: {count}" for reason, count in skipped.most_common())
    raise UnreachablePoseError(
        f"No random motion of {source} can be followed in {TRIES} draws ({why}).",
        remedy="Check the robot's reference and its workspace.",
    )


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
def _nominal(source: str, trust: bool = False) -> Robot:
    return load_robot(source, trust=trust)


def _elsewhere(robot: Robot, rng: np.random.Generator) -> Robot:
    """Return the robot with another reference: that of its file may be next to a singularity, as zeros often are."""
    around = closed_around(constraint_system(robot))
    choice = np.flatnonzero(around.regular)
    return replace(robot, q_reference=read_only(around.q[rng.choice(choice)])) if len(choice) else robot


def _why_not_followed(case: RandomCase) -> str:
    """Return why a motion cannot be followed from the reference, far from singularities; empty if it can."""
    own = follower(case.robot)
    here, near = own.home, min(NEAR_SINGULAR_MARGIN, _NEAR_SHARE * typical_margin(own.system))
    for pose in case.motion(np.linspace(0.0, case.t[-1], 200)).x:
        reached = own.advance(here, pose)
        if isinstance(reached, BranchEnd):
            if reached.status is SampleStatus.UNREACHABLE:
                return "unreachable"
            # on its branch, which turns too fast for steps: as near a singularity
            return "near_type_i" if in_working_mode(case.robot, reached.q[None])[0] else "branch_lost"
        if reached.margin < near:
            return "near_type_i"
        here = reached
    return ""


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
