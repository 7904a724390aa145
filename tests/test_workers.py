"""Processes of the studies: one thread of linear algebra each, and the environment as it was."""

from __future__ import annotations

import os

import pytest

from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.workers import THREADS, workers


def test_processes_have_one_thread_each_and_leave_the_environment_as_it_was(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(THREADS[0], "7")
    monkeypatch.delenv(THREADS[1], raising=False)
    with workers(1) as pool:
        # what the library saw when it was loaded: the environment the process began with
        assert [pool.submit(os.getenv, name).result() for name in THREADS] == ["1"] * len(THREADS)
    assert os.environ[THREADS[0]] == "7"
    assert THREADS[1] not in os.environ


def test_a_process_that_dies_is_one_clear_error():
    with pytest.raises(RedundancyPinError, match=r"died.*fewer jobs"), workers(1) as pool:
        pool.submit(os._exit, 1).result()
