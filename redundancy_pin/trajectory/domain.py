"""Checks of scalar arguments and of the interval a curve is evaluated on."""

from __future__ import annotations

import math
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError

Side: TypeAlias = Literal["left", "right"]
"""Which limit to take where a function jumps: before the jump, or after it."""

ROUNDING = 1e-12
"""Relative distance below which two times or two arc lengths count as the same: a thousand times
what a few dozen additions of doubles lose, and far below any sampling interval."""


def positive(value: float, name: str, unit: str) -> float:
    """Return ``value`` as a float after checking that it is positive and finite.

    Args:
        value: the number.
        name: what to call it in an error.
        unit: its unit; empty for a number without.

    Raises:
        InputError: not a number, zero, negative, NaN or infinite.
    """
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        of = f" of {unit}" if unit else ""
        raise InputError(f"{name} is {value!r}, expected a number{of}.", name=name) from error
    if not (math.isfinite(number) and number > 0.0):
        said = f"{number:g} {unit}".rstrip()
        raise InputError(f"{name} is {said}, expected a positive number.", name=name, value=number)
    return number


def inside(values: ArrayLike, lower: float, upper: float, name: str, unit: str) -> Array:
    """Return ``values`` clipped to [lower, upper] after checking that only rounding is clipped away.

    Args:
        values: times or arc lengths, any shape.
        lower: start of the interval.
        upper: end of the interval.
        name: what to call the values in an error.
        unit: their unit.

    Raises:
        InputError: a value is NaN or lies outside by more than rounding.
    """
    array = np.asarray(values, dtype=np.float64)
    slack = ROUNDING * max(upper - lower, abs(lower), abs(upper))
    outside = ~((array >= lower - slack) & (array <= upper + slack))
    if outside.any():
        value = float(array[outside][0])
        raise InputError(
            f"{name} = {value:.9g} {unit} is outside [{lower:.9g}, {upper:.9g}] {unit}.",
            remedy="Nothing is extrapolated: stay inside the interval.",
            name=name,
            value=value,
            lower=lower,
            upper=upper,
        )
    clipped: Array = np.clip(array, lower, upper)
    return clipped


def require_side(side: str) -> None:
    """Check the name of a one-sided limit.

    Raises:
        InputError: neither "left" nor "right".
    """
    if side not in ("left", "right"):
        raise InputError(f"side is {side!r}, expected 'left' or 'right'.", side=side)
