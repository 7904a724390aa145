"""The shortest vector under equations and bounds: Kuhn-Tucker conditions, other solvers, continuity."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog, lsq_linear, nnls

from redundancy_pin.arrays import RANK_TOLERANCE
from redundancy_pin.dynamics.allocation import shortest

ROUNDING = 1e-8
"""Relative to the answer; the conditions of the matrices drawn are below 1e3."""


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
    y, within = shortest(*given_)
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
    y, within = shortest(matrix, wanted, np.eye(5), lower, upper)
    best = lsq_linear(matrix, wanted, (lower, upper), method="bvls", tol=1e-14)
    assert within
    assert np.linalg.norm(matrix @ y - wanted) == pytest.approx(np.sqrt(2.0 * best.cost), rel=1e-6, abs=1e-7)


def test_without_bounds_it_is_the_pseudoinverse():
    matrix, wanted, bounded, _, _ = problem(1)
    y, within = shortest(matrix, wanted, bounded, np.full(5, -np.inf), np.full(5, np.inf))
    assert within
    assert np.allclose(y, np.linalg.pinv(matrix) @ wanted, atol=1e-12)


def test_it_is_continuous_where_bounds_begin_to_act_and_where_they_begin_to_forbid():
    matrix, wanted, bounded, lower, upper = problem(4)

    def along(shares):
        return np.array([shortest(matrix, share * wanted, bounded, lower, upper)[0] for share in shares])

    shares = np.linspace(0.0, 4.0, 401)
    determinants = along(shares)
    missed = np.linalg.norm(determinants @ matrix.T - shares[:, None] * wanted, axis=1)
    assert missed[0] < ROUNDING  # met at first,
    assert missed[-1] > 0.1  # and not at last
    steps = np.abs(np.diff(determinants, axis=0)).max(axis=1)
    # a jump would not become smaller where one looks more closely
    for i in np.argsort(steps)[-5:]:
        closer = np.abs(np.diff(along(np.linspace(shares[i], shares[i + 1], 41)), axis=0)).max()
        assert closer < 0.1 * steps[i]


def test_bounds_that_contradict_one_another_are_told():
    bounded = np.array([[1.0, 0.0], [1.0, 0.0]])  # singular
    y, within = shortest(np.ones((1, 2)), np.ones(1), bounded, np.array([1.0, -2.0]), np.array([2.0, -1.0]))
    assert not within
    assert np.allclose(y, 0.5)


def test_a_bound_that_nothing_moves_counts_as_it_stands():
    none = np.zeros((1, 2))
    assert shortest(np.ones((1, 2)), np.ones(1), none, np.array([-1.0]), np.array([1.0]))[1]
    assert not shortest(np.ones((1, 2)), np.ones(1), none, np.array([0.5]), np.array([1.0]))[1]


def test_what_the_equations_leave_open_is_shortest_also_where_bounds_forbid_them():
    """y₀ = 2 is out of reach; y₁ + y₂ ≥ 3 is met by the shortest pair, (3/2, 3/2)."""
    bounded = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    lower, upper = np.array([-1.0, 3.0, -9.0]), np.array([1.0, 9.0, 9.0])
    y, within = shortest(np.array([[1.0, 0.0, 0.0]]), np.array([2.0]), bounded, lower, upper)
    assert within
    np.testing.assert_allclose(y, [1.0, 1.5, 1.5], atol=1e-6)


@pytest.mark.parametrize(("size", "regular"), [(0.7, False), (1.4, True)])
def test_bounds_count_as_singular_by_their_condition_number(size, regular):
    """Two of them differ in the second unknown by a little, e: their condition number is 2 / e."""
    bounded = np.array([[1.0, 0.0], [1.0, 2.0 * size * RANK_TOLERANCE]])
    y, within = shortest(np.array([[1.0, 0.0]]), np.array([3.0]), bounded, np.full(2, -1.0), np.ones(2))
    assert within == regular
    assert y[0] == pytest.approx(1.0 if regular else 3.0, abs=1e-6)
