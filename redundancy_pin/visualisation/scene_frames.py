"""Frames and axes of joints, as pictures need them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array


def along_z(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is a unit axis."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)


def joint_axis(model: pin.Model, index: int) -> Array:
    """Return (3,) the unit axis of a joint of one freedom in its own frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    joint = model.joints[index]
    column = np.reshape(pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL), (6, model.nv))[
        :, joint.idx_v
    ]
    part = column[3:] if np.abs(column[3:]).max() > 0.0 else column[:3]
    axis: Array = part / np.linalg.norm(part)
    return axis


def slides(model: pin.Model, index: int) -> bool:
    """Return whether a joint is prismatic."""
    return str(model.joints[index].shortname()).startswith("JointModelP")


def place(rotation: Array | None = None, translation: Array | None = None) -> Array:
    """Return a homogeneous placement (4, 4)."""
    placement = np.eye(4)
    if rotation is not None:
        placement[:3, :3] = rotation
    if translation is not None:
        placement[:3, 3] = translation
    return placement
