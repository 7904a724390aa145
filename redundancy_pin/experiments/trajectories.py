"""Trajectories by name: those of the thesis, and two for the user's own paths."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from numpy.typing import ArrayLike

from redundancy_pin.experiments.experiment import PATHS
from redundancy_pin.trajectory import Path, SpeedProfile, Trajectory, rounded_polygon, through_points, with_constant


def points(
    points: ArrayLike,
    speed: float,
    ramp_time: float,
    ramp_length: float | None = None,
    closed: bool = False,
    alpha: float | None = None,
) -> Trajectory:
    """Return a motion along a smooth path through points; two of them give a straight line.

    Args:
        points: (N, n) points, m.
        speed: cruising speed, m/s.
        ramp_time: duration of each ramp, s.
        ramp_length: length of each ramp, m.
        closed: whether to return to the first point.
        alpha: constant orientation, rad, added as last coordinate.

    Raises:
        InputError: as ``through_points`` and ``SpeedProfile``.
    """
    return _along(through_points(points, closed=closed), speed, ramp_time, ramp_length, alpha)


def polygon(
    vertices: ArrayLike,
    radius: float,
    speed: float,
    ramp_time: float,
    ramp_length: float | None = None,
    closed: bool = False,
    alpha: float | None = None,
) -> Trajectory:
    """Return a motion along a polygon with rounded corners.

    Args:
        vertices: (N, n) corners, m; the first and last are the ends unless ``closed``.
        radius: of the arcs, m.
        speed: cruising speed, m/s.
        ramp_time: duration of each ramp, s.
        ramp_length: length of each ramp, m.
        closed: whether to return to the first corner.
        alpha: constant orientation, rad, added as last coordinate.

    Raises:
        InputError: as ``rounded_polygon`` and ``SpeedProfile``.
    """
    return _along(rounded_polygon(vertices, radius, closed=closed), speed, ramp_time, ramp_length, alpha)


TRAJECTORIES: Mapping[str, Callable[..., Trajectory]] = {
    **{str(name): make for name, make in PATHS.items()},
    "points": points,
    "polygon": polygon,
}
"""Makers of trajectories: those of the thesis, and two for the user's own paths."""


def _along(path: Path, speed: float, ramp_time: float, ramp_length: float | None, alpha: float | None) -> Trajectory:
    whole = path if alpha is None else with_constant(path, alpha)
    return Trajectory(whole, SpeedProfile(whole.length, speed, ramp_time, ramp_length))
