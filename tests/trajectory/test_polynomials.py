import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BPoly

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import boundary_polynomial, rest_to_rest_345, rest_to_rest_4567

finite = st.floats(-10.0, 10.0)
conditions = st.lists(finite, min_size=0, max_size=5)


def powers_of(law):
    """Return the coefficients of κ⁰, κ¹, ... with κ = (t − t0)/(t1 − t0), of a single value."""
    width = law.end - law.start
    return law.coefficients[::-1, 0, 0] * width ** np.arange(len(law.coefficients))


def test_345_has_the_closed_form_coefficients():
    law = rest_to_rest_345(2.0, 5.0, 0.0, 1.0)
    np.testing.assert_allclose(powers_of(law), [0, 0, 0, 10, -15, 6], atol=1e-14)


def test_4567_has_the_closed_form_coefficients():
    law = rest_to_rest_4567(2.0, 5.0, 0.0, 1.0)
    np.testing.assert_allclose(powers_of(law), [0, 0, 0, 0, 35, -84, 70, -20], atol=1e-13)


def test_rest_to_rest_between_vectors():
    law = rest_to_rest_345(0.0, 2.0, [1.0, -1.0], [3.0, 4.0])
    # κ = 1/4: 10/64 − 15/256 + 6/1024 = 106/1024
    np.testing.assert_allclose(law(0.5), [1 + 2 * 106 / 1024, -1 + 5 * 106 / 1024], rtol=1e-14)


@given(conditions, conditions, st.floats(-5.0, 5.0), st.floats(0.05, 5.0))
def test_boundary_conditions_of_any_number_are_met(start, end, t0, duration):
    if not start and not end:
        return
    t1 = t0 + duration
    law = boundary_polynomial(t0, t1, start, end)
    # A derivative of order d divides coefficients of the size of the largest T^j y_j by T^d.
    size = max([abs(y) * duration**j for values in (start, end) for j, y in enumerate(values)])
    for t, values in ((t0, start), (t1, end)):
        for order, value in enumerate(values):
            assert abs(law([t], order=order)[0, 0] - value) <= 1e-11 * (size / (t1 - t0) ** order + abs(value)) + 1e-300


@given(st.lists(finite, min_size=4, max_size=4), st.lists(finite, min_size=4, max_size=4), st.floats(0.1, 3.0))
def test_eight_conditions_solve_the_8_by_8_system(start, end, duration):
    """Against the linear system of the power basis in κ, built here."""
    law = boundary_polynomial(0.0, duration, start, end)
    powers = np.arange(8)
    rows, right = [], []
    for kappa, values in ((0.0, start), (1.0, end)):
        for order, value in enumerate(values):
            falling = np.prod([powers - i for i in range(order)], axis=0) if order else np.ones(8)
            rows.append(falling * kappa ** np.maximum(powers - order, 0))
            right.append(value * duration**order)
    expected = np.linalg.solve(np.array(rows), np.array(right))
    # The 8 x 8 matrix has a condition number of a few thousand.
    np.testing.assert_allclose(powers_of(law), expected, atol=1e-11 * max(1.0, np.abs(right).max()))


def test_vector_polynomial_agrees_with_scipy_in_every_derivative():
    rng = np.random.default_rng(1)
    start, end = rng.normal(size=(4, 3)), rng.normal(size=(3, 3))
    law = boundary_polynomial(1.0, 1.7, list(start), list(end))
    other = BPoly.from_derivatives([1.0, 1.7], [list(start), list(end)])
    t = np.linspace(1.0, 1.7, 31)
    for order in range(len(law.coefficients)):
        expected = other(t) if order == 0 else other.derivative(order)(t)
        # Each derivative divides by 0.7 s and multiplies by up to six.
        np.testing.assert_allclose(law(t, order=order), expected, rtol=1e-11, atol=1e-12 * 10**order)
    assert np.all(law(t, order=len(law.coefficients)) == 0.0)


def test_shapes_follow_the_time_then_the_value():
    law = boundary_polynomial(0.0, 1.0, [[0.0, 1.0]], [[1.0, 2.0]])
    assert law(0.5).shape == (2,)
    assert law(np.zeros((4, 5))).shape == (4, 5, 2)
    assert boundary_polynomial(0.0, 1.0, [0.0], [1.0])(np.zeros(3)).shape == (3, 1)
    with pytest.raises(ValueError, match="read-only"):
        law.coefficients[0] = 1.0


def test_ends_keep_their_digits_in_a_short_interval_late_in_time():
    """A power basis in t itself is useless here: the interval is 1e-6 of its own start."""
    law = boundary_polynomial(1000.0, 1000.001, [1.0, 2.0, 3.0], [1.5, -2.0, 0.0])
    assert law(1000.0)[0] == 1.0
    assert law(1000.001)[0] == pytest.approx(1.5, rel=1e-15)
    # values of order 1 divided by 1e-3 s
    assert law(1000.001, "left", 1)[0] == pytest.approx(-2.0, abs=1e-10)


@pytest.mark.parametrize(
    ("t0", "t1", "start", "end", "message"),
    [
        (1.0, 1.0, [0.0], [1.0], r"interval \[1, 1\] s is empty"),
        (0.0, float("nan"), [0.0], [1.0], "is empty"),
        (0.0, 1.0, [], [], "No boundary condition"),
        (0.0, 1.0, [0.0, [1.0, 2.0]], [1.0], "different shapes"),
        (0.0, 1.0, [0.0, np.inf], [1.0], r"start\[1\] has 1 value\(s\) that are not finite"),
        (0.0, 1.0, [0.0], ["a"], r"end\[0\] is not an array of numbers"),
    ],
)
def test_bad_conditions_are_refused(t0, t1, start, end, message):
    with pytest.raises(InputError, match=message):
        boundary_polynomial(t0, t1, start, end)


def test_outside_the_interval_are_the_ends():
    law = rest_to_rest_345(0.0, 1.0, 0.0, 1.0)
    assert law([-1.0, 0.5, 2.0])[:, 0].tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize(
    ("t0", "t1", "right"),
    [
        (0.0, 0.0, False),
        (0.0, 1e-300, True),
        (1.0, float(np.nextafter(1.0, 2.0)), True),
        (1.0, float(np.nextafter(1.0, 0.0)), False),
        (-3.0, -2.0, True),
        (-1e308, 1e308, False),  # its duration is no number
        (1.0e308, 1.5e308, True),  # the sum of its ends is none, which does not matter
        (0.0, np.inf, False),
    ],
)
def test_the_interval_of_a_polynomial_has_a_duration(t0, t1, right):
    if right:
        boundary_polynomial(t0, t1, [0.0], [1.0])
    else:
        with pytest.raises(InputError) as caught:
            boundary_polynomial(t0, t1, [0.0], [1.0])
        assert (caught.value.details["t0"], caught.value.details["t1"]) == (t0, t1)
