"""Files and folders of results appear whole or not at all, and nobody else's are touched."""

from __future__ import annotations

import itertools
import json
import os
import signal
import stat
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from redundancy_pin.errors import OutputError
from redundancy_pin.io import files
from redundancy_pin.io.files import replacing_file, replacing_folder, require_replaceable, require_writable, write_text


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _write_results(folder: Path, *names: str) -> None:
    with replacing_folder(folder) as temporary:
        for name in names:
            write_text(temporary / name, name)
        write_text(temporary / "summary.json", json.dumps({"files": names}))


def test_file_is_written_and_replaced(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    for text in ("one\n", "two\n"):
        write_text(target, text)
        assert target.read_bytes() == text.encode()
    assert _names(tmp_path) == ["a.txt"]


def _modes(folder: Path) -> set[int]:
    return {stat.S_IMODE(path.stat().st_mode) for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002, 0o000])
def test_new_files_and_folders_get_what_the_umask_leaves(mask: int, tmp_path: Path) -> None:
    before = os.umask(mask)
    try:
        write_text(tmp_path / "a.txt", "")
        with replacing_file(tmp_path / "b.txt") as temporary:
            temporary.unlink()  # writers may put another file in its place
            temporary.touch(0o600)
        _write_results(tmp_path / "results")
    finally:
        os.umask(before)
    for name in ("a.txt", "b.txt"):
        assert (tmp_path / name).stat().st_mode & 0o777 == 0o666 & ~mask
    assert (tmp_path / "results").stat().st_mode & 0o777 == 0o777 & ~mask


def test_files_of_other_threads_keep_the_umask(tmp_path: Path) -> None:
    """A writer that sets the umask of the process to read it lets other threads make files that all may write."""
    places = [tmp_path / name for name in ("writers", "others", "results")]
    for place in places:
        place.mkdir()
    end = time.monotonic() + 0.7
    write: list[Callable[[int], object]] = [
        lambda i: write_text(places[0] / f"{i}", ""),
        lambda i: _write_results(places[2] / f"{i}"),
        lambda i: (places[1] / f"a{i}").touch(),
        lambda i: (places[1] / f"b{i}").touch(),
    ]

    def repeat(one: Callable[[int], object]) -> None:
        for i in itertools.count():
            one(i)
            if time.monotonic() > end:
                break

    mask, interval = os.umask(0o027), sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(len(write)) as pool:
            list(pool.map(repeat, write))
    finally:
        sys.setswitchinterval(interval)
        os.umask(mask)
    assert [_modes(place) for place in places] == [{0o640}] * 3
    assert {stat.S_IMODE(path.stat().st_mode) for path in places[2].iterdir()} == {0o750}


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write_half() -> None:
        with replacing_file(target) as temporary:
            temporary.write_text("half of the n")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert target.read_text() == "old"
    assert _names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("none/a.txt", "there is no folder"),
        ("file/a.txt", "there is no folder"),
        ("folder", "it is a folder"),
        ("read-only", "it is read-only"),
        ("pipe", "a pipe or a device"),
        ("loop", "Cannot write"),
        ("x" * 256, "Cannot write"),
        ("x" * 5000, "Cannot write"),
        ("a/" * 3000, "Cannot write"),
        ("a\0b", "Cannot write"),
        ("~nobody-of-that-name/a.txt", "home"),
    ],
)
def test_what_cannot_be_written_is_refused_and_left_alone(name: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for file in ("file", "read-only"):
        (tmp_path / file).write_text("mine")
    (tmp_path / "read-only").chmod(0o444)
    os.mkfifo(tmp_path / "pipe")  # not a real device: a fault would take it from the machine
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    before = _names(tmp_path)
    for write in (lambda path: write_text(path, "new"), require_writable):
        with pytest.raises(OutputError, match=says):
            write(name if name.startswith("~") else tmp_path / name)
    if len(name) > 200 or "\0" in name or name in ("file/a.txt", "none/a.txt", "read-only", "pipe", "loop"):
        with pytest.raises(OutputError):
            require_replaceable(tmp_path / name)
    assert _names(tmp_path) == before
    assert (tmp_path / "read-only").read_text() == "mine"


def test_folder_is_made_and_replaced_as_a_whole(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    _write_results(folder, "a.csv", "b.csv")
    _write_results(folder, "b.csv", "c.csv")
    assert _names(folder) == ["b.csv", "c.csv", "summary.json"]
    assert _names(tmp_path) == ["results"]


def test_empty_folder_is_used(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    _write_results(tmp_path / "results", "a.csv")
    assert _names(tmp_path / "results") == ["a.csv", "summary.json"]


@pytest.mark.parametrize("manifest", [None, "no json", "[]", '{"files": 3}', '{"files": ["other.csv"]}'])
def test_folder_with_other_files_is_left_alone(manifest: str | None, tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    if manifest is not None:
        (folder / "summary.json").write_text(manifest)
    with pytest.raises(OutputError, match=r"mine\.txt"):
        _write_results(folder, "a.csv")
    assert (folder / "mine.txt").read_text() == "mine"
    assert _names(tmp_path) == ["results"]


def test_file_put_there_meanwhile_is_found_before_the_swap(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    _write_results(folder, "a.csv")
    with pytest.raises(OutputError, match=r"late\.txt"), replacing_folder(folder):
        (folder / "late.txt").write_text("mine")
    assert _names(folder) == ["a.csv", "late.txt", "summary.json"]


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["full", "Ctrl-C"])
def test_a_fault_between_the_two_renames_brings_the_old_folder_back(
    fault: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "results"
    _write_results(folder, "a.csv")
    real = os.replace

    def second_fails(source: Path, target: Path) -> None:
        if Path(target) == folder and (Path(source) / "b.csv").exists():
            raise fault
        real(source, target)

    monkeypatch.setattr(files.os, "replace", second_fails)
    with pytest.raises((OutputError, KeyboardInterrupt)) as caught:
        _write_results(folder, "b.csv")
    assert isinstance(caught.value, KeyboardInterrupt) or "No space left" in str(caught.value)
    assert _names(folder) == ["a.csv", "summary.json"]
    assert _names(tmp_path) == ["results"]


def test_current_folder_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    monkeypatch.chdir(inner)
    for target in (".", ".."):
        with pytest.raises(OutputError, match="current folder"):
            require_replaceable(target)


def test_what_a_link_leads_to_is_written(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    target = tmp_path / "there" / "a.txt"
    for link in (tmp_path / "link.txt", tmp_path / "dangling.txt"):
        link.symlink_to(target)
        write_text(link, link.name)
        assert link.is_symlink()
        assert target.read_text() == link.name
        target.unlink()
    assert _names(tmp_path / "there") == []


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666, 0o755])
def test_a_file_that_is_replaced_keeps_its_permissions(mode: int, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "a.txt").chmod(mode)
    write_text(tmp_path / "a.txt", "new")
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == mode
    assert (tmp_path / "a.txt").read_text() == "new"


@pytest.mark.parametrize("step", ["touch", "write", "fsync", "replace"])
def test_a_killed_writer_leaves_the_old_file_whole(step: str, tmp_path: Path) -> None:
    """Killed before the file is made, while it is written, before it is on the disk, and before it takes its place."""
    target = tmp_path / "a.txt"
    write_text(target, "old")
    child = os.fork()
    if child == 0:
        try:
            kill = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)  # noqa: E731
            if step == "touch":
                Path.touch = kill  # type: ignore[method-assign]
            elif step != "write":
                setattr(os, step, kill)

            def parts() -> Iterator[str]:
                yield "n" * 100_000
                if step == "write":
                    kill()
                yield "ew"

            write_text(target, parts())
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert target.read_text() == "old"
    write_text(target, "new")
    assert target.read_text() == "new"
