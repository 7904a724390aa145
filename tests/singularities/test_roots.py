"""Where functions of time are below zero, and their minima: dips far narrower than the samples."""

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.singularities.roots import below_zero, minima


@examples(100)
@given(centre=st.floats(0.05, 0.95), width=st.floats(1e-7, 0.02), slope=st.floats(0.1, 10.0))
def test_short_window_is_not_missed(centre, width, slope):
    """A sharp dip, as the smallest singular value makes it: below zero over a width far below the sampling."""

    def function(t):
        return slope * (np.abs(t - centre) - width)

    intervals = below_zero(function, np.linspace(0.0, 1.0, 33))
    assert len(intervals) == 1
    assert intervals[0].start == pytest.approx(centre - width, abs=1e-12)
    assert intervals[0].end == pytest.approx(centre + width, abs=1e-12)
    ((t, value),) = minima(lambda times: np.abs(times - centre), np.linspace(0.0, 1.0, 33), 1e-9)
    assert t == pytest.approx(centre, abs=1e-14)
    assert value < 1e-14


@examples(100)
@given(centre=st.floats(0.1, 0.9), depth=st.floats(1e-9, 1e-3))
def test_shallow_smooth_dip_is_not_missed(centre, depth):
    intervals = below_zero(lambda t: (t - centre) ** 2 - depth, np.linspace(0.0, 1.0, 33))
    assert len(intervals) == 1
    assert intervals[0].end - intervals[0].start == pytest.approx(2.0 * np.sqrt(depth), rel=1e-6)


def test_intervals_at_the_ends_are_open():
    intervals = below_zero(lambda t: 0.25 - np.abs(t - 0.5), np.linspace(0.0, 1.0, 33))
    assert [(i.open_start, i.open_end) for i in intervals] == [(True, False), (False, True)]
    assert intervals[0].end == pytest.approx(0.25, abs=1e-14)
