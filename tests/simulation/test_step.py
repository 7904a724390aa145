"""A step of an integrator as a function of time."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from numpy.polynomial import Polynomial
from scipy.integrate import DOP853

from redundancy_pin.simulation.events import Step


def test_estimates_are_exact_for_a_cubic_and_meet_both_ends() -> None:
    courses = [Polynomial([0.3, -1.0, 4.0, -7.0]), Polynomial([0.0, 2.0, 0.0, 5.0])]

    def at(t: float) -> tuple[np.ndarray, np.ndarray]:
        return np.array([c(t) for c in courses]), np.array([c.deriv()(t) for c in courses])

    start, end = 0.4, 0.9
    (y, f), fractions = at(end), (0.0, 0.2, 0.75, 1.0)
    step = Step(SimpleNamespace(t_old=start, t=end, y=y, f=f), at(start))
    expected = [at(start + x * (end - start))[0] for x in fractions]
    np.testing.assert_allclose(step.estimates(fractions), expected, atol=1e-14)
    np.testing.assert_array_equal(step.estimates((0.0, 1.0)), [at(start)[0], y])


def test_at_is_the_interpolant_of_the_integrator() -> None:
    solver = DOP853(lambda t, y: -y, 0.0, np.ones(1), 1.0, rtol=1e-11, atol=1e-12)
    before = solver.y, solver.f
    solver.step()
    step = Step(solver, before)
    for fraction in (0.0, 0.3, 1.0):
        np.testing.assert_allclose(step.at(fraction), np.exp(-step.time(fraction)), atol=1e-12)
