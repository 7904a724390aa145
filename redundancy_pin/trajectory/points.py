"""A motion through points of one's own: at given times, at given speeds, or as fast as limits allow."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path as File
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked, positive
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.reading import LARGEST_TEXT, read_json, read_text
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import PlatformMotion, require_poses
from redundancy_pin.trajectory.csv_file import checked_poses, in_order_of, read_table
from redundancy_pin.trajectory.paths import Path, with_constant
from redundancy_pin.trajectory.quaternions import quaternions_of
from redundancy_pin.trajectory.timing import SpeedProfile, TimingLaw, law_through_speeds, uniform_law
from redundancy_pin.trajectory.trajectory import Trajectory
from redundancy_pin.trajectory.waypoints import PosePath, SplinePath, TimedSpline, resolve_ends

TIME_OPTIMAL: Literal["time-optimal"] = "time-optimal"
"""In place of times: as fast as limits allow."""

SUFFIXES = (".csv", ".json")
"""Of files with points."""

_RAMP = 0.1
"""Length of each ramp, as a fraction of the path, where no ramp time is given."""

MOST_POINTS = 100_000
"""Of a file: each is a piece of a spline. Longer motions are sampled ones (``from_csv``)."""


def from_points(
    points: ArrayLike | str | os.PathLike[str],
    times: ArrayLike | Literal["time-optimal"] | None = None,
    *,
    speed: ArrayLike | None = None,
    ramp_time: float | None = None,
    max_speed: ArrayLike | None = None,
    max_acceleration: ArrayLike | None = None,
    alpha: float | None = None,
    closed: bool = False,
    ends: str | Sequence[str] = "auto",
    robot: RobotLike | None = None,
) -> Trajectory:
    """Return a smooth motion through points or poses.

    One of three determines the timing:

    - ``times``: each point is passed at its own time, on a quintic spline of time (four continuous derivatives). It
      starts and ends with the speed and the acceleration of the points, or at rest where they show it (``ends``).
    - ``speed``: a cubic spline by arc length (curvature is continuous), at one cruising speed with ramps, or with a
      speed of its own at each point.
    - ``times="time-optimal"``: the same path in least time under ``max_speed`` and ``max_acceleration`` of the
      platform, with a continuous acceleration (``fastest_law``).

    By speed it is at rest at the ends, or has the speeds given there; time-optimal it is at rest. Poses (three or more
    make a spline; two are joined directly) turn by splines of quaternions. By speed or
    time-optimal they need origins that move from each to the next.

    Args:
        points: (N, n) coordinates, m and rad; poses as (N, 4, 4), or (N, 7) position and unit quaternion x, y, z, w;
            or a file: CSV with a row of names such as ``t,x,y`` (``t`` and ``speed`` may be left out; poses are
            ``x,y,z,qx,qy,qz,qw``; x, y and z come first, whatever their order), or JSON, ``{"points": [...], "t":
            [...]}`` or a list of points.
        times: (N,) increasing times, s, counted from the first; or "time-optimal". Those of a file when left out.
        speed: cruising speed, m/s; or (N,) the speed at each point, zero where it stops.
        ramp_time: duration of each ramp to the cruising speed, s; when left out ramps are a tenth of the path long.
        max_speed: for "time-optimal": largest |ẋ|, m/s; or of each coordinate, (n,). Of poses two numbers, of the
            origin, m/s, and of the rotation, rad/s, or (6,).
        max_acceleration: the same of ẍ, m/s² and rad/s².
        alpha: a constant last coordinate, rad, for points in the plane.
        closed: by ``speed`` or "time-optimal": return to the first point, which is not repeated.
        ends: with ``times``: "rest" starts and ends at rest without acceleration; "samples" with the speed and the
            acceleration of the points; "auto" chooses for each end, by the points (``resolve_ends``: six or more may
            show rest). A pair of these words is for the start and the end. What was chosen is ``Trajectory.ends``.
        robot: whose coordinates a file has: columns go by name, foreign names and units of other quantities are
            refused. Without it columns are taken in their order, x, y, z, rx, ry and rz first.

    Returns:
        The motion; ``ends`` of it is a pair of "rest" and "samples", None without times.

    Raises:
        InputError: none or two of times and speed, points that are none, times that do not increase, a file that
            cannot be read (with row and column), ...

    Example:
        >>> move = rp.trajectory.from_points([[0.2, 0.6], [0.3, 0.6]], [0.0, 1.0], ends="rest")
        >>> move.sample(0.01).x.shape
        (101, 2)
    """
    given, remedy = "", 'Pass one of times=[...], speed=0.1, and times="time-optimal" with limits.'
    if isinstance(points, (str, os.PathLike)):
        file = os.fspath(points)
        given = f", and {file} has neither t nor speed"
        remedy = (
            'Give it a column t, or pass speed=0.1, or times="time-optimal" with limits '
            f"(--motion {file}:speed=0.1 on the command line)."
        )
        points, own_times, own_speed = read_points(points, robot, but_last=alpha is not None)
        if own_times is not None:
            if times is not None or speed is not None:
                both = "times" if times is not None else "speed"
                raise InputError(
                    f"The file has times of its own, and {both} is given too.",
                    remedy="Leave it out, or the column t.",
                    name=both,
                )
            times = own_times
        speed = own_speed if speed is None else speed
    if (times is None) == (speed is None):
        if speed is not None:
            raise InputError("Both times and speed are given.", remedy="Leave one of them out.")
        raise InputError(f"Neither times nor speed is given{given}.", remedy=remedy)
    fastest = isinstance(times, str)
    if fastest and times != TIME_OPTIMAL:
        raise InputError(f"times is {shown(times)}.", remedy='Pass times, or "time-optimal".', name="times")
    timed = times is not None and not fastest
    for name, value, fits in (
        ("max_speed", max_speed, fastest),
        ("max_acceleration", max_acceleration, fastest),
        ("ramp_time", ramp_time, speed is not None and np.ndim(speed) == 0),
        ("ends", None if ends == "auto" else ends, timed),
    ):
        if value is not None and not fits:
            remedies = {"ramp_time": "It is for one cruising speed.", "ends": "It is for points with times."}
            remedy = remedies.get(name, 'It is for times="time-optimal".')
            raise InputError(f"{name} is given, and has no effect here.", remedy=remedy, name=name)
    where, rotations = _split(points)
    if closed and (rotations is not None or timed):
        raise InputError(
            "closed is for coordinates, by speed or time-optimal.", remedy="Repeat the first point.", name="closed"
        )
    if timed:
        origin = TimedSpline(where, times, ends)  # type: ignore[arg-type]
        if rotations is not None:  # a platform that turns on the spot is not at rest
            columns = np.concatenate([where, quaternions_of(rotations)], axis=1)
            origin = TimedSpline(where, origin.times, resolve_ends(columns, origin.times, ends))
        law = uniform_law(origin.length, origin.length)
        return Trajectory(_whole(origin, rotations, alpha), law, ends=origin.ends)
    spline = SplinePath(where, closed=closed)
    path = _whole(spline, rotations, alpha)
    if not fastest:
        return Trajectory(path, _law(spline, speed, ramp_time))
    for name, value in (("max_speed", max_speed), ("max_acceleration", max_acceleration)):
        if value is None:
            raise InputError(f'times="time-optimal" needs {name}.', remedy="Give both limits.", name=name)
    from redundancy_pin.trajectory.time_optimal import fastest_law  # toppra imports matplotlib

    return Trajectory(path, fastest_law(path, max_speed, max_acceleration))  # type: ignore[arg-type]


def _law(path: SplinePath, speed: Any, ramp_time: float | None) -> TimingLaw:
    if np.ndim(speed) == 0:
        cruise = positive(speed, "speed", "m/s")
        ramp = 2.0 * _RAMP * path.length / cruise if ramp_time is None else ramp_time
        return SpeedProfile(path.length, cruise, ramp)
    places = path.lengths_at_points
    speeds = checked(speed, "speed", ("N",))
    if len(speeds) == len(places) - 1:  # closed: the last point is the first
        speeds = np.append(speeds, speeds[0])
    if len(speeds) != len(places):
        raise InputError(
            f"speed has {len(speeds)} values for {len(path.points)} points.",
            remedy="Give one number, or one for each point.",
            name="speed",
        )
    return law_through_speeds(places, speeds)


def _whole(path: Any, rotations: Array | None, alpha: float | None) -> Path:
    if rotations is not None:
        if alpha is not None:
            raise InputError("alpha goes with points, not with poses.", remedy="Leave it out.", name="alpha")
        return PosePath(path, rotations)
    return path if alpha is None else with_constant(path, alpha)


def _split(points: Any) -> tuple[Array, Array | None]:
    """Return (N, n) coordinates and None, or (N, 3) origins and (N, 3, 3) rotations of poses."""
    if isinstance(points, PlatformMotion):
        raise InputError("A sampled motion is a motion already.", remedy="Pass points, or use the motion as it is.")
    try:
        axes = np.ndim(points)
    except ValueError:  # rows of different lengths: said by checked
        axes = 2
    given = checked(points, "points", ("N", 4, 4) if axes == 3 else ("N", "n"))
    if given.shape[1:] == (7,):
        given = checked_poses(given, "points")
    if given.ndim == 2:
        return given, None
    require_poses(given)
    return given[:, :3, 3], given[:, :3, :3]


def read_points(
    path: str | os.PathLike[str], robot: RobotLike | None = None, *, but_last: bool = False
) -> tuple[Array, Array | None, Array | None]:
    """Return points (N, n), times (N,) and speeds (N,) of a CSV or JSON file; the latter two if present.

    The columns belong to ``robot``, if given; with ``but_last`` all except the last coordinate.

    Raises:
        InputError: another suffix, a file that cannot be read, or one without points.
    """
    place = File(os.path.expanduser(path))
    suffix = place.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{place} ends in neither .csv nor .json.", remedy="Name it as what it is.", path=str(place))
    if suffix == ".json":
        return _read_json(place)
    table = read_table(place)
    if table.has_rates:
        raise InputError(
            f"{place} is a sampled motion: it has rates.",
            remedy="Read it with trajectory.from_csv (--motion on the command line).",
            path=str(place),
        )
    if len(next(iter(table.columns.values()), ())) > MOST_POINTS:
        raise InputError(f"{place} has more than {MOST_POINTS} rows.", remedy="Take fewer points.", path=str(place))
    if not table.coordinates:
        raise InputError(f"{place} has no coordinates.", remedy="Name its columns t, x, y, ....", path=str(place))
    if robot is None:
        _require_no_euler_angles(table.coordinates, place)
    else:
        table = in_order_of(as_robot(robot), table, but_last=but_last)
    return table.stacked(table.coordinates), table.columns.get("t"), table.columns.get("speed")


def _require_no_euler_angles(columns: Sequence[str], path: File) -> None:
    """Refuse roll, pitch and yaw angles: their names do not determine a rotation."""
    angles = [name for name in columns if name.lower() in ("roll", "pitch", "yaw")]
    if angles and (len(angles) > 1 or angles[0].lower() != "yaw" or "z" in columns):  # x, y and yaw are a plane's
        raise InputError(
            f"{path} has the column {angles[0]!r}: by itself it does not say about which axes, nor in which order.",
            remedy="Turn it into a unit quaternion, columns x, y, z, qx, qy, qz, qw (scipy: "
            'Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()).',
            path=str(path),
        )


def _read_json(path: File) -> tuple[Array, Array | None, Array | None]:
    """Return points, times and speeds of a JSON file, the latter two if present."""
    try:
        data = read_json(read_text(path, InputError, largest=LARGEST_TEXT))
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} is not JSON: {error}.", remedy="Correct it.", path=str(path)) from error
    times = speed = None
    if isinstance(data, Mapping):
        unknown = [key for key in data if key not in ("points", "t", "times", "speed")]
        if unknown or "points" not in data:
            what = f"has the key {shown(unknown[0])}" if unknown else "has no points"
            remedy = 'Write {"points": [[x, y], ...], "t": [...]}; speed is the other key.'
            raise InputError(f"{path} {what}.", remedy=remedy, path=str(path))
        times, speed, data = data.get("t", data.get("times")), data.get("speed"), data["points"]
    if not isinstance(data, list) or not data or isinstance(data[0], Mapping):
        remedy = 'Write [[x, y], ...], or {"points": [[x, y], ...], "t": [...]}.'
        raise InputError(f"{path} holds no list of points.", remedy=remedy, path=str(path))
    depth = 3 if isinstance(data[0], list) and data[0] and isinstance(data[0][0], list) else 2
    optional = [
        None if part is None else checked(part, name, ("N",)) for name, part in (("t", times), ("speed", speed))
    ]
    return checked(data, "points", ("N", "n", "m")[:depth]), optional[0], optional[1]
