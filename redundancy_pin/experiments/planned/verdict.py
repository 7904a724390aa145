"""When a stated number counts as reproduced."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["reproduced", "differs"]

RULE = (
    "A stated number counts as reproduced if one run gives it to half a unit of the last printed digit (numbers stated "
    "together must come from one and the same run): ours, or one in which a parameter that the thesis leaves unstated "
    "(named in the column 'range over') takes another value of its grid; a number given as an order of magnitude, if a "
    "run comes within a factor of √10 of it. Lying inside the range that the runs span is not enough. The ramps of the "
    "grid were chosen so that other stated times are met, so they are no independent evidence. A statement without a "
    "number counts as reproduced if it holds in at least one working mode of the 3-RRR, which the thesis does not "
    "state; the modes are named. Everything else differs, and the reason is given."
)


@dataclass(frozen=True)
class Printed:
    """A number as the thesis prints it.

    Attributes:
        text: the digits, ``"2.6"``: they say how it was rounded.
        order: whether only its order of magnitude is meant.
    """

    text: str
    order: bool = False

    @property
    def value(self) -> float:
        """The number."""
        return float(self.text)

    @property
    def interval(self) -> tuple[float, float]:
        """What the printed digits can stand for: ± half a unit of the last one, or a factor of √10."""
        if self.order:
            return self.value / math.sqrt(10.0), self.value * math.sqrt(10.0)
        decimals = len(self.text.partition(".")[2])
        half = 0.5 * 10.0**-decimals
        return self.value - half, self.value + half

    def __str__(self) -> str:
        return f"~{self.text}" if self.order else self.text


@dataclass(frozen=True)
class Range:
    """Smallest and largest value of a number.

    Attributes:
        low, high: NaN if there is no value.
    """

    low: float
    high: float

    @staticmethod
    def of(values: Sequence[float]) -> Range:
        """Return the range of the values that are numbers."""
        known = [value for value in values if not math.isnan(value)]
        return Range(min(known), max(known)) if known else Range(math.nan, math.nan)

    def gap_to(self, printed: Printed) -> float:
        """Return how far a printed number is beyond the range, 0 inside; infinite if the range is empty."""
        low, high = printed.interval
        if math.isnan(self.low):
            return math.inf
        return max(0.0, low - self.high, self.low - high)


ROUNDING = 1e-12
"""A gap up to this is none: the limits of an interval are themselves rounded."""


def judge(stated: Sequence[Printed], ranges: Sequence[Range]) -> tuple[Verdict, float]:
    """Return the verdict on numbers that are stated together, and the largest gap.

    Args:
        stated: as printed.
        ranges: of ours, in the same order.
    """
    gap = max(found.gap_to(printed) for printed, found in zip(stated, ranges, strict=True))
    return ("reproduced" if gap <= ROUNDING else "differs"), gap
