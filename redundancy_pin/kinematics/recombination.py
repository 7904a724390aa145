"""Configurations of one pose put together leg by leg from several, to reach a working mode that none of them is in.

With the platform held, the legs are independent of each other: each joint belongs to the chain that carries the
platform or to one leg. Of six legs with two inverse displacements each, one random start in 64 falls to a given working
mode, but one in two has a given leg right.
"""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.modes import mode_indicator
from redundancy_pin.robot import Robot


def recombined(system: ConstraintSystem, q: Array, guess: Array) -> Array | None:
    """Return a configuration whose legs are taken from several configurations of the same pose.

    Args:
        system: closures and platform rows.
        q: (N, nq) closed configurations of one pose.
        guess: (nq,) configuration to stay near to, leg by leg.

    Returns:
        (nq,) a candidate in the robot's working mode, whose closures the caller checks; None where some leg is in the
        wanted mode in none of the configurations.
    """
    robot = system.robot
    if robot.working_modes is None or len(q) == 0:
        return None
    right = mode_indicator(robot, q) * np.array(robot.working_mode, dtype=float) > 0.0
    indicators = [robot.model.joints[robot.model.getJointId(name)].idx_q for name in robot.working_modes.joints]
    result = guess.copy()
    for columns in _independent_parts(robot):
        judged = [leg for leg, column in enumerate(indicators) if column in columns]
        usable: BoolArray = right[:, judged].all(axis=1)
        if not usable.any():
            return None
        away = np.where(usable, np.abs(q[:, columns] - guess[columns]).sum(axis=1), np.inf)
        result[columns] = q[int(np.argmin(away)), columns]
    return result


def _independent_parts(robot: Robot) -> list[IntArray]:
    """Return the indices in q of each set of joints that the pose and the closures tie together, carriers left out."""
    model = robot.model

    def ancestors(joint: int) -> set[int]:
        return set(model.supports[joint].tolist()) - {0}

    def body(frame: str) -> int:
        return int(model.frames[model.getFrameId(frame)].parentJoint)

    if robot.platform is not None:
        held = ancestors(body(robot.platform.frame))
    else:
        held = {model.getJointId(name) for name in robot.independent_joints}
    parts: list[set[int]] = [held]
    for closure in robot.closures:
        tied = (ancestors(body(closure.frame_a)) | ancestors(body(closure.frame_b))) - held
        parts = [part for part in parts if not part & tied] + [tied.union(*(part for part in parts if part & tied))]
    return [
        np.array(
            [c for j in sorted(part) for c in range(model.joints[j].idx_q, model.joints[j].idx_q + model.joints[j].nq)],
            dtype=np.intp,
        )
        for part in parts
        if part
    ]
