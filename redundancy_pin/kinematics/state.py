"""Lift a platform motion to the tree: q, v, a, with the branch kept and checked sample by sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.errors import UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.branch import find_on_branch
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.continuation import follow, initial_guess
from redundancy_pin.kinematics.coordinates import require_matching
from redundancy_pin.kinematics.lift_checks import (
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
        reachable: (N,) false where no configuration was found; everything else is NaN there.
        serial_margin: (N,) lower bound of the distance to a type I singularity, scaled; see ``projection.Projection``.
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
    serial_margin: Array


def lift(robot: Robot, motion: PlatformMotion, *, mark_unreachable: bool = False) -> TreeMotion:
    """Lift a platform motion to the tree.

    The first pose is found on the branch of the reference configuration (and in the robot's working mode); from there
    the branch is followed continuously.

    Args:
        robot: the robot.
        motion: N samples of the independent coordinates.
        mark_unreachable: mark samples without a configuration with NaN instead of raising.

    Raises:
        InputError: the motion does not have the robot's coordinates.
        UnreachablePoseError: no configuration closes the chains; carries sample and gap.
        SingularPoseError: a sample is a type I singularity.
        WorkingModeError: the motion leaves the working mode, or cannot be followed continuously.
    """
    require_matching(robot, motion)
    system = ConstraintSystem(robot)
    first, start = _first_reachable(system, motion, mark_unreachable)
    x = motion.x[first:]
    anchors = follow(system, x, start, resume=mark_unreachable)
    if not mark_unreachable:
        require_branch(system, motion, anchors)
    guess = initial_guess(system, x, anchors)
    if first:
        guess = np.concatenate([np.repeat(start[None], first, axis=0), guess])
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
    v = np.einsum("nvi,ni->nv", gamma, motion.xd)
    bias_c, bias_x = system.bias(solution.state, v)
    rate = np.concatenate([-bias_c, motion.xdd - bias_x], axis=1)
    a = np.zeros_like(v)
    a[:, system.pose_columns] = np.einsum("npr,nr->np", projection.inverse, rate)
    w = gamma[:, robot.actuated_velocity, :].transpose(0, 2, 1)
    for array in (solution.q, v, a, gamma):
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


def _first_reachable(system: ConstraintSystem, motion: PlatformMotion, mark: bool) -> tuple[int, Array]:
    """Return the first sample found on the branch, and its configuration."""
    stride = max(1, len(motion) // 50)  # a motion that is out of reach throughout is not searched sample by sample
    for sample in range(0, len(motion), stride):
        try:
            return sample, find_on_branch(system, motion.x[sample], sample=sample)
        except (UnreachablePoseError, WorkingModeError):
            if not mark:
                raise
    return 0, np.array(system.robot.q_reference)
