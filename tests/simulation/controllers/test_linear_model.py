"""Zero-order hold with a delay, against integration of the differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from redundancy_pin.simulation.controllers.lqr import LinearModel, sampled_model

PERIOD = 0.01


def model_of(change: float) -> LinearModel:
    random = np.random.default_rng(5)
    A, B = random.normal(size=(4, 4)), random.normal(size=(4, 2))
    other = random.normal(size=(4, 4))
    t = np.array([0.0, 1.0])
    return LinearModel(t, np.array([A, A + change * other]), np.array([B, B + change * other[:, :2]]))


def distance(model: LinearModel, period: float, delay: float) -> float:
    """How far one step of the hold is from the integrated equation."""
    sampled = sampled_model(model, 0.0, 1.0, period, delay)
    i, z, old, new = 4, np.array([1.0, 0.5, -0.3, 2.0]), np.array([0.4, -1.0]), np.array([2.0, 0.3])
    start = sampled.t[i]

    def rate(t, y, u):
        A, B = model.at(np.array([t]))
        return A[0] @ y + B[0] @ u

    y = z
    for begin, end, u in ((0.0, delay, old), (delay, period, new)):
        if end > begin:
            y = solve_ivp(rate, (start + begin, start + end), y, args=(u,), rtol=1e-12, atol=1e-14).y[:, -1]
    xi = z if delay == 0.0 else np.concatenate([z, old])
    after = sampled.transition[i] @ xi + sampled.input[i] @ new
    if delay:
        assert (after[4:] == new).all()
    return float(np.abs(after[:4] - y).max())


@pytest.mark.parametrize("delay", [0.0, 0.004, PERIOD])
def test_the_hold_is_the_integrated_equation(delay):
    assert distance(model_of(0.0), PERIOD, delay) < 1e-11


def test_the_model_may_change_within_a_period():
    """A and B of the middle leave an error of third order in the period: an eighth for half of it."""
    coarse, fine = distance(model_of(1.0), 0.04, 0.02), distance(model_of(1.0), 0.02, 0.01)
    assert 5.0 < coarse / fine < 11.0


def test_outside_its_nodes_the_model_keeps_the_ends():
    model = model_of(0.5)
    A, B = model.at(np.array([-1.0, 0.5, 9.0]))
    assert (A[0] == model.A[0]).all()
    assert np.allclose(A[1], 0.5 * (model.A[0] + model.A[1]))
    assert np.allclose(B[2], model.B[1])
