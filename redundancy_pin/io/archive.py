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

import hashlib
import json
import math
import os
import sys
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias, TypeVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from redundancy_pin.arrays import read_only
from redundancy_pin.errors import InputError, OutputError, PlanFileError, RedundancyPinError, shortened, shown
from redundancy_pin.io.files import refusing, replacing_file
from redundancy_pin.io.reading import opened, read_json

Arrays: TypeAlias = dict[str, NDArray[Any]]
"""Arrays by their name in the archive."""

_MARK = "$"
_KINDS = "biufcU"
"""Kinds of numpy arrays that are stored: truth values, integers, floats, complex numbers, text."""


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
        match kind:
            case "$tuple":
                return tuple(decode(entry, arrays) for entry in content)
            case "$float":
                return float(content)
            case "$array":
                return arrays[content]
            case "$mapping":
                return {decode(key, arrays): decode(entry, arrays) for key, entry in content}
        if kind.startswith(_MARK):
            raise ValueError(f"unknown mark {shown(kind)}")
    return {key: decode(entry, arrays) for key, entry in value.items()}


def encode(value: object, arrays: Arrays, name: str = "", *, of_record: bool = True) -> Any:
    """Return a record as what JSON knows, and put its arrays into ``arrays``.

    Args:
        value: a dataclass; its fields hold dataclasses, enumerations, tuples of them, arrays and plain data.
        arrays: where the arrays go, by name.
        name: where the value is in the record.
        of_record: whether dataclasses and enumerations may be there; inside mappings and lists there is plain data.

    Raises:
        InputError: something that is none of these, or stands inside a mapping and is not plain.
    """
    if of_record and is_dataclass(value) and not isinstance(value, type):
        names = {field.name: f"{name}.{field.name}" if name else field.name for field in fields(value)}
        return {key: encode(getattr(value, key), arrays, full) for key, full in names.items()}
    if of_record and isinstance(value, Enum) and not isinstance(value, (int, str)):
        value = value.value
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or (isinstance(value, (bool, int, str)) and not isinstance(value, Enum)):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"$float": repr(float(value))}
    if isinstance(value, np.ndarray) and value.dtype.kind in _KINDS:
        # keys of mappings are any text: arrays in them are counted, not named after them
        key = name if of_record else f"{name.split('[')[0]}.{len(arrays)}"
        arrays[key] = read_only(np.array(value))
        return {"$array": key}
    if isinstance(value, tuple):
        part = "{}.{}" if of_record else "{}[{}]"
        row = [encode(each, arrays, part.format(name, i), of_record=of_record) for i, each in enumerate(value)]
        return {"$tuple": row}
    if isinstance(value, list):
        return [encode(each, arrays, f"{name}[{i}]", of_record=False) for i, each in enumerate(value)]
    if isinstance(value, Mapping):
        pairs = [(key, encode(each, arrays, f"{name}[{key!r}]", of_record=False)) for key, each in value.items()]
        if all(type(key) is str and not key.startswith(_MARK) for key, _ in pairs):
            return dict(pairs)
        return {"$mapping": [[encode(key, arrays, f"{name}, key", of_record=False), each] for key, each in pairs]}
    what = f"n array of {value.dtype}" if isinstance(value, np.ndarray) else f" {type(value).__name__}"
    raise InputError(
        f"{name} is a{what}, which a file cannot hold.",
        remedy="Use truth values, numbers, text, arrays of these, lists, tuples and mappings.",
        name=name,
    )


_T = TypeVar("_T")

_METADATA = "metadata"
"""Name of the array that holds the JSON text."""

MOST_ARRAYS = 10_000
"""Arrays in a file; a plan has some fifteen, and two for each interval in which its actuators are off."""

UNPACKED, _RATIO = 1 << 27, 20
"""Bytes that a file may have when it is unpacked: so many, and so many for each byte it has. Plans have 1.4 to 3."""

_SURROGATES = 0xD800, 0xDFFF
"""First and last code that is half a character."""

_TAIL = 22 + (1 << 16)
"""Bytes at the end of an archive where its list of members is named."""

_LONGEST_DIRECTORY = 1 << 21
"""Bytes of that list; an array takes some 80 and its name."""

_DIGEST = "digest"
"""Key of the metadata under which the digest of everything else stands."""


def _digest(content: Mapping[str, Any], arrays: Arrays) -> str:
    """Return the SHA-256 of metadata and arrays: not a signature, but no edit by accident or convenience fits it."""
    rest = {key: value for key, value in content.items() if key != _DIGEST}
    digest = hashlib.sha256(json.dumps(rest, sort_keys=True).encode())
    for name in sorted(set(arrays) - {_METADATA}):
        array = arrays[name]
        array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))  # the same on every machine
        digest.update(f"{name} {array.dtype.str} {arrays[name].shape}".encode())
        digest.update(array.data)
    return digest.hexdigest()


def write_archive(path: str | Path, kind: str, version: int, record: object) -> None:
    """Write a dataclass to a file, whole or not at all. The same record gives the same bytes.

    Args:
        path: the file; it gets exactly this name.
        kind: what the file calls itself.
        version: version of the format.
        record: the dataclass; see ``encode`` for what it may hold.

    Raises:
        InputError: the record holds something that is not plain data.
        OutputError: the file cannot be written, or its name says that it is of another format.
    """
    _require_archive_name(path)
    arrays: Arrays = {}
    content = {
        "format": kind,
        "format_version": version,
        "package_version": _package_version(),
        "record": encode(record, arrays),
    }
    text = json.dumps({**content, _DIGEST: _digest(content, arrays)}, allow_nan=False)
    try:
        read_json(text)
        if len(arrays) >= MOST_ARRAYS:
            raise ValueError(f"{len(arrays)} arrays")
    except ValueError as error:
        raise InputError(
            f"The record is more than a file may hold: {error}.", remedy="Keep numbers in few arrays, not in lists."
        ) from error
    members = {_METADATA: np.array(text), **arrays}
    with replacing_file(path) as temporary, refusing(path), temporary.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **members)
        if sum(array.nbytes for array in members.values()) > _most_unpacked(stream.tell()):
            # millions of zeros: the reader would take them for a bomb
            stream.seek(0)
            stream.truncate()
            np.savez(stream, allow_pickle=False, **members)


_OTHER_FORMATS = (".csv", ".tsv", ".txt", ".json", ".yaml", ".yml", ".mat", ".xlsx", ".h5", ".hdf5", ".parquet", ".pkl")
"""Suffixes that other programs go by; names that say nothing are as good as ``.npz``."""


def _require_archive_name(path: str | Path) -> None:
    if isinstance(path, (str, Path)) and (suffix := Path(path).suffix.lower()) in _OTHER_FORMATS:
        raise OutputError(
            f"{path} is to be a {suffix} file by its name, and save writes npz archives.",
            remedy=f"Save {Path(path).with_suffix('.npz').name}; plan.table() has to_csv, to_json, to_mat and to_ros.",
            path=str(path),
        )


def read_archive(path: str | Path, kind: str, version: int, word: str, make: Callable[[Mapping[str, Any]], _T]) -> _T:
    """Read what ``write_archive`` wrote. Nothing in the file is executed; its arrays are read-only.

    Args:
        path: the file.
        kind: what it must call itself.
        version: the version of the format that the caller understands.
        word: what it holds, for messages: "plan".
        make: from the record, dataclasses as mappings of their fields, to what is returned; raises ``InputError``, or
            what Python raises, where it does not fit.

    Raises:
        PlanFileError: missing, unreadable, truncated or damaged, another kind of file, another version of the
            format, or a record
            that ``make`` refuses; or a file that was changed since it was written.
    """
    if not isinstance(path, (str, Path)):
        raise PlanFileError(f"A file is named by text or a path, not by {shown(path)}.", remedy="Pass its path.")
    place = Path(os.path.expanduser(path))
    arrays = _read_arrays(place, word)
    content = _metadata(place, arrays, word)
    _require_format(place, content, kind, version, word)
    try:
        record = decode(content["record"], arrays)
    except (KeyError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {shortened(str(error))}"
        raise _damaged(place, word, f"its metadata cannot be followed ({reason})") from error
    if not isinstance(record, dict):
        raise _damaged(place, word, "its metadata hold no record")
    try:
        made = make(record)
    except RedundancyPinError as error:
        raise _damaged(place, word, error.message.removesuffix(".")) from error
    except KeyError as error:
        raise _damaged(place, word, f"{shown(error.args[0])} is missing") from error
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
        reason = shortened(" ".join(str(error).split()))
        raise _damaged(place, word, f"it does not hold a {word}'s fields ({reason})") from error
    # last: what does not fit together at all is named by what it is
    if content.get(_DIGEST) != _digest(content, arrays):
        raise _damaged(place, word, f"it was changed after the {word} was saved, for its digest is another one")
    return made


def _require_format(path: Path, content: Mapping[str, Any], kind: str, version: int, word: str) -> None:
    if content.get("format") != kind:
        raise _foreign(path, word, f"is a {shown(content.get('format'))}, not a {kind!r}")
    written = content.get("format_version")
    if type(written) is not int or written < 1:
        raise _damaged(path, word, f"its format version is {shown(written)}")
    if written != version:
        writer = shortened(str(content.get("package_version")))
        raise PlanFileError(
            f"{path} has format version {written}, written by redundancy_pin {writer}; this "
            f"one, {_package_version()}, reads version {version}.",
            remedy="Install a newer redundancy_pin." if written > version else f"Compute the {word} again.",
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
    """Return the arrays of a file, unpacked only once all sizes and names in it are known to be sound."""
    if os.path.isdir(path) or not os.path.exists(path):
        raise _foreign(path, word, "is a folder" if os.path.isdir(path) else "does not exist")
    with opened(path, PlanFileError) as stream:
        size = os.fstat(stream.fileno()).st_size
        if stream.read(4) != b"PK\x03\x04":
            raise _foreign(path, word, f"is not an npz archive ({size} bytes)")
        try:
            _require_short_directory(stream, size)
            with zipfile.ZipFile(stream) as archive:
                members = archive.infolist()
                _require_sound(members, size)
                return {member.filename.removesuffix(".npy"): _read_array(archive, member) for member in members}
        except Exception as error:  # untrusted bytes: zip, zlib and numpy raise a dozen kinds
            reason = shortened(" ".join(str(error).split()) or type(error).__name__)
            raise _damaged(path, word, f"its {size} bytes are no complete archive of arrays ({reason})") from error


def _require_short_directory(stream: BinaryIO, size: int) -> None:
    """Check the size of the list of members, which ``zipfile`` reads whole, as ``zipfile`` finds it."""
    stream.seek(max(size - _TAIL, 0))
    tail = stream.read(_TAIL)
    end = tail.rfind(b"PK\x05\x06")
    if end < 0 or len(tail) < end + 22:
        raise ValueError("File is not a zip file")
    if b"PK\x06\x07" in tail[max(end - 20, 0) : end]:
        raise ValueError("an archive of more than 4 GiB")
    listed = int.from_bytes(tail[end + 12 : end + 16], "little")
    if listed > _LONGEST_DIRECTORY:
        raise ValueError(f"{listed} bytes of names of members, of at most {_LONGEST_DIRECTORY}")
    stream.seek(0)


def _require_sound(members: Sequence[zipfile.ZipInfo], size: int) -> None:
    """Check number, names and unpacked sizes of the members of an archive of so many bytes."""
    if len(members) > MOST_ARRAYS:
        raise ValueError(f"{len(members)} arrays, of at most {MOST_ARRAYS}")
    names: set[str] = set()
    for member in members:
        name = member.filename
        if name in names:
            raise ValueError(f"the array {shown(name)} twice")
        if not name.endswith(".npy") or "/" in name or "\\" in name or not name.isprintable():
            raise ValueError(f"a member {shown(name)}, which is no array")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{shown(name)} is packed in another manner than by numpy")
        names.add(name)
    unpacked, largest = sum(member.file_size for member in members), _most_unpacked(size)
    if unpacked > largest:
        raise ValueError(f"{unpacked} bytes when unpacked, of at most {largest}")


def _most_unpacked(size: int) -> int:
    return UNPACKED + _RATIO * size


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Return an array, read-only; its header is believed only where it says what the member holds."""
    with archive.open(member) as stream:
        version = npy.read_magic(stream)
        if version == (1, 0):
            shape, by_columns, dtype = npy.read_array_header_1_0(stream)
        elif version == (2, 0):
            shape, by_columns, dtype = npy.read_array_header_2_0(stream)
        else:
            raise ValueError(f"{shown(member.filename)} has version {version} of numpy's format")
        if dtype.hasobject or dtype.kind not in _KINDS:
            raise ValueError(f"{shown(member.filename)} is an array of {dtype}, not of numbers or text")
        count = math.prod(shape)
        expected = member.file_size - stream.tell()
        if any(length < 0 for length in shape) or not dtype.itemsize or count * dtype.itemsize != expected:
            raise ValueError(f"{shown(member.filename)} says it has shape {shown(shape)}, but has {expected} bytes")
        content = stream.read(expected + 1)  # the byte more makes it check the sum
    if len(content) != expected:
        raise ValueError(f"{shown(member.filename)} ends after {len(content)} of {expected} bytes")
    if dtype.kind == "U":
        codes = np.frombuffer(content, np.dtype(np.uint32).newbyteorder(dtype.byteorder))
        if ((codes > sys.maxunicode) | ((codes >= _SURROGATES[0]) & (codes <= _SURROGATES[1]))).any():
            raise ValueError(f"{shown(member.filename)} holds codes that are no characters")
    array: NDArray[Any] = np.ndarray(shape, dtype, content, order="F" if by_columns else "C")
    return read_only(array if dtype.isnative else array.astype(dtype.newbyteorder("=")))


def _metadata(path: Path, arrays: Arrays, word: str) -> dict[str, Any]:
    if _METADATA not in arrays:
        names = ", ".join(shortened(name, 40) for name in list(arrays)[:5]) or "nothing"
        raise _foreign(path, word, f"is an npz archive without metadata (it holds {names})")
    text = arrays[_METADATA]
    if text.shape or text.dtype.kind != "U":
        raise _damaged(path, word, f"its metadata are {text.dtype} of shape {text.shape}, not text")
    try:
        content = read_json(str(text))
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
