"""Random states of a robot, on the branch of its reference: every check is made on them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, read_only
from redundancy_pin.errors import UnreachablePoseError
from redundancy_pin.kinematics.branch import BranchEnd, ClosedState, follower
from redundancy_pin.kinematics.closed_state import closed_around, typical_margin
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import difference, in_working_mode, moved
from redundancy_pin.loading import load_with
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import coordinate_unit
from redundancy_pin.status import SampleStatus

STATES_PER_BATCH, FEWEST_BATCHES = 250, 4
"""Most states of one random walk, and the number of walks that even a small check makes."""

_STEP, _PULL, _TRIES = 0.1, 0.9, 60
"""Typical step between states, characteristic lengths or rad, the share of the way from the reference that is kept
before it, so that states spread 0.23 about the reference, and the shorter steps that are tried before an error."""

_SPEED, _ACCELERATION = 1.0, 5.0
"""Typical rates, characteristic lengths or rad per s, and second rates."""

_NEAR_SHARE = 0.1
"""Share of a robot's typical singularity margin of K below which a pose counts as near type I, if that is less than
``NEAR_SINGULAR_MARGIN``: short levers and many joints make small margins everywhere."""

REASONS: Mapping[str, str] = {
    "unreachable": "a pose is unreachable: the chains do not close",
    "branch_lost": "the branch is lost: another one is nearer, or in another working mode",
    "near_type_i": "near a type I singularity",
    "near_type_ii": "near a type II singularity",
    "underactuated": "fewer motors than degrees of freedom of the platform",
    "not_finite": "the forces of the independent joints are not finite",
    "massless": "a free motion moves hardly any mass: forces do not determine its acceleration",
    "rank_loss": "the closure rows in use lose rank",
    "other_branch": "this backend reaches another assembly of the loops there; declared working_modes tell them apart",
    "no_backend": "this backend does not cover the robot, or cannot be compiled",
}
"""Why states are skipped, by the name of the reason."""


@dataclass(frozen=True, eq=False)
class RandomStates:
    """N random states of a robot; the rates are independent of one another and of the positions.

    Attributes:
        robot: the robot.
        motion: platform coordinates, each reached from those before, with rates.
        carriers: carriers anywhere on their tracks, with rates.
        skipped: number of coordinates that were drawn and not used, by reason (a key of ``REASONS``).
    """

    robot: Robot
    motion: PlatformMotion
    carriers: CarrierMotion
    skipped: Mapping[str, int] = field(default_factory=dict)


def batches(samples: int) -> tuple[int, ...]:
    """Return the number of states in each batch, ``samples`` in all."""
    size = max(1, min(STATES_PER_BATCH, -(-samples // FEWEST_BATCHES)))
    whole, rest = divmod(samples, size)
    return (size,) * whole + ((rest,) if rest else ())


def random_states(
    source: str,
    samples: int,
    seed: int,
    index: int = 0,
    *,
    trust: bool = False,
    settings: tuple[tuple[str, object], ...] = (),
) -> RandomStates:
    """Return states of a robot with the arguments ``settings``; states with different ``index`` are independent.

    Every second batch of a robot without working modes starts at another assembly mode or reference, because the
    reference of a file may be near a singularity, as zeros often are.

    Raises:
        UnreachablePoseError: no coordinates that can be used are found.
        RedundancyPinError: the robot does not load.
    """
    robot, rng = load_with(source, dict(settings), trust=trust), np.random.default_rng([seed, index])
    if index % 2 and robot.working_modes is None:
        around = closed_around(constraint_system(robot))
        if len(regular := np.flatnonzero(around.regular)):
            robot = replace(robot, q_reference=read_only(around.q[rng.choice(regular)]))
    return walk(robot, samples, rng)


def walk(robot: Robot, samples: int, rng: np.random.Generator) -> RandomStates:
    """Return random states of a robot, drawn from its reference on; raises as ``random_states``."""
    unit, skipped = coordinate_unit(robot), Counter[str]()
    near = min(NEAR_SINGULAR_MARGIN, _NEAR_SHARE * typical_margin(follower(robot).system))
    home, tries = follower(robot).home, 0
    here, poses = home, list[Array]()
    while len(poses) < samples:
        step = _STEP * 0.9**tries * unit * rng.normal(size=robot.n)
        x = moved(robot, home.x, _PULL * difference(robot, here.x, home.x) + step)
        there = follower(robot).advance(here, x)
        if isinstance(there, ClosedState) and not (reason := _unusable(robot, there, near)):
            here, tries = there, max(0, tries - 1)
            poses.append(there.x)
            continue
        skipped[_end_reason(robot, there) if isinstance(there, BranchEnd) else reason] += 1
        tries += 1
        if tries == _TRIES:
            why = "; ".join(f"{REASONS[reason]}: {count}" for reason, count in skipped.most_common())
            raise UnreachablePoseError(
                f"No random state of {robot.name} can be reached in {_TRIES} draws ({why}).",
                remedy="Check the robot's reference and its workspace.",
            )
    rates, second_rates = (size * unit * rng.normal(size=(samples, robot.n)) for size in (_SPEED, _ACCELERATION))
    motion = PlatformMotion(0.1 * np.arange(samples), np.array(poses), rates, second_rates, check_rates=False)
    return RandomStates(robot, motion, _random_carriers(robot, samples, rng), dict(skipped))


def _random_carriers(robot: Robot, samples: int, rng: np.random.Generator) -> CarrierMotion:
    lower, upper = (np.array([getattr(limit, end) for limit in robot.carrier_limits]) for end in ("lower", "upper"))
    half = 0.5 * (upper - lower)
    s = 0.5 * (upper + lower) + half * rng.uniform(-0.95, 0.95, (samples, robot.k))
    sd, sdd = (size * half * rng.normal(size=(samples, robot.k)) for size in (_SPEED, _ACCELERATION))
    return CarrierMotion(s, sd, sdd, check_rates=False)


def _unusable(robot: Robot, state: ClosedState, near: float) -> str:
    """Return why a closed state is not used; empty if it is."""
    if not in_working_mode(robot, state.q[None])[0]:
        return "branch_lost"
    return "near_type_i" if state.margin < near else ""


def _end_reason(robot: Robot, end: BranchEnd) -> str:
    if end.status is SampleStatus.UNREACHABLE:
        return "unreachable"
    # closed in the working mode, but K turns too fast for steps: as near a singularity
    return "near_type_i" if in_working_mode(robot, end.q[None])[0] else "branch_lost"
