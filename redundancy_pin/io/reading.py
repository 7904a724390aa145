"""Reading untrusted files: what is no file, too large, or no text is refused before it is read.

And the one reader of JSON: of bounded size and depth, each key once, and nothing that cannot be written again.
"""

from __future__ import annotations

import io
import json
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from redundancy_pin.errors import RedundancyPinError, shortened, shown


def opened(path: str | Path, error: type[RedundancyPinError], what: str = "") -> BinaryIO:
    """Open an ordinary file for reading.

    Args:
        path: the file; ``~`` is the user's folder.
        error: raised where it cannot be opened.
        what: what it is, before its path in messages: "The problem ".

    Raises:
        RedundancyPinError: of the given kind: missing, unreadable, a name no file can have, a folder, or a pipe or
            device, which may never end.
    """
    try:
        place = Path(path).expanduser()
        # before it is opened: opening a pipe waits for its writer, opening a device may do something
        _require_ordinary(os.stat(place).st_mode)
        # and without waiting, for it may have become a pipe since
        handle = os.open(place, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        try:
            _require_ordinary(os.fstat(handle).st_mode)
        except ValueError:
            os.close(handle)
            raise
    except FileNotFoundError as fault:
        raise _unreadable(path, error, what, "it does not exist") from fault
    except OSError as fault:
        raise _unreadable(path, error, what, fault.strerror or str(fault)) from fault
    except (ValueError, RuntimeError) as fault:  # a NUL in the name, or ~ of a user there is not
        raise _unreadable(path, error, what, str(fault)) from fault
    return os.fdopen(handle, "rb")


def open_text(path: str | Path, error: type[RedundancyPinError], what: str = "", *, largest: int) -> TextIO:
    """Open an ordinary UTF-8 text file of at most ``largest`` bytes for reading, ends of lines as they stand.

    For files that are read piece by piece; what is no UTF-8 raises UnicodeDecodeError where it is met.

    Raises:
        RedundancyPinError: as ``opened``, and too large.
    """
    stream = opened(path, error, what)
    size = os.fstat(stream.fileno()).st_size
    if size > largest:
        stream.close()
        raise _too_large(path, error, what, size, largest)
    return io.TextIOWrapper(stream, "utf-8-sig", newline="")


def read_bytes(path: str | Path, error: type[RedundancyPinError], what: str = "", *, largest: int) -> bytes:
    """Return the content of an ordinary file of at most ``largest`` bytes; errors as ``opened``, and too large."""
    with opened(path, error, what) as stream:
        size = os.fstat(stream.fileno()).st_size
        try:
            # files that the kernel makes up have no size: one byte more than is allowed tells
            content = b"" if size > largest else stream.read(largest + 1)
        except OSError as fault:
            raise _unreadable(path, error, what, fault.strerror or str(fault)) from fault
    if max(size, len(content)) > largest:
        raise _too_large(path, error, what, max(size, len(content)), largest)
    return content


def _too_large(
    path: str | Path, error: type[RedundancyPinError], what: str, size: int, largest: int
) -> RedundancyPinError:
    message = f"{what}{path} is too large: {size} bytes, of which at most {largest} are read."
    return error(message, remedy="Shorten the file, or name another.", path=str(path), size=size)


def read_text(path: str | Path, error: type[RedundancyPinError], what: str = "", *, largest: int) -> str:
    """Return the content of a UTF-8 text file, with or without a byte order mark; errors as ``read_bytes``."""
    content = read_bytes(path, error, what, largest=largest)
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


def is_file(path: Path) -> bool:
    """Return whether a path leads to an ordinary file; no name whatever makes it fail."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode)
    except (OSError, ValueError):  # a name that is too long, or holds a NUL
        return False


def _unreadable(path: str | Path, error: type[RedundancyPinError], what: str, reason: str) -> RedundancyPinError:
    return error(f"{what}{shortened(str(path))} cannot be read: {reason}.", remedy="Check the path.", path=str(path))


def _require_ordinary(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise ValueError("it is a folder")
    if not stat.S_ISREG(mode):
        raise ValueError("it is a pipe or a device, not a file")


# --- JSON ----------------------------------------------------------------------------------------------------------

LARGEST_TEXT = 1 << 23
"""Characters; the metadata of a plan have some five thousand, the manifest of the thesis' reproduction 30,000."""

MOST_LISTS = 200_000
"""Lists and objects: two characters for each take a hundred bytes of memory."""

DEEPEST = 50
"""Levels of lists and objects inside each other."""

_LONGEST_INTEGER = 300
"""Digits: more is beyond any float."""


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
            elif isinstance(part, list):
                inner += part
            elif isinstance(part, dict):
                inner += part
                inner += part.values()
        level, depth = inner, depth + 1
