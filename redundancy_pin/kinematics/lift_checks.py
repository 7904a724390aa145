"""What makes a lifted motion unacceptable, each with the sample, the time and a remedy."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, IntArray
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import assemble, configuration_difference
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.continuation import Anchors, continuous, follow
from redundancy_pin.kinematics.modes import in_working_mode, mode_indicator, mode_name
from redundancy_pin.kinematics.projection import project
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot


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
