"""Pinocchio's own forward dynamics of robots whose closures are points."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_link


def constrained(robot: Robot, q: Array, v: Array, force: Array) -> Array:
    """Return constrained accelerations (nv,) under generalised forces (nv,), by a proximal iteration to 1e-14.

    Planar loops have a redundant z row each: the proximal term copes with it, given its iterations.
    """
    model = robot.model
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for closure in robot.closures:
        ends = (find_link(model, name) for name in (closure.frame_a, closure.frame_b))
        places = (part for end in ends for part in (end.parentJoint, end.placement))
        models.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *places, pin.ReferenceFrame.LOCAL))
        datas.append(models[-1].createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    settings = pin.ProximalSettings(1e-14, 1e-8, 100)
    return np.array(pin.constraintDynamics(model, data, q, v, force, models, datas, settings))
