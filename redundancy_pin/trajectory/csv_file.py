"""Motions from a user's CSV file."""

from __future__ import annotations

import csv
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import TextIOWrapper
from itertools import islice
from typing import TypeAlias

import numpy as np

from redundancy_pin.arrays import LARGEST, Array, decimal
from redundancy_pin.errors import InputError, numbered_from, shown
from redundancy_pin.io.reading import opened
from redundancy_pin.motion import CarrierMotion, PlatformMotion, joined, require_consistent
from redundancy_pin.trajectory.quaternions import poses_of

_QUATERNION_TOLERANCE = 1e-6
"""How far the norm of a quaternion may be from one: text with six digits passes; it is then normalised."""


_LONGEST_LINE = 1_000_000

BLOCK = 20_000
"""Samples of a long motion that are worked on at a time."""

_OVERLAP = 10
"""Samples of one block that are compared with the next one again: fewer steps than nine tell little of rates."""


def from_csv(path: str | os.PathLike[str], *, check_rates: bool = True) -> PlatformMotion:
    """Read a platform motion from a CSV file.

    The first row names the columns: ``t`` (s), ``x0``, ``x1``, ... (m, rad), ``xd0``, ... and ``xdd0``, ...; any order,
    other columns are ignored. For a spatial platform give six rates and seven x: position (m) and unit quaternion
    (x, y, z, w). An instant may occur twice for the acceleration before and after a jump. Rates must be those of the
    positions (``require_consistent``): other units, or columns in another order, are refused.

    Args:
        path: of the file, UTF-8, comma separated.
        check_rates: as in ``PlatformMotion``: false for poses to stand still in, and states that are no motion.

    Raises:
        InputError: no such file, not text, a missing column (with the names seen), a cell that is not a finite
            number (with row and column), rows of different lengths, rates that are not those of the positions (with
            column, sample and both values), or a motion that is not one.
    """
    table = table_of_csv(path)
    motion = _platform(table, path, check_rates)
    with _in_file(path):
        require_consistent(motion)
    return motion


def carriers_from_csv(path: str | os.PathLike[str], *, check_rates: bool = True) -> CarrierMotion | None:
    """Read the carrier motion from a CSV file: columns ``s0``, ..., ``sd0``, ..., ``sdd0``, ... (m, s).

    Args:
        path: of the file, as in ``from_csv``.
        check_rates: as in ``from_csv``.

    Returns:
        The carrier motion, or None where the file has no carrier column.

    Raises:
        InputError: as ``from_csv``.
    """
    table = table_of_csv(path)
    carriers = _carriers(table, path, check_rates)
    if carriers is not None and check_rates:
        still = np.zeros((len(carriers), 0))
        with _in_file(path):
            require_consistent(PlatformMotion(table["t"], still, still, still), carriers)
    return carriers


MotionBlock: TypeAlias = tuple[PlatformMotion, CarrierMotion | None]


class MotionFile:
    """The motion of a CSV file that may be too long to be held, block by block.

    It is read once to check it, as ``from_csv`` and ``carriers_from_csv`` do, and once more by whoever iterates over
    it. Memory is that of a block, however long the file is.

    Args:
        path: of the file, as in ``from_csv``.
        check_rates: as in ``from_csv``.
        block: samples a block.
        progress: called with the part of the file that has been checked.

    Raises:
        InputError: as ``from_csv`` and ``carriers_from_csv``.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        check_rates: bool = True,
        block: int = BLOCK,
        progress: Callable[[float], None] = lambda part: None,
    ) -> None:
        if not isinstance(block, int) or block < 1:
            raise InputError(f"block is {shown(block)}.", remedy="Pass a number of samples, 1 or more.")
        self._path, self._check, self._block, self._samples = path, check_rates, block, 0
        last: MotionBlock | None = None
        for new in self._blocks(progress):
            with numbered_from(self._samples - (len(last[0]) if last else 0)), _in_file(path):
                motion, carriers = joined(last, new) if last else new
                require_consistent(motion, carriers)
            self._samples += len(new[0])
            last = motion[-_OVERLAP:], None if carriers is None else carriers[-_OVERLAP:]

    def __len__(self) -> int:
        """Return the number of samples."""
        return self._samples

    def __iter__(self) -> Iterator[MotionBlock]:
        """Give the motions of platform and carriers, block by block; carriers None where there are no such columns."""
        return self._blocks()

    def _blocks(self, progress: Callable[[float], None] = lambda part: None) -> Iterator[MotionBlock]:
        first = 0
        for table in tables_of_csv(self._path, block=self._block, progress=progress):
            with numbered_from(first):
                motion = _platform(table, self._path, self._check)
                carriers = _carriers(table, self._path, self._check)
            yield motion, carriers
            first += len(motion)


def _platform(table: dict[str, Array], path: str | os.PathLike[str], check_rates: bool) -> PlatformMotion:
    x, xd, xdd = (_columns(table, name, path) for name in ("x", "xd", "xdd"))
    if x.shape[1] == 7 and xd.shape[1] == 6:
        x = checked_poses(x, path)
    else:
        _require_as_many(path, x=x, xd=xd)
    _require_as_many(path, xd=xd, xdd=xdd)
    with _in_file(path):
        return PlatformMotion(table["t"], x, xd, xdd, check_rates=check_rates)


def _carriers(table: dict[str, Array], path: str | os.PathLike[str], check_rates: bool) -> CarrierMotion | None:
    if not any(re.fullmatch(r"s(d|dd)?\d+", name) for name in table):
        return None
    s, sd, sdd = (_columns(table, name, path) for name in ("s", "sd", "sdd"))
    _require_as_many(path, s=s, sd=sd)
    _require_as_many(path, sd=sd, sdd=sdd)
    return CarrierMotion(s, sd, sdd, check_rates=check_rates)


def table_of_csv(path: str | os.PathLike[str], needs: Sequence[str] = ("t",), most: float = np.inf) -> dict[str, Array]:
    """Return the columns of the file by name.

    InputError where it cannot be read, lacks one of those needed, or has more rows than ``most``.
    """
    tables, rows = [], 0
    for table in tables_of_csv(path, needs):
        tables.append(table)
        rows += len(next(iter(table.values())))
        if rows > most:
            raise _bad(path, f" has more than {most} rows.", "Take fewer points.")
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def tables_of_csv(
    path: str | os.PathLike[str],
    needs: Sequence[str] = ("t",),
    *,
    block: int = BLOCK,
    progress: Callable[[float], None] = lambda part: None,
) -> Iterator[dict[str, Array]]:
    """Give the columns of the file by name, so many rows at a time, one block at least; errors as ``table_of_csv``."""
    try:
        with TextIOWrapper(opened(os.fspath(path), InputError), "utf-8-sig", newline="") as stream:
            reader, size = csv.reader(_lines(stream, path)), max(os.fstat(stream.fileno()).st_size, 1)
            # The row number is that of the line in the file, as an editor shows it.
            rows = ((reader.line_num, row) for row in reader if any(cell.strip() for cell in row))
            heading = [row for _, row in islice(rows, 1)]
            names = [name.strip() for row in heading for name in row]
            twice = sorted(name for name, count in Counter(names).items() if count > 1)
            some = list(islice(rows, block))
            if not some:
                remedy = "Give a row of column names (t, x0, ..., xd0, ..., xdd0, ...) and at least one row of numbers."
                raise _bad(path, " has 0 rows of numbers.", remedy)
            _require_names(names, some[0][1], path)
            if twice:
                raise _bad(path, f" has the column {twice[0]!r} more than once.", column=twice[0])
            while some:
                table = dict(zip(names, _numbers(names, some, path).T, strict=True))
                for name in needs:
                    if name not in table:
                        raise _missing(path, name, names)
                progress(min(stream.buffer.tell() / size, 1.0))
                yield table
                some = list(islice(rows, block))
    except OSError as error:
        raise InputError(
            f"Cannot read {os.fspath(path)}: {error.strerror or error}.", remedy="Check the path.", path=str(path)
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise _bad(path, f" is not a text file with columns: {error}.") from error


def _lines(stream: TextIOWrapper, path: str | os.PathLike[str]) -> Iterator[str]:
    """Give the lines of a file; one that is too long for a row of numbers is refused before it is held."""
    while line := stream.readline(_LONGEST_LINE + 1):
        if len(line) > _LONGEST_LINE:
            raise _bad(path, f" has a line of more than {_LONGEST_LINE} characters.", "Write a line for each sample.")
        yield line


def _require_names(names: Sequence[str], first: Sequence[str], path: str | os.PathLike[str]) -> None:
    """Check that the first row names columns between commas: numbers there would be dropped as if they were names."""
    if names and np.isfinite([_number(name) for name in names]).all():
        message = f" begins with numbers, {shown(', '.join(names))}, where the names of its columns should stand."
        raise _bad(path, message, "Put a row of names before it, such as t,x,y; a sampled motion has t,x0,xd0,xdd0.")
    if len(names) != 1:
        return
    for separator, what in ((";", "semicolons"), ("\t", "tabs"), (None, "blanks")):
        parts = names[0].split(separator)
        # a name may hold blanks: they separate where the numbers below stand in as many parts
        if len(parts) > 1 and (separator or len(parts) == len(" ".join(first).split())):
            message = f" has one column, {shown(names[0])}: {what} are between its names."
            raise _bad(path, message, "Put commas between the columns, and points into the numbers.")


def _numbers(names: Sequence[str], rows: Sequence[tuple[int, list[str]]], path: str | os.PathLike[str]) -> Array:
    for line, row in rows:
        if len(row) != len(names):
            raise _bad(path, f", row {line}: {len(row)} cells under {len(names)} column names.", row=line)
    try:
        if any("_" in cell or not cell.isascii() for _, row in rows for cell in row):
            raise ValueError("numpy takes them as ``float`` does")
        values = np.array([row for _, row in rows], dtype=np.float64)
    except ValueError:
        values = np.array([[_number(cell) for cell in row] for _, row in rows])
    bad = np.argwhere(~(np.abs(values) <= LARGEST))
    if len(bad):
        r, c = (int(i) for i in bad[0])
        line, cell = rows[r][0], rows[r][1][c]
        message = f", row {line}, column {names[c]!r}: {shown(cell)} is not a finite number."
        raise _bad(path, message, "Use a decimal point and no unit.", row=line, column=names[c])
    return values


def _number(cell: str) -> float:
    try:
        return decimal(cell)
    except ValueError:
        return float("nan")


def _columns(table: dict[str, Array], prefix: str, path: str | os.PathLike[str]) -> Array:
    """Return (N, n) the columns prefix0, prefix1, ...; there must be a first one and no gap."""
    numbers = sorted(int(name[len(prefix) :]) for name in table if re.fullmatch(rf"{prefix}(0|[1-9]\d{{0,3}})", name))
    for expected in range(max(len(numbers), 1)):
        if expected >= len(numbers) or numbers[expected] != expected:
            raise _missing(path, f"{prefix}{expected}", list(table))
    return np.stack([table[f"{prefix}{k}"] for k in numbers], axis=1)


def _require_as_many(path: str | os.PathLike[str], **columns: Array) -> None:
    (first, a), (second, b) = ((name, array.shape[1]) for name, array in columns.items())
    if a != b:
        message = f" has {a} columns {first}0, ... and {b} columns {second}0, ...."
        raise _bad(
            path, message, "Give as many of each; only poses have seven x (position and quaternion) for six rates."
        )


def checked_poses(x: Array, path: str | os.PathLike[str]) -> Array:
    """Return (N, 4, 4) poses of (N, 7) positions, m, and quaternions x, y, z, w; ``path`` is what errors name."""
    norms = np.linalg.norm(x[:, 3:], axis=1)
    k = int(np.argmax(np.abs(norms - 1.0)))
    if abs(norms[k] - 1.0) > _QUATERNION_TOLERANCE:
        message = f": the quaternion x3..x6 of sample {k} has norm {norms[k]:.9g}."
        raise _bad(path, message, "Give unit quaternions in the order x, y, z, w.", sample=k)
    return poses_of(x[:, :3], x[:, 3:])


@contextmanager
def _in_file(path: str | os.PathLike[str]) -> Iterator[None]:
    """Say of an error which file it is about."""
    try:
        yield
    except InputError as error:
        details = {"path": str(path), **error.details}
        raise InputError(f"{os.fspath(path)}: {error.message}", remedy=error.remedy, **details) from error


def _bad(path: str | os.PathLike[str], message: str, remedy: str = "", **details: object) -> InputError:
    return InputError(f"{os.fspath(path)}{message}", remedy=remedy, path=str(path), **details)


def _missing(path: str | os.PathLike[str], name: str, columns: Sequence[str]) -> InputError:
    message = f" has no column {name!r}; its columns are {', '.join(repr(column) for column in columns)}."
    remedy = "Name the columns t, x0, ..., xd0, ..., xdd0, ..., separated by commas."
    return _bad(path, message, remedy, column=name, seen=tuple(columns))
