"""Efforts at samples where W has full rank: unique, of least norm, or impossible for want of actuators."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from prescribed import factors, reduced, times

from redundancy_pin.dynamics.allocation import FORCE_TOLERANCE
from redundancy_pin.dynamics.distribution import LARGEST_WEIGHT_RATIO, distribute
from redundancy_pin.errors import InputError
from redundancy_pin.status import SampleStatus

N = 40
SOLUTION = 1e-12
"""Relative: condition numbers up to 1e3 times rounding."""

SHAPES = [(1, 1), (2, 2), (3, 3), (6, 6), (1, 3), (2, 3), (3, 4), (6, 8)]


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


@examples(60)
@given(
    n=st.integers(1, 4),
    extra=st.integers(1, 3),
    exponents=st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7),
    seed=st.integers(0, 999),
)
def test_weighted_norm_is_stationary_along_the_null_space(n, extra, exponents, seed):
    # Lagrange: weights * tau is a combination of the rows of W exactly at the weighted optimum
    rng = np.random.default_rng(seed)
    m = n + extra
    weights = 10.0 ** np.array(exponents[:m])
    _, W, V = factors(rng, 3, n, m, np.linspace(2.0, 0.5, n))
    f = rng.normal(size=(3, n))
    d = distribute(reduced(W, f), weights=weights)
    assert times(W, d.tau) == pytest.approx(f, rel=0.0, abs=1e-12)
    gradient = weights * d.tau
    along = times(V[:, :, n:].transpose(0, 2, 1), gradient)
    # the gradient is known to rounding times the square root of the spread of the weights
    assert np.abs(along).max() <= 1e-12 * np.sqrt(np.ptp(weights) / weights.min() + 1.0) * weights.max()


def test_default_weights_count_a_torque_as_the_force_at_the_characteristic_length():
    # one freedom; a linear actuator and a motor whose lever is the characteristic length share the force equally
    length = 0.25
    d = distribute(reduced([[[1.0, 1.0 / length]]], [[10.0]], column_scale=[1.0, length]))
    assert d.tau[0] == pytest.approx([5.0, 5.0 * length])
    equal = distribute(reduced([[[1.0, 4.0]]], [[17.0]], column_scale=[1.0, length]), weights=[1.0, 1.0])
    assert equal.tau[0] == pytest.approx([1.0, 4.0])  # the pseudo-inverse of the row (1, 4)


@examples(40)
@given(unit=st.floats(1e-3, 1e3), m=st.integers(2, 5), seed=st.integers(0, 999))
def test_nothing_depends_on_the_unit_of_length(unit, m, seed):
    # platform (x, y, rotation); actuator 0 prismatic, the others revolute; lengths counted in 1/unit metres, forces
    # still in newtons
    rng = np.random.default_rng(seed)
    length = 0.3
    row, column = np.array([1.0, 1.0, length]), np.array([1.0] + [length] * (m - 1))
    row_unit, column_unit = np.array([1.0, 1.0, unit]), np.array([1.0] + [unit] * (m - 1))
    _, A, _ = factors(rng, 4, 3, m, np.linspace(2.0, 0.5, min(3, m)))
    A[0, 0] = A[0, 1]  # one singular sample
    W, f = A * row[:, None] / column, times(A, rng.normal(size=(4, m))) * row
    f[1] += 1.0
    before = distribute(reduced(W, f, row, column))
    after = distribute(reduced(W * row_unit[:, None] / column_unit, f * row_unit, row * row_unit, column * column_unit))
    assert (after.status == before.status).all()
    assert (after.rank == before.rank).all()
    assert after.margin == pytest.approx(before.margin, rel=0.0, abs=1e-13)
    assert after.residual == pytest.approx(before.residual, rel=0.0, abs=1e-11)
    assert after.tau == pytest.approx(before.tau * column_unit, rel=1e-10, abs=1e-11 * max(unit, 1.0), nan_ok=True)


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
    d = distribute(reduced(W, f, reachable=[True, False, True, True, False, True]), lower=[-1e9] * 3, upper=[1e9] * 3)
    gone, there = [1, 3, 4], [0, 2, 5]
    assert (d.status[gone] == SampleStatus.UNREACHABLE).all()
    for values in (d.tau, d.residual, d.margin, d.condition, d.free_direction, d.uncontrolled):
        assert np.isnan(values[gone]).all()
    assert (d.rank[gone] == 0).all()
    assert (d.status[there] == clean.status[there]).all()
    assert np.array_equal(d.tau[there], clean.tau[there])


@pytest.mark.parametrize(("n", "m"), SHAPES)
def test_no_samples(n, m):
    d = distribute(reduced(np.empty((0, n, m)), np.empty((0, n))), lower=[-1.0] * m)
    assert d.tau.shape == (0, m)
    assert d.uncontrolled.shape == (0, n)
    assert len(d) == 0


def test_results_are_read_only():
    d = distribute(reduced(np.eye(2)[None], np.ones((1, 2))))
    for name in ("tau", "status", "rank", "residual", "margin", "condition", "free_direction", "uncontrolled"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(d, name)[0] = 1


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


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("share", "label"), [(0.9, "ok"), (1.1, "bound_infeasible")])
def test_an_effort_may_pass_its_bound_by_a_share_of_the_largest_one(sign, share, label):
    """Of 1000 N beside it; it is put on the bound, and what is then missing is the residual."""
    passed = share * FORCE_TOLERANCE * 1000.0
    bound = {"upper": [np.inf, 1.0 - passed]} if sign > 0.0 else {"lower": [-np.inf, -1.0 + passed]}
    d = distribute(reduced([np.eye(2)], [[1000.0, sign]]), **bound)
    assert d.status_labels.tolist() == [label]
    assert d.residual[0] == pytest.approx(passed, rel=1e-6)
    if label == "ok":
        assert d.tau[0].tolist() == [1000.0, sign * (1.0 - passed)]


def test_weighted_optimum_against_a_general_optimiser():
    rng = np.random.default_rng(4)
    W, f, weights = rng.normal(size=(1, 2, 4)), rng.normal(size=(1, 2)), np.array([1.0, 5.0, 0.2, 2.0])
    other = scipy.optimize.minimize(
        lambda tau: weights @ tau**2,
        np.zeros(4),
        jac=lambda tau: 2.0 * weights * tau,
        constraints={"type": "eq", "fun": lambda tau: W[0] @ tau - f[0], "jac": lambda tau: W[0]},
        method="SLSQP",
        options={"ftol": 1e-15},
    )
    # SLSQP stops on the cost, so its minimiser is good to the square root of 1e-15
    assert distribute(reduced(W, f), weights=weights).tau[0] == pytest.approx(other.x, abs=1e-6)
