"""Statements in words, tested in working modes where the answer is known from plans made without this study."""

from __future__ import annotations

import numpy as np
import pytest
from redundancy_pin.experiments.planned.mode_claims import CLAIMS, runs_of
from redundancy_pin.experiments.planned.store import PlanStore

KNOWN = {
    "no carrier meets a limit": {(1, 1, 1): False, (-1, -1, -1): True},
    "12 m/s² brings τ2 and τ3 below the baseline": {(1, 1, 1): False, (-1, -1, -1): True},
    "τ2 and τ3 exceed the baseline in the corner, at an acceleration limit": {(1, 1, 1): True, (-1, -1, -1): True},
    "half of the baseline's torque": {(1, 1, 1): False, (-1, -1, -1): True},
}


@pytest.mark.parametrize("mode", [(1, 1, 1), (-1, -1, -1)])
def test_known_answers(mode: tuple[int, ...]) -> None:
    runs = runs_of(PlanStore(), mode)
    claims = {claim.text: claim for claim in CLAIMS}
    for text, answers in KNOWN.items():
        holds, said = claims[text].test(runs)
        assert holds == answers[mode], (text, said)


def test_plan_and_baseline_stand_at_the_same_samples() -> None:
    for run in runs_of(PlanStore(), (1, 1, 1)).values():
        count = len(run.baseline.t)
        np.testing.assert_array_equal(run.plan.t[:count], run.baseline.t)
        assert run.accelerating.sum() > 20
        assert (run.decided <= run.accelerating).all()
