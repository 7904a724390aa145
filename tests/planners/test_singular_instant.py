"""Efforts at singular instants: of motions whose efforts are known, since f = W τ of a τ(t) written down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.singular_instant import Evaluate, SingularInstant
from redundancy_pin.trajectory import reference

AT = 0.7
EDGES = np.array([0.0, 0.3, 0.6, AT, 0.8, 1.0, 2.0])


def known(W: Callable[[Array], Array], tau: Callable[[Array], Array], row_scale: Array) -> Evaluate:
    """Return the dynamics of given W (N, n, m) and τ (N, m)."""

    def evaluate(t: Array) -> ReducedDynamics:
        matrix, count = W(t), len(t)
        return ReducedDynamics(
            t=t,
            f=np.einsum("nij,nj->ni", matrix, tau(t)),
            W=matrix,
            carrier_force=np.zeros((count, 0)),
            reachable=np.ones(count, dtype=bool),
            residual=np.zeros(count),
            row_scale=row_scale,
            column_scale=np.ones(matrix.shape[2]),
        )

    return evaluate


def turned(values: Array) -> Array:
    """Return (N, n, n) diagonal matrices (N, n), turned on both sides by fixed angles."""
    n = values.shape[1]
    left, right = (np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))[0] for seed in (1, 2))
    return left @ (values[:, :, None] * np.eye(n)) @ right


@pytest.mark.parametrize("length", [1.0, 1e-3, 1e3, 1e-6, 1e6])
@pytest.mark.parametrize("pace", [1.0, 1e-4, 1e4])
def test_the_efforts_are_those_that_a_motion_has_on_both_sides(length: float, pace: float) -> None:
    """One of three directions is lost, whatever the units of length and time."""

    def W(t: Array) -> Array:
        t = t / pace
        matrix = turned(np.stack([2.0 + np.cos(t), (t - AT) * (2.0 + np.sin(3.0 * t)), 1.5 + 0.1 * t], axis=1))
        return matrix * np.array([1.0, 1.0, length])[:, None]

    def tau(t: Array) -> Array:
        t = t / pace
        return np.stack([np.sin(4.0 * t), 2.0 - t**2, np.exp(-t)], axis=1)

    for side in ("left", "right"):
        dynamics = known(W, tau, np.array([1.0, 1.0, length]))
        instant = SingularInstant.along(dynamics, pace * EDGES, pace * AT, side)
        np.testing.assert_allclose(instant.efforts(), tau(np.array([pace * AT]))[0], atol=1e-8)
        scaled = W(np.array([pace * AT]))[0] / instant.row_scale[:, None]
        np.testing.assert_allclose((instant.u * instant.row_scale) @ scaled, 0.0, atol=1e-9)
        row, right = instant.equation
        np.testing.assert_allclose(row @ instant.efforts(), right, rtol=1e-6)


def test_where_a_motion_kinks_each_side_has_its_own_efforts() -> None:
    def tau(t: Array) -> Array:
        return np.where(t < AT, 1.0 + t, 5.0 - 2.0 * t)[:, None]

    dynamics = known(lambda t: (t - AT)[:, None, None] + 0.0, tau, np.ones(1))
    for side, expected in (("left", 1.0 + AT), ("right", 5.0 - 2.0 * AT)):
        np.testing.assert_allclose(SingularInstant.along(dynamics, EDGES, AT, side).efforts(), [expected], rtol=1e-9)


def test_with_spare_actuators_the_efforts_are_nearest_to_those_preferred() -> None:
    """W = ((t − 0.7), 0, 1): τ₁ and τ₃ share the force; by hand τ = p + W⁺ (f − W p) away from the singularity."""

    def W(t: Array) -> Array:
        rows = np.zeros((len(t), 2, 3))
        rows[:, 0, 0], rows[:, 1, 1], rows[:, 1, 2] = t - AT, 3.0, 4.0
        return rows

    wanted = np.array([7.0, 1.0, 2.0])
    dynamics = known(W, lambda t: np.stack([2.0 + t, t, 1.0 - t], axis=1), np.ones(2))
    instant = SingularInstant.along(dynamics, EDGES, AT)
    spare = 3.0 * AT + 4.0 * (1.0 - AT) - wanted[1:] @ [3.0, 4.0]
    expected = [2.0 + AT, *(wanted[1:] + np.array([3.0, 4.0]) * spare / 25.0)]
    np.testing.assert_allclose(instant.efforts(wanted), expected, rtol=1e-9)


def test_where_a_motion_only_touches_a_singularity_the_least_efforts_are_left() -> None:
    dynamics = known(
        lambda t: turned(np.stack([np.ones(len(t)), (t - AT) ** 2], axis=1)),
        lambda t: np.stack([t, 1.0 + t], axis=1),
        np.ones(2),
    )
    instant = SingularInstant.along(dynamics, EDGES, AT)
    least = np.linalg.pinv(instant.W, rcond=1e-6) @ instant.f
    np.testing.assert_allclose(instant.efforts(), least, atol=1e-9)


@cache
def crossing() -> Plan:
    dynamics = rp.VirtualWork(zoo.robot_of("2rpr", end_effector_mass=0.5, cylinder_mass=0.3))
    return rp.plan_whole_trajectory(dynamics, reference.circle(0.5, 0.2, 0.05), mesh=rp.Mesh(dt=0.03, refinements=0))


@pytest.mark.parametrize("node", [0, 1])
def test_a_check_finds_efforts_at_a_singular_instant_that_balance_and_are_no_limit(node: int) -> None:
    """W τ = f holds whatever is added along the null space of W: it is the rate that tells."""
    plan, other = crossing(), rp.RneaDynamics(zoo.robot_of("2rpr", end_effector_mass=0.5, cylinder_mass=0.3))
    assert rp.check_plan(plan, other).passed
    i = plan.diagnostics["singular_nodes"][node]
    null = np.linalg.svd(np.asarray(other.along(plan.motion).reduce().W)[i])[2][-1]
    tau, amount = np.array(plan.tau), 2e-3 * float(np.abs(plan.tau).max())
    tau[i] += amount * null
    check = rp.check_plan(replace(plan, tau=tau), other)
    assert check.imbalance < 1e-6
    (deviation,) = check.deviations
    assert (deviation.quantity, deviation.time) == ("main efforts", plan.t[i])
    assert deviation.amount == pytest.approx(amount * np.abs(null).max(), rel=1e-3)
