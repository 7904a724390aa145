"""Motions from a user's CSV file."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Sequence
from pathlib import Path as FilePath

import numpy as np
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion, PlatformMotion

_QUATERNION_TOLERANCE = 1e-6
"""How far the norm of a quaternion may be from one: text with six digits passes; it is then normalised."""


def from_csv(path: str | os.PathLike[str]) -> PlatformMotion:
    """Read a platform motion from a CSV file.

    The first row names the columns: ``t`` (s), ``x0``, ``x1``, ... (m, rad), ``xd0``, ... and ``xdd0``, ...; any order,
    other columns are ignored. For a spatial platform give six rates and seven x: position (m) and unit quaternion
    (x, y, z, w). An instant may occur twice for the acceleration before and after a jump.

    Args:
        path: of the file, UTF-8, comma separated.

    Raises:
        InputError: no such file, not text, a missing column (with the names seen), a cell that is not a finite
            number (with row and column), rows of different lengths, or a motion that is not one.
    """
    table = _read(path)
    x, xd, xdd = (_columns(table, name, path) for name in ("x", "xd", "xdd"))
    if x.shape[1] == 7 and xd.shape[1] == 6:
        x = _poses(x, path)
    else:
        _require_as_many(path, x=x, xd=xd)
    _require_as_many(path, xd=xd, xdd=xdd)
    return PlatformMotion(table["t"], x, xd, xdd)


def carriers_from_csv(path: str | os.PathLike[str]) -> CarrierMotion | None:
    """Read the carrier motion from a CSV file: columns ``s0``, ..., ``sd0``, ..., ``sdd0``, ... (m, s).

    Args:
        path: of the file, as in ``from_csv``.

    Returns:
        The carrier motion, or None where the file has no carrier column.

    Raises:
        InputError: as ``from_csv``.
    """
    table = _read(path)
    if not any(re.fullmatch(r"s(d|dd)?\d+", name) for name in table):
        return None
    s, sd, sdd = (_columns(table, name, path) for name in ("s", "sd", "sdd"))
    _require_as_many(path, s=s, sd=sd)
    _require_as_many(path, sd=sd, sdd=sdd)
    return CarrierMotion(s, sd, sdd)


def _read(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Return the columns of the file by name, with ``t`` among them."""
    try:
        with FilePath(path).open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            # The row number is that of the line in the file, as an editor shows it.
            rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except OSError as error:
        raise InputError(
            f"Cannot read {os.fspath(path)}: {error.strerror or error}.", remedy="Check the path.", path=str(path)
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise _bad(path, f" is not a text file with columns: {error}.") from error
    if len(rows) < 2:
        remedy = "Give a row of column names (t, x0, ..., xd0, ..., xdd0, ...) and at least one row of numbers."
        raise _bad(path, f" has {max(len(rows) - 1, 0)} rows of numbers.", remedy)
    names = [name.strip() for name in rows[0][1]]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise _bad(path, f" has the column {twice[0]!r} more than once.", column=twice[0])
    table = dict(zip(names, _numbers(names, rows[1:], path).T, strict=True))
    if "t" not in table:
        raise _missing(path, "t", names)
    return table


def _numbers(names: Sequence[str], rows: Sequence[tuple[int, list[str]]], path: str | os.PathLike[str]) -> Array:
    for line, row in rows:
        if len(row) != len(names):
            raise _bad(path, f", row {line}: {len(row)} cells under {len(names)} column names.", row=line)
    try:
        values = np.array([row for _, row in rows], dtype=np.float64)
    except ValueError:
        values = np.array([[_number(cell) for cell in row] for _, row in rows])
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        r, c = (int(i) for i in bad[0])
        line, cell = rows[r][0], rows[r][1][c]
        message = f", row {line}, column {names[c]!r}: {cell!r} is not a finite number."
        raise _bad(path, message, "Use a decimal point and no unit.", row=line, column=names[c])
    return values


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _columns(table: dict[str, Array], prefix: str, path: str | os.PathLike[str]) -> Array:
    """Return (N, n) the columns prefix0, prefix1, ...; there must be a first one and no gap."""
    numbers = sorted(int(name[len(prefix) :]) for name in table if re.fullmatch(rf"{prefix}\d+", name))
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


def _poses(x: Array, path: str | os.PathLike[str]) -> Array:
    norms = np.linalg.norm(x[:, 3:], axis=1)
    k = int(np.argmax(np.abs(norms - 1.0)))
    if abs(norms[k] - 1.0) > _QUATERNION_TOLERANCE:
        message = f": the quaternion x3..x6 of sample {k} has norm {norms[k]:.9g}."
        raise _bad(path, message, "Give unit quaternions in the order x, y, z, w.", sample=k)
    pose = np.tile(np.eye(4), (len(x), 1, 1))
    pose[:, :3, :3] = Rotation.from_quat(x[:, 3:]).as_matrix()
    pose[:, :3, 3] = x[:, :3]
    return pose


def _bad(path: str | os.PathLike[str], message: str, remedy: str = "", **details: object) -> InputError:
    return InputError(f"{os.fspath(path)}{message}", remedy=remedy, path=str(path), **details)


def _missing(path: str | os.PathLike[str], name: str, columns: Sequence[str]) -> InputError:
    message = f" has no column {name!r}; its columns are {', '.join(repr(column) for column in columns)}."
    remedy = "Name the columns t, x0, ..., xd0, ..., xdd0, ..., separated by commas."
    return _bad(path, message, remedy, column=name, seen=tuple(columns))
