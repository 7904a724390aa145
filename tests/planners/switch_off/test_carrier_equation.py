"""The integration of F s̈ = W τ_ref − f(s, ṡ, 0) on equations whose solutions are known in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

from redundancy_pin.arrays import Array
from redundancy_pin.planners.carrier_model import CarrierModel
from redundancy_pin.planners.switch_off.carrier_equation import CarrierEquation, StepGivenUpError
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

S, S2, SD, SSD, SDD = range(5)
Function = Callable[[Array], Array]


@dataclass
class Written:
    """A carrier model of one coordinate, written down: ``load`` and ``terms`` by (carrier, term), functions of time."""

    k: int
    load: Function
    terms: dict[tuple[int, int], Function]
    breaks: Array
    knots: Array
    tolerance: float = 1e-12

    def at(self, t: Array) -> CarrierModel:
        f_terms, none = np.zeros((len(t), 1, self.k, 5)), np.zeros((len(t), self.k))
        for (carrier, term), function in self.terms.items():
            f_terms[:, 0, carrier, term] = function(t)
        f0 = -self.load(t)[:, None]
        return CarrierModel(t, np.zeros((len(t), 1, 1)), f0, f_terms, none, np.zeros((len(t), self.k, 5)))


def one(t: Array) -> Array:
    return np.ones_like(t)


def zero(t: Array) -> Array:
    return np.zeros_like(t)


def equation(load: Function, *carriers: dict[int, Function], breaks: tuple[float, ...] = ()) -> CarrierEquation:
    """Return the equation Σ terms = load; ``carriers``: the terms of each, by their place."""
    terms = {(carrier, term): function for carrier, of in enumerate(carriers) for term, function in of.items()}
    model = cast(Any, Written(len(carriers), load, terms, np.array(breaks), np.empty(0)))
    effort = PiecewisePolynomial.constant(np.zeros(1), -1e4, 1e4)
    return CarrierEquation(model, effort, np.ones(1), 1.0)


def test_oscillator_and_nonlinear_terms() -> None:
    """s̈ + s = 0 from s = 1 at rest is cos t; s = 1/(1 + t) has ṡ = −s², so s̈ + 2 s ṡ + ṡ + s² = 0."""
    t = np.linspace(0.0, 10.0, 1001)
    motion = carriers_at(equation(zero, {SDD: one, S: one}).solve(0.0, 10.0, np.ones(1), np.zeros(1)), t)
    for part, exact in ((motion.s, np.cos(t)), (motion.sd, -np.sin(t)), (motion.sdd, -np.cos(t))):
        np.testing.assert_allclose(part[:, 0], exact, atol=1e-9, rtol=0)
    nonlinear = equation(zero, {SDD: one, SSD: lambda t: 2.0 * one(t), SD: one, S2: one})
    path = nonlinear.solve(0.0, 10.0, np.ones(1), -np.ones(1))
    np.testing.assert_allclose(carriers_at(path, t).s[:, 0], 1.0 / (1.0 + t), atol=1e-9, rtol=0)


@pytest.mark.parametrize("start", [-1.0, -0.3, -1.0 / 3.0])
def test_removable_singularity(start: float) -> None:
    """t s̈ = t cos t: divided by t it is s̈ = cos t, right through t = 0."""
    path = equation(lambda t: t * np.cos(t), {SDD: lambda t: t}).solve(
        start, 1.0, np.array([-np.cos(start)]), np.array([np.sin(start)])
    )
    t = np.linspace(start, 1.0, 401)
    motion = carriers_at(path, t)
    np.testing.assert_allclose(motion.s[:, 0], -np.cos(t), atol=1e-10, rtol=0)
    np.testing.assert_allclose(motion.sdd[:, 0], np.cos(t), atol=1e-8, rtol=0)


def test_spare_carriers_share_by_least_norm_and_a_jump_of_the_load_is_one_of_the_acceleration() -> None:
    """s̈₁ + t s̈₂ = (1 + t²) g: of all solutions the one along (1, t) is g (1, t); g jumps."""

    def load(t: Array) -> Array:
        return np.where(t < 0.37, 1.0, -2.0) * (1.0 + t**2)

    spare = equation(load, {SDD: one}, {SDD: lambda t: t}, breaks=(0.37,))
    path = spare.solve(0.0, 1.0, np.zeros(2), np.zeros(2))
    for side, g in (("left", 1.0), ("right", -2.0)):
        sdd = carriers_at(path, np.array([0.37]), cast(Any, side)).sdd[0]
        np.testing.assert_allclose(sdd, [g, 0.37 * g], atol=1e-10)
    speed = carriers_at(path, np.array([1.0])).sd[0]
    np.testing.assert_allclose(speed, [0.37 - 2.0 * 0.63, 0.5 * 0.37**2 - (1.0 - 0.37**2)], atol=1e-11)


def test_an_unbounded_acceleration_is_given_up_beside_its_pole_in_any_unit_of_time() -> None:
    """t s̈ = 1 N has ṡ = ln |t| and no bounded solution through 0, in seconds and in units of them."""
    found = []
    for unit in (1.0, 1e-3, 1e3):
        pole = equation(one, {SDD: lambda t, unit=unit: t * unit})  # type: ignore[misc]
        with pytest.raises(StepGivenUpError) as caught:
            pole.solve(-unit, unit, np.zeros(1), np.zeros(1))
        found.append((caught.value.t / unit, caught.value.s[0], caught.value.sd[0] * unit))
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-3)
    # the last step tried was a millionth of the 2 s, and the pole is a few such steps ahead
    assert -1e-4 < found[0][0] < 0.0
    assert found[0][2] == pytest.approx(np.log(-found[0][0]), rel=1e-3)


def test_a_finite_time_escape_is_given_up() -> None:
    """s̈ = 2 s ṡ from (1, 1): s = 1/(1 − t) leaves for infinity at t = 1."""
    with pytest.raises(StepGivenUpError) as caught:
        equation(zero, {SDD: one, SSD: lambda t: -2.0 * one(t)}).solve(0.0, 2.0, np.ones(1), np.ones(1))
    assert 0.99 < caught.value.t < 1.01
