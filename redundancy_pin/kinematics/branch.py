"""Find the configuration of one pose on the robot's branch: from its reference, or by search in the working mode."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray
from redundancy_pin.errors import UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import Assembly, assemble, integrate
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.continuation import follow
from redundancy_pin.kinematics.coordinates import coordinates, velocity_scale
from redundancy_pin.kinematics.modes import in_working_mode, mode_name, working_modes

_STARTS = (1, 16, 240)
"""Starts in each round of a search: the guess itself, then random ones."""
_SEED = 20141  # any fixed number: the search must give the same answer every time


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
        WorkingModeError: there are closed configurations, but none in the working mode.
    """
    reference = np.array(system.robot.q_reference)
    home = coordinates(system.robot, system.evaluate(reference[None]))
    anchors = follow(system, np.concatenate([home, x[None]]), reference)
    if anchors.valid[-1] and in_working_mode(system.robot, anchors.q[-1:])[0]:
        q: Array = anchors.q[-1]
        return q
    q, gap, closed = search(system, reference, x)
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
        gap = np.where(np.isfinite(solution.gap), solution.gap, np.inf)
        if gap.min() < best_gap:
            best_q, best_gap = q[int(gap.argmin())], float(gap.min())
    return best_q, best_gap, False


def _assemble_around(
    system: ConstraintSystem, guess: Array, x: Array, starts: int, rng: np.random.Generator
) -> Assembly:
    model, columns = system.robot.model, system.pose_columns
    steps = np.zeros((starts, model.nv))
    if starts > 1:
        spread = np.where(_turns(system), np.pi, system.robot.characteristic_length)
        steps[:, columns] = rng.uniform(-1.0, 1.0, (starts, len(columns))) * spread
    around = integrate(model, np.repeat(guess[None], starts, axis=0), steps)
    return assemble(system, around, np.repeat(x[None], starts, axis=0))


def _turns(system: ConstraintSystem) -> BoolArray:
    result: BoolArray = velocity_scale(system.robot)[system.pose_columns] != 1.0
    return result


def _wrapped(system: ConstraintSystem, q: Array) -> Array:
    """Return q with the angles of bounded revolute joints in (−π, π]."""
    result: Array = q.copy()
    model = system.robot.model
    for index in range(1, model.njoints):
        joint = model.joints[index]
        if joint.nq == 1 and not str(joint.shortname()).startswith("JointModelP"):
            result[:, joint.idx_q] = np.pi - (np.pi - q[:, joint.idx_q]) % (2.0 * np.pi)
    return result
