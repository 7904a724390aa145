"""Progress where there is no terminal, as in a log: a line every ten seconds on stderr, and nothing else."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from command_line import call

from redundancy_pin.cli import output
from redundancy_pin.cli.output import progress


def test_a_line_every_ten_seconds(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    clock = 5.0
    monkeypatch.setattr(output, "time", SimpleNamespace(monotonic=lambda: clock))
    with progress("reproduce") as advance:
        for step in range(36):
            advance(step, 36, f"case\r{step}")
            clock += 2.5
        clock += 3600.0
        advance(0, 0, "")
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "\r" not in printed.err
    elapsed = ["0:00:10", "0:00:20", "0:00:30", "0:00:40", "0:00:50", "0:01:00", "0:01:10", "0:01:20"]
    assert printed.err.splitlines() == [
        *(f"reproduce: case {4 * k}, {4 * k} of 36, {time} elapsed" for k, time in enumerate(elapsed, 1)),
        "reproduce: 1:01:30 elapsed",
    ]


def test_a_step_that_takes_long_has_lines_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(output, "EVERY", 0.05)
    with progress("plan") as advance:
        advance(1, 3, "whole_trajectory")
        time.sleep(0.4)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert set(printed.err.splitlines()) == {"plan: whole_trajectory, 1 of 3, 0:00:00 elapsed"}
    assert 3 <= len(printed.err.splitlines()) <= 8
    time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_a_command_prints_lines_and_its_result() -> None:
    result = call("validate", "--robot", "four_bar", "--samples", "8", "--json", every=0.02)
    assert json.loads(result.stdout)["passed"]
    lines = result.stderr.splitlines()
    assert len(lines) > 2
    assert all(re.fullmatch(r"validate: (\d of 8, )?0:00:\d\d elapsed", line) for line in lines)


def test_a_log_that_cannot_be_written_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    attempts = 0

    class Full:
        def write(self, *_: object) -> int:
            nonlocal attempts
            attempts += 1
            raise OSError(28, "No space left on device")

        def flush(self) -> None:
            raise OSError(28, "No space left on device")

        def isatty(self) -> bool:
            return False

    monkeypatch.setattr(output, "EVERY", 0.02)
    for stream in (Full(), None):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress("plan") as advance:
            time.sleep(0.1)
            advance(1, 3, "writing")
    assert attempts > 0


def test_a_terminal_has_a_bar_and_no_lines() -> None:
    code = (
        "import time; from redundancy_pin.cli import output; output.EVERY = 0.02\n"
        "with output.progress('plan') as advance: advance(1, 3, 'stage'); time.sleep(0.2)"
    )
    ours, its = pty.openpty()
    subprocess.run([sys.executable, "-c", code], stdout=its, stderr=its, check=True)
    os.close(its)
    shown = os.read(ours, 100_000).decode()
    os.close(ours)
    assert "plan: stage" in shown
    assert "1/3" in shown
    assert "elapsed" not in shown
