"""What makes a lifted motion unacceptable, each with the sample, the time and a remedy."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, IntArray, read_only
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import assemble, configuration_difference
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.continuation import Anchors, continuous, follow, initial_guess, take_up
from redundancy_pin.kinematics.coordinates import coordinates, require_matching
from redundancy_pin.kinematics.inverse_kinematics import search
from redundancy_pin.kinematics.modes import in_working_mode, mode_indicator, mode_name, working_modes
from redundancy_pin.kinematics.projection import project
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot


def find_on_branch(system: ConstraintSystem, x: Array, *, sample: int = 0) -> Array:
    """Return (nq,) a configuration at a pose, in the robot's working mode.

    First the straight way from the reference configuration is followed; where that leaves the workspace, the pose is
    searched from many starts and the solution nearest to the reference in the right working mode is taken.

    Args:
        system: closures and platform rows; the robot's ``q_reference`` must be closed.
        x: (n,) coordinates or a pose (4, 4), base frame.
        sample: index to name in the error.

    Raises:
        UnreachablePoseError: no start leads to a closed configuration; carries the smallest gap.
        SingularPoseError: the pose is a type I singularity.
        WorkingModeError: there are closed configurations, but none in the working mode.
    """
    reference = np.array(system.robot.q_reference)
    home = coordinates(system.robot, system.evaluate(reference[None]))
    anchors = follow(system, np.concatenate([home, x[None]]), reference)
    if anchors.valid[-1] and in_working_mode(system.robot, anchors.q[-1:])[0]:
        q: Array = anchors.q[-1]
        return q
    q, gap, closed = search(system, reference, x)
    if gap < CLOSURE_TOLERANCE and project(system, system.evaluate(q[None])).margin[0] == 0.0:
        raise SingularPoseError(
            f"The pose of sample {sample}, x = {np.round(x, 6).tolist()}, is a type I singularity: the platform "
            "velocity does not determine the joint velocities.",
            remedy="Keep the legs away from full stretch, full fold and zero length.",
            sample=sample,
        )
    if not closed and gap < CLOSURE_TOLERANCE:
        raise WorkingModeError(
            f"The pose of sample {sample}, x = {np.round(x, 6).tolist()}, closes only in other working modes than "
            f"{mode_name(system.robot.working_mode)} of {system.robot.name}, such as "
            f"{mode_name(tuple(working_modes(system.robot, q[None])[0]))}.",
            remedy="Load the robot in that working_mode, or move the pose.",
            sample=sample,
        )
    if not closed:
        raise UnreachablePoseError(
            f"The pose of sample {sample}, x = {np.round(x, 6).tolist()}, cannot be reached in the working mode of "
            f"{system.robot.name}: the chains stay open by {gap:.3g} m.",
            remedy="Move the pose into the workspace, or load the robot in another working_mode.",
            sample=sample,
            gap=gap,
        )
    return q


def require_branch(system: ConstraintSystem, motion: PlatformMotion, anchors: Anchors) -> None:
    """Check that the anchors reach the end of the motion.

    Raises:
        UnreachablePoseError: a sample cannot be closed; carries sample and gap.
        SingularPoseError: a sample is a type I singularity.
        WorkingModeError: every sample near the end of the branch closes, but not continuously.
    """
    if anchors.valid.all():
        return
    lost = int(np.argmin(anchors.valid))
    first = int(np.floor(anchors.position[max(lost - 1, 0)]))
    last = int(np.ceil(anchors.position[lost]))
    poses = motion.x[first : last + 1]
    solution = assemble(system, np.repeat(anchors.q[lost][None], len(poses), axis=0), poses)
    if not solution.closed.all():
        k = first + int(np.argmin(solution.closed))
        raise _unreachable(motion, k, float(solution.gap[k - first]))
    singular = project(system, solution.state).margin == 0.0
    if singular.any():
        raise _singular(motion, first + int(np.argmax(singular)))
    raise WorkingModeError(
        f"The motion cannot be followed continuously to sample {last} (t = {motion.t[last]:.6g} s): the way there "
        "leaves the workspace or passes a type I singularity (a leg at full stretch, full fold or zero length).",
        remedy="Keep every leg away from the end of its reach, or sample the motion more finely.",
        sample=last,
    )


def require_closed(motion: PlatformMotion, gap: Array) -> None:
    """Check that every sample is closed.

    Raises:
        UnreachablePoseError: naming the first sample that is not, and its gap.
    """
    bad = np.flatnonzero(~(gap < CLOSURE_TOLERANCE))
    if len(bad):
        raise _unreachable(motion, int(bad[0]), float(gap[bad[0]]))


def _unreachable(motion: PlatformMotion, k: int, gap: float) -> UnreachablePoseError:
    return UnreachablePoseError(
        f"The pose of sample {k} (t = {motion.t[k]:.6g} s, x = {np.round(motion.x[k], 6).tolist()}) cannot be reached: "
        f"the chains stay open by {gap:.3g} m.",
        remedy="Keep the motion inside the workspace, or ask for unreachable samples to be marked.",
        sample=k,
        gap=gap,
    )


def require_regular(motion: PlatformMotion, singular: BoolArray) -> None:
    """Check that no sample is a type I singularity.

    Raises:
        SingularPoseError: naming the first that is.
    """
    bad = np.flatnonzero(singular)
    if len(bad):
        raise _singular(motion, int(bad[0]))


def _singular(motion: PlatformMotion, k: int) -> SingularPoseError:
    return SingularPoseError(
        f"Sample {k} (t = {motion.t[k]:.6g} s) is a type I singularity: the platform velocity does not determine "
        "the joint velocities.",
        remedy="Keep the legs away from full stretch, full fold and zero length.",
        sample=k,
    )


def require_mode(robot: Robot, motion: PlatformMotion, q: Array) -> None:
    """Check that every configuration (N, nq) is in the robot's working mode.

    Raises:
        WorkingModeError: naming the first sample that is not, and the leg.
    """
    bad = np.flatnonzero(~in_working_mode(robot, q))
    if len(bad) and robot.working_modes is not None:
        k = int(bad[0])
        leg = int(np.argmax(mode_indicator(robot, q[k : k + 1])[0] * np.array(robot.working_mode) <= 0.0))
        raise WorkingModeError(
            f"The motion leaves the working mode {mode_name(robot.working_mode)} at sample {k} "
            f"(t = {motion.t[k]:.6g} s): leg {leg + 1} ({robot.working_modes.joints[leg]}) changes over.",
            remedy="Plan a path that keeps every leg on its side, or load the robot in another working_mode.",
            sample=k,
            leg=leg + 1,
        )


def require_continuous(system: ConstraintSystem, motion: PlatformMotion, q: Array, gamma: Array) -> None:
    """Check that configurations (N, nq) with Γ (N, nv, n) lie on one branch, sample by sample.

    Raises:
        WorkingModeError: naming the samples between which the branch changes.
    """
    breaks = branch_breaks(system, motion, q, gamma)
    if len(breaks):
        k = int(breaks[0]) - 1
        raise WorkingModeError(
            f"The motion cannot be followed continuously from sample {k} to {k + 1} (t = {motion.t[k]:.6g} to "
            f"{motion.t[k + 1]:.6g} s): another branch of the kinematics is nearer.",
            remedy="Keep away from type I singularities, or sample the motion more finely.",
            sample=k + 1,
        )


def branch_breaks(system: ConstraintSystem, motion: PlatformMotion, q: Array, gamma: Array) -> IntArray:
    """Return the samples whose configuration does not continue the branch of the sample before.

    Args:
        system: closures and platform rows.
        motion: N samples.
        q: (N, nq) configurations; a pair with NaN is no break.
        gamma: (N, nv, n) velocities per unit of each independent velocity.
    """
    if len(q) < 2:
        return np.zeros(0, dtype=np.intp)
    comparable = np.isfinite(q[1:]).all(axis=1) & np.isfinite(q[:-1]).all(axis=1)
    suspects = np.flatnonzero(comparable & ~continuous(system, q, gamma, motion.x))
    # a step between sparse samples may be long without being a break: go there again in small steps
    broken = [k + 1 for k in suspects if not _reached_again(system, motion.x[k : k + 2], q[k], q[k + 1])]
    return np.array(broken, dtype=np.intp)


def _reached_again(system: ConstraintSystem, x: Array, start: Array, end: Array) -> bool:
    again = follow(system, x, start)
    apart = configuration_difference(system.robot.model, again.q[-1:], end[None])
    return bool(again.valid.all()) and float(np.abs(apart).max()) <= _SAME_CONFIGURATION


_SAME_CONFIGURATION = 1e-6
"""Two closed configurations of one pose nearer than this (rad, m) are the same one, computed twice."""


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
