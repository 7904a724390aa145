"""Working modes: which of its inverse displacements each leg is in."""

from __future__ import annotations

import itertools

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
    if robot.working_modes is None:
        return np.zeros((len(q), 0))
    columns = []
    for name, sign in zip(robot.working_modes.joints, robot.working_modes.signs, strict=True):
        joint = robot.model.joints[robot.model.getJointId(name)]
        if joint.nq == 2:
            value = q[:, joint.idx_q + 1]
        elif str(joint.shortname()).startswith("JointModelP"):
            value = q[:, joint.idx_q]
        else:
            value = np.sin(q[:, joint.idx_q])
        columns.append(sign * value)
    return np.stack(columns, axis=1)


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
