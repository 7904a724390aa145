import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trajectory_checks import clear_of, differentiate

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import RestToRest, SpeedProfile

LAWS = {
    "3-4-5": (RestToRest(1.3, 2.0), []),
    "4-5-6-7": (RestToRest(1.3, 2.0, "4-5-6-7"), []),
    "symmetric": (SpeedProfile(1.0, 0.5, 0.4), [0.4, 2.0]),
    "unequal ramps": (SpeedProfile(1.0, 0.5, 0.4, 0.11, 0.6, 0.14), [0.4, 0.4 + 0.75 / 0.5]),
    "overshooting": (SpeedProfile(1.0, 0.5, 0.4, 0.16), [0.4, 0.4 + 0.68 / 0.5]),
    "no cruise": (SpeedProfile(0.2, 0.5, 0.4), [0.4]),
}
every_law = pytest.mark.parametrize(("law", "inner"), LAWS.values(), ids=LAWS.keys())


@every_law
def test_speed_and_acceleration_are_the_derivatives(law, inner):
    step = 1e-3
    t = clear_of([0.0, *inner, law.duration], step)
    point = law.evaluate(t)
    # The law is of degree 7 at most, so the stencil is exact but for rounding, 1e-16 / 1e-3.
    np.testing.assert_allclose(point.pd, differentiate(lambda s: law.evaluate(s).p, t, step), atol=1e-11)
    np.testing.assert_allclose(point.pdd, differentiate(lambda s: law.evaluate(s).pd, t, step), atol=1e-10)


@every_law
def test_starts_and_ends_at_rest_and_never_runs_back(law, inner):
    ends = law.evaluate([0.0, law.duration])
    np.testing.assert_array_equal(ends.p, [0.0, law.length])
    np.testing.assert_allclose(ends.pd, 0.0, atol=1e-14)
    np.testing.assert_allclose(ends.pdd, 0.0, atol=1e-13)
    assert law.evaluate(np.linspace(0.0, law.duration, 2001)).pd.min() >= -1e-14


@every_law
def test_is_continuous_in_acceleration_where_pieces_meet(law, inner):
    for t in inner:
        for before, after in zip(law.evaluate(t - 1e-9), law.evaluate(t + 1e-9), strict=True):
            assert after - before == pytest.approx(0.0, abs=1e-6)  # the largest rate is a jerk of 100 m/s³


@every_law
def test_time_at_inverts_the_law(law, inner):
    for p in np.linspace(0.0, law.length, 23):
        t = law.time_at(p)
        assert float(law.evaluate(t).p) == pytest.approx(p, abs=1e-14)
    assert law.time_at(0.0) == 0.0
    assert law.time_at(law.length) == pytest.approx(law.duration, abs=1e-15)
    with pytest.raises(InputError, match="p = "):
        law.time_at(law.length * 1.01)


@every_law
def test_scaling_multiplies_speed_and_its_square_the_acceleration(law, inner):
    fast = law.scaled(2.5)
    assert type(fast) is type(law)
    assert fast.duration == pytest.approx(law.duration / 2.5, rel=1e-14)
    t = np.linspace(0.0, law.duration, 201)[1:-1]
    slow_point, fast_point = law.evaluate(t), fast.evaluate(t / 2.5)
    np.testing.assert_allclose(fast_point.p, slow_point.p, atol=1e-14)
    np.testing.assert_allclose(fast_point.pd, 2.5 * slow_point.pd, atol=1e-13)
    np.testing.assert_allclose(fast_point.pdd, 2.5**2 * slow_point.pdd, atol=1e-11)


def test_a_scaled_profile_cruises_as_exactly_and_a_side_is_left_or_right():
    law = SpeedProfile(1.0, 0.5, 0.4, 0.11, 0.6, 0.14)
    fast = law.scaled(2.5)
    assert fast.peak_speed == pytest.approx(2.5 * law.peak_speed, rel=1e-15)
    assert fast.cruise_time == pytest.approx(law.cruise_time / 2.5, rel=1e-15)
    middle = fast.evaluate(0.5 * fast.duration)
    assert (float(middle.pd), float(middle.pdd)) == (1.25, 0.0)
    with pytest.raises(InputError, match="side"):
        law.evaluate(0.1, "middle")


def test_ramps_reach_the_speed_at_their_ends():
    law = SpeedProfile(1.0, 0.5, 0.4, 0.11, 0.6, 0.14)
    up, down = law.evaluate(0.4), law.evaluate(law.duration - 0.6)
    for point, place in ((up, 0.11), (down, 0.86)):
        assert float(point.p) == pytest.approx(place, abs=1e-15)
        assert float(point.pd) == pytest.approx(0.5, abs=1e-14)
        assert float(point.pdd) == pytest.approx(0.0, abs=1e-13)
    assert law.duration == pytest.approx(0.4 + 0.75 / 0.5 + 0.6, rel=1e-15)


def test_nothing_accelerates_while_it_cruises():
    law = SpeedProfile(1.0, 0.3, 0.4)
    point = law.evaluate(np.linspace(0.4, law.duration - 0.41, 50))
    np.testing.assert_array_equal(point.pd, 0.3)
    np.testing.assert_array_equal(point.pdd, 0.0)


def test_default_ramp_covers_half_the_distance_of_cruising():
    law = SpeedProfile(1.0, 0.5, 0.4)
    assert law.ramp_length == 0.1
    kappa = np.linspace(0.0, 1.0, 21)
    np.testing.assert_allclose(law.evaluate(0.4 * kappa).pd, 0.5 * (3 * kappa**2 - 2 * kappa**3), atol=1e-15)


def test_ramp_down_mirrors_the_ramp_up():
    law = SpeedProfile(1.0, 0.5, 0.4, 0.11)
    t = np.linspace(0.0, law.duration, 101)
    there, back = law.evaluate(t), law.evaluate(law.duration - t)
    np.testing.assert_allclose(there.p + back.p, 1.0, rtol=1e-14)
    np.testing.assert_allclose(there.pd, back.pd, atol=1e-13)
    np.testing.assert_allclose(there.pdd, -back.pdd, atol=1e-11)


@given(st.floats(0.2, 2.0))
def test_speed_stays_positive_exactly_from_four_tenths(fraction):
    """The sign of the speed of the quintic through the same six conditions, found here from its coefficients."""
    # p/(vT) = λ(10κ³ − 15κ⁴ + 6κ⁵) − 4κ³ + 7κ⁴ − 3κ⁵
    quintic = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6]) * fraction + [0, 0, 0, -4, 7, -3]
    rate = quintic.deriv()(np.linspace(0.0, 1.0, 4001))
    if fraction >= 0.4:
        law = SpeedProfile(10.0, 1.0, 1.0, fraction, end_ramp_length=0.5)
        assert rate.min() > -1e-12
        assert law.peak_speed == pytest.approx(rate.max(), abs=1e-5)
        assert (law.peak_speed > 1.0) == (fraction > 0.6)
    else:
        with pytest.raises(InputError, match="start backwards"):
            SpeedProfile(10.0, 1.0, 1.0, fraction)


def test_ramp_length_out_of_range_names_the_range():
    with pytest.raises(InputError, match=r"ramp_length = 0\.03 m .* Admissible is 0\.04 m .* 2 m .* 0\.06 m") as caught:
        SpeedProfile(2.0, 0.5, 0.2, 0.03)
    assert caught.value.details["least"] == pytest.approx(0.04)
    SpeedProfile(2.0, 0.5, 0.2, 0.4 * 0.5 * 0.2)
    with pytest.raises(InputError, match=r"^end_ramp_length = 0\.03 m"):
        SpeedProfile(2.0, 0.5, 0.2, end_ramp_length=0.03)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SpeedProfile(0.1, 0.5, 0.4), r"0\.1 m long, and reaching 0\.5 m/s takes 0\.1 m, stopping 0\.1 m"),
        (lambda: SpeedProfile(1.0, 0.0, 0.4), r"speed is 0 m/s, expected a positive number"),
        (lambda: SpeedProfile(1.0, 0.5, -0.4), r"ramp_time is -0\.4 s"),
        (lambda: SpeedProfile(np.nan, 0.5, 0.4), "length is nan m"),
        (lambda: SpeedProfile(1.0, 0.5, 0.4, end_ramp_time=0.0), "end_ramp_time is 0 s"),
        (lambda: SpeedProfile(1.0, 0.5, 0.4).scaled(0.0), "factor is 0"),
        (lambda: SpeedProfile(1.0, 0.5, 0.4).evaluate(-0.1), r"t = -0\.1 s is outside \[0, 2\.4\] s"),
        (lambda: RestToRest(1.0, 0.0), "duration is 0 s"),
        (lambda: RestToRest(1.0, 1.0, "5-6-7"), "shape is '5-6-7'"),
        (lambda: RestToRest(1.0, 1.0).evaluate(1.1), r"t = 1\.1 s is outside \[0, 1\] s"),
    ],
)
def test_bad_laws_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, 0.1),
        ({"ramp_length": 0.11}, 0.11),  # as the ramp up
        ({"ramp_length": 0.11, "end_ramp_time": 0.4}, 0.11),
        ({"ramp_length": 0.11, "end_ramp_time": 0.6}, 0.5 * 0.5 * 0.6),  # of its own time
        ({"end_ramp_time": 0.2}, 0.5 * 0.5 * 0.2),
        ({"end_ramp_time": 0.6, "end_ramp_length": 0.17}, 0.17),
    ],
)
def test_the_ramp_down_left_out_is_as_said(given, expected):
    law = SpeedProfile(1.0, 0.5, 0.4, **given)
    assert law.end_ramp_length == pytest.approx(expected, rel=1e-15)
    up, down = law.ramp_length, law.end_ramp_length
    end = given.get("end_ramp_time", 0.4)
    duration = 0.4 + (1.0 - up - down) / 0.5 + end
    assert law.duration == pytest.approx(duration, rel=1e-14)
