"""Values of parameters as users write them: each reader makes one kind of them what a planner takes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from redundancy_pin.arrays import frozen
from redundancy_pin.errors import InputError

Reader = Callable[[str, object], Any]
"""From the name of a parameter and the value as written to the value the planner takes."""


def number(name: str, value: object) -> float:
    """Return a number; text with one is accepted (YAML reads ``1e-3`` as text).

    Raises:
        InputError: anything else.
    """
    if not isinstance(value, bool) and isinstance(value, (int, float, str)):
        try:
            return float(value)
        except (ValueError, OverflowError):
            pass
    raise InputError(f"{name} is {value!r}, not a number.", remedy="Write a number, such as 0.5 (SI units).", name=name)


def numbers(name: str, value: object) -> Any:
    """Return a number, or an array of the numbers of nested lists or of text such as ``0.1,-0.1``.

    Raises:
        InputError: anything else.
    """
    if isinstance(value, str) and "," in value:
        value = [part.strip() for part in value.split(",")]
    if not isinstance(value, list):
        return number(name, value)
    rows = [numbers(name, entry) for entry in value]
    if len({np.shape(row) for row in rows}) != 1:
        raise InputError(f"{name} is {value!r}, not a row of numbers.", remedy="Write [0.1, -0.1].", name=name)
    return frozen(rows)


def whole(name: str, value: object) -> int:
    """Return a whole number.

    Raises:
        InputError: anything else.
    """
    found = number(name, value)
    if not math.isfinite(found) or found != int(found):
        raise InputError(f"{name} is {value!r}, not a whole number.", remedy="Write a number such as 4.", name=name)
    return int(found)


def number_or_word(name: str, value: object) -> float | str:
    """Return a number, or the word as it stands (the planner knows which words it takes).

    Raises:
        InputError: neither.
    """
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return number(name, value)


def word(name: str, value: object) -> str:
    """Return a word as it stands.

    Raises:
        InputError: no text.
    """
    if not isinstance(value, str):
        raise InputError(f"{name} is {value!r}, not a word.", remedy="Write text.", name=name)
    return value


def flag(name: str, value: object) -> bool:
    """Return a truth value.

    Raises:
        InputError: neither true nor false.
    """
    if not isinstance(value, bool):
        raise InputError(f"{name} is {value!r}, neither true nor false.", remedy="Write true or false.", name=name)
    return value


def weights(name: str, value: object) -> str | dict[str, float]:
    """Return one word, or the weights of several: from a mapping, or from words such as ``effort`` and ``peak=2``.

    Raises:
        InputError: neither; a weight that is no number; a word twice.
    """
    if isinstance(value, Mapping):
        return {str(key): number(f"the weight of {key}", weight) for key, weight in value.items()}
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, Sequence) or not all(isinstance(entry, str) for entry in value):
        raise InputError(
            f"{name} is {value!r}, neither a word nor weights.", remedy="Write effort, or {effort: 1, peak: 2}."
        )
    if len(value) == 1 and "=" not in value[0]:
        return str(value[0])
    found: dict[str, float] = {}
    for entry in value:
        key, separator, weight = entry.partition("=")
        key = key.strip()
        if key in found:
            raise InputError(f"{name} has {key!r} twice.", remedy="Leave one of them out.", name=name)
        found[key] = number(f"the weight of {key}", weight) if separator else 1.0
    return found
