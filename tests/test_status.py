"""The vocabulary of statuses: spellings and numbers that files, logs and generated C hold."""

from __future__ import annotations

import numpy as np
import pytest

from redundancy_pin.status import ResultStatus, SampleStatus, UpdateStatus, solved_status

CODES = {
    "ok": 0,
    "near_singular": 1,
    "singular_consistent": 2,
    "singular_inconsistent": 3,
    "underactuated": 4,
    "bound_infeasible": 5,
    "unreachable": 6,
    "branch_lost": 7,
    "out_of_range": 8,
    "type_i": 9,
    "type_ii": 10,
    "not_finite": 11,
}
"""Saved plans hold these numbers, and controllers that were generated return them: they do not change."""


def test_codes_of_samples_are_what_files_and_controllers_hold() -> None:
    assert {status.label: int(status) for status in SampleStatus} == CODES


@pytest.mark.parametrize(
    ("kind", "spellings"),
    [
        (ResultStatus, ["ok", "limit_violated", "unbounded", "unresolved", "not_converged", "stopped"]),
        (UpdateStatus, ["ok", "time_scaled", "relaxed", "fallback", "refused"]),
    ],
)
def test_spellings_are_the_names_in_lower_case(kind: type[ResultStatus], spellings: list[str]) -> None:
    assert [status.value for status in kind] == spellings
    assert [status.name.lower() for status in kind] == spellings


def test_four_statuses_of_a_sample_have_a_solution() -> None:
    solved = {"ok", "near_singular", "singular_consistent", "out_of_range"}
    codes = np.arange(len(CODES)).reshape(3, 4)
    np.testing.assert_array_equal(solved_status(codes).ravel(), [label in solved for label in CODES])
    assert {status.label for status in SampleStatus if status.solved} == solved
