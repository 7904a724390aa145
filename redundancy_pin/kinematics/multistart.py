"""Inverse kinematics of one pose by multistart: a configuration in the robot's working mode, from many guesses.

Where no start falls to the working mode, the configurations of several starts are put together leg by leg. With the
platform at its pose the legs are independent of each other: each joint belongs to the chain that carries the platform
or to one leg. Of six legs with two inverse displacements each, one random start in 64 falls to a given working mode,
but one in two has a given leg right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.kinematics.assembly import Assembly, assemble, integrate
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import in_working_mode, mode_indicator
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import ROUNDING, random_spread
from redundancy_pin.robot.lookup import find_joint, find_joint_index, find_link
from redundancy_pin.robot.scales import position_unit
from redundancy_pin.robot.types import slides

_STARTS = (1, 16, 240)
"""Starts in each round: the guess itself, then random ones."""
_NEAR_STARTS = 24
"""Random starts of each kind where the nearest configuration is wanted: of four legs with two elbows each about one
start in sixteen falls to the right branch, and the known joints do the rest."""
_SHORTEST_STEP = 2.0**-5
"""A start that needs shorter Newton steps than this is given up: as many starts succeed, in a third of the time."""
_SEED = 20141  # any fixed number: the same answer every time


class PoseSolution(NamedTuple):
    """What multistart reached.

    Attributes:
        q: (nq,) the configuration; where none closes in the working mode, the one with the smallest gap.
        gap: its closure residual, m.
        in_mode: whether it closes in the working mode.
    """

    q: Array
    gap: float
    in_mode: bool


def multistart(system: ConstraintSystem, guess: Array, x: Array) -> PoseSolution:
    """Assemble one pose from a guess, and from more and more random starts around it until one succeeds.

    Of the first round in which one closes in the working mode, the nearest to the guess (nq,) is taken.
    """
    rng = np.random.default_rng(_SEED)
    best = PoseSolution(guess, float("inf"), False)
    for starts in _STARTS:
        solution = _assembled(system, _around(system, guess, starts, rng), x)
        q = wrapped(system.robot, solution.q)
        usable = solution.closed & in_working_mode(system.robot, q)
        if usable.any():
            nearest = int(np.argmin(np.where(usable, np.abs(q - guess).sum(axis=1), np.inf)))
            return PoseSolution(q[nearest], float(solution.gap[nearest]), True)
        mixed = _from_mixed_legs(system, q[solution.closed], guess, x)
        if mixed is not None:
            return mixed
        gap = np.where(np.isfinite(solution.gap), solution.gap, np.inf)
        if gap.min() < best.gap:
            best = PoseSolution(q[int(gap.argmin())], float(gap.min()), False)
    return best


def multistart_nearest(
    system: ConstraintSystem, guess: Array, x: Array, listed: IntArray, prescribed: Array
) -> PoseSolution:
    """Assemble one pose in the configuration nearest to what is known of it.

    Many starts are solved, half of them with the known joints at their guess, and the nearest of all solutions is
    taken: Newton from the guess alone may leave it for another branch, above all where the joints left out start
    stretched. ``listed`` are the indices in q of the joints whose guess means something; the others do not count for
    the distance. ``prescribed`` (nq,) is the guess with the joints that the pose prescribes where they end: Newton
    starts from there too, and that is what is nearest where no joint is listed.
    """
    rng = np.random.default_rng(_SEED)
    around = [_around(system, guess, _NEAR_STARTS, rng) for _ in range(2)]
    around[0][:, listed] = guess[listed]
    solution = _assembled(system, np.concatenate([guess[None], prescribed[None], *around]), x)
    q = wrapped(system.robot, solution.q, guess)
    usable = solution.closed & in_working_mode(system.robot, q)
    if not usable.any():
        return _from_mixed_legs(system, q[solution.closed], guess, x) or multistart(system, guess, x)
    columns = listed if len(listed) else np.arange(len(guess))
    unit = position_unit(system.robot)
    away = (q[:, columns] - prescribed[columns]) / unit[columns]
    turning = np.isin(columns, _bounded_angles(system.robot))
    away[:, turning] = (away[:, turning] + np.pi) % (2.0 * np.pi) - np.pi
    # the joints that are not listed decide among equals, so that the answer does not hang on the order of the starts
    distance = np.abs(away).sum(axis=1).round(9) + 1e-12 * np.abs((q - prescribed) / unit).sum(axis=1)
    nearest = int(np.argmin(np.where(usable, distance, np.inf)))
    return PoseSolution(q[nearest], float(solution.gap[nearest]), True)


def mixed_legs(robot: Robot, q: Array, guess: Array) -> Array | None:
    """Return a configuration with each leg from the one of several closed ones (N, nq) of a pose nearest to a guess.

    It is a candidate in the robot's working mode, whose closures are still to be checked; None where some leg is in the
    wanted mode in none of the configurations.
    """
    if robot.working_modes is None or len(q) == 0:
        return None
    right = mode_indicator(robot, q) * np.array(robot.working_mode, dtype=float) > 0.0
    indicators = [find_joint(robot.model, name).idx_q for name in robot.working_modes.joints]
    result, unit = guess.copy(), position_unit(robot)
    for columns in _independent_parts(robot):
        usable: BoolArray = right[:, [leg for leg, column in enumerate(indicators) if column in columns]].all(axis=1)
        if not usable.any():
            return None
        apart = np.abs(q[:, columns] - guess[columns]) / unit[columns]
        away = np.where(usable, apart.sum(axis=1), np.inf)
        result[columns] = q[int(np.argmin(away)), columns]
    return result


def _from_mixed_legs(system: ConstraintSystem, q: Array, guess: Array, x: Array) -> PoseSolution | None:
    candidate = mixed_legs(system.robot, q, guess)
    if candidate is None:
        return None
    solution = _assembled(system, candidate[None], x)
    settled = wrapped(system.robot, solution.q)
    if not (solution.closed[0] and in_working_mode(system.robot, settled)[0]):
        return None
    return PoseSolution(settled[0], float(solution.gap[0]), True)


def _independent_parts(robot: Robot) -> list[IntArray]:
    """Return the indices in q of each set of joints that the pose and the closures tie together, carriers left out."""
    model = robot.model

    def ancestors(frame: str) -> set[int]:
        return set(model.supports[find_link(model, frame).parentJoint].tolist()) - {0}

    if robot.platform is not None:
        of_platform = ancestors(robot.platform.frame)
    else:
        of_platform = {find_joint_index(model, name) for name in robot.independent_joints}
    parts: list[set[int]] = [of_platform]
    loops = [ancestors(closure.frame_a) | ancestors(closure.frame_b) for closure in robot.closures]
    pairs = [{find_joint_index(model, name) for name in (each.joint, each.of) if name} for each in robot.couplings]
    for tied in (each - of_platform for each in (*loops, *pairs)):
        parts = [part for part in parts if not part & tied] + [tied.union(*(part for part in parts if part & tied))]
    spans = [[range(model.joints[j].idx_q, model.joints[j].idx_q + model.joints[j].nq) for j in part] for part in parts]
    return [np.array(sorted(c for span in part for c in span), dtype=np.intp) for part in spans if part]


def _around(system: ConstraintSystem, guess: Array, starts: int, rng: np.random.Generator) -> Array:
    """Return (starts, nq) random configurations about a guess (nq,); of one start the guess itself."""
    model, columns = system.robot.model, system.pose_columns
    steps = np.zeros((starts, model.nv))
    if starts > 1:
        steps[:, columns] = rng.uniform(-1.0, 1.0, (starts, len(columns))) * random_spread(system.robot)[columns]
    return integrate(model, np.repeat(guess[None], starts, axis=0), steps)


def _assembled(system: ConstraintSystem, starts: Array, x: Array) -> Assembly:
    """Assemble one pose from starts (N, nq), all at once."""
    return assemble(system, starts, np.repeat(x[None], len(starts), axis=0), shortest_step=_SHORTEST_STEP)


def wrapped(robot: Robot, q: Array, guess: Array | None = None) -> Array:
    """Return q with the angles of bounded revolute joints in (−π, π], but for those that the pose prescribes.

    Where that is beyond a joint's limits, and the turn nearest to the guess (nq,) is not, it is that turn.
    """
    result: Array = q.copy()
    prescribed = {find_joint(robot.model, name).idx_q for name in robot.independent_joints}
    columns = [column for column in _bounded_angles(robot) if column not in prescribed]
    result[:, columns] = short = np.pi - (np.pi - q[:, columns]) % (2.0 * np.pi)
    if guess is not None:
        ends = robot.model.lowerPositionLimit - ROUNDING, robot.model.upperPositionLimit + ROUNDING  # rad
        lower, upper = (limit[columns] for limit in ends)
        near = short + 2.0 * np.pi * np.round((guess[columns] - short) / (2.0 * np.pi))
        allowed, within = ((lower <= angle) & (angle <= upper) for angle in (short, near))
        result[:, columns] = np.where(~allowed & within, near, short)
    return result


def _bounded_angles(robot: Robot) -> list[int]:
    """Return the indices in q of bounded revolute joints; of coupled ones the turns count."""
    coupled = {name for each in robot.couplings for name in (each.joint, each.of)}
    joints = zip(list(robot.model.names)[1:], list(robot.model.joints)[1:], strict=True)
    bounded = (j for name, j in joints if j.nq == 1 and str(name) not in coupled)
    return [int(j.idx_q) for j in bounded if not slides(j)]
