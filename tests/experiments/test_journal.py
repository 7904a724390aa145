"""Journals of sweeps and studies: they survive a kill, a full disk and a second run, and refuse what is not theirs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from redundancy_pin.errors import OutputError
from redundancy_pin.experiments.feasibility.cell import Cell, Verdict
from redundancy_pin.experiments.feasibility.journal import CELLS
from redundancy_pin.experiments.journal import digest, open_journal
from redundancy_pin.experiments.robustness.journal import TRIALS
from redundancy_pin.experiments.robustness.trial import Trial

IDENTITY = {"seed": 3, "bounds": {"b": 1.0, "a": 2.0}, "fingerprint": "f"}

KINDS: dict[str, tuple[Any, Any]] = {
    "feasibility": (CELLS, lambda i: Cell("stepwise", 0.1 * i, 1 / 3, Verdict.FEASIBLE, ("track",), "c", 0.1)),
    "robustness": (TRIALS, lambda i: Trial("line", "LQR", i, "completed", "", 1 / 3, 0.1, 1.0, 2.0, 0.0)),
}

KILLED = """
import os, sys, time
from redundancy_pin.experiments import journal
from redundancy_pin.experiments.{kind}.journal import {name}

class HalfALine:  # the third record gets to the disk in part, and then nothing happens any more
    count = 0
    def __getattr__(self, name):
        return getattr(os, name)
    def write(self, handle, data):
        HalfALine.count += 1
        if HalfALine.count < 3:
            return os.write(handle, data)
        os.write(handle, data[:30])
        print("half", flush=True)
        time.sleep(120.0)

journal.os = HalfALine()
with journal.open_journal({name}, sys.argv[1], {identity!r}) as book:
    for line in sys.stdin:
        book.add({name}.read(__import__("json").loads(line)))
"""


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_kill_in_the_middle_of_a_line_costs_that_record_alone(kind: str, tmp_path: Path) -> None:
    lines, make = KINDS[kind]
    path, name = tmp_path / "journal.jsonl", "CELLS" if kind == "feasibility" else "TRIALS"
    program = KILLED.format(kind=kind, name=name, identity=IDENTITY)
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout:
        process.stdin.write("".join(json.dumps(make(i).as_dict()) + "\n" for i in range(3)))
        process.stdin.close()
        assert process.stdout.readline() == "half\n"
        with pytest.raises(OutputError, match="in use by another run"), open_journal(lines, path, IDENTITY):
            pytest.fail("opened twice")
        os.kill(process.pid, signal.SIGKILL)
        process.wait(timeout=60)
    kept = path.read_bytes()
    assert not kept.endswith(b"\n")
    with open_journal(lines, path, IDENTITY) as book:
        assert book.records == {make(i).key: make(i) for i in range(2)}
        book.add(make(2))
    assert path.read_bytes().startswith(kept)
    with open_journal(lines, path, IDENTITY) as book:
        assert list(book.records.values()) == [make(i) for i in range(3)]


@pytest.mark.skipif(os.name == "nt", reason="locks of POSIX")
def test_a_journal_belongs_to_one_run(kind: str, tmp_path: Path) -> None:
    """A second run would compute the same records and cut off what the first writes while it opens the file."""
    lines, make = KINDS[kind]
    path = tmp_path / "journal.jsonl"
    with open_journal(lines, path, IDENTITY) as first:
        with pytest.raises(OutputError, match="in use by another run"), open_journal(lines, path, IDENTITY):
            pytest.fail("opened twice")
        first.add(make(0))
    with open_journal(lines, path, IDENTITY) as again:
        assert len(again.records) == 1


def test_a_full_disk_spoils_no_line(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines, make = KINDS[kind]
    path, write = tmp_path / "journal.jsonl", os.write
    with open_journal(lines, path, IDENTITY) as book:
        book.add(make(0))
        with monkeypatch.context() as patched:
            patched.setattr(os, "write", lambda handle, data: write(handle, data[: len(data) // 2]))
            with pytest.raises(OutputError, match="make room"):
                book.add(make(1))
        assert list(book.records) == [make(0).key]
    with open_journal(lines, path, IDENTITY) as again:
        assert list(again.records) == [make(0).key]
        again.add(make(2))
    assert len([json.loads(line) for line in path.read_bytes().splitlines()]) == 3


def test_of_two_lines_of_one_record_the_first_counts(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    make = KINDS["robustness"][1]
    with open_journal(TRIALS, path, IDENTITY) as book:
        book.add(make(0))
    other = {**make(0).as_dict(), "largest": 9.0}
    path.write_text(path.read_text() + json.dumps(other) + "\n")
    with open_journal(TRIALS, path, IDENTITY) as book:
        assert list(book.records.values()) == [make(0)]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"seed": 4, "fingerprint": "g"}, "for seed it has 3, now it is 4"),
        ({"bounds": {"a": 2.0, "b": 5.0}}, "for bounds.b it has 1.0, now it is 5.0"),
        ({"bounds": {"b": 1.0}}, r"for bounds it has \{'b': 1.0, 'a': 2.0\}, now it is \{'b': 1.0\}"),
        ({"fingerprint": "g"}, "for fingerprint it has 'f', now it is 'g'"),
        ({"further": 1}, "for further it has None, now it is 1"),
    ],
)
def test_what_differs_is_named_and_the_journal_is_left_alone(changed: dict, says: str, kind: str, tmp_path: Path):
    lines, make = KINDS[kind]
    path = tmp_path / "journal.jsonl"
    with open_journal(lines, path, IDENTITY) as book:
        book.add(make(0))
    before = path.read_bytes() + b'{"torn'
    path.write_bytes(before)
    with pytest.raises(OutputError, match=says), open_journal(lines, path, {**IDENTITY, **changed}):
        pytest.fail("opened")
    assert path.read_bytes() == before
    with open_journal(lines, path, IDENTITY) as book:  # the lock is free again
        assert len(book.records) == 1


def test_another_version_of_the_package_is_another_identity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "journal.jsonl"
    with open_journal(TRIALS, path, IDENTITY):
        pass
    monkeypatch.setattr("redundancy_pin.__version__", "99")
    with (
        pytest.raises(OutputError, match=r"for package it has .*, now it is '99'"),
        open_journal(TRIALS, path, IDENTITY),
    ):
        pytest.fail("opened")


def test_the_journal_of_the_other_kind_and_those_of_other_versions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    with open_journal(CELLS, path, IDENTITY):
        pass
    with pytest.raises(OutputError, match="no journal of a robustness study"), open_journal(TRIALS, path, IDENTITY):
        pytest.fail("opened")
    # the header of version 1
    path.write_text(json.dumps({"format": TRIALS.format, "package": "0.1.0", "seed": 0}) + "\n")
    with pytest.raises(OutputError, match=r"version None.*version 2"), open_journal(TRIALS, path, IDENTITY):
        pytest.fail("opened")
    for content in (b"", b"mine\n", b"\xff\n", b"[1]\n"):
        path.write_bytes(content)
        with pytest.raises(OutputError, match="no journal"), open_journal(TRIALS, path, IDENTITY):
            pytest.fail("opened")
        assert path.read_bytes() == content


def test_a_digest_does_not_depend_on_the_order_of_keys() -> None:
    assert digest({"a": 1, "b": {"c": 2, "d": 3}}) == digest({"b": {"d": 3, "c": 2}, "a": 1})
    assert digest({"a": 1}) != digest({"a": 2})
