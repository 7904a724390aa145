"""The moving bodies of a robot: what each joint carries, with all links that are fixed to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, Frozen, frozen


@dataclass(frozen=True, eq=False)
class Body(Frozen):
    """A rigid body that a joint carries, payloads included.

    Attributes:
        name: name of the link that the joint carries; of the joint where the model names no link there.
        joint: name of the joint.
        links: names of all links of the body, marks included.
        mass: mass, kg.
        centre: (3,) centre of mass in the frame of the body, which is that of the joint, m.
        principal_moments: (3,) principal moments of inertia about the centre of mass, in ascending order, kg·m².
    """

    name: str
    joint: str
    links: tuple[str, ...]
    mass: float
    centre: Array
    principal_moments: Array


def moving_bodies(model: pin.Model) -> tuple[Body, ...]:
    """Return the bodies of a model in the order of its joints; what is fixed to the ground is not among them."""
    links: dict[int, list[str]] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            links.setdefault(int(frame.parentJoint), []).append(str(frame.name))
    bodies = []
    for index in range(1, model.njoints):
        joint, own, inertia = str(model.names[index]), links.get(index, []), model.inertias[index]
        moments = np.linalg.eigvalsh(inertia.inertia)
        bodies.append(
            Body(
                name=(own or [joint])[0],
                joint=joint,
                links=tuple(own),
                mass=float(inertia.mass),
                centre=frozen(inertia.lever),
                principal_moments=frozen(moments),
            )
        )
    return tuple(bodies)
