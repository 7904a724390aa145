"""The study on several processes: the same trials, one thread each, and a process that dies."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest

from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.experiments.robustness import robustness_study, study
from redundancy_pin.experiments.robustness.scenarios import Scenario
from redundancy_pin.experiments.robustness.trial import Trial
from redundancy_pin.workers import THREADS

SHORT = Scenario("line", "switch off", 2.48, 2.50)
OPTIONS = {"scenarios": (SHORT,), "drives": ("open loop",)}


def settings_of_its_process(scenario, drive, bounds, seed, number):
    """Stand in for a trial, whose reason says how its process is set up."""
    told = {"pid": os.getpid(), "silent": signal.getsignal(signal.SIGINT) is signal.SIG_DFL}
    told["threads"] = [os.environ.get(name) for name in THREADS]
    return Trial(scenario.name, drive, number, "completed", json.dumps(told), 1e-3, 5e-4, 1.0, 2.0, 0.0)


def dying(scenario, drive, bounds, seed, number):
    """Stand in for a trial whose process is killed from outside, when those before it are finished."""
    if number == 2:
        time.sleep(1.0)
        os._exit(9)
    return settings_of_its_process(scenario, drive, bounds, seed, number)


def test_processes_have_one_thread_and_one_that_dies_is_one_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setattr(study, "run_trial", dying)
    journal = tmp_path / "journal.jsonl"
    with pytest.raises(RedundancyPinError, match=r"worker process died.*fewer jobs"):
        robustness_study(3, jobs=2, journal=journal, **OPTIONS)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "OPENBLAS_NUM_THREADS" not in os.environ
    trials = [json.loads(line) for line in journal.read_text().splitlines()[1:]]
    assert sorted(one["number"] for one in trials) == [0, 1]  # what was finished is kept
    for told in (json.loads(one["reason"]) for one in trials):
        assert told["pid"] != os.getpid()
        assert told["threads"] == ["1", "1", "1"]
        assert told["silent"]  # what to say after Ctrl-C is the parent's


def test_several_processes_make_the_same_trials() -> None:
    one, two = (robustness_study(2, jobs=jobs, **OPTIONS) for jobs in (1, 2))
    assert two.trials == one.trials
    assert two.cells == one.cells
