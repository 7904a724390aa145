"""The rule by which a stated number counts as reproduced."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from redundancy_pin.experiments.planned.verdict import Printed, Range, judge

number = st.floats(-1e3, 1e3)


@pytest.mark.parametrize(
    ("text", "low", "high"), [("2.6", 2.55, 2.65), ("0.20", 0.195, 0.205), ("1", 0.5, 1.5), ("3.0", 2.95, 3.05)]
)
def test_digits_say_how_a_number_was_rounded(text: str, low: float, high: float) -> None:
    assert Printed(text).interval == pytest.approx((low, high), abs=1e-12)


def test_an_order_of_magnitude_is_a_factor_of_ten_wide() -> None:
    low, high = Printed("0.01", order=True).interval
    assert high / low == pytest.approx(10.0)
    assert math.sqrt(low * high) == pytest.approx(0.01)


@given(st.lists(number, min_size=1, max_size=6), st.data())
def test_what_lies_in_the_range_is_reproduced(values: list[float], data: st.DataObject) -> None:
    found = Range.of(values)
    inside = data.draw(st.floats(found.low, found.high))
    assert judge([Printed(f"{inside:.4f}")], [found]) == ("reproduced", 0.0)


@given(st.lists(number, min_size=1, max_size=6), st.floats(0.01, 100.0), st.booleans())
def test_what_lies_beyond_differs_by_the_gap(values: list[float], beyond: float, above: bool) -> None:
    found = Range.of(values)
    stated = Printed(f"{found.high + beyond if above else found.low - beyond:.6f}")
    verdict, gap = judge([stated], [found])
    assert verdict == "differs"
    assert gap == pytest.approx(beyond, abs=2e-6)  # six digits are printed


def test_numbers_stated_together_have_to_hold_together() -> None:
    ranges = [Range(0.0, 1.0), Range(0.0, 1.0)]
    assert judge([Printed("0.5"), Printed("0.9")], ranges)[0] == "reproduced"
    assert judge([Printed("0.5"), Printed("2.9")], ranges)[0] == "differs"


def test_what_never_happens_differs() -> None:
    assert judge([Printed("0.65")], [Range.of([math.nan, math.nan])]) == ("differs", math.inf)
    assert Range.of([math.nan, 2.0, 1.0]) == Range(1.0, 2.0)
