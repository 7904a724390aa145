"""A smooth path through a user's own list of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from redundancy_pin.arrays import Array, assign, checked, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.paths import PathPoint, SmoothPath, straight_pieces

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_LENGTH_TOLERANCE = 1e-14
"""Change of a panel's arc length by halving it, relative to the whole, below which it counts as converged."""
_LEAST_RATE = 1e-4
"""|r'| below which the path counts as turning on the spot. It is about 1 elsewhere, for u is the distance between
points; where it falls to this the radius of curvature is about 1e-8 of that distance."""
_MOST_HALVINGS = 40
"""At a cusp the panels shrink until their square is lost in rounding, after 25 halvings."""
_INVERSION_TOLERANCE = 1e-14
"""Arc length, relative to the whole, to which p is met: fifty roundings."""
_MOST_STEPS = 60
"""Bisection alone would halve a panel to its last bit in fewer; Newton takes about four."""


@dataclass(frozen=True, init=False, eq=False)
class SplinePath(SmoothPath):
    """A cubic spline through points, parametrised by its own arc length.

    The spline r(u) takes the distance between points as its parameter; its second derivative is continuous,
    so the path has no breaks. With r' its derivative by u and e = r'/|r'|:
    x' = e, x'' = (r'' − (r''·e) e)/|r'|². The arc length comes from Gauss quadrature and is inverted by Newton
    steps on the same quadrature, both to rounding.

    Attributes:
        points: (N, n) the points, m.
        closed: whether the path returns to its first point, with continuous curvature.
        length: arc length, m.

    Raises:
        InputError: too few points, two consecutive ones that coincide, or a spline with a cusp.
    """

    points: Array
    closed: bool
    length: float
    _spline: CubicSpline
    _edges: Array
    _arc_at_edges: Array

    def __init__(self, points: ArrayLike, *, closed: bool = False) -> None:
        given = checked(points, "points", ("N", "n"))
        needed = 3 if closed else 2
        if len(given) < needed:
            raise InputError(f"points has {len(given)} points, expected at least {needed}.", count=len(given))
        ring = np.concatenate([given, given[:1]]) if closed else given
        chords, _ = straight_pieces(ring)
        knots = np.concatenate([[0.0], np.cumsum(chords)])
        spline = CubicSpline(knots, ring, bc_type="periodic" if closed else "natural")
        edges, arc_at_edges = _arc_length_table(spline, knots)
        assign(self, points=given, closed=closed, length=float(arc_at_edges[-1]))
        assign(self, _spline=spline, _edges=frozen(edges), _arc_at_edges=frozen(arc_at_edges))

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return int(self.points.shape[1])

    def _at(self, p: Array) -> PathPoint:
        u = self._parameter(p)
        first, second = self._spline(u, 1), self._spline(u, 2)
        speed = np.linalg.norm(first, axis=-1, keepdims=True)
        tangent = first / speed
        normal = second - np.sum(second * tangent, axis=-1, keepdims=True) * tangent
        return PathPoint(self._spline(u), tangent, normal / speed**2)

    def _parameter(self, p: Array) -> Array:
        """Return the spline parameter u at arc lengths p: Newton steps, or bisection where one leaves its bracket."""
        panel = np.searchsorted(self._arc_at_edges, p, side="right") - 1
        panel = np.clip(panel, 0, len(self._edges) - 2)
        start, low, high = self._edges[panel], self._edges[panel], self._edges[panel + 1]
        target = p - self._arc_at_edges[panel]
        u = low + (high - low) * target / (self._arc_at_edges[panel + 1] - self._arc_at_edges[panel])
        for _ in range(_MOST_STEPS):
            miss = _arc_length(self._spline, start, u) - target
            if np.abs(miss).max(initial=0.0) <= _INVERSION_TOLERANCE * self.length:
                break
            low, high = np.where(miss < 0.0, u, low), np.where(miss > 0.0, u, high)
            newton = u - miss / np.linalg.norm(self._spline(u, 1), axis=-1)
            u = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        return u


def through_points(points: ArrayLike, *, closed: bool = False) -> SplinePath:
    """Return a smooth path through (N, n) points, m, in order; closed, it returns to the first, which is not repeated.

    Raises:
        InputError: too few points, two consecutive ones that coincide, or a spline with a cusp.
    """
    return SplinePath(points, closed=closed)


def _arc_length(spline: CubicSpline, lower: Array, upper: Array) -> Array:
    """Return ∫ |r'(u)| du between lower and upper, any equal shapes, within one panel each."""
    half = 0.5 * (upper - lower)
    nodes = (lower + half)[..., None] + half[..., None] * _NODES
    length: Array = half * (np.linalg.norm(spline(nodes, 1), axis=-1) @ _WEIGHTS)
    return length


def _arc_length_table(spline: CubicSpline, knots: Array) -> tuple[Array, Array]:
    """Return panel edges in u and the arc length at each; a panel is halved until its length stands still."""
    start, end = knots[:-1], knots[1:]
    lengths = _arc_length(spline, start, end)
    total = lengths.sum()
    starts, pieces = [], []
    for _ in range(_MOST_HALVINGS):
        middle = 0.5 * (start + end)
        first, second = _arc_length(spline, start, middle), _arc_length(spline, middle, end)
        moving = np.abs(first + second - lengths) > _LENGTH_TOLERANCE * total
        starts += [start[~moving], middle[~moving]]
        pieces += [first[~moving], second[~moving]]
        start, end = np.concatenate([start[moving], middle[moving]]), np.concatenate([middle[moving], end[moving]])
        lengths = np.concatenate([first[moving], second[moving]])
        if len(start) == 0:
            break
    edges = np.concatenate([*starts, start, knots[-1:]])
    order = np.argsort(edges)
    arcs = np.concatenate([[0.0], np.cumsum(np.concatenate([*pieces, lengths])[order[:-1]])])
    _require_direction(spline, edges[order], unsettled=len(start) > 0)
    return edges[order], arcs


def _require_direction(spline: CubicSpline, edges: Array, unsettled: bool) -> None:
    half = 0.5 * np.diff(edges)[:, None]
    places = np.concatenate([edges, (edges[:-1, None] + half + half * _NODES).ravel()])
    rate = np.linalg.norm(spline(places, 1), axis=-1)
    k = int(np.argmin(rate))
    if unsettled or rate[k] < _LEAST_RATE:
        raise InputError(
            f"The spline through the points has a cusp near {np.asarray(spline(places[k])).round(6).tolist()}: "
            "its direction is not defined there.",
            remedy="Space the points more evenly, or round the turn with more points.",
            rate=float(rate[k]),
        )
