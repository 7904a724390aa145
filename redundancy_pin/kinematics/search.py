"""Search for a configuration of one pose in the robot's working mode, from many starts."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.assembly import Assembly, assemble, integrate
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import turning_velocities
from redundancy_pin.kinematics.modes import in_working_mode

_STARTS = (1, 16, 240)
"""Starts in each round of a search: the guess itself, then random ones."""
_SHORTEST_STEP = 2.0**-5
"""A start that needs shorter Newton steps than this is given up: as many starts succeed, in a third of the time."""
_SEED = 20141  # any fixed number: the search must give the same answer every time


def search(system: ConstraintSystem, guess: Array, x: Array) -> tuple[Array, float, bool]:
    """Assemble one pose from a guess, and from more and more random starts around it until one succeeds.

    Returns:
        The configuration (nq,) nearest to the guess, of the first round in which one closes in the working mode, its
        gap and True; or, when none does, the one with the smallest gap, that gap and False.
    """
    rng = np.random.default_rng(_SEED)
    best_q, best_gap = guess, float("inf")
    for starts in _STARTS:
        solution = _assemble_around(system, guess, x, starts, rng)
        q = _wrapped(system, solution.q)
        usable = solution.closed & in_working_mode(system.robot, q)
        if usable.any():
            nearest = int(np.argmin(np.where(usable, np.abs(q - guess).sum(axis=1), np.inf)))
            return q[nearest], float(solution.gap[nearest]), True
        gap = np.where(np.isfinite(solution.gap), solution.gap, np.inf)
        if gap.min() < best_gap:
            best_q, best_gap = q[int(gap.argmin())], float(gap.min())
    return best_q, best_gap, False


def _assemble_around(
    system: ConstraintSystem, guess: Array, x: Array, starts: int, rng: np.random.Generator
) -> Assembly:
    model, columns = system.robot.model, system.pose_columns
    steps = np.zeros((starts, model.nv))
    if starts > 1:
        spread = np.where(turning_velocities(system.robot)[columns], np.pi, system.robot.characteristic_length)
        steps[:, columns] = rng.uniform(-1.0, 1.0, (starts, len(columns))) * spread
    around = integrate(model, np.repeat(guess[None], starts, axis=0), steps)
    goal = np.repeat(x[None], starts, axis=0)
    return assemble(system, around, goal, shortest_step=_SHORTEST_STEP)


def _wrapped(system: ConstraintSystem, q: Array) -> Array:
    """Return q with the angles of bounded revolute joints in (−π, π]."""
    result: Array = q.copy()
    model = system.robot.model
    for index in range(1, model.njoints):
        joint = model.joints[index]
        if joint.nq == 1 and not str(joint.shortname()).startswith("JointModelP"):
            result[:, joint.idx_q] = np.pi - (np.pi - q[:, joint.idx_q]) % (2.0 * np.pi)
    return result
