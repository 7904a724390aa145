"""Processes of the studies: one thread of linear algebra each; they end with whoever started them."""

from __future__ import annotations

import contextlib
import os
import signal
import sqlite3
import subprocess
import sys
import threading
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
import ctypes, os, sys, time
from redundancy_pin.workers import parallel

def process(number):
    os.write(1, f"{os.getpid()}\\n".encode())  # in one piece: two processes write to the same pipe
    if number:  # a solver that computes in C and gives no other thread a turn
        ctypes.PyDLL(None).sleep(600)
    return number

if __name__ == "__main__":
    for _ in parallel(process, [(int(busy),) for busy in sys.argv[1:]], 2):
        pass
    time.sleep(600.0)
"""


def _runs(process: int) -> bool:
    """Return whether a process is there; one that has ended and that nobody has asked for is not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def _children(process: int) -> set[int]:
    """Processes that another one has started, loky's tracker of resources among them, and theirs."""
    tree = {int(path.name): path for path in Path("/proc").iterdir() if path.name.isdigit()}
    parents = {}
    for number, path in tree.items():
        with contextlib.suppress(OSError):
            parents[number] = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
    own = {number for number, parent in parents.items() if parent == process}
    return own.union(*(_children(child) for child in own))


def _require_all_ended(processes: set[int], patience: float) -> None:
    until = time.monotonic() + patience
    while any(_runs(process) for process in processes) and time.monotonic() < until:
        time.sleep(0.05)
    left = [process for process in processes if _runs(process)]
    for process in left:
        os.kill(process, signal.SIGKILL)
    assert not left


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks Linux which processes there are")
@pytest.mark.long_for("idle", "busy")
@pytest.mark.parametrize("busy", ["00", "11", "01"], ids=["idle", "busy", "one of them"])
def test_processes_end_with_a_parent_that_is_killed(busy: str, tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    with subprocess.Popen([sys.executable, str(script), *busy], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        workers = {int(parent.stdout.readline()) for _ in range(2)} | _children(parent.pid)
        assert len(workers) >= 3
        parent.send_signal(signal.SIGKILL)
    _require_all_ended(workers, 20.0)


def test_processes_outlive_the_thread_that_had_them_started() -> None:
    thread = threading.Thread(target=lambda: list(parallel(_wrong, [(0,), (2,)], 2)))
    thread.start()
    thread.join()
    assert list(parallel(_wrong, [(0,), (2,), (3,)], 2, ordered=True)) == [0, 2, 3]


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks Linux which processes there are")
def test_a_map_that_is_killed_leaves_no_process_and_a_store_to_go_on_from(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-c",
        "from redundancy_pin.cli import main; main()",
        "map",
        "--robot",
        "3rrr",
        "--jobs",
        "4",
        "--out",
        "map",
    ]
    command += ["--x", "speed=0.1:0.3:3", "--y", "stroke=0.5:2.0:3", "--refine", "0"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as parent:
        store, patience = tmp_path / "map" / "store.sqlite", time.monotonic() + 120.0
        while not (store.exists() and store.stat().st_size > 16384) and time.monotonic() < patience:
            time.sleep(0.1)
        children = _children(parent.pid)
        assert len(children) >= 4
        parent.send_signal(signal.SIGKILL)
    _require_all_ended(children, 20.0)
    with sqlite3.connect(store) as raw:
        assert raw.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert raw.execute("SELECT count(*) > 0 FROM record").fetchall() == [(1,)]
    raw.close()
