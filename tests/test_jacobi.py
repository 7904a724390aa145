"""Singular values by rotations, against prescribed ones and against LAPACK."""

import numpy as np
import pytest

from redundancy_pin.spectrum import jacobi_singular_values

ROUNDING = 1e-14
"""Relative to the largest singular value: some tens of roundings (2e-16)."""


def orthogonal(rng, samples, size):
    return np.linalg.qr(rng.normal(size=(samples, size, size)))[0]


def with_values(rng, samples, n, m, values):
    p = min(n, m)
    return orthogonal(rng, samples, n)[:, :, :p] * values @ orthogonal(rng, samples, m)[:, :p]


@pytest.mark.parametrize(
    "values",
    [
        pytest.param([1, 1, 1], id="triple"),
        pytest.param([1, 0.5, 0.5], id="small-pair"),
        pytest.param([1, 1, 0.5], id="large-pair"),
        pytest.param([1, 0.5, 0.5 - 1e-9], id="almost-pair"),
        pytest.param([1, 1e-3, 1e-6], id="graded"),
        pytest.param([1, 1, 1e-12], id="almost-singular"),
        pytest.param([1, 1, 0], id="singular"),
        pytest.param([1, 0, 0], id="rank-one"),
        pytest.param([0, 0, 0], id="zero"),
    ],
)
@pytest.mark.parametrize("shape", [(3, 3), (3, 5), (6, 3)])
def test_prescribed_singular_values(values, shape):
    rng = np.random.default_rng(1)
    sigmas, converged = jacobi_singular_values(with_values(rng, 500, *shape, np.array(values, float)))
    assert converged.all()
    assert sigmas == pytest.approx(np.broadcast_to(values, (500, 3)), rel=0.0, abs=ROUNDING)


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (5, 1), (2, 2), (2, 3), (3, 2), (3, 3), (4, 4)])
def test_agrees_with_lapack(shape):
    rng = np.random.default_rng(2)
    matrices = rng.normal(size=(300, *shape))
    values, converged = jacobi_singular_values(matrices)
    assert converged.all()
    assert values == pytest.approx(np.linalg.svd(matrices, compute_uv=False), rel=0.0, abs=1e2 * ROUNDING)


def test_small_singular_values_of_graded_columns_keep_all_digits():
    # columns of very different size, the angles between them moderate: rotations are exact relative to each value
    rng = np.random.default_rng(3)
    matrices = with_values(rng, 200, 3, 3, np.array([1.0, 0.8, 0.5])) * np.array([1.0, 1e-6, 1e-12])
    product = np.abs(np.linalg.det(matrices / np.array([1.0, 1e-6, 1e-12]))) * 1e-18
    assert jacobi_singular_values(matrices)[0].prod(axis=1) == pytest.approx(product, rel=1e-12, abs=0.0)


def test_does_not_touch_its_argument():
    matrices = np.random.default_rng(4).normal(size=(50, 3, 3))
    matrices.setflags(write=False)
    before = matrices.copy()
    jacobi_singular_values(matrices)
    assert np.array_equal(matrices, before)


def test_no_matrices():
    values, converged = jacobi_singular_values(np.empty((0, 3, 3)))
    assert values.shape == (0, 3)
    assert converged.shape == (0,)
