"""One axis of a feasibility map: a parameter by name, and its values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from redundancy_pin.errors import InputError

Scale = Literal["linear", "log"]

_DIGITS = 12
"""Significant digits of a value: the same value of two grids is then the same number, and is computed once."""


@dataclass(frozen=True)
class Axis:
    """A parameter and the values it takes.

    Attributes:
        name: a key of the trajectory, a limit (``limits.LIMITS``), or an argument of the robot.
        values: increasing, SI units.
        scale: how the picture spaces them, and how the border is bisected.

    Raises:
        InputError: fewer than two values, values that are not finite or do not increase, or a logarithmic scale with
            values that are not positive.
    """

    name: str
    values: tuple[float, ...]
    scale: Scale = "linear"

    def __post_init__(self) -> None:
        try:
            values = tuple(rounded(value) for value in self.values)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"The values of {self.name} are {self.values!r}, not numbers.", remedy="Pass numbers, SI units."
            ) from error
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "name", self.name.strip().replace("-", "_"))
        if len(values) < 2 or not all(math.isfinite(value) for value in values):
            raise InputError(f"{self.name} has the values {values}.", remedy="Pass at least two finite values.")
        if any(b <= a for a, b in pairwise(values)):
            raise InputError(
                f"The values of {self.name} do not increase: {values}.", remedy="Sort them, without doubles."
            )
        if self.scale not in ("linear", "log"):
            raise InputError(f"The scale of {self.name} is {self.scale!r}.", remedy="Use linear or log.")
        if self.scale == "log" and values[0] <= 0.0:
            raise InputError(f"{self.name} = {values[0]:g} has no logarithm.", remedy="Use positive values, or linear.")

    def middle(self, low: float, high: float) -> float:
        """Return the value half way between two, on the scale of the axis."""
        return rounded(math.sqrt(low * high) if self.scale == "log" else 0.5 * (low + high))

    def edges(self, values: Sequence[float]) -> list[float]:
        """Return the len(values) + 1 edges of tiles around values of this axis.

        Tiles meet half way; the outermost reach as far beyond the grid as its first and last step go half way inside,
        but not across zero: a stroke or a speed has no values there.
        """
        first, last = self._beyond(self.values[0], self.values[1]), self._beyond(self.values[-1], self.values[-2])
        between = [self.middle(a, b) for a, b in pairwise(values)]
        return [first, *between, last]

    def _beyond(self, end: float, neighbour: float) -> float:
        if self.scale == "log":
            return end * math.sqrt(end / neighbour)
        beyond = end + 0.5 * (end - neighbour)
        return beyond if beyond * end > 0.0 else 0.0


def spaced(name: str, low: float, high: float, count: int, scale: Scale = "linear") -> Axis:
    """Return an axis of evenly spaced values.

    Args:
        name: the parameter.
        low: first value.
        high: last value.
        count: number of values.
        scale: evenly spaced on which scale.

    Raises:
        InputError: as ``Axis``.
    """
    if not (math.isfinite(low) and math.isfinite(high) and low < high and count >= 2):
        raise InputError(
            f"{name} goes from {low:g} to {high:g} in {count} values.",
            remedy="The first must be below the last, and there must be at least two.",
        )
    if scale == "log" and low <= 0.0:
        raise InputError(f"{name} = {low:g} has no logarithm.", remedy="Use positive values, or linear.")
    values = np.geomspace(low, high, count) if scale == "log" else np.linspace(low, high, count)
    return Axis(name, tuple(values.tolist()), scale)


def parse_axis(text: str) -> Axis:
    """Return the axis that ``NAME=LOW:HIGH:COUNT``, with ``:log`` at the end or without, or ``NAME=V,V,...`` describes.

    Raises:
        InputError: text of another form, or as ``Axis``.
    """
    name, separator, rest = text.partition("=")
    name = name.strip().replace("-", "_")
    parts = [part.strip() for part in rest.split(":")]
    try:
        if not (separator and name):
            raise ValueError
        if len(parts) == 1:
            return Axis(name, tuple(float(value) for value in rest.split(",")))
        low, high, count, *scale = parts
        if scale not in ([], ["log"], ["linear"]):
            raise ValueError
        return spaced(name, float(low), float(high), int(count), "log" if scale == ["log"] else "linear")
    except InputError:
        raise
    except ValueError as error:
        raise InputError(
            f"{text!r} is no axis.", remedy="Write speed=0.2:2.0:10, stroke=0.05:1:12:log, or radius=0.013,0.025."
        ) from error


def rounded(value: float) -> float:
    """Return a value of an axis with as many digits as tell values apart."""
    return float(f"{float(value):.{_DIGITS}g}")
