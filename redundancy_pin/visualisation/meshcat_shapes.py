"""Meshes of what viewers have no primitive for: arrows, arcs, plates, and a path as a coloured tube."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.visualisation.scene import Mesh

AROUND = 14
"""Corners of a round cross-section."""

_ARC = 1.5 * np.pi
"""Angle of an arc up to its head: long enough to tell the sense of rotation, short enough to see where it starts."""


def arrow() -> Mesh:
    """Return an arrow of length 1 along z, with its foot at the origin; 0.22 wide at its head."""
    profile = np.array([[0.0, 0.0], [0.035, 0.0], [0.035, 0.75], [0.11, 0.75], [0.0, 1.0]])
    angles = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    rings = np.array([[[r * np.cos(a), r * np.sin(a), z] for a in angles] for r, z in profile])
    return _skin(rings, closed=False)


def arc() -> Mesh:
    """Return an arc with a head, of radius 1 about z, from the x axis in the positive sense."""
    shaft = [(angle, 0.06) for angle in np.linspace(0.0, _ARC - 0.35, 40)]
    sections = [(0.0, 0.0), *shaft, (_ARC - 0.35, 0.2), (_ARC, 0.0)]
    around = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    rings = []
    for angle, radius in sections:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        rings.append([out + radius * (np.cos(a) * out - np.sin(a) * up) for a in around])
    return _skin(np.array(rings), closed=False)


def plate(corners: Array, thickness: float) -> Mesh:
    """Return a prism over a polygon.

    Args:
        corners: (c, 3) in order around the polygon, c ≥ 3, m.
        thickness: m, half of it on either side.
    """
    middle = corners.mean(axis=0)
    normal = np.linalg.svd(corners - middle).Vh[2]
    offset = 0.5 * thickness * normal
    c = len(corners)
    vertices = np.concatenate([corners + offset, corners - offset, [middle + offset, middle - offset]])
    triangles = []
    for i in range(c):
        j = (i + 1) % c
        triangles += [(i, j, 2 * c), (c + j, c + i, 2 * c + 1), (i, c + i, j), (j, c + i, c + j)]
    return vertices, np.array(triangles, dtype=np.intp)


def tube(points: Array, radius: float) -> tuple[Array, IntArray, IntArray]:
    """Return a tube along points.

    Args:
        points: (N, 3), m; those that coincide with the one before are passed over.
        radius: m.

    Returns:
        Vertices (V, 3), triangles (T, 3), and (V,) the index of the point each vertex belongs to. Without any length
        all three are empty.
    """
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = np.concatenate([[0], np.flatnonzero(step > 1e-3 * radius) + 1]) if len(points) else np.zeros(0, dtype=int)
    if len(kept) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.intp), np.zeros(0, dtype=np.intp)
    way = points[kept]
    tangent = np.gradient(way, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    helper = np.eye(3)[int(np.argmin(np.abs(tangent).max(axis=0)))]  # the direction the path uses least
    first = np.cross(helper, tangent)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    second = np.cross(tangent, first)
    around = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)
    rings = way[:, None] + radius * (
        np.cos(around)[None, :, None] * first[:, None] + np.sin(around)[None, :, None] * second[:, None]
    )
    vertices, triangles = _skin(rings, closed=False)
    return vertices, triangles, np.repeat(kept, len(around))


def _skin(rings: Array, *, closed: bool) -> Mesh:
    """Return the surface through rings (R, a, 3)."""
    count, around = rings.shape[:2]
    ring = np.arange(count if closed else count - 1)[:, None]
    here, side = np.arange(around)[None, :], (np.arange(around)[None, :] + 1) % around
    after = (ring + 1) % count
    a, b = ring * around + here, ring * around + side
    c, d = after * around + here, after * around + side
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([b, d, c], axis=2)], axis=1)
    return rings.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.intp)
