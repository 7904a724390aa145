"""Journals: one line of JSON for every finished piece of work, so that an interruption loses none of them."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import redundancy_pin
from redundancy_pin.errors import OutputError
from redundancy_pin.io.files import require_writable, write_text

DIGITS = 16
"""Hexadecimal digits of a digest."""


class Record(Protocol):
    """What a line holds."""

    @property
    def key(self) -> Hashable:
        """What tells it from the others of its journal."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON, without NaN."""


R = TypeVar("R", bound=Record)


@dataclass(frozen=True)
class JournalKind(Generic[R]):
    """One kind of journal.

    Attributes:
        format: what the header calls it.
        version: of its lines.
        of: of what it is a journal, for errors.
        whole: what all its records together answer, for errors.
        record: what one line is, for errors.
        read: the record of plain data; KeyError, TypeError or ValueError where it is none.
    """

    format: str
    version: int
    of: str
    whole: str
    record: str
    read: Callable[[Mapping[str, Any]], R]


class Journal(Generic[R]):
    """The finished records of one piece of work, in memory and in a file."""

    def __init__(self, path: Path, records: dict[Any, R], handle: int) -> None:
        self._path, self._records, self._handle = path, records, handle

    @property
    def records(self) -> Mapping[Any, R]:
        """The finished records, by their keys."""
        return self._records

    def add(self, record: R) -> None:
        """Put down a finished record; when this returns, it survives a crash of the machine.

        Raises:
            OutputError: the disk refuses.
        """
        line = (json.dumps(record.as_dict(), allow_nan=False) + "\n").encode()
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
        self._records[record.key] = record


def digest(identity: Any) -> str:
    """Return a hash of plain data that does not depend on the order of keys."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:DIGITS]


@contextmanager
def open_journal(kind: JournalKind[R], path: str | Path, identity: Mapping[str, Any]) -> Iterator[Journal[R]]:
    """Open a journal, or begin one.

    A last line that was cut off (the process was killed while it wrote) is dropped, and its record computed anew.

    Args:
        kind: what its lines are.
        path: the file.
        identity: everything the records depend on but their keys, in plain data, and what says most to a user first:
            the first entry that differs is named where a journal does not fit. The version of the package is added.

    Yields:
        The journal.

    Raises:
        OutputError: the file cannot be written; is in use by another run; is no journal of this kind; is one of another
            identity or version, which is named; or is damaged in the middle.
    """
    place = Path(path).expanduser()
    require_writable(place)
    identity = json.loads(json.dumps({**identity, "package": redundancy_pin.__version__}))
    if not place.exists():
        header = {"format": kind.format, "version": kind.version, "digest": digest(identity), "problem": identity}
        write_text(place, json.dumps(header) + "\n")
    try:
        handle = os.open(place, os.O_WRONLY | os.O_APPEND)
    except OSError as error:
        raise OutputError(f"Cannot open {place}: {error.strerror}.", remedy="Choose another folder.") from error
    try:
        _lock(place, handle)
        records, length = _read(kind, place, identity)
        os.ftruncate(handle, length)
        yield Journal(place, records, handle)
    finally:
        os.close(handle)


def _lock(path: Path, handle: int) -> None:
    """Keep a journal to one run: another would compute the same, and cut off lines written while it opens it."""
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


def _read(kind: JournalKind[R], path: Path, identity: Mapping[str, Any]) -> tuple[dict[Any, R], int]:
    """Return the records of a journal and the length of its whole lines, bytes."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise OutputError(f"Cannot read {path}: {error.strerror}.", remedy="Choose another folder.") from error
    length = raw.rfind(b"\n") + 1
    lines = raw[:length].splitlines()
    _check_header(kind, path, lines[0] if lines else b"", identity)
    records: dict[Any, R] = {}
    for number, line in enumerate(lines[1:], start=2):
        try:
            record = kind.read(json.loads(line))
        except (ValueError, KeyError, TypeError) as error:
            raise OutputError(
                f"Line {number} of the journal {path} is damaged.",
                remedy=f"Delete that line (its {kind.record} is then computed anew), or choose another folder.",
                path=str(path),
                line=number,
            ) from error
        records.setdefault(record.key, record)
    return records, length


def _check_header(kind: JournalKind[R], path: Path, line: bytes, identity: Mapping[str, Any]) -> None:
    try:
        header = json.loads(line)
        known = header["format"] == kind.format
        version, found, problem = (header.get(name) for name in ("version", "digest", "problem"))
    except (ValueError, KeyError, TypeError, AttributeError):
        known = False
    if not known:
        raise OutputError(f"{path} is no journal of {kind.of}.", remedy="Choose another folder.", path=str(path))
    remedy = "Choose another folder, or delete it to compute everything anew."
    if version != kind.version:
        raise OutputError(
            f"The journal {path} has version {version}, and this package writes version {kind.version}.",
            remedy=remedy,
            path=str(path),
        )
    if found != digest(identity):
        raise OutputError(
            f"The journal {path} is of another {kind.whole}: {_difference(problem, identity)}.",
            remedy=remedy,
            path=str(path),
        )


def _difference(then: Any, now: Mapping[str, Any]) -> str:
    """Return what differs: of what both name first, and within a group its first entry that does."""
    earlier: Mapping[str, Any] = then if isinstance(then, Mapping) else {}
    for name in (*now, *earlier):
        old, new = earlier.get(name), now.get(name)
        if old != new:
            if isinstance(old, Mapping) and isinstance(new, Mapping):
                for key in new:
                    if key in old and old[key] != new[key]:
                        return f"for {name}.{key} it has {old[key]!r}, now it is {new[key]!r}"
            return f"for {name} it has {old!r}, now it is {new!r}"
    return "its header does not fit itself"
