"""Assembly modes: all configurations that positions of the main actuators allow, by Newton's method from random starts.

``forward_kinematics`` follows one of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import AGREEMENT_TOLERANCE, Array, BoolArray, Frozen, IntArray, checked, positive, read_only
from redundancy_pin.errors import UnreachablePoseError
from redundancy_pin.kinematics.assembly import assemble, evaluated
from redundancy_pin.kinematics.branch import SAME_CONFIGURATION
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import coordinates, with_independent_joints
from redundancy_pin.kinematics.forward_kinematics import followed_motors, motor_mismatch
from redundancy_pin.kinematics.multistart import SEED, SHORTEST_STEP, draw_starts, wrapped
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import out_of_range
from redundancy_pin.robot.lookup import find_link_index

_STARTS, _MOST_FAILED = 128, 512
"""Random starts of a round, and of all where none closes."""

_UNSEEN_CHANCE, _MEAN_HITS = 1e-3, 6
"""Random starts go on until one more has a chance below the first of finding a mode that none has found, and each mode
was found as often as the second on average: one that is half as likely as the mean is missed with chance e⁻³."""


@dataclass(frozen=True, eq=False)
class AssemblyModes(Frozen):
    """All configurations found for positions of the motors; made by ``assembly_modes``.

    Attributes:
        robot: the robot.
        q: (M, nq) a configuration of each mode, angles in (−π, π]; that nearest to the reference first.
        x: (M, n) coordinates or (M, 4, 4) poses of the platform.
        margin: (M,) lower bound of the scaled distance to type II, where modes meet.
        in_range: (M,) whether all joints are within their limits.
        hits: (M,) how many random starts led to each.
        unseen: estimated chance that one more start finds another mode (Good and Turing: the share of modes that were
            found once among all successful starts).
    """

    robot: Robot
    q: Array
    x: Array
    margin: Array
    in_range: BoolArray
    hits: IntArray
    unseen: float

    def __len__(self) -> int:
        """Return the number of modes."""
        return len(self.q)


def assembly_modes(robot: RobotLike, actuated: ArrayLike, *, most_starts: int = 2048) -> AssemblyModes:
    """Return the configurations that positions of the motors allow: two of a five-bar, up to forty of a Gough platform.

    Newton from random starts, the same ones every time, until another start would hardly find a new mode. Modes are
    alike where joints, platform and closures are at the same places: a universal joint turned over is the same mode.

    Args:
        robot: the robot, or its name or path.
        actuated: (m,) positions of the main actuators, m and rad.
        most_starts: bound on the number of starts; a Gough platform takes up to 2,000.

    Raises:
        InputError: wrong shape.
        UnsupportedRobotError: fewer motors than freedoms.
        UnreachablePoseError: no start closes the chains.

    Example:
        >>> len(rp.assembly_modes("2rpr", [0.4, 0.5]))
        2
    """
    robot, most_starts = as_robot(robot), int(positive(most_starts, "most_starts", ""))
    u = np.array(checked(actuated, "actuated", (robot.m,)))
    reference, system = np.array(robot.q_reference), constraint_system(robot)
    followed = followed_motors(system, reference)
    motors = constraint_system(with_independent_joints(robot, tuple(robot.actuated[j] for j in followed)))
    rng, length = np.random.default_rng(SEED), robot.characteristic_length
    q, keys, hits = np.zeros((0, robot.model.nq)), np.zeros((0, len(_frames(robot, reference)))), np.zeros(0, np.intp)
    residual, starts = np.inf, 0
    while starts < (most_starts if len(q) else min(most_starts, _MOST_FAILED)):
        guess = draw_starts(motors, reference, _STARTS, rng)
        if not starts:
            guess[0] = reference
        solved = assemble(motors, guess, np.repeat(u[None, followed], _STARTS, axis=0), shortest_step=SHORTEST_STEP)
        off = np.fmax(solved.residual, motor_mismatch(system, followed, np.repeat(u[None], _STARTS, axis=0), solved.q))
        starts, residual = starts + _STARTS, min(residual, float(np.nanmin(off)))
        for one in solved.q[solved.closed & (off < AGREEMENT_TOLERANCE * length)]:
            key = _frames(robot, one)
            same = np.flatnonzero(np.abs(keys - key).max(axis=1, initial=0.0) < SAME_CONFIGURATION * length)
            if len(same):
                hits[same[0]] += 1
            else:
                q, keys, hits = np.vstack([q, one]), np.vstack([keys, key]), np.append(hits, 1)
        if (hits == 1).sum() < _UNSEEN_CHANCE * hits.sum() and hits.mean() >= _MEAN_HITS:
            break
    if not len(q):
        raise UnreachablePoseError(
            f"No configuration of {robot.name} has its motors at {np.round(u, 6).tolist()}: the chains stay open by "
            f"{residual:.3g} m in {starts} attempts.",
            remedy="Move the motors back towards the reference.",
            residual=residual,
        )
    order = np.argsort(np.abs(keys - _frames(robot, reference)).max(axis=1), kind="stable")
    q = wrapped(motors.robot, q)[order]
    parts = (
        read_only(q),
        read_only(coordinates(robot, system.evaluate(q))),
        evaluated(motors, q).margin,
        read_only(~out_of_range(robot, q, motion=False)),
        read_only(hits[order]),
    )
    return AssemblyModes(robot, *parts, unseen=float((hits == 1).sum() / hits.sum()))


def _frames(robot: Robot, q: Array) -> Array:
    """Return the origins of joints and of frames of closures and platform, and the platform's axes, m, at one state."""
    model = robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    pin.updateFramePlacements(model, data)
    parts = [*(data.oMi[k].translation for k in range(1, model.njoints))]
    parts += [data.oMf[find_link_index(model, name)].translation for name in constraint_system(robot).support]
    if robot.platform is not None:
        platform = data.oMf[find_link_index(model, robot.platform.frame)]
        parts.append(robot.characteristic_length * platform.rotation.ravel())
    return np.concatenate(parts)
