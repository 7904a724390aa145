"""Efforts at samples of any rank, without bounds: unique, of least norm, or impossible; and what distribute refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from prescribed import factors, reduced, times

import redundancy_pin as rp
from redundancy_pin.dynamics.distribution import CONSISTENCY_TOLERANCE, LARGEST_WEIGHT_RATIO, distribute
from redundancy_pin.errors import InputError
from redundancy_pin.status import SampleStatus

N = 40

SOLUTION = 1e-12
"""Relative: condition numbers up to 1e3 times rounding."""

ROUNDING = 1e-13

POWERS = (-1000, -700, -401, -60, 0, 60, 401, 520, 700, 1000)
"""Of two. Squares leave the range of doubles from 2^±512 on."""


def times_power(values: np.ndarray, power: int) -> np.ndarray:
    return np.asarray(np.ldexp(values, power))


SHAPES = [(1, 1), (2, 2), (3, 3), (6, 6), (1, 3), (2, 3), (3, 4), (6, 8)]

# --- W of full rank


@pytest.mark.parametrize(("n", "m"), SHAPES)
def test_efforts_reproduce_those_that_made_the_force(n, m):
    rng = np.random.default_rng(1)
    _, W, V = factors(rng, N, n, m, np.linspace(2.0, 0.5, n))
    tau = times(V[:, :, :n], rng.normal(size=(N, n)))  # in the row space of W: the solution of least norm
    d = distribute(reduced(W, times(W, tau)))
    assert (d.status == SampleStatus.OK).all()
    assert d.solved.all()
    assert (d.rank == n).all()
    assert d.tau == pytest.approx(tau, rel=0.0, abs=SOLUTION * np.abs(tau).max())
    assert d.margin == pytest.approx(np.full(N, 2.0 if n == 1 else 0.5), rel=1e-13)
    assert d.condition == pytest.approx(np.full(N, 1.0 if n == 1 else 4.0), rel=1e-13)
    assert (d.residual <= 1e-14 * np.linalg.norm(tau, axis=1) * 20).all()
    assert np.isnan(d.free_direction).all()
    assert np.isnan(d.uncontrolled).all()


@pytest.mark.parametrize("smallest", [1e-2, 1e-4, 1e-6, 1e-8])
def test_near_a_singularity_the_residual_stays_at_rounding_and_the_efforts_lose_the_condition_number(smallest):
    rng = np.random.default_rng(2)
    _, W, _ = factors(rng, N, 3, 3, [2.0, 1.0, smallest])
    tau = rng.normal(size=(N, 3))
    d = distribute(reduced(W, times(W, tau)))
    assert (d.status == SampleStatus.NEAR_SINGULAR).all()
    assert d.margin == pytest.approx(np.full(N, smallest), rel=0.0, abs=2e-10)
    # backward stability: a residual of roundings of ‖W‖ ‖τ‖, whatever the condition
    assert (d.residual <= 1e-14 * 2.0 * np.linalg.norm(d.tau, axis=1)).all()
    assert (np.linalg.norm(d.tau - tau, axis=1) <= 1e-14 * d.condition * np.linalg.norm(tau, axis=1)).all()


@pytest.mark.parametrize(("n", "m"), [(2, 1), (3, 2), (6, 4)])
def test_fewer_actuators_than_freedoms_balance_a_force_in_the_range(n, m):
    rng = np.random.default_rng(5)
    U, W, _ = factors(rng, N, n, m, np.linspace(2.0, 1.0, m))
    tau = rng.normal(size=(N, m))
    d = distribute(reduced(W, times(W, tau)))
    assert (d.status == SampleStatus.OK).all()
    assert (d.rank == m).all()
    assert d.tau == pytest.approx(tau, abs=1e-13)
    # no actuator feels a velocity orthogonal to the range
    assert times(W.transpose(0, 2, 1), d.uncontrolled) == pytest.approx(np.zeros((N, m)), abs=1e-14)
    assert np.isnan(d.free_direction).all()

    outside = U[:, :, m] * 3e-3
    d = distribute(reduced(W, times(W, tau) + outside))
    assert (d.status == SampleStatus.UNDERACTUATED).all()
    assert not d.solved.any()
    assert np.isnan(d.tau).all()
    assert d.residual == pytest.approx(np.full(N, 3e-3), rel=1e-10)


def test_fewer_actuators_near_and_at_a_singularity():
    rng = np.random.default_rng(6)
    U, near, _ = factors(rng, N, 3, 2, [1.0, 1e-3])
    tau = rng.normal(size=(N, 2))
    assert (distribute(reduced(near, times(near, tau))).status == SampleStatus.NEAR_SINGULAR).all()
    U, lost, _ = factors(rng, N, 3, 2, [1.0, 0.0])
    assert (distribute(reduced(lost, times(lost, tau))).status == SampleStatus.SINGULAR_CONSISTENT).all()
    assert (distribute(reduced(lost, U[:, :, 2])).status == SampleStatus.SINGULAR_INCONSISTENT).all()


def test_unreachable_samples_are_marked_and_leave_their_neighbours_alone():
    rng = np.random.default_rng(7)
    W, f = rng.normal(size=(6, 3, 3)), rng.normal(size=(6, 3))
    clean = distribute(reduced(W, f))
    W[1], f[1] = np.nan, np.nan
    f[3, 0] = np.nan
    given = W.copy(), f.copy(), np.ones(3), np.full(3, 1e9)
    bounds = {"weights": given[2], "lower": -given[3], "upper": given[3]}
    d = distribute(reduced(given[0], given[1], reachable=[True, False, True, True, False, True]), **bounds)
    for own, before in zip(given, (W, f, np.ones(3), np.full(3, 1e9)), strict=True):
        assert np.array_equal(own, before, equal_nan=True)  # what was given is not changed
    nothing = distribute(reduced(np.empty((0, 3, 3)), np.empty((0, 3))), **bounds)
    assert (len(nothing), nothing.tau.shape, nothing.uncontrolled.shape) == (0, (0, 3), (0, 3))
    gone, there = [1, 3, 4], [0, 2, 5]
    assert (d.status[gone] == SampleStatus.UNREACHABLE).all()
    for values in (d.tau, d.residual, d.margin, d.condition, d.free_direction, d.uncontrolled):
        assert np.isnan(values[gone]).all()
    assert (d.rank[gone] == 0).all()
    assert (d.status[there] == clean.status[there]).all()
    assert np.array_equal(d.tau[there], clean.tau[there])


def test_weights_may_differ_by_the_largest_ratio_and_no_more():
    """Counted on forces: a torque's weight is times the square of its scale."""
    dynamics = reduced([[[1.0, 1.0]]], [[2.0]], column_scale=[1.0, 0.5])
    widest = distribute(dynamics, weights=[LARGEST_WEIGHT_RATIO / 4.0, 1.0])
    assert widest.tau[0] == pytest.approx([0.0, 2.0], abs=1e-9)
    distribute(dynamics, weights=[1.0, 4.0 * LARGEST_WEIGHT_RATIO])
    for weights in ([0.26 * LARGEST_WEIGHT_RATIO, 1.0], [1.0, 4.1 * LARGEST_WEIGHT_RATIO]):
        with pytest.raises(InputError, match=r"more than 1e\+12") as caught:
            distribute(dynamics, weights=weights)
        assert caught.value.details["ratio"] == pytest.approx(LARGEST_WEIGHT_RATIO, rel=0.05)


# --- singularities that are exact by construction, and the limits from both sides


def test_outer_product_with_the_force_along_it_and_across_it():
    # W = a bᵀ, f = 6 a: every τ with b·τ = 6 will do, the shortest is 6 b / |b|²; and 0.25 N that nobody balances
    a, b, across = np.array([3.0, 4.0]), np.array([1.0, -2.0]), np.array([4.0, -3.0]) / 5.0
    d = distribute(reduced([np.outer(a, b)] * 2, [6.0 * a, 6.0 * a + 0.25 * across]))
    assert d.status_labels.tolist() == ["singular_consistent", "singular_inconsistent"]
    assert d.solved.tolist() == [True, False]
    assert d.rank.tolist() == [1, 1]
    assert d.tau[0] == pytest.approx(6.0 * b / 5.0, abs=ROUNDING)
    assert d.free_direction[0] == pytest.approx(np.array([2.0, 1.0]) / np.sqrt(5.0), abs=ROUNDING)
    assert np.isnan([d.tau[1], d.free_direction[1]]).all()
    assert d.uncontrolled == pytest.approx(np.array([across, across]), abs=ROUNDING)
    assert d.margin == pytest.approx([0.0, 0.0], abs=ROUNDING)
    assert (d.condition > 1e15).all()
    assert d.residual == pytest.approx([0.0, 0.25], rel=1e-12, abs=ROUNDING * 30.0)


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


def test_edges_of_the_tolerances():
    """A margin at its threshold is enough, a singular value at its tolerance none, a force at its own is balanced."""
    exact = reduced([np.diag([1.0, 0.25])], [[1.0, 1.0]])
    assert distribute(exact, near_singular=0.25 - 1e-12).status_labels.tolist() == ["ok"]
    assert distribute(exact, near_singular=0.25 + 1e-12).status_labels.tolist() == ["near_singular"]
    assert distribute(exact, rank_tolerance=0.25 + 1e-12).rank.tolist() == [1]
    assert distribute(exact, rank_tolerance=0.25 - 1e-12).rank.tolist() == [2]
    large, small = (reduced([size * np.diag([1.0, 0.25])], [[1.0, 1.0]]) for size in (4.0, 0.5))
    assert distribute(large, rank_tolerance=0.25 + 1e-12).rank.tolist() == [1]  # a fraction of the largest one,
    assert distribute(large, rank_tolerance=0.25 - 1e-12).rank.tolist() == [2]
    assert distribute(small, rank_tolerance=0.125 + 1e-12).rank.tolist() == [1]  # and a number without unit
    lost = [np.diag([1.0, 0.0])]
    given = {"consistency_tolerance": 0.5, "force_tolerance": 0.5}  # of 5 N, and of a scale of 1 N: 3 N
    within, over = (replace(reduced(lost, [[4.0, off]]), force_size=np.ones(1)) for off in (2.999, 3.001))
    assert distribute(within, **given).status_labels.tolist() == ["singular_consistent"]
    over = distribute(over, **given)
    assert over.status_labels.tolist() == ["singular_inconsistent"]
    assert over.residual[0] == pytest.approx(3.001)
    least = distribute(exact, rank_tolerance=1e-14, near_singular=0.0, consistency_tolerance=0.0, force_tolerance=0.0)
    assert least.status_labels.tolist() == ["ok"]


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(("off", "rank"), [(1e-4, 3), (-1e-4, 2)])
def test_next_to_the_threshold_of_rank(size, off, rank):
    """Of a large W it is 1e-9 of the largest singular value, of a small one 1e-9: entries of W have no unit."""
    rng = np.random.default_rng(8)
    smallest = (1.0 + off) * 1e-9 * max(size, 1.0)
    U, W, _ = factors(rng, N, 3, 3, [size, 0.5 * size, smallest])
    d = rp.distribute(reduced(W, U[:, :, 2]), force_tolerance=0.0)
    assert (d.rank == rank).all()
    lost = SampleStatus.SINGULAR_INCONSISTENT
    assert (d.status == (SampleStatus.NEAR_SINGULAR if rank == 3 else lost)).all()


# --- numbers of any size


def matrices(n: int, m: int, rank: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(5)
    W = random.normal(size=(6, n, rank)) @ random.normal(size=(6, rank, m))
    f = np.einsum("Nij,Nj->Ni", W, random.normal(size=(6, m)))
    f[3:] = random.normal(size=(3, n))  # outside the range of W where that is less than all
    return W, f


@pytest.mark.parametrize(("n", "m", "rank"), [(3, 3, 3), (3, 3, 2), (2, 4, 2), (4, 2, 2)])
def test_distribute_is_linear_at_any_size(n: int, m: int, rank: int) -> None:
    W, f = matrices(n, m, rank)
    one = rp.distribute(reduced(W, f), force_tolerance=0.0)
    for power in POWERS:
        got = rp.distribute(reduced(W, times_power(f, power)), force_tolerance=0.0)
        np.testing.assert_array_equal(got.status, one.status)
        np.testing.assert_array_equal(got.tau, times_power(one.tau, power))
        lost = one.status >= SampleStatus.SINGULAR_INCONSISTENT
        np.testing.assert_array_equal(got.residual[lost], times_power(one.residual[lost], power))
        assert (got.residual[~lost] <= 1e-13 * np.abs(times_power(f, power)).max()).all()


def test_distribute_keeps_bounds_of_any_size() -> None:
    random = np.random.default_rng(5)
    W, f = random.normal(size=(6, 2, 4)), random.normal(size=(6, 2))
    free = rp.distribute(reduced(W, f))
    bound = 0.9 * np.abs(free.tau).max(axis=1, keepdims=True) * np.ones(4)
    one = rp.distribute(reduced(W, f), lower=-bound, upper=bound)
    assert set(one.status.tolist()) == {SampleStatus.OK, SampleStatus.BOUND_INFEASIBLE}
    for power in (-1000, -700, -401, -60, 60, 300):  # bounds that are given may be 1e100 at most
        limit = times_power(bound, power)
        got = rp.distribute(reduced(W, times_power(f, power)), lower=-limit, upper=limit, force_tolerance=0.0)
        np.testing.assert_array_equal(got.status, one.status)
        np.testing.assert_allclose(got.tau, times_power(one.tau, power), rtol=1e-9)  # a solver's rounding
        lost = one.status == SampleStatus.BOUND_INFEASIBLE
        np.testing.assert_allclose(got.residual[lost], times_power(one.residual[lost], power), rtol=1e-9)
    got = rp.distribute(reduced(W, times_power(f, 700)), lower=-bound, upper=bound)
    assert set(got.status.tolist()) == {SampleStatus.BOUND_INFEASIBLE}  # what the motors give is nothing beside f
    np.testing.assert_allclose(got.residual, times_power(np.linalg.norm(f, axis=1), 700), rtol=1e-12)


def test_distribute_says_where_no_double_holds_the_efforts() -> None:
    W, f = np.array([np.eye(2), 1e-6 * np.eye(2), np.eye(2)]), np.array([[1.0, 2.0], [1e305, 0.0], [0.0, 1.5e308]])
    got = rp.distribute(reduced(W, f))
    assert got.status_labels.tolist() == ["ok", "unreachable", "ok"]
    np.testing.assert_array_equal(got.tau, [[1.0, 2.0], [np.nan, np.nan], [0.0, 1.5e308]])
    assert np.isnan(got.residual[1])
    assert got.rank.tolist() == [2, 0, 2]


# --- what is refused, by name

GOOD = reduced(np.ones((4, 2, 3)), np.ones((4, 2)))
FIVE_AT_TWO = np.where(np.arange(4)[:, None] == 2, 5.0, 0.0) * np.ones(3)

ARGUMENTS = [
    ({"weights": [1.0, 1.0]}, r"weights has shape \(2,\), expected \(3,\)"),
    ({"weights": [1.0, -2.0, 1.0]}, r"weights\[1\] is -2"),
    ({"weights": [1.0, 1.0, 0.0]}, r"weights\[2\] is 0"),
    ({"weights": [1.0, np.nan, 1.0]}, "weights has 1 value"),
    ({"weights": [1.0, np.inf, 1.0]}, "weights has 1 value"),
    ({"weights": [1.0, 1e13, 1.0]}, r"factor of 1e\+13"),
    ({"weights": "heavy"}, "weights is not an array of numbers"),
    ({"lower": [0.0, 0.0]}, r"lower has shape \(2,\), expected \(3,\)"),
    ({"upper": np.zeros((3, 3))}, r"upper has shape \(3, 3\), expected \(4, 3\)"),
    ({"upper": np.nan}, "upper has 3 value"),
    ({"lower": [0.0, np.nan, 0.0]}, r"lower has 1 value.*index \(1,\)"),
    ({"lower": [0.0, np.inf, 0.0]}, "lower has 1 value"),
    ({"upper": [0.0, 0.0, -np.inf]}, "upper has 1 value"),
    ({"upper": ["a", "b", "c"]}, "upper is not an array of numbers"),
    ({"lower": [0.0, 2.0, 0.0], "upper": [1.0, 1.0, 1.0]}, r"actuator 1 \(first at sample 0\): 2 > 1"),
    ({"lower": FIVE_AT_TWO, "upper": [5.0, 1.0, 5.0]}, r"actuator 1 \(first at sample 2\): 5 > 1"),
    ({"preferred": [np.inf, 0.0, 0.0]}, "preferred"),
    ({"near_singular": -0.1}, "near_singular is -0.1"),
    ({"rank_tolerance": 0.0}, "rank_tolerance is 0.0.*at least 1e-14"),
    ({"rank_tolerance": np.nan}, "rank_tolerance is nan"),
    ({"consistency_tolerance": np.inf}, "consistency_tolerance is inf"),
    ({"force_tolerance": -1.0}, "force_tolerance is -1.0"),
]

DYNAMICS = [
    ({"f": np.ones((4, 3))}, r"\(4, 2, 3\), \(4, 3\) and \(4,\)"),
    ({"f": np.ones((5, 2))}, r"\(5, 2\)"),
    ({"W": np.ones((4, 2))}, r"\(4, 2\), \(4, 2\)"),
    ({"W": np.ones((4, 2, 0))}, r"\(4, 2, 0\)"),
    ({"reachable": np.ones(3, bool)}, r"\(3,\)"),
    ({"row_scale": np.ones(3)}, "row_scale has shape"),
    ({"row_scale": np.array([1.0, 0.0])}, r"row_scale\[1\] is 0"),
    ({"column_scale": np.ones(2)}, "column_scale has shape"),
    ({"column_scale": np.array([1.0, -1.0, 1.0])}, r"column_scale\[1\] is -1"),
]


def test_arguments_out_of_their_domain_and_dynamics_that_do_not_fit_are_refused() -> None:
    for arguments, message in ARGUMENTS:
        with pytest.raises(InputError, match=message):
            distribute(GOOD, **arguments)
    for changes, message in DYNAMICS:
        with pytest.raises(InputError, match=message):
            distribute(replace(GOOD, **changes))
    with pytest.raises(InputError, match=r"given dict. Pass the result of a backend's reduce"):
        distribute({})


def test_results_print_what_tells_them_apart():
    given = reduced([[[1.0]], [[1e-37]], [[1.0]]], [[2.0], [1.0], [-3.0]], reachable=[True, True, False])
    assert repr(given) == "ReducedDynamics(N=3, n=1, m=1, k=0, 1 unreachable; peak |f| 3 N or N·m)"
    assert repr(distribute(given)) == (
        "Distribution(N=3, m=1: 1 ok, 1 singular_inconsistent, 1 unreachable; peak |tau| 2 N or N·m, "
        "least margin 1e-37)"
    )
