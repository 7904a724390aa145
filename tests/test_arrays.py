"""Validation at the door and read-only results."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from redundancy_pin.arrays import checked, decimal, fraction, frozen, not_negative, read_only
from redundancy_pin.errors import InputError


def test_frozen_copies_and_locks() -> None:
    source = np.array([1, 2, 3])
    copy = frozen(source)
    source[0] = 9
    assert copy.tolist() == [1.0, 2.0, 3.0]
    assert copy.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        copy[0] = 0.0


def test_read_only_locks_in_place() -> None:
    fresh = np.zeros(3)
    assert read_only(fresh) is fresh
    assert not fresh.flags.writeable


@given(hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2), elements=st.floats(-1e100, 1e100)))
def test_finite_arrays_of_the_right_shape_pass_unchanged(values: np.ndarray) -> None:
    rows, columns = values.shape
    np.testing.assert_array_equal(checked(values, "x", ("N", columns)), values)
    np.testing.assert_array_equal(checked(values.tolist(), "x", (rows, "n")), values)
    with pytest.raises(InputError, match=rf"x has shape \({rows}, {columns}\), expected \(N, {columns + 1}\)"):
        checked(values, "x", ("N", columns + 1))


@pytest.mark.parametrize(
    ("values", "shape", "message"),
    [
        ("down", ("N",), "x is not an array of numbers"),
        ([[1.0], [1.0, 2.0]], ("N", "n"), "x is not an array of numbers"),
        ([1.0, None], ("N",), "x is not an array of numbers: it holds None"),
        ([1.0, -1.1e100], ("N",), r"beyond 1e\+100, the first at index \(1,\): -1.1e\+100"),
        ([1j, 2.0], ("N",), "x is not an array of numbers"),
        (np.array([1j, 2.0]), ("N",), "x is not an array of numbers"),
        (["1", "2"], ("N",), "x is not an array of numbers"),
        (np.ma.masked_array([1.0, 2.0], mask=[False, True]), ("N",), "masked values"),
        (3.0, ("N",), r"shape \(\), expected \(N,\)"),
        ([1.0, 2.0], (3,), r"shape \(2,\), expected \(3,\)"),
        ([[1.0, 2.0]], ("N",), r"shape \(1, 2\), expected \(N,\)"),
    ],
)
def test_bad_arrays_are_refused_by_name(values: object, shape: tuple[int | str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        checked(values, "x", shape)  # type: ignore[arg-type]
    assert caught.value.details["name"] == "x"
    assert caught.value.remedy


@pytest.mark.parametrize("check", [not_negative, fraction])
def test_numbers_out_of_range_are_refused(check: Callable[[Any, str], float]) -> None:
    assert [check(value, "x") for value in (0, 0.5, np.float64(1.0))] == [0.0, 0.5, 1.0]
    for bad in (-1e-300, np.nan, np.inf, "1", True, None, *((1.0 + 1e-15,) if check is fraction else ())):
        with pytest.raises(InputError, match=r"x is .*, expected a number"):
            check(bad, "x")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_counted_and_located(bad: float) -> None:
    values = np.zeros((3, 2))
    values[1, 1] = values[2, 0] = bad
    with pytest.raises(InputError, match=r"2 value\(s\).*index \(1, 1\)") as caught:
        checked(values, "xdd", ("N", 2))
    assert caught.value.details["index"] == (1, 1)


@pytest.mark.parametrize(
    "text", ["1_0", "1e1_0", "\u0663", "\u0661.5", "1\u00a00", "0x1p3", "1d0", "1e", "", " ", "+-1", "1 0", "infinit"]
)
def test_what_is_a_number_to_python_alone_is_none(text: str) -> None:
    with pytest.raises(ValueError, match="no decimal number"):
        decimal(text)


@given(st.floats(allow_nan=False), st.sampled_from(["{!r}", "{:.3e}", "{:+.9f}", " {:G} "]))
def test_numbers_as_programs_write_them_are_taken(value: float, form: str) -> None:
    assert decimal(form.format(value)) == float(form.format(value))
    assert decimal("7.") == 7.0
    assert np.isnan(decimal("NaN"))
