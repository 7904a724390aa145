"""Splines that are no paths by arc length: points at given times, and poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from redundancy_pin.arrays import Array, Frozen, assign, checked, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.paths import PathPoint, SmoothPath
from redundancy_pin.trajectory.quaternions import angular_rates, poses_of, quaternions_of, turns_between
from redundancy_pin.trajectory.waypoints import SplinePath

_LEAST_NORM = 0.3
"""Of a quaternion between poses, before it is normalised: below, the poses turn too far for what is between them."""

_HALF_TURN_MARGIN = 1e-6
"""Rotations this close to a half turn, rad, have no usable axis (as in ``PoseTrajectory``)."""


@dataclass(frozen=True, init=False, eq=False)
class TimedSpline(Frozen, SmoothPath):
    """A quintic spline through points at given times, at rest without acceleration at both ends.

    It is a path whose parameter is the time since the first point; four derivatives are continuous.

    Attributes:
        points: (N, d) the points, m and rad.
        times: (N,) when they are passed, s, from zero.
        length: duration, s.
    """

    points: Array
    times: Array
    length: float
    _spline: BSpline

    def __init__(self, points: ArrayLike, times: ArrayLike) -> None:
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
        rest = [(1, np.zeros(given.shape[1])), (2, np.zeros(given.shape[1]))]
        spline = make_interp_spline(t, given, k=5, bc_type=(rest, rest))
        assign(self, points=given, times=frozen(t), length=float(t[-1]), _spline=spline)

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
        turned_over = np.flatnonzero(turns_between(quaternions) > np.pi - _HALF_TURN_MARGIN)
        if len(turned_over):
            k = int(turned_over[0])
            raise InputError(
                f"Poses {k} and {k + 1} are half a turn apart: the axis is not determined.",
                remedy="Go through a pose in between.",
                index=k,
            )
        if isinstance(origin, TimedSpline):
            places = origin.times
            turn = TimedSpline(quaternions, places)._spline
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
