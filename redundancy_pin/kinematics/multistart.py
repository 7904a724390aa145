"""Inverse kinematics of one pose by multistart: draw starts, close them, choose the nearest in the working mode.

Where no start falls to the working mode, the configurations of several starts are put together leg by leg. With the
platform at its pose the legs are independent of each other: each joint belongs to the chain that carries the platform
or to one leg. Of six legs with two inverse displacements each, one random start in 64 falls to a given working mode,
but one in two has a given leg right.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.kinematics.assembly import Assembly, assemble, integrate
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import in_working_mode, mode_indicator
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import ROUNDING
from redundancy_pin.robot.lookup import find_joint, find_joint_index, find_link
from redundancy_pin.robot.scales import position_unit, turning_velocities
from redundancy_pin.robot.whole_turns import counted_turns

SEED = 20141
"""Of all random starts, any number: the same answer every time."""

SHORTEST_STEP = 2.0**-5
"""A start that needs shorter Newton steps than this is given up: as many starts succeed, in a third of the time."""

_STARTS = (16, 240)
"""Random starts of each round, three times the first where joints are known. Of four legs with two elbows each one
start in sixteen falls to a given mode, which 16 miss with a chance of 36 %; of six legs one in 64, which 240 miss with
2 %."""


class PoseSolution(NamedTuple):
    """What multistart reached.

    Attributes:
        q: (nq,) the configuration; where none closes in the working mode, the one with the smallest residual.
        residual: its closure residual, m.
        in_mode: whether it closes in the working mode.
    """

    q: Array
    residual: float
    in_mode: bool


def draw_starts(
    system: ConstraintSystem,
    q: Array,
    count: int,
    rng: np.random.Generator,
    *,
    spread: float | None = None,
    along: Array | None = None,
) -> Array:
    """Return configurations (count, nq), evenly distributed about q (nq,); carriers stay.

    Args:
        system: closures and platform rows.
        q: (nq,) the middle.
        count: how many.
        rng: the source of random numbers.
        spread: half-width of each velocity, rad or characteristic lengths; if left out, half a turn or one length.
        along: (f, p) orthonormal displacements without units: starts are displaced along these alone, the joint that
            moves farthest by its half-width.
    """
    model, columns = system.robot.model, system.pose_columns
    width = np.where(turning_velocities(system.robot)[columns], np.pi, 1.0) if spread is None else spread
    around = rng.uniform(-1.0, 1.0, (count, len(columns))) * width
    if along is not None:
        around = around @ along.T @ along
        farthest = np.abs(around / width).max(axis=1, keepdims=True)
        around /= np.where(farthest > 0.0, farthest, 1.0)
    steps = np.zeros((count, model.nv))
    steps[:, columns] = around * system.step_unit
    return integrate(model, np.repeat(q[None], count, axis=0), steps)


def multistart(
    system: ConstraintSystem,
    guess: Array,
    x: Array,
    *,
    known: IntArray | None = None,
    prescribed: Array | None = None,
) -> PoseSolution:
    """Assemble one pose from a guess and from more and more random starts, until one closes in the working mode.

    Of the first round in which one does, the configuration nearest to the guess is taken: positions count in
    characteristic lengths and rad, angles modulo a turn. With ``known`` the first round has random starts too, half of
    them with the known joints at the guess: Newton from the guess alone may leave it for another branch, above all
    where the other joints start stretched.

    Args:
        system: closures and platform rows.
        guess: (nq,) configuration, carriers stay.
        x: (n,) coordinates, or a pose (4, 4).
        known: indices in q of the joints whose guess means something; the others decide among equals only.
        prescribed: (nq,) the guess with the joints that the pose prescribes where they end: one more start, and what
            distances are measured from.

    Example:
        >>> q, residual, in_mode = multistart(system, np.array(robot.q_reference), x)
    """
    robot, best = system.robot, PoseSolution(guess, float("inf"), False)
    origin = guess if prescribed is None else prescribed
    closed = guess[None][:0]
    for starts in _rounds(system, guess, origin, known):
        solution, q, usable = _close(system, starts, x, guess)
        residual = np.where(np.isfinite(solution.residual), solution.residual, np.inf)
        if residual.min() < best.residual:
            best = PoseSolution(q[int(residual.argmin())], float(residual.min()), False)
        if not usable.any():
            closed = np.concatenate([closed, q[solution.closed]])
            mixed = mixed_legs(robot, closed, guess)
            if mixed is None:
                continue
            solution, q, usable = _close(system, mixed[None], x, guess)
        if usable.any():
            nearest = _nearest(robot, q, usable, origin, known)
            return PoseSolution(q[nearest], float(solution.residual[nearest]), True)
    return best


def _rounds(system: ConstraintSystem, guess: Array, prescribed: Array, known: IntArray | None) -> Iterator[Array]:
    """Yield the starts (count, nq) of each round."""
    rng = np.random.default_rng(SEED)
    if known is None:
        yield guess[None]
    else:
        around = draw_starts(system, guess, 3 * _STARTS[0], rng)
        half = len(around) // 2
        around[:half, known] = guess[known]
        yield np.concatenate([guess[None], prescribed[None], around])
    for count in _STARTS:
        yield draw_starts(system, guess, count, rng)


def _close(system: ConstraintSystem, starts: Array, x: Array, guess: Array) -> tuple[Assembly, Array, BoolArray]:
    """Return what Newton reaches at one pose, the configurations with angles wrapped, and which are in the mode."""
    solution = assemble(system, starts, np.repeat(x[None], len(starts), axis=0), shortest_step=SHORTEST_STEP)
    q = wrapped(system.robot, solution.q, guess)
    return solution, q, solution.closed & in_working_mode(system.robot, q)


def _nearest(robot: Robot, q: Array, usable: BoolArray, origin: Array, known: IntArray | None) -> int:
    """Return which of the usable configurations (N, nq) is nearest to another.

    The known joints decide, all joints among equals; neither the order of the starts nor rounding does.
    """
    columns = np.arange(len(origin)) if known is None or not len(known) else known
    away = (q - origin) / position_unit(robot)
    short, turning = away.copy(), _free_turns(robot)
    short[:, turning] = (away[:, turning] + np.pi) % (2.0 * np.pi) - np.pi
    distance = np.where(usable, np.abs(short[:, columns]).sum(axis=1), np.inf)
    equal = distance <= distance.min() + ROUNDING
    return int(np.argmin(np.where(equal, np.abs(away).sum(axis=1), np.inf)))


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
    coupled = [{find_joint_index(model, name) for name in each.joints} for each in robot.couplings]
    for tied in (each - of_platform for each in (*loops, *coupled)):
        parts = [part for part in parts if not part & tied] + [tied.union(*(part for part in parts if part & tied))]
    spans = [[range(model.joints[j].idx_q, model.joints[j].idx_q + model.joints[j].nq) for j in part] for part in parts]
    return [np.array(sorted(c for span in part for c in span), dtype=np.intp) for part in spans if part]


def wrapped(robot: Robot, q: Array, guess: Array | None = None) -> Array:
    """Return q with the angles of bounded revolute joints in (−π, π], except for those that the pose prescribes.

    Where that is beyond a joint's limits, and the turn nearest to the guess (nq,) is not, it is that turn.
    """
    result: Array = q.copy()
    columns = _free_turns(robot)
    result[:, columns] = short = np.pi - (np.pi - q[:, columns]) % (2.0 * np.pi)
    if guess is not None:
        ends = robot.model.lowerPositionLimit - ROUNDING, robot.model.upperPositionLimit + ROUNDING  # rad
        lower, upper = (limit[columns] for limit in ends)
        near = short + 2.0 * np.pi * np.round((guess[columns] - short) / (2.0 * np.pi))
        allowed, within = ((lower <= angle) & (angle <= upper) for angle in (short, near))
        result[:, columns] = np.where(~allowed & within, near, short)
    return result


def _free_turns(robot: Robot) -> IntArray:
    """Return the indices in q of angles whose whole turns nothing counts: of dependent joints without a coupling."""
    turns = counted_turns(robot)
    return np.flatnonzero(turns.angles & ~turns.kept)
