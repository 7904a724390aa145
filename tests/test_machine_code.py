"""C to functions: a cache shared by processes, compilers that fail, disks that are full, folders that are not ours.

The library is one function that returns a number.
"""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest

from redundancy_pin import machine_code

NUMBER = 42


def answer(number: int = NUMBER) -> tuple[int | None, str]:
    """Compile and load a function, call it, and return what it returns; or None and why not."""
    return machine_code.built(
        lambda compiler: machine_code.digest([compiler, str(number)]),
        lambda: f"int rp_answer(void) {{ return {number}; }}",
        lambda path: int(machine_code.loaded(path).rp_answer()),
    )


def works() -> bool:
    return answer() == (NUMBER, "")


def elsewhere(folder: Path, number: int = NUMBER) -> str:
    """The same in a process of its own: what this one has loaded, it would get again whatever the file is."""
    code = (
        "from redundancy_pin import machine_code as m\n"
        f"print(m.built(lambda c: m.digest([c, '{number}']), lambda: 'int rp_answer(void) {{ return {number}; }}',"
        " lambda path: m.loaded(path).rp_answer()))"
    )
    environment = {**os.environ, machine_code.CACHE: str(folder)}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    ).stdout.strip()


def test_the_second_one_is_loaded_and_a_broken_one_built_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(machine_code.CACHE, str(tmp_path / "kept"))
    assert works()
    (library,) = (tmp_path / "kept").iterdir()
    size, kept = library.stat().st_size, library.stat().st_ino
    assert works()
    assert library.stat().st_ino == kept
    library.unlink()  # what this process has loaded stays mapped
    library.write_bytes(b"half a file")
    assert elsewhere(tmp_path / "kept") == f"({NUMBER}, '')"
    assert library.stat().st_size == size


def test_a_library_under_anothers_name_is_built_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(machine_code.CACHE, str(tmp_path))
    assert answer(1) == (1, "")
    (one,) = tmp_path.iterdir()
    assert answer(2) == (2, "")
    (two,) = set(tmp_path.iterdir()) - {one}
    one.replace(two)  # sound machine code
    assert elsewhere(tmp_path, 2) == "(2, '')"
    with pytest.raises(ValueError, match="is the library"):
        machine_code.loaded(two.rename(tmp_path / "other.so"))


def test_names_depend_on_all_that_goes_in() -> None:
    names = {machine_code.digest(parts) for parts in (["ab", "c"], ["a", "bc"], ["ab"], ["ab", "c", ""], ["b", "c"])}
    assert len(names) == 5


@pytest.mark.parametrize("what", ["compiler", "folder"])
def test_on_a_full_disk_it_is_compiled_elsewhere(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = tmp_path / "kept"
    monkeypatch.setenv(machine_code.CACHE, str(kept))
    if what == "compiler":
        full = f'case "$*" in *{kept}*) echo "No space left on device" >&2; exit 1;; esac; exec cc "$@"'
        monkeypatch.setenv("CC", script(tmp_path, full))
        monkeypatch.setattr(machine_code.shutil, "disk_usage", lambda folder: SimpleNamespace(free=4096))
    else:
        make = tempfile.TemporaryDirectory

        def refused(prefix: str, dir: Path | None) -> tempfile.TemporaryDirectory[str]:
            if dir is not None:
                raise OSError(errno.ENOSPC, "No space left on device")
            return make(prefix=prefix)

        monkeypatch.setattr(machine_code.tempfile, "TemporaryDirectory", refused)
    assert works()
    assert list(kept.iterdir()) == []


def test_a_compiler_may_be_named_with_its_arguments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(machine_code.CACHE, "")
    told = tmp_path / "told"
    wrapper = script(tmp_path, f'echo "$1" > {told}; shift; exec "$@"')
    monkeypatch.setenv("CC", f"{wrapper} 'two words' cc")
    assert works()
    assert told.read_text() == "two words\n"
    compiler = machine_code.find_compiler()
    assert compiler is not None
    assert compiler.command == (wrapper, "two words", "cc")
    for unusable in ("'no end", "   ", "nothing-of-this-name -O2"):  # the usual ones serve
        monkeypatch.setenv("CC", unusable)
        assert (other := machine_code.find_compiler()) is not None
        assert len(other.command) == 1


def test_two_processes_build_at_once(tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(elsewhere, [tmp_path / "shared"] * 2)) == [f"({NUMBER}, '')"] * 2
    assert len(list((tmp_path / "shared").iterdir())) == 1


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("echo out of luck >&2; exit 1", "out of luck"),
        ("exit 0", "cannot be loaded"),
        ("sleep 60; exit 0", "did not end"),
    ],
)
def test_a_compiler_that_fails_is_done_without(
    text: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", script(tmp_path, text))
    monkeypatch.setattr(machine_code, "PATIENCE", 0.3)
    made, why = answer()
    assert made is None
    assert reason in why


def test_no_compiler_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    made, why = answer()
    assert made is None
    assert "no C compiler" in why


def script(folder: Path, text: str) -> str:
    path = folder / "compiler"
    path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


@pytest.mark.parametrize("home", ["/proc/nothing", "file"])
def test_a_home_that_cannot_be_written_to(home: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(machine_code.CACHE, home if home.startswith("/") else str(tmp_path / home))
    assert works()


def test_a_folder_that_others_may_write_to_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tmp_path.chmod(0o777)
    monkeypatch.setenv(machine_code.CACHE, str(tmp_path))
    assert works()
    assert list(tmp_path.iterdir()) == []
