"""Efforts at singularities that are exact by construction, and the limits from both sides."""

from dataclasses import replace

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from prescribed import factors, reduced, times

from redundancy_pin.dynamics.distribution import CONSISTENCY_TOLERANCE, distribute
from redundancy_pin.status import SampleStatus

N = 30
ROUNDING = 1e-13


def test_outer_product_with_the_force_along_it():
    # W = a bᵀ, f = 6 a: every τ with b·τ = 6 will do, the shortest is 6 b / |b|²
    a, b = np.array([3.0, 4.0]), np.array([1.0, -2.0])
    d = distribute(reduced(np.outer(a, b)[None], 6.0 * a[None]))
    assert d.status_labels.tolist() == ["singular_consistent"]
    assert d.solved.all()
    assert d.rank[0] == 1
    assert d.tau[0] == pytest.approx(6.0 * b / 5.0, abs=ROUNDING)
    assert d.free_direction[0] == pytest.approx(np.array([2.0, 1.0]) / np.sqrt(5.0), abs=ROUNDING)
    assert d.uncontrolled[0] == pytest.approx(np.array([4.0, -3.0]) / 5.0, abs=ROUNDING)
    assert d.margin[0] == pytest.approx(0.0, abs=ROUNDING)
    assert d.condition[0] > 1e15
    assert d.residual[0] == pytest.approx(0.0, abs=ROUNDING * 30.0)


def test_outer_product_with_the_force_across_it():
    a, b = np.array([3.0, 4.0]), np.array([1.0, -2.0])
    across = np.array([4.0, -3.0]) / 5.0
    d = distribute(reduced(np.outer(a, b)[None], 6.0 * a[None] + 0.25 * across))
    assert d.status_labels.tolist() == ["singular_inconsistent"]
    assert not d.solved.any()
    assert np.isnan(d.tau).all()
    assert np.isnan(d.free_direction).all()
    assert d.residual[0] == pytest.approx(0.25, rel=1e-12)
    assert d.uncontrolled[0] == pytest.approx(across, abs=ROUNDING)


def test_one_freedom_at_its_singular_pose():
    # W is one number there, of the size of rounding, and largest and smallest singular value at once
    d = distribute(reduced([[[1e-37]], [[1e-37]], [[1e-4]]], [[2.5], [0.0], [2.5]]))
    assert d.status_labels.tolist() == ["singular_inconsistent", "singular_consistent", "near_singular"]
    assert np.isnan(d.tau[0]).all()
    assert d.residual[0] == pytest.approx(2.5, rel=1e-12)
    assert d.tau[1:, 0] == pytest.approx([0.0, 2.5e4], rel=1e-12)


def test_two_rpr_in_line_needs_the_scalar_condition_of_the_thesis():
    # both legs along x: W = Jᵀ has the columns ±(1, 0); a force along x is shared, one along y cannot be held
    W = np.array([[[1.0, -1.0], [0.0, 0.0]]] * 2)
    d = distribute(reduced(W, [[3.0, 0.0], [3.0, 1e-3]]))
    assert d.status_labels.tolist() == ["singular_consistent", "singular_inconsistent"]
    assert d.tau[0] == pytest.approx([1.5, -1.5])
    assert d.free_direction[0] == pytest.approx(np.array([1.0, 1.0]) / np.sqrt(2.0))
    assert d.uncontrolled[0] == pytest.approx([0.0, 1.0])
    assert d.residual[1] == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("n", "m", "rank"), [(2, 2, 0), (3, 3, 2), (3, 3, 1), (6, 6, 4), (3, 4, 2), (2, 5, 1), (4, 3, 2)]
)
def test_any_rank_deficiency(n, m, rank):
    rng = np.random.default_rng(1)
    values = np.where(np.arange(min(n, m)) < rank, np.linspace(2.0, 1.0, min(n, m)), 0.0)
    U, W, _ = factors(rng, N, n, m, values)
    f = times(W, rng.normal(size=(N, m)))
    d = distribute(reduced(W, f))
    assert (d.status == SampleStatus.SINGULAR_CONSISTENT).all()
    assert (d.rank == rank).all()
    assert d.tau == pytest.approx(times(np.linalg.pinv(W, rcond=1e-9), f), abs=ROUNDING)
    assert times(W, d.free_direction) == pytest.approx(np.zeros((N, n)), abs=ROUNDING)
    assert times(W.transpose(0, 2, 1), d.uncontrolled) == pytest.approx(np.zeros((N, m)), abs=ROUNDING)
    assert np.linalg.norm(d.free_direction, axis=1) == pytest.approx(np.ones(N))
    assert np.linalg.norm(d.uncontrolled, axis=1) == pytest.approx(np.ones(N))

    d = distribute(reduced(W, f + 0.1 * U[:, :, -1]))
    assert (d.status == SampleStatus.SINGULAR_INCONSISTENT).all()
    assert np.isnan(d.tau).all()
    assert d.residual == pytest.approx(np.full(N, 0.1), rel=1e-10)


@examples(40)
@given(exponents=st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4), m=st.integers(3, 4), seed=st.integers(0, 999))
def test_weighted_norm_at_a_singularity_equals_the_bordered_system(exponents, m, seed):
    # the optimum solves [diag(w) Wᵀ; W 0] [τ; λ] = [0; f], singular in λ only
    rng = np.random.default_rng(seed)
    weights = 10.0 ** np.array(exponents[:m])
    _, W, _ = factors(rng, 1, 3, m, [2.0, 1.0, 0.0])
    f = times(W, rng.normal(size=(1, m)))
    d = distribute(reduced(W, f), weights=weights)
    bordered = np.block([[np.diag(weights), W[0].T], [W[0], np.zeros((3, 3))]])
    expected = np.linalg.lstsq(bordered, np.concatenate([np.zeros(m), f[0]]), rcond=1e-13)[0][:m]
    assert d.status[0] == SampleStatus.SINGULAR_CONSISTENT
    assert d.tau[0] == pytest.approx(expected, rel=0.0, abs=1e-8 * np.abs(expected).max())


def test_directions_are_in_physical_units_and_normalised_in_scaled_ones():
    rng = np.random.default_rng(2)
    row, column = np.array([1.0, 1.0, 0.2]), np.array([1.0, 0.2, 0.2])
    _, A, _ = factors(rng, N, 3, 3, [2.0, 1.0, 0.0])
    W = A * row[:, None] / column
    d = distribute(reduced(W, times(W, np.ones((N, 3))), row, column))
    assert times(W, d.free_direction) == pytest.approx(np.zeros((N, 3)), abs=ROUNDING)
    assert times(W.transpose(0, 2, 1), d.uncontrolled) == pytest.approx(np.zeros((N, 3)), abs=ROUNDING)
    assert np.linalg.norm(d.free_direction / column, axis=1) == pytest.approx(np.ones(N))
    assert np.linalg.norm(d.uncontrolled * row, axis=1) == pytest.approx(np.ones(N))
    assert (np.take_along_axis(d.free_direction, np.abs(d.free_direction / column).argmax(1)[:, None], 1) > 0.0).all()


def test_efforts_pass_continuously_through_a_singularity_where_the_force_is_consistent():
    # W(e) = U diag(2, 1, e) Vᵀ, f = W(e) τ₀ with τ₀ across the null direction: τ(e) = τ₀ on both sides and at e = 0
    rng = np.random.default_rng(3)
    U, _, V = (x[0] for x in factors(rng, 1, 3, 3, [1.0, 1.0, 1.0]))
    e = np.array([-1e-3, -1e-6, -1e-8, -1e-10, 0.0, 1e-10, 1e-8, 1e-6, 1e-3])
    W = U * np.stack([np.full(9, 2.0), np.ones(9), e], axis=1)[:, None, :] @ V.T
    tau = V @ np.array([1.0, -2.0, 0.0])
    d = distribute(reduced(W, W @ tau))
    singular = np.abs(e) < 1e-9 * 2.0
    assert (d.status == np.where(singular, SampleStatus.SINGULAR_CONSISTENT, SampleStatus.NEAR_SINGULAR)).all()
    error = np.linalg.norm(d.tau - tau, axis=1)
    # the condition number multiplies rounding next to the singularity, not on it
    assert (error <= np.where(singular, 1e-14, 1e-14 / np.maximum(np.abs(e), 1e-10))).all()


def test_efforts_grow_without_limit_where_the_force_is_inconsistent():
    e = np.array([-1e-2, -1e-4, -1e-6, 0.0, 1e-6, 1e-4, 1e-2])
    W = np.stack([np.diag([1.0, distance]) for distance in e])
    d = distribute(reduced(W, np.ones((7, 2))))
    assert d.tau[[0, 1, 2, 4, 5, 6], 1] == pytest.approx(1.0 / e[e != 0.0])
    assert d.status[3] == SampleStatus.SINGULAR_INCONSISTENT
    assert np.isnan(d.tau[3]).all()


def test_tolerances_decide_rank_and_consistency():
    W = np.array([np.diag([1.0, 1e-6])])
    f = np.array([[1.0, 1e-5]])
    assert distribute(reduced(W, f)).tau[0] == pytest.approx([1.0, 10.0])
    assert distribute(reduced(W, f), rank_tolerance=1e-5).status[0] == SampleStatus.SINGULAR_INCONSISTENT
    d = distribute(reduced(W, f), rank_tolerance=1e-5, consistency_tolerance=1e-4)
    assert d.status[0] == SampleStatus.SINGULAR_CONSISTENT
    assert d.residual[0] == pytest.approx(1e-5)


def test_consistency_is_relative_to_the_force_down_to_the_smallest_force_that_counts():
    W = np.array([np.diag([1.0, 0.0])] * 4)
    just = CONSISTENCY_TOLERANCE
    f = np.array([[1e6, 0.5e6 * just], [1e6, 2e6 * just], [1e-15, 1e-13], [0.0, 1e-6]])
    labels = ["singular_consistent", "singular_inconsistent", "singular_consistent", "singular_inconsistent"]
    given = replace(reduced(W, f), force_size=np.ones(4))
    assert distribute(given).status_labels.tolist() == labels
    assert distribute(given, force_tolerance=1e-5).status[3] == SampleStatus.SINGULAR_CONSISTENT
    # of a machine a thousand times as strong, and where nothing says how strong it is
    assert distribute(replace(given, force_size=np.full(4, 1e3))).status[3] == SampleStatus.SINGULAR_CONSISTENT
    assert distribute(reduced(W, f)).status[2] == SampleStatus.SINGULAR_INCONSISTENT


def test_a_singular_sample_among_thousands_of_regular_ones():
    rng = np.random.default_rng(4)
    W, f = rng.normal(size=(2000, 3, 3)), rng.normal(size=(2000, 3))
    W[777] = np.outer([1.0, 2.0, 2.0], [2.0, -1.0, 2.0])
    f[777] = [9.0, 18.0, 18.0]
    W[1234], f[1234] = 0.0, 0.0
    d = distribute(reduced(W, f))
    assert d.rank[[777, 1234]].tolist() == [1, 0]
    assert d.status_labels[[777, 1234]].tolist() == ["singular_consistent"] * 2
    assert d.tau[777] == pytest.approx([2.0, -1.0, 2.0])
    assert (d.tau[1234] == 0.0).all()
    others = np.delete(np.arange(2000), [777, 1234])
    assert (d.status[others] <= SampleStatus.NEAR_SINGULAR).all()
    assert np.isnan(d.free_direction[others]).all()
