"""Targets whole turns of a joint away: one turn is followed, and the others are multiples of it.

The loops do not see whole turns of a joint that counts them (``robot.whole_turns``). Where a turn of that joint brings
every other one back except for whole turns, the next turn does the same. With gears several turns may pass
until it does; they are followed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, BoolArray, frozen
from redundancy_pin.kinematics.branch import BranchEnd, ClosedState, Follower
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.robot.types import slides
from redundancy_pin.robot.whole_turns import EXACT, FARTHEST, MOST_TURNS, TURN, WHOLE, counted_turns
from redundancy_pin.status import SampleStatus


def advance_turns(own: Follower, here: ClosedState, x: Array) -> ClosedState | BranchEnd:
    """Return the state at coordinates x on the branch of a state, as ``Follower.advance``.

    Whole turns of independent joints are followed one joint after the other, and only until they repeat. More than
    ``MOST_TURNS`` turns that do not repeat are not followed; ``BranchEnd.reason`` states it.

    Example:
        >>> advance_turns(own, own.home, own.home.x + 200.0 * np.pi).q
    """
    columns = counted_turns(own.robot).coordinates
    if np.abs(x[columns]).max(initial=0.0) > FARTHEST:
        return own.diagnose(here, x)
    counts = np.trunc((x[columns] - here.x[columns]) / TURN)
    if counts.any():
        at = x.copy()
        at[columns] -= TURN * counts
        reached = own.follow(here, frozen(at))
        for column, count in zip(columns.tolist(), counts.tolist(), strict=True):
            reached = _turned(own, reached, column, count) if isinstance(reached, ClosedState) else reached
        if isinstance(reached, ClosedState):
            reached = own.follow(reached, frozen(x))
        if isinstance(reached, ClosedState) or reached.reason:
            return reached
    return own.follow(here, frozen(x))


def _turned(own: Follower, start: ClosedState, column: int, count: float) -> ClosedState | BranchEnd:
    """Return the state so many whole turns of one coordinate on."""
    robot, here, left, repeating, followed = own.robot, start, abs(count), False, 0
    step = math.copysign(TURN, count)
    in_vain = left > MOST_TURNS and not _may_repeat(robot, column)
    while left:
        if in_vain or followed == MOST_TURNS:
            return BranchEnd(
                SampleStatus.UNREACHABLE,
                _beyond(start.x, column, count * TURN),
                here,
                here.q,
                math.nan,
                reason=f"The pose lies {abs(count):.0f} turns of {robot.independent_joints[column]!r} away, which do "
                f"not repeat; at most {MOST_TURNS} of such turns are followed.",
            )
        left, followed = left - 1.0, followed + 1
        reached = own.follow(here, _beyond(start.x, column, (abs(count) - left) * step))
        if isinstance(reached, BranchEnd):
            return reached
        here = reached
        shift = None if repeating or not left else _whole_turns_between(robot, start.q, here.q)
        if shift is not None:
            repeating, repeats = True, float(left // followed)
            further = here.q + repeats * shift
            keeps = counted_turns(robot).kept | (np.abs(further) < EXACT)
            left -= repeats * followed
            x = _beyond(start.x, column, (abs(count) - left) * step)
            # Γ does not see whole turns
            here = replace(here, q=frozen(np.where(keeps, further, here.q - shift)), x=x)
    return here


def _beyond(x: Array, column: int, angle: float) -> Array:
    """Return coordinates with an angle added to one: that of all turns at once, since a sum of steps would drift."""
    result = x.copy()
    result[column] += angle
    return frozen(result)


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
