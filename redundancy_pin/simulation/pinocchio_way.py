"""The second way to closed-chain accelerations: Pinocchio's ``constraintDynamics``."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.robot import Robot

DAMPING = 1e-8
"""Proximal damping μ. The out-of-plane row of a planar closure is empty, and μ = 0 gives NaN there."""

ACCURACY = 1e-14
"""Absolute and relative accuracy asked of the proximal iteration."""

MOST_ITERATIONS = 30


def has_point_closures(robot: Robot) -> bool:
    """Return whether all closures are points in a plane or in space, which is what ``ConstraintDynamics`` covers."""
    return all(set(closure.axes) in ({"x", "y"}, {"x", "y", "z"}) for closure in robot.closures)


class ConstraintDynamics:
    """Pinocchio's constrained forward dynamics of one robot, its point closures as 3D constraints.

    It shares nothing with ``ForwardDynamics`` but the model. Bodies without mass make its factorisation singular.

    Args:
        robot: the robot.

    Raises:
        UnsupportedRobotError: a closure is not a point.
    """

    def __init__(self, robot: Robot) -> None:
        if not has_point_closures(robot):
            other = next(c for c in robot.closures if set(c.axes) not in ({"x", "y"}, {"x", "y", "z"}))
            raise UnsupportedRobotError(
                f"Pinocchio's constraintDynamics cannot take closure {other.name!r} along {', '.join(other.axes)}.",
                remedy="Use the projected equations, which take every closure.",
                closure=other.name,
            )
        self._model = model = robot.model
        self._constraints = pin.StdVec_RigidConstraintModel()
        self._constraint_data = pin.StdVec_RigidConstraintData()
        for closure in robot.closures:
            frame_a, frame_b = (
                model.frames[model.getFrameId(f, pin.FrameType.BODY)] for f in (closure.frame_a, closure.frame_b)
            )
            constraint = pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D,
                model,
                frame_a.parentJoint,
                frame_a.placement,
                frame_b.parentJoint,
                frame_b.placement,
                pin.ReferenceFrame.LOCAL,
            )
            self._constraints.append(constraint)
            self._constraint_data.append(constraint.createData())
        self._data = model.createData()
        pin.initConstraintDynamics(model, self._data, self._constraints, self._constraint_data)
        self._settings = pin.ProximalSettings(ACCURACY, DAMPING, MOST_ITERATIONS)

    def __call__(self, q: Array, v: Array, force: Array) -> Array:
        """Return the accelerations (nv,) at q (nq,), v (nv,) under generalised forces (nv,)."""
        acceleration = pin.constraintDynamics(
            self._model, self._data, q, v, force, self._constraints, self._constraint_data, self._settings
        )
        return np.array(acceleration)
