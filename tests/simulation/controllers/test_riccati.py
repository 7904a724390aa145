"""Riccati equations against least squares over the whole horizon, the algebraic equations and the integrated one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag, solve_continuous_are, solve_discrete_are

from redundancy_pin.errors import InputError
from redundancy_pin.simulation.controllers.lqr import continuous_riccati, discrete_riccati

STATES, INPUTS, STEPS = 4, 2, 7


def system(seed=3):
    random = np.random.default_rng(seed)
    phi = np.eye(STATES) + 0.4 * random.normal(size=(STEPS, STATES, STATES))
    gamma = random.normal(size=(STEPS, STATES, INPUTS))
    root = random.normal(size=(STATES, STATES))
    return phi, gamma, root @ root.T, np.diag([0.3, 2.0]), np.diag(random.uniform(0.5, 2.0, STATES))


def test_gains_and_cost_are_those_of_least_squares_over_the_horizon():
    """All inputs at once: the states are linear in them, and the cost is a sum of squares."""
    phi, gamma, Q, R, final = system()
    gains = discrete_riccati(phi, gamma, Q, R, final)
    start = np.array([1.0, -2.0, 0.5, 0.7])
    free, forced, rows = start, np.zeros((STATES, STEPS * INPUTS)), []
    costs = [Q] * (STEPS - 1) + [final]
    for i in range(STEPS):
        free = phi[i] @ free
        forced = phi[i] @ forced
        forced[:, INPUTS * i : INPUTS * (i + 1)] = gamma[i]
        root = np.linalg.cholesky(costs[i]).T
        rows.append((root @ forced, root @ free))
    matrix = np.vstack([*(row for row, _ in rows), block_diag(*[np.sqrt(R)] * STEPS)])
    target = np.concatenate([*(value for _, value in rows), np.zeros(STEPS * INPUTS)])
    inputs = np.linalg.lstsq(matrix, -target, rcond=None)[0]
    assert inputs[:INPUTS] == pytest.approx(-gains.K[0] @ start, rel=1e-9)
    state = start
    for i in range(STEPS):
        assert inputs[INPUTS * i : INPUTS * (i + 1)] == pytest.approx(-gains.K[i] @ state, rel=1e-8, abs=1e-9)
        state = phi[i] @ state + gamma[i] @ inputs[INPUTS * i : INPUTS * (i + 1)]
    cost = float(np.sum((matrix @ inputs + target) ** 2)) + start @ Q @ start
    assert start @ gains.P[0] @ start == pytest.approx(cost, rel=1e-10)


def test_far_from_the_end_it_is_the_algebraic_equation():
    phi, gamma, Q, R, final = system()
    many = 400
    gains = discrete_riccati(np.repeat(phi[:1], many, 0), np.repeat(gamma[:1], many, 0), Q, R, final)
    assert np.allclose(gains.P[0], solve_discrete_are(phi[0], gamma[0], Q, R), rtol=1e-8)


def test_the_continuous_one_far_from_the_end_is_the_algebraic_equation():
    phi, gamma, Q, R, final = system()
    A, B = phi[0] - np.eye(STATES), gamma[0]
    many = 500
    gains = continuous_riccati(
        np.repeat(A[None], many, 0), np.repeat(B[None], many, 0), Q, R, final, np.full(many, 0.1)
    )
    P = solve_continuous_are(A, B, Q, R)
    assert np.allclose(gains.P[0], P, rtol=1e-8)
    assert np.allclose(gains.K[0], np.linalg.solve(R, B.T @ P), rtol=1e-8)


def test_the_continuous_one_is_the_integrated_differential_equation():
    phi, gamma, Q, R, final = system()
    A, B, step = phi - np.eye(STATES), gamma, 0.05

    def rate(t, flat):
        P = flat.reshape(STATES, STATES)
        i = min(int(t / step), STEPS - 1)
        return -(A[i].T @ P + P @ A[i] - P @ B[i] @ np.linalg.solve(R, B[i].T) @ P + Q).ravel()

    gains = continuous_riccati(A, B, Q, R, final, np.full(STEPS, step))
    P = final.ravel()
    for i in range(STEPS - 1, -1, -1):  # each interval on its own: A and B jump between them
        inside = (i + 0.5) * step

        def at_inside(t, y, inside=inside):
            return rate(inside, y)

        P = solve_ivp(at_inside, (step, 0.0), P, rtol=1e-11, atol=1e-12).y[:, -1]
        assert np.allclose(gains.P[i], P.reshape(STATES, STATES), rtol=1e-8, atol=1e-9)


def test_costs_are_symmetric_and_positive():
    phi, gamma, Q, R, final = system()
    gains = discrete_riccati(phi, gamma, Q, R, final)
    assert (gains.P.transpose(0, 2, 1) == gains.P).all()
    assert gains.least_eigenvalue > 0.0


@pytest.mark.parametrize("solve", [discrete_riccati, lambda *given: continuous_riccati(*given, np.ones(STEPS))])
def test_free_efforts_are_refused(solve):
    phi, gamma, Q, _, final = system()
    with pytest.raises(InputError, match=r"inputs is not positive definite.*positive weight"):
        solve(phi, gamma, Q, np.diag([1.0, -1e3]), final)


def test_a_negative_cost_is_refused():
    phi, gamma, Q, R, final = system()
    with pytest.raises(InputError, match=r"no positive solution"):
        discrete_riccati(phi[:1], 0.0 * gamma[:1], -10.0 * Q, R, 0.0 * final)
