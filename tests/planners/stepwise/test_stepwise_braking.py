"""The speed from which a carrier can stop, against direct simulation of its braking."""

from __future__ import annotations

import numpy as np
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.planners.stepwise.course import braked_speeds, braking_times
from redundancy_pin.planners.stepwise.optimiser import stoppable_speed

ROUNDING = 1e-12

sizes = st.floats(1e-3, 10.0)
steps = st.floats(1e-5, 0.1)


@given(gap=st.floats(1e-9, 10.0), step=steps, deceleration=sizes)
def test_the_speed_uses_the_gap_up(gap, step, deceleration):
    v = stoppable_speed(gap, step, deceleration)
    assert abs(step * v + v * v / (2.0 * deceleration) - gap) <= ROUNDING * gap


def test_without_limits_or_without_a_gap():
    assert stoppable_speed(1.0, 0.1, np.inf) == 10.0
    assert stoppable_speed(np.inf, 0.1, 5.0) == np.inf
    assert stoppable_speed(0.0, 0.1, 5.0) == 0.0
    assert stoppable_speed(-1e-17, 0.1, 5.0) == 0.0


@examples(40)
@given(gap=st.floats(1e-6, 2.0), deceleration=sizes, lengths=st.lists(steps, min_size=2, max_size=8))
def test_from_that_speed_the_carrier_stops_on_its_track_whatever_the_steps(gap, deceleration, lengths):
    v = stoppable_speed(gap, lengths[0], deceleration)
    s = lengths[0] * v
    for j in range(100_000):
        if v == 0.0:
            break
        h = lengths[(j + 1) % len(lengths)]
        v = max(v - deceleration * h, 0.0)
        s += h * v
        assert s <= gap * (1.0 + 1e-9)


@examples(40)
@given(gap=st.floats(1e-3, 2.0), deceleration=st.floats(0.1, 10.0))
def test_a_little_faster_and_fine_steps_overrun(gap, deceleration):
    h = 1e-4
    v = 1.05 * stoppable_speed(gap, h, deceleration)
    s = h * v
    while v > 0.0:
        v -= deceleration * h
        s += h * max(v, 0.0)
        if s > gap:
            return
    # the set allows for steps of any length; with equal ones it is half a step of travel too careful
    assert s > gap - 0.5 * h * 1.05 * stoppable_speed(gap, h, deceleration)


def test_braking_takes_the_wanted_time_where_there_is_room():
    speed = np.array([1.0, -1.0, 0.0, 1.0])
    room = np.array([10.0, 0.2, 1.0, 0.01])
    times = braking_times(speed, room, np.full(4, 5.0), 0.5)
    np.testing.assert_allclose(times, [0.5, 0.4, 0.0, 0.2])  # as wanted; 2 d / v; at rest; v / a


def test_braked_speeds_fall_to_zero_and_stay():
    got = braked_speeds(np.array([1.0, -2.0, 0.0]), np.array([0.2, 0.4, 0.0]), np.array([0.1, 0.2, 0.3, 0.5]))
    expected = [[0.5, -1.5, 0.0], [0.0, -1.0, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, 0.0]]
    np.testing.assert_allclose(got, expected, atol=1e-15)
