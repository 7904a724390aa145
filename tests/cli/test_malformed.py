"""Malformed invocations, from a seed: refused in one line, with code 2, soon, and with nothing left behind."""

from __future__ import annotations

import os
import sys
import time

import malformed
import pytest
from examples import SHARE
from promises import Keep

from redundancy_pin.cli import main

SAMPLE = 5

COMMANDS, PARTS = 3000, 30
"""Of ``make long``."""

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, and reads /proc")


def test_malformed_invocations_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    _, faults = malformed.tally(range(SAMPLE), main)
    assert not faults, capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_many_malformed_invocations_are_refused(part: int, capsys: pytest.CaptureFixture[str], keep: Keep) -> None:
    size = max(1, int(SHARE * COMMANDS / PARTS))
    ends, faults = malformed.tally(range(part * size, (part + 1) * size), main)
    refused, wrong = ends["ended with 2"], ends["wrong"]
    keep("malformed", "commands", {"right": size - refused - wrong, "refused": refused, "wrong": wrong}, faults)
    assert not faults, capsys.readouterr().out


def test_a_fault_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The judge itself: a traceback, a wrong code, too many lines, time, memory, and files left behind."""
    monkeypatch.setattr(malformed, "SECONDS", 0.5)
    monkeypatch.setattr(malformed, "MEGABYTES", 100.0)

    def outcome(program: object) -> tuple[str, ...]:
        return malformed.run(malformed.Invocation(("x",), {"a": b""}), program).faults  # type: ignore[arg-type]

    def refusing(before: object = None) -> object:
        def program(_: object) -> None:
            if callable(before):
                before()
            os.write(2, b"error: no.\n")
            raise SystemExit(2)

        return program

    def burn() -> None:
        while time.process_time() < 0.6:
            pass

    assert outcome(refusing()) == ()
    assert outcome(lambda _: 1 / 0) == ("traceback ZeroDivisionError",)
    assert outcome(lambda _: os._exit(77)) == ("exit code 77",)
    assert outcome(refusing(lambda: os.write(2, b"error: what\n"))) == ("2 lines on stderr",)
    assert outcome(refusing(lambda: os.write(1, b"what"))) == ("output of a refused command",)
    assert outcome(refusing(lambda: os.close(os.open("b", os.O_CREAT)))) == ("files left behind",)
    assert outcome(refusing(burn)) == ("more than 0.5 s",)
    assert outcome(refusing(lambda: len(b"x" * 120 * 2**20))) == ("more than 100 MB",)
