"""Search for a configuration of one pose in the robot's working mode, from many starts.

Configurations of one pose put together leg by leg from several, to reach a working mode that none of them is in.

With the platform held, the legs are independent of each other: each joint belongs to the chain that carries the
platform or to one leg. Of six legs with two inverse displacements each, one random start in 64 falls to a given working
mode, but one in two has a given leg right.
"""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.kinematics.assembly import Assembly, assemble, integrate
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import turning_velocities
from redundancy_pin.kinematics.modes import in_working_mode, mode_indicator
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


_STARTS = (1, 16, 240)
"""Starts in each round of a search: the guess itself, then random ones."""
_NEAR_STARTS = 24
"""Random starts of each kind in the search for the nearest configuration: of four legs with two elbows each about one
start in sixteen falls to the right branch, and the known joints do the rest."""
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
        mixed = _recombined(system, q[solution.closed], guess, x)
        if mixed is not None:
            return mixed
        gap = np.where(np.isfinite(solution.gap), solution.gap, np.inf)
        if gap.min() < best_gap:
            best_q, best_gap = q[int(gap.argmin())], float(gap.min())
    return best_q, best_gap, False


def search_nearest(system: ConstraintSystem, guess: Array, x: Array, listed: IntArray) -> tuple[Array, float, bool]:
    """Assemble one pose in the configuration nearest to what is known of it.

    Many starts are solved, half of them with the known joints at their guess, and the nearest of all solutions is
    taken: Newton from the guess alone may leave it for another branch, above all where the joints left out start
    stretched.

    Args:
        system: closures and platform rows.
        guess: (nq,) configuration to start from.
        x: (n,) coordinates or a pose.
        listed: indices in q of the joints whose guess means something; the others do not count for the distance.

    Returns:
        As ``search``.
    """
    rng = np.random.default_rng(_SEED)
    found = [_assemble_around(system, guess, x, 1, rng)]
    found += [_assemble_around(system, guess, x, _NEAR_STARTS, rng, kept=kept) for kept in (listed, listed[:0])]
    q = _wrapped(system, np.concatenate([solution.q for solution in found]))
    closed = np.concatenate([solution.closed for solution in found])
    usable = closed & in_working_mode(system.robot, q)
    if not usable.any():
        return _recombined(system, q[closed], guess, x) or search(system, guess, x)
    columns = listed if len(listed) else np.arange(len(guess))
    away = q[:, columns] - guess[columns]
    turning = np.isin(columns, _angle_positions(system))
    away[:, turning] = (away[:, turning] + np.pi) % (2.0 * np.pi) - np.pi
    # the joints that are not listed decide among equals, so that the answer does not hang on the order of the starts
    distance = np.abs(away).sum(axis=1).round(9) + 1e-12 * np.abs(q - guess).sum(axis=1)
    nearest = int(np.argmin(np.where(usable, distance, np.inf)))
    return q[nearest], float(np.concatenate([solution.gap for solution in found])[nearest]), True


def _recombined(system: ConstraintSystem, q: Array, guess: Array, x: Array) -> tuple[Array, float, bool] | None:
    """Return a configuration in the working mode whose legs come from several closed ones (N, nq), if there is one."""
    candidate = recombined(system, q, guess)
    if candidate is None:
        return None
    solution = assemble(system, candidate[None], x[None], shortest_step=_SHORTEST_STEP)
    settled = _wrapped(system, solution.q)
    if not (solution.closed[0] and in_working_mode(system.robot, settled)[0]):
        return None
    return settled[0], float(solution.gap[0]), True


def _assemble_around(
    system: ConstraintSystem,
    guess: Array,
    x: Array,
    starts: int,
    rng: np.random.Generator,
    kept: IntArray | None = None,
) -> Assembly:
    model, columns = system.robot.model, system.pose_columns
    steps = np.zeros((starts, model.nv))
    if starts > 1:
        spread = np.where(turning_velocities(system.robot)[columns], np.pi, system.robot.characteristic_length)
        steps[:, columns] = rng.uniform(-1.0, 1.0, (starts, len(columns))) * spread
    around = integrate(model, np.repeat(guess[None], starts, axis=0), steps)
    if kept is not None:
        around[:, kept] = guess[kept]
    goal = np.repeat(x[None], starts, axis=0)
    return assemble(system, around, goal, shortest_step=_SHORTEST_STEP)


def _wrapped(system: ConstraintSystem, q: Array) -> Array:
    """Return q with the angles of bounded revolute joints in (−π, π]."""
    result: Array = q.copy()
    for column in _angle_positions(system):
        result[:, column] = np.pi - (np.pi - q[:, column]) % (2.0 * np.pi)
    return result


def _angle_positions(system: ConstraintSystem) -> list[int]:
    """Return the indices in q of bounded revolute joints."""
    joints = list(system.robot.model.joints)[1:]
    revolute = [j for j in joints if j.nq == 1 and not str(j.shortname()).startswith("JointModelP")]
    return [int(joint.idx_q) for joint in revolute]
