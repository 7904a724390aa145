"""Lift a platform motion to the tree: q, v, a, with the branch kept and checked sample by sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, read_only
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.branch import find_on_branch
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.continuation import continuous, follow, initial_guess
from redundancy_pin.kinematics.coordinates import require_matching
from redundancy_pin.kinematics.modes import mode_indicator, mode_name
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
    anchors = follow(system, x, start)
    guess = initial_guess(system, x, anchors)
    if first:
        guess = np.concatenate([np.repeat(start[None], first, axis=0), guess])
    solution = assemble(system, guess, motion.x, max_iterations=30)
    projection = project(system, solution.state)
    singular = projection.margin == 0.0
    if not mark_unreachable:
        _require_closed(motion, solution.gap)
        _require_regular(motion, singular)
        _require_mode(robot, motion, solution.q)
        _require_continuous(system, motion, solution.q, projection.gamma)
    good = solution.closed & ~singular & _in_mode(robot, solution.q)
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
    """Return the first sample that lies on the branch and its configuration."""
    worst: UnreachablePoseError | None = None
    stride = max(1, len(motion) // 50)  # a motion that is out of reach throughout is not searched sample by sample
    for sample in range(0, len(motion), stride):
        try:
            return sample, find_on_branch(system, motion.x[sample], sample=sample)
        except UnreachablePoseError as error:
            worst = worst or error
            if not mark:
                raise
    if worst is None:
        raise UnreachablePoseError("The motion has no samples.")
    return 0, np.array(system.robot.q_reference)


def _require_closed(motion: PlatformMotion, gap: Array) -> None:
    bad = np.flatnonzero(~(gap < CLOSURE_TOLERANCE))
    if len(bad):
        k = int(bad[0])
        raise UnreachablePoseError(
            f"The pose of sample {k} (t = {motion.t[k]:.6g} s, x = {np.round(motion.x[k], 6).tolist()}) cannot be reached: "
            f"the chains stay open by {gap[k]:.3g} m ({len(bad)} of {len(gap)} samples).",
            remedy="Keep the motion inside the workspace, or ask for unreachable samples to be marked.",
            sample=k,
            gap=float(gap[k]),
            count=len(bad),
        )


def _require_regular(motion: PlatformMotion, singular: BoolArray) -> None:
    bad = np.flatnonzero(singular)
    if len(bad):
        k = int(bad[0])
        raise SingularPoseError(
            f"Sample {k} (t = {motion.t[k]:.6g} s) is a type I singularity: the platform velocity does not determine the "
            "joint velocities.",
            remedy="Keep the legs away from full stretch, full fold and zero length.",
            sample=k,
        )


def _in_mode(robot: Robot, q: Array) -> BoolArray:
    if robot.working_modes is None:
        return np.ones(len(q), dtype=bool)
    wanted = np.array(robot.working_mode)
    result: BoolArray = (mode_indicator(robot, q) * wanted > 0.0).all(axis=1)
    return result


def _require_mode(robot: Robot, motion: PlatformMotion, q: Array) -> None:
    bad = np.flatnonzero(~_in_mode(robot, q))
    if len(bad) and robot.working_modes is not None:
        k = int(bad[0])
        leg = int(np.argmax(mode_indicator(robot, q[k : k + 1])[0] * np.array(robot.working_mode) <= 0.0))
        raise WorkingModeError(
            f"The motion leaves the working mode {mode_name(robot.working_mode)} at sample {k} (t = {motion.t[k]:.6g} s): "
            f"leg {leg + 1} ({robot.working_modes.joints[leg]}) changes over.",
            remedy="Plan a path that keeps every leg on its side, or load the robot in another working_mode.",
            sample=k,
            leg=leg + 1,
        )


def _require_continuous(system: ConstraintSystem, motion: PlatformMotion, q: Array, gamma: Array) -> None:
    if len(q) < 2:
        return
    jumps = np.flatnonzero(~continuous(system, q, gamma, motion.x))
    if len(jumps):
        # a step between sparse samples may be long without being a jump: go there again in small steps
        for k in (int(j) for j in jumps):
            again = follow(system, motion.x[k : k + 2], q[k])
            if not again.valid.all() or np.abs(again.q[-1] - q[k + 1]).max() > _SAME_CONFIGURATION:
                raise WorkingModeError(
                    f"The motion cannot be followed continuously from sample {k} to {k + 1} (t = {motion.t[k]:.6g} to "
                    f"{motion.t[k + 1]:.6g} s): another branch of the kinematics is nearer.",
                    remedy="Keep away from type I singularities, or sample the motion more finely.",
                    sample=k + 1,
                )


_SAME_CONFIGURATION = 1e-6
"""Two closed configurations of one pose nearer than this (rad, m) are the same one, computed twice."""
