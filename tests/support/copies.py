"""Arrays inside objects of this package, by path, and what a copy of them is compared by."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np


def arrays_of(value: Any, path: str = "", seen: set[int] | None = None) -> Iterator[tuple[str, np.ndarray, object]]:
    """Yield path, array and owner of every array that can be reached from an object."""
    seen = set() if seen is None else seen
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, (tuple, list)):
        parts = [(f"[{i}]", part) for i, part in enumerate(value)]
    elif isinstance(value, (dict, MappingProxyType)):
        parts = [(f"[{key}]", part) for key, part in value.items()]
    elif type(value).__module__.startswith("redundancy_pin") and hasattr(value, "__dict__"):
        # what is computed when it is needed may stay behind
        cached = [key for key in vars(value) if isinstance(getattr(type(value), key, None), cached_property)]
        parts = [(f".{key}", part) for key, part in vars(value).items() if key not in cached]
    else:
        return
    for name, part in parts:
        if isinstance(part, np.ndarray):
            yield path + name, part, value
        else:
            yield from arrays_of(part, path + name, seen)


def types_of(value: Any, seen: set[int] | None = None) -> set[type]:
    """Return the types of an object and of everything in it."""
    seen = set() if seen is None else seen
    if id(value) in seen:
        return set()
    seen.add(id(value))
    types = {type(value)}
    inside = value if isinstance(value, (tuple, list)) else vars(value).values() if hasattr(value, "__dict__") else ()
    inside = value.values() if isinstance(value, (dict, MappingProxyType)) else inside
    for part in inside:
        if not isinstance(part, type):
            types |= types_of(part, seen)
    return types


def digest(value: Any) -> dict[str, tuple[bytes, bool]]:
    """Return bytes and writeability of each array of an object; other processes call this."""
    return {path: (part.tobytes(), bool(part.flags.writeable)) for path, part, _ in arrays_of(value)}
