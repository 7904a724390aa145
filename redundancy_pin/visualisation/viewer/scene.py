"""What a moving picture of a robot consists of, in plain arrays: no viewer is named here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, IntArray

Role = Literal["base", "link", "track", "carrier", "actuated", "passive", "closure", "platform"]
"""What a part is to the mechanism; it decides on the colour (``scene_colors``)."""

Shape = Literal["box", "cylinder", "sphere", "arc", "mesh"]

Mesh = tuple[Array, IntArray]
"""Vertices (V, 3), m, and triangles (T, 3), indices of vertices."""

Group = Literal["main", "carrier"]
"""Whose effort an arrow shows."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape fixed to a body.

    Attributes:
        name: unique within the body.
        body: index of the joint that moves it; 0 is the base.
        placement: (4, 4) homogeneous placement in the frame of that joint, m.
        shape: what it is; a cylinder has its axis along z.
        size: sides (3) of a box, radius and length of a cylinder, radius of a sphere, m; radius and thickness of an
            arc, m, and where it starts and ends, rad about z from x; empty for a mesh.
        role: what it is to the mechanism.
        color: ``#rrggbb``.
        mesh: of a mesh, in the frame of ``placement``; None for other shapes.
    """

    name: str
    body: int
    placement: Array
    shape: Shape
    size: tuple[float, ...]
    role: Role
    color: str
    mesh: Mesh | None = None


@dataclass(frozen=True, eq=False)
class Plate:
    """A flat polygon through points of one body: the base, or the platform.

    Attributes:
        name: unique.
        body: index of the joint that moves it; 0 is the base.
        corners: (c, 3) in order around it, in the frame of that joint, m. With fewer than three corners there is no
            polygon: a bar, or a ball.
        thickness: m.
        role: "base" or "platform".
    """

    name: str
    body: int
    corners: Array
    thickness: float
    role: Role


@dataclass(frozen=True, eq=False)
class Arrow:
    """The effort of one actuator over the frames: straight for a force, an arc for a torque.

    Attributes:
        name: of the joint.
        body: index of the joint; the arrow starts at its origin and turns with it.
        axis: (3,) unit axis of the joint in its own frame; positive efforts point along it.
        turning: whether it is a torque.
        group: whose effort it is.
        length: (F,) with its sign, m; the radius of an arc. Zero where no finite effort exists.
    """

    name: str
    body: int
    axis: Array
    turning: bool
    group: Group
    length: Array


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot in motion. F frames, N points of the path, J joints of the tree with the base as number 0.

    Attributes:
        title: one line.
        names: (J,) names of the joints, the base first.
        t: (F,) time of each frame, s, from zero.
        placement: (F, J, 4, 4) placement of each joint's frame in the world, m.
        solids: links, joints, tracks, carriers.
        plates: base and platform.
        arrows: efforts.
        margin: (F,) distance to type II, scaled; NaN where unknown.
        path: (N, 3) way of the traced point, world, m.
        path_margin: (N,) margin along it.
        size: the size of the machine, m: parts that have no size of their own are drawn in proportion to it.
        captions: what the arrows' lengths stand for, a line each.
    """

    title: str
    names: tuple[str, ...]
    t: Array
    placement: Array
    solids: tuple[Solid, ...]
    plates: tuple[Plate, ...]
    arrows: tuple[Arrow, ...]
    margin: Array
    path: Array
    path_margin: Array
    size: float
    captions: tuple[str, ...]

    @property
    def duration(self) -> float:
        """Duration of the motion, s."""
        return float(self.t[-1])


def corners_of(solid: Solid) -> Array:
    """Return points (P, 3) whose convex hull holds a solid, in the frame of its body, m."""
    if solid.mesh is not None:
        low, high = solid.mesh[0].min(axis=0), solid.mesh[0].max(axis=0)
    elif solid.shape == "arc":
        points = arc_points(solid)
        low, high = points.min(axis=0), points.max(axis=0)
    else:
        if solid.shape == "box":
            half = 0.5 * np.array(solid.size)
        elif solid.shape == "cylinder":
            half = np.array([solid.size[0], solid.size[0], 0.5 * solid.size[1]])
        else:
            half = np.full(3, solid.size[0])
        low, high = -half, half
    corners: Array = np.where(_CUBE, high, low)
    placed: Array = corners @ solid.placement[:3, :3].T + solid.placement[:3, 3]
    return placed


def arc_points(solid: Solid) -> Array:
    """Return points (P, 3) along the middle of a solid that is an arc, in the frame of its placement, m."""
    radius, _, low, high = solid.size
    angle = np.linspace(low, high, max(2, round(abs(high - low) / _ARC_STEP) + 1))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=1)


_CUBE = np.array([[x, y, z] for x in (False, True) for y in (False, True) for z in (False, True)])
"""Which corner of a box has the high coordinate along which axis."""

_ARC_STEP = 0.05
"""Of the points along an arc, rad."""


ROLE_COLORS: Mapping[Role, str] = {
    "base": "#5A5A5A",
    "link": "#4A7FB5",
    "track": "#F0C808",
    "carrier": "#D95F0E",
    "actuated": "#202020",
    "passive": "#C8C8C8",
    "closure": "#9B59B6",
    "platform": "#348C4D",
}
"""Colour of each role, where the URDF does not give a link its own."""

ROLE_NAMES: Mapping[Role, str] = {
    "link": "link",
    "actuated": "driven joint",
    "passive": "passive joint",
    "closure": "closure",
    "track": "track",
    "carrier": "carrier",
}
"""What legends call them, in their order."""

EFFORT_COLORS: Mapping[Group, str] = {"main": "#E4007C", "carrier": "#00A3A3"}
"""Colours of the arrows: the main actuators', the carriers'."""

MARGIN_EDGES = (NEAR_SINGULAR_MARGIN, 0.1, 0.2, 0.4)
"""Where the classes of the margin part: below the first a pose is reported as near-singular."""

MARGIN_COLORS = ("#B2182B", "#EF6C00", "#F6B600", "#5BAA3A", "#2166AC")
"""Colour of each class of the margin, from singular to far."""

UNKNOWN_COLOR = "#9E9E9E"
"""Where there is no margin."""


def margin_classes(margin: Array) -> IntArray:
    """Return (N,) the class of each margin: an index into ``MARGIN_COLORS``, −1 where it is not known."""
    found: IntArray = np.searchsorted(MARGIN_EDGES, np.abs(margin), side="right").astype(np.intp)
    return np.where(np.isnan(margin), -1, found)


def margin_labels() -> tuple[str, ...]:
    """Return what the legend says of each class."""
    edges = [f"{edge:g}" for edge in MARGIN_EDGES]
    inner = [f"{low} to {high}" for low, high in pairwise(edges)]
    return (f"below {edges[0]}: near-singular", *inner, f"above {edges[-1]}")


def rgb(color: str) -> tuple[float, float, float]:
    """Return a colour ``#rrggbb`` as three numbers from 0 to 1."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue


def code(color: str) -> int:
    """Return a colour ``#rrggbb`` as one number, as viewers want it."""
    return int(color[1:], 16)


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
