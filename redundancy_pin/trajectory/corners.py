"""Straights joined by arcs: the rounded corner and the rounded polygon."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import ROUNDING, Array, checked, positive
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.paths import Arc, ChainedPath, Line, Path, straight_pieces

_STRAIGHT_ANGLE = 1e-9
"""Turns below this angle, rad, are no corner: the polygon runs straight on."""


def corner_path(
    start: ArrayLike,
    direction: ArrayLike,
    straight: float,
    radius: float,
    angle: float = np.pi / 2.0,
    second_straight: float | None = None,
) -> ChainedPath:
    """Return a straight, a circular arc and a second straight in the plane (Parsa 2014, section 4.2.2).

    Args:
        start: (2,) start point, m.
        direction: (2,) direction of the first straight; any length but zero.
        straight: length of the first straight, m.
        radius: radius of the arc, m.
        angle: signed turn, rad, positive to the left.
        second_straight: length of the second straight, m; as the first when left out.

    Raises:
        InputError: a length, the radius, the direction or the angle is zero, negative or not finite.
    """
    first = checked(start, "start", (2,))
    heading = checked(direction, "direction", (2,))
    if not heading.any() or angle == 0.0 or not np.isfinite(angle):
        raise InputError(
            f"A corner needs a direction and a turn; direction = {heading.tolist()}, angle = {angle:g} rad.",
            remedy="Use Line for a straight.",
        )
    forward = heading / np.linalg.norm(heading)
    left = np.array([-forward[1], forward[0]])
    inward = np.sign(angle) * left
    entry = first + positive(straight, "straight", "m") * forward
    arc = Arc(entry + positive(radius, "radius", "m") * inward, radius, -inward, forward, abs(angle))
    leave = arc.evaluate(arc.length)
    rest = straight if second_straight is None else positive(second_straight, "second_straight", "m")
    return ChainedPath([Line(first, entry), arc, Line(leave.x, leave.x + rest * leave.tangent)])


def rounded_polygon(
    vertices: ArrayLike, radius: float, *, closed: bool = True, start: float | None = None
) -> ChainedPath:
    """Return a polygon whose corners are rounded by arcs of one radius, in any dimension.

    At a vertex where the direction turns by θ the arc begins and ends r tan(θ/2) from the vertex.

    Args:
        vertices: (N, n) corners, m; a closed polygon does not repeat its first.
        radius: corner radius r, m.
        closed: whether the last vertex is joined to the first. An open polygon starts and ends in
            its first and last vertex.
        start: closed polygon only: distance of the start (and end) from the first vertex along
            the first edge, m; it must lie on what the arcs leave of that edge. Its middle when left out.

    Raises:
        InputError: too few vertices, two that coincide, an edge that turns back on itself, a radius that does
            not fit (with edge, lengths and the largest radius that fits), a start off the straight part or of an
            open polygon.
    """
    corners = checked(vertices, "vertices", ("N", "n"))
    r = positive(radius, "radius", "m")
    needed = 3 if closed else 2
    if start is not None and not closed:
        raise InputError(
            f"start = {start:g} m is for a closed polygon.", remedy="An open polygon starts in its first vertex."
        )
    if len(corners) < needed:
        raise InputError(f"vertices has {len(corners)} points, expected at least {needed}.", count=len(corners))
    ring = np.concatenate([corners, corners[:1]]) if closed else corners
    edges, directions = straight_pieces(ring)
    following = np.concatenate([directions, directions[:1]]) if closed else directions
    turns = _turn_angles(following)
    trims = r * np.tan(turns / 2.0)
    at_start, at_end = (np.roll(trims, 1), trims) if closed else (np.append(0.0, trims), np.append(trims, 0.0))
    _require_fit(edges, at_start, at_end, r)

    arcs = [
        _corner_arc(ring[k + 1], following[k], following[k + 1], turn, r) if turn > _STRAIGHT_ANGLE else None
        for k, turn in enumerate(turns)
    ]
    if not closed:
        return _chain_between(corners[0], arcs, [*corners[1:-1]], corners[-1])
    offset = _start_offset(start, float(edges[0]), float(at_start[0]), float(at_end[0]))
    origin = corners[0] + offset * directions[0]
    return _chain_between(origin, arcs, [*corners[1:], corners[0]], origin)


def _chain_between(start: Array, arcs: Sequence[Arc | None], vertices: Sequence[Array], end: Array) -> ChainedPath:
    """Join arcs (None: the path runs straight through that vertex) by straights."""
    segments: list[Path] = []
    here = start
    scale = max(float(np.linalg.norm(vertex - start)) for vertex in [*vertices, end])
    for arc, vertex in zip([*arcs, None], [*vertices, end], strict=True):
        entry = vertex if arc is None else arc.evaluate(0.0).x
        if np.linalg.norm(entry - here) > ROUNDING * scale:
            segments.append(Line(here, entry))
        here = entry
        if arc is not None:
            segments.append(arc)
            here = arc.evaluate(arc.length).x
    return ChainedPath(segments)


def _corner_arc(vertex: Array, before: Array, after: Array, turn: float, radius: float) -> Arc:
    inward = after - np.dot(after, before) * before
    inward = inward / np.linalg.norm(inward)
    entry = vertex - radius * np.tan(turn / 2.0) * before
    return Arc(entry + radius * inward, radius, -inward, before, turn)


def _turn_angles(directions: Array) -> Array:
    before, after = directions[:-1], directions[1:]
    # atan2 of half-angle lengths keeps its digits near 0 and near π, where acos of the product loses half.
    turns: Array = 2.0 * np.arctan2(np.linalg.norm(after - before, axis=1), np.linalg.norm(after + before, axis=1))
    back = np.flatnonzero(turns > np.pi - _STRAIGHT_ANGLE)
    if len(back):
        raise InputError(
            f"The polygon turns back on itself after edge {int(back[0])}.",
            remedy="No arc joins two opposite directions: insert a vertex to the side.",
            edge=int(back[0]),
        )
    return turns


def _require_fit(edges: Array, at_start: Array, at_end: Array, radius: float) -> None:
    taken = at_start + at_end
    excess = taken - edges
    k = int(np.argmax(excess))
    if excess[k] > ROUNDING * edges[k]:
        fits = float(np.min(edges[taken > 0.0] / taken[taken > 0.0]) * radius)
        raise InputError(
            f"Corner radius {radius:g} m does not fit: edge {k} is {edges[k]:.6g} m long and its rounded ends "
            f"take {taken[k]:.6g} m.",
            remedy=f"Use a radius of at most {fits:.6g} m.",
            edge=k,
            largest_radius=fits,
        )


def _start_offset(start: float | None, edge: float, lower: float, trim: float) -> float:
    upper = edge - trim
    offset = 0.5 * (lower + upper) if start is None else float(start)
    if not lower - ROUNDING * edge <= offset <= upper + ROUNDING * edge:
        raise InputError(
            f"start = {offset:.6g} m is not on the straight part of the first edge, [{lower:.6g}, {upper:.6g}] m.",
            remedy="Start on the straight part, or leave start out.",
            start=offset,
            lower=lower,
            upper=upper,
        )
    return offset
