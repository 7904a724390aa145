"""Pinocchio's own forward dynamics of robots whose closures are points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_link


def constrained(robot: Robot, q: Array, v: Array, force: Array) -> Array:
    """Return constrained accelerations (nv,) of a robot under generalised forces (nv,); see ``accelerations``."""
    pairs = [(closure.frame_a, closure.frame_b) for closure in robot.closures]
    ends = [tuple(find_link(robot.model, name) for name in pair) for pair in pairs]
    return accelerations(robot.model, ends, pin.ContactType.CONTACT_3D, q, v, force)


def accelerations(
    model: pin.Model, ends: Sequence[tuple[pin.Frame, ...]], kind: pin.ContactType, q: Array, v: Array, force: Array
) -> Array:
    """Return accelerations (nv,) of a tree whose frames in pairs are held together, by a proximal iteration to 1e-14.

    Planar loops have a redundant z row each: the proximal term copes with it, given its iterations.
    """
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for pair in ends:
        places = (part for end in pair for part in (end.parentJoint, end.placement))
        models.append(pin.RigidConstraintModel(kind, model, *places, pin.ReferenceFrame.LOCAL))
        datas.append(models[-1].createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    settings = pin.ProximalSettings(1e-14, 1e-8, 200)
    return np.array(pin.constraintDynamics(model, data, q, v, force, models, datas, settings))
