"""Efforts of a plan between its samples: what is prescribed, what is preferred, and W τ = f everywhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from prescribed import reduced

from redundancy_pin.planners.functions import DEGREE, PlanFunctions
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, chebyshev_times


def functions(**options: object) -> PlanFunctions:
    parked = PiecewisePolynomial.constant(np.zeros(1), 0.0, 1.0)
    return PlanFunctions(as_motion(reference.corner()), parked, **options)


def test_of_all_efforts_the_nearest_to_the_preferred_ones_are_taken() -> None:
    random = np.random.default_rng(2)
    along = reduced(random.normal(size=(5, 2, 3)), random.normal(size=(5, 2)))
    wanted = np.array([1.0, -2.0, 0.5])
    end = float(along.t[-1]) + 1.0
    tau = functions(preferred=PiecewisePolynomial.constant(wanted, 0.0, end)).efforts(along)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", along.W, tau), along.f, atol=1e-12)
    null = np.linalg.svd(along.W)[2][:, -1]
    np.testing.assert_allclose(np.einsum("nj,nj->n", null, tau - wanted), 0.0, atol=1e-12)


def test_prescribed_efforts_stand_over_their_own_interval_only() -> None:
    along = reduced([[[2.0]]] * 4, [[6.0]] * 4)
    part = PiecewisePolynomial.constant(np.array([7.0]), float(along.t[1]), float(along.t[2]))
    assert functions(prescribed=(part,)).efforts(along)[:, 0].tolist() == [3.0, 7.0, 7.0, 3.0]


def test_beside_a_singular_instant_the_efforts_are_continued_and_rounding_is_not_magnified() -> None:
    """τ = (1 + t)² after a singular instant beside which W, f and its rounding are all that W⁻¹ f has to go by."""
    edges = np.array([0.0, 0.01])
    t = chebyshev_times(edges, DEGREE)
    W, tau = t, (1.0 + t) ** 2
    rounding = 1e-9 * np.where(t < 0.003, W.max(), 0.0) * np.resize([1.0, -1.0], len(t))
    along = replace(reduced(W[:, None, None], (W * tau + rounding)[:, None]), t=t)
    naive = (W * tau + rounding) / W - tau
    for limits in ({0.0: np.array([1.0])}, {0.0 + 1e-15: np.array([1.0])}):
        ours = functions().effort_polynomials(edges, along, limits)(t)[:, 0] - tau
        assert np.abs(naive).max() > 5e-8
        assert np.abs(ours).max() < 1e-12
