"""Find joints and links of a Pinocchio model by name.

A joint and a link may share a name: Pinocchio keeps both as frames, and refuses a search without the kind of frame. All
other modules search by these functions.
"""

from __future__ import annotations

from collections.abc import Sequence

import pinocchio as pin

from redundancy_pin.errors import InputError, one_of


def joint_names(model: pin.Model) -> tuple[str, ...]:
    """Return the names of the moving joints, in the order of the model."""
    return tuple(str(name) for name in model.names)[1:]


def link_names(model: pin.Model) -> tuple[str, ...]:
    """Return the names of the links, in the order of the model."""
    return tuple(str(frame.name) for frame in model.frames if frame.type == pin.FrameType.BODY)


def has_joint(model: pin.Model, name: str) -> bool:
    """Return whether the model has a moving joint of that name."""
    return bool(model.existJointName(name)) and name != model.names[0]


def has_link(model: pin.Model, name: str) -> bool:
    """Return whether the model has a link of that name."""
    return bool(model.existFrame(name, pin.FrameType.BODY))


def find_joint_index(model: pin.Model, name: str) -> int:
    """Return the index of a moving joint in ``model.joints``.

    Raises:
        InputError: the model has no such joint.
    """
    index = int(model.getJointId(name))
    return index if 0 < index < model.njoints else _refuse("moving joint", name, joint_names(model))


def find_joint(model: pin.Model, name: str) -> pin.JointModel:
    """Return a moving joint; raises as ``find_joint_index``."""
    return model.joints[find_joint_index(model, name)]


def find_link_index(model: pin.Model, name: str) -> int:
    """Return the index of a link in ``model.frames``.

    Raises:
        InputError: the model has no such link.
    """
    index = int(model.getFrameId(name, pin.FrameType.BODY))
    return index if index < model.nframes else _refuse("link", name, link_names(model))


def find_link(model: pin.Model, name: str) -> pin.Frame:
    """Return the frame of a link, whose ``parentJoint`` is the joint that carries it; raises as ``find_link_index``."""
    return model.frames[find_link_index(model, name)]


def _refuse(kind: str, name: str, known: Sequence[str]) -> int:
    raise InputError(f"The model has no {kind} {name!r}.", remedy=one_of(name, known), name=name)
