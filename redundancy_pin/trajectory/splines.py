"""A smooth path through a user's own list of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from redundancy_pin.arrays import Array, checked, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.domain import ROUNDING, Side, inside, require_side
from redundancy_pin.trajectory.paths import PathPoint
from redundancy_pin.trajectory.segments import straight_pieces

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_LENGTH_TOLERANCE = 1e-13
"""Relative change of the arc length by halving the panels below which it counts as converged."""
_LEAST_RATE = 1e-6
"""|r'| below which the direction is lost; it is about 1 elsewhere, for u is the distance between points."""
_MOST_HALVINGS = 8
_MOST_NEWTON_STEPS = 30


@dataclass(frozen=True, init=False, eq=False)
class SplinePath:
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
        for name, value in (
            ("points", given),
            ("closed", closed),
            ("length", float(arc_at_edges[-1])),
            ("_spline", spline),
            ("_edges", frozen(edges)),
            ("_arc_at_edges", frozen(arc_at_edges)),
        ):
            object.__setattr__(self, name, value)

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return int(self.points.shape[1])

    @property
    def breaks(self) -> Array:
        """(0,) the curvature is continuous."""
        return frozen([])

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p, m; see ``Path.evaluate``.

        Raises:
            InputError: p outside [0, length].
        """
        require_side(side)
        u = self._parameter(inside(p, 0.0, self.length, "p", "m"))
        first, second = self._spline(u, 1), self._spline(u, 2)
        speed = np.linalg.norm(first, axis=-1, keepdims=True)
        tangent = first / speed
        normal = second - np.sum(second * tangent, axis=-1, keepdims=True) * tangent
        return PathPoint(self._spline(u), tangent, normal / speed**2)

    def _parameter(self, p: Array) -> Array:
        """Return the spline parameter u at arc lengths p: Newton steps inside the panel of each p."""
        panel = np.searchsorted(self._arc_at_edges, p, side="right") - 1
        panel = np.clip(panel, 0, len(self._edges) - 2)
        lower, upper = self._edges[panel], self._edges[panel + 1]
        target = p - self._arc_at_edges[panel]
        u = lower + (upper - lower) * target / (self._arc_at_edges[panel + 1] - self._arc_at_edges[panel])
        for _ in range(_MOST_NEWTON_STEPS):
            miss = _arc_length(self._spline, lower, u) - target
            step = miss / np.linalg.norm(self._spline(u, 1), axis=-1)
            u = np.clip(u - step, lower, upper)
            if np.abs(miss).max(initial=0.0) <= ROUNDING * 1e-2 * self.length:
                break
        return u


def through_points(points: ArrayLike, *, closed: bool = False) -> SplinePath:
    """Return a smooth path through points, in order.

    Args:
        points: (N, n) points, m, in any dimension; two of them give a straight line.
        closed: whether to return to the first point, which is not repeated.

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
    """Return panel edges in u and the arc length at each, halving all panels until it stands still."""
    edges = knots
    lengths = _arc_length(spline, edges[:-1], edges[1:])
    for _ in range(_MOST_HALVINGS):
        finer = np.sort(np.concatenate([edges, 0.5 * (edges[:-1] + edges[1:])]))
        halves = _arc_length(spline, finer[:-1], finer[1:])
        change = np.abs(halves[0::2] + halves[1::2] - lengths).max()
        edges, lengths = finer, halves
        if change <= _LENGTH_TOLERANCE * lengths.sum():
            break
    else:
        raise _cusp(spline, edges)
    # A cusp right at an edge does not disturb the quadrature on either side of it.
    if np.linalg.norm(spline(edges, 1), axis=-1).min() < _LEAST_RATE:
        raise _cusp(spline, edges)
    return edges, np.concatenate([[0.0], np.cumsum(lengths)])


def _cusp(spline: CubicSpline, edges: Array) -> InputError:
    rate = np.linalg.norm(spline(edges, 1), axis=-1)
    k = int(np.argmin(rate))
    return InputError(
        f"The spline through the points has a cusp near {np.asarray(spline(edges[k])).round(6).tolist()}: "
        "its direction is not defined there.",
        remedy="Space the points more evenly, or round the turn with more points.",
        rate=float(rate[k]),
    )
