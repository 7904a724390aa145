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


def test_a_line_now_and_then_however_long_a_step_takes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert output.EVERY == 10.0
    monkeypatch.setattr(output, "EVERY", 0.05)
    clock = time.monotonic
    monkeypatch.setattr(output, "time", SimpleNamespace(monotonic=lambda: 36000.0 * clock()))
    with progress("plan") as advance:
        advance(1, 3, "whole\rtrajectory")
        time.sleep(0.4)
        advance(0, 0, "")
        time.sleep(0.2)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "\r" not in printed.err
    lines = printed.err.splitlines()
    assert 3 <= len(lines) <= 12
    assert re.fullmatch(r"plan: whole trajectory, 1 of 3, \d:\d\d:\d\d elapsed", lines[0])
    assert re.fullmatch(r"plan: \d:\d\d:\d\d elapsed", lines[-1])
    # ten hours of that clock a second
    assert 0.2 < sum(int(part) * 60**k for k, part in enumerate(lines[-1].split()[1].split(":")[::-1])) / 36000.0 < 3.0
    time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_a_command_prints_lines_and_its_result() -> None:
    result = call("validate", "--robot", "four_bar", "--samples", "100", "--json", every=0.002)  # 0.1 s and more
    assert json.loads(result.stdout)["passed"]
    lines = result.stderr.splitlines()
    assert len(lines) > 2
    assert all(re.fullmatch(r"validate: (\d+ of 100, )?0:00:\d\d elapsed", line) for line in lines)


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
