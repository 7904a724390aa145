"""Random mutants of the package are noticed by the tests of ``make test`` that reach them: 95 % of them at least."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from examples import SHARE
from promises import Keep

PROGRAM = Path(__file__).resolve().parents[1] / "support" / "mutants.py"

MUTANTS, BATCHES = 60, 60
BLOCK = 1700
"""The first number: a block whose survivors have been given tests says nothing any more; add 100 then."""

pytestmark = [pytest.mark.long, pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")]


def _printed(*arguments: object) -> str:
    """Return what the program prints: in a process of its own, which has not loaded the package."""
    command = [sys.executable, str(PROGRAM), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("batch", range(BATCHES))
def test_mutants_are_noticed(batch: int, keep: Keep) -> None:
    count = max(1, int(SHARE * MUTANTS / BATCHES))
    printed = _printed(count, BLOCK + batch * count)
    sys.stdout.write(printed)  # `pytest -rA` shows which test has killed which
    survivors = re.findall(r"^\d+: (?:SURVIVED|UNDECIDED.*?): (.*)$", printed, flags=re.M)
    killed = len(re.findall(r"^\d+: killed by ", printed, flags=re.M))
    assert killed + len(survivors) == count
    kind = "signs, comparisons and factors, judged by the tests of make test that reach them"
    keep("mutants", kind, {"right": killed, "wrong": len(survivors)}, dict.fromkeys(survivors, 1))
    # a few may survive: promises.LEAST judges the sum


def test_no_change_is_not_noticed() -> None:
    """Otherwise every mutant would be, whatever the tests are worth."""
    assert "0 of 1 killed" in _printed(1, "none")
