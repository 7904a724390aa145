"""Processes of the studies: one thread of linear algebra each, and the environment as it was."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

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


KILLED = """
import os, time
from redundancy_pin.workers import workers

if __name__ == "__main__":
    with workers(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(600.0)
"""


def _runs(process: int) -> bool:
    """Return whether a process is there; one that has ended and that nobody has asked for is not."""
    stat = Path(f"/proc/{process}/stat")
    try:
        return stat.read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks Linux which processes there are")
def test_processes_end_with_a_parent_that_is_killed(tmp_path: Path):
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert _runs(worker)
        parent.send_signal(signal.SIGKILL)
    patience = time.monotonic() + 20.0
    while _runs(worker) and time.monotonic() < patience:
        time.sleep(0.05)
    left = _runs(worker)
    if left:
        os.kill(worker, signal.SIGKILL)
    assert not left
