"""Virtual work against Lagrange's equations for point masses, on random machines, modes, states and gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from point_mass_oracle import PointMasses, derivative, three_rrr_masses, two_rpr_masses

from redundancy_pin.dynamics.virtual_work import Mechanism
from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrMechanism
from redundancy_pin.dynamics.virtual_work.two_rpr import TwoRprMechanism

AGREEMENT = 1e-8
"""Relative to the largest effort of the sample. Central differences over a step of 2e-3 round at 1e-13, and the poses
keep a margin of 0.3 to type I."""

STATES = 12
SEEDS = range(8)


@dataclass(frozen=True)
class Case:
    """A random mechanism with random states, one row each; q = (x, s)."""

    mechanism: Mechanism
    oracle: PointMasses
    gravity: np.ndarray
    n: int
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray

    @property
    def along(self):
        """The virtual-work dynamics at the states."""
        x, xd, xdd = (part[:, : self.n] for part in (self.q, self.qd, self.qdd))
        return self.mechanism.along(self.legs, x, xd, xdd)

    @property
    def legs(self):
        """The inverse displacement at the states."""
        return self.mechanism.legs(self.q[:, : self.n])

    @property
    def carriers(self):
        """Carrier motion, leg-major."""
        return tuple(np.ascontiguousarray(v[:, self.n :].T) for v in (self.q, self.qd, self.qdd))

    def states(self):
        """Iterate over (q, qd, qdd)."""
        return zip(self.q, self.qd, self.qdd, strict=True)


def two_rpr(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    names = ("track_offset", "carrier_mass", "end_effector_mass", "cylinder_mass", "cylinder_length")
    names += ("piston_mass", "piston_length", "base_distance")
    parameters = {name: float(rng.uniform(0.1, 1.5)) for name in names} | {"carriers": seed % 4 != 3}
    mode = tuple(int(s) for s in rng.choice([1, -1], 2))
    gravity = rng.uniform(-10, 10, 3)
    x = np.column_stack([rng.uniform(-1, 2, STATES), rng.uniform(0.5, 2, STATES) * rng.choice([1, -1], STATES)])
    mechanism = TwoRprMechanism(parameters, gravity, mode)
    return states_of(Case, rng, mechanism, two_rpr_masses(parameters, mode), gravity, x, 2)


def three_rrr(seed: int) -> Case:
    rng = np.random.default_rng(seed)
    names = ("base_radius", "platform_radius", "proximal_length", "distal_length", "tail_length")
    names += ("proximal_mass", "distal_mass", "platform_mass", "carrier_mass", "platform_inertia")
    parameters = {name: float(rng.uniform(0.3, 1.5)) for name in names}
    parameters |= {"proximal_length": float(rng.uniform(1.0, 1.5)), "distal_length": float(rng.uniform(1.0, 1.5))}
    parameters |= {"platform_radius": float(rng.uniform(0.1, 0.4)), "base_radius": float(rng.uniform(0.8, 1.2))}
    parameters |= {"carriers": seed % 4 != 3, "platform_inertia": "auto" if seed % 2 else 0.05}
    mode = tuple(int(s) for s in rng.choice([1, -1], 3))
    gravity = rng.uniform(-10, 10, 3)
    mechanism = ThreeRrrMechanism(parameters, gravity, mode)
    centre = parameters["base_radius"] * np.array([np.sqrt(3) / 2, 0.5])
    tries = np.column_stack([centre + rng.uniform(-1, 1, (2000, 2)), rng.uniform(-np.pi, np.pi, 2000)])
    x = tries[(mechanism.legs(tries).margin > 0.3).all(axis=0)][:STATES]
    assert len(x) == STATES
    return states_of(Case, rng, mechanism, three_rrr_masses(parameters, mode), gravity, x, 3)


def states_of(kind, rng, mechanism, oracle, gravity, x, legs):
    s, qd, qdd = rng.uniform(-1, 1, (STATES, legs)), *rng.uniform(-2, 2, (2, STATES, x.shape[1] + legs))
    return kind(mechanism, oracle, gravity, x.shape[1], np.hstack([x, s]), qd, qdd)


@pytest.fixture(
    params=[(make, seed) for make in (two_rpr, three_rrr) for seed in SEEDS], ids=lambda p: f"{p[0].__name__}-{p[1]}"
)
def case(request):
    make, seed = request.param
    return make(seed)


def assert_close(got, want, tolerance=AGREEMENT):
    scale = max(1.0, np.abs(want).max())
    np.testing.assert_allclose(got, want, rtol=0, atol=tolerance * scale)


@pytest.mark.long_for(*(f"{name}-{seed}" for name in ("two_rpr", "three_rrr") for seed in range(2, 8)))
def test_efforts_obey_lagrange(case):
    efforts = case.along.efforts(case.carriers)
    f, force = efforts.f, efforts.force
    for k, state in enumerate(case.states()):
        want = case.oracle.generalised_force(*state, case.gravity)
        assert_close(np.concatenate([f[:, k], force[:, k]]), want)


def test_energy_is_that_of_the_point_masses(case):
    got = case.along.efforts(case.carriers).energy
    want = [case.oracle.energy(q, qd, case.gravity) for q, qd, _ in case.states()]
    assert_close(got, np.array(want), 1e-12)  # both exact but for rounding


def test_base_wrench_is_weight_less_rate_of_momentum(case):
    got = case.along.efforts(case.carriers).ground
    for k, state in enumerate(case.states()):
        assert_close(got[k], case.oracle.base_wrench(*state, case.gravity))


def test_power_is_the_rate_of_energy(case):
    efforts = case.along.efforts(case.carriers)
    f, force = efforts.f, efforts.force
    power = (f.T * case.qd[:, : case.n]).sum(axis=1) + (force.T * case.qd[:, case.n :]).sum(axis=1)

    def energy_at(t):
        moved = Case(
            case.mechanism, case.oracle, case.gravity, case.n,
            case.q + case.qd * t + 0.5 * case.qdd * t**2, case.qd + case.qdd * t, case.qdd,
        )  # fmt: skip
        return moved.along.efforts(moved.carriers).energy

    assert_close(power, derivative(energy_at))


def test_derivatives_by_the_carriers(case):
    """f is quadratic in (s, ṡ) and affine in s̈, as are the forces: central differences are exact for any step."""
    along, carriers = case.along, case.carriers
    exact = along.efforts(carriers, derivatives=True)
    for which, (by_f, by_force) in enumerate(zip(exact.by_f, exact.by_force, strict=True)):
        for leg in range(len(carriers[0])):

            def efforts_at(step, which=which, leg=leg):
                moved = [value.copy() for value in carriers]
                moved[which][leg] += step
                return along.efforts(tuple(moved))

            up, down = efforts_at(0.5), efforts_at(-0.5)
            assert_close(by_f[:, leg], up.f - down.f, 1e-12)
            assert_close(by_force[:, leg], up.force - down.force, 1e-12)


def test_jacobian_is_the_derivative_of_the_actuated_joints(case):
    def actuated(x):
        solved = case.mechanism.legs(x)
        return (solved.d if case.n == 2 else np.unwrap(solved.theta, axis=0)).T

    x = case.q[:, : case.n]
    for column in range(case.n):
        step = np.eye(case.n)[column]
        difference = derivative(lambda h, step=step: np.exp(1j * actuated(x + h * step)))
        want = (difference / (1j * np.exp(1j * actuated(x)))).real
        assert_close(case.legs.jacobian[column].T, want)
