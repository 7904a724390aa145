"""Projection on the closures: closed, compatible, and nearest."""

from __future__ import annotations

from pathlib import Path

import moving
import numpy as np
import pinocchio as pin
import pytest
import zoo
from spatial_chains import CHAINS, chain_of

import redundancy_pin as rp
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.robot.scales import velocity_scale
from redundancy_pin.simulation.forward import ForwardDynamics
from redundancy_pin.simulation.state import Manifold, closed_state, tree_state

PARTING = 1e-12
"""m/s: velocities of order 1 and rounding."""


@pytest.mark.parametrize("name", [*zoo.SHIPPED, *CHAINS])
def test_states_off_the_closures_are_brought_back_to_the_nearest_ones(name: str) -> None:
    robot = chain_of(name) if name in CHAINS else moving.massive(name)
    dynamics, system = ForwardDynamics(robot), ConstraintSystem(robot)
    manifold, scale = Manifold(dynamics.chain), velocity_scale(robot)
    rng = np.random.default_rng(2)
    off = 1e-4
    for state in moving.random_states(robot, 3, 3):
        q = pin.integrate(robot.model, state.q, off * rng.normal(size=robot.model.nv) / scale)
        v = state.v + rng.normal(size=robot.model.nv)
        projected, rate, evaluated, left = manifold.project(q, v)
        rows = system.evaluate(projected[None])
        assert evaluated == pytest.approx(system.largest_residual(system.evaluate(q[None]).phi)[0], rel=1e-9)
        assert evaluated > 1e-6
        assert system.largest_residual(rows.phi)[0] <= manifold.tolerance + 1e-15
        assert left <= manifold.tolerance
        assert np.abs(rows.Jc[0] @ rate).max() < PARTING
        np.testing.assert_array_equal(projected[robot.carrier_position], q[robot.carrier_position])
        np.testing.assert_array_equal(rate[robot.carrier_velocity], v[robot.carrier_velocity])
        # nearest: what was changed is normal, in scaled coordinates, to all that the closures allow
        dynamics.adapt(projected)
        allowed = dynamics.velocity_basis(projected)
        moved = pin.difference(robot.model, q, projected)
        assert np.abs(allowed.T @ (scale**2 * (rate - v))).max() < 1e-9 * np.abs(allowed).max()
        assert np.abs(allowed.T @ (scale**2 * moved)).max() < 100 * off**2 * np.abs(allowed).max()


def test_a_loose_tolerance_opens_the_closures_in_a_step_and_the_projection_closes_them() -> None:
    robot = moving.massive("five_bar")
    start = closed_state(robot, xd=[0.8, -0.5], sd=[0.5, -0.4])
    run = rp.simulate(robot, start=start, duration=1.0, rtol=1e-4, atol=1e-5, stop_at=(), integrator="RK45")
    assert run.t[-1] == 1.0
    assert {event.joint for event in run.violated if event.quantity == "track"} == set(robot.carriers)  # no stops
    assert run.statistics.largest_correction > 1e-6
    assert run.gap.max() < 1e-12
    system = ConstraintSystem(robot)
    rates = np.einsum("nrv,nv->nr", system.evaluate(run.q).Jc, run.v)
    assert np.abs(rates).max() < PARTING


def test_every_step_starts_from_a_closed_state() -> None:
    # a crank that turns for a second at a loose tolerance: what steps open does not add up
    robot = zoo.robot_of("four_bar", ground_length=0.5, crank_length=0.2, coupler_length=0.4, rocker_length=0.3)
    run = rp.simulate(robot, start=closed_state(robot, xd=[8.0]), duration=1.0, rtol=1e-6, atol=1e-8, stop_at=())
    assert run.status.value == "ok"
    assert run.statistics.largest_correction < 1e-6


def test_quaternions_are_brought_back_to_unit_length(tmp_path: Path) -> None:
    robot = moving.floating(tmp_path)
    dynamics = ForwardDynamics(robot)
    q = np.array(robot.q_reference)
    q[3:7] *= 1.001
    projected, *_ = Manifold(dynamics.chain).project(q, np.zeros(robot.model.nv))
    assert np.linalg.norm(projected[3:7]) == pytest.approx(1.0, abs=1e-15)


def test_a_start_that_is_closed_to_a_micrometre_is_closed_before_the_first_step() -> None:
    robot = moving.massive("3rrr")
    state = moving.random_states(robot, 4, 1)[0]
    q = state.q + 2e-7 * np.random.default_rng(1).normal(size=robot.model.nq)
    assert np.abs(ConstraintSystem(robot).evaluate(q[None]).phi).max() > 1e-7
    run = rp.simulate(robot, start=tree_state(robot, q, state.v), duration=0.1, stop_at=())
    assert run.gap.max() < 1e-12
    assert run.statistics.largest_correction < 1e-10
