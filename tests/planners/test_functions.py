"""Efforts of a plan between its samples: what is prescribed, what is preferred, and W τ = f everywhere else."""

from __future__ import annotations

import numpy as np
from prescribed import reduced

from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, continuous_motion


def functions(**options: object) -> PlanFunctions:
    parked = PiecewisePolynomial.constant(np.zeros(1), 0.0, 1.0)
    return PlanFunctions(continuous_motion(reference.corner()), parked, **options)


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
