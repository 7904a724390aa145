"""Loads at the edge of what is taken, light and heavy: moments of payloads, domains of numbers, samples of wrenches."""

from __future__ import annotations

import math

import numpy as np
import pytest

from redundancy_pin.errors import InputError
from redundancy_pin.robot.loads import JointForces, Payload, Spring, Wrench

ALLOWED = 1e-9  # of the largest moment: what is taken as rounding


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e8])
@pytest.mark.parametrize(
    ("moments", "off", "right"),
    [
        ((1.0, 2.0, 3.0), 0.0, True),  # a flat body
        ((1.0, 2.0, 3.0 + 0.5 * ALLOWED), 0.0, True),
        ((1.0, 2.0, 3.0 + 1e3 * ALLOWED), 0.0, False),
        ((3.0 + 1e3 * ALLOWED, 2.0, 1.0), 0.0, False),
        ((0.0, 2.0, 2.0), 0.0, True),  # a rod
        ((-1e3 * ALLOWED, 2.0, 2.0), 0.0, False),
        ((2.0, -1e3 * ALLOWED, 2.0), 0.0, False),
        ((1.0, 2.0, 2.5), 0.5 * ALLOWED, True),
        ((1.0, 2.0, 2.5), 1e3 * ALLOWED, False),
        ((1.0, 2.0, 2.5), -1e3 * ALLOWED, False),
        ((0.0, 0.0, 0.0), 0.0, True),  # a point
    ],
)
def test_moments_of_payloads_are_those_of_a_body(
    size: float, moments: tuple[float, float, float], off: float, right: bool
) -> None:
    """Whatever they weigh; ``off`` is what one product of inertia has more than its twin."""
    inertia = size * np.diag(moments)
    inertia[0, 1] += off * size
    if right:
        np.testing.assert_array_equal(Payload("hand", 2.0, inertia=inertia).inertia, inertia)
    else:
        with pytest.raises(InputError, match="which no body has"):
            Payload("hand", 2.0, inertia=inertia)


@pytest.mark.parametrize(
    "name", ["damping", "friction", "stiffness", "rotor_inertia", "friction_speed", "rest", "gear"]
)
def test_numbers_of_joints_have_the_domains_that_are_said(name: str) -> None:
    """Rest and gear have any sign; none of the others is negative, and the speed of friction is not zero either."""
    assert getattr(JointForces("crank", **{name: 2.5}), name) == 2.5
    for value in (0.0, -1e-3, -3.0):
        if name in ("rest", "gear") or (value == 0.0 and name != "friction_speed"):
            assert getattr(JointForces("crank", **{name: value}), name) == value
        else:
            with pytest.raises(InputError, match=f"{name} of 'crank' is"):
                JointForces("crank", **{name: value})


@pytest.mark.parametrize("name", ["stiffness", "damping", "length"])
def test_numbers_of_springs_and_masses_are_not_negative(name: str) -> None:
    assert getattr(Spring("a", "b", **{name: 0.0}), name) == 0.0
    with pytest.raises(InputError, match=f"{name} of the spring is -1e-09"):
        Spring("a", "b", **{name: -1e-9})
    assert Payload("hand", 0.0).mass == 0.0
    with pytest.raises(InputError, match="mass is -1e-09"):
        Payload("hand", -1e-9)


def test_resistance_of_a_joint_is_its_formula_and_its_rate_the_slope() -> None:
    """The formula by hand for a few speeds, 76 % of Coulomb's friction at its speed; the slope by differences."""
    law = JointForces("crank", damping=0.7, friction=3.0, friction_speed=0.25, stiffness=40.0, rest=0.3)
    at = np.array([0.3, 0.8, -0.2, 0.3])
    v = np.array([0.0, 0.25, -0.25, 5.0])
    share = (1.0 - math.exp(-2.0)) / (1.0 + math.exp(-2.0))
    expected = [0.0, 0.175 + 3.0 * share + 20.0, -0.175 - 3.0 * share - 20.0, 3.5 + 3.0]
    np.testing.assert_allclose(law.resistance(at, v), expected, rtol=1e-14, atol=1e-14)
    speeds, step = np.linspace(-2.0, 2.0, 81), 1e-5
    rest = np.zeros_like(speeds)
    slope = (law.resistance(rest, speeds + step) - law.resistance(rest, speeds - step)) / (2.0 * step)
    # step² times a third derivative of 2 · 3 / 0.25³, over six, and rounding of 12 over the step
    np.testing.assert_allclose(law.resistance_rate(speeds), slope, atol=1e-8)


@pytest.mark.parametrize("count", [1, 6, 7])
def test_wrenches_are_of_one_value_of_samples_or_of_a_law(count: int) -> None:
    t, x, xd = np.linspace(0.0, 1.0, count), np.ones((count, 2)), np.full((count, 2), 0.5)
    one = np.arange(6.0)
    np.testing.assert_array_equal(Wrench("hand", one).at(t, x, xd), np.tile(one, (count, 1)))
    rows = np.arange(6.0 * count).reshape(count, 6)
    np.testing.assert_array_equal(Wrench("hand", rows).at(t, x, xd), rows)
    drag = Wrench("hand", lambda t, x, xd: np.column_stack([-2.0 * xd, x, t, t]))
    np.testing.assert_array_equal(drag.at(t, x, xd), np.column_stack([-np.ones((count, 2)), x, t, t]))
    for samples in (count + 1, 2 * count + 1):
        with pytest.raises(InputError, match=f"has {samples} samples, the motion {count}"):
            Wrench("hand", np.zeros((samples, 6))).at(t, x, xd)
    with pytest.raises(InputError):
        Wrench("hand", lambda t, x, xd: np.zeros((len(t), 5))).at(t, x, xd)
