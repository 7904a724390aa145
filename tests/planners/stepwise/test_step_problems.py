"""The problem of a step: efforts at its end and their slopes by the acceleration, and when its minimum is exact."""

from __future__ import annotations

import math

import numpy as np
import pytest

from redundancy_pin.planners.carrier_model import EffortModel
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.stepwise.optimiser import (
    AccelerationBox,
    StepProblems,
    damping_of,
    minimise,
    optimise,
    step_problems,
)
from redundancy_pin.robot import CarrierLimits

RNG = np.random.default_rng(8)
T = np.array([1.0, 1.1, 1.1, 1.3, 1.35])
"""s, with an instant of two sides; steps of 0.1, 0.2 and 0.05 s between the others."""

AT = np.array([0, 1, 3, 4])
M, K = 3, 2
TAU0, TERMS, TARGET = RNG.normal(size=(5, M)), RNG.normal(size=(5, M, K, 5)), RNG.normal(size=(5, M))
TERMS[..., :4] *= 8.0  # so that terms of the state count beside those of s̈

ROUNDING = 1e-12


def problems() -> StepProblems:
    model = EffortModel(T, TAU0, TERMS)
    return step_problems(model, TARGET, AT)


def missed(step: int, s: np.ndarray, sd: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Efforts less their target at the end of a step of backward differences, term by term."""
    i, h = AT[step + 1], T[AT[step + 1]] - T[AT[step]]
    sd = sd + h * u
    s = s + h * sd
    left = TAU0[i] - TARGET[i]
    for j in range(K):
        left = left + TERMS[i, :, j] @ np.array([s[j], s[j] ** 2, sd[j], s[j] * sd[j], u[j]])
    return left


def test_efforts_at_the_end_of_a_step_and_their_slopes() -> None:
    made = problems()
    np.testing.assert_allclose(made.h, [0.1, 0.2, 0.05])
    np.testing.assert_array_equal(made.t, T[AT])
    for step in range(3):
        s, sd, u = RNG.normal(size=(3, K))
        h = made.h[step]
        ends = (s + h * (sd + h * u), sd + h * u, u)
        (residual,), (slopes,) = made.linearised(step, *(part[None] for part in ends))
        np.testing.assert_allclose(residual, missed(step, s, sd, u), atol=ROUNDING * 100.0)
        # r(u + d) = r + J d + C d², with no terms of two carriers: exact for any d
        for d in RNG.normal(size=(4, K)):
            expected = residual + slopes @ d + made.C[step] @ d**2
            np.testing.assert_allclose(missed(step, s, sd, u + d), expected, atol=ROUNDING * 100.0)


def test_sizes_are_those_of_slopes_curvatures_and_efforts() -> None:
    made = problems()
    rest = np.zeros((3, K))
    residual, slopes = made.linearised(0, rest, rest, rest)
    np.testing.assert_allclose(made.slope, np.abs(slopes).max(axis=(1, 2)), rtol=1e-12)
    np.testing.assert_allclose(made.curvature, np.abs(made.C).max(axis=(1, 2)), rtol=1e-12)
    assert made.tolerance == pytest.approx(1e-9 * np.abs(residual).max())
    model = EffortModel(T, TARGET, TERMS)  # nothing to be done: slopes say how large efforts may become
    assert step_problems(model, TARGET, AT).tolerance == pytest.approx(1e-9 * made.slope.max())


def test_each_step_begins_where_the_one_before_it_ended() -> None:
    limits = CarrierLimits(-9.0, 9.0, 9.0, 3.0, math.inf)
    box = AccelerationBox(("a", "b"), (limits, limits), False, math.inf)
    s, sd = np.array([0.3, -0.2]), np.array([0.5, 0.1])
    made = problems()
    steps = optimise(made, 1, 3, CarrierState(1.1, s, sd, np.zeros(K)), box)
    assert len(steps.s) == 2
    for i, h in enumerate(made.h[1:]):
        np.testing.assert_allclose(steps.sd[i], sd + h * steps.sdd[i], atol=ROUNDING)
        np.testing.assert_allclose(steps.s[i], s + h * steps.sd[i], atol=ROUNDING)
        np.testing.assert_allclose([steps.lower[i], steps.upper[i]], [[-3.0] * K, [3.0] * K], atol=ROUNDING)
        # no move inside the box does better
        least = (missed(1 + i, s, sd, steps.sdd[i]) ** 2).sum()
        for move in 1e-3 * RNG.normal(size=(40, K)):
            beside = np.clip(steps.sdd[i] + move, -3.0, 3.0)
            assert (missed(1 + i, s, sd, beside) ** 2).sum() >= least * (1.0 - ROUNDING)
        s, sd = steps.s[i], steps.sd[i]


@pytest.mark.parametrize("unit", [0.01, 1.0, 100.0])
def test_it_ends_as_soon_as_what_a_step_misses_is_below_the_tolerance(unit: float) -> None:
    """A step d leaves C (d² + 2 d ‖r‖ / slope) of the gradient; the steps here without bounds, by hand."""
    c, B, C = np.array([1.0, 2.0, -0.5]), np.array([[3.0], [-1.0], [0.5]]), np.array([[0.4], [0.3], [-0.2]])
    c, B, C = c, B / unit, C / unit**2  # u in another unit
    slope, curvature, x, left = float(np.abs(B).max()), float(np.abs(C).max()), np.zeros(1), []
    for _ in range(4):
        r, J = c + B @ x + C @ x**2, B + 2.0 * C * x
        d = -float((J[:, 0] @ r) / (J[:, 0] @ J[:, 0]))
        left.append(curvature * abs(d) * (abs(d) + 2.0 * float(np.linalg.norm(r)) / slope))
        x = x + d
    assert left[0] > 1.1 * left[1] > 1.2 * left[2] > 1.3 * left[3]

    def iterations(tolerance: float) -> int:
        return minimise(
            lambda u: np.column_stack([B + 2.0 * C * u[0], c + B @ u + C @ np.square(u)]),
            [-math.inf],
            [math.inf],
            [0.0],
            slope=slope,
            curvature=curvature,
            damping=damping_of(1, slope),
            tolerance=tolerance,
        )[1]

    for number, missing in enumerate(left, 1):
        assert iterations(1.01 * missing) == number
        assert iterations(0.99 * missing) == number + 1
