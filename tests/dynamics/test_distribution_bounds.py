"""Efforts within bounds and rows, against other solvers and cases by hand; closure forces against free bodies."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from prescribed import factors, reduced, times
from scipy.optimize import LinearConstraint, minimize, nnls

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.allocation import (
    FORCE_TOLERANCE,
    least_miss,
    within_bounds,
)
from redundancy_pin.dynamics.contacts import ClosureForces, closure_forces
from redundancy_pin.dynamics.distribution import EffortRows, distribute, torque_speed_bounds
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.errors import InputError
from redundancy_pin.status import SampleStatus

OPTIMUM = 1e-8
"""Relative: bounds count as met within 1e-9 of the largest effort, and the optimum moves by about as much."""

# least norm (5, 5) of τ1 + τ2 = 10, with τ1 ≤ 3 (3, 7), with τ2 ≤ 6 as well 1 N is missing; tensions of four cables to
# the middle of a square, at least 1 N; a linear actuator and a motor, in N and N·m; an actuator that is held
CABLES = np.array([[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]]) / np.sqrt(2.0)

BY_HAND = [
    ([[1.0, 1.0]], [10.0], None, {"upper": [5.0, 5.0]}, [5.0, 5.0]),
    ([[1.0, 1.0]], [10.0], None, {"upper": [3.0, np.inf]}, [3.0, 7.0]),
    ([[1.0, 1.0]], [10.0], None, {"upper": [3.0, 6.0]}, None),
    (CABLES, [0.0, 0.0], None, {"lower": [1.0] * 4}, [1.0] * 4),
    ([[1.0, 4.0]], [10.0], [1.0, 0.25], {"upper": [np.inf, 1.0]}, [6.0, 1.0]),
    ([[1.0, 4.0]], [10.0], [1.0, 0.25], {"lower": [-np.inf, 2.0]}, [2.0, 2.0]),
    ([[1.0, 1.0, 1.0]], [9.0], None, {"lower": [-9.0, 7.0, -9.0], "upper": [9.0, 7.0, 9.0]}, [1.0, 7.0, 1.0]),
    # W τ = f returns 1/3, which is no floating-point number, with an error of a rounding
    (np.diag([3.0, 7.0]), [1.0, 1.0], None, {"upper": [np.nextafter(1.0 / 3.0, 0.0), 1.0]}, [1.0 / 3.0, 1.0 / 7.0]),
]


@pytest.mark.parametrize(("W", "f", "scale", "bounds", "expected"), BY_HAND)
def test_cases_solved_by_hand(W, f, scale, bounds, expected):
    d = distribute(reduced([W], [f], column_scale=scale), **bounds)
    if expected is None:
        assert d.status_labels.tolist() == ["bound_infeasible"]
        assert np.isnan(d.tau).all()
        assert d.residual == pytest.approx([1.0], abs=10.0 * OPTIMUM)
        return
    assert d.status_labels.tolist() == ["ok"]
    assert d.tau[0] == pytest.approx(expected, abs=10.0 * OPTIMUM)
    assert (d.tau[0] >= bounds.get("lower", -np.inf)).all()
    assert (d.tau[0] <= bounds.get("upper", np.inf)).all()


def test_the_free_direction_of_a_singular_pose_serves_the_bounds():
    # 2-RPR in line: W τ = (τ1 − τ2, 0); least norm (2, −2), with τ1 ≤ 0.5 it is (0.5, −3.5)
    W = np.array([[[1.0, -1.0], [0.0, 0.0]]] * 2)
    d = distribute(reduced(W, [[4.0, 0.0]] * 2), lower=[[-9.0, -9.0], [-9.0, -3.0]], upper=[0.5, 9.0])
    assert d.status_labels.tolist() == ["singular_consistent", "bound_infeasible"]
    assert d.tau[0] == pytest.approx([0.5, -3.5], abs=10.0 * OPTIMUM)
    assert d.free_direction[0] == pytest.approx(np.array([1.0, 1.0]) / np.sqrt(2.0))
    assert d.residual[1] == pytest.approx(0.5, rel=1e-9)
    assert np.isnan(d.free_direction[1]).all()


@pytest.mark.parametrize(("n", "m"), [(2, 2), (3, 3), (3, 2)])
def test_unique_efforts_outside_their_bounds_are_infeasible(n, m):
    rng = np.random.default_rng(1)
    _, W, _ = factors(rng, 20, n, m, np.linspace(2.0, 1.0, m))
    tau = rng.uniform(-1.0, 1.0, size=(20, m))
    lower, upper = np.full(m, -0.8), np.full(m, 0.7)
    d = distribute(reduced(W, times(W, tau)), lower=lower, upper=upper)
    inside = ((tau >= lower) & (tau <= upper)).all(axis=1)
    assert inside.any()
    assert not inside.all()
    assert (d.status == np.where(inside, SampleStatus.OK, SampleStatus.BOUND_INFEASIBLE)).all()
    assert d.tau[inside] == pytest.approx(tau[inside], abs=1e-13)
    assert np.isnan(d.tau[~inside]).all()


def test_residual_where_bounded_least_squares_end_in_nan(monkeypatch):
    """As scipy's BVLS did at one of 2001 samples of two arms with a bar, by 0/0."""
    lsq_linear = scipy.optimize.lsq_linear

    def failing(*args, method, **kwargs):
        fit = lsq_linear(*args, method=method, **kwargs)
        return fit if method != "bvls" else type(fit)(fit, x=fit.x * np.nan)

    W, goal, box = np.array([[1.0, 2.0, 1.0, 2.0], [0.5, -1.0, 0.5, -1.0]]), np.array([30.0, 1.0]), np.ones(4)
    expected = np.linalg.norm(W @ least_miss(W, goal, -box, box) - goal)
    monkeypatch.setattr(scipy.optimize, "lsq_linear", failing)
    assert np.linalg.norm(W @ least_miss(W, goal, -box, box) - goal) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("angle", [1e-4, 1e-6])
def test_bounds_nearly_along_one_another_are_two(angle):
    start, null, rows = np.zeros(2), np.eye(2), np.array([[1.0, 0.0], [1.0, angle]])
    corner = rows @ [1.0, 3.0]  # z1 ≤ 1 and z1 + angle z2 ≥ 1 + 3 angle: the corner is nearest
    z = within_bounds(start, null, rows, np.array([-np.inf, corner[1]]), np.array([corner[0], np.inf]))
    np.testing.assert_allclose(z, [1.0, 3.0], rtol=1e-12 / angle)


@examples(40)
@given(
    n=st.integers(1, 3),
    extra=st.integers(1, 3),
    lost=st.integers(0, 1),
    exponents=st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6),
    seed=st.integers(0, 9999),
)
def test_bounded_optimum_meets_the_optimality_conditions(n, extra, lost, exponents, seed):
    # Karush, Kuhn and Tucker: tau is optimal if and only if, on the free actuators, w τ is a combination Wᵀ λ, and on
    # the ones at a bound w τ − Wᵀ λ pushes outwards; λ is found here by non-negative least squares
    rng = np.random.default_rng(seed)
    m = n + extra
    weights = 10.0 ** np.array(exponents[:m])
    values = np.linspace(2.0, 1.0, n)
    values[n - 1 :] *= 1 - lost
    _, W, _ = factors(rng, 1, n, m, values)
    inner = rng.uniform(-1.0, 1.0, m)
    lower, upper = inner - rng.uniform(0.0, 0.8, m), inner + rng.uniform(0.0, 0.8, m)
    d = distribute(reduced(W, times(W, inner[None])), weights=weights, lower=lower, upper=upper)
    assert d.solved.all()  # the efforts that made f are within the bounds
    tau = d.tau[0]
    assert (tau >= lower).all()
    assert (tau <= upper).all()
    assert W[0] @ tau == pytest.approx(W[0] @ inner, abs=1e-8)
    at_lower, at_upper = tau <= lower + 1e-7, tau >= upper - 1e-7
    # w τ = Wᵀ λ + μ_lower − μ_upper
    gradient = weights * tau
    identity = np.eye(m)
    generators = np.concatenate([W[0].T, -W[0].T, identity[:, at_lower], -identity[:, at_upper]], axis=1)
    assert scipy.optimize.nnls(generators, gradient)[1] <= 1e-6 * max(weights.max(), 1.0)


def test_bounds_that_leave_a_single_point_are_met():
    # every actuator held at the efforts that made f: rounding must not make that infeasible
    rng = np.random.default_rng(4)
    _, W, _ = factors(rng, 100, 2, 4, [2.0, 1.0])
    tau = rng.uniform(-1.0, 1.0, size=(100, 4))
    d = distribute(reduced(W, times(W, tau)), lower=tau, upper=tau)
    assert (d.status == SampleStatus.OK).all()
    assert np.array_equal(d.tau, tau)


def test_an_effort_that_the_free_direction_cannot_move_keeps_its_bound():
    # actuator 0 alone holds one freedom, 1 and 2 share the other and cannot relieve it. Seen through a rotation the
    # null vector gets a rounding of either sign in its first entry; the answer must not be a huge step along it
    rng = np.random.default_rng(6)
    rotation = factors(rng, 50, 2, 2, [1.0, 1.0])[0]
    W = rotation @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.7]])
    d = distribute(reduced(W, times(rotation, np.full((50, 2), 2.0))), upper=[1.0, np.inf, np.inf])
    assert (d.status == SampleStatus.BOUND_INFEASIBLE).all()
    assert d.residual == pytest.approx(np.ones(50))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("share", "label"), [(0.9, "ok"), (1.1, "bound_infeasible")])
def test_an_effort_may_pass_its_bound_by_a_share_of_the_largest_one(sign, share, label):
    """Of 1000 N beside it; it is put on the bound, and what is then missing is the residual."""
    passed = share * FORCE_TOLERANCE * 1000.0
    bound = {"upper": [np.inf, 1.0 - passed]} if sign > 0.0 else {"lower": [-np.inf, -1.0 + passed]}
    d = distribute(reduced([np.eye(2)], [[1000.0, sign]]), **bound)
    assert d.status_labels.tolist() == [label]
    assert d.residual[0] == pytest.approx(passed, rel=1e-6)
    if label == "ok":
        assert d.tau[0].tolist() == [1000.0, sign * (1.0 - passed)]


def test_inconsistent_samples_stay_inconsistent_under_bounds():
    d = distribute(reduced([[[1.0, 0.0], [0.0, 0.0]]], [[5.0, 1.0]]), lower=[-1.0, -1.0], upper=[1.0, 1.0])
    assert d.status[0] == SampleStatus.SINGULAR_INCONSISTENT
    assert d.residual[0] == pytest.approx(1.0)


def test_an_actuator_with_a_tiny_lever_that_has_to_help_is_found_exactly():
    # τ1 ε + τ2 + τ3 = 10, −τ1 ε + τ2 = 0 with τ3 ≤ 4: the cheap ones are at their bounds, so τ1 ε = τ2 = 3
    lever = 1e-7
    d = distribute(reduced([[[lever, 1.0, 1.0], [-lever, 1.0, 0.0]]], [[10.0, 0.0]]), upper=[np.inf, np.inf, 4.0])
    assert d.status_labels.tolist() == ["ok"]
    assert d.residual[0] < 1e-6
    assert d.tau[0] * [lever, 1.0, 1.0] == pytest.approx([3.0, 3.0, 4.0], rel=1e-6)


@given(seed=st.integers(0, 2**32 - 1), bounded=st.booleans())
@examples(25)
def test_preferred_efforts_are_missed_least(seed, bounded):
    """Against a general optimiser, with weights and bounds, at samples each with its own preference."""
    rng = np.random.default_rng(seed)
    n, m, samples = 2, 4, 2
    problem = reduced(rng.normal(size=(samples, n, m)), rng.normal(size=(samples, n)))
    preferred, weights = rng.normal(size=(samples, m)), rng.uniform(0.2, 5.0, m)
    bounds = {"lower": -1.5 * np.ones(m), "upper": 1.5 * np.ones(m)} if bounded else {}
    efforts = distribute(problem, weights=weights, preferred=preferred, **bounds)
    for k in np.flatnonzero(np.isfinite(efforts.tau).all(axis=1)):
        W, f = problem.W[k], problem.f[k]
        np.testing.assert_allclose(W @ efforts.tau[k], f, atol=1e-9)
        optimum = scipy.optimize.minimize(
            lambda u, k=k: weights @ (u - preferred[k]) ** 2,
            efforts.tau[k],
            jac=lambda u, k=k: 2.0 * weights * (u - preferred[k]),
            constraints={"type": "eq", "fun": lambda u, W=W, f=f: W @ u - f, "jac": lambda u, W=W: W},
            bounds=[(-1.5, 1.5)] * m if bounded else None,
            method="SLSQP",
            options={"ftol": 1e-14},
        )
        assert weights @ (efforts.tau[k] - preferred[k]) ** 2 <= optimum.fun + 1e-7


def test_forces_and_torques_are_preferred_as_they_are_counted():
    """Forces in N beside torques in N·m: Σ (τ − τ⁰)² / scale² is least where W τ = f, so (τ − τ⁰) / scale² is Wᵀ y."""
    rng = np.random.default_rng(6)
    W, f, preferred = rng.normal(size=(5, 2, 4)), rng.normal(size=(5, 2)), rng.normal(size=(5, 4))
    scale = np.array([1.0, 0.2, 3.0, 1.0])
    d = distribute(reduced(W, f, row_scale=[1.0, 0.2], column_scale=scale), preferred=preferred)
    np.testing.assert_allclose(times(W, d.tau), f, atol=1e-9)
    free = np.array([np.linalg.svd(one)[2][2:] for one in W])
    np.testing.assert_allclose(times(free, (d.tau - preferred) / scale**2), 0.0, atol=1e-9)


def test_bounds_of_a_motor_fall_with_its_speed():
    lower, upper = torque_speed_bounds([[0.0, 5.0, -5.0, 20.0]], stall=4.0, no_load=10.0)
    assert upper.tolist() == [[4.0, 2.0, 4.0, -4.0]]
    assert lower.tolist() == [[-4.0, -4.0, -2.0, -4.0]]
    with pytest.raises(InputError, match="no_load"):
        torque_speed_bounds([[1.0]], 4.0, 0.0)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_residual_of_infeasible_bounds_and_rows_is_the_least_within_them(scale):
    """Against scipy's BVLS, one effort held; with rows against SLSQP. Efforts of 0 are within all the rows."""
    rng = np.random.default_rng(2)
    W, f = rng.normal(size=(10, 3, 5)), 50.0 * rng.normal(size=(10, 3))
    lower, upper = -rng.uniform(0.5, 2.0, 5), rng.uniform(0.5, 2.0, 5)
    lower[1] = upper[1] = 0.5
    d = distribute(reduced(W, scale * f), lower=scale * lower, upper=scale * upper)
    assert (d.status == SampleStatus.BOUND_INFEASIBLE).all()
    free = np.arange(5) != 1
    best = [
        scipy.optimize.lsq_linear(A[:, free], g - 0.5 * A[:, 1], (lower[free], upper[free]), method="bvls", tol=1e-14)
        for A, g in zip(W, f, strict=True)
    ]
    np.testing.assert_allclose(d.residual / scale, [np.sqrt(2.0 * one.cost) for one in best], rtol=1e-8)
    rows = np.concatenate([np.eye(5), rng.normal(size=(3, 5))])
    low, high = -np.abs(rng.normal(size=8)), np.abs(rng.normal(size=8))
    d = distribute(reduced(W, scale * f), rows=[EffortRows(rows, scale * low, scale * high)])
    for k, (A, g) in enumerate(zip(W, f, strict=True)):
        least = minimize(
            lambda u, A=A, g=g: ((A @ u - g) ** 2).sum(), np.zeros(5), jac=lambda u, A=A, g=g: 2.0 * A.T @ (A @ u - g),
            constraints=[LinearConstraint(rows, low, high)], method="SLSQP", options={"ftol": 1e-14},
        )  # fmt: skip
        assert d.residual[k] / scale == pytest.approx(np.sqrt(least.fun), rel=1e-6)
    held = distribute(reduced([[[1.0, 1.0]]], [[10.0 * scale]]), lower=[scale, scale], upper=[scale, scale])
    assert held.residual[0] == pytest.approx(8.0 * scale)


# --- rows of efforts: contacts and closure forces


EXACT = 1e-12
CONDITIONS = 1e-5  # relative; DAQP keeps conditions to 1e-6


Gripping = tuple[RneaAlongMotion, ReducedDynamics, ClosureForces, EffortRows]


@pytest.fixture(scope="module")
def gripping() -> Gripping:
    """A five-bar with all four hinges driven: two arms that hold a point between them, and squeeze it."""
    five_bar = zoo.robot_of("five_bar")
    robot = rp.robot_from_model(
        five_bar.model,
        closures=[{"name": "grip", "frames": ["tip_2", "end_effector"], "axes": ["x", "y"]}],
        actuated=["base_1", "elbow_1", "base_2", "elbow_2"],
        carriers=five_bar.carriers,
        independent=five_bar.platform,
        reference=np.array(five_bar.q_reference),
    )
    along = rp.RneaDynamics(robot).along(zoo.smooth_motion(five_bar, 1).at(np.linspace(0.0, 1.0, 6)))
    force = closure_forces(along)
    return along, along.reduce(), force, force.rows(force.component("grip", "x"), 20.0, 20.0)


def least(W: Array, f: Array, rows: EffortRows, k: int) -> Array:
    """Return the τ of least norm with W τ = f and the rows, by non-negative least squares (Lawson and Hanson 1974)."""
    C = rows.matrix[k] if rows.matrix.ndim == 3 else rows.matrix
    low, high = (side[k] if np.ndim(side) == 2 else np.broadcast_to(side, len(C)) for side in (rows.lower, rows.upper))
    A, low, high = np.concatenate([W, C]), np.concatenate([f, low]), np.concatenate([f, high])
    G = np.concatenate([A[np.isfinite(low)], -A[np.isfinite(high)]])
    h = np.concatenate([low[np.isfinite(low)], -high[np.isfinite(high)]])
    size = np.linalg.norm(G, axis=1)
    G, h = G / size[:, None], h / size
    multipliers, left = nnls(np.concatenate([G.T, h[None] / np.abs(h).max()]), np.eye(W.shape[1] + 1)[-1])
    assert left > 1e-9  # else nothing keeps them
    pressed = multipliers > 0.0
    return np.asarray(np.linalg.lstsq(G[pressed], h[pressed], rcond=None)[0])


def test_a_squeeze_holds_exactly_and_costs_least(gripping: Gripping) -> None:
    along, reduced, force, squeeze = gripping
    distribution = rp.distribute(reduced, rows=[squeeze])
    assert distribution.solved.all()
    reactions = rp.joint_reactions(along, distribution.tau)
    assert np.abs(reactions.closure_force[:, 0] - 20.0).max() < 1e-6
    assert np.abs(reactions.closure_force - force.at(distribution.tau)).max() < 1e-8
    assert np.abs(np.einsum("nij,nj->ni", reduced.W, distribution.tau) - reduced.f).max() < 1e-8
    for k in range(len(reduced.f)):
        oracle = least(reduced.W[k], reduced.f[k], squeeze, k)
        assert np.abs(distribution.tau[k] - oracle).max() < CONDITIONS * np.abs(oracle).max()
    free = rp.distribute(reduced)
    assert np.linalg.norm(free.tau) < np.linalg.norm(distribution.tau)


def test_contacts_stay_in_their_cones_and_motors_in_their_bounds(gripping: Gripping) -> None:
    along, reduced, force, _ = gripping
    cone = force.friction_cone("grip", 0.5, normal="x", least=5.0)
    upper = np.abs(rp.distribute(reduced, rows=[cone]).tau).max(axis=0) * [1.5, 0.95, 1.5, 1.5]  # one motor is weak
    distribution = rp.distribute(reduced, rows=[cone], lower=-upper, upper=upper)
    assert distribution.solved.all()
    normal, tangent = rp.joint_reactions(along, distribution.tau).closure_force.T
    assert (normal > 5.0 - 1e-6).all()
    assert (np.abs(tangent) < 0.5 * normal + 1e-6).all()
    assert (np.abs(distribution.tau) <= upper).all()
    assert (np.abs(distribution.tau[:, 1]) > 0.99 * upper[1]).any()
    bounds = EffortRows(np.eye(4), -upper, upper)
    for k in range(len(reduced.f)):
        both = EffortRows(*(np.concatenate(parts) for parts in zip(
            (cone.matrix[k], cone.lower[k], np.full(len(cone.lower[k]), np.inf)),
            (bounds.matrix, bounds.lower, bounds.upper), strict=True)))  # fmt: skip
        oracle = least(reduced.W[k], reduced.f[k], both, 0)
        assert np.abs(distribution.tau[k] - oracle).max() < 1e-4 * np.abs(oracle).max()


def test_conditions_that_cannot_be_kept_are_a_status(gripping: Gripping) -> None:
    along, reduced, force, squeeze = gripping
    distribution = rp.distribute(reduced, rows=[squeeze], lower=-0.5, upper=0.5)
    assert (distribution.status == SampleStatus.BOUND_INFEASIBLE).all()
    assert np.isnan(distribution.tau).all()
    # equal rows that contradict each other have no residual at all
    other = force.rows(force.component("grip", "x"), 30.0, 30.0)
    assert np.isinf(rp.distribute(reduced, rows=[squeeze, other]).residual).all()
    # a robot without choice keeps rows or does not
    five_bar = zoo.robot_of("five_bar")
    own = rp.RneaDynamics(five_bar).reduce(along.motion)
    efforts = rp.distribute(own).tau
    limit = float(np.median(efforts[:, 0]))
    kept = rp.distribute(own, rows=[EffortRows(np.array([[1.0, 0.0]]), np.array([-np.inf]), np.array([limit]))])
    assert ((kept.status == SampleStatus.BOUND_INFEASIBLE) == (efforts[:, 0] > limit + 1e-9)).all()


def foot() -> ClosureForces:
    """A point foot in a plane: what holds it are the two efforts themselves."""
    return ClosureForces(("x of foot", "z of foot"), np.zeros((1, 2)), np.eye(2)[None])


@pytest.mark.parametrize("sides", [3, 4, 5, 8])
def test_a_cone_in_a_plane_is_the_same_to_both_sides_whatever_the_number_of_sides(sides: int) -> None:
    cone = foot().friction_cone("foot", 0.5, sides=sides)
    tangential = np.linspace(-1.0, 1.0, 401)
    held = [bool((cone.matrix[0] @ [x, 1.0] >= cone.lower[0] - EXACT).all()) for x in tangential]
    assert held == (np.abs(tangential) <= 0.5 + EXACT).tolist()


@pytest.mark.parametrize("sides", [3, 4, 8])
def test_a_cone_in_space_is_a_pyramid_with_its_edges_on_coulombs_cone(sides: int) -> None:
    force = ClosureForces(("x of foot", "y of foot", "z of foot"), np.zeros((1, 3)), np.eye(3)[None])
    cone = force.friction_cone("foot", 0.5, sides=sides)

    def held(radius: float, angle: Array) -> list[bool]:
        forces = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones_like(angle)])
        return [bool(one) for one in (cone.matrix[0] @ forces >= cone.lower[0][:, None]).all(axis=0)]

    around = np.linspace(-np.pi, np.pi, 97)
    edges = (2.0 * np.arange(sides) + 1.0) * np.pi / sides
    assert all(held(0.5 * (1.0 - 1e-9), edges))
    assert all(held(0.5 * (1.0 - 1e-9) * np.cos(np.pi / sides), around))
    assert not any(held(0.5 * (1.0 + 1e-9), around))


WRONG_CONES = [
    {"friction": "a"},
    {"friction": np.inf},
    {"sides": 3.5},
    {"sides": "x"},
    {"least": np.nan},
    {"least": [1, 2]},
]
WRONG_ROWS = [
    ([1, 2, 3], 0, 1),
    ("x", 0, 1),
    ([1, 0], 2, 1),
    ([1, 0], np.nan, 1),
    ([1, 0], [0, 0, 0], 1),
    ([np.nan, 0], 0, 1),
]


def test_cones_and_rows_of_no_sense_are_refused() -> None:
    for wrong in WRONG_CONES:
        with pytest.raises(InputError):
            foot().friction_cone(**{"closure": "foot", "friction": 0.5, **wrong})
    for direction, lower, upper in WRONG_ROWS:
        with pytest.raises(InputError):
            foot().rows(direction, lower, upper)
    with pytest.raises(InputError, match="no closure row 'y of foot'"):
        foot().friction_cone("foot", 0.5, normal="y")
    with pytest.raises(InputError, match="friction is -1"):
        foot().friction_cone("foot", -1.0)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (None, "rows is None"),
        (EffortRows(np.eye(4), np.zeros(4), np.ones(4)), r"rows is one EffortRows. Pass a list .* rows=\[squeeze\]"),
        ([EffortRows("x", 0, 1)], "matrix is not an array"),
        ([EffortRows(np.eye(4), np.ones(4), np.zeros(4))], "lower is above upper"),
        ([EffortRows(np.eye(3), np.zeros(3), np.ones(3))], "matrix has shape"),
        ([5], "Rows of efforts was expected"),
    ],
)
def test_rows_that_do_not_fit_are_refused(gripping: Gripping, rows: object, message: str) -> None:
    along, reduced, _, _ = gripping
    with pytest.raises(InputError, match=message):
        rp.distribute(reduced, rows=rows)
    with pytest.raises(InputError, match="RNEA dynamics along a motion"):
        closure_forces(along.robot)
