"""The fastest timing law along a path, under limits of the platform's speed and acceleration.

With w = ṗ² and u = p̈ the limits are linear at every arc length: ẋ = x' ṗ and ẍ = x' u + x'' w, while w' = 2 u. toppra
finds the optimum by reachability analysis on a grid (H. Pham and Q.-C. Pham, A new approach to time-optimal path
parameterization based on reachability analysis, 2018). In each step of the grid u is constant and the limits hold at
both of its ends.

That optimum switches between extreme accelerations at once. Planners and motors need a continuous one, so the law is
averaged over a short window, ``BLEND`` of the duration, by which it gets longer; then it is run as fast as the
limits allow on dense samples. Corners that take less time than the window slow the whole law down.

toppra imports matplotlib: this module is imported where it is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import toppra
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly
from toppra.algorithm import TOPPRA

from redundancy_pin.arrays import Array, IntArray, Side, checked
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.paths import Path
from redundancy_pin.trajectory.timing import TimingLaw

STEPS = 1000
"""Of the grid, where the path is not sharply bent: with twice as many durations change by less than 1e-4."""

_TURN = 0.1
"""rad; in a step of the grid the path turns by no more. A spline that turns back nearly as it came does so within a
millimetre: limits that are looked at beside it only are exceeded by a third there."""

_UNEVEN = 0.02
"""Relative; in a step of the grid the curvature is linear but for so much."""

_HALVINGS = 14
"""Of a step, for both: a corner of a ten thousandth of the path has a hundred steps then."""

_MOST_STEPS = 20_000

BLEND = 0.02
"""Window in which accelerations change, as a fraction of the least duration."""

_PIECES = 4
"""Of the law in each window."""

_DENSE = 40
"""Samples in each piece at which limits are looked at."""

_PARTS = 4
"""Of each step of the grid, at whose ends they are looked at as well."""

_SPARE = 1e-4
"""By which the law runs slower than these samples allow: what is between them stays within the limits too."""

_DIRECTIONS = 64
"""Sides of the polygon that stands for a limit of the norm: inside it by 0.12 %, which is made good at the end."""

_SIDES = np.round([[np.cos(angle), np.sin(angle)] for angle in 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS], 15)
"""(_DIRECTIONS, 2) where they are. A cosine of 6e-17 in place of zero would bound accelerations by rounding over it."""


FAR = 1e6
"""Square of the speed, in units of the problem, that stands for no limit: 500 times what a straight path reaches."""


@dataclass(frozen=True)
class _Group:
    """Coordinates whose norm is limited together: ``columns``, largest ``speed`` and ``acceleration``."""

    columns: IntArray
    speed: float
    acceleration: float


def fastest_law(path: Path, max_speed: ArrayLike, max_acceleration: ArrayLike) -> TimingLaw:
    """Return the law from rest to rest in least time, but for the window in which accelerations change.

    Args:
        path: the path; where its curvature jumps, the limits hold on both sides.
        max_speed: a number, which limits the norm of ẋ, m/s; or (n,) of each coordinate, m/s and rad/s. Of a pose: two
            numbers, of the origin and of the angular velocity; or (6,).
        max_acceleration: the same of ẍ, m/s² and rad/s².

    Raises:
        InputError: limits that are not positive, or of another number; a path that stands still.
    """
    groups = _groups(path, max_speed, max_acceleration)
    p, w, u = _optimum(path, groups)
    law = _averaged(p, w, u)
    even = np.linspace(0.0, law.duration, _DENSE * (len(law.curve.x) - 1) + 1)
    reached = np.maximum.accumulate(law.evaluate(even).p)
    places = (p[:-1, None] + np.diff(p)[:, None] * np.arange(_PARTS) / _PARTS).ravel()
    times = np.union1d(even, np.interp(places, reached, even))
    return law.scaled((1.0 - _SPARE) / _use(path, groups, law, times))


def least_duration(path: Path, max_speed: ArrayLike, max_acceleration: ArrayLike) -> float:
    """Return the duration, s, of the optimum whose accelerations switch at once; arguments as of ``fastest_law``."""
    p, w, _ = _optimum(path, _groups(path, max_speed, max_acceleration))
    return float(_durations(p, w).sum())


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


def _optimum(path: Path, groups: list[_Group]) -> tuple[Array, Array, Array]:
    """Return arc lengths (N + 1,), squares of the speed there, and the (N,) accelerations between them.

    Raises:
        InputError: toppra finds none, for numbers of sizes that lose all digits.
    """
    p = _grid(path)
    d = np.diff(p)
    starts, ends = path.evaluate(p[:-1], "right"), path.evaluate(p[1:], "left")
    A0, B0, c, most0 = _rows(starts.tangent, starts.curvature, groups)
    A1, B1, _, most1 = _rows(ends.tangent, ends.curvature, groups)
    most = np.minimum(np.append(most0, np.inf), np.append(np.inf, most1))
    # at the start of a step, and at its end, where w is w + 2 d u
    A, B = np.concatenate([A0, A1 + 2.0 * d[:, None] * B1], axis=1), np.concatenate([B0, B1], axis=1)
    # toppra has absolute tolerances: the path gets the length 1, and the largest u the limits allow at rest is 1
    length = path.length
    square = length / np.abs(A0).max()
    limits = _Limits(A / np.abs(A0).max(), B * square, np.concatenate([c, c]), np.minimum(most / square, FAR))
    solver = TOPPRA([limits], _Interval(), gridpoints=p / length, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    if speed is None or not np.isfinite(speed).all():
        raise InputError(
            "No timing law was found under these limits.", remedy="Space the points more evenly, or use like limits."
        )
    w = speed**2 * square
    return p, w, np.diff(w) / (2.0 * d)


def _grid(path: Path) -> Array:
    """Return (N + 1,) arc lengths, breaks among them, between which tangent and curvature hardly change."""
    inner = np.concatenate([np.asarray(path.breaks), np.linspace(0.0, path.length, STEPS + 1)])
    p = np.unique(np.clip(inner, 0.0, path.length))
    p = p[np.append(True, np.diff(p) > 1e-9 * path.length)]
    p[-1] = path.length
    for _ in range(_HALVINGS):
        middle = 0.5 * (p[:-1] + p[1:])
        start, end = path.evaluate(p[:-1], "right").curvature, path.evaluate(p[1:], "left").curvature
        between = path.evaluate(middle).curvature
        size = np.linalg.norm([start, between, end], axis=2).max(axis=0)
        uneven = np.linalg.norm(between - 0.5 * (start + end), axis=1) > _UNEVEN * size + _TURN / path.length
        halved = middle[uneven | (size * np.diff(p) > _TURN)]
        if not len(halved) or len(p) + len(halved) > _MOST_STEPS:
            break
        p = np.union1d(p, halved)
    return p


def _rows(tangent: Array, curvature: Array, groups: list[_Group]) -> tuple[Array, Array, Array, Array]:
    """Return A (N, r), B (N, r) and c (r,) of A u + B w <= c, and (N,) the largest w by the speeds.

    Rows are divided by the largest acceleration: c is one, or that of a side of the polygon.
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


def _averaged(p: Array, w: Array, u: Array) -> TimingLaw:
    """Return the mean of the law over a window that slides, from rest to rest: its acceleration is continuous.

    Its p, ṗ and p̈ are differences of ∫p, p and ṗ over the window; quintics go through them.
    """
    dt = _durations(p, w)
    t, speed = np.concatenate([[0.0], np.cumsum(dt)]), np.sqrt(w)
    cubes = np.stack([u / 6.0, 0.5 * speed[:-1], p[:-1], np.zeros(len(dt))])  # of ∫ p dt from the left of each step
    area = np.concatenate([[0.0], np.cumsum(((cubes[0] * dt + cubes[1]) * dt + cubes[2]) * dt)])
    end, window = float(t[-1]), BLEND * float(t[-1])

    def integral(times: Array) -> tuple[Array, Array, Array]:
        """Return ∫p, p and ṗ; before the start it rests there, and after the end."""
        at = np.clip(times, 0.0, end)
        k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(dt) - 1)
        h = at - t[k]
        whole = area[k] + ((cubes[0, k] * h + cubes[1, k]) * h + cubes[2, k]) * h
        return (
            whole + p[-1] * np.maximum(times - end, 0.0),
            (0.5 * u[k] * h + speed[k]) * h + p[k],
            np.where((times > 0.0) & (times < end), u[k] * h + speed[k], 0.0),
        )

    nodes = np.linspace(0.0, end + window, int(np.ceil(_PIECES / BLEND)) + 1)
    ahead, behind = integral(nodes), integral(nodes - window)
    place, rate, acceleration = ((a - b) / window for a, b in zip(ahead, behind, strict=True))
    place[0], place[-1] = 0.0, p[-1]
    states = np.stack([place, rate, acceleration], axis=1)
    return TimingLaw(BPoly.from_derivatives(nodes, states), float(p[-1]))


def _use(path: Path, groups: list[_Group], law: TimingLaw, times: Array) -> float:
    """Return how much faster than the limits allow a law runs, at (N,) times and breaks; below one, how much slower."""
    breaks = np.asarray(path.breaks)
    at = law.evaluate(np.append(times, [law.time_at(float(p)) for p in breaks]))
    p, pd, pdd = np.append(at.p[: len(times)], breaks), at.pd[:, None], at.pdd[:, None]
    ratio = 0.0
    sides: tuple[Side, Side] = ("left", "right")
    for side in sides:
        point = path.evaluate(p, side)
        xd, xdd = point.tangent * pd, point.tangent * pdd + point.curvature * pd**2
        for group in groups:
            speed, acceleration = (np.linalg.norm(part[:, group.columns], axis=1).max() for part in (xd, xdd))
            ratio = max(ratio, speed / group.speed, np.sqrt(acceleration / group.acceleration))
    return float(ratio)
