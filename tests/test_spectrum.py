"""Margin, rank, condition and null directions of matrices whose singular values and vectors are prescribed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from redundancy_pin.spectrum import null_directions, scaled, spectrum_of

MARGIN_TOLERANCE = 1e-10
"""The promised accuracy of a margin, relative to the largest singular value."""

FEW = 7


def orthogonal(rng, samples, size):
    return np.linalg.qr(rng.normal(size=(samples, size, size)))[0]


def with_values(rng, samples, n, m, values):
    p = min(n, m)
    return orthogonal(rng, samples, n)[:, :, :p] * values @ orthogonal(rng, samples, m)[:, :p]


@pytest.mark.parametrize("smallest", [1.0, 0.3, 1e-3, 1e-6, 1e-9, 1e-13, 0.0])
@pytest.mark.parametrize("shape", [(1, 2), (2, 2), (2, 4), (3, 2), (3, 3), (4, 4), (6, 6)])
def test_margin_is_the_prescribed_smallest_singular_value(smallest, shape):
    rng = np.random.default_rng(1)
    values = np.linspace(4.0, 1.0, min(shape))
    values[-1] = smallest
    margin = spectrum_of(with_values(rng, FEW, *shape, values)).margin
    assert margin == pytest.approx(np.full(FEW, smallest), rel=0.0, abs=MARGIN_TOLERANCE * 4.0)


def test_margin_along_a_path_through_a_singularity_is_the_absolute_value_of_the_distance():
    # diag(1, 1, d) seen through two fixed rotations: the margin is |d| on both sides, with a kink at 0
    rng = np.random.default_rng(2)
    distance = np.linspace(-1e-6, 1e-6, 1001)
    left, right = orthogonal(rng, 2, 3)
    matrices = left * np.stack([np.ones_like(distance), np.ones_like(distance), distance], axis=1)[:, None, :] @ right
    assert spectrum_of(matrices).margin == pytest.approx(np.abs(distance), rel=0.0, abs=1e-15)


def test_condition_number_of_a_two_rpr_is_the_cotangent_of_half_the_angle_between_its_legs():
    # Parsa 2014, section 3.2: the rows of J are the unit vectors of the legs
    angle = np.radians(np.concatenate([np.linspace(1.0, 90.0, 90), [0.0]]))
    J = np.stack([np.stack([np.ones(91), np.zeros(91)], 1), np.stack([np.cos(angle), np.sin(angle)], 1)], 1)
    condition = spectrum_of(J).condition
    assert condition[:-1] == pytest.approx(1.0 / np.tan(angle[:-1] / 2.0), rel=1e-11)
    assert np.isposinf(condition[-1])


def test_condition_of_a_zero_matrix_is_infinite():
    assert np.isposinf(spectrum_of(np.zeros((1, 2, 2))).condition).all()


@pytest.mark.parametrize(
    ("values", "rank"),
    [([5, 1, 1], 3), ([5, 1, 1e-8], 3), ([5, 1, 1e-10], 2), ([5, 1, 0], 2), ([5, 1e-12, 0], 1), ([0, 0, 0], 0)],
)
def test_rank_counts_singular_values_above_the_tolerance(values, rank):
    matrices = with_values(np.random.default_rng(3), FEW, 3, 3, np.array(values, float))
    assert (spectrum_of(matrices).rank(1e-9) == rank).all()


def test_rank_tolerance_is_relative():
    matrices = 1e7 * with_values(np.random.default_rng(3), FEW, 3, 3, np.array([1.0, 0.5, 1e-4]))
    assert (spectrum_of(matrices).rank(1e-3) == 2).all()
    assert (spectrum_of(matrices).rank(1e-5) == 3).all()


def test_of_a_matrix_that_vanishes_altogether_no_rank_is_left():
    # singular values that are all rounding have a largest one too; lever ratios are of size 1
    matrices = with_values(np.random.default_rng(3), FEW, 3, 3, np.array([1e-17, 5e-18, 1e-21]))
    assert (spectrum_of(matrices).rank() == 0).all()
    assert spectrum_of(np.array([[[1e-37]], [[1e-3]], [[-0.5]]])).rank().tolist() == [0, 1, 1]


def test_matrices_that_are_not_finite_give_nan_and_leave_their_neighbours_alone():
    matrices = np.random.default_rng(4).normal(size=(FEW, 3, 3))
    clean = spectrum_of(matrices).singular_values
    matrices[2] = np.nan
    matrices[4, 0, 0] = np.inf
    spectrum = spectrum_of(matrices)
    others = np.delete(np.arange(FEW), [2, 4])
    assert np.isnan(spectrum.singular_values[[2, 4]]).all()
    assert np.isnan(spectrum.condition[[2, 4]]).all()
    assert (spectrum.rank()[[2, 4]] == 0).all()
    assert spectrum.singular_values[others] == pytest.approx(clean[others], rel=1e-14)


def test_scaling_is_the_product_with_both_diagonal_matrices():
    rng = np.random.default_rng(6)
    W = rng.normal(size=(FEW, 3, 4))
    row, column = rng.uniform(0.1, 3.0, 3), rng.uniform(0.1, 3.0, 4)
    expected = [np.linalg.inv(np.diag(row)) @ w @ np.diag(column) for w in W]
    assert scaled(W, row, column) == pytest.approx(np.array(expected), rel=1e-14)


@settings(deadline=None)
@given(unit=st.floats(1e-3, 1e3), seed=st.integers(0, 999))
def test_margin_does_not_depend_on_the_unit_of_length(unit, seed):
    # platform (x, y, rotation), actuators (prismatic, revolute, revolute); lengths counted in 1/unit metres:
    # a moment row grows with the unit, a torque column shrinks with it, and so do both characteristic lengths
    rng = np.random.default_rng(seed)
    W = rng.normal(size=(FEW, 3, 3))
    length = 0.3
    rows, columns = np.array([1.0, 1.0, length]), np.array([1.0, length, length])
    row_unit, column_unit = np.array([1.0, 1.0, unit]), np.array([1.0, unit, unit])
    converted = W * row_unit[:, None] / column_unit
    margin = spectrum_of(scaled(W, rows, columns)).margin
    other = spectrum_of(scaled(converted, rows * row_unit, columns * column_unit)).margin
    assert other == pytest.approx(margin, rel=0.0, abs=1e-13)


@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (3, 5), (4, 2), (6, 6)])
def test_null_directions_are_mapped_to_the_margin(shape):
    rng = np.random.default_rng(7)
    values = np.linspace(2.0, 1.0, min(shape))
    values[-1] = 0.0
    matrices = with_values(rng, FEW, *shape, values)
    left, right = null_directions(matrices)
    assert np.einsum("Nij,Ni->Nj", matrices, left) == pytest.approx(np.zeros((FEW, shape[1])), abs=1e-14)
    assert np.einsum("Nij,Nj->Ni", matrices, right) == pytest.approx(np.zeros((FEW, shape[0])), abs=1e-14)
    assert np.linalg.norm(left, axis=1) == pytest.approx(np.ones(FEW), rel=1e-14)
    assert np.linalg.norm(right, axis=1) == pytest.approx(np.ones(FEW), rel=1e-14)


def test_sign_of_a_null_direction_makes_its_first_largest_component_positive():
    # the null vector of a rank-one matrix a bᵀ on the plane is b turned by a right angle, in either sense
    b = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [3.0, 1.0], [-3.0, 1.0], [1.0, 2.0]])
    matrices = np.array([1.0, 2.0])[None, :, None] * b[:, None, :]
    right = null_directions(matrices)[1] * np.linalg.norm(b, axis=1, keepdims=True)
    expected = np.array([[1.0, -1.0], [1.0, 1.0], [1.0, 1.0], [-1.0, 3.0], [1.0, 3.0], [2.0, -1.0]])
    assert right == pytest.approx(expected, abs=1e-14)


def test_sign_of_a_null_direction_does_not_hang_on_rounding():
    # all components of the null vector tie; rounding makes any of them the largest
    rng = np.random.default_rng(9)
    null = np.array([1.0, -1.0, 1.0, -1.0]) / 2.0
    rows = rng.normal(size=(100, 4, 4))
    matrices = rows - (rows @ null)[:, :, None] * null
    assert null_directions(matrices)[1] == pytest.approx(np.broadcast_to(null, (100, 4)), abs=1e-11)


def test_results_are_read_only():
    spectrum = spectrum_of(np.random.default_rng(8).normal(size=(FEW, 2, 2)))
    for array in (spectrum.singular_values, spectrum.margin, spectrum.condition, spectrum.rank()):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
