"""Which joints count their turns, and how many turns are followed.

A bounded revolute joint counts its turns: as an independent joint it has any number of them for a coordinate.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import BoolArray, IntArray, read_only
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
