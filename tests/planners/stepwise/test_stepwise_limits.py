"""The box of one step, against the limits written as in the thesis and against what braking allows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.stepwise.optimiser import AccelerationBox
from redundancy_pin.robot import CarrierLimits

LIMITS = CarrierLimits(lower=-0.8, upper=1.0, speed=1.5, acceleration=7.0, force=np.inf)

ROUNDING = 1e-10
"""m/s²: a position of 1 m is divided by the square of a step of at least 1e-3 s."""


def limits_of(anticipate=False, rest_at=np.inf, **changes):
    one = CarrierLimits(**{**vars(LIMITS), **changes})
    return AccelerationBox(("slider",), (one,), anticipate, rest_at)


def box(limits, s, sd, step=0.005, t=0.1):
    (low,), (high,) = limits.box(t, step, [s], [sd])
    return low, high


states = {
    "s": st.floats(-0.8, 1.0),
    "sd": st.floats(-1.5, 1.5),
    "step": st.floats(1e-3, 0.05),
    "acceleration": st.floats(0.5, 50.0),
}


@given(**states)
def test_without_anticipation_it_is_the_box_of_the_thesis(s, sd, step, acceleration):
    low = max(-0.8, s - 1.5 * step, s + sd * step - acceleration * step**2)
    high = min(1.0, s + 1.5 * step, s + sd * step + acceleration * step**2)
    limits = limits_of(acceleration=acceleration)
    if low > high + 1e-12:
        with pytest.raises(InfeasiblePlanError, match="slider") as caught:
            box(limits, s, sd, step)
        assert caught.value.details["amount"] > 0.0
        assert caught.value.details["time"] == 0.1
        return
    assume(high - low > 1e-12)
    got = box(limits, s, sd, step)
    reached = s + step * (sd + step * np.array(got))
    np.testing.assert_allclose(reached, [low, high], atol=1e-14)
    assert -acceleration <= got[0] <= got[1] <= acceleration


@given(**states, fraction=st.floats(0.0, 1.0))
def test_with_anticipation_every_choice_can_still_stop(s, sd, step, acceleration, fraction):
    room = (1.0 - s) if sd > 0 else (s + 0.8)
    assume(sd * sd / (2.0 * acceleration) <= room)  # it can stop now
    limits = limits_of(anticipate=True, acceleration=acceleration)
    low, high = box(limits, s, sd, step)
    thesis = limits_of(anticipate=False, acceleration=acceleration)
    wide = box(thesis, s, sd, step)
    assert wide[0] - ROUNDING <= low <= high <= wide[1] + ROUNDING
    u = low + fraction * (high - low)
    v = sd + step * u
    x = s + step * v
    distance = v * v / (2.0 * acceleration)
    assert x + distance <= 1.0 + 1e-12 or v <= 0.0
    assert x - distance >= -0.8 - 1e-12 or v >= 0.0
    assert -acceleration <= low
    assert high <= acceleration


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_carrier_that_cannot_stop_is_braked_as_hard_as_it_can(side):
    # 1 m/s needs 0.071 m at 7 m/s²
    limits = limits_of(anticipate=True, lower=-1.0)
    low, high = box(limits, side * 0.95, side * 1.0)
    assert low == pytest.approx(-side * 7.0, abs=ROUNDING)
    assert high == pytest.approx(-side * 7.0, abs=ROUNDING)
    with pytest.raises(InfeasiblePlanError, match="track") as caught:
        box(limits, side * 0.998, side * 1.0)
    # the step ends at 0.998 + 0.005 (1 - 0.035) m
    assert caught.value.details["amount"] == pytest.approx(0.998 + 0.005 * 0.965 - 1.0)


def test_a_carrier_above_its_speed_limit_is_named():
    with pytest.raises(InfeasiblePlanError, match="above its speed limit") as caught:
        box(limits_of(), 0.0, 1.6)
    assert caught.value.details["constraint"] == "speed"
    assert caught.value.details["amount"] == pytest.approx(1.6 - 0.035 - 1.5)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_deadline_leaves_the_speed_that_can_be_braked(side):
    limits = limits_of(rest_at=0.2)
    speeds = np.sort([side * (side * 0.69 + 0.005 * u) for u in box(limits, 0.0, side * 0.69, t=0.1)])
    assert speeds[1] == pytest.approx(0.7)  # 7 m/s² times the 0.1 s that are left
    # too fast for the deadline: as hard as it can
    low, high = box(limits, 0.0, side * 0.9, t=0.1)
    assert low == pytest.approx(-side * 7.0, abs=ROUNDING)
    assert high == pytest.approx(-side * 7.0, abs=ROUNDING)
    # at the deadline nothing is left
    low, high = box(limits, 0.0, side * 0.02, t=0.2)
    assert low == high == pytest.approx(-side * 4.0)


@given(sd=st.floats(-1.5, 1.5), step=st.floats(1e-4, 0.05), acceleration=st.floats(0.5, 50.0))
def test_a_box_that_rounding_empties_is_one_point(sd, step, acceleration):
    # at the deadline a fast carrier can only be braked in full: two equal bounds, rounded differently
    assume(abs(sd) > 1.1 * acceleration * step)
    low, high = box(limits_of(rest_at=0.1, acceleration=acceleration, lower=-9.0, upper=9.0), 0.0, sd, step, t=0.1)
    assert low == pytest.approx(-np.sign(sd) * acceleration, rel=1e-9)
    assert low <= high
    assert abs(low) <= acceleration


def test_no_limits_leave_everything():
    free = AccelerationBox(("slider",), (CarrierLimits(-np.inf, np.inf, np.inf, np.inf, np.inf),), True, np.inf)
    assert box(free, 0.0, 1.0) == (-np.inf, np.inf)
