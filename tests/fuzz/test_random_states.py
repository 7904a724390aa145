"""10,000 random states of each shipped robot: the backends agree with each other and with the balances of physics."""

from __future__ import annotations

import pytest
from examples import SHARE
from promises import Keep

from redundancy_pin import crosscheck

STATES, PARTS = 10_000, 10
"""Of each robot, and tests that share them; each part has a seed of its own, and so robots of its own."""


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_backends_agree_with_each_other_and_with_physics(part: int, keep: Keep) -> None:
    states = max(1, int(SHARE * STATES / PARTS))
    report = crosscheck.run(samples=states, seed=100 + part)
    for robot in sorted({row.robot for row in report.rows}):
        rows = [row for row in report.rows if row.robot == robot]
        failed = [row.check for row in rows if not row.passed]
        # how many states of a check that fails are wrong is not known: one, at least
        keep("parity", robot, {"right": states - len(failed), "wrong": len(failed)}, dict.fromkeys(failed, 1))
    assert report.passed, [row for row in report.rows if not row.passed]
