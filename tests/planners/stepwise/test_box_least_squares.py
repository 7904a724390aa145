"""Least squares over a box, against every choice of active bounds, scipy's solvers, and the conditions of a minimum."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear, minimize

from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.planners.stepwise.optimiser import (
    damping_of,
    definiteness,
    minimise,
    optimality,
)

# scipy of Python 3.10 rounds out of its own bounds on the way, says so, and steps back inside
pytestmark = pytest.mark.filterwarnings("ignore:Values in x were outside bounds:RuntimeWarning")

SAME = 1e-9
"""Of minima of problems with entries of order one and condition numbers up to 1e3: conditioning times rounding."""


def solve(c, B, C, lower, upper, start=None, tolerance=1e-13):
    def linearised(u):
        u = np.array(u)
        return np.column_stack([B + 2.0 * C * u, c + B @ u + C @ (u * u)])

    slope = np.abs(B).max()
    return minimise(
        linearised,
        np.asarray(lower, dtype=float).tolist(),
        np.asarray(upper, dtype=float).tolist(),
        [0.0] * len(lower) if start is None else start,
        slope=slope,
        curvature=np.abs(C).max(),
        damping=damping_of(len(lower), slope),
        tolerance=tolerance,
    )


def best_of_all_faces(H, g, lower, upper):
    """The minimum of ½ dᵀ H d + gᵀ d in the box: the best feasible stationary point of all 3^k faces."""
    best, at = np.inf, None
    for sides in itertools.product((-1, 0, 1), repeat=len(g)):
        sides = np.array(sides)
        d = np.where(sides < 0, lower, np.where(sides > 0, upper, 0.0))
        if not np.isfinite(d).all():
            continue
        free = sides == 0
        if free.any():
            d[free] = np.linalg.solve(H[np.ix_(free, free)], -(g + H @ d)[free])
        if (d < lower - 1e-12).any() or (d > upper + 1e-12).any():
            continue
        value = 0.5 * d @ H @ d + g @ d
        if value < best:
            best, at = value, d
    return at


def random_problem(seed, k, extra, stiffness):
    rng = np.random.default_rng(seed)
    m = k + extra
    B = rng.normal(size=(m, k)) * np.geomspace(1.0, stiffness, k)
    while np.linalg.cond(B) > 1e3:
        B = rng.normal(size=(m, k))
    ends = np.sort(rng.normal(size=(2, k)), axis=0)
    return rng.normal(size=m) * 2.0, B, ends[0], ends[1], rng


@examples(60)
@given(
    seed=st.integers(0, 10**6),
    k=st.integers(1, 4),
    extra=st.integers(0, 2),
    stiffness=st.sampled_from([1.0, 0.1, 0.01]),
    half=st.booleans(),
)
def test_quadratic_programme_against_all_faces(seed, k, extra, stiffness, half):
    c, B, lower, upper, rng = random_problem(seed, k, extra, stiffness)
    if half:  # bounds on one side only
        upper[rng.integers(k)] = np.inf
    H, g = B.T @ B, B.T @ c
    expected = best_of_all_faces(H, g, lower, upper)
    got, _ = solve(c, B, np.zeros_like(B), lower, upper)
    np.testing.assert_allclose(got, expected, atol=SAME * np.linalg.cond(H), rtol=0)


@examples(80)
@given(seed=st.integers(0, 10**6), k=st.integers(1, 4), extra=st.integers(0, 2))
def test_affine_problem_against_lsq_linear(seed, k, extra):
    c, B, lower, upper, _ = random_problem(seed, k, extra, 1.0)
    expected = lsq_linear(B, -c, (lower, upper), method="bvls", tol=1e-15).x
    u, iterations = solve(c, B, np.zeros_like(B), lower, upper)
    assert iterations == 1
    value, least = np.linalg.norm(c + B @ u), np.linalg.norm(c + B @ expected)
    assert value <= least * (1.0 + 1e-12) + 1e-14
    np.testing.assert_allclose(u, expected, atol=1e-7, rtol=0)  # bvls stops by the cost: half the digits


@examples(40)
@given(seed=st.integers(0, 10**6), k=st.integers(1, 3), extra=st.integers(0, 1), bend=st.floats(1e-6, 0.03))
def test_curved_problem_against_slsqp(seed, k, extra, bend):
    c, B, lower, upper, rng = random_problem(seed, k, extra, 1.0)
    least_slope = np.linalg.svd(B, compute_uv=False)[-1]
    C = bend * rng.uniform(-1.0, 1.0, B.shape) * min(least_slope, least_slope**2 / np.linalg.norm(c))
    u, _ = solve(c, B, C, lower, upper)
    r = c + B @ u + C @ np.square(u)
    J = B + 2.0 * C * np.array(u)

    def cost(x):
        residual = c + B @ x + C @ (x * x)
        return residual @ residual, 2.0 * residual @ (B + 2.0 * C * x)

    least = min(
        minimize(cost, start, jac=True, bounds=list(zip(lower, upper, strict=True)), method="SLSQP", tol=1e-15).fun
        for start in (lower, upper, 0.5 * (lower + upper))
    )
    assert r @ r <= least * (1.0 + 1e-8) + 1e-14
    gradient = optimality(r[None], J[None], lower[None], upper[None], np.array(u)[None])
    assert gradient[0] <= 1e-11
    assert definiteness(r[None], J[None], C[None])[0] > 0.0
    assert (np.array(u) >= lower).all()
    assert (np.array(u) <= upper).all()


def test_bounds_are_met_bit_by_bit():
    lower, upper = np.array([0.1, -0.3]), np.array([0.7, 1.0 / 3.0])
    u, _ = solve(np.array([1.0, -1.0]) / 3.0 * 7.0, np.eye(2), np.zeros((2, 2)), lower, upper)
    assert u == [0.1, 1.0 / 3.0]


def test_a_component_that_is_not_felt_stays_at_the_guess():
    B = np.array([[2.0, 0.0], [1.0, 0.0]])
    u, _ = solve(np.array([1.0, 0.0]), B, np.zeros((2, 2)), [-9.0, -9.0], [9.0, 9.0], start=[0.0, 0.25])
    assert u[0] == pytest.approx(-0.4, abs=1e-12)
    assert u[1] == 0.25


def test_optimality_sees_a_wrong_point_and_ignores_the_bound_direction():
    J, r = np.eye(2)[None], np.array([[1.0, 0.0]])
    lower, upper = np.array([[0.0, 0.0]]), np.array([[1.0, 1.0]])
    assert optimality(r, J, lower, upper, np.array([[0.0, 0.5]]))[0] == 0.0
    assert optimality(r, J, lower, upper, np.array([[0.5, 0.5]]))[0] == 1.0
    assert optimality(r, J, lower, upper, np.array([[1.0, 0.5]]))[0] == 1.0
    assert optimality(-r, J, lower, upper, np.array([[0.0, 0.5]]))[0] == 1.0


def test_definiteness_sees_a_maximum():
    # r = 1 - u² at u = 0 : half its square has the second derivative -2
    assert definiteness(np.array([[1.0]]), np.zeros((1, 1, 1)), np.array([[[-1.0]]]))[0] == -1.0


def test_a_problem_whose_curvature_dominates_is_refused():
    # u² + 1 has no zero: Gauss–Newton jumps about
    with pytest.raises(RedundancyPinError, match="did not converge"):
        solve(np.array([1.0]), np.array([[1e-3]]), np.array([[1.0]]), [-10.0], [10.0], start=[0.3])


@pytest.mark.parametrize("seed", [2, 4, 34, 74])
def test_boxes_that_daqp_calls_infeasible_have_their_minimum(seed):
    """Condition 1e12 of BᵀB, as beside a singularity of the Gough platform; against another method of scipy's."""
    rng = np.random.default_rng(seed)
    left, right = (np.linalg.qr(rng.normal(size=(6, 6)))[0] for _ in range(2))
    B = left @ np.diag([4.0, 0.4, 0.4, 4e-4, 4e-4, 3e-6]) @ right.T
    c, lower, upper = 100.0 * rng.normal(size=6), np.zeros(6), np.full(6, 20.0)
    u = np.array(solve(c, B, 0.0 * B, lower, upper)[0])
    assert ((lower <= u) & (u <= upper)).all()
    assert optimality((c + B @ u)[None], B[None], lower[None], upper[None], u[None]) < 1e-9
    expected = lsq_linear(B, -c, (lower, upper), tol=1e-14).x
    assert np.linalg.norm(c + B @ u) == pytest.approx(np.linalg.norm(c + B @ expected), rel=1e-9)


@pytest.mark.parametrize("size", [2.0**-30, 1.0, 2.0**30])
def test_what_a_step_says_of_its_optimum_is_that_of_one_point_after_the_other(size):
    """In the unit of r, whatever that of u is: J is so many times as large where u is measured in larger units."""
    rng = np.random.default_rng(6)
    r, J, C = rng.normal(size=(40, 3)), rng.normal(size=(40, 3, 2)), 0.2 * rng.normal(size=(40, 3, 2))
    u = rng.uniform(-1.0, 1.0, (40, 2))
    lower, upper = np.full((40, 2), -1.0), np.full((40, 2), 1.0)
    u[:10, 0], u[10:20, 1], u[20:25] = -1.0, 1.0, [1.0, -1.0]
    left = optimality(r, J * size, lower / size, upper / size, u / size)
    curved = definiteness(r, J * size, C * size**2)
    for i in range(40):
        downhill = []
        for k in range(2):
            slope = sum(r[i, m] * J[i, m, k] for m in range(3))
            # downhill is where the slope is negative: not beyond an end of the box
            stuck = (slope > 0.0 and u[i, k] == -1.0) or (slope < 0.0 and u[i, k] == 1.0)
            downhill.append(0.0 if stuck else abs(slope))
        assert left[i] == pytest.approx(max(downhill) / max(abs(J[i].ravel())), rel=1e-12)

        def cost(x, i=i):
            return 0.5 * sum((r[i, m] + J[i, m] @ x + C[i, m] @ x**2) ** 2 for m in range(3))

        h, e = 1e-4, np.eye(2)
        hessian = [[(cost(h * (a + b)) - cost(h * (a - b)) - cost(h * (b - a)) + cost(-h * (a + b))) / (4.0 * h * h)
                    for a in e] for b in e]  # fmt: skip
        least, most = np.linalg.eigvalsh(hessian)
        assert curved[i] == pytest.approx(least / most, abs=1e-5)
