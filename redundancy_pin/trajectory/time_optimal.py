"""The fastest timing law along a path, under limits of the platform's speed and acceleration.

With w = ṗ² and u = p̈ the limits are linear at every arc length: ẋ = x' ṗ and ẍ = x' u + x'' w, while w' = 2 u. toppra
finds the optimum by reachability analysis on a grid (H. Pham and Q.-C. Pham, A new approach to time-optimal path
parameterization based on reachability analysis, 2018). In each step of the grid u is constant and the limits hold at
both of its ends.

That optimum switches between extreme accelerations at once. Planners and motors need a continuous acceleration, so the
law passes nodes of the path at the speeds of the optimum (``law_through_speeds``): an acceleration changes between two
nodes. Nodes are ``BLEND`` of the duration apart, and closer where the path bends: between two of them it turns by
``NODE_TURN`` at most, so that a sharp corner costs a part of the time in it. Next to a switch such a law exceeds the
limits, by a third where all else is uniform. There, between those two nodes alone, the limits are tightened and the
optimum is computed again. What remains is removed by time scaling, by the largest use of the limits anywhere on the
law. Laws take 1.01 to 1.06 of the least time on most random paths, with corners down to 1e-4 of their length.
Up to 1.13 was measured through hundreds of noisy points, which bend the path between all nodes, and on arcs whose
coordinates have very unlike limits.

toppra imports matplotlib: this module is imported on use.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import toppra
from numpy.typing import ArrayLike
from toppra.algorithm import TOPPRA

from redundancy_pin.arrays import Array, IntArray, Side, checked
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.paths import Path, PathPoint
from redundancy_pin.trajectory.timing import TimingLaw, law_through_speeds

STEPS = 1000
"""Steps of the grid where the path is not sharply bent: with twice as many durations change by less than 1e-4."""

_TURN = 0.1
"""Largest turn of the path in a step of the grid, rad. A spline may turn back within a millimetre: limits evaluated
only before and after it are exceeded by a third there."""

_UNEVEN = 0.02
"""Largest deviation of the curvature from linear in a step of the grid, relative."""

_UNLIKE = 4.0
"""Largest ratio of two steps of the grid that follow each other."""

_HALVINGS = 14
"""Largest number of halvings of a step: a corner of a ten thousandth of the path has a hundred steps then."""

_MOST_STEPS = 20_000

BLEND = 0.007
"""Largest distance of two nodes, in which an acceleration changes, as a fraction of the least duration."""

NODE_TURN = 0.2
"""Largest turn of the path between two nodes, rad: a right angle has eight."""

_NODE_GROWTH = 0.25
"""Growth of the distance of nodes with the time from a bend, s/s."""

_ROUNDS = 6
"""Largest number of optima with tightened limits; most paths need two."""

_LEAST_PART = 0.5
"""Smallest factor in one round of tightening. Where less of u would be left w is reduced as well, by no more: the
next optimum has other accelerations there, and may need far less."""

_ENOUGH = 1.002
"""Use of the limits at which tightening ends: less is removed by time scaling, at the same cost in time."""

_SAMPLES = 40
"""Samples between two nodes at which limits are evaluated."""

_PARTS = 4
"""Parts of a step of the grid, at whose ends limits are evaluated as well."""

_EXTREME = 1e-5
"""Largest remainder, relative, by which the use of limits may exceed the largest one found, estimated by bisection."""

_BISECTIONS = 16
"""Largest number of bisections of an interval, to 1/65,536: rounding of curvatures may look like bends for ever."""

_SPARE = 1e-4
"""Reserve of speed, relative: twenty times that remainder, for bends that no sample meets."""

_DIRECTIONS = 64
"""Sides of the polygon, inscribed, that stands for a limit of the norm: at most 0.12 % below it."""

_SIDES = np.round([[np.cos(angle), np.sin(angle)] for angle in 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS], 15)
"""(_DIRECTIONS, 2) normals of the sides. A cosine of 6e-17 in place of zero would bound accelerations by rounding."""


FAR = 1e6
"""Square of the speed, in units of the problem, that stands for no limit: 500 times that of a straight path."""


@dataclass(frozen=True)
class _Group:
    """Coordinates whose norm is limited together: ``columns``, largest ``speed`` and ``acceleration``."""

    columns: IntArray
    speed: float
    acceleration: float


def fastest_law(path: Path, max_speed: ArrayLike, max_acceleration: ArrayLike) -> TimingLaw:
    """Return the law from rest to rest in least time with a continuous acceleration, which is zero at both ends.

    The law is near that least time, not at it: ``law.duration / law.least_duration`` bounds how far it may be.

    Args:
        path: the path; where its curvature jumps, the limits hold on both sides.
        max_speed: a number, which limits the norm of ẋ, m/s; or (n,) of each coordinate, m/s and rad/s. Of a pose: two
            numbers, of the origin and of the angular velocity; or (6,).
        max_acceleration: the same of ẍ, m/s² and rad/s².

    Raises:
        InputError: limits that are not positive, or of another number; a path without length; limits of such unlike
            sizes that the optimum loses all digits.

    Example:
        >>> law = fastest_law(circle_path((0.0, 0.0), 0.3), 1.0, 2.0)
    """
    groups = _groups(path, max_speed, max_acceleration)
    p, w = _least_time(path, groups)
    least, nodes = float(_durations(p, w).sum()), _nodes(path, p, w)
    limits = np.ones((2, len(nodes) - 1))
    best = np.inf
    for _ in range(_ROUNDS):
        candidate = law_through_speeds(p[nodes], np.sqrt(w[nodes]))
        use, square, along = _use(path, groups, candidate, p, nodes)
        if candidate.duration * use < best:
            best, law = candidate.duration * use, candidate
        if use < _ENOUGH:
            break
        limits *= np.minimum(square, 1.0), np.minimum(along, 1.0)
        tightened = _optimum(path, groups, p, *np.repeat(limits, np.diff(nodes), axis=1))
        if tightened is None:  # by rounding alone: to move slowly enough is always possible
            break
        w = tightened
    law = law.scaled((1.0 - _SPARE) / _largest_use(path, groups, law, p, nodes))
    return TimingLaw(law.curve, law.length, least)


def least_duration(path: Path, max_speed: ArrayLike, max_acceleration: ArrayLike) -> float:
    """Return the duration, s, of the optimum whose accelerations switch at once; arguments as of ``fastest_law``."""
    return float(_durations(*_least_time(path, _groups(path, max_speed, max_acceleration))).sum())


def _groups(path: Path, max_speed: ArrayLike, max_acceleration: ArrayLike) -> list[_Group]:
    each = np.arange(path.dimension)[:, None]
    start = path.evaluate(np.zeros(1))
    if not start.tangent.any():
        remedy = "Give two different poses, or a law that says how long it stays, RestToRest."
        raise InputError("The path stands still: no limit determines its duration.", remedy=remedy)
    pose = start.x.ndim == 3
    parts = {2: each.reshape(2, 3), 6: each} if pose else {len(each): each, 1: each.T}
    limits = []
    for name, values in (("max_speed", max_speed), ("max_acceleration", max_acceleration)):
        given = checked(np.atleast_1d(values), name, ("n",))
        if len(given) not in parts:
            wanted = "two numbers (of the origin and of the rotation) or six" if pose else f"one number or {len(each)}"
            raise InputError(f"{name} has {len(given)} values.", remedy=f"Give {wanted}.", name=name)
        if not (given > 0.0).all():
            raise InputError(f"{name} is {given.min():g}, expected positive numbers.", name=name)
        limits.append(given.tolist())
    if len(limits[0]) != len(limits[1]):
        raise InputError(
            "max_speed and max_acceleration have different numbers of values.", remedy="Give as many of each."
        )
    return [_Group(*group) for group in zip(parts[len(limits[0])], *limits, strict=True)]


class _Limits(toppra.constraint.LinearConstraint):  # type: ignore[misc]
    """Rows A u + B w <= c of each step of a grid, (N, r) and (r,), and the (N + 1,) largest w, for toppra."""

    def __init__(self, A: Array, B: Array, c: Array, most: Array) -> None:
        super().__init__()
        self.identical = True
        self._parameters = [np.concatenate([part, part[-1:]]) for part in (A, B)], c, most

    def compute_constraint_params(self, *_: object) -> tuple[Array | None, ...]:
        """Return a, b, c of v = a u + b w + c, F and g of F v <= g, and the bounds of u and of w."""
        (a, b), c, most = self._parameters
        return a, b, np.zeros(a.shape), np.eye(len(c)), c, None, np.stack([np.zeros(len(most)), most], axis=1)


class _Interval(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
    """The places of a path from 0 to 1: its limits know the rest."""

    path_interval = (0.0, 1.0)
    dof = 1


def _least_time(path: Path, groups: list[_Group]) -> tuple[Array, Array]:
    """Return arc lengths (N + 1,), m, and the squares of the speed there, m²/s², of the optimum.

    Raises:
        InputError: toppra finds none, for numbers of sizes that lose all digits.
    """
    p = _grid(path)
    w = _optimum(path, groups, p, *np.ones((2, len(p) - 1)))
    if w is None:
        raise InputError(
            "No timing law was found under these limits.", remedy="Space the points more evenly, or use like limits."
        )
    return p, w


def _optimum(path: Path, groups: list[_Group], p: Array, square: Array, along: Array) -> Array | None:
    """Return the squares w of the speed at arc lengths p (N + 1,), m²/s²; None if toppra finds none.

    Each step has a fraction ``square`` (N,) of what the limits allow of w, and ``along`` (N,) of what they allow of u.
    """
    d = np.diff(p)
    starts, ends = path.evaluate(p[:-1], "right"), path.evaluate(p[1:], "left")
    A0, B0, c, most0 = _rows(starts.tangent, starts.curvature, groups)
    A1, B1, _, most1 = _rows(ends.tangent, ends.curvature, groups)
    most = np.minimum(np.append(most0 * square, np.inf), np.append(np.inf, most1 * square))
    # at the start of a step, and at its end, where w is w + 2 d u
    B0, B1, A0, A1 = (rows / part[:, None] for rows, part in ((B0, square), (B1, square), (A0, along), (A1, along)))
    A, B = np.concatenate([A0, A1 + 2.0 * d[:, None] * B1], axis=1), np.concatenate([B0, B1], axis=1)
    # toppra has absolute tolerances: the path gets the length 1, and the largest u the limits allow at rest is 1
    length = path.length
    unit = length / np.abs(A0).max()
    limits = _Limits(A / np.abs(A0).max(), B * unit, np.concatenate([c, c]), np.minimum(most / unit, FAR))
    solver = TOPPRA([limits], _Interval(), gridpoints=p / length, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    if speed is None or not np.isfinite(speed).all():
        return None
    w: Array = speed**2 * unit
    return w


def _grid(path: Path) -> Array:
    """Return (N + 1,) arc lengths, breaks among them, between which tangent and curvature hardly change."""
    inner = np.concatenate(
        [np.asarray(path.breaks), getattr(path, "knots", ()), np.linspace(0.0, path.length, STEPS + 1)]
    )
    p = np.unique(np.clip(inner, 0.0, path.length))
    p = p[np.append(True, np.diff(p) > 1e-9 * path.length)]
    p[-1] = path.length
    for _ in range(_HALVINGS):
        middle = 0.5 * (p[:-1] + p[1:])
        points = path.evaluate(p[:-1], "right"), path.evaluate(middle), path.evaluate(p[1:], "left")
        start, between, end = (point.curvature for point in points)
        turn = np.max([_turn(point) for point in points], axis=0)
        size = np.linalg.norm([start, between, end], axis=2).max(axis=0)
        uneven = np.linalg.norm(between - 0.5 * (start + end), axis=1) > _UNEVEN * size + _TURN / path.length
        d = np.diff(p)
        beside = np.minimum(np.append(d[1:], np.inf), np.append(np.inf, d[:-1]))
        halved = middle[uneven | (turn * d > _TURN) | (d > _UNLIKE * beside)]
        if not len(halved) or len(p) + len(halved) > _MOST_STEPS:
            break
        p = np.union1d(p, halved)
    return p


def _turn(point: PathPoint) -> Array:
    """Return how fast the tangent turns, (N,) rad per arc length; of poses x' is not a unit vector."""
    size = np.maximum(np.linalg.norm(point.tangent, axis=1, keepdims=True), np.finfo(float).tiny)
    direction = point.tangent / size
    across = point.curvature - (point.curvature * direction).sum(axis=1, keepdims=True) * direction
    return np.asarray(np.linalg.norm(across / size, axis=1))


def _rows(tangent: Array, curvature: Array, groups: list[_Group]) -> tuple[Array, Array, Array, Array]:
    """Return A (N, r), B (N, r) and c (r,) of A u + B w <= c, and (N,) the largest w by the speeds.

    Rows are divided by the largest acceleration: c is one, or a bound of a side of the polygon.
    """
    A, B, c = [], [], []
    most = np.full(len(tangent), np.inf)
    for group in groups:
        first, second = tangent[:, group.columns], curvature[:, group.columns]
        size = np.linalg.norm(first, axis=1)
        with np.errstate(divide="ignore"):
            most = np.minimum(most, (group.speed / size) ** 2)
        if len(group.columns) == 1:
            A += [first[:, 0] / group.acceleration, -first[:, 0] / group.acceleration]
            B += [second[:, 0] / group.acceleration, -second[:, 0] / group.acceleration]
            c += [1.0, 1.0]
            continue
        # in the plane of both: along the tangent, and across it
        along = np.einsum("ni,ni->n", first, second) / np.maximum(size, np.finfo(float).tiny)
        across = np.sqrt(np.maximum((second**2).sum(axis=1) - along**2, 0.0))
        both = np.stack([along, across]) / group.acceleration
        for side in _SIDES:
            A.append(side[0] * size / group.acceleration)
            B.append(side @ both)
            c.append(float(np.cos(np.pi / _DIRECTIONS)))
    return np.stack(A, axis=1), np.stack(B, axis=1), np.array(c), most


def _durations(p: Array, w: Array) -> Array:
    speed = np.sqrt(w)
    return np.asarray(2.0 * np.diff(p) / (speed[1:] + speed[:-1]))


def _nodes(path: Path, p: Array, w: Array) -> IntArray:
    """Return (n + 1,) indices into arc lengths p, ends and breaks among them, at which the law has given speeds."""
    dt = _durations(p, w)
    t = np.concatenate([[0.0], np.cumsum(dt)])
    bent = np.maximum(_turn(path.evaluate(p[:-1])), _turn(path.evaluate(p[1:], "left")))
    # the time in which the path turns by so much; from there it grows with the time to a bend, past and future
    apart = np.minimum(BLEND * t[-1], NODE_TURN * dt / np.maximum(bent * np.diff(p), np.finfo(float).tiny))
    grown = _NODE_GROWTH * 0.5 * (t[:-1] + t[1:])
    apart = np.minimum.accumulate(apart - grown) + grown
    apart = np.minimum.accumulate((apart + grown)[::-1])[::-1] - grown
    count = np.concatenate([[0.0], np.cumsum(dt / apart)])
    ends = np.concatenate([[0], np.searchsorted(p, path.breaks), [len(dt)]])
    parts = []
    for a, b in pairwise(ends):
        n = max(int(np.ceil(count[b] - count[a] - 1e-6)), 1)
        wanted = count[a] + (count[b] - count[a]) * np.arange(n) / n
        parts.append(np.searchsorted(count, wanted - 1e-9))
    return np.unique(np.concatenate([*parts, [len(dt)]]))


def _use(path: Path, groups: list[_Group], law: TimingLaw, p: Array, nodes: IntArray) -> tuple[float, Array, Array]:
    """Return how much faster than the limits allow a law runs at samples, and by which factors (n,) w and u keep them.

    The factors are those between two of n + 1 nodes; that of u is for the law's own w.
    """
    starts, ends, interval = _intervals(law, p, nodes)
    largest, square, part = 0.0, np.full(len(nodes) - 1, np.inf), np.full(len(nodes) - 1, np.inf)
    last = np.append(np.diff(interval) > 0, True)
    samples: tuple[tuple[Array, IntArray, Side], ...] = (
        (starts, interval, "right"),
        (ends[last], interval[last], "left"),  # of the path before a break
    )
    for t, where, side in samples:
        for xd, across, along in _rates(path, groups, law, p[nodes], t, where, side):
            fast, total = (xd**2).sum(axis=1), np.linalg.norm(across + along, axis=1)
            largest = max(largest, fast.max(), total.max())
            # |across + factor · along| = 1, a quadratic equation
            a, b, c = (along**2).sum(axis=1), (along * across).sum(axis=1), (across**2).sum(axis=1) - 1.0
            root = np.sqrt(np.maximum(b**2 - a * c, 0.0)) - b
            factor = np.divide(root, a, out=np.full(len(a), np.inf), where=(c < 0.0) & (a > 0.0))
            # where w takes nearly the whole limit both are reduced: with hardly any u left toppra finds no law
            crowded = (c >= 0.0) | (factor < _LEAST_PART)
            both = np.clip(total, 1.0, 1.0 / _LEAST_PART)
            np.minimum.at(part, where, np.where(crowded, 1.0 / both, factor))
            np.minimum.at(square, where, 1.0 / np.maximum(np.where(crowded, np.maximum(fast, both), fast), 1.0))
    return float(np.sqrt(largest)), square, part


def _largest_use(path: Path, groups: list[_Group], law: TimingLaw, p: Array, nodes: IntArray) -> float:
    """Return how much faster than the limits allow a law runs anywhere, to ``_EXTREME``.

    Intervals between samples are bisected. A parabola through both ends and the middle exceeds these by no more than
    the middle deviates from the chord: an interval is done when twice that cannot exceed the largest use.
    """

    def used(t: Array, where: IntArray, side: Side) -> Array:
        uses = [
            np.maximum((xd**2).sum(axis=1), np.linalg.norm(across + along, axis=1))
            for xd, across, along in _rates(path, groups, law, p[nodes], t, where, side)
        ]
        return np.asarray(np.max(uses, axis=0))

    starts, ends, where = _intervals(law, p, nodes)
    at_start, at_end = used(starts, where, "right"), used(ends, where, "left")
    largest = max(at_start.max(), at_end.max())
    for _ in range(_BISECTIONS):
        middle = 0.5 * (starts + ends)
        between = used(middle, where, "right")
        largest = max(largest, between.max())
        highest = np.maximum(np.maximum(at_start, at_end), between)
        highest += 2.0 * np.abs(between - 0.5 * (at_start + at_end))
        (left,) = np.nonzero(highest > largest * (1.0 + _EXTREME))
        if not 0 < len(left) <= _MOST_STEPS:
            break
        starts, ends = np.concatenate([starts[left], middle[left]]), np.concatenate([middle[left], ends[left]])
        at_start = np.concatenate([at_start[left], between[left]])
        at_end = np.concatenate([between[left], at_end[left]])
        where = np.tile(where[left], 2)
    return float(np.sqrt(highest[left].max(initial=largest)))  # what is left by rounding counts at its bound


def _intervals(law: TimingLaw, p: Array, nodes: IntArray) -> tuple[Array, Array, IntArray]:
    """Return (m,) starts and ends of intervals of time, s, and between which two nodes each is.

    Between two nodes there are ``_SAMPLES`` of equal duration; parts of steps of the grid end intervals as well.
    """
    at_nodes = np.concatenate([[0.0], law.knots, [law.duration]])
    even = (at_nodes[:-1, None] + np.diff(at_nodes)[:, None] * np.arange(_SAMPLES) / _SAMPLES).ravel()
    places = (p[:-1, None] + np.diff(p)[:, None] * np.arange(_PARTS) / _PARTS).ravel()
    t = np.union1d(even, np.interp(places, np.maximum.accumulate(law.evaluate(even).p), even))
    where = np.minimum(np.searchsorted(at_nodes, t, side="right"), len(nodes) - 1) - 1
    return t, np.append(t[1:], law.duration), where


def _rates(
    path: Path, groups: list[_Group], law: TimingLaw, nodes: Array, t: Array, where: IntArray, side: Side
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield ẋ, x'' w and x' u of each group, (N, k) over its limits, at times (N,), s, between given nodes, m."""
    at = law.evaluate(t, side)
    point = path.evaluate(np.clip(at.p, nodes[where], nodes[where + 1]), side)
    pd, pdd = at.pd[:, None], at.pdd[:, None]
    for group in groups:
        tangent, curvature = point.tangent[:, group.columns], point.curvature[:, group.columns]
        yield tangent * pd / group.speed, curvature * pd**2 / group.acceleration, tangent * pdd / group.acceleration
