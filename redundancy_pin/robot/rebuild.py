"""A Pinocchio model with its joints depth first, and some of them replaced by others in a row, or by none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, shown

_OF_VELOCITIES = ("armature", "rotorInertia", "rotorGearRatio")
LIMITS = tuple(f"{bound}{what}Limit" for bound in ("lower", "upper") for what in ("Position", "Velocity", "Effort"))
"""Attributes of a model that are limits of its joints."""

_ALONG = {
    "revolute": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRevoluteUnaligned),
    "prismatic": (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPrismaticUnaligned),
}


def joint_along(kind: str, axis: Array) -> pin.JointModel:
    """Return a revolute or prismatic joint along a unit axis (3,), of the class for x, y or z if it is one."""
    *aligned, unaligned = _ALONG[kind]
    along = np.flatnonzero(axis == 1.0)
    return aligned[int(along[0])]() if len(along) == 1 and np.count_nonzero(axis) == 1 else unaligned(np.array(axis))


def axis_of(model: pin.Model, index: int) -> Array:
    """Return (3,) the constant axis of a joint of one freedom, in its own frame."""
    joint = model.joints[index]
    data = joint.createData()
    joint.calc(data, pin.neutral(model), np.zeros(model.nv))
    twist = np.ravel(data.S)
    return np.array(twist[3:] if np.any(twist[3:]) else twist[:3])


def rebuilt(
    model: pin.Model, replaced: Mapping[str, Sequence[tuple[str, pin.JointModel]]] | None = None
) -> tuple[pin.Model, list[int]]:
    """Return a model whose joints are followed by the joints that they carry, some of them replaced.

    Pinocchio's mass matrix is wrong for another order.

    Args:
        model: the model; it stays as it is.
        replaced: by joint, the names and joints that replace it, from its parent outwards; none for a joint that is
            fixed at its neutral position. They have no limits of position; one that replaces one of equal freedoms has
            its inertia of the rotor, and its limits of speed and effort.

    Returns:
        The model, and its index of the joint that carries what each joint of the given one carried.

    Raises:
        InputError: no Pinocchio model.
    """
    if not isinstance(model, pin.Model):
        raise InputError(f"The model is {shown(model)}.", remedy="Pass a pinocchio.Model (pin.buildModelFromUrdf).")
    replaced = replaced or {}
    order = _depth_first(model)
    if not replaced and order == sorted(order):
        return pin.Model(model), list(range(model.njoints))
    new = pin.Model()
    new.name, new.gravity = model.name, model.gravity
    at, places = [0] * model.njoints, [pin.SE3.Identity() for _ in range(model.njoints)]
    new.inertias[0] = model.inertias[0]
    for index in order:
        name, above = str(model.names[index]), model.parents[index]
        carrier, place = at[above], places[above] * model.jointPlacements[index]
        for own, joint in replaced.get(name, [(name, model.joints[index])]):
            carrier, place = new.addJoint(carrier, joint, place, own), pin.SE3.Identity()
        at[index], places[index] = carrier, place
        if model.inertias[index].mass or np.any(model.inertias[index].inertia):
            new.appendBodyToJoint(carrier, model.inertias[index], place)
    for attribute in (*_OF_VELOCITIES, *LIMITS):
        values, kind = getattr(new, attribute), "q" if "Position" in attribute else "v"
        if attribute in LIMITS:
            values[:] = -np.inf if attribute.startswith("lower") else np.inf
        for index in order:
            stands = replaced.get(str(model.names[index]))
            of_velocity = kind == "v" and [each.nv for _, each in stands or ()] == [model.joints[index].nv]
            if stands is None or of_velocity:
                values[span(new, at[index], kind)] = getattr(model, attribute)[span(model, index, kind)]
        setattr(new, attribute, values)
    for frame in list(model.frames)[1:]:
        joint = frame.parentJoint
        place = places[joint] * frame.placement
        new.addFrame(pin.Frame(frame.name, at[joint], frame.parentFrame, place, frame.type), False)
    return new, at


def _depth_first(model: pin.Model) -> list[int]:
    order: list[int] = []
    waiting = [index for index in range(model.njoints - 1, 0, -1) if model.parents[index] == 0]
    while waiting:
        order.append(index := waiting.pop())
        waiting += [each for each in range(model.njoints - 1, 0, -1) if model.parents[each] == index]
    return order


def span(model: pin.Model, index: int, kind: str) -> slice:
    """Return where a joint's numbers are in q (``kind`` "q") or v ("v")."""
    joint = model.joints[index]
    first, count = (joint.idx_q, joint.nq) if kind == "q" else (joint.idx_v, joint.nv)
    return slice(int(first), int(first + count))
