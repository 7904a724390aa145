"""Lift a platform motion to the tree: q, v, a, with the branch kept and checked sample by sample."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.branch import find_on_branch
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.continuation import follow, initial_guess, take_up
from redundancy_pin.kinematics.coordinates import require_matching
from redundancy_pin.kinematics.lift_checks import (
    branch_breaks,
    require_branch,
    require_closed,
    require_continuous,
    require_mode,
    require_regular,
)
from redundancy_pin.kinematics.modes import in_working_mode
from redundancy_pin.kinematics.projection import project
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot


@dataclass(frozen=True, eq=False)
class TreeMotion:
    """Motion of the tree with the chains closed, carriers at zero; made by ``lift``.

    Carriers do not change the pose: their positions, rates and accelerations are added to their own entries of q, v, a.

    Attributes:
        robot: the robot.
        motion: the platform motion.
        q: (N, nq) configurations.
        v: (N, nv) tree velocities, v = Γ ẋ.
        a: (N, nv) tree accelerations, a = Γ ẍ + the part due to J̇_c v and J̇_x v.
        gamma: (N, nv, n) velocity per unit of each independent velocity, J_c Γ = 0.
        W: (N, n, m) actuation matrix, Γᵀ Sᵀ.
        gap: (N,) closure gap, m or rad.
        reachable: (N,) false where no configuration was found in the working mode, and at a type I singularity; q, v,
            a, gamma and W are NaN there.
        serial_margin_bound: (N,) lower bound of the distance to a type I singularity, scaled; see
            ``projection.Projection``.
    """

    robot: Robot
    motion: PlatformMotion
    q: Array
    v: Array
    a: Array
    gamma: Array
    W: Array
    gap: Array
    reachable: BoolArray
    serial_margin_bound: Array


def lift(robot: Robot, motion: PlatformMotion, *, mark_unreachable: bool = False) -> TreeMotion:
    """Lift a platform motion to the tree.

    The first pose is found on the branch of the reference configuration (and in the robot's working mode); from there
    the branch is followed continuously.

    Args:
        robot: the robot.
        motion: N samples of the independent coordinates.
        mark_unreachable: instead of raising, mark samples without a configuration in the working mode, and type I
            singularities, with NaN. Behind them the motion is taken up again in the working mode; a robot that
            declares no modes may come back on another branch, but never without a marked sample in between.

    Raises:
        InputError: the motion does not have the robot's coordinates.
        UnreachablePoseError: no configuration closes the chains; carries sample and gap.
        SingularPoseError: a sample is a type I singularity.
        WorkingModeError: the motion leaves the working mode, or cannot be followed continuously.
    """
    require_matching(robot, motion)
    system = ConstraintSystem(robot)
    guess = _guess(system, motion, mark_unreachable)
    solution = assemble(system, guess, motion.x, max_iterations=30)
    projection = project(system, solution.state)
    singular = projection.margin == 0.0
    if not mark_unreachable:
        require_closed(motion, solution.gap)
        require_regular(motion, singular)
        require_mode(robot, motion, solution.q)
        require_continuous(system, motion, solution.q, projection.gamma)
    good = solution.closed & ~singular & in_working_mode(robot, solution.q)
    gamma = projection.gamma
    if mark_unreachable:
        lost = np.where(good[:, None], solution.q, np.nan)
        good[branch_breaks(system, motion, lost, gamma)] = False
    v = np.einsum("nvi,ni->nv", gamma, motion.xd)
    bias_c, bias_x = system.bias(solution.state, v)
    rate = np.concatenate([-bias_c, motion.xdd - bias_x], axis=1)
    a = np.zeros_like(v)
    a[:, system.pose_columns] = np.einsum("npr,nr->np", projection.inverse, rate)
    w = gamma[:, robot.actuated_velocity, :].transpose(0, 2, 1)
    for array in (solution.q, v, a, gamma, w):
        array[~good] = np.nan
    return TreeMotion(
        robot,
        motion,
        read_only(solution.q),
        read_only(v),
        read_only(a),
        read_only(gamma),
        read_only(np.ascontiguousarray(w)),
        read_only(solution.gap),
        read_only(good),
        read_only(projection.margin),
    )


def _guess(system: ConstraintSystem, motion: PlatformMotion, mark: bool) -> Array:
    """Return (N, nq) guesses along the branch: from the first sample found on it onward, and from there back."""
    found = _first_reachable(system, motion, mark)
    if found is None:
        return np.repeat(system.robot.q_reference[None], len(motion), axis=0)
    first, start = found
    onward = motion.x[first:]
    anchors = follow(system, onward, start, resume=mark)
    if not mark:
        require_branch(system, motion, anchors)
    guess = initial_guess(system, onward, anchors)
    if first == 0:
        return guess
    back = motion.x[first::-1]
    before = initial_guess(system, back, follow(system, back, start, resume=mark))
    return np.concatenate([before[:0:-1], guess])


def _first_reachable(system: ConstraintSystem, motion: PlatformMotion, mark: bool) -> tuple[int, Array] | None:
    """Return the first sample found on the branch, and its configuration."""
    try:
        return 0, find_on_branch(system, motion.x[0])
    except (UnreachablePoseError, SingularPoseError, WorkingModeError):
        if not mark:
            raise
    near = take_up(system, motion.x, np.array(system.robot.q_reference))
    if near is not None:
        return near[:2]
    for sample in np.linspace(0, len(motion) - 1, _FAR_SEARCHES).round().astype(int)[1:]:
        with contextlib.suppress(UnreachablePoseError, SingularPoseError, WorkingModeError):
            return int(sample), find_on_branch(system, motion.x[sample], sample=int(sample))
    return None


_FAR_SEARCHES = 5
"""Samples of a motion that no plain Newton closes anywhere for which many starts are tried before it is given up."""
