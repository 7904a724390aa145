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
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import read_only
from redundancy_pin.errors import InputError, OutputError, PlanFileError, RedundancyPinError, shortened, shown
from redundancy_pin.io.files import refusing, replacing_file
from redundancy_pin.io.reading import is_file, read_json
from redundancy_pin.io.schema import Schema, record_of

Arrays: TypeAlias = dict[str, NDArray[Any]]
"""Arrays by their name in the archive."""

_KINDS = "biufcU"
"""Kinds of numpy arrays that are stored: truth values, integers, floats, complex numbers, text."""

_HEADER = "metadata"
"""Name of the array that holds the JSON text."""

UNPACKED, _RATIO = 1 << 27, 20
"""Bytes that a file may have when it is unpacked, with eight for each element of an array, because readers make doubles
of all: so many, and so many for each byte of the file. Plans have 1.4 to 3."""

_MOST_ARRAYS = 10_000
"""Arrays in a file; plans have some 40."""

_SURROGATES, _LAST_CODE = (0xD800, 0xDFFF), 0x10FFFF
"""Codes that are no characters, and the last one that is."""


class _Header(Schema):
    """The JSON text.

    Attributes:
        format: what the file calls itself.
        format_version: version of the format.
        package_version: version of this package that wrote it.
        record: the record, encoded.
        digest: SHA-256 of everything else: no signature, but no edit by accident or convenience fits it.
    """

    format: Any = None
    format_version: Any = None
    package_version: Any = None
    record: Any = None
    digest: Any = None

    def digest_with(self, arrays: Arrays) -> str:
        """Return the digest of everything else, the same on every machine."""
        digest = hashlib.sha256(json.dumps(self.model_dump(exclude={"digest"}), sort_keys=True).encode())
        for name in sorted(set(arrays) - {_HEADER}):
            array = np.ascontiguousarray(arrays[name], arrays[name].dtype.newbyteorder("<"))
            digest.update(f"{name} {array.dtype.str} {arrays[name].shape}".encode())
            digest.update(array.data)
        return digest.hexdigest()


def encode(value: object, arrays: Arrays, name: str = "") -> Any:
    """Return a record as what JSON knows, and put its arrays into ``arrays``.

    Inside mappings and lists there is plain data: no dataclasses and no enumerations.

    Args:
        value: a dataclass; its fields hold dataclasses, enumerations, tuples of them, arrays and plain data.
        arrays: where the arrays go, by name.
        name: where the value is in the record; it has a bracket inside mappings and lists.

    Raises:
        InputError: another type, or one inside a mapping that is not plain.
    """
    of_record = "[" not in name
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
        row = [encode(each, arrays, part.format(name, i)) for i, each in enumerate(value)]
        return {"$tuple": row}
    if isinstance(value, list):
        return [encode(each, arrays, f"{name}[{i}]") for i, each in enumerate(value)]
    if isinstance(value, Mapping):
        pairs = [(key, encode(each, arrays, f"{name}[{key!r}]")) for key, each in value.items()]
        if all(type(key) is str and not key.startswith("$") for key, _ in pairs):
            return dict(pairs)
        return {"$mapping": [[encode(key, arrays, f"{name}[key]"), each] for key, each in pairs]}
    what = f"n array of {value.dtype}" if isinstance(value, np.ndarray) else f" {type(value).__name__}"
    raise InputError(
        f"{name} is a{what}, which a file cannot hold.",
        remedy="Use truth values, numbers, text, arrays of these, lists, tuples and mappings.",
        name=name,
    )


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
        if kind.startswith("$"):
            raise ValueError(f"unknown mark {shown(kind)}")
    return {key: decode(entry, arrays) for key, entry in value.items()}


_T = TypeVar("_T")

_OTHER_FORMATS = (".csv", ".tsv", ".txt", ".json", ".yaml", ".yml", ".mat", ".xlsx", ".h5", ".hdf5", ".parquet", ".pkl")
"""Suffixes that other programs go by; names that say nothing are as good as ``.npz``."""


def write_archive(path: str | Path, kind: str, version: int, record: object) -> None:
    """Write a dataclass to a file, whole or not at all. The same record gives the same bytes.

    Args:
        path: the file; it gets exactly this name.
        kind: what the file calls itself.
        version: version of the format.
        record: the dataclass; ``encode`` lists the types that it may hold.

    Raises:
        InputError: the record holds something that is not plain data.
        OutputError: the file cannot be written, or its name has the suffix of another format.
    """
    if isinstance(path, (str, Path)) and (suffix := Path(path).suffix.lower()) in _OTHER_FORMATS:
        raise OutputError(
            f"{path} is to be a {suffix} file by its name, and save writes npz archives.",
            remedy=f"Save {Path(path).with_suffix('.npz').name}; plan.table() has to_csv, to_json, to_mat and to_ros.",
            path=str(path),
        )
    arrays: Arrays = {}
    encoded = encode(record, arrays)
    header = _Header(format=kind, format_version=version, package_version=_package_version(), record=encoded)
    text = json.dumps({**header.model_dump(), "digest": header.digest_with(arrays)}, allow_nan=False)
    try:
        read_json(text)
    except ValueError as error:
        raise InputError(
            f"The record is more than a file may hold: {error}.", remedy="Keep numbers in few arrays, not in lists."
        ) from error
    members = {_HEADER: np.array(text), **arrays}
    # what packs well, such as millions of zeros, looks like a bomb to the reader
    save = np.savez if _size_as_doubles(members) > UNPACKED else np.savez_compressed
    with replacing_file(path) as temporary, refusing(path), temporary.open("wb") as stream:
        save(stream, allow_pickle=False, **members)


def read_archive(path: str | Path, kind: str, version: int, word: str, make: Callable[[Mapping[str, Any]], _T]) -> _T:
    """Read what ``write_archive`` wrote. Nothing in the file is executed; its arrays are read-only.

    Args:
        path: the file.
        kind: the kind of record that the file must name.
        version: the version of the format that the caller understands.
        word: the kind of record in messages: "plan".
        make: makes the returned object from the record, whose dataclasses are mappings of their fields; raises
            ``InputError``, or errors of Python, if the record does not fit.

    Raises:
        PlanFileError: missing, unreadable, truncated or damaged, another kind of file, another version of the format,
            a record that ``make`` refuses, or a file that was changed since it was written.
    """
    if not isinstance(path, (str, Path)):
        raise PlanFileError(f"A file is named by text or a path, not by {shown(path)}.", remedy="Pass its path.")
    place = Path(os.path.expanduser(path))

    def damaged(what: str) -> PlanFileError:
        return PlanFileError(
            f"{place} is damaged: {what}.", remedy=f"Save the {word} again, or restore the file.", path=str(place)
        )

    arrays = _read_arrays(place, word, damaged)
    try:
        header = record_of(_Header, read_json(str(arrays[_HEADER])))
    except ValueError as error:
        raise damaged(f"its metadata cannot be read ({shortened(str(error))})") from error
    if header.format != kind:
        raise _foreign(place, word, f"is a {shown(header.format)}, not a {kind!r}")
    written = header.format_version
    if type(written) is not int or written < 1:
        raise damaged(f"its format version is {shown(written)}")
    if written != version:
        writer = shortened(str(header.package_version))
        raise PlanFileError(
            f"{place} has format version {written}, written by redundancy_pin {writer}; this "
            f"one, {_package_version()}, reads version {version}.",
            remedy="Install a newer redundancy_pin." if written > version else f"Compute the {word} again.",
            path=str(place),
            found=written,
            readable=version,
        )
    try:
        record = decode(header.record, arrays)
        if not isinstance(record, dict):
            raise TypeError("its metadata hold no record")
        made = make(record)
    except RedundancyPinError as error:
        raise damaged(error.message.removesuffix(".")) from error
    except KeyError as error:
        raise damaged(f"{shown(error.args[0])} is missing") from error
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError) as error:
        reason = shortened(" ".join(str(error).split()))
        raise damaged(f"it does not hold a {word}'s fields ({reason})") from error
    # last: what does not fit together at all is named by what it is
    if header.digest != header.digest_with(arrays):
        raise damaged(f"it was changed after the {word} was saved, for its digest is another one")
    return made


def _read_arrays(path: Path, word: str, damaged: Callable[[str], PlanFileError]) -> Arrays:
    """Return the arrays of a file, read-only, unpacked only if their sizes are sound."""
    if not is_file(path):
        what = "is a folder" if os.path.isdir(path) else "is a pipe or a device" if os.path.exists(path) else ""
        raise _foreign(path, word, what or "does not exist")
    size = path.stat().st_size
    try:
        with path.open("rb") as stream:
            if stream.read(4) != b"PK\x03\x04":
                raise _foreign(path, word, f"is not an npz archive ({size} bytes)")
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            unpacked, largest = sum(member.file_size for member in members), UNPACKED + _RATIO * size
        if len(members) > _MOST_ARRAYS:
            raise ValueError(f"{len(members)} arrays, of at most {_MOST_ARRAYS}")
        if unpacked > largest:
            raise ValueError(f"{unpacked} bytes when unpacked, of at most {largest}")
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: _sound(name, file[name]) for name in file.files}
        if _size_as_doubles(arrays) > largest:
            raise ValueError(f"{_size_as_doubles(arrays)} bytes as doubles, of at most {largest}")
    except PlanFileError:
        raise
    except Exception as error:  # untrusted bytes: zip, zlib and numpy raise a dozen kinds
        reason = shortened(" ".join(str(error).split()) or type(error).__name__)
        raise damaged(f"its {size} bytes are no complete archive of arrays ({reason})") from error
    if _HEADER not in arrays:
        names = ", ".join(shown(name)[1:-1] for name in list(arrays)[:5]) or "nothing"
        raise _foreign(path, word, f"is an npz archive without metadata (it holds {names})")
    return arrays


def _size_as_doubles(arrays: Arrays) -> int:
    return sum(max(array.nbytes, 8 * array.size) for array in arrays.values())


def _sound(name: str, array: Any) -> NDArray[Any]:
    """Return an array of numbers or text in the byte order of the machine, read-only."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in _KINDS or not array.dtype.itemsize:
        raise ValueError(f"{shown(name)} is {getattr(array, 'dtype', 'no array')}, not an array of numbers or text")
    if array.dtype.kind == "U":
        codes = np.ascontiguousarray(array).view(np.dtype(np.uint32).newbyteorder(array.dtype.byteorder))
        if ((codes > _LAST_CODE) | ((codes >= _SURROGATES[0]) & (codes <= _SURROGATES[1]))).any():
            raise ValueError(f"{shown(name)} holds codes that are no characters")
    return read_only(array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("=")))


def _foreign(path: Path, word: str, what: str) -> PlanFileError:
    """Return the error for a file of another kind."""
    return PlanFileError(f"{path} {what}.", remedy=f"Give a file that a {word} was saved to.", path=str(path))


def _package_version() -> str:
    try:
        return metadata.version("redundancy_pin")
    except metadata.PackageNotFoundError:  # a source tree that is not installed
        return "unknown"
