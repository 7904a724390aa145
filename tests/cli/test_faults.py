"""Faults around a command: outputs that are full, closed or without letters, interrupts, too many of something."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import refused

import redundancy_pin
from redundancy_pin.cli import main

FULL = Path("/dev/full")
TOP = Path(redundancy_pin.__file__).parents[1]


def started(folder: Path, *arguments: str, path: str = "", **how: object) -> subprocess.CompletedProcess[bytes]:
    """Run the command as a user does: by a script of its name, in a process of its own."""
    script = folder / "redundancy-pin"
    # as in a terminal: a shell's background processes ignore interrupts, and so do their children
    text = "import signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    script.write_text(f"{text}from redundancy_pin.cli import main\nsys.exit(main())\n", encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": f"{path}{os.pathsep}{TOP}", **how.pop("env", {})}  # type: ignore[dict-item]
    settings = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **how}
    command = [sys.executable, str(script), *arguments]
    return subprocess.run(command, cwd=folder, env=environment, timeout=120, check=False, **settings)  # type: ignore[call-overload, no-any-return]


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_a_full_disk_behind_stdout(tmp_path: Path) -> None:
    with FULL.open("wb") as full:
        done = started(tmp_path, "info", stdout=full)
    assert done.returncode == 2
    assert done.stderr == b"error: Cannot write the output: No space left on device.\n"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs pipes without a reader")
@pytest.mark.long_for("info --robot 2rpr")
@pytest.mark.parametrize("arguments", [("info",), ("info", "--robot", "2rpr")], ids=" ".join)
def test_a_reader_that_has_seen_enough_is_no_fault(arguments: tuple[str, ...], tmp_path: Path) -> None:
    """The tables are rich's, which would end with 1."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as closed:
        done = started(tmp_path, *arguments, stdout=closed)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_terminal_without_greek_letters(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="ascii") for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    with pytest.raises(SystemExit) as leaving:
        main(["info", "--robot", "2rpr"])
    printed, complaints = (stream.buffer.getvalue() for stream in streams)  # type: ignore[attr-defined]
    assert leaving.value.code in (0, None)
    assert complaints == b""
    assert b"gravity [m/s\\xb2]" in printed


def test_outputs_that_were_closed_before_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python has no streams then."""
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    with pytest.raises(SystemExit) as leaving:
        main(["infos"])
    assert leaving.value.code == 2


def test_an_interrupt_while_importing(tmp_path: Path) -> None:
    # what the package imports first among the slow ones interrupts it
    slow = tmp_path / "slow"
    slow.mkdir()
    text = f"import os, signal, time\nos.kill(os.getpid(), {int(signal.SIGINT)})\ntime.sleep(60)\n"
    (slow / "pinocchio.py").write_text(text, encoding="utf-8")
    done = started(tmp_path, "info", path=str(slow))
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"\nerror: interrupted.\n")  # behind ^C


def test_a_program_that_imports_the_package_keeps_its_interrupts() -> None:
    assert signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_IGN)


WHOLE = ("plan", "whole-trajectory", "--robot", "2rpr", "--motion", "line")
OFF = ("plan", "switch-off", "--robot", "2rpr", "--motion", "line")
STEPWISE = ("plan", "stepwise", "--robot", "3rrr", "--motion", "corner")
TOO_MANY: tuple[tuple[str, ...], ...] = (
    (*WHOLE, "--starts", "100000"),
    (*WHOLE, "--refinements", "1000000000"),
    (*WHOLE, "--dt", "1e-9"),
    (*WHOLE[:-1], "line:speed=1e-9"),
    (*OFF, "--dt", "1e-9"),
    (*OFF, "--dt", "1e-90"),
    (*STEPWISE, "--dt", "1e-9"),
    (*STEPWISE[:-1], "corner:speed=1e-12"),
    ("validate", "--robot", "2rpr", "--samples", "1000000000000"),
    ("validate", "--robot", "2rpr", "--jobs", "99999"),
    ("reproduce", "--jobs", "99999"),
)


@pytest.mark.parametrize("arguments", TOO_MANY, ids=" ".join)
def test_too_many_of_something_are_refused_at_once(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert re.search(r"[aA]t most \d+|from \w+ to \d+|1 to \d+", refused(*arguments))
    assert list(tmp_path.iterdir()) == []
