"""Writers of files killed at line after line: what they write is there whole, the old or the new."""

from __future__ import annotations

import os
import signal
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from mutated import plan_of
from promises import Keep

from redundancy_pin.io import files
from redundancy_pin.io.files import write_text

WATCHED = (files.__file__, zipfile.__file__, __file__)
"""Files whose lines count: what writes, and the blocks of this file."""

Writer = Callable[..., None]
"""Writes what is new, or old, to a target."""

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks"),
]


def _text(target: Path, *, new: bool) -> None:
    write_text(target, ("new" if new else "old") * 100_000)


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
    "plan.npz": (_plan, 17),
}
"""Who writes, and every how many-th line of it is the last one."""


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


def _kills(write: Writer, target: Path, stride: int = 1) -> Iterator[str]:
    """Kill a writer at its lines in turn, and give what is wrong each time."""
    write(target, new=True)
    new = target.read_bytes()
    write(target, new=False)
    old = target.read_bytes()
    assert old != new
    for line in count(step=stride):
        if not _killed_at(line, lambda: write(target, new=True)):
            assert target.read_bytes() == new
            return
        yield "" if target.read_bytes() in (old, new) else "half of the results"
        write(target, new=False)


@pytest.mark.parametrize("name", WRITERS)
def test_killed_writers_leave_whole_results(name: str, tmp_path: Path, keep: Keep) -> None:
    write, stride = WRITERS[name]
    faults = list(_kills(write, tmp_path / name, stride))
    wrong = Counter(filter(None, faults))
    keep("kills", f"writers of {name}", {"right": len(faults) - wrong.total(), "wrong": wrong.total()}, wrong)
    assert len(faults) > 30
    assert not wrong


def test_half_a_file_is_seen(tmp_path: Path) -> None:
    """The judge itself: a writer that writes in place."""

    def in_place(target: Path, *, new: bool) -> None:
        with target.open("w") as stream:
            for _ in range(3):
                stream.write("new" if new else "old")
                stream.flush()

    assert "half of the results" in set(_kills(in_place, tmp_path / "a.txt"))
