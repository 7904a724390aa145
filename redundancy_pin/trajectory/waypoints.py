"""Paths from points: corners and polygons rounded by arcs, splines by arc length or by time, and through poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, CubicSpline, PPoly, make_interp_spline

from redundancy_pin.arrays import ROUNDING, Array, Frozen, assign, checked, frozen, positive
from redundancy_pin.errors import InputError, shown
from redundancy_pin.motion import SIX_DIGITS
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, chebyshev_times, first_times
from redundancy_pin.trajectory.paths import Arc, ChainedPath, Line, Path, PathPoint, SmoothPath, straight_pieces
from redundancy_pin.trajectory.quaternions import (
    HALF_TURN_MARGIN,
    angular_rates,
    poses_of,
    quaternions_of,
    turns_between,
)
from redundancy_pin.trajectory.trajectory import Ends

_FARTHEST = 1e100  # m: squares of such lengths are numbers still
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

    Example:
        >>> round(rp.trajectory.corner_path([0.8, 0.4], [1.0, 0.0], 0.12, 0.025).length, 3)
        0.279
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

    Example:
        >>> round(rp.trajectory.rounded_polygon([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]], 0.02).length, 3)
        0.766
    """
    corners = _near(vertices, "vertices")
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
        message = (
            f"Corner radius {radius:g} m does not fit: edge {k} is {edges[k]:.6g} m long and its rounded ends "
            f"take {taken[k]:.6g} m."
        )
        remedy = f"Use a radius of at most {fits:.6g} m."
        raise InputError(message, remedy=remedy, edge=k, largest_radius=fits)


def _start_offset(start: float | None, edge: float, lower: float, trim: float) -> float:
    upper = edge - trim
    offset = 0.5 * (lower + upper) if start is None else float(start)
    if not lower - ROUNDING * edge <= offset <= upper + ROUNDING * edge:
        message = f"start = {offset:.6g} m is not on the straight part of the first edge, [{lower:.6g}, {upper:.6g}] m."
        remedy = "Start on the straight part, or leave start out."
        raise InputError(message, remedy=remedy, start=offset, lower=lower, upper=upper)
    return offset


_LENGTH_TOLERANCE = 1e-11
"""Last Chebyshev coefficients of the speed |r'| on a piece, relative to the largest speed: its integral is then exact
to rounding (1e-15, measured)."""
_LEAST_RATE = 1e-4
"""|r'| below which the path counts as turning on the spot. It is about 1 elsewhere, for u is the distance between
points; where it falls to this the radius of curvature is about 1e-8 of that distance."""


@dataclass(frozen=True, init=False, eq=False)
class SplinePath(Frozen, SmoothPath):
    """A cubic spline through points, parametrised by its own arc length.

    The spline r(u) takes the distance between points as its parameter; its second derivative is continuous,
    so the path has no breaks. With r' its derivative by u and e = r'/|r'|:
    x' = e, x'' = (r'' − (r''·e) e)/|r'|². The arc length is the integral of a fit of |r'| in polynomials, and is
    inverted, both to machine precision.

    Attributes:
        points: (N, n) the points, m.
        closed: whether the path returns to its first point, with continuous curvature.
        length: arc length, m.

    Raises:
        InputError: too few points, two consecutive ones that coincide, or a spline with a cusp.

    Example:
        >>> round(rp.trajectory.SplinePath([[0.0, 0.0], [0.1, 0.2], [0.3, 0.1]]).length, 3)
        0.461
    """

    points: Array
    closed: bool
    length: float
    _spline: CubicSpline
    _arc: PPoly

    def __init__(self, points: ArrayLike, *, closed: bool = False) -> None:
        given = _near(points, "points")
        needed = 3 if closed else 2
        if len(given) < needed:
            raise InputError(f"points has {len(given)} points, expected at least {needed}.", count=len(given))
        ring = np.concatenate([given, given[:1]]) if closed else given
        chords, _ = straight_pieces(ring)
        knots = np.concatenate([[0.0], np.cumsum(chords)])
        spline = CubicSpline(knots, ring, bc_type="periodic" if closed else "natural")

        def speed(u: Array) -> Array:
            return np.asarray(np.linalg.norm(spline(u, 1), axis=1)[:, None])

        fitted = PiecewisePolynomial.fit(speed, knots, np.empty(0), lambda v: v.max(axis=0), _LENGTH_TOLERANCE)
        _require_direction(spline, np.union1d(fitted.edges, chebyshev_times(fitted.edges)))
        arc = PPoly(fitted.coefficients[:, :, 0], fitted.edges).antiderivative()
        assign(self, points=given, closed=closed, length=float(arc(knots[-1])), _spline=spline, _arc=arc)

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return int(self.points.shape[1])

    @property
    def lengths_at_points(self) -> Array:
        """(N,) arc lengths at the points, m; one more, at the end, where the path is closed."""
        return np.asarray(self._arc(self._spline.x))

    @property
    def knots(self) -> Array:
        """(c,) inner arc lengths between which the path is resolved by a few points, m: close together at a cusp."""
        return frozen(self._arc(self._arc.x[1:-1]))

    def _at(self, p: Array) -> PathPoint:
        u = first_times(self._arc, p)
        first, second = self._spline(u, 1), self._spline(u, 2)
        speed = np.linalg.norm(first, axis=-1, keepdims=True)
        tangent = first / speed
        normal = second - np.sum(second * tangent, axis=-1, keepdims=True) * tangent
        return PathPoint(self._spline(u), tangent, normal / speed**2)


def through_points(points: ArrayLike, *, closed: bool = False) -> SplinePath:
    """Return a smooth path through (N, n) points, m, in order; closed, it returns to the first, which is not repeated.

    Raises:
        InputError: too few points, two consecutive ones that coincide, or a spline with a cusp.

    Example:
        >>> round(rp.trajectory.through_points([[0.0, 0.0], [0.1, 0.2], [0.3, 0.1]]).length, 3)
        0.461
    """
    return SplinePath(points, closed=closed)


def _require_direction(spline: CubicSpline, places: Array) -> None:
    rate = np.linalg.norm(spline(places, 1), axis=-1)
    k = int(np.argmin(rate))
    if rate[k] < _LEAST_RATE:
        raise InputError(
            f"The spline through the points has a cusp near {np.asarray(spline(places[k])).round(6).tolist()}: "
            "its direction is not defined there.",
            remedy="Space the points more evenly, or round the turn with more points.",
            rate=float(rate[k]),
        )


def _near(points: ArrayLike, name: str) -> Array:
    array = checked(points, name, ("N", "n"))
    far = float(np.abs(array).max(initial=0.0))
    if far > _FARTHEST:
        raise InputError(f"{name} are up to {far:.3g} m from the origin.", remedy="Give them in metres.", name=name)
    return array


_PASSED = 1e-6
"""Part of the size of all by which points may be missed: by more, times are too uneven for the spline's equations."""

_LEAST_NORM = 0.3
"""Of a quaternion between poses, before it is normalised: below, the poses turn too far for what is between them."""


ENDS = ("auto", "rest", "samples")

_FEWEST_POINTS = 6
"""Points that a quintic takes, and that can show rest: through five of them all ends are equally smooth."""

_ROUGHER = 1.25
"""Rest is shown by points that no end makes smoother: by so many times the largest jerk near the end. The ratio is
1 or less for motions from rest of the third and higher orders in time, and 100 at constant speed."""

_MOVES = 100.0
"""Roundings by which points move that stood in two steps: at constant acceleration seven steps are 49 times one."""

_WINDOW = 8
"""Points in which the end of a motion is judged; of dense and rounded points each second, fourth, ... counts."""


def resolve_ends(points: Array, times: Array, ends: object = "auto") -> Ends:
    """Return what holds at the ends of a motion through (N, d) points at (N,) times, s.

    ``auto``: "rest" where the points show it, else "samples". Points show rest where a motion that starts (ends) at
    rest without acceleration is as smooth as one with the speed and the acceleration of the points: its largest jerk
    within two steps is at most 1.25 times as large, in each coordinate; or where the points stand during two steps, and
    move then. Six digits suffice.

    Args:
        points: (N, d) the points, m and rad.
        times: (N,) increasing times, s.
        ends: one of ``ENDS``, or a pair of them, for the start and the end.

    Raises:
        InputError: another word.
    """
    words = (ends, ends) if isinstance(ends, str) else ends
    if not isinstance(words, (tuple, list)) or len(words) != 2 or any(word not in ENDS for word in words):
        raise InputError(
            f"ends is {shown(ends)}.", remedy=f"Pass one of {', '.join(ENDS)}, or a pair of them.", name="ends"
        )
    start, end = (points, times), (points[::-1], times[-1] - times[::-1])
    return _resolve_end(words[0], *start), _resolve_end(words[1], *end)


def _resolve_end(word: str, points: Array, times: Array) -> Literal["rest", "samples"]:
    return "rest" if word == "rest" or (word == "auto" and _shows_rest(points, times)) else "samples"


def _rounding(points: Array) -> Array:
    """Return (d,) the error of (N, d) points: that of six digits, or less where eighth differences show less."""
    size = np.abs(points).max(axis=0)
    differences = np.abs(np.diff(points, 8, axis=0)).max(axis=0, initial=0.0) / 64.0  # of noise 65 times its size
    return np.asarray(np.clip(differences, 4.0 * np.finfo(float).eps * size, SIX_DIGITS * size))


def _shows_rest(points: Array, times: Array) -> bool:
    """Return whether (N, d) points at (N,) times start from rest; as ``resolve_ends``."""
    d, stride = points.shape[1], 1
    if len(points) < _FEWEST_POINTS:
        return False
    while len(times) > (_FEWEST_POINTS - 1) * stride:
        near = slice(0, (_WINDOW - 1) * stride + 1, stride)
        t, y = times[near] - times[0], points[near] - points[0]
        rounding = _rounding(points[: 3 * near.stop])
        if (np.abs(y[:3]) <= rounding).all() and (np.abs(y) > _MOVES * rounding).any():
            return True
        columns, inside = np.concatenate([y, np.eye(len(t))], axis=1), np.linspace(0.0, t[2], 9)
        jerks = []
        for start in (np.zeros((2, columns.shape[1])), _end_rates(t, columns)):
            jerk = np.abs(
                _spline(t, columns, start, _end_rates(t[-1] - t[::-1], columns[::-1]) * [[-1.0], [1.0]])(inside, 3)
            )
            jerks.append((jerk[:, :d].max(axis=0), jerk[:, d:].sum(axis=1).max()))
        (rest, from_rest), (free, from_free) = jerks
        unsure = (from_rest + from_free) * rounding
        if (rest > _ROUGHER * free + unsure).any():
            return False
        if (free > 4.0 * unsure).any():
            return True
        stride *= 2
    return True


def _end_rates(times: Array, points: Array) -> Array:
    """Return (2, d) first and second derivative at the first of few (N, d) points, by the polynomial through six."""
    t, y = times[:_FEWEST_POINTS] - times[0], points[:_FEWEST_POINTS]
    scale = t[-1]
    powers = np.linalg.solve(np.vander(t / scale, increasing=True), y - y[0])
    first, second = powers[1], powers[2] if len(t) > 2 else 0.0 * powers[1]
    return np.asarray([first / scale, 2.0 * second / scale**2])


def _measured_rates(times: Array, points: Array) -> Array:
    """Return (2, d) first and second derivative at the first of (N, d) points.

    Errors are of fifth and fourth order in the steps. Of dense and rounded points every second, fourth, ... is taken,
    as long as rounding hides the difference that it makes (Lepski's rule).
    """
    stride = 1
    rates = _end_rates(times, points)
    while len(times) > 2 * (_FEWEST_POINTS - 1) * stride:
        near = slice(0, (_FEWEST_POINTS - 1) * stride + 1, stride)
        t = times[near] - times[0]
        unsure = np.abs(_end_rates(t, np.eye(len(t)))).sum(axis=1)[:, None] * _rounding(points[: 3 * near.stop])
        wider = _end_rates(times[:: 2 * stride], points[:: 2 * stride])
        if (np.abs(wider - rates) > unsure).any():
            break
        rates, stride = wider, 2 * stride
    return rates


def _spline(times: Array, points: Array, start: Array, end: Array) -> BSpline:
    """Return the quintic through (N, d) points, with (2, d) first and second derivatives at the ends."""
    conditions = tuple([(1, rates[0]), (2, rates[1])] for rates in (start, end))
    return make_interp_spline(times, points, k=5, bc_type=conditions)


@dataclass(frozen=True, init=False, eq=False)
class TimedSpline(Frozen, SmoothPath):
    """A quintic spline through points at given times.

    It is a path whose parameter is the time since the first point; four derivatives are continuous. At each end it is
    at rest without acceleration, or has the speed and the acceleration that the points have there, by polynomials
    through the six next to it (through all, of fewer). Between points of a smooth motion h seconds apart the errors of
    x, ẋ and ẍ fall with h⁶, h⁵ and h⁴.

    Attributes:
        points: (N, d) the points, m and rad.
        times: (N,) when they are passed, s, from zero.
        length: duration, s.
        ends: "rest" or "samples", at the start and at the end; of ``ends="auto"`` by ``resolve_ends``.
    """

    points: Array
    times: Array
    length: float
    ends: Ends
    _spline: BSpline

    def __init__(self, points: ArrayLike, times: ArrayLike, ends: str | Sequence[str] = "auto") -> None:
        given = checked(points, "points", ("N", "d"))
        t = checked(times, "times", (len(given),))
        if len(t) < 2 or (np.diff(t) <= 0.0).any():
            k = int(np.diff(t).argmin()) if len(t) > 1 else 0
            raise InputError(
                f"times must increase: {t[k : k + 2].tolist()} at point {k}.",
                remedy="Pass at least two points, each later than the one before.",
                index=k,
            )
        t = t - t[0]
        rest = np.zeros((2, given.shape[1]))
        try:
            with np.errstate(all="ignore"):
                resolved = resolve_ends(given, t, ends)
                start = rest if resolved[0] == "rest" else _measured_rates(t, given)
                backwards = t[-1] - t[::-1], given[::-1]
                end = rest if resolved[1] == "rest" else _measured_rates(*backwards) * [[-1.0], [1.0]]
                spline = _spline(t, given, start, end)
                missed = float(np.abs(spline(t) - given).max())
        except InputError:
            raise
        except ValueError:  # numbers that are infinite, or LinAlgError
            missed = np.inf
        if not missed <= _PASSED * max(float(np.ptp(given, axis=0).max()), _PASSED * float(np.abs(given).max())):
            k = int(np.diff(t).argmin())
            raise InputError(
                f"No spline passes points at these times: numbers {k} and {k + 1} are {t[k + 1] - t[k]:g} s apart, of "
                f"{t[-1]:g} s.",
                remedy="Space them more evenly.",
                index=k,
            )
        assign(self, points=given, times=frozen(t), length=float(t[-1]), ends=resolved, _spline=spline)

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return int(self.points.shape[1])

    @property
    def knots(self) -> Array:
        """(N − 2,) the inner times, s, where the fifth derivative jumps."""
        return self.times[1:-1]

    def _at(self, p: Array) -> PathPoint:
        return PathPoint(*(self._spline(p, order) for order in range(3)))


@dataclass(frozen=True, init=False, eq=False)
class PosePath(Frozen, SmoothPath):
    """Poses along a path of their origins: SE(3) splines with continuous twist and rate of twist.

    The orientation is a spline of quaternions, normalised (``trajectory.quaternions``, with p in place of the time).

    Attributes:
        origin: path of the platform's origin, m.
        quaternions: (N, 4) of the poses that are passed, x, y, z, w; signs such that each is near the one before.
        length: of the path of the origin.
    """

    origin: SmoothPath
    quaternions: Array
    length: float
    _turn: Any

    def __init__(self, origin: TimedSpline | SplinePath, rotations: ArrayLike) -> None:
        matrices = checked(rotations, "rotations", ("N", 3, 3))
        quaternions = quaternions_of(matrices)
        turned_over = np.flatnonzero(turns_between(quaternions) > np.pi - HALF_TURN_MARGIN)
        if len(turned_over):
            k = int(turned_over[0])
            raise InputError(
                f"Poses {k} and {k + 1} are half a turn apart: the axis is not determined.",
                remedy="Go through a pose in between.",
                index=k,
            )
        if isinstance(origin, TimedSpline):
            places = origin.times
            turn = TimedSpline(quaternions, places, origin.ends)._spline
        else:
            places = origin.lengths_at_points
            turn = CubicSpline(places, quaternions, bc_type="natural")
        assign(self, origin=origin, quaternions=frozen(quaternions), length=origin.length, _turn=turn)
        norms = np.linalg.norm(turn(np.linspace(0.0, self.length, 20 * len(places))), axis=-1)
        if norms.min() < _LEAST_NORM:
            raise InputError(
                "The poses turn too far from one to the next for a spline through them.",
                remedy="Give poses in between: up to a quarter turn is good.",
            )

    @property
    def dimension(self) -> int:
        """Number of rates: six."""
        return 6

    @property
    def knots(self) -> Array:
        """(c,) where a higher derivative jumps."""
        own = self._turn.x[1:-1] if isinstance(self._turn, CubicSpline) else np.empty(0)
        return frozen(np.unique(np.concatenate([getattr(self.origin, "knots", np.empty(0)), own])))

    def _at(self, p: Array) -> PathPoint:
        place = self.origin._at(p)
        q, first, second = (self._turn(p, order) for order in range(3))
        omega, alpha = angular_rates(q, first, second)
        tangent = np.concatenate([place.tangent, omega], axis=-1)
        return PathPoint(poses_of(place.x, q), tangent, np.concatenate([place.curvature, alpha], axis=-1))
