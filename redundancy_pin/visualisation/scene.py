"""What a moving picture of a robot consists of, in plain arrays: no viewer is named here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from redundancy_pin.arrays import Array, IntArray

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
