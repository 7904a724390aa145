"""Writers killed at line after line: their results are there whole, the old or the new, and nothing is left over."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from mutated import plan_of
from promises import Keep

from redundancy_pin.io import files
from redundancy_pin.io.files import replacing_file, replacing_folder, write_text

WATCHED = (files.__file__, shutil.__file__, zipfile.__file__, __file__)
"""Files whose lines count: what writes, what removes, and the blocks of this file."""

Writer = Callable[..., None]
"""Writes what is new, or old, to a target."""

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks; leftovers stay where there are no locks"),
]


def _text(target: Path, *, new: bool) -> None:
    write_text(target, ("new" if new else "old") * 100_000)


def _results(target: Path, *, new: bool) -> None:
    names = ("a.csv", "b.csv") if new else ("b.csv", "c.csv", "d.csv")
    with replacing_folder(target) as folder:
        for name in names:
            write_text(folder / name, f"{name} {new}")
        write_text(folder / "summary.json", json.dumps({"files": names}))


def _linked(target: Path, *, new: bool) -> None:
    link = target.parent / "link.txt"
    if not link.is_symlink():
        link.symlink_to(target)
    _text(link, new=new)


def _plan(target: Path, *, new: bool) -> None:
    plan_of("five_bar" if new else "2rpr").save(target)


WRITERS: dict[str, tuple[Writer, int]] = {
    "text.txt": (_text, 1),
    "linked.txt": (_linked, 1),
    "results": (_results, 3),
    "plan.npz": (_plan, 17),
}
"""Who writes, and every how many-th line of it is the last one."""


def _content(target: Path) -> dict[str, bytes]:
    """Return what a file or folder holds; nothing where there is none."""
    parts = [target] if target.is_file() else sorted(target.rglob("*"))
    return {path.name: path.read_bytes() for path in parts if path.is_file()}


def _killed_at(line: int, write: Callable[[], None]) -> bool:
    """Write in a process that is killed before its line of this number; False if it was done before."""
    child = os.fork()
    if child == 0:
        left = iter(range(line))

        def trace(frame: FrameType, event: str, _: Any) -> Any:
            if frame.f_code.co_filename not in WATCHED:
                return None
            if event == "line" and next(left, None) is None:
                os.kill(os.getpid(), signal.SIGKILL)
            return trace

        sys.settrace(trace)
        write()
        sys.settrace(None)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, -signal.SIGKILL)
    return code != 0


def _fault(target: Path, old: dict[str, bytes], new: dict[str, bytes], others: set[str]) -> str:
    """Return what is wrong after a kill, and after the next writer, which fails; empty if nothing is."""
    whole = (old, new)
    # a folder is moved aside before its successor takes its place: what comes next brings it back
    if target.suffix and _content(target) not in whole:
        return "half of the results"
    next_one = replacing_file if target.suffix else replacing_folder
    with suppress(RuntimeError), next_one(target):
        raise RuntimeError
    if _content(target) not in whole:
        return "half of the results, after the next writer"
    left = {path.name for path in target.parent.iterdir()} - others - {target.name}
    return f"{len(left)} left over" if left else ""


def _kills(write: Writer, target: Path, stride: int = 1) -> Iterator[str]:
    """Kill a writer at its lines in turn, and give what is wrong each time."""
    write(target, new=True)
    new = _content(target)
    write(target, new=False)
    old, others = _content(target), {path.name for path in target.parent.iterdir()}
    assert old != new
    for line in count(step=stride):
        killed = _killed_at(line, lambda: write(target, new=True))
        if not killed:
            assert _content(target) == new
            return
        yield _fault(target, old, new, others)
        write(target, new=False)


@pytest.mark.parametrize("name", WRITERS)
def test_killed_writers_leave_whole_results_and_nothing_else(name: str, tmp_path: Path, keep: Keep) -> None:
    write, stride = WRITERS[name]
    faults = list(_kills(write, tmp_path / name, stride))
    wrong = Counter(filter(None, faults))
    keep("kills", f"writers of {name}", {"right": len(faults) - wrong.total(), "wrong": wrong.total()}, wrong)
    assert len(faults) > 50
    assert not wrong


def test_half_a_file_is_seen(tmp_path: Path) -> None:
    """The judge itself: a writer that writes in place, and one that leaves what it does not need."""

    def in_place(target: Path, *, new: bool) -> None:
        with target.open("w") as stream:
            for _ in range(3):
                stream.write("new" if new else "old")
                stream.flush()

    def untidy(target: Path, *, new: bool) -> None:
        beside = target.with_name("beside")
        beside.touch()
        write_text(target, f"{new}")
        beside.unlink()

    assert "half of the results" in set(_kills(in_place, tmp_path / "a.txt"))
    assert "1 left over" in set(_kills(untidy, tmp_path / "b.txt"))
