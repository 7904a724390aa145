"""What distribute refuses, and that the message names the culprit."""

import dataclasses

import numpy as np
import pytest
from prescribed import reduced

from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InputError
from redundancy_pin.status import SampleStatus

GOOD = reduced(np.ones((4, 2, 3)), np.ones((4, 2)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        pytest.param({"weights": [1.0, 1.0]}, r"weights has shape \(2,\), expected \(3,\)", id="weights-shape"),
        pytest.param({"weights": [1.0, -2.0, 1.0]}, r"weights\[1\] is -2", id="weights-negative"),
        pytest.param({"weights": [1.0, 1.0, 0.0]}, r"weights\[2\] is 0", id="weights-zero"),
        pytest.param({"weights": [1.0, np.nan, 1.0]}, "weights has 1 value", id="weights-nan"),
        pytest.param({"weights": [1.0, np.inf, 1.0]}, "weights has 1 value", id="weights-infinite"),
        pytest.param({"weights": [1.0, 1e13, 1.0]}, r"factor of 1e\+13", id="weights-apart"),
        pytest.param({"weights": "heavy"}, "weights is not an array of numbers", id="weights-text"),
        pytest.param({"lower": [0.0, 0.0]}, r"lower has shape \(2,\), expected \(3,\)", id="lower-shape"),
        pytest.param({"upper": np.zeros((3, 3))}, r"upper has shape \(3, 3\), expected \(4, 3\)", id="upper-samples"),
        pytest.param({"upper": np.nan}, "upper has 3 value", id="upper-scalar"),
        pytest.param({"lower": [0.0, np.nan, 0.0]}, r"lower has 1 value.*index \(1,\)", id="lower-nan"),
        pytest.param({"lower": [0.0, np.inf, 0.0]}, "lower has 1 value", id="lower-at-plus-infinity"),
        pytest.param({"upper": [0.0, 0.0, -np.inf]}, "upper has 1 value", id="upper-at-minus-infinity"),
        pytest.param({"upper": ["a", "b", "c"]}, "upper is not an array of numbers", id="upper-text"),
        pytest.param(
            {"lower": [0.0, 2.0, 0.0], "upper": [1.0, 1.0, 1.0]},
            r"actuator 1 \(first at sample 0\): 2 > 1",
            id="lower-above-upper",
        ),
        pytest.param({"near_singular": -0.1}, "near_singular is -0.1", id="near-singular"),
        pytest.param({"rank_tolerance": 0.0}, "rank_tolerance is 0.0.*at least 1e-14", id="rank-zero"),
        pytest.param({"rank_tolerance": np.nan}, "rank_tolerance is nan", id="rank-nan"),
        pytest.param({"consistency_tolerance": np.inf}, "consistency_tolerance is inf", id="consistency"),
        pytest.param({"force_tolerance": -1.0}, "force_tolerance is -1.0", id="force"),
    ],
)
def test_arguments_out_of_their_domain(arguments, message):
    with pytest.raises(InputError, match=message):
        distribute(GOOD, **arguments)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"f": np.ones((4, 3))}, r"\(4, 2, 3\), \(4, 3\) and \(4,\)"),
        ({"f": np.ones((5, 2))}, r"\(5, 2\)"),
        ({"W": np.ones((4, 2))}, r"\(4, 2\), \(4, 2\)"),
        ({"W": np.ones((4, 2, 0))}, r"\(4, 2, 0\)"),
        ({"reachable": np.ones(3, bool)}, r"\(3,\)"),
        ({"row_scale": np.ones(3)}, "row_scale has shape"),
        ({"row_scale": np.array([1.0, 0.0])}, r"row_scale\[1\] is 0"),
        ({"column_scale": np.ones(2)}, "column_scale has shape"),
        ({"column_scale": np.array([1.0, -1.0, 1.0])}, r"column_scale\[1\] is -1"),
    ],
)
def test_dynamics_that_do_not_fit_together(changes, message):
    with pytest.raises(InputError, match=message):
        distribute(dataclasses.replace(GOOD, **changes))


def test_bounds_a_sample_each_are_compared_sample_by_sample():
    lower = np.zeros((4, 3))
    lower[2, 1] = 5.0
    with pytest.raises(InputError, match="first at sample 2") as caught:
        distribute(GOOD, lower=lower, upper=[1.0, 1.0, 1.0])
    assert caught.value.details == {"sample": 2, "actuator": 1}


def test_arguments_are_not_changed():
    W, f = np.ones((4, 2, 3)), np.ones((4, 2))
    weights, lower, upper = np.ones(3), np.full(3, -9.0), np.full(3, 9.0)
    W[1] = np.nan
    before = [a.copy() for a in (W, f, weights, lower, upper)]
    distribute(reduced(W, f, reachable=[True, True, False, True]), weights=weights, lower=lower, upper=upper)
    for array, copy in zip((W, f, weights, lower, upper), before, strict=True):
        assert np.array_equal(array, copy, equal_nan=True)
        assert array.flags.writeable


def test_labels_are_the_names_in_lower_case():
    assert [status.label for status in SampleStatus] == [
        "ok",
        "near_singular",
        "singular_consistent",
        "singular_inconsistent",
        "underactuated",
        "bound_infeasible",
        "unreachable",
        "branch_lost",
        "out_of_range",
        "type_i",
        "type_ii",
        "not_finite",
    ]


def test_a_backend_in_place_of_its_result_is_refused():
    with pytest.raises(InputError, match=r"given dict. Pass the result of a backend's reduce"):
        distribute({})


def test_results_print_what_tells_them_apart():
    given = reduced([[[1.0]], [[1e-37]], [[1.0]]], [[2.0], [1.0], [-3.0]], reachable=[True, True, False])
    assert repr(given) == "ReducedDynamics(N=3, n=1, m=1, k=0, 1 unreachable; peak |f| 3 N or N·m)"
    assert repr(distribute(given)) == (
        "Distribution(N=3, m=1: 1 ok, 1 singular_inconsistent, 1 unreachable; peak |tau| 2 N or N·m, "
        "least margin 1e-37)"
    )
