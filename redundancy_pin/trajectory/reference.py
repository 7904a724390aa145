"""The reference trajectories of the thesis, with its numbers as defaults, and those through points of one's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import checked, positive
from redundancy_pin.trajectory.csv_file import checked_poses
from redundancy_pin.trajectory.paths import Line, Path, PoseLine, circle_path, with_constant
from redundancy_pin.trajectory.timing import LEAST_RAMP_FRACTION, RestToRest, SpeedProfile
from redundancy_pin.trajectory.trajectory import Trajectory
from redundancy_pin.trajectory.waypoints import corner_path, rounded_polygon, through_points

CIRCLE_RAMP_FRACTION = 0.765
"""Length of the ramp up on the thesis's circle as a fraction of v T: 0.153 v metres for T = 0.2 s. The thesis
does not state it; the times at which its circle reaches the singular line, at 0.5 and at 0.75 m/s, imply it."""


def circle(
    speed: float = 0.5,
    ramp_time: float = 0.2,
    ramp_length: float | None = None,
    end_ramp_length: float | None = None,
    *,
    centre: ArrayLike = (0.25, 0.185),
    radius: float = 0.2,
    alpha: float | None = None,
) -> Trajectory:
    """Return a circle, by default the one of the 2-RPR, (x, y) (Parsa 2014, section 3.2).

    Once counter-clockwise from its leftmost point. That of the thesis has the centre (0.25, 0.185) m and the radius
    0.2 m, begins at (0.05, 0.185) and crosses the singular line y = 0 at x ≈ 0.174 and 0.326 m.

    The ramp lengths are not stated, but the stated times imply both: those of the singular region a ramp up of
    0.765 v T (it overshoots v by 13 %), and the end at 2.68 s, with that, a ramp down of 0.4 v T (the
    shortest that does not run backwards). These are the defaults. With equal ramps no length reproduces both:
    0.765 v T ends at 2.61 s, v T / 2 at 2.71 s.

    Args:
        speed: cruising speed, m/s; 0.5 and 0.75 in the thesis.
        ramp_time: duration of each ramp, s.
        ramp_length: length of the ramp up, m; the implied one when left out.
        end_ramp_length: length of the ramp down, m; by default the length of the ramp up if given, else
            the implied one.
        centre: (2,) m.
        radius: m.
        alpha: constant orientation, rad, a third coordinate; none when left out.

    Raises:
        InputError: as ``SpeedProfile``; a radius that is not positive.

    Example:
        >>> circle(speed=0.2, centre=(0.5, 0.4), radius=0.1).path.length
        0.628...
    """
    path: Path = circle_path(centre, radius, start_angle=np.pi)
    path = path if alpha is None else with_constant(path, alpha)
    if ramp_length is None:
        cruised = positive(speed, "speed", "m/s") * positive(ramp_time, "ramp_time", "s")
        ramp_length = CIRCLE_RAMP_FRACTION * cruised
        end_ramp_length = LEAST_RAMP_FRACTION * cruised if end_ramp_length is None else end_ramp_length
    return Trajectory(path, SpeedProfile(path.length, speed, ramp_time, ramp_length, end_ramp_length=end_ramp_length))


def line(speed: float = 0.1, ramp_time: float = 1.0, ramp_length: float | None = None) -> Trajectory:
    """Return the straight line of the 2-RPR, (x, y) (Parsa 2014, section 3.2).

    From (0.15, 0.4) to (0.25, −0.7) m; it crosses the singular line y = 0 at x ≈ 0.186 m.

    Args:
        speed: cruising speed, m/s; 0.1 and 0.2 in the thesis.
        ramp_time: duration of each ramp, s.
        ramp_length: length of each ramp, m; v T / 2 when left out (the thesis does not state it).

    Raises:
        InputError: as ``SpeedProfile``.
    """
    path = Line((0.15, 0.4), (0.25, -0.7))
    return Trajectory(path, SpeedProfile(path.length, speed, ramp_time, ramp_length))


def corner(
    radius: float = 0.025,
    speed: float = 0.2,
    ramp_time: float = 0.4,
    straight: float = 0.12,
    ramp_length: float | None = None,
    *,
    start: ArrayLike = (1.0, 0.4),
    alpha: float = 0.0,
) -> Trajectory:
    """Return the rounded corner of the 3-RRR, (x, y, α) with constant α (Parsa 2014, section 4.2.2).

    From ``start`` along +y, a quarter circle to the left, then along −x. The thesis states straights of 0.07 m, which
    contradicts its times (corner from 0.8 to 1.0 s, 1.8 s in all); 0.12 m, ramps included, fits them.

    Args:
        radius: corner radius, m; 0.025 and 0.013 in the thesis.
        speed: cruising speed, m/s.
        ramp_time: duration of each ramp, s.
        straight: length of each straight, m.
        ramp_length: length of each ramp, m; v T / 2 when left out, which fits the stated times.
        start: (2,) start point, m.
        alpha: constant orientation, rad; not stated in the thesis.

    Raises:
        InputError: as ``corner_path`` and ``SpeedProfile``.
    """
    path = with_constant(corner_path(start, (0.0, 1.0), straight, radius), alpha)
    return Trajectory(path, SpeedProfile(path.length, speed, ramp_time, ramp_length))


def square(
    side: float = 0.17,
    radius: float = 0.025,
    speed: float = 0.2,
    ramp_time: float = 0.2,
    ramp_length: float | None = None,
    *,
    start: ArrayLike = (1.0, 0.4),
    alpha: float = 0.0,
) -> Trajectory:
    """Return the rounded square of the 3-RRR, (x, y, α) with constant α (Parsa 2014, section 4.2.2).

    Counter-clockwise from ``start`` along +y, back to it. The ramp down starts as the last corner ends, so the start
    lies one ramp length past a corner, and the first straight is shorter than a side by that length.

    ``side`` is the straight between two corners, so that the square measures side + 2 radius. The thesis does
    not say whether its 0.17 m include the corners. Its times decide: on its square the carriers meet their
    speed limit during corners at 1.0 and near 2.1 s and return at 1.1 s. Here corners last from 0.85 to 1.05 s and
    from 1.90 to 2.09 s; had the 0.17 m included them, from 0.60 to 0.80 s and from 1.40 to 1.60 s.
    For that reading pass ``side=0.12``.

    Args:
        side: length of the straight between two corners, m.
        radius: corner radius, m.
        speed: cruising speed, m/s.
        ramp_time: duration of each ramp, s.
        ramp_length: length of each ramp, m; v T / 2 when left out (the thesis does not state it).
        start: (2,) start and end point, m.
        alpha: constant orientation, rad; not stated in the thesis.

    Raises:
        InputError: as ``rounded_polygon`` and ``SpeedProfile``.
    """
    origin = checked(start, "start", (2,))
    r = positive(radius, "radius", "m")
    ramp = 0.5 * positive(speed, "speed", "m/s") * ramp_time if ramp_length is None else ramp_length
    width = positive(side, "side", "m") + 2.0 * r
    outline = np.array([[0.0, 0.0], [0.0, width], [-width, width], [-width, 0.0]])
    vertices = origin - [0.0, r + ramp] + outline
    path = with_constant(rounded_polygon(vertices, r, start=r + ramp), alpha)
    return Trajectory(path, SpeedProfile(path.length, speed, ramp_time, ramp))


def pose(
    start: ArrayLike, end: ArrayLike, duration: float = 1.0, shape: Literal["3-4-5", "4-5-6-7"] = "4-5-6-7"
) -> Trajectory:
    """Return a rest-to-rest motion of a spatial platform: straight line, and rotation about a constant axis.

    Args:
        start: (4, 4) homogeneous pose in the base frame, m; or (7,) position, m, and unit quaternion x, y, z, w.
        end: the same at the end.
        duration: s.
        shape: the rest-to-rest polynomial of the fraction travelled.

    Raises:
        InputError: as ``PoseLine`` and ``RestToRest``.
    """
    first, last = (
        checked_poses(checked(given, name, (7,))[None], name)[0] if np.shape(given) == (7,) else given
        for name, given in (("start", start), ("end", end))
    )
    return Trajectory(PoseLine(first, last), RestToRest(1.0, duration, shape))


def points(
    points: ArrayLike,
    speed: float,
    ramp_time: float,
    ramp_length: float | None = None,
    closed: bool = False,
    alpha: float | None = None,
) -> Trajectory:
    """Return a motion along a smooth path through (N, n) points, m; two of them give a straight line.

    Ramps last ``ramp_time``, s, and are ``ramp_length``, m, long; ``alpha``, rad, is a constant last coordinate.
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
    """Return a motion along a polygon of (N, n) corners, m, rounded by arcs of a radius, m; the rest as ``points``."""
    return _along(rounded_polygon(vertices, radius, closed=closed), speed, ramp_time, ramp_length, alpha)


def _along(path: Path, speed: float, ramp_time: float, ramp_length: float | None, alpha: float | None) -> Trajectory:
    whole = path if alpha is None else with_constant(path, alpha)
    return Trajectory(whole, SpeedProfile(whole.length, speed, ramp_time, ramp_length))


PATHS = ("circle", "line", "corner", "square")
"""Names of the trajectories of the thesis."""

TRAJECTORIES: Mapping[str, Callable[..., Trajectory]] = {
    "circle": circle,
    "line": line,
    "corner": corner,
    "square": square,
    "points": points,
    "polygon": polygon,
    "pose": pose,
}
"""Constructors of trajectories by name: those of the thesis, and three for other motions."""
