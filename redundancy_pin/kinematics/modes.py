"""Working modes: which of its inverse displacements each leg is in."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.robot import Robot


def mode_indicator(robot: Robot, q: Array) -> Array:
    """Return (N, legs) the signed distance of each leg from the change of its working mode.

    Positive in mode +1, negative in mode −1, zero where the two meet (a type I singularity of that leg): sin(q) of a
    revolute indicator joint, q (m) of a prismatic one, times the declared sign.

    Args:
        robot: the robot; without declared modes the result has no columns.
        q: (N, nq) configurations.
    """
    return _indicator(robot)(q)


class ModeIndicator:
    """``mode_indicator`` of one robot, the joints looked up once.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        modes = robot.working_modes
        columns, sine = [], []
        for name in modes.joints if modes else ():
            joint = robot.model.joints[robot.model.getJointId(name)]
            columns.append(joint.idx_q + (joint.nq == 2))  # of a continuous joint the second number is the sine
            sine.append(joint.nq == 1 and not str(joint.shortname()).startswith("JointModelP"))
        self._columns = np.array(columns, dtype=np.intp)
        self._sine = np.array(sine, dtype=bool)
        self._signs = np.array(modes.signs if modes else (), dtype=np.float64)

    def __call__(self, q: Array) -> Array:
        """Return (N, legs) the indicator at (N, nq) configurations."""
        value = q.take(self._columns, 1)
        signed: Array = self._signs * np.where(self._sine, np.sin(value), value)
        return signed


_indicator = lru_cache(maxsize=64)(ModeIndicator)


def working_modes(robot: Robot, q: Array) -> IntArray:
    """Return (N, legs) the working mode of configurations, ±1 a leg, 0 exactly between the two."""
    return np.sign(mode_indicator(robot, q)).astype(np.intp)


def in_working_mode(robot: Robot, q: Array) -> BoolArray:
    """Return (N,) whether configurations are in the robot's own working mode (true where it declares none)."""
    wanted = np.array(robot.working_mode, dtype=float)
    result: BoolArray = (mode_indicator(robot, q) * wanted > 0.0).all(axis=1)
    return result


def all_working_modes(robot: Robot) -> tuple[tuple[int, ...], ...]:
    """Return every working mode of a robot, (+1, …, +1) first; one empty mode where none is declared."""
    legs = len(robot.working_modes.joints) if robot.working_modes else 0
    return tuple(itertools.product((1, -1), repeat=legs))


def mode_name(mode: tuple[int, ...]) -> str:
    """Return a mode as text, ``(1, -1, 1)`` as ``"+-+"``."""
    return "".join("+" if sign > 0 else "-" for sign in mode)
