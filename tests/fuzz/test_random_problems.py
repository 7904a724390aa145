"""2,000 random planning problems: a plan that keeps what its status promises, or one clear error."""

from __future__ import annotations

from collections import Counter

import forked
import pytest
from examples import SHARE
from promises import Keep
from random_problems import try_problem, warm

PROBLEMS, PARTS = 2000, 40


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_plans_keep_their_promises(part: int, keep: Keep) -> None:
    size = max(1, int(SHARE * PROBLEMS / PARTS))
    warm()
    counts: Counter[str] = Counter()
    classes: Counter[str] = Counter()
    broken = []
    for number in range(part * size, (part + 1) * size):
        outcome = try_problem(number)
        counts[outcome.verdict] += 1
        if outcome.verdict == forked.WRONG:
            classes[f"{outcome.reason} ({number})"] += 1
            broken.append(f"{number}: {outcome.text}")
    keep("plans", "random planning problems", counts, classes)
    assert not broken
