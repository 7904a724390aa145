"""The one reader of JSON: of bounded size and depth, each key once, and nothing that cannot be written again."""

from __future__ import annotations

import json
from typing import Any

from redundancy_pin.errors import shown

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
