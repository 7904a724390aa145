"""The one CSV format of motions, read and written: a row of names with units, such as ``x [m]``, then one row a sample.

A column is named by its quantity, then by its joint or coordinate:

    t [s]                                          time
    x [m], y [m], z [m], rx [rad], ry [rad], rz [rad]   platform coordinates; xd [m/s], rzd [rad/s] and
                                                   xdd [m/s^2], rzdd [rad/s^2] are their rates and accelerations
    x, y, z [m], qx, qy, qz, qw                    a pose: origin and unit quaternion; its rates are xd, ..., rzd, ...
    x:JOINT, xd:JOINT, xdd:JOINT                   coordinates of a robot without a platform
    s:JOINT, sd:JOINT, sdd:JOINT                   carriers
    q:JOINT, qd:JOINT, qdd:JOINT                   main actuators, written and not read
    tau:JOINT [N*m] or [N]                         efforts, written and not read

A number may stand in place of a name: x0, x1, ...; xd0, ...; s0, .... No cell of the first row begins with the name of
a joint: a spreadsheet cannot take it for a formula.
"""

from __future__ import annotations

import csv
import io
import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import LARGEST, Array, decimal
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.csv_cells import escape_formula, escape_value, unescape_formula
from redundancy_pin.io.reading import open_text, read_text
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_consistent
from redundancy_pin.robot import AXES, Robot
from redundancy_pin.robot.scales import effort_unit, is_revolute
from redundancy_pin.trajectory.quaternions import poses_of, quaternions_of

_QUATERNION_TOLERANCE = 1e-6
"""How far the norm of a quaternion may be from one: text with six digits passes; it is then normalised."""

_LARGEST_FILE = 1 << 30
"""Bytes of a file: five million samples of ten columns."""

_ROWS = 4096
"""Rows that become numbers at once: as text they take ten times the memory of their numbers."""

_QUATERNION = ("qx", "qy", "qz", "qw")
POSE = (*AXES[:3], *_QUATERNION)
"""Coordinates of a pose in space."""

_RESULTS = re.compile(r"(?:q|qd|qdd|tau):.*|status|margin|residual", re.DOTALL)
"""Columns that are results of a motion: they are written, and ignored where a motion is read."""

_MEASURED = re.compile(r"(?:x|q|s|tau):.*", re.DOTALL)
"""Columns of joints that are read where a file has measurements."""

_INDEXED = re.compile(r"([xs])(d{0,2})(0|[1-9]\d{0,3}|:.*)", re.DOTALL | re.ASCII)
"""Coordinates and carriers by number or by the name of a joint, and their rates: symbol, dots, which one."""

_POINTS_REMEDY = "Name the columns t,x,y,xd,yd,xdd,ydd for a motion with rates, or t,x,y for points."

# --- units ------------------------------------------------------------------------------------------------------------

LENGTH, ANGLE, TIME, NUMBER, EFFORT = "length", "angle", "time", "number", "effort"

_BASES: Mapping[str, tuple[str, float]] = {
    **{"m": (LENGTH, 1.0), "mm": (LENGTH, 1e-3), "cm": (LENGTH, 1e-2), "um": (LENGTH, 1e-6), "µm": (LENGTH, 1e-6)},
    **{"rad": (ANGLE, 1.0), "mrad": (ANGLE, 1e-3), "deg": (ANGLE, np.pi / 180.0), "°": (ANGLE, np.pi / 180.0)},
    **{"s": (TIME, 1.0), "ms": (TIME, 1e-3), "us": (TIME, 1e-6), "µs": (TIME, 1e-6), "min": (TIME, 60.0)},
    **{"1": (NUMBER, 1.0), "-": (NUMBER, 1.0), "": (NUMBER, 1.0)},
    **{"N": (EFFORT, 1.0), "N*m": (EFFORT, 1.0), "N·m": (EFFORT, 1.0)},
}
"""Units that are read: what they measure, and their value in SI."""

_RATE = re.compile(r"(?P<base>[^/]+)/(?P<time>[^/^²*\d]+)(?P<square>(?:\^|\*\*)?2|²)?")


def _unit(text: str) -> tuple[str, int, float] | None:
    """Return what a unit measures, by which power of time it is divided, and its value in SI; None if not known."""
    text = text.replace(" ", "").replace("μ", "µ")  # two letters that look alike
    if text in _BASES:
        return _BASES[text][0], 0, _BASES[text][1]
    rate = _RATE.fullmatch(text)
    base, time = (_BASES.get(rate[name]) for name in ("base", "time")) if rate else (None, None)
    if rate is None or base is None or time is None or time[0] != TIME or base[0] not in (LENGTH, ANGLE):
        return None
    power = 2 if rate["square"] else 1
    return base[0], power, base[1] / time[1] ** power


def heading(name: str, unit: str = "") -> str:
    """Return the cell of the first row that names a column."""
    return escape_formula(f"{name} [{unit}]" if unit else name)


_HEADING = re.compile(r"(?P<name>.*?) ?\[(?P<unit>[^\[\]]*)\]", re.DOTALL)


def _name_and_unit(cell: str) -> tuple[str, str | None]:
    """Return name and unit of a cell of the first row, "t" for "time"; None without a unit."""
    match = _HEADING.fullmatch(cell.strip())
    name = match["name"] if match else cell.strip()
    name = name if ":" in name else name.strip()
    return ("t" if name == "time" else name), (match["unit"] if match else None)


# --- writing ----------------------------------------------------------------------------------------------------------

Columns: TypeAlias = Mapping[str, tuple[str, NDArray[np.generic]]]
"""Unit and values (N,) of each column, by its name."""


def rate_name(coordinate: str, order: int) -> str:
    """Return the name of the rate, or of the acceleration, of a coordinate: ``xd``, ``rzdd``, ``xd:JOINT``, ``xd0``."""
    indexed = _INDEXED.fullmatch(coordinate)
    return f"{indexed[1]}{order * 'd'}{indexed[3]}" if indexed else coordinate + order * "d"


def coordinate_names(robot: Robot) -> tuple[str, ...]:
    """Return the names of the independent coordinates of a robot in a file."""
    if robot.platform is None:
        return tuple(f"x:{joint}" for joint in robot.independent_joints)
    return POSE if robot.platform.is_pose else robot.platform.axes


def motion_columns(
    robot: Robot, motion: PlatformMotion, carriers: CarrierMotion | None = None
) -> dict[str, tuple[str, Array]]:
    """Return the columns of a motion: time, coordinates, their rates and accelerations, then the carriers'."""
    names, x = coordinate_names(robot), motion.x
    if motion.is_pose:
        x = np.concatenate([x[:, :3, 3], quaternions_of(x[:, :3, :3])], axis=1)
    rates = AXES if motion.is_pose else names
    moved = tuple(f"s:{joint}" for joint in robot.carriers)
    parts = [(names, 0, x), (rates, 1, motion.xd), (rates, 2, motion.xdd)]
    parts += [] if carriers is None else [(moved, 0, carriers.s), (moved, 1, carriers.sd), (moved, 2, carriers.sdd)]
    columns: dict[str, tuple[str, Array]] = {"t": ("s", motion.t)}
    for own, order, values in parts:
        for name, column in zip(own, values.T, strict=True):
            columns[rate_name(name, order)] = unit_of(robot, name, order), column
    return columns


def heading_unit(robot: Robot, joint: str) -> str:
    """Return the unit of the effort of a joint as headings of columns have it."""
    return effort_unit([is_revolute(robot, joint)]).replace("·", "*")


def unit_of(robot: Robot, name: str, order: int = 0) -> str:
    """Return the unit of a coordinate or a carrier, or of its rate."""
    if name in _QUATERNION:
        return "1"
    return ("rad" if _turns(robot, name) else "m") + ("", "/s", "/s^2")[order]


def _turns(robot: Robot, name: str) -> bool:
    """Return whether a coordinate of a robot, or one of its carriers, is an angle."""
    symbol, separator, joint = name.partition(":")
    return is_revolute(robot, joint) if separator else symbol.startswith("r")


def effort_columns(
    joints: Sequence[str], efforts: Array, robot: Robot, symbol: str = "tau"
) -> dict[str, tuple[str, Array]]:
    """Return the columns of efforts (N, c) of joints."""
    return {f"{symbol}:{name}": (heading_unit(robot, name), efforts[:, k]) for k, name in enumerate(joints)}


def csv_rows(columns: Columns, *, digits: int | None = None) -> str:
    """Return columns as CSV text.

    Args:
        columns: numbers or texts.
        digits: significant digits of numbers; the shortest text that brings the float back when left out.
    """

    def text(value: object) -> str:
        return (
            escape_value(value) if isinstance(value, str) else repr(value) if digits is None else f"{value:.{digits}g}"
        )

    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([heading(name, unit) for name, (unit, _) in columns.items()])
    cells = [list(map(text, np.asarray(values).tolist())) for _, values in columns.values()]
    writer.writerows(zip(*cells, strict=True))
    return out.getvalue()


# --- reading ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MotionTable:
    """What a CSV file holds of a motion, in SI units.

    Attributes:
        path: of the file.
        coordinates: names of the coordinates, x, y and z first.
        rates: names of their rates; empty for a file of points.
        carriers: names of the carriers.
        columns: (N,) by name: ``t`` and ``speed`` where they are there, coordinates, carriers, and rates of both.
        measures: "length", "angle", ... by name of a column that has a unit in the file, whatever it is divided by.
    """

    path: str
    coordinates: tuple[str, ...]
    rates: tuple[str, ...]
    carriers: tuple[str, ...]
    columns: Mapping[str, Array]
    measures: Mapping[str, str] = field(default_factory=dict)

    @property
    def has_rates(self) -> bool:
        """Whether it is a sampled motion; else points, which are passed by a motion of their own."""
        return bool(self.rates)

    def stacked(self, names: Sequence[str], order: int = 0) -> Array:
        """Return (N, c) columns, or their rates."""
        return np.stack([self.columns[rate_name(name, order)] for name in names], axis=1)


def from_csv(
    path: str | os.PathLike[str], robot: RobotLike | None = None, *, check_rates: bool = True
) -> PlatformMotion:
    """Read a platform motion from a CSV file.

    The first row names the columns, with units or without (then SI): ``t [s]``; coordinates ``x [m]``, ``y``, ``z``,
    ``rx [rad]``, ``ry``, ``rz``, or ``x:JOINT``; their rates ``xd [m/s]``, ``yd``, ... and ``xdd [m/s^2]``, ...; any
    order, other columns are ignored. A spatial platform has ``x``, ``y``, ``z`` and the unit quaternion ``qx``, ``qy``,
    ``qz``, ``qw``, and six rates ``xd``, ..., ``rzd``, its twist in world axes. A number may stand for a name: ``x0``,
    ``xd0``, ``xdd0``. Units mm, cm, µm, deg, ms, min are converted. An instant may occur twice for the acceleration
    before and after a jump. Rates must match the positions (``require_consistent``): other units, or columns in
    another order, are refused.

    Args:
        path: of the file, UTF-8, comma separated.
        robot: whose motion it is: names of columns must be its coordinates; the result has its order.
        check_rates: as in ``PlatformMotion``: false for poses to stand still in, and states that are no motion.

    Raises:
        InputError: no such file, not text, a missing column (with the names seen), a unit that is not known or not one
            of that quantity, a cell that is not a finite number (with row and column), rows of different lengths,
            columns of another robot, rates that do not match the positions (with column, sample and both values),
            positions without rates, or a motion that is not one.

    Example:
        >>> rp.trajectory.from_csv("motion.csv").x.shape
        (3, 2)
    """
    table = _sampled(path, robot)
    motion = _platform(table, check_rates)
    with _in_file(table):
        require_consistent(motion)
    return motion


def carriers_from_csv(
    path: str | os.PathLike[str], robot: RobotLike | None = None, *, check_rates: bool = True
) -> CarrierMotion | None:
    """Read the carrier motion from a CSV file: columns ``s:JOINT [m]``, ``sd:JOINT``, ``sdd:JOINT``, or ``s0``, ....

    Args:
        path: of the file, as in ``from_csv``.
        robot: whose carriers they are: they are put into its order.
        check_rates: as in ``from_csv``.

    Returns:
        The carrier motion, or None where the file has no carrier column.

    Raises:
        InputError: as ``from_csv``.

    Example:
        >>> rp.trajectory.carriers_from_csv("motion.csv") is None  # no carrier columns: parked
        True
    """
    table = _sampled(path, robot)
    if not table.carriers:
        return None
    carriers = CarrierMotion(*(table.stacked(table.carriers, order) for order in range(3)), check_rates=check_rates)
    if check_rates:
        still = np.zeros((len(carriers), 0))
        with _in_file(table):
            require_consistent(PlatformMotion(table.columns["t"], still, still, still), carriers)
    return carriers


def _sampled(path: str | os.PathLike[str], robot: RobotLike | None) -> MotionTable:
    """Return the table of a sampled motion, in the order of a robot."""
    table = read_table(path)
    if not table.has_rates:
        message = f" has positions ({', '.join(table.coordinates)}) and no rates: it is a file of points."
        remedy = "Read it by trajectory.from_points (--motion on the command line), or add "
        rated = AXES if set(_QUATERNION) & set(table.coordinates) else table.coordinates
        raise _bad(table.path, message, f"{remedy}{_listed(rated, 1)}, {_listed(rated, 2)}.")
    return table if robot is None else in_order_of(as_robot(robot), table)


def _listed(names: Sequence[str], order: int) -> str:
    return ", ".join(rate_name(name, order) for name in names)


def _platform(table: MotionTable, check_rates: bool) -> PlatformMotion:
    x = table.stacked(table.coordinates)
    if len(table.rates) < len(table.coordinates):
        x = checked_poses(x, table.path)
    with _in_file(table):
        rates = (table.stacked(table.rates, order) for order in (1, 2))
        return PlatformMotion(table.columns["t"], x, *rates, check_rates=check_rates)


def in_order_of(robot: Robot, table: MotionTable, *, but_last: bool = False) -> MotionTable:
    """Return a table with the coordinates and the carriers of a robot, in its order.

    With ``but_last`` the file has all coordinates except the last one, which is constant.

    Raises:
        InputError: named columns do not match the robot, or have units of other quantities.
    """
    own, carriers = coordinate_names(robot)[: -1 if but_last else None], tuple(f"s:{joint}" for joint in robot.carriers)
    coordinates = _match_columns(table, table.coordinates, own, "coordinates", robot)
    moved = _match_columns(table, table.carriers, carriers, "carriers", robot) if table.carriers else ()
    for given, expected in ((coordinates, own), (moved, carriers)):
        for column, name in zip(given, expected, strict=False):  # counts are judged by what takes the motion
            wanted = NUMBER if name in _QUATERNION else ANGLE if _turns(robot, name) else LENGTH
            for each in (rate_name(column, order) for order in range(3)):
                if table.measures.get(each, wanted) != wanted:
                    units = ", ".join(unit for unit, (what, _) in _BASES.items() if what == wanted)
                    message = (
                        f", column {each!r}: its unit is one of {table.measures[each]}, and {name} of {robot.name}"
                    )
                    raise _bad(table.path, f"{message} is one of {wanted}.", f"Give {units}, or none.", column=each)
    rates = coordinates if len(table.rates) == len(table.coordinates) else table.rates
    return MotionTable(table.path, coordinates, rates if table.rates else (), moved, table.columns, table.measures)


def _match_columns(
    table: MotionTable, given: tuple[str, ...], own: tuple[str, ...], what: str, robot: Robot
) -> tuple[str, ...]:
    """Return the columns of a file in the order of a robot's names; numbered ones are in it."""
    numbered = all(_INDEXED.fullmatch(name) and ":" not in name for name in given)
    if numbered or given == own:
        return given
    if set(given) == set(own):
        return own
    if len(given) == len(own) == 1:  # one coordinate may have any name
        return given
    bare = {name.partition(":")[2]: name for name in own if ":" in name}
    if set(given) == set(bare):  # names of joints
        return tuple(bare)
    # a plane's angle may have any name: phi, alpha, yaw
    free, left = [name for name in given if name not in AXES and ":" not in name], [n for n in own if n not in given]
    if len(given) == len(own) and len(free) == len(left) == 1 and left[0].startswith("r"):
        return tuple(free[0] if name == left[0] else name for name in own)
    message = f" has the {what} {', '.join(given)}; {robot.name} has {', '.join(own) if own else 'none'}."
    rated = AXES if own == POSE else own
    names = ", ".join((*own, _listed(rated, 1), _listed(rated, 2)) if table.has_rates else own)
    remedy = f"Name the columns {names}." if own else "Leave these columns out."
    raise _bad(table.path, message, remedy, axes_seen=given)


def read_table(path: str | os.PathLike[str]) -> MotionTable:
    """Read a CSV file: a motion if it has rates, otherwise points.

    Raises:
        InputError: as ``from_csv``.
    """
    place = os.fspath(path)
    header, rows = _header_and_rows(place)
    blocks = iter(lambda: list(islice(rows, _ROWS)), [])
    values = np.concatenate([_numbers(header.names, header.read, block, place) for block in blocks]).T
    columns = {name: column * header.factor[name] for name, column in zip(header.read, values, strict=True)}
    return MotionTable(place, header.coordinates, header.rates, header.carriers, columns, header.measures)


def read_measured(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Read a CSV file of measurements: t, platform coordinates, x:JOINT, q:JOINT, s:JOINT, tau:JOINT.

    Other columns are ignored.

    Returns:
        Values (N,) in SI, by column name.

    Raises:
        InputError: as ``from_csv``.

    Example:
        >>> read_measured("run.csv")["tau:base_1"]
    """
    place = os.fspath(path)
    cells, rows = _cells_and_rows(place)
    units = _units(cells, place)
    read = [name for name in units if name == "t" or name in AXES or _MEASURED.fullmatch(name)]
    if "t" not in units:
        raise _missing("t", units, place, "Name the columns t,q:JOINT,...,tau:JOINT,....")
    factors = [_factor(name, unit, place)[0] if (unit := units[name]) is not None else 1.0 for name in read]
    values = _numbers(list(units), read, list(rows), place)
    return dict(zip(read, (values * factors).T, strict=True))


def has_rates(path: str | os.PathLike[str]) -> bool:
    """Return whether a CSV file is a sampled motion, by its first row; raises as ``read_table``."""
    return bool(_header_and_rows(os.fspath(path))[0].rates)


def _header_and_rows(path: str) -> tuple[_Header, Iterator[tuple[int, list[str]]]]:
    """Return the header that the first row of a file states, and the other rows with their numbers."""
    cells, rows = _cells_and_rows(path)
    return _Header(cells, path), rows


def _cells_and_rows(path: str) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """Return the cells of the first row of a file, and the others with their numbers."""
    rows = _rows(path)
    names, first = next(rows, None), next(rows, None)
    if names is None or first is None:
        remedy = "Give a row of column names (t, x, y, ..., xd, yd, ...) and at least one row of numbers."
        raise _bad(path, " has 0 rows of numbers.", remedy)
    cells = [unescape_formula(cell.strip()) for cell in names[1]]
    _require_names(cells, first[1], path)
    return cells, chain([first], rows)


def _units(cells: Sequence[str], path: str) -> dict[str, str | None]:
    """Return the unit of each column by its name, from the cells of the first row."""
    names = [_name_and_unit(cell)[0] for cell in cells]
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        cells_of = ", ".join(shown(cell) for cell, name in zip(cells, names, strict=True) if name == twice[0])
        raise _bad(path, f" has the column {twice[0]!r} more than once: {cells_of}.", column=twice[0])
    return dict(map(_name_and_unit, cells))


def _rows(path: str) -> Iterator[tuple[int, list[str]]]:
    """Give the rows that are not empty, each with the number of its line in the file, as an editor shows it."""
    try:
        with open_text(path, InputError, largest=_LARGEST_FILE) as text:
            reader = csv.reader(text)
            yield from ((reader.line_num, row) for row in reader if any(cell.strip() for cell in row))
    except UnicodeDecodeError:
        read_text(path, InputError, largest=_LARGEST_FILE)  # raises, and names the line
        raise
    except csv.Error as error:
        raise _bad(path, f" is not a text file with columns: {error}.") from error


class _Header:
    """The first row of a file: the columns that are read, and their meaning.

    Attributes:
        names: of all columns.
        read: names of the columns that are read.
        coordinates, rates, carriers: as of ``MotionTable``.
        factor: by name of a column that is read, the value of its unit in SI.
        measures: as of ``MotionTable``.
    """

    def __init__(self, cells: Sequence[str], path: str) -> None:
        units = _units(cells, path)
        self._path, self.names = path, list(units)
        own = [name for name in self.names if name not in _TIMES and not _RESULTS.fullmatch(name)]
        # by name what a column is of, and how often that is differentiated
        of = {name: _differentiated(name, units) for name in own}
        moved = [stem for name, (stem, order) in of.items() if order and not _of_carrier(name)]
        places = [name for name in own if not of[name][1] and not _of_carrier(name)]
        if moved:  # what is no coordinate is a note
            places = [name for name in places if name in moved or name in (*POSE, *AXES) or _INDEXED.fullmatch(name)]
        self.coordinates = self._number_order("x", sort_coordinates(places), moved)
        tracks = [name for name in own if not of[name][1] and _of_carrier(name)]
        self.carriers = self._number_order("s", tracks, [stem for stem, _ in of.values()])
        self.rates = self._rates() if moved else ()
        if (moved or self.carriers) and "t" not in units:
            raise _missing("t", self.names, self._path)
        timed = [name for name in _TIMES if name in units and (name != "speed" or not moved)]
        needed = [*self.coordinates, *self.carriers]
        needed += [rate_name(name, order) for order in (1, 2) for name in (*self.rates, *self.carriers)]
        # carriers go with a platform that moves; rates go with what they are the rates of
        absent = [name for name in needed if name not in units]
        absent += [stem for name, (stem, order) in of.items() if order and name not in needed]
        absent += [rate_name(name, 1) for name in (*self.coordinates, "x") if self.carriers and not moved]
        if absent:
            raise _missing(absent[0], self.names, self._path)
        self.read = [*timed, *needed]
        self.factor: dict[str, float] = dict.fromkeys(self.read, 1.0)
        self.measures: dict[str, str] = {}
        for name in self.read:
            if (unit := units[name]) is not None:
                stem, order = of.get(name, (name, 0))
                self.factor[name], self.measures[name] = _factor(name, unit, path, stem, order)

    def _number_order(self, symbol: str, names: Sequence[str], moved: Sequence[str]) -> tuple[str, ...]:
        """Return coordinates, or carriers, in the order of their numbers, if they have numbers: all, from zero on."""
        numbered = [name for name in (*names, *moved) if re.fullmatch(rf"{symbol}(0|[1-9]\d*)", name, re.ASCII)]
        if not numbered or not moved:
            return tuple(names)
        count = max(1, len(set(numbered) & set(names)))
        absent = [name for k in range(count) if (name := f"{symbol}{k}") not in names]
        if absent:
            raise _missing(absent[0], self.names, self._path)
        others = [name for name in names if name not in numbered]
        if others:
            message = f" names columns in two ways: {symbol}0 and {others[0]}."
            raise _bad(self._path, message, "Name all of them, or number all.", column=others[0])
        return tuple(f"{symbol}{k}" for k in range(count))

    def _rates(self) -> tuple[str, ...]:
        """Return the names of the rates of the coordinates; a pose has six."""
        if set(_QUATERNION) & set(self.coordinates):
            absent = [name for name in POSE if name not in self.coordinates]
            if absent:
                raise _missing(absent[0], self.names, self._path)
            return AXES
        of_pose = self.coordinates == tuple(f"x{k}" for k in range(len(POSE))) and "xd6" not in self.names
        return self.coordinates[: len(AXES)] if of_pose else self.coordinates


_TIMES = ("t", "speed")
"""Columns beside the coordinates."""

_PER = ("", " by time", " by time squared")


def _of_carrier(name: str) -> bool:
    match = _INDEXED.fullmatch(name)
    return bool(match and match[1] == "s")


def _differentiated(name: str, known: Collection[str]) -> tuple[str, int]:
    """Return of what a column is the rate (1) or the acceleration (2), and which; or the column itself, and 0."""
    if match := _INDEXED.fullmatch(name):
        return f"{match[1]}{match[3]}", len(match[2])
    for order in (2, 1):
        stem = name[:-order]
        if name.endswith("d" * order) and (stem in AXES or stem in known):
            return stem, order
    return name, 0


def _quantities(stem: str) -> tuple[str, ...]:
    """Return what a column may measure, by which coordinate it is of."""
    if stem == "t":
        return (TIME,)
    if stem in _QUATERNION:
        return (NUMBER,)
    if stem.startswith("tau:"):
        return (EFFORT,)
    if stem in AXES or stem == "speed":
        return (ANGLE if stem.startswith("r") else LENGTH,)
    return LENGTH, ANGLE


def _factor(name: str, unit: str, path: str, stem: str = "", order: int = 0) -> tuple[float, str]:
    """Return the value of a unit in SI, and what it measures; ``stem`` is what a rate is the rate of."""
    known, quantities = _unit(unit), _quantities(stem or name)
    order += name == "speed"
    if known is not None and known[0] in quantities and known[1] == order:
        return known[2], known[0]
    units = [f"{each}{('', '/s', '/s^2')[order]}" for each, (what, _) in _BASES.items() if what in quantities and each]
    wrong = "is no unit of" if known else "is no unit that is known; a column of"
    message = f", column {name!r}: {shown(unit)} {wrong} {' or '.join(quantities)}{_PER[order]}"
    remedy = f"Give one of {', '.join(units)}, or no unit for SI."
    raise _bad(path, f"{message}{'' if known else ' is expected'}.", remedy, column=name, unit=unit)


def _missing(name: str, names: Iterable[str], path: str, remedy: str = _POINTS_REMEDY) -> InputError:
    seen = tuple(names)
    message = f" has no column {name!r}; its columns are {', '.join(map(repr, seen))}."
    return _bad(path, message, remedy, column=name, seen=seen)


def sort_coordinates(names: Iterable[str]) -> list[str]:
    """Return coordinates, x, y, z and rotations first, then others as they come; a pose as ``POSE``."""
    listed = list(names)
    first = POSE if set(_QUATERNION) & set(listed) else AXES
    return sorted(listed, key=lambda name: first.index(name) if name in first else len(first))


def _require_names(names: Sequence[str], first: Sequence[str], path: str) -> None:
    """Check that the first row names columns between commas: numbers there would be dropped as if they were names."""
    names = [name.strip() for name in names]
    if names and np.isfinite([_number(name) for name in names]).all():
        message = f" begins with numbers, {shown(', '.join(names))}, where the names of its columns should stand."
        raise _bad(path, message, f"Put a row of names before it. {_POINTS_REMEDY}")
    if len(names) != 1:
        return
    for separator, what in ((";", "semicolons"), ("\t", "tabs"), (None, "blanks")):
        parts = names[0].split(separator)
        # a name may hold blanks: they separate where the numbers below stand in as many parts
        if len(parts) > 1 and (separator or len(parts) == len(" ".join(first).split())):
            message = f" has one column, {shown(names[0])}: {what} are between its names."
            raise _bad(path, message, "Put commas between the columns, and points into the numbers.")


def _numbers(names: Sequence[str], read: Sequence[str], rows: Sequence[tuple[int, list[str]]], path: str) -> Array:
    """Return (N, c) the numbers of the columns that are read."""
    for line, row in rows:
        if len(row) != len(names):
            raise _bad(path, f", row {line}: {len(row)} cells under {len(names)} column names.", row=line)
    at = [names.index(name) for name in read]
    cells = [[row[k] for k in at] for _, row in rows]
    try:
        if any("_" in cell or not cell.isascii() for row in cells for cell in row):
            raise ValueError("numpy takes them as ``float`` does")
        values = np.array(cells, dtype=np.float64)
    except ValueError:
        values = np.array([[_number(cell) for cell in row] for row in cells])
    values = values.reshape(len(rows), len(at))
    bad = np.argwhere(~(np.abs(values) <= LARGEST))
    if len(bad):
        r, c = (int(i) for i in bad[0])
        line, cell, name = rows[r][0], cells[r][c], read[c]
        message = f", row {line}, column {name!r}: {shown(cell)} is not a finite number."
        raise _bad(path, message, "Use a decimal point and no unit.", row=line, column=name)
    return values


def _number(cell: str) -> float:
    try:
        return decimal(cell)
    except ValueError:
        return float("nan")


def checked_poses(x: Array, path: str | os.PathLike[str]) -> Array:
    """Return (N, 4, 4) poses of (N, 7) positions, m, and quaternions x, y, z, w; ``path`` is what errors name."""
    norms = np.linalg.norm(x[:, 3:], axis=1)
    k = int(np.argmax(np.abs(norms - 1.0)))
    if abs(norms[k] - 1.0) > _QUATERNION_TOLERANCE:
        message = f": the quaternion x3..x6 of sample {k} has norm {norms[k]:.9g}."
        raise _bad(path, message, "Give unit quaternions in the order x, y, z, w.", sample=k)
    return poses_of(x[:, :3], x[:, 3:])


@contextmanager
def _in_file(table: MotionTable) -> Iterator[None]:
    """Say of an error which file it is about, and call columns what the file calls them."""
    try:
        yield
    except InputError as error:
        called = {
            f"{symbol}{order * 'd'}{k}": rate_name(name, order)
            for symbol, names in (("x", table.rates), ("s", table.carriers))
            for k, name in enumerate(names)
            for order in range(3)
        }
        message = re.sub(r"\b[xs]d{0,2}\d+\b", lambda match: called.get(match[0], match[0]), error.message)
        details = {"path": table.path, **error.details}
        if details.get("column") in called:
            details["column"] = called[str(details["column"])]
        raise InputError(f"{table.path}: {message}", remedy=error.remedy, **details) from error


def _bad(path: str | os.PathLike[str], message: str, remedy: str = "", **details: object) -> InputError:
    return InputError(f"{os.fspath(path)}{message}", remedy=remedy, path=str(path), **details)
