"""Find the configuration of one pose on the robot's branch: from its reference, or by search in the working mode."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.continuation import follow
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.kinematics.modes import in_working_mode, mode_name, working_modes
from redundancy_pin.kinematics.projection import project
from redundancy_pin.kinematics.search import search


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
