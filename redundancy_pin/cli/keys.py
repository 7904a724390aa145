"""Keys that a user writes: unknown ones are refused with the nearest known one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

from redundancy_pin.errors import InputError


def require_known(given: Iterable[object], known: Sequence[str], where: str) -> None:
    """Check that every key is known.

    Args:
        given: the keys as written.
        known: the keys there are.
        where: what takes them, for the message: "the circle".

    Raises:
        InputError: an unknown key, with the nearest known one.
    """
    for key in given:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            hint = f"Did you mean {close[0]!r}? " if close else ""
            takes = f"It takes {', '.join(known)}." if known else "It takes none."
            raise InputError(f"{_capital(where)} has no key {str(key)!r}.", remedy=f"{hint}{takes}", key=str(key))


def require_choice(value: object, known: Sequence[str], where: str) -> str:
    """Return a value that must be one of a few words.

    Raises:
        InputError: it is none of them.
    """
    if isinstance(value, str) and value in known:
        return value
    close = difflib.get_close_matches(str(value), known, n=1)
    hint = f"Did you mean {close[0]!r}? " if close else ""
    raise InputError(f"{_capital(where)} is {value!r}.", remedy=f"{hint}Choose one of {', '.join(known)}.", value=value)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
