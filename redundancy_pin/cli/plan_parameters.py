"""Parameters of the planners as users write them: what kind of value each one is."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from redundancy_pin.arrays import frozen
from redundancy_pin.cli.keys import require_known
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


SWITCH_OFF: Mapping[str, Reader] = {
    "threshold": number,
    "measure": word,
    "ramp_down": number,
    "return_time": number_or_word,
    "datum": numbers,
    "dt": number,
    "scheme": word,
}
"""Parameters of ``plan_switch_off``."""

STEPWISE: Mapping[str, Reader] = {
    "lam": number,
    "active": word,
    "start": numbers,
    "datum": numbers,
    "return_time": number_or_word,
    "stop": word,
    "brake_time": number,
    "anticipate": flag,
    "speed": numbers,
    "acceleration": numbers,
    "track": numbers,
    "least_margin": number,
    "between": whole,
}
"""Parameters of ``plan_stepwise``, but for the baseline, which is a robot."""

PARAMETERS: Mapping[str, Mapping[str, Reader]] = {"switch-off": SWITCH_OFF, "stepwise": STEPWISE}


def read_parameters(planner: str, given: Mapping[str, object]) -> dict[str, Any]:
    """Return the parameters of a planner, each as the kind of value it is.

    Args:
        planner: a key of ``PARAMETERS``.
        given: values as written; None for those left out.

    Raises:
        InputError: an unknown parameter, or a value of the wrong kind.
    """
    readers = PARAMETERS[planner]
    require_known(given, tuple(readers), f"the planner {planner}")
    return {name: readers[name](name, value) for name, value in given.items() if value is not None}
