"""Sharing out a force by efforts and carriers within bounds: exact, of least weighted deviation, or a status."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.optimize import linprog, lsq_linear, minimize, nnls

from redundancy_pin.arrays import RANK_TOLERANCE
from redundancy_pin.dynamics.allocation import FORCE_TOLERANCE, CarrierForces, allocate, factorise, shortest
from redundancy_pin.status import SampleStatus

ROUNDING = 1e-8
"""Relative; matrices with entries in [-3, 3] whose smallest singular value is above 1e-3."""

entries = st.floats(-3.0, 3.0)


def shared(W, coupling, force, planned=(0.0, 0.0), **changed):
    settings = {"effort_scale": np.ones(2), "carrier_scale": np.full(2, 0.1), "row_scale": np.ones(2), **changed}
    return allocate(*(np.array(part, dtype=float) for part in (W, coupling, force, planned)), **settings)


@given(
    hnp.arrays(float, (2, 4), elements=entries),
    hnp.arrays(float, 2, elements=entries),
    hnp.arrays(float, 4, elements=st.floats(0.01, 10.0)),
)
def test_the_force_is_brought_up_with_the_least_weighted_deviation(matrix, force, scale):
    if np.linalg.svd(matrix * scale)[1][-1] < 1e-3:
        return
    planned = np.array([0.3, -0.2])
    allocation = shared(matrix[:, :2], matrix[:, 2:], force, planned, effort_scale=scale[:2], carrier_scale=scale[2:])
    assert allocation.status is SampleStatus.OK
    size = 1.0 + np.abs(allocation.tau).max() + np.abs(allocation.deviation).max()
    assert np.allclose(
        matrix[:, :2] @ allocation.tau - matrix[:, 2:] @ allocation.deviation, force, atol=ROUNDING * size
    )
    # the least cost is stationary along everything that leaves the force as it is
    gradient = np.concatenate([allocation.tau - planned, allocation.deviation]) / scale**2
    full = np.concatenate([matrix[:, :2], -matrix[:, 2:]], axis=1)
    null = np.linalg.svd(full)[2][np.linalg.matrix_rank(full) :]
    assert np.abs(null @ gradient).max(initial=0.0) <= ROUNDING * (1.0 + np.abs(gradient).max())


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(("off", "status"), [(1e-4, SampleStatus.OK), (-1e-4, SampleStatus.SINGULAR_INCONSISTENT)])
def test_next_to_the_threshold_of_rank(size, off, status):
    """It is 1e-9 of the largest singular value, however large that is; the rounding of 1e9 times the force is 1e-7."""
    left, right = (np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0] for seed in (1, 2))
    W = left * np.array([1.0, 0.5, (1.0 + off) * 1e-9]) * size @ right
    force = 1e-6 * size * left[:, 2]
    allocation = shared(
        W,
        np.zeros((3, 0)),
        force,
        np.zeros(3),
        effort_scale=np.ones(3),
        carrier_scale=np.zeros(0),
        row_scale=np.ones(3),
    )
    assert allocation.status is status
    along = right[2] @ allocation.tau * (1.0 + off) * 1e-3
    assert along == pytest.approx(1.0 if status is SampleStatus.OK else 0.0, abs=1e-5)


@pytest.mark.parametrize(
    ("W", "coupling", "force", "status"),
    [
        ([[1.0, 1.0], [0.0, 0.0]], [[0.3, 0.0], [0.0, 0.0]], [1.0, 0.25], SampleStatus.SINGULAR_INCONSISTENT),
        ([[1.0, 1.0], [0.0, 0.0]], [[0.3, 0.0], [0.0, 0.0]], [1.0, 0.0], SampleStatus.OK),
        ([[1.0], [0.0]], np.zeros((2, 0)), [1.0, 0.25], SampleStatus.UNDERACTUATED),  # all the rank of one column
    ],
)
def test_a_direction_that_nobody_reaches_is_reported_with_what_is_missing(W, coupling, force, status):
    m, k = np.shape(W)[1], np.shape(coupling)[1]
    allocation = shared(W, coupling, force, np.zeros(m), effort_scale=np.ones(m), carrier_scale=np.full(k, 0.1))
    assert allocation.status is status
    assert allocation.residual == pytest.approx(force[1])
    assert allocation.balanced == (status is SampleStatus.OK)
    assert allocation.margin < 1e-12


def within(carriers_limit, **changed):
    """Two carriers that weigh 2 kg and 1 kg, with some coupling, and need 0.4 N and −0.3 N for their plan."""
    forces = CarrierForces(np.array([0.4, -0.3]), np.array([[2.0, 0.3], [0.3, 1.0]]), np.array(carriers_limit))
    return forces, {"carrier_scale": np.array([0.3, 0.2]), "carriers": forces, **changed}


def best_within(forces, objective, bounds=None, *equal):
    """Return scipy's own optimum over (τ, δ), carrier forces within their limits."""
    inside = [
        {"type": "ineq", "fun": lambda u, sign=sign: forces.limit - sign * (forces.planned + forces.mass @ u[2:])}
        for sign in (1.0, -1.0)
    ]
    return minimize(objective, np.zeros(4), bounds=bounds, constraints=[*equal, *inside], options={"ftol": 1e-14})


@pytest.mark.parametrize("weak", [False, True])
def test_what_a_limit_of_the_carriers_cuts_off_is_left_to_the_main_actuators(weak):
    """Least weighted deviation, exact force, carrier forces within limits; and the second effort within its own."""
    W, coupling = np.array([[0.05, 1.0], [0.2, 0.3]]), np.array([[-1.0, 0.2], [-0.5, -1.0]])
    limit, scale = np.array([np.inf, 0.9 if weak else np.inf]), np.array([0.7, 1.6, 0.3, 0.2])
    force, (forces, settings) = np.array([1.0, 0.4]), within([0.5, 0.4], effort_scale=scale[:2])
    allocation = shared(W, coupling, force, effort_limit=limit, **settings)
    free = shared(W, coupling, force, effort_scale=scale[:2], carrier_scale=scale[2:])
    assert not forces.allow(free.deviation)
    full = np.hstack([W, -coupling])
    exact = {"type": "eq", "fun": lambda u: full @ u - force}
    bounds = [(-most, most) if np.isfinite(most) else (None, None) for most in [*limit, np.inf, np.inf]]
    best = best_within(forces, lambda u: float(np.sum((u / scale) ** 2)), bounds, exact)
    assert (allocation.status, allocation.saturated) == (SampleStatus.OK, True)
    assert np.concatenate([allocation.tau, allocation.deviation]) == pytest.approx(best.x, abs=1e-5)
    assert np.abs(forces.of(allocation.deviation)).max() <= 0.5
    assert weak or np.abs(allocation.tau).max() > np.abs(free.tau).max()
    assert (allocation.tau[1] == pytest.approx(0.9)) == weak


def test_carriers_and_efforts_at_their_limits_miss_least():
    forces, settings = within([0.5, 0.5], effort_limit=np.array([0.2, 0.2]))
    coupling, force = np.array([[-1.0, 0.0], [0.0, -1.0]]), np.array([3.0, 0.0])
    allocation = shared(np.eye(2), coupling, force, **settings)
    assert allocation.status is SampleStatus.BOUND_INFEASIBLE
    assert allocation.balanced  # every direction has an effect: it is the limits that fall short
    bounds = [(-0.2, 0.2)] * 2 + [(None, None)] * 2
    best = best_within(forces, lambda u: float(np.sum((force - u[:2] - u[2:]) ** 2)), bounds)
    assert allocation.residual == pytest.approx(np.sqrt(best.fun), rel=1e-6)
    assert np.abs(allocation.tau).max() <= 0.2
    assert forces.of(allocation.deviation) == pytest.approx(
        forces.planned + forces.mass @ allocation.deviation, abs=1e-9
    )


@given(hnp.arrays(float, (2, 4), elements=entries), hnp.arrays(float, 4, elements=st.floats(0.01, 10.0)))
def test_the_margin_is_what_the_worst_direction_gets_from_deviations_of_the_size_of_the_scales(matrix, scale):
    row_scale = np.array([1.0, 0.3])
    margin = shared(
        *(matrix[:, :2], matrix[:, 2:], np.zeros(2)),
        **{"effort_scale": scale[:2], "carrier_scale": scale[2:], "row_scale": row_scale},
    ).margin
    angle = np.linspace(0.0, np.pi, 2001)
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=1) / row_scale
    most = np.linalg.norm(directions @ matrix * scale, axis=1)  # of y · (A u), |u / scale| = 1
    assert margin <= most.min() * (1.0 + ROUNDING) + ROUNDING
    assert margin >= most.min() - most.max() * (angle[1] - angle[0])


def test_with_fewer_unknowns_than_coordinates_some_direction_gets_nothing():
    allocation = shared(
        *([[2.0], [0.0], [0.0]], [[0.0], [3.0], [0.0]], [2.0, 3.0, 0.0], [0.0]),
        **{"effort_scale": np.ones(1), "carrier_scale": np.ones(1), "row_scale": np.ones(3)},
    )
    assert allocation.status is SampleStatus.OK
    assert allocation.margin == 0.0


@pytest.mark.parametrize("size", [0.0, 3.0, 300.0])
@pytest.mark.parametrize(("share", "status"), [(0.9, SampleStatus.OK), (1.1, SampleStatus.SINGULAR_INCONSISTENT)])
def test_what_is_missing_counts_from_a_share_of_the_force_and_of_a_newton_on(size, share, status):
    """In the second direction nobody has an effect; it is told in N of the scaled equations."""
    missing = share * FORCE_TOLERANCE * (1.0 + size)
    W, coupling = [[1.0, 0.0], [0.0, 0.0]], np.zeros((2, 2))
    allocation = shared(W, coupling, [size, 0.25 * missing], row_scale=np.array([1.0, 0.25]))
    assert allocation.status is status
    assert allocation.residual == pytest.approx(missing, rel=1e-5, abs=0.0)  # of 300 N rounding is 1e-13


@pytest.mark.parametrize(("over", "status"), [(0.5, "ok"), (1.5, "ok"), (2.5, "bound_infeasible")])
def test_limits_are_fallen_short_of_from_the_same_share_on(over, status):
    """A force of 1 N, of which the limit leaves a little; 2e-9 N is the tolerance."""
    missing = over * FORCE_TOLERANCE
    allocation = shared(np.eye(2), np.zeros((2, 2)), [1.0 + missing, 0.0], effort_limit=np.ones(2))
    assert (allocation.status.label, allocation.saturated) == (status, True)
    assert allocation.residual == pytest.approx(missing, rel=1e-3)
    assert allocation.tau.max() == 1.0


def test_efforts_and_carrier_forces_may_be_as_large_as_their_limits():
    """Numbers that are exact in binary: the limits hold to the last digit."""
    free = shared(np.eye(2), np.zeros((2, 2)), [1.0, -0.5], effort_limit=np.array([1.0, 0.5]))
    assert free.status is SampleStatus.OK
    assert free.tau.tolist() == [1.0, -0.5]
    forces = CarrierForces(np.array([1.0, -0.5]), np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([3.25, 0.5]))
    assert forces.allow(np.array([1.0, 0.5]))
    assert not forces.allow(np.array([1.0, 0.5 + 1e-9]))
    assert not forces.allow(np.array([-2.5, 0.25]))  # −3.875 N
    assert forces.of(np.array([1.0, 0.5])).tolist() == [3.25, 0.5]
    assert forces.of(np.array([-2.5, -1.0])).tolist() == [-3.25, -0.5]


# --- the shortest vector under equations and bounds: Kuhn-Tucker conditions, other solvers, continuity


def problem(seed: int, n: int = 2, p: int = 5, b: int = 5):
    random = np.random.default_rng(seed)
    matrix, bounded = random.uniform(-1.0, 1.0, (n, p)), random.uniform(-1.0, 1.0, (b, p)) + np.eye(b, p)
    middle, half = random.uniform(-0.5, 0.5, b), random.uniform(0.1, 1.5, b)
    return matrix, matrix @ random.uniform(-3.0, 3.0, p), bounded, middle - half, middle + half


def possible(matrix, wanted, bounded, lower, upper) -> bool:
    """By the simplex method."""
    optimum = linprog(
        np.zeros(matrix.shape[1]),
        A_ub=np.concatenate([bounded, -bounded]),
        b_ub=np.concatenate([upper, -lower]),
        A_eq=matrix,
        b_eq=wanted,
        bounds=(None, None),
    )
    return optimum.status == 0


@given(st.integers(0, 10**6))
def test_it_meets_the_conditions_of_kuhn_and_tucker_or_nothing_does(seed):
    matrix, wanted, bounded, lower, upper = given_ = problem(seed)
    if np.linalg.cond(bounded) > 1e2 or np.linalg.cond(matrix) > 1e2:
        return
    y, within = shortest(factorise(matrix), *given_[1:])
    assert within
    size = 1.0 + np.abs(y).max()
    here = bounded @ y
    assert (here >= lower - ROUNDING * size).all()
    assert (here <= upper + ROUNDING * size).all()
    met = np.abs(matrix @ y - wanted).max() <= ROUNDING * size
    assert met == possible(*given_)
    if met:
        # y = Aᵀ μ + C_lᵀ λ_l − C_uᵀ λ_u with λ ≥ 0 for the bounds that are active alone
        at_lower, at_upper = here - lower < 1e-7 * size, upper - here < 1e-7 * size
        rows = [bounded[at_lower], -bounded[at_upper], matrix, -matrix]
        assert nnls(np.concatenate(rows).T, y)[1] <= 1e-6 * size


@given(st.integers(0, 10**6))
def test_where_nothing_meets_the_equations_it_misses_least(seed):
    """Bounds on y itself: scipy's own solver knows the least residual."""
    matrix, wanted, _, lower, upper = problem(seed)
    wanted = 5.0 * wanted
    if np.linalg.cond(matrix) > 1e2:
        return
    y, within = shortest(factorise(matrix), wanted, np.eye(5), lower, upper)
    best = lsq_linear(matrix, wanted, (lower, upper), method="bvls", tol=1e-14)
    assert within
    assert np.linalg.norm(matrix @ y - wanted) == pytest.approx(np.sqrt(2.0 * best.cost), rel=1e-6, abs=1e-7)


def test_bounds_that_contradict_one_another_are_told():
    bounded = np.array([[1.0, 0.0], [1.0, 0.0]])  # singular
    y, within = shortest(factorise(np.ones((1, 2))), np.ones(1), bounded, np.array([1.0, -2.0]), np.array([2.0, -1.0]))
    assert not within
    assert np.allclose(y, 0.5)


def test_a_bound_that_nothing_moves_counts_as_it_stands():
    none = np.zeros((1, 2))
    assert shortest(factorise(np.ones((1, 2))), np.ones(1), none, np.array([-1.0]), np.array([1.0]))[1]
    assert not shortest(factorise(np.ones((1, 2))), np.ones(1), none, np.array([0.5]), np.array([1.0]))[1]


def test_what_the_equations_leave_open_is_shortest_also_where_bounds_forbid_them():
    """y₀ = 2 is out of reach; y₁ + y₂ ≥ 3 is met by the shortest pair, (3/2, 3/2)."""
    bounded = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    lower, upper = np.array([-1.0, 3.0, -9.0]), np.array([1.0, 9.0, 9.0])
    y, within = shortest(factorise(np.array([[1.0, 0.0, 0.0]])), np.array([2.0]), bounded, lower, upper)
    assert within
    np.testing.assert_allclose(y, [1.0, 1.5, 1.5], atol=1e-6)


@pytest.mark.parametrize(("size", "regular"), [(0.7, False), (1.4, True)])
def test_bounds_count_as_singular_by_their_condition_number(size, regular):
    """Two of them differ in the second unknown by a little, e: their condition number is 2 / e."""
    bounded = np.array([[1.0, 0.0], [1.0, 2.0 * size * RANK_TOLERANCE]])
    y, within = shortest(factorise(np.array([[1.0, 0.0]])), np.array([3.0]), bounded, np.full(2, -1.0), np.ones(2))
    assert within == regular
    assert y[0] == pytest.approx(1.0 if regular else 3.0, abs=1e-6)
