"""The integration of F s̈ = W τ_ref − f(s, ṡ, 0) on equations whose solutions are known."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from redundancy_pin.planners.carrier_model import CarrierModel
from redundancy_pin.planners.switch_off.carrier_equation import CarrierEquation, StepGivenUpError
from redundancy_pin.planners.switch_off.crossing import lost_directions
from redundancy_pin.trajectory.functions_of_time import carriers_at

S, S2, SD, SSD, SDD = range(5)


@dataclass
class Written:
    """A carrier model written down as functions of time: ``load`` (N, n), ``terms`` by (row, carrier, term)."""

    n: int
    k: int
    load: object
    terms: dict
    breaks: np.ndarray = field(default_factory=lambda: np.empty(0))
    knots: np.ndarray = field(default_factory=lambda: np.empty(0))
    tolerance: float = 1e-12

    def at(self, t, side="right"):
        f_terms = np.zeros((len(t), self.n, self.k, 5))
        for (row, carrier, term), function in self.terms.items():
            f_terms[:, row, carrier, term] = function(t)
        f0 = -np.stack([function(t) for function in self.load], axis=1)
        return CarrierModel(
            t, np.zeros((len(t), self.n, 1)), f0, f_terms, np.zeros((len(t), self.k)), np.zeros((len(t), self.k, 5))
        )


def one(t):
    return np.ones_like(t)


def zero(t):
    return np.zeros_like(t)


def equation(model):
    return CarrierEquation(model, lambda t: np.zeros((len(t), 1)), np.ones(model.n), 1.0)


def test_oscillator():
    """s̈ + s = 0 from s = 1 at rest is cos t."""
    model = Written(1, 1, [zero], {(0, 0, SDD): one, (0, 0, S): one})
    path = equation(model).solve(0.0, 10.0, np.array([1.0]), np.array([0.0]))
    t = np.linspace(0.0, 10.0, 1001)
    motion = carriers_at(path, t)
    for part, exact in ((motion.s, np.cos(t)), (motion.sd, -np.sin(t)), (motion.sdd, -np.cos(t))):
        assert np.abs(part[:, 0] - exact).max() < 1e-9


def test_all_nonlinear_terms():
    """s = 1/(1 + t): ṡ = −s², s̈ = 2 s³, so s̈ + 2 s ṡ = 0; and s̈ + 2 ṡ s + ṡ + s² = 0 as well."""
    for terms in (
        {(0, 0, SSD): lambda t: 2.0 * one(t)},
        {(0, 0, SSD): lambda t: 2.0 * one(t), (0, 0, SD): one, (0, 0, S2): one},
    ):
        model = Written(1, 1, [zero], {(0, 0, SDD): one, **terms})
        path = equation(model).solve(0.0, 5.0, np.array([1.0]), np.array([-1.0]))
        t = np.linspace(0.0, 5.0, 501)
        assert np.abs(carriers_at(path, t).s[:, 0] - 1.0 / (1.0 + t)).max() < 1e-9


@pytest.mark.parametrize("start", [-1.0, -0.3, -1.0 / 3.0])
def test_removable_singularity(start):
    """t s̈ = t cos t: divided by t it is s̈ = cos t, right through t = 0."""
    model = Written(1, 1, [lambda t: t * np.cos(t)], {(0, 0, SDD): lambda t: t})
    path = equation(model).solve(start, 1.0, np.array([-np.cos(start)]), np.array([np.sin(start)]))
    t = np.linspace(start, 1.0, 401)
    motion = carriers_at(path, t)
    assert np.abs(motion.s[:, 0] + np.cos(t)).max() < 1e-10
    assert np.abs(motion.sdd[:, 0] - np.cos(t)).max() < 1e-8


def test_two_singularities_close_to_each_other():
    """(t² − 1e-6) s̈ = (t² − 1e-6) eᵗ."""
    model = Written(1, 1, [lambda t: (t**2 - 1e-6) * np.exp(t)], {(0, 0, SDD): lambda t: t**2 - 1e-6})
    path = equation(model).solve(-1.0, 1.0, np.array([np.exp(-1.0)]), np.array([np.exp(-1.0)]))
    t = np.linspace(-1.0, 1.0, 2001)
    assert np.abs(carriers_at(path, t).sdd[:, 0] - np.exp(t)).max() < 1e-6
    assert np.abs(carriers_at(path, t).s[:, 0] - np.exp(t)).max() < 1e-9


@pytest.mark.parametrize("force", [1.0, 1e-3])
def test_unbounded_acceleration_is_given_up_beside_its_pole(force):
    """t s̈ = force has no bounded solution through 0."""
    model = Written(1, 1, [lambda t: force * one(t)], {(0, 0, SDD): lambda t: t})
    with pytest.raises(StepGivenUpError) as caught:
        equation(model).solve(-1.0, 1.0, np.zeros(1), np.zeros(1))
    assert -1e-3 < caught.value.t < 1e-9
    # until then it is the solution: ṡ = force ln |t|
    assert caught.value.sd[0] == pytest.approx(force * np.log(-caught.value.t), rel=1e-3)


def test_finite_time_escape_is_given_up():
    """s̈ = 2 s ṡ from (1, 1): s = 1/(1 − t) leaves for infinity at t = 1."""
    model = Written(1, 1, [zero], {(0, 0, SDD): one, (0, 0, SSD): lambda t: -2.0 * one(t)})
    with pytest.raises(StepGivenUpError) as caught:
        equation(model).solve(0.0, 2.0, np.ones(1), np.ones(1))
    assert 0.99 < caught.value.t < 1.01


def test_spare_carriers_share_by_least_norm():
    """s̈₁ + 2 s̈₂ = sin t: of all solutions the one along (1, 2)."""
    model = Written(1, 2, [np.sin], {(0, 0, SDD): one, (0, 1, SDD): lambda t: 2.0 * one(t)})
    path = equation(model).solve(0.0, 2.0, np.zeros(2), np.zeros(2))
    t = np.linspace(0.0, 2.0, 201)
    np.testing.assert_allclose(carriers_at(path, t).sdd, np.sin(t)[:, None] * [0.2, 0.4], atol=1e-9)


def test_jump_of_the_load_makes_a_jump_of_the_acceleration():
    model = Written(1, 1, [lambda t: np.where(t < 0.37, 1.0, -2.0)], {(0, 0, SDD): one}, breaks=np.array([0.37]))
    path = equation(model).solve(0.0, 1.0, np.zeros(1), np.zeros(1))
    for side, value in (("left", 1.0), ("right", -2.0)):
        assert carriers_at(path, np.array([0.37]), side).sdd[0, 0] == pytest.approx(value, abs=1e-10)
    assert carriers_at(path, np.array([1.0])).sd[0, 0] == pytest.approx(0.37 - 2.0 * 0.63, abs=1e-11)


def test_where_the_carriers_lose_a_direction_is_found_in_scaled_coordinates():
    """F(t) loses the direction u at t = 0.4, in forces; moments are forces at a lever of 5 m."""
    scale, u = np.array([1.0, 5.0]), np.array([0.6, 0.8])
    lost, grows = np.outer([0.8, -0.6], [1.0, 2.0]), np.array([[0.3, 1.0], [1.0, -0.2]])
    f0, W, tau = np.array([2.0, 35.0]), np.array([[1.0, 0.5], [2.0, -1.0]]), np.array([3.0, 4.0])
    by_s = np.array([[0.7, -1.0], [4.0, 2.0]])

    def at(t):
        terms = np.zeros((len(t), 2, 2, 5))
        terms[..., 0] = by_s
        terms[..., 4] = scale[:, None] * (lost + (t - 0.4)[:, None, None] * grows)
        return SimpleNamespace(t=t, f_terms=terms, f0=np.tile(f0, (len(t), 1)), W=np.tile(W, (len(t), 1, 1)))

    model = SimpleNamespace(at=at, interpolant=SimpleNamespace(edges=np.array([0.0, 0.25, 1.0])))
    equation = SimpleNamespace(model=model, row_scale=scale, effort=lambda t: np.tile(tau, (len(t), 1)))
    (crossings,) = lost_directions(equation, 0.0, 1.0)
    assert crossings.t == pytest.approx(0.4, abs=1e-7)
    sign = np.sign(crossings.direction[0])
    np.testing.assert_allclose(sign * crossings.direction, u, atol=1e-7)
    assert sign * crossings.parked == pytest.approx(u @ ((f0 - W @ tau) / scale), rel=1e-6)
    assert crossings.by_motion == pytest.approx(np.abs(u / scale @ by_s).max(), rel=1e-6)
    assert crossings.by_main


@pytest.mark.parametrize(
    ("size", "push", "most"),
    [(1.0, 0.0, 1e-8), (5.0, 0.0, 5e-8), (0.2, 0.0, 2e-9), (1.0, 900.0, 1e-8), (1.0, 2e4, 2e-7), (50.0, 2e4, 5e-7)],
)
@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_a_step_is_accepted_where_what_is_left_is_ten_tolerances_at_most(size, push, most, scale):
    """Two rows that ask one carrier for accelerations 2 δ apart: δ is left of each, whatever the steps.

    Tolerances of the largest f, or of a thousandth of F s̈ where that is more. The second row is a moment.
    """
    for share in (0.98, 1.02):
        apart = share * most
        model = Written(
            2,
            1,
            [lambda t: push * one(t), lambda t, apart=apart: scale * (push + 2.0 * apart) * one(t)],
            {(0, 0, SDD): one, (1, 0, SDD): lambda t: scale * one(t)},
            tolerance=1e-9,
        )
        made = CarrierEquation(model, lambda t: np.zeros((len(t), 1)), np.array([1.0, scale]), size)
        if share < 1.0:
            path = made.solve(1.0, 2.0, np.array([0.3]), np.array([-0.2]))
            expected = 0.3 - 0.2 + 0.5 * (push + apart)
            assert carriers_at(path, np.array([2.0])).s[0, 0] == pytest.approx(expected, rel=1e-9)
        else:
            with pytest.raises(StepGivenUpError) as caught:
                made.solve(1.0, 2.0, np.array([0.3]), np.array([-0.2]))
            assert caught.value.t == 1.0
            assert caught.value.defect == pytest.approx(apart, rel=1e-3)


@pytest.mark.parametrize("slower", [1e-3, 1e3])
def test_where_it_is_given_up_is_as_near_to_the_pole_in_any_unit_of_time(slower):
    """t s̈ = 1 N on the way to the pole at 0, in seconds and in units of which there are more or fewer."""
    found = []
    for unit in (1.0, slower):
        model = Written(1, 1, [lambda t: 1.0 * one(t)], {(0, 0, SDD): lambda t, unit=unit: t * unit})
        with pytest.raises(StepGivenUpError) as caught:
            equation(model).solve(-unit, unit, np.zeros(1), np.zeros(1))
        found.append((caught.value.t / unit, caught.value.s[0], caught.value.sd[0] * unit))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)
    # the last step tried was a millionth of the 2 s, and the pole is a few such steps ahead
    assert -1e-4 < found[0][0] < 0.0


def test_steps_are_few_where_nothing_happens_and_end_at_breaks():
    """A polynomial of degree 13 in s̈ is one step, a jump of the load ends one, and a sharp bend is divided."""
    smooth = Written(1, 1, [lambda t: t**13], {(0, 0, SDD): one}, breaks=np.array([-5.0, 0.0, 0.25, 1.0, 7.0]))
    path = equation(smooth).solve(0.0, 1.0, np.zeros(1), np.zeros(1))
    np.testing.assert_allclose(path.edges, [0.0, 0.25, 1.0])
    assert carriers_at(path, np.array([1.0])).s[0, 0] == pytest.approx(1.0 / (14.0 * 15.0), rel=1e-12)
    sharp = Written(1, 1, [lambda t: 1.0 / (1.0 + (30.0 * (t - 0.5)) ** 2)], {(0, 0, SDD): one})
    edges = equation(sharp).solve(0.0, 1.0, np.zeros(1), np.zeros(1)).edges
    assert 8 < len(edges) <= 40
    assert np.diff(edges).max() > 4.0 * np.diff(edges).min()
