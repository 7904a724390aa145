"""From a platform motion to the motion of the tree: every sample closed, on one branch, in the working mode."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, IntArray, read_only
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import Assembly, assemble, configuration_difference, project
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.continuation import Anchors, continuous, follow, initial_guess, reacquire
from redundancy_pin.kinematics.coordinates import coordinates, require_matching
from redundancy_pin.kinematics.inverse_kinematics import multistart
from redundancy_pin.kinematics.modes import in_working_mode, mode_indicator, mode_name, working_modes
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot

_FAR_STARTS = 5
"""Samples of a motion that no Newton from the reference closes anywhere at which multistart is tried before it is
given up."""

_SAME_CONFIGURATION = 1e-6
"""Two closed configurations of one pose nearer than this (rad, m) are the same one, computed twice."""

_STAY_AWAY = "Keep the legs away from full stretch, full fold and zero length."


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
            ``assembly.Projection``.
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
            singularities, with NaN. Behind them the motion is reacquired in the working mode; a robot that declares no
            modes may come back on another branch, but never without a marked sample in between.

    Raises:
        InputError: the motion does not have the robot's coordinates.
        UnreachablePoseError: no configuration closes the chains; carries sample and gap.
        SingularPoseError: a sample is a type I singularity.
        WorkingModeError: the motion leaves the working mode, or cannot be followed continuously.
    """
    require_matching(robot, motion)
    system = constraint_system(robot)
    # the guesses lie on the branch, so that all samples can be solved at once: no sample waits for the one before
    solved = assemble(system, _guesses(system, motion, mark_unreachable), motion.x, max_iterations=30)
    if not mark_unreachable:
        _require_usable(motion, solved)
    good = solved.usable
    breaks = _branch_breaks(motion, solved, good)
    if len(breaks) and not mark_unreachable:
        raise _discontinuous(motion, int(breaks[0]) - 1)
    good[breaks] = False  # closed, but on another branch than the sample before
    gamma, inverse = solved.gamma, solved.projection.inverse
    v = np.einsum("nvi,ni->nv", gamma, motion.xd)
    bias_c, bias_x = system.bias(solved.state, v)
    a = np.zeros_like(v)
    a[:, system.pose_columns] = np.einsum("npr,nr->np", inverse, np.concatenate([-bias_c, motion.xdd - bias_x], axis=1))
    W = np.ascontiguousarray(gamma[:, robot.actuated_velocity, :].transpose(0, 2, 1))
    for array in (solved.q, v, a, gamma, W):
        array[~good] = np.nan
    parts = (solved.q, v, a, gamma, W, solved.gap, good, solved.projection.margin)
    return TreeMotion(robot, motion, *(read_only(part) for part in parts))


def find_on_branch(system: ConstraintSystem, x: Array, *, sample: int = 0) -> Array:
    """Return (nq,) a configuration at a pose, in the robot's working mode.

    First the straight line from the reference configuration is followed; where that leaves the workspace, multistart
    takes the solution nearest to the reference in the right working mode.

    Args:
        system: closures and platform rows; the robot's ``q_reference`` must be closed.
        x: (n,) coordinates or a pose (4, 4), base frame.
        sample: index to name in the error.

    Raises:
        UnreachablePoseError: no start leads to a closed configuration; carries the smallest gap.
        SingularPoseError: the pose is a type I singularity.
        WorkingModeError: there are closed configurations, but none in the working mode.
    """
    robot, reference = system.robot, np.array(system.robot.q_reference)
    home = coordinates(robot, system.evaluate(reference[None]))
    anchors = follow(system, np.concatenate([home, x[None]]), reference)
    if anchors.valid[-1] and in_working_mode(robot, anchors.q[-1:])[0]:
        q: Array = anchors.q[-1]
        return q
    q, gap, in_mode = multistart(system, reference, x)
    closed, pose = gap < CLOSURE_TOLERANCE, f"The pose of sample {sample}, x = {np.round(x, 6).tolist()},"
    if closed and project(system, system.evaluate(q[None])).margin[0] == 0.0:
        raise SingularPoseError(
            f"{pose} is a type I singularity: the platform velocity does not determine the joint velocities.",
            remedy=_STAY_AWAY,
            sample=sample,
        )
    if closed and not in_mode:
        raise WorkingModeError(
            f"{pose} closes only in other working modes than {mode_name(robot.working_mode)} of {robot.name}, such as "
            f"{mode_name(tuple(working_modes(robot, q[None])[0]))}.",
            remedy="Load the robot in that working_mode, or move the pose.",
            sample=sample,
        )
    if not in_mode:
        raise UnreachablePoseError(
            f"{pose} cannot be reached in the working mode of {robot.name}: the chains stay open by {gap:.3g} m.",
            remedy="Move the pose into the workspace, or load the robot in another working_mode.",
            sample=sample,
            gap=gap,
        )
    return q


def _guesses(system: ConstraintSystem, motion: PlatformMotion, mark: bool) -> Array:
    """Return (N, nq) guesses along the branch: from the first sample solved on it onward, and from there back."""
    start = _first_on_branch(system, motion, mark)
    if start is None:
        return np.repeat(system.robot.q_reference[None], len(motion), axis=0)
    first, q = start
    onward = motion.x[first:]
    anchors = follow(system, onward, q, resume=mark)
    if not mark:
        _require_branch(system, motion, anchors)
    guess = initial_guess(system, onward, anchors)
    if first == 0:
        return guess
    back = motion.x[first::-1]
    before = initial_guess(system, back, follow(system, back, q, resume=mark))
    return np.concatenate([before[:0:-1], guess])


def _first_on_branch(system: ConstraintSystem, motion: PlatformMotion, mark: bool) -> tuple[int, Array] | None:
    """Return the first sample that is solved on the branch, and its configuration."""
    try:
        return 0, find_on_branch(system, motion.x[0])
    except (UnreachablePoseError, SingularPoseError, WorkingModeError):
        if not mark:
            raise
    near = reacquire(system, motion.x, np.array(system.robot.q_reference))
    if near is not None:
        return near[0], near[1].q
    for sample in np.linspace(0, len(motion) - 1, _FAR_STARTS).round().astype(int)[1:]:
        with contextlib.suppress(UnreachablePoseError, SingularPoseError, WorkingModeError):
            return int(sample), find_on_branch(system, motion.x[sample], sample=int(sample))
    return None


def _branch_breaks(motion: PlatformMotion, solved: Assembly, good: BoolArray) -> IntArray:
    """Return the samples whose configuration does not continue the branch of the sample before, both being good."""
    system, q, x = solved.system, solved.q, motion.x
    if len(q) < 2:
        return np.zeros(0, dtype=np.intp)
    suspects = np.flatnonzero(good[1:] & good[:-1] & ~continuous(system, q, solved.gamma, x))

    def reached_again(k: int) -> bool:
        again = follow(system, x[k : k + 2], q[k])
        apart = configuration_difference(system.robot.model, again.q[-1:], q[k + 1 : k + 2])
        return bool(again.valid.all()) and float(np.abs(apart).max()) <= _SAME_CONFIGURATION

    # a step between sparse samples may be long without being a break: go there again in small steps
    return np.array([k + 1 for k in suspects.tolist() if not reached_again(k)], dtype=np.intp)


def _require_branch(system: ConstraintSystem, motion: PlatformMotion, anchors: Anchors) -> None:
    """Check that the anchors reach the end of the motion; where they do not, say what ended the branch."""
    if anchors.valid.all():
        return
    lost = int(np.argmin(anchors.valid))
    first = int(np.floor(anchors.position[max(lost - 1, 0)]))
    last = int(np.ceil(anchors.position[lost]))
    poses = motion.x[first : last + 1]
    solved = assemble(system, np.repeat(anchors.q[lost][None], len(poses), axis=0), poses)
    _require_closed_and_regular(motion, solved, first)
    raise WorkingModeError(
        f"The motion cannot be followed continuously to sample {last} (t = {motion.t[last]:.6g} s): the way there "
        "leaves the workspace or passes a type I singularity (a leg at full stretch, full fold or zero length).",
        remedy="Keep every leg away from the end of its reach, or sample the motion more finely.",
        sample=last,
    )


def _require_usable(motion: PlatformMotion, solved: Assembly) -> None:
    """Check every sample: closed, regular, in the working mode."""
    _require_closed_and_regular(motion, solved, 0)
    robot = solved.system.robot
    if robot.working_modes is not None and not solved.in_mode.all():
        k = int(np.argmin(solved.in_mode))
        leg = int(np.argmax(mode_indicator(robot, solved.q[k : k + 1])[0] * np.array(robot.working_mode) <= 0.0))
        raise WorkingModeError(
            f"The motion leaves the working mode {mode_name(robot.working_mode)} at sample {k} "
            f"(t = {motion.t[k]:.6g} s): leg {leg + 1} ({robot.working_modes.joints[leg]}) changes over.",
            remedy="Plan a path that keeps every leg on its side, or load the robot in another working_mode.",
            sample=k,
            leg=leg + 1,
        )


def _require_closed_and_regular(motion: PlatformMotion, solved: Assembly, first: int) -> None:
    """Check samples of a motion from number ``first`` on."""
    if not solved.closed.all():
        i = int(np.argmin(solved.closed))
        k, gap = first + i, float(solved.gap[i])
        raise UnreachablePoseError(
            f"The pose of sample {k} (t = {motion.t[k]:.6g} s, x = {np.round(motion.x[k], 6).tolist()}) cannot be "
            f"reached: the chains stay open by {gap:.3g} m.",
            remedy="Keep the motion inside the workspace, or ask for unreachable samples to be marked.",
            sample=k,
            gap=gap,
        )
    if not solved.regular.all():
        k = first + int(np.argmin(solved.regular))
        raise SingularPoseError(
            f"Sample {k} (t = {motion.t[k]:.6g} s) is a type I singularity: the platform velocity does not determine "
            "the joint velocities.",
            remedy=_STAY_AWAY,
            sample=k,
        )


def _discontinuous(motion: PlatformMotion, k: int) -> WorkingModeError:
    return WorkingModeError(
        f"The motion cannot be followed continuously from sample {k} to {k + 1} (t = {motion.t[k]:.6g} to "
        f"{motion.t[k + 1]:.6g} s): another branch of the kinematics is nearer.",
        remedy="Keep away from type I singularities, or sample the motion more finely.",
        sample=k + 1,
    )
