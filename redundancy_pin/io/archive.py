"""Records in one file: arrays in an npz archive, everything else as JSON text inside it. No pickle, no half file.

Nested plain data as JSON and a list of arrays, and back, without loss.

JSON knows neither tuples, nor NaN and infinity, nor keys that are not text, nor arrays. Those become objects with one
key that starts with ``$``:

=============================  ==================================================
tuple                          ``{"$tuple": [...]}``
NaN, inf, -inf                 ``{"$float": "nan"}``
array                          ``{"$array": "diagnostics.2"}``, its name in the archive
mapping, keys not all plain    ``{"$mapping": [[key, value], ...]}``
=============================  ==================================================

Finite floats are written with as many digits as make them come back bit by bit. Numpy scalars become Python's.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import read_only
from redundancy_pin.errors import InputError, OutputError, PlanFileError
from redundancy_pin.io.files import replacing_file

Arrays: TypeAlias = dict[str, NDArray[Any]]
"""Arrays by their name in the archive."""

_MARK = "$"
_KINDS = "biufcU"
"""Kinds of numpy arrays that are stored: truth values, integers, floats, complex numbers, text."""


def encode(record: object, arrays: Arrays) -> Any:
    """Return a record as what JSON knows, and put its arrays into ``arrays``.

    Args:
        record: a dataclass; its fields hold dataclasses, enumerations, tuples of them, arrays and plain data.
        arrays: where the arrays go, by name.

    Raises:
        InputError: something that is none of these, or stands inside a mapping and is not plain.
    """
    return _encode_record(record, "", arrays)


def decode(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Return what ``encode`` was given; dataclasses as mappings of their fields, enumerations as their values.

    Raises:
        KeyError: an array is missing.
        TypeError, ValueError: the data were not written by ``encode``.
    """
    if isinstance(value, list):
        return [decode(entry, arrays) for entry in value]
    if not isinstance(value, dict):
        return value
    if len(value) == 1:
        (kind, content), *_ = value.items()
        if kind.startswith(_MARK):
            return _decode_marked(kind, content, arrays)
    return {key: decode(entry, arrays) for key, entry in value.items()}


def _decode_marked(kind: str, content: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    if kind == "$tuple":
        return tuple(decode(entry, arrays) for entry in content)
    if kind == "$float":
        return float(content)
    if kind == "$array":
        return arrays[content]
    if kind == "$mapping":
        return {decode(key, arrays): decode(entry, arrays) for key, entry in content}
    raise ValueError(f"unknown mark {kind!r}")


def _encode_record(value: object, name: str, arrays: Arrays) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        prefix = f"{name}." if name else ""
        return {
            field.name: _encode_record(getattr(value, field.name), prefix + field.name, arrays)
            for field in fields(value)
        }
    if isinstance(value, Enum) and not isinstance(value, (int, str)):
        return _encode_value(value.value, name, arrays)
    if isinstance(value, np.ndarray):
        return _store(value, name, name, arrays)
    if isinstance(value, tuple):
        return {"$tuple": [_encode_record(entry, f"{name}.{i}", arrays) for i, entry in enumerate(value)]}
    return _encode_value(value, name, arrays)


def _encode_value(value: object, name: str, arrays: Arrays) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or (isinstance(value, (bool, int, str)) and not isinstance(value, Enum)):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"$float": repr(float(value))}
    if isinstance(value, np.ndarray):
        # keys are any text: arrays are counted, not named after them
        root = name.split("[")[0]
        return _store(value, f"{root}.{len(arrays)}", name, arrays)
    if isinstance(value, tuple):
        return {"$tuple": [_encode_value(entry, f"{name}[{i}]", arrays) for i, entry in enumerate(value)]}
    if isinstance(value, list):
        return [_encode_value(entry, f"{name}[{i}]", arrays) for i, entry in enumerate(value)]
    if isinstance(value, Mapping):
        encoded = [(key, _encode_value(entry, f"{name}[{key!r}]", arrays)) for key, entry in value.items()]
        if all(type(key) is str and not key.startswith(_MARK) for key, _ in encoded):
            return dict(encoded)
        return {"$mapping": [[_encode_value(key, f"{name}, key", arrays), entry] for key, entry in encoded]}
    raise InputError(
        f"{name} is a {type(value).__name__}, which a file cannot hold.",
        remedy="Use numbers, text, lists, tuples, mappings and arrays of numbers.",
        name=name,
    )


def _store(array: NDArray[Any], key: str, name: str, arrays: Arrays) -> dict[str, str]:
    if array.dtype.kind not in _KINDS:
        raise InputError(
            f"{name} is an array of {array.dtype}, which a file cannot hold.",
            remedy="Use arrays of numbers, truth values or text.",
            name=name,
        )
    arrays[key] = read_only(np.array(array))
    return {"$array": key}


_T = TypeVar("_T")

_METADATA = "metadata"
"""Name of the array that holds the JSON text."""


def write_archive(path: str | Path, kind: str, version: int, record: object) -> None:
    """Write a dataclass to a file, whole or not at all. The same record gives the same bytes.

    Args:
        path: the file; it gets exactly this name.
        kind: what the file calls itself.
        version: version of the format.
        record: the dataclass; see ``plain.encode`` for what it may hold.

    Raises:
        InputError: the record holds something that is not plain data.
        OutputError: the file cannot be written.
    """
    arrays: Arrays = {}
    content = {
        "format": kind,
        "format_version": version,
        "package_version": _package_version(),
        "record": encode(record, arrays),
    }
    text = json.dumps(content, allow_nan=False)
    with replacing_file(path) as temporary:
        try:
            with temporary.open("wb") as stream:
                np.savez_compressed(stream, allow_pickle=False, **{_METADATA: np.array(text)}, **arrays)
        except OSError as error:
            raise OutputError(
                f"Cannot write {path}: {error.strerror or error}.", remedy="Choose another place.", path=str(path)
            ) from error


def read_archive(path: str | Path, kind: str, version: int, word: str, make: Callable[[Mapping[str, Any]], _T]) -> _T:
    """Read what ``write_archive`` wrote. Nothing in the file is executed; its arrays are read-only.

    Args:
        path: the file.
        kind: what it must call itself.
        version: newest version of the format that the caller understands.
        word: what it holds, for messages: "plan".
        make: from the record, dataclasses as mappings of their fields, to what is returned; raises ``InputError``, or
            what Python raises, where it does not fit.

    Raises:
        PlanFileError: missing, unreadable, truncated or damaged, another kind of file, a newer format, or a record
            that ``make`` refuses.
    """
    if not isinstance(path, (str, Path)):
        raise PlanFileError(f"A file is named by text or a path, not by {path!r}.", remedy="Pass its path.")
    place = Path(path).expanduser()
    arrays = _read_arrays(place, word)
    content = _metadata(place, arrays, word)
    _require_format(place, content, kind, version, word)
    try:
        record = decode(content["record"], arrays)
    except (KeyError, TypeError, ValueError) as error:
        raise _damaged(place, word, f"its metadata cannot be followed ({type(error).__name__}: {error})") from error
    if not isinstance(record, dict):
        raise _damaged(place, word, "its metadata hold no record")
    try:
        return make(record)
    except InputError as error:
        raise _damaged(place, word, error.message.removesuffix(".")) from error
    except KeyError as error:
        raise _damaged(place, word, f"{error.args[0]!r} is missing") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise _damaged(place, word, f"it does not hold a {word}'s fields ({error})") from error


def _require_format(path: Path, content: Mapping[str, Any], kind: str, version: int, word: str) -> None:
    if content.get("format") != kind:
        raise _foreign(path, word, f"is a {content.get('format')!r}, not a {kind!r}")
    written = content.get("format_version")
    if type(written) is not int or written < 1:
        raise _damaged(path, word, f"its format version is {written!r}")
    if written > version:
        raise PlanFileError(
            f"{path} has format version {written}, written by redundancy_pin {content.get('package_version')}; this "
            f"one, {_package_version()}, reads up to version {version}.",
            remedy="Install a newer redundancy_pin.",
            path=str(path),
            found=written,
            readable=version,
        )


def _foreign(path: Path, word: str, what: str) -> PlanFileError:
    """Return the error for a file that never held what is looked for."""
    return PlanFileError(f"{path} {what}.", remedy=f"Give a file that a {word} was saved to.", path=str(path))


def _damaged(path: Path, word: str, what: str) -> PlanFileError:
    """Return the error for a file that was not written by ``write_archive``, or not wholly, or was changed since."""
    return PlanFileError(
        f"{path} is damaged: {what}.", remedy=f"Save the {word} again, or restore the file.", path=str(path)
    )


def _read_arrays(path: Path, word: str) -> Arrays:
    if not path.is_file():
        raise _foreign(path, word, "is a folder" if path.is_dir() else "does not exist")
    try:
        with path.open("rb") as stream:
            if stream.read(4) != b"PK\x03\x04":
                raise _foreign(path, word, f"is not an npz archive ({os.path.getsize(path)} bytes)")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                return {name: read_only(archive[name]) for name in archive.files}
    except PlanFileError:
        raise
    except Exception as error:  # bytes that nobody vouches for: zip, zlib and numpy raise a dozen kinds
        size = os.path.getsize(path) if os.access(path, os.R_OK) else 0
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise _damaged(path, word, f"its {size} bytes are no complete archive of arrays ({reason})") from error


def _metadata(path: Path, arrays: Arrays, word: str) -> dict[str, Any]:
    if _METADATA not in arrays:
        names = ", ".join(list(arrays)[:5]) or "nothing"
        raise _foreign(path, word, f"is an npz archive without metadata (it holds {names})")
    try:
        content = json.loads(str(arrays[_METADATA]))
    except ValueError as error:
        raise _damaged(path, word, f"its metadata are not JSON ({error})") from error
    if not isinstance(content, dict):
        raise _damaged(path, word, "its metadata are no JSON object")
    return content


def _package_version() -> str:
    try:
        return metadata.version("redundancy_pin")
    except metadata.PackageNotFoundError:  # a source tree that is not installed
        return "unknown"
