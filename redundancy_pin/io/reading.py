"""Reading untrusted files of text and JSON: other kinds of files, and large ones, are refused before they are read."""

from __future__ import annotations

import io
import json
import stat
from pathlib import Path
from typing import Any, TextIO

from redundancy_pin.errors import RedundancyPinError, shortened, shown

LARGEST_TEXT = 1 << 23
"""Characters of JSON; a plan has some five thousand, the manifest of the thesis' reproduction 30,000."""

MOST_LISTS = 200_000
"""Lists and objects: two characters for each take a hundred bytes of memory."""

DEEPEST = 50
"""Levels of lists and objects inside each other."""

_LONGEST_INTEGER = 300
"""Digits: more is beyond any float."""


def is_file(path: Path) -> bool:
    """Return whether a path leads to an ordinary file, no folder, pipe or device; no name whatever makes it fail."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except (OSError, ValueError):  # a name that is too long, or holds a NUL
        return False


def open_text(path: str | Path, error: type[RedundancyPinError], what: str = "", *, largest: int) -> TextIO:
    """Open an ordinary UTF-8 text file for reading, with or without a byte order mark, ends of lines as they stand.

    For files that are read piece by piece; bytes that are not UTF-8 raise UnicodeDecodeError during reading.

    Args:
        path: the file; ``~`` is the user's folder.
        error: type of the error for a file that cannot be opened.
        what: kind of file, before its path in messages: "The problem ".
        largest: most bytes that it may have.

    Raises:
        RedundancyPinError: of the given kind: missing, unreadable, a folder, a pipe or a device, too large.
    """
    try:
        place = Path(path).expanduser()
        status = place.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ValueError("it is a folder" if place.is_dir() else "it is a pipe or a device, not a file")
        if status.st_size > largest:
            message = f"{what}{path} is too large: {status.st_size} bytes, of which at most {largest} are read."
            raise error(message, remedy="Shorten the file, or name another.", path=str(path), size=status.st_size)
        return io.TextIOWrapper(place.open("rb"), "utf-8-sig", newline="")
    except (OSError, ValueError, RuntimeError) as fault:  # a NUL in the name, or ~ of a user there is not
        missing = isinstance(fault, FileNotFoundError)
        reason = "it does not exist" if missing else getattr(fault, "strerror", None) or str(fault)
        message = f"{what}{shortened(str(path))} cannot be read: {reason}."
        raise error(message, remedy="Check the path.", path=str(path)) from fault


def read_text(path: str | Path, error: type[RedundancyPinError], what: str = "", *, largest: int) -> str:
    """Return the content of a UTF-8 text file; arguments and errors as ``open_text``, and no UTF-8, with its line."""
    with open_text(path, error, what, largest=largest) as stream:
        content = stream.buffer.read()
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        line = content.count(b"\n", 0, fault.start) + 1
        raise error(
            f"{what}{path}, line {line}: it is not text in UTF-8 ({content[fault.start]:#04x}: {fault.reason}).",
            remedy="Save the file as UTF-8.",
            path=str(path),
            line=line,
        ) from fault


def read_json(text: str, *, constants: bool = False) -> Any:
    """Return what JSON text holds.

    Args:
        text: the text.
        constants: whether NaN and infinity, which Python writes and JSON does not know, are allowed.

    Raises:
        ValueError: it is too long, has too many lists, is nested too deep or is not JSON; a key twice in one object;
            NaN, infinity, endless integers, or halves of characters.
    """
    if len(text) > LARGEST_TEXT:
        raise ValueError(f"{len(text)} characters, of which at most {LARGEST_TEXT} are read")
    if text.count("[") + text.count("{") > MOST_LISTS:
        raise ValueError(f"more than {MOST_LISTS} lists and objects")
    constant = float if constants else _refuse_constant
    try:
        value = json.loads(text, object_pairs_hook=_object, parse_int=_integer, parse_constant=constant)
    except RecursionError:
        raise ValueError(f"nested more than {DEEPEST} deep") from None
    _require_sound(value)
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in pairs:
        if name in values:
            raise ValueError(f"the key {shown(name)} twice in one object")
        values[name] = value
    return values


def _integer(digits: str) -> int:
    if len(digits) > _LONGEST_INTEGER:
        raise ValueError(f"an integer of {len(digits)} digits")
    return int(digits)


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name}, which is not JSON")


def _require_sound(value: Any) -> None:
    """Check depth and text level by level, without recursion."""
    level, depth = [value], 0
    while level:
        if depth > DEEPEST:
            raise ValueError(f"nested more than {DEEPEST} deep")
        inner: list[Any] = []
        for part in level:
            if isinstance(part, str):
                part.encode()  # UnicodeEncodeError is a ValueError
            elif isinstance(part, (list, dict)):
                inner += part
                inner += part.values() if isinstance(part, dict) else ()
        level, depth = inner, depth + 1
