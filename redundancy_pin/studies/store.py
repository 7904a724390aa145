"""The store of a study: an SQLite file of finished records, so that an interruption loses none of them.

SQLite's rollback journal with full synchronisation: a record is on the disk when ``put`` returns, and what a kill or a
power failure leaves half written is rolled back when the file is opened again. No write-ahead log: it keeps committed
records in a second file, which a copy of the first would lack, and shares memory, which network file systems do not.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import redundancy_pin
from redundancy_pin.errors import OutputError, shortened, shown
from redundancy_pin.io.files import expanded, require_writable
from redundancy_pin.io.reading import read_json
from redundancy_pin.workers import ready

FILE = "store.sqlite"
"""Name of the store in the folder of a study."""

_TABLES = ("CREATE TABLE study (kind TEXT, identity TEXT)", "CREATE TABLE record (record TEXT)")
"""What a store consists of."""

Progress = Callable[[int, int, str], None]
"""Called with records done, records in all as far as known, and what is being done."""

_ANEW = "Choose another folder, or delete it to compute everything anew."


class Record(Protocol):
    """What a store holds."""

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells it from the others."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON."""


R = TypeVar("R", bound=Record)


class Store(Generic[R]):
    """The finished records of one study; made by ``Store.open``."""

    def __init__(self, connection: sqlite3.Connection, path: str, records: dict[tuple[Any, ...], R]) -> None:
        self._connection, self._path, self._records = connection, path, records

    @classmethod
    @contextmanager
    def open(
        cls, path: str | Path | None, kind: str, identity: Mapping[str, Any], read: Callable[[Mapping[str, Any]], R]
    ) -> Iterator[Store[R]]:
        """Open a store, or begin one. It belongs to this process until it is closed.

        Args:
            path: the file, made with its folder if it is missing; None keeps the records in memory alone.
            kind: of what it holds the records: "feasibility map".
            identity: everything the records depend on but their keys, in plain data, what says most to a user first:
                the first entry that differs is named where a store does not fit. The package's version is added.
            read: a record of its plain data; KeyError, TypeError or ValueError where it is none.

        Raises:
            OutputError: the file cannot be written; is in use by another run; is no store of this kind; is one of
                another identity, which is named; or is damaged.
        """
        place = ":memory:" if path is None else str(_writable(expanded(path)))
        identity = json.loads(json.dumps({**identity, "package": redundancy_pin.__version__}))
        try:
            # where SQLite was built to read names as addresses, "file:x" is the name of another file
            at = place if path is None else os.path.abspath(place)
            connection = sqlite3.connect(at, timeout=0.0, isolation_level=None)
        except sqlite3.Error as error:
            raise _unusable(place, kind, error) from error
        with closing(connection):
            try:
                # the first lock is kept until the end: a second run would compute the same
                connection.execute("PRAGMA locking_mode = EXCLUSIVE")
                connection.execute("PRAGMA synchronous = FULL")
                connection.execute("BEGIN EXCLUSIVE")
                # a kill before the end of this transaction leaves an empty file
                tables = [sql for (sql,) in connection.execute("SELECT sql FROM sqlite_master").fetchmany(3)]
                if tables and set(tables) != set(_TABLES):  # a view, say, could make records without end
                    raise OutputError(_foreign(place, kind), remedy="Choose another folder.", path=place)
                if not tables:
                    for table in _TABLES:
                        connection.execute(table)
                    connection.execute("INSERT INTO study VALUES (?, ?)", (kind, json.dumps(identity)))
                _require_own(connection, place, kind, identity)
                records = _records(connection, place, read)
                connection.execute("COMMIT")
            except (sqlite3.Error, UnicodeDecodeError) as error:  # SQLite quotes a damaged table's text in its errors
                raise _unusable(place, kind, error) from error
            yield cls(connection, place, records)

    @property
    def records(self) -> Mapping[tuple[Any, ...], R]:
        """The finished records, by key."""
        return self._records

    def put(self, *records: R) -> None:
        """Add finished records; when this returns, they survive a crash of the machine. OutputError if they cannot."""
        texts = [(json.dumps(record.as_dict()),) for record in records]
        try:
            # the disk takes as long for many as for one
            self._connection.execute("BEGIN")
            self._connection.executemany("INSERT INTO record VALUES (?)", texts)
            self._connection.execute("COMMIT")
        except sqlite3.Error as error:
            with suppress(sqlite3.Error):  # of most errors SQLite has done so itself
                self._connection.execute("ROLLBACK")
            remedy = "What is in it is safe: make room and run again."
            raise OutputError(f"Cannot write {self._path}: {error}.", remedy=remedy, path=self._path) from error
        self._records.update((record.key, record) for record in records)

    def complete(
        self,
        function: Callable[..., R],
        wanted: Mapping[tuple[Any, ...], tuple[Any, ...]],
        jobs: int | None,
        progress: Progress | None,
        what: str,
    ) -> None:
        """Compute the records that are missing, and add each as soon as it is finished.

        ``function`` makes a record of its arguments, which ``wanted`` has by key; ``what`` tells ``progress`` what is
        being done. OutputError where the disk refuses, RedundancyPinError where a process died.
        """
        missing = [given for key, given in wanted.items() if key not in self._records]
        done = len(wanted) - len(missing)
        tell = progress or (lambda done, total, what: None)
        tell(done, len(wanted), what)
        for records in ready(function, missing, jobs):
            self.put(*records)
            for _ in records:
                done += 1
                tell(done, len(wanted), what)


def versions(*names: str) -> dict[str, str]:
    """Return the versions of packages, empty for those that are not installed."""
    installed = {}
    for name in names:
        try:
            installed[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            installed[name] = ""
    return installed


def make_folder(folder: str | Path) -> Path:
    """Return a folder, made with its parents if it is missing; OutputError if it cannot be, or is a file."""
    place = expanded(folder)
    try:
        place.mkdir(exist_ok=True, parents=True)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = (error.strerror if isinstance(error, OSError) else "") or str(error)
        message = f"Cannot make the folder {shortened(str(place))}: {reason}."
        raise OutputError(message, remedy="Choose another.", path=str(place)) from error
    return place


def _writable(path: Path) -> Path:
    """Return the path of a store that can be written, its folder made."""
    make_folder(path.parent)
    require_writable(path)
    return path


def _require_own(connection: sqlite3.Connection, path: str, kind: str, now: Mapping[str, Any]) -> None:
    its_kind, text = connection.execute("SELECT kind, identity FROM study").fetchone() or (None, "")
    if its_kind != kind:
        message = f"{path} is no store of a {kind}, but of a {shortened(str(its_kind))}."
        raise OutputError(message, remedy="Choose another folder.", path=path)
    try:
        then = dict(read_json(text, constants=True))
    except (ValueError, TypeError) as error:
        raise OutputError(f"The identity in the store {path} is damaged.", remedy=_ANEW, path=path) from error
    for name in (*now, *then):
        old, new, where = then.get(name), now.get(name), name
        if old == new:
            continue
        if isinstance(old, dict) and isinstance(new, dict):  # of a group, its first entry that differs
            for key in (key for key in new if key in old and old[key] != new[key]):
                old, new, where = old[key], new[key], f"{name}.{key}"
                break
        message = f"The store {path} is of another {kind}: for {where} it has {shown(old)}, now it is {shown(new)}."
        raise OutputError(message, remedy=_ANEW, path=path)


def _records(
    connection: sqlite3.Connection, path: str, read: Callable[[Mapping[str, Any]], R]
) -> dict[tuple[Any, ...], R]:
    records: dict[tuple[Any, ...], R] = {}
    for number, text in connection.execute("SELECT rowid, record FROM record ORDER BY rowid"):
        try:
            record = read(read_json(text, constants=True))
            records[record.key] = record
        except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
            raise OutputError(f"Record {number} of the store {path} is damaged.", remedy=_ANEW, path=path) from error
    return records


def _foreign(path: str, kind: str) -> str:
    return f"{path} is no store of a {kind}."


def _unusable(path: str, kind: str, error: Exception) -> OutputError:
    """Return what an error of SQLite at the opening says to a user; Python 3.10 has no codes of them, but texts."""
    text = str(error)
    if "locked" in text:
        message, remedy = f"The store {path} is in use by another run.", "Wait for it to end, or choose another folder."
    elif "not a database" in text or "no such" in text:
        message, remedy = _foreign(path, kind), "Choose another folder."
    elif isinstance(error, sqlite3.OperationalError):  # such as a file system without locks
        message, remedy = f"Cannot use {path}: {text}.", "Choose another folder, on a disk of this machine."
    else:
        message, remedy = f"The store {path} is damaged: {text}.", _ANEW
    return OutputError(message, remedy=remedy, path=path)
