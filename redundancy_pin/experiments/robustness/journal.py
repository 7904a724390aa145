"""The journal of a study: one line of JSON for every finished trial, so that an interruption loses none of them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import redundancy_pin
from redundancy_pin.errors import OutputError
from redundancy_pin.experiments.robustness.trial import Trial, trial_from
from redundancy_pin.files import write_text

FORMAT = "redundancy_pin robustness journal"

Key = tuple[str, str, int]


class Journal:
    """The finished trials of one study, in memory and in a file."""

    def __init__(self, path: Path, trials: dict[Key, Trial], handle: int) -> None:
        self._path, self._handle = path, handle
        self.trials = trials

    def add(self, trial: Trial) -> None:
        """Put down a finished trial; when this returns, it survives a crash.

        Raises:
            OutputError: the disk refuses.
        """
        try:
            os.write(self._handle, (json.dumps(trial.as_dict(), allow_nan=False) + "\n").encode())
            os.fsync(self._handle)
        except OSError as error:
            raise OutputError(
                f"Cannot write {self._path}: {error.strerror or error}.",
                remedy="What is in it is safe: make room and run again.",
            ) from error
        self.trials[trial.key] = trial


@contextmanager
def open_journal(path: str | Path, identity: Mapping[str, Any]) -> Iterator[Journal]:
    """Open the journal of a study, or begin one.

    A last line that was cut off (the process was killed while it wrote) is dropped, and its trial run anew.

    Args:
        path: the file; it and its folder are made if they are missing.
        identity: what the trials depend on, in plain data; the number of draws is not part of it.

    Yields:
        The journal.

    Raises:
        OutputError: the file cannot be read or written, is no journal, one of another study, or damaged in the middle.
    """
    place = Path(path).expanduser()
    header = json.loads(json.dumps({"format": FORMAT, "package": redundancy_pin.__version__, **identity}))
    if not place.exists():
        _make_folder(place.parent)
        write_text(place, json.dumps(header) + "\n")
    trials, length, cut = _read(place, header)
    try:
        handle = os.open(place, os.O_WRONLY | os.O_APPEND)
    except OSError as error:
        raise OutputError(f"Cannot write {place}: {error.strerror}.", remedy="Choose another folder.") from error
    try:
        if cut:
            os.ftruncate(handle, length)
        yield Journal(place, trials, handle)
    finally:
        os.close(handle)


def _read(path: Path, header: Mapping[str, Any]) -> tuple[dict[Key, Trial], int, bool]:
    """Return the trials of a journal, the length of its whole lines, bytes, and whether more follows them."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise OutputError(f"Cannot read {path}: {error.strerror}.", remedy="Choose another folder.") from error
    length = raw.rfind(b"\n") + 1
    lines = raw[:length].splitlines()
    try:
        found = json.loads(lines[0])
        known = found["format"] == FORMAT
    except (ValueError, KeyError, TypeError, IndexError):
        known = False
    if not known:
        raise OutputError(f"{path} is no journal of a robustness study.", remedy="Choose another folder.")
    other = [name for name in sorted({*found, *header}) if found.get(name) != header.get(name)]
    if other:
        name, then, now = _first_difference(other[0], found.get(other[0]), header.get(other[0]))
        raise OutputError(
            f"The journal {path} is of another study: for {name} it has {then!r}, now it is {now!r}.",
            remedy="Choose another folder, or delete it to run everything anew.",
        )
    trials: dict[Key, Trial] = {}
    for number, line in enumerate(lines[1:], start=2):
        try:
            trial = trial_from(json.loads(line))
        except (ValueError, KeyError, TypeError) as error:
            raise OutputError(
                f"Line {number} of the journal {path} is damaged.",
                remedy="Delete that line (its trial is then run anew), or choose another folder.",
            ) from error
        trials.setdefault(trial.key, trial)
    return trials, length, length < len(raw)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"Cannot make the folder {folder}: {error.strerror}.", remedy="Choose another one."
        ) from error


def _first_difference(name: str, then: Any, now: Any) -> tuple[str, Any, Any]:
    """Return the name and both values of what differs; within a group, its first entry that does."""
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        for key in (*then, *now):
            if then.get(key) != now.get(key):
                return f"{name}.{key}", then.get(key), now.get(key)
    return name, then, now
