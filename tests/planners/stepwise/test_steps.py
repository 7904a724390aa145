"""Single steps of least effort on problems made up here, against scipy's solvers and the conditions of a minimum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

from redundancy_pin.arrays import Array
from redundancy_pin.planners.carrier_model import EffortModel
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.stepwise.step import AccelerationBox, optimise

HALF = 10.0
"""Largest acceleration of the boxes, m/s²."""


def step(c: Array, B: Array, C: Array) -> Array:
    """Return the u of least ‖c + B u + C u²‖ in the box |u| ≤ HALF.

    In one step of 1 s from rest at s = 0 position, speed and acceleration at its end have the same value u.
    """
    (m, k), zero = B.shape, np.zeros(B.shape[1])
    terms = np.zeros((2, m, k, 5))
    terms[1, ..., 1], terms[1, ..., 4] = C, B
    none = np.full(k, np.inf)
    limits = ResolvedLimits(
        tuple(f"c{j}" for j in range(k)),
        np.stack([-none, none], axis=1),
        none,
        np.full(k, HALF),
        none,
        none,
        none,
        none,
    )
    model = EffortModel(np.array([0.0, 1.0]), np.stack([c, c]), terms)
    box = AccelerationBox(limits, False, np.inf)
    made = optimise(model, 0, 1, CarrierState(0.0, zero, zero, zero), box)
    np.testing.assert_array_equal(made.lower[0], -HALF)
    np.testing.assert_array_equal(made.upper[0], HALF)
    return made.sdd[0]


def downhill(c: Array, B: Array, C: Array, u: Array) -> float:
    """Return the largest slope of ½ ‖r‖² at u that leads downhill inside the box, over the largest of J."""
    J = B + 2.0 * C * u
    slope = J.T @ (c + B @ u + C @ u**2)
    stuck = ((u == -HALF) & (slope > 0.0)) | ((u == HALF) & (slope < 0.0))
    return float(np.abs(np.where(stuck, 0.0, slope)).max() / np.abs(J).max())


@pytest.mark.parametrize("seed", range(40))
def test_curved_boxes_against_slsqp(seed: int) -> None:
    """One to three carriers, as many efforts or one more, and bends that leave one minimum; half of the bounds bind."""
    rng = np.random.default_rng(seed)
    k = 1 + seed % 3
    m = k + seed % 2
    B = rng.normal(size=(m, k))
    least = np.linalg.svd(B, compute_uv=False)[-1]
    c = HALF * rng.normal(size=m)
    C = 0.01 / HALF * rng.uniform(-1.0, 1.0, B.shape) * min(least, HALF * least**2 / np.linalg.norm(c))

    def cost(u: Array) -> tuple[float, Array]:
        r = c + B @ u + C @ (u * u)
        return float(r @ r), 2.0 * r @ (B + 2.0 * C * u)

    u = step(c, B, C)
    assert (np.abs(u) <= HALF).all()
    starts = (np.full(k, -HALF), np.full(k, HALF), np.zeros(k))
    found = [minimize(cost, u0, jac=True, bounds=[(-HALF, HALF)] * k, method="SLSQP", tol=1e-15).fun for u0 in starts]
    assert cost(u)[0] <= min(found) * (1.0 + 1e-8) + 1e-12
    assert downhill(c, B, C, u) <= 1e-8 * np.abs(c).max()


def test_boxes_of_condition_1e12_have_their_minimum() -> None:
    """Of BᵀB, as beside a singularity of the Gough platform, in 400 boxes; some against another method of scipy's.

    With its own pivots the solver calls one of ten of them infeasible.
    """
    rng = np.random.default_rng(0)
    for number in range(400):
        left, right = (np.linalg.qr(rng.normal(size=(6, 6)))[0] for _ in range(2))
        B = left @ np.diag([4.0, 0.4, 0.4, 4e-4, 4e-4, 4e-6]) @ right.T
        c = 100.0 * rng.normal(size=6)
        u = step(c, B, 0.0 * B)
        assert (np.abs(u) <= HALF).all()
        assert downhill(c, B, 0.0 * B, u) <= 1e-9 * np.abs(c).max()
        if number % 20 == 0:
            expected = lsq_linear(B, -c, (-HALF, HALF), tol=1e-14).x
            assert np.linalg.norm(c + B @ u) == pytest.approx(np.linalg.norm(c + B @ expected), rel=1e-9)
