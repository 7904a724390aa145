"""Processes of the studies: one thread of linear algebra each; they end with whoever started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.workers import parallel

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def _settings(number: int) -> tuple[int, int, list[str | None], bool]:
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return number, os.getpid(), [os.environ.get(name) for name in THREADS], ignored


def _wrong(number: int) -> int:
    if number == 1:
        raise InputError("The second is wrong.", remedy="Leave it out.", number=number)
    return number


def test_processes_have_one_thread_each_and_leave_the_environment_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS[0], "7")
    monkeypatch.delenv(THREADS[1], raising=False)
    results = list(parallel(_settings, [(number,) for number in range(5)], 2, ordered=True))
    assert [number for number, *_ in results] == list(range(5))
    assert os.getpid() not in {process for _, process, *_ in results}
    # what the library saw when it was loaded; and what to print after Ctrl-C is the parent's
    assert all(threads == ["1"] * 3 and ignored for _, _, threads, ignored in results)
    assert os.environ[THREADS[0]] == "7"
    assert THREADS[1] not in os.environ


def test_one_job_is_this_process_and_all_give_the_same() -> None:
    assert {process for _, process, *_ in parallel(_settings, [(0,), (1,)], 1)} == {os.getpid()}
    assert list(parallel(_settings, [], 2)) == []
    assert {number for number, *_ in parallel(_settings, [(0,), (1,), (2,)], -1)} == {0, 1, 2}


def test_an_error_of_a_process_reaches_the_caller_whole() -> None:
    with pytest.raises(InputError, match="The second is wrong") as caught:
        list(parallel(_wrong, [(0,), (1,), (2,)], 2))
    assert caught.value.details == {"number": 1}


def test_a_process_that_dies_is_one_clear_error() -> None:
    with pytest.raises(RedundancyPinError, match=r"worker process died.*fewer jobs"):
        list(parallel(os._exit, [(1,), (1,)], 2))


KILLED = """
import os, time
from redundancy_pin.workers import parallel

def process(number):
    return os.getpid()

if __name__ == "__main__":
    for found in parallel(process, [(0,), (1,)], 2):
        print(found, flush=True)
    time.sleep(600.0)
"""


def _runs(process: int) -> bool:
    """Return whether a process is there; one that has ended and that nobody has asked for is not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks Linux which processes there are")
def test_processes_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        workers = {int(parent.stdout.readline()) for _ in range(2)}
        assert all(_runs(worker) for worker in workers)
        parent.send_signal(signal.SIGKILL)
    patience = time.monotonic() + 20.0
    while any(_runs(worker) for worker in workers) and time.monotonic() < patience:
        time.sleep(0.05)
    left = [worker for worker in workers if _runs(worker)]
    for worker in left:
        os.kill(worker, signal.SIGKILL)
    assert not left
