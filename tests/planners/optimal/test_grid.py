"""Nodes in time: where they lie between events, on which of them an event is, and which steps are meant."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from redundancy_pin.errors import InputError
from redundancy_pin.planners.optimal.mesh import (
    NEAR_SINGULAR,
    grid_of,
    near_singular,
    steps_around,
    widened,
    with_middles,
)
from redundancy_pin.planners.optimal.problem import RATE_DEGREE, RATE_SPAN, times_beside

START, END = 3.0, 5.0
"""s, of the motions here."""


def source(breaks: Any = (), kinks: Any = ()) -> Any:
    """A motion that is known by its events alone."""
    every = np.unique([START, END, *breaks, *kinks])
    return SimpleNamespace(start=START, end=END, breaks=np.array(breaks, dtype=float), kinks=every)


@pytest.mark.parametrize(
    ("dt", "steps"), [(0.1, 20), (0.1001, 20), (0.0999, 21), (0.7, 3), (1.0, 2), (5.0, 2), (2.0 / 3.0, 3)]
)
def test_steps_are_as_long_as_they_may_be_and_two_at_least(dt: float, steps: int) -> None:
    grid = grid_of(source(), [], dt)
    np.testing.assert_allclose(grid.t, np.linspace(START, END, steps + 1), atol=1e-12)
    np.testing.assert_allclose(grid.h, 2.0 / steps, atol=1e-12)
    assert grid.singular.size == 0
    assert not grid.smooth.any()


def test_each_stretch_between_events_has_steps_of_its_own() -> None:
    """A kink at 3.5, a jump at 4, singular instants at 4.2 and out of the motion."""
    grid = grid_of(source([4.0], [3.5]), [2.9, 4.2, 5.1], 0.2)
    parts = [(3.0, 3.5, 3), (3.5, 4.0, 3), (4.0, 4.2, 2), (4.2, 5.0, 4)]
    expected = np.concatenate([np.linspace(a, b, n + 1)[: None if b == 4.0 else -1] for a, b, n in parts] + [[5.0]])
    np.testing.assert_allclose(grid.t, expected, atol=1e-12)
    assert (grid.h == 0.0).sum() == 1
    np.testing.assert_array_equal(grid.t[grid.singular], [4.2])
    np.testing.assert_array_equal(grid.smooth, np.isin(np.arange(len(grid.t)), grid.singular))


@pytest.mark.parametrize(("beside", "merged"), [(1.9e-9, True), (-1.9e-9, True), (2.1e-9, False), (-2.1e-9, False)])
def test_a_singular_instant_that_rounding_keeps_from_an_event_is_on_it(beside: float, merged: bool) -> None:
    """A thousand millionth of the motion, of 2 s: on both nodes of a jump, and on a kink in its place."""
    jump, kink = grid_of(source([4.0]), [4.0 + beside], 0.6), grid_of(source([], [4.0]), [4.0 + beside], 0.6)
    plain = grid_of(source([4.0]), [], 0.6)
    if merged:
        np.testing.assert_array_equal(jump.t, plain.t)
        np.testing.assert_array_equal(jump.t[jump.singular], [4.0, 4.0])
        assert not jump.smooth.any()  # a step of length zero is on one side of each
        assert len(kink.t) == len(plain.t) - 1
    else:
        assert len(jump.t) == len(plain.t) + 2
        assert len(kink.t) == len(plain.t) + 1
    (at,) = kink.singular
    assert kink.t[at] == 4.0 + beside
    assert kink.smooth[at]


def test_with_short_ends_nodes_are_where_a_harmonic_motion_is_at_equal_times() -> None:
    grid = grid_of(source(), [], 0.2, ends=True)
    np.testing.assert_allclose(grid.t, 4.0 - np.cos(np.linspace(0.0, np.pi, 11)), atol=1e-12)
    split = grid_of(source([], [3.5]), [], 0.2, ends=True)
    assert 3.5 in split.t
    phase = np.arccos(4.0 - split.t)  # of which half a turn takes the 2 s
    first = np.searchsorted(split.t, 3.5)
    for part, length in ((phase[: first + 1], np.pi / 3.0), (phase[first:], 2.0 * np.pi / 3.0)):
        steps = int(np.ceil(length * 2.0 / np.pi / 0.2 - 1e-9))
        np.testing.assert_allclose(np.diff(part), length / steps, atol=1e-7)


def test_too_many_nodes_are_refused_with_their_number() -> None:
    with pytest.raises(InputError, match=r"dt = 1e-05 s makes 2e\+05 nodes") as caught:
        grid_of(source(), [], 1e-5)
    assert caught.value.details["dt"] == 1e-5


def test_middles_halve_marked_steps_and_what_is_singular_stays_so() -> None:
    grid = grid_of(source([4.0]), [4.5], 0.5)  # 3, 3.5, 4, 4, 4.25, 4.5, 4.75, 5
    marked = np.array([True, False, True, False, True, False, False])  # the third is the jump
    finer = with_middles(grid, marked)
    np.testing.assert_allclose(finer.t, [3.0, 3.25, 3.5, 4.0, 4.0, 4.25, 4.375, 4.5, 4.75, 5.0])
    np.testing.assert_array_equal(finer.t[finer.singular], [4.5])
    np.testing.assert_array_equal(finer.t[finer.smooth], [3.25, 4.375, 4.5])
    again = with_middles(finer, np.arange(len(finer.h)) == 0)
    np.testing.assert_array_equal(again.t[again.smooth], [3.125, 3.25, 4.375, 4.5])


@pytest.mark.parametrize(
    ("times", "by", "steps"),
    [
        ([3.3], 0, [1]),
        ([3.3], 1, [0, 1, 2]),
        ([3.25], 0, [1]),
        ([3.1, 4.9], 1, [0, 1, 6, 7]),
        ([3.6], 9, range(8)),
        ([], 2, []),
    ],
)
def test_steps_around_times(times: list[float], by: int, steps: Any) -> None:
    around = steps_around(grid_of(source(), [], 0.25), np.array(times), by)
    np.testing.assert_array_equal(np.flatnonzero(around), list(steps))


def test_steps_are_widened_to_both_sides() -> None:
    steps = np.arange(12) == 5
    for by in range(4):
        np.testing.assert_array_equal(np.flatnonzero(widened(steps, by)), np.arange(5 - by, 6 + by))
    both = np.isin(np.arange(12), [0, 4, 5])
    np.testing.assert_array_equal(np.flatnonzero(widened(both, 1)), [0, 1, 3, 4, 5, 6])


@pytest.mark.parametrize(
    ("t", "side", "begin", "end"),
    [
        (4.5, "right", 4.5 - RATE_SPAN, 4.5 + RATE_SPAN),
        (4.5, "left", 4.5 - RATE_SPAN, 4.5 + RATE_SPAN),
        (4.0, "right", 4.0, 4.0 + RATE_SPAN),
        (4.0, "left", 4.0 - RATE_SPAN, 4.0),
        (4.0 + 0.25 * RATE_SPAN, "left", 4.0, 4.0 + 1.25 * RATE_SPAN),
        (4.0 - 0.25 * RATE_SPAN, "right", 4.0 - 1.25 * RATE_SPAN, 4.0),
        (START, "right", START, START + RATE_SPAN),
        (START, "left", START, START + RATE_SPAN),
        (END, "right", END - RATE_SPAN, END),
        (END, "left", END - RATE_SPAN, END),
    ],
)
def test_a_derivative_is_taken_on_the_smooth_stretch_of_its_side(t: float, side: Any, begin: float, end: float) -> None:
    """Its times fill that stretch and no more, so that the polynomial through them is as exact as it can be."""
    edges, times = times_beside(source([4.0]), t, side)
    np.testing.assert_allclose(edges, [begin, end], atol=1e-12)
    assert len(times) == RATE_DEGREE + 1
    assert times.min() >= begin
    assert times.max() <= end
    assert np.ptp(times) > 0.9 * (end - begin)


def reduced(W: Any) -> Any:
    """Rows in other units, as moments have, which the scales take away."""
    n, m = W.shape[1:]
    rows, columns = np.linspace(1.0, 3.0, n), np.linspace(1.0, 0.5, m)
    return SimpleNamespace(W=rows[:, None] * W / columns, row_scale=rows, column_scale=columns)


def test_near_a_singularity_w_is_a_fifth_as_large_in_one_direction() -> None:
    angle, sizes = np.linspace(0.1, 2.0, 4), NEAR_SINGULAR * np.array([0.99, 1.01, -0.5, 4.0])
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=1).reshape(-1, 2, 2)
    for size in (0.01, 1.0, 100.0):
        W = size * turn @ np.stack([np.diag([1.0, least]) for least in sizes])
        np.testing.assert_array_equal(near_singular(reduced(W)), [True, False, True, False])
    # of a single freedom it is compared with the largest along the motion
    single = np.array([5.0, 0.99, -1.01, 0.0])[:, None, None]
    np.testing.assert_array_equal(near_singular(reduced(single)), [False, True, False, True])
