"""The finder of zeros, touches and dips, on functions whose zeros are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from redundancy_pin.singularities.roots import below_zero, minima, zeros

TIMES = np.linspace(0.0, 2.0, 41)
ROUNDING = 1e-14


@example([1.96875, 1.984375])  # both in the last step
@given(st.lists(st.floats(0.01, 1.99), min_size=1, max_size=4, unique=True).map(sorted))
def test_simple_zeros_are_all_found_however_near(roots: list[float]) -> None:
    if np.diff([0.0, *roots]).min() < 2e-4:  # closer pairs leave a dip that is zero within the tolerance
        return
    if any(sum(lo <= r <= lo + 0.1 for r in roots) > 2 for lo in TIMES):  # at most one dip between two samples
        return
    intervals = zeros(lambda t: np.prod([np.sin(t - r) for r in roots], axis=0), TIMES, 1e-13)
    assert [one.t for one in intervals] == pytest.approx(roots, abs=1e-9)
    assert all(one.crosses and one.until == one.t for one in intervals)


@pytest.mark.parametrize("at", [0.4, 0.512345, 1.9999, 0.05])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_touches_of_either_kind(at: float, sign: float) -> None:
    (smooth,) = zeros(lambda t: sign * (t - at) ** 2, TIMES, 1e-12)
    (sharp,) = zeros(lambda t: sign * np.abs(t - at), TIMES, 1e-12)
    (cusp,) = zeros(lambda t: sign * np.sqrt(np.abs(t - at)), TIMES, 1e-6)
    assert smooth.t == pytest.approx(at, abs=1e-6)
    assert sharp.t == pytest.approx(at, abs=ROUNDING)
    assert cusp.t == pytest.approx(at, abs=1e-12)
    assert not smooth.crosses
    assert not sharp.crosses


def test_a_near_miss_is_no_zero_and_a_constant_is_searched_nowhere() -> None:
    calls = []

    def constant(t: np.ndarray) -> np.ndarray:
        calls.append(len(t))
        return np.full(len(t), 0.3)

    assert zeros(constant, TIMES, 1e-9) == []
    assert calls == [len(TIMES)]
    assert zeros(lambda t: (t - 0.77) ** 2 + 1e-6, TIMES, 1e-9) == []


def test_a_stay_has_a_beginning_and_an_end() -> None:
    (stay,) = zeros(lambda t: np.maximum(t - 1.213, 0.0) - np.maximum(0.62 - t, 0.0), TIMES, 1e-9)
    assert (stay.t, stay.until) == pytest.approx((0.62, 1.213), abs=2e-9)
    assert stay.crosses
    (ends,) = zeros(lambda t: np.maximum(1.0 - t, 0.0), TIMES, 1e-9)
    assert (ends.t, ends.until) == (pytest.approx(1.0, abs=2e-9), 2.0)


def test_steps_with_a_value_that_is_not_finite_are_left_alone() -> None:
    def pole(t: np.ndarray) -> np.ndarray:
        return np.where(np.abs(t - 1.0) < 0.06, np.nan, 1.0 / np.where(t == 1.0, 1.0, t - 1.0) + 2.0)

    assert [one.t for one in zeros(pole, TIMES, 1e-12)] == pytest.approx([0.5])


def test_windows_open_and_closed_and_narrower_than_a_step() -> None:
    windows = below_zero(lambda t: np.cos(2.0 * np.pi * t) ** 2 - 1e-6, TIMES)
    half = np.arcsin(1e-3) / (2.0 * np.pi)
    centres = np.array([0.25, 0.75, 1.25, 1.75])
    assert [one.start for one in windows] == pytest.approx(centres - half, abs=1e-12)
    assert [one.end for one in windows] == pytest.approx(centres + half, abs=1e-12)
    (first,) = below_zero(lambda t: t - 0.3, TIMES)
    assert (first.start, first.open_start, first.open_end) == (0.0, True, False)
    assert first.end == pytest.approx(0.3, abs=ROUNDING)


def test_minima_that_cannot_be_low_enough_are_left_out() -> None:
    function = lambda t: np.abs(np.sin(3.0 * t)) + 0.5 * t  # noqa: E731
    assert [t for t, _ in minima(function, TIMES, np.inf)] == pytest.approx([0.0, np.pi / 3.0, 2.0], abs=ROUNDING)
    assert [t for t, _ in minima(function, TIMES, 0.1)] == [0.0]


@pytest.mark.parametrize("at", [0.525, 0.5, 1.275])
def test_a_dip_between_or_on_samples_is_found_once(at: float) -> None:
    ((t, value),) = minima(lambda t: np.abs(t - at), TIMES, 0.01)
    assert (t, value) == pytest.approx((at, 0.0), abs=ROUNDING)
