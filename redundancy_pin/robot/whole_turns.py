"""Targets whole turns of a joint away: one turn is followed, and the others are multiples of it.

A bounded revolute joint counts its turns: as an independent joint it has any number of them for a coordinate. The
loops do not see whole turns. Where a turn of that joint brings every other one back but for whole turns of its own, the
next turn does the same. With gears several turns may pass until it does; they are followed.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, BoolArray, IntArray, read_only
from redundancy_pin.errors import UnreachablePoseError
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.robot.types import Robot, slides

TURN = 2.0 * np.pi

MOST_TURNS = 10_000
"""Turns that are followed one by one where they do not repeat: a hundred seconds in Python, 0.1 s by generated code."""

WHOLE = 1e-9
"""rad or characteristic lengths by which joints may miss whole turns; Newton's method comes to 1e-13."""

EXACT = 2.0**15
"""rad beyond which a dependent joint loses its turns: the rounding of the angle, 4e-12, would open loops."""

FARTHEST = 2.0**25
"""rad beyond which closures cannot be told to be closed: the angle is known to 7e-9."""

Follow = Callable[[Array, Array, Array], Array | None]
"""From a configuration closed at coordinates to others, straight; None where that fails."""


class CountedTurns(NamedTuple):
    """What counts turns.

    Attributes:
        coordinates: columns of x that do.
        angles: (nq,) entries of q that are angles whose turns count.
        kept: (nq,) those whose turns count for others: independent joints and coupled ones.
    """

    coordinates: IntArray
    angles: BoolArray
    kept: BoolArray


@lru_cache(maxsize=64)
def counted_turns(robot: Robot) -> CountedTurns:
    """Return what counts turns in a robot."""
    model = robot.model
    joints = {str(name): joint for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True)}
    bounded = {name: int(joint.idx_q) for name, joint in joints.items() if joint.nq == 1 and not slides(joint)}
    coordinates = np.array([i for i, name in enumerate(robot.independent_joints) if name in bounded], dtype=np.intp)
    angles, kept = np.zeros((2, model.nq), dtype=bool)
    angles[list(bounded.values())] = True
    coupled = {name for each in robot.couplings for name in each.joints}
    kept[[place for name, place in bounded.items() if name in coupled or name in robot.independent_joints]] = True
    return CountedTurns(read_only(coordinates), read_only(angles), read_only(kept))


def follow_whole_turns(robot: Robot, q: Array, x: Array, target: Array, follow: Follow) -> Array | None:
    """Return the configuration at target coordinates on the straight way from others, or None.

    Args:
        robot: the robot.
        q: (nq,) a closed configuration.
        x: (n,) its coordinates, or a pose.
        target: (n,) coordinates, or a pose.
        follow: what follows the branch.

    Raises:
        UnreachablePoseError: more than ``MOST_TURNS`` turns that do not repeat: nobody knows the branch there.
    """
    turns = counted_turns(robot)
    if np.abs(target[turns.coordinates]).max(initial=0.0) > FARTHEST:
        return None
    counts = np.trunc((target[turns.coordinates] - x[turns.coordinates]) / TURN)
    if counts.any():
        at = target.copy()
        at[turns.coordinates] -= TURN * counts
        reached = follow(q, x, at)
        for column, count in zip(turns.coordinates, counts, strict=True):
            reached = None if reached is None else _advance_turns(robot, reached, at, int(column), float(count), follow)
        reached = None if reached is None else follow(reached, at, target)
        if reached is not None:
            return reached
    return follow(q, x, target)


def _advance_turns(robot: Robot, q: Array, at: Array, column: int, count: float, follow: Follow) -> Array | None:
    """Return the configuration so many turns of one coordinate on; ``at`` is moved along."""
    start, here, left, period = q, q, abs(count), 0.0
    first, step, followed = float(at[column]), np.copysign(TURN, count), 0.0
    if left > MOST_TURNS and not _may_repeat(robot, column):
        raise _too_many_turns(robot, column, count)
    while left:
        if followed == MOST_TURNS:
            raise _too_many_turns(robot, column, count)
        before = at.copy()
        followed += 1.0
        at[column] = first + (abs(count) - left + 1.0) * step  # a sum of thousands of steps would drift
        there = follow(here, before, at)
        if there is None:
            return None
        here, left = there, left - 1.0
        shift = None if period or not left else _whole_turns_between(robot, start, here)
        if shift is not None:
            period, repeats = followed, float(left // followed)
            further = here + repeats * shift
            keeps = counted_turns(robot).kept | (np.abs(further) < EXACT)
            here = np.where(keeps, further, here - shift)
            left -= repeats * period
            at[column] = first + (abs(count) - left) * step
    return here


def _too_many_turns(robot: Robot, column: int, count: float) -> UnreachablePoseError:
    return UnreachablePoseError(
        f"The pose lies {abs(count):.0f} turns of {robot.independent_joints[column]!r} away, which do not repeat; at "
        f"most {MOST_TURNS} of such turns are followed.",
        turns=count,
    )


def are_too_many_turns_away(robot: Robot, x: Array, targets: Array) -> BoolArray:
    """Return (N,) whether coordinates lie more turns away than are followed, turns that cannot repeat.

    Args:
        robot: the robot.
        x: (n,) coordinates, or a pose.
        targets: (N, n) coordinates, or poses.
    """
    columns = counted_turns(robot).coordinates
    if not len(columns):
        return np.zeros(len(targets), dtype=bool)
    turns = np.abs(targets[:, columns] - x[columns]) / TURN
    most = [np.inf if _may_repeat(robot, column) else MOST_TURNS + 1.0 for column in columns.tolist()]
    return np.asarray((turns >= most).any(axis=1))


def _may_repeat(robot: Robot, column: int) -> bool:
    """Return whether whole turns of a coordinate can bring back all joints geared to it within ``MOST_TURNS``.

    A gear ratio must be a fraction of whole numbers. Joints that are coupled by a curve, or slide, do not come back.
    """
    joint = robot.independent_joints[column]
    for coupling in robot.couplings:
        powers = coupling.polynomial[1:] if coupling.of == joint else ()
        slope = sum(powers[:1]) + sum(factor for name, factor in coupling.also if name == joint)
        if not slope and not any(powers):
            continue
        turns = Fraction(slope).limit_denominator(MOST_TURNS).denominator
        off = turns * slope - round(turns * slope)
        curved, sliding = any(powers[1:]), slides(find_joint(robot.model, coupling.joint))
        if curved or sliding or abs(off) * TURN > WHOLE:
            return False
    return True


def _whole_turns_between(robot: Robot, start: Array, end: Array) -> Array | None:
    """Return (nq,) the whole turns from one configuration to another, rad; None where they are not whole."""
    shift = np.where(counted_turns(robot).angles, TURN * np.round((end - start) / TURN), 0.0)
    rest = pin.difference(robot.model, start, end - shift)
    return shift if np.abs(rest / velocity_unit(robot)).max(initial=0.0) < WHOLE else None
