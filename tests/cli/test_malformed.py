"""Malformed invocations, from a seed: refused in one line, with code 2, soon, and with nothing left behind."""

from __future__ import annotations

import os
import sys
import time

import malformed
import pytest
from examples import FACTOR
from promises import Keep

from redundancy_pin.cli import main

SAMPLE = 20

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, and reads /proc")


@pytest.mark.parametrize("count", [SAMPLE, pytest.param(300 * FACTOR, marks=pytest.mark.long, id="many")])
def test_malformed_invocations_are_refused(count: int, capsys: pytest.CaptureFixture[str], keep: Keep) -> None:
    counts = malformed.tally(count, 0, main)
    faults = {name: times for name, times in counts.items() if not name.startswith("ended with")}
    if count > SAMPLE:  # make long shows them
        wrong, refused = sum(faults.values()), counts["ended with 2"]
        keep("malformed", "commands", {"right": count - refused - wrong, "refused": refused, "wrong": wrong}, faults)
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
