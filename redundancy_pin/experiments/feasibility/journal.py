"""The journal of a sweep: one line of JSON for every finished cell, so that an interruption loses none of them."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import redundancy_pin
from redundancy_pin.errors import OutputError
from redundancy_pin.experiments.feasibility.cell import Cell, Key, cell_from
from redundancy_pin.experiments.feasibility.problem import digest
from redundancy_pin.files import require_writable, write_text

FORMAT = "redundancy_pin feasibility journal"
VERSION = 1


class Journal:
    """The finished cells of one problem, in memory and in a file."""

    def __init__(self, path: Path, cells: dict[Key, Cell], handle: int) -> None:
        self._path, self._cells, self._handle = path, cells, handle

    @property
    def cells(self) -> Mapping[Key, Cell]:
        """The finished cells."""
        return self._cells

    def add(self, cell: Cell) -> None:
        """Put down a finished cell; when this returns, it survives a crash of the machine.

        Raises:
            OutputError: the disk refuses.
        """
        line = (json.dumps(cell.as_dict(), allow_nan=False) + "\n").encode()
        try:
            # a part of a line would spoil the next one; alone at the end it is dropped when the journal is opened again
            if os.write(self._handle, line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._handle)
        except OSError as error:
            raise OutputError(
                f"Cannot write {self._path}: {error.strerror or error}.",
                remedy="What is in it is safe: make room and run again.",
                path=str(self._path),
            ) from error
        self._cells[cell.key] = cell


@contextmanager
def open_journal(path: str | Path, identity: Mapping[str, Any]) -> Iterator[Journal]:
    """Open the journal of a problem, or begin one.

    A last line that was cut off (the process was killed while it wrote) is dropped, and its cell computed anew.

    Args:
        path: the file.
        identity: what the cells depend on (``MapProblem.identity``, and the robot).

    Yields:
        The journal.

    Raises:
        OutputError: the file cannot be written; is in use by another run; is no journal; is one of another problem or
            version, which is named; or is damaged in the middle.
    """
    place = Path(path).expanduser()
    require_writable(place)
    identity = json.loads(json.dumps({**identity, "package": redundancy_pin.__version__}))
    if not place.exists():
        header = {"format": FORMAT, "version": VERSION, "digest": digest(identity), "problem": identity}
        write_text(place, json.dumps(header) + "\n")
    try:
        handle = os.open(place, os.O_WRONLY | os.O_APPEND)
    except OSError as error:
        raise OutputError(f"Cannot open {place}: {error.strerror}.", remedy="Choose another folder.") from error
    try:
        _lock(place, handle)
        cells, length = _read(place, identity)
        os.ftruncate(handle, length)
        yield Journal(place, cells, handle)
    finally:
        os.close(handle)


def _lock(path: Path, handle: int) -> None:
    """Keep a journal to one run: another would compute the same cells, and cut off lines written while it opens it."""
    try:
        import fcntl
    except ImportError:  # Windows
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise OutputError(
            f"The journal {path} is in use by another run.",
            remedy="Wait for it to end, or choose another folder.",
            path=str(path),
        ) from error
    except OSError:  # a file system without locks
        return


def _read(path: Path, identity: Mapping[str, Any]) -> tuple[dict[Key, Cell], int]:
    """Return the cells of a journal and the length of its whole lines, bytes."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise OutputError(f"Cannot read {path}: {error.strerror}.", remedy="Choose another folder.") from error
    length = raw.rfind(b"\n") + 1
    lines = raw[:length].splitlines()
    _check_header(path, lines[0] if lines else b"", identity)
    cells: dict[Key, Cell] = {}
    for number, line in enumerate(lines[1:], start=2):
        try:
            cell = cell_from(json.loads(line))
        except (ValueError, KeyError, TypeError) as error:
            raise OutputError(
                f"Line {number} of the journal {path} is damaged.",
                remedy="Delete that line (its cell is then computed anew), or choose another folder.",
                path=str(path),
                line=number,
            ) from error
        cells.setdefault(cell.key, cell)
    return cells, length


def _check_header(path: Path, line: bytes, identity: Mapping[str, Any]) -> None:
    try:
        header = json.loads(line)
        known = header["format"] == FORMAT
        version, found, problem = header["version"], header["digest"], header["problem"]
    except (ValueError, KeyError, TypeError):
        known = False
    if not known:
        raise OutputError(
            f"{path} is no journal of a feasibility map.", remedy="Choose another folder.", path=str(path)
        )
    if version != VERSION:
        raise OutputError(
            f"The journal {path} has version {version}, and this package writes version {VERSION}.",
            remedy="Choose another folder, or delete it to compute everything anew.",
            path=str(path),
        )
    if found != digest(identity):
        raise OutputError(
            f"The journal {path} is of another problem: {_difference(problem, identity)}.",
            remedy="Choose another folder, or delete it to compute everything anew.",
            path=str(path),
        )


def _difference(then: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    # the fingerprint of the machine says least, and changes along with others
    for name in sorted({*then, *now}, key=lambda key: (key == "machine", key)):
        if then.get(name) != now.get(name):
            return f"for {name} it has {then.get(name)!r}, now it is {now.get(name)!r}"
    return "its header does not fit itself"
