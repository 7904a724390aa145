"""Joints that close loops: the rows that each kind constrains, and the frames on both links between which it acts.

Every reader of a format returns loop joints of these kinds, whatever its files call them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import RANK_TOLERANCE, Array
from redundancy_pin.errors import DeclarationError
from redundancy_pin.robot.lookup import find_link, has_link
from redundancy_pin.robot.types import AXES, Closure

ROWS: Mapping[str, tuple[str, ...]] = {
    "hinge": ("x", "y", "z", "rx", "ry"),
    "slider": ("x", "y", "rx", "ry", "rz"),
    "cylinder": ("x", "y", "rx", "ry"),
    "ball": ("x", "y", "z"),
    "universal": ("x", "y", "z", "rz"),
    "planar": ("z", "rx", "ry"),
    "weld": AXES,
    "rod": ("distance",),
}
"""Constrained axes of each kind. The z axes of both frames are the axis of a hinge, slider or cylinder, and normal to
the plane of a planar joint. A universal joint turns about the y axis of the first frame and the x axis of the second,
which stay at right angles. A rod of constant length has a ball at both ends."""


LOOP_KINDS = {
    "revolute": "hinge",
    "continuous": "hinge",
    "hinge": "hinge",
    "prismatic": "slider",
    "cylindrical": "cylinder",
    "spherical": "ball",
    "ball": "ball",
    "universal": "universal",
    "planar": "planar",
    "fixed": "weld",
}
"""Kinds by the names that files have for the types of joints."""


@dataclass(frozen=True, eq=False)
class LoopJoint:
    """A joint that closes a loop.

    Attributes:
        name: what to call it in messages.
        kind: one of ``ROWS``.
        links: the two links that it joins.
        placements: (4, 4) of its frame in each link, as ``ROWS`` defines it, the link's own by default; the frames
            coincide when the loop is closed; a rod has them at its ends.
        length: m, of a rod; 0 where it is the distance of its ends at the reference.
    """

    name: str
    kind: str
    links: tuple[str, str]
    placements: tuple[Array, Array] = field(default_factory=lambda: (np.eye(4), np.eye(4)))
    length: float = 0.0

    def frames(self) -> tuple[str, str]:
        """Return the names of both frames: the link's own where the joint is at its origin."""
        one, other = (
            link if np.array_equal(placement, np.eye(4)) else f"{self.name}:{side}"
            for side, link, placement in zip("ab", self.links, self.placements, strict=True)
        )
        return one, other

    def closure(self) -> Closure:
        """Return the closure between its frames."""
        return Closure(self.name, *self.frames(), ROWS[self.kind], self.length)


def joint_between(
    name: str,
    kind: str,
    links: tuple[str, str],
    places: Sequence[Array],
    axes: Sequence[Array],
    length: float = 0.0,
) -> LoopJoint:
    """Return a joint from its place and its axis in both links.

    Args:
        name: what to call it in messages.
        kind: one of ``ROWS``.
        links: the two links that it joins.
        places: (4, 4) of the joint in each link; the axes are read there.
        axes: (3,) along it, of any length but zero; of a universal joint the one that it has in each link. Those of a
            ball, weld or rod do not count.
        length: m, of a rod; 0 where it is the distance of its ends at the reference.

    Raises:
        DeclarationError: one link twice, an axis of length zero, or a slider of two axes: its angle is not determined.
    """
    if links[0] == links[1]:
        remedy = "Name two links."
        raise DeclarationError(f"The joint {name!r} has one link at both ends, {links[0]!r}.", remedy=remedy, name=name)
    if not all(np.any(axis) for axis in axes):
        raise DeclarationError(f"The joint {name!r} has an axis of length zero.", remedy="Correct it.", name=name)
    first, second = (axis / np.linalg.norm(axis) for axis in axes)
    if kind == "slider" and np.abs(first - second).max() > RANK_TOLERANCE:
        remedy = "Turn its frames by rpy, so that one axis serves both."
        message = f"The slider {name!r} has two axes, which do not say how its links are turned about them."
        raise DeclarationError(message, remedy=remedy, name=name)
    one, other = (
        place if kind in ("ball", "weld", "rod") else place @ placed(turned_to(axis, column), np.zeros(3))
        for place, axis, column in zip(places, axes, (1, 0) if kind == "universal" else (2, 2), strict=True)
    )
    return LoopJoint(name, kind, links, (one, other), length)


def add_frames(model: pin.Model, joints: Sequence[LoopJoint]) -> None:
    """Add the frames of joints that close loops to a model, as links that weigh nothing.

    Raises:
        InputError: the model has no such link.
        DeclarationError: it has one with the name of such a frame.
    """
    for joint in joints:
        for name, link, placement in zip(joint.frames(), joint.links, joint.placements, strict=True):
            carrier = find_link(model, link)
            if name == link:
                continue
            if has_link(model, name):
                message = f"The joint {joint.name!r} that closes a loop needs the name {name!r}, which a link has."
                raise DeclarationError(message, remedy="Give the closure another name.", name=name)
            place = carrier.placement * pin.SE3(placement)
            model.addFrame(pin.Frame(name, carrier.parentJoint, place, pin.FrameType.BODY))


def ends_of(closure: Closure, model: pin.Model, data: pin.Data) -> tuple[Array, Array]:
    """Return the origins (3,) of both frames of a closure, m, world, where the joints are placed in the data."""
    frames = [find_link(model, name) for name in (closure.frame_a, closure.frame_b)]
    one, other = ((data.oMi[frame.parentJoint] * frame.placement).translation for frame in frames)
    return one, other


def turned_to(axis: Array, column: int = 2) -> Array:
    """Return a rotation (3, 3) whose column of that number is along an axis (3,), of any length but zero.

    It is the smallest turn that does this, the identity for an axis that is there already.
    """
    unit = axis / np.linalg.norm(axis)
    own = np.eye(3)[column]
    normal = np.cross(own, unit)
    sine, cosine = float(np.linalg.norm(normal)), float(own @ unit)
    if sine < RANK_TOLERANCE:  # the same way, or half a turn about another axis
        return np.eye(3) if cosine > 0.0 else np.asarray(pin.exp3(np.pi * np.eye(3)[column - 1]))
    return np.asarray(pin.exp3(np.arctan2(sine, cosine) * normal / sine))


def placed(rotation: Array, translation: ArrayLike) -> Array:
    """Return the (4, 4) placement of a rotation (3, 3) and a translation (3,)."""
    placement: Array = np.eye(4)
    placement[:3, :3], placement[:3, 3] = rotation, translation
    return placement
