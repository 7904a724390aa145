"""Nested plain data as JSON and a list of arrays, and back, without loss.

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

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import read_only
from redundancy_pin.errors import InputError

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
        return _encode_plain(value.value, name, arrays)
    if isinstance(value, np.ndarray):
        return _store(value, name, name, arrays)
    if isinstance(value, tuple):
        return {"$tuple": [_encode_record(entry, f"{name}.{i}", arrays) for i, entry in enumerate(value)]}
    return _encode_plain(value, name, arrays)


def _encode_plain(value: object, name: str, arrays: Arrays) -> Any:
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
        return {"$tuple": [_encode_plain(entry, f"{name}[{i}]", arrays) for i, entry in enumerate(value)]}
    if isinstance(value, list):
        return [_encode_plain(entry, f"{name}[{i}]", arrays) for i, entry in enumerate(value)]
    if isinstance(value, Mapping):
        encoded = [(key, _encode_plain(entry, f"{name}[{key!r}]", arrays)) for key, entry in value.items()]
        if all(type(key) is str and not key.startswith(_MARK) for key, _ in encoded):
            return dict(encoded)
        return {"$mapping": [[_encode_plain(key, f"{name}, key", arrays), entry] for key, entry in encoded]}
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
