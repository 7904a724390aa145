"""Every backend against Lagrange's equations for point masses: random machines, modes, states and gravity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
import zoo
from point_mass_oracle import COMPLEX_STEP, PointMasses, angle_of, arccos, derivative, three_rrr_masses, two_rpr_masses

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import DynamicsAlongMotion
from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrMechanism

AGREEMENT = 1e-8
"""Relative to the largest effort of the sample. Central differences over a step of 2e-3 round at 1e-13, and the poses
keep a margin of 0.3 to type I."""

STATES = 12
SEEDS = range(8)


@dataclass(frozen=True)
class Case:
    """A random machine in random states, one row each; q = (x, s), a carrier for each leg: of mass 0 if it has none."""

    backend: type[rp.VirtualWork] | type[rp.CompiledDynamics]
    robot: rp.Robot
    oracle: PointMasses
    q: Array
    qd: Array
    qdd: Array

    @property
    def along(self) -> DynamicsAlongMotion:
        """The dynamics along the platform's states."""
        parts = (part[:, : self.robot.n] for part in (self.q, self.qd, self.qdd))
        motion = rp.PlatformMotion(np.arange(float(len(self.q))), *parts, check_rates=False)
        return self.backend(self.robot).along(motion)

    @property
    def carriers(self) -> rp.CarrierMotion:
        """The carriers' states."""
        n, k = self.robot.n, self.robot.k
        parts = (part[:, n : n + k] for part in (self.q, self.qd, self.qdd))
        return rp.CarrierMotion(*parts, check_rates=False)

    def states(self) -> Iterator[tuple[Array, Array, Array]]:
        """Iterate over (q, qd, qdd)."""
        return zip(self.q, self.qd, self.qdd, strict=True)

    def moved(self, t: float) -> Case:
        """Return the case after a time of its accelerations, s."""
        return replace(self, q=self.q + self.qd * t + 0.5 * self.qdd * t**2, qd=self.qd + self.qdd * t)


def numbers_of(name: str, seed: int) -> dict[str, object]:
    """Return random arguments of a model, carriers and the disc's inertia among them."""
    rng = np.random.default_rng(seed)
    if name == "2rpr":
        names = ("track_offset", "carrier_mass", "end_effector_mass", "cylinder_mass", "cylinder_length")
        names += ("piston_mass", "piston_length", "base_distance")
        return {key: float(rng.uniform(0.1, 1.5)) for key in names} | {"carriers": seed % 4 != 3}
    names = ("proximal_mass", "distal_mass", "platform_mass", "carrier_mass", "tail_length")
    parameters: dict[str, object] = {key: float(rng.uniform(0.3, 1.5)) for key in names}
    parameters |= {key: float(rng.uniform(1.0, 1.5)) for key in ("proximal_length", "distal_length")}
    parameters |= {"platform_radius": float(rng.uniform(0.1, 0.4)), "base_radius": float(rng.uniform(0.8, 1.2))}
    return parameters | {"carriers": seed % 4 != 3, "platform_inertia": "auto" if seed % 2 else 0.05}


def poses_of(robot: rp.Robot, rng: np.random.Generator) -> Array:
    """Return poses anywhere, away from type I."""
    if robot.name == "2rpr":
        height = rng.uniform(0.5, 2, STATES) * rng.choice([1, -1], STATES)
        return np.column_stack([rng.uniform(-1, 2, STATES), height])
    centre = float(robot.parameters["base_radius"]) * np.array([np.sqrt(3) / 2, 0.5])
    tries = np.column_stack([centre + rng.uniform(-1, 1, (2000, 2)), rng.uniform(-np.pi, np.pi, 2000)])
    legs = ThreeRrrMechanism(robot.parameters, robot.gravity, robot.working_mode).legs(tries)
    x = tries[(legs.margin > 0.3).all(axis=0)][:STATES]
    assert len(x) == STATES
    return x


def case_of(backend: type[rp.VirtualWork] | type[rp.CompiledDynamics], name: str, seed: int) -> Case:
    """Return closed forms at poses anywhere, and what follows a branch along a motion."""
    rng = np.random.default_rng(seed)
    mode = tuple(rng.choice([1, -1], 2 if name == "2rpr" else 3).tolist())
    gravity = rng.uniform(-10.0, 10.0, 3)
    robot = rp.load_robot(name, working_mode=mode, gravity=tuple(gravity), **numbers_of(name, seed))
    oracle = (two_rpr_masses if name == "2rpr" else three_rrr_masses)(dict(robot.parameters), mode)
    if backend is rp.VirtualWork:
        x, (xd, xdd) = poses_of(robot, rng), rng.uniform(-2, 2, (2, STATES, robot.n))
    else:
        motion = zoo.smooth_motion(robot, seed).at(np.linspace(0.0, 1.0, STATES))
        x, xd, xdd = motion.x, motion.xd, motion.xdd
    s, (sd, sdd) = rng.uniform(-1, 1, (STATES, robot.m)), rng.uniform(-2, 2, (2, STATES, robot.m))
    return Case(backend, robot, oracle, np.hstack([x, s]), np.hstack([xd, sd]), np.hstack([xdd, sdd]))


CASES = [(rp.VirtualWork, name, seed) for name in ("2rpr", "3rrr") for seed in SEEDS]
CASES += [(rp.CompiledDynamics, name, seed) for name in ("2rpr", "3rrr") for seed in (1, 2, 3)]


@pytest.fixture(params=CASES, ids=lambda p: f"{p[0].__name__}-{p[1]}-{p[2]}")
def case(request: pytest.FixtureRequest) -> Case:
    return case_of(*request.param)


def assert_close(got: Array, want: Array, tolerance: float = AGREEMENT) -> None:
    scale = max(1.0, np.abs(want).max(initial=0.0))
    np.testing.assert_allclose(got, want, rtol=0, atol=tolerance * scale)


@pytest.mark.long_for(
    *(f"VirtualWork-{name}-{seed}" for name in ("2rpr", "3rrr") for seed in range(2, 8)),
    *(f"CompiledDynamics-{name}-{seed}" for name in ("2rpr", "3rrr") for seed in (2, 3)),
)
def test_efforts_and_base_wrench_obey_lagrange(case: Case) -> None:
    reduced, wrench = case.along.reduce(case.carriers), case.along.base_wrench(case.carriers)
    for k, state in enumerate(case.states()):
        got = np.concatenate([reduced.f[k], reduced.carrier_force[k]])
        assert_close(got, case.oracle.generalised_force(*state, case.robot.gravity)[: len(got)])
        assert_close(wrench[k], case.oracle.base_wrench(*state, case.robot.gravity))


def test_energy_is_that_of_the_point_masses_and_grows_by_the_power(case: Case) -> None:
    got = case.along.energy(case.carriers)
    want = [case.oracle.energy(q, qd, case.robot.gravity) for q, qd, _ in case.states()]
    assert_close(got, np.array(want), 1e-12)  # both exact but for rounding
    reduced, carriers = case.along.reduce(case.carriers), case.carriers
    power = (reduced.f * case.qd[:, : case.robot.n]).sum(axis=1) + (reduced.carrier_force * carriers.sd).sum(axis=1)

    def energy_at(t: float) -> Array:
        moved = case.moved(t)
        return moved.along.energy(moved.carriers)

    assert_close(power, derivative(energy_at))


def test_derivatives_by_the_carriers(case: Case) -> None:
    """f is quadratic in (s, ṡ) and affine in s̈, as are the forces: central differences are exact for any step."""
    along, carriers = case.along, case.carriers
    exact = along.carrier_derivatives(carriers)
    for which in ("s", "sd", "sdd"):
        for leg in range(case.robot.k):
            up, down = (
                along.reduce(replace(carriers, **{which: getattr(carriers, which) + step * np.eye(case.robot.k)[leg]}))
                for step in (0.5, -0.5)
            )
            assert_close(getattr(exact, f"f_{which}")[:, :, leg], up.f - down.f, 1e-12)
            assert_close(getattr(exact, f"force_{which}")[:, :, leg], up.carrier_force - down.carrier_force, 1e-12)


def test_W_is_the_derivative_of_the_actuated_joints(case: Case) -> None:
    """Lengths of legs and angles of cranks in closed form, by complex steps (Parsa 2014, eqs. 2.3 and 2.22)."""
    robot, W = case.robot, case.along.reduce().W
    for x, own in zip(case.q[:, : robot.n], W, strict=True):
        for row, direction in zip(own, np.eye(robot.n), strict=True):
            want = actuated(robot, x + 1j * COMPLEX_STEP * direction).imag / COMPLEX_STEP
            assert_close(row, want, 1e-11)


def actuated(robot: rp.Robot, x: Array) -> Array:
    """Return (m,) the actuated joints at coordinates (n,), complex ones too."""
    sizes, joints = {key: value for key, value in robot.parameters.items() if isinstance(value, float)}, []
    for leg, mode in enumerate(robot.working_mode):
        if robot.name == "2rpr":
            joints.append(mode * np.sqrt((x[0] - leg * sizes["base_distance"]) ** 2 + x[1] ** 2))
            continue
        hinge = sizes["base_radius"] * np.array([(0, 0), (np.sqrt(3), 0), (np.sqrt(3) / 2, 1.5)][leg])
        turned = x[2] + (np.pi / 6, 5 * np.pi / 6, -np.pi / 2)[leg]
        corner = x[:2] - sizes["platform_radius"] * np.array([np.cos(turned), np.sin(turned)]) - hinge
        rho, first = np.sqrt((corner**2).sum()), sizes["proximal_length"]
        cosine = (first**2 + rho**2 - sizes["distal_length"] ** 2) / (2 * first * rho)
        joints.append(angle_of(corner) + mode * arccos(cosine))
    return np.array(joints)
