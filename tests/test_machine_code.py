"""C to functions: a cache shared by processes, compilers that fail, disks that are full, folders that are not ours.

The library is one function that returns a number.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

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
        make = os.mkdir

        def refused(path: str, *arguments: int) -> None:
            if Path(path).parent == kept:
                raise OSError(errno.ENOSPC, "No space left on device")
            make(path, *arguments)

        monkeypatch.setattr(os, "mkdir", refused)
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


def test_the_compiler_that_pip_brings_is_the_last_choice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package ziglang whose zig is the compiler of this system, and writes down what it is told."""
    compiler, package, told = machine_code.find_compiler(), tmp_path / "ziglang", tmp_path / "told"
    assert compiler is not None
    package.mkdir()
    (package / "__init__.py").touch()
    own = shlex.join(compiler.command)
    zig = Path(script(tmp_path, f'echo "$@" > {told}; shift 2; exec {own} "$@"')).rename(package / "zig")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(machine_code.CACHE, "")
    assert machine_code.find_compiler() == compiler
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(machine_code.shutil, "which", shutil_without("cc", "gcc", "clang"))
    found = machine_code.find_compiler()
    assert found is not None
    # any processor of this kind may run what is kept, unless a later option says otherwise
    assert found.command == (str(zig), "cc", "-mcpu=baseline")
    assert works()
    assert told.read_text().startswith("cc -mcpu=baseline -std=c99 -O3")
    zig.unlink()
    assert machine_code.find_compiler() is None
    assert answer() == (None, machine_code.NO_COMPILER)


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_nothing_is_built() -> None:
    assert machine_code.find_compiler() is None
    assert answer() == (None, machine_code.NO_COMPILER)


def test_ziglang_compiles_what_others_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ziglang", reason="pip install 'redundancy_pin[compiler]'")
    monkeypatch.setenv(machine_code.CACHE, "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(machine_code.shutil, "which", shutil_without("cc", "gcc", "clang"))
    found = machine_code.find_compiler()
    assert found is not None
    assert found.command[1] == "cc"
    assert works()


def shutil_without(*names: str) -> Callable[..., str | None]:
    """``shutil.which`` on a system without some programs."""
    which = shutil.which
    return lambda program, **where: None if program in names else which(program, **where)


def test_two_processes_build_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", script(tmp_path, 'sleep 0.4; exec cc "$@"'))
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(elsewhere, [tmp_path / "shared"] * 2)) == [f"({NUMBER}, '')"] * 2
    assert [path.suffix for path in (tmp_path / "shared").iterdir()] == [".so"]


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


# --- who may write what is loaded ------------------------------------------------------------------------------------

POISON = 13
NOBODY = 65534
as_root = pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs files of another user")


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache whose library is not the one of its name: whoever calls it gets POISON."""
    folder = tmp_path / "above" / "kept"
    monkeypatch.setenv(machine_code.CACHE, str(folder))
    assert compile_as(POISON) == (POISON, "")
    return folder


def compile_as(number: int) -> tuple[int | None, str]:
    """As ``answer``, under the name of the function that returns NUMBER."""
    return machine_code.built(
        lambda compiler: machine_code.digest([compiler, str(NUMBER)]),
        lambda: f"int rp_answer(void) {{ return {number}; }}",
        lambda path: int(machine_code.loaded(path).rp_answer()),
    )


def library_in(folder: Path) -> Path:
    (library,) = folder.iterdir()
    return library


def link_to_a_copy(folder: Path) -> None:
    library = library_in(folder)
    library.symlink_to(library.rename(folder.parent / "copy.so"))


def to_nobody(path: Path) -> None:
    os.chown(path, NOBODY, NOBODY)


HARMLESS: dict[str, Callable[[Path], object]] = {
    "as it is": lambda folder: None,
    "others may read it": lambda folder: (library_in(folder).chmod(0o755), folder.chmod(0o755)),
    "a sticky folder above": lambda folder: folder.parent.chmod(0o1777),
}
OF_A_FILE: dict[str, Callable[[Path], object]] = {
    "all may write the file": lambda folder: library_in(folder).chmod(0o666),
    "the group may write the file": lambda folder: library_in(folder).chmod(0o660),
    "a link": link_to_a_copy,
    "the file of another user": lambda folder: to_nobody(library_in(folder)),
}
OF_A_FOLDER: dict[str, Callable[[Path], object]] = {
    "all may write to the folder": lambda folder: folder.chmod(0o777),
    "all may write to the folder, which is sticky": lambda folder: folder.chmod(0o1777),
    "the group may write to the folder": lambda folder: folder.chmod(0o770),
    "the folder of another user": to_nobody,
    "all may write to the folder above": lambda folder: folder.parent.chmod(0o777),
    "the folder above of another user": lambda folder: to_nobody(folder.parent),
    "the sticky folder above of another user": lambda folder: (folder.parent.chmod(0o1777), to_nobody(folder.parent)),
}


def cases(*tables: Mapping[str, object]) -> list[Any]:
    return [
        pytest.param(name, marks=[as_root] if "another user" in name else [], id=name)
        for table in tables
        for name in table
    ]


@pytest.mark.parametrize("name", HARMLESS)
def test_what_only_this_user_may_write_is_loaded(name: str, kept: Path, caplog: pytest.LogCaptureFixture) -> None:
    HARMLESS[name](kept)
    assert answer() == (POISON, "")
    assert not caplog.records


@pytest.mark.parametrize("name", cases(OF_A_FILE))
def test_a_file_that_others_may_have_written_is_built_again(
    name: str, kept: Path, caplog: pytest.LogCaptureFixture
) -> None:
    OF_A_FILE[name](kept)
    assert works()
    assert works()
    library = library_in(kept)
    assert not library.is_symlink()
    status = library.stat()
    assert (status.st_uid, stat.S_IMODE(status.st_mode)) == (os.geteuid(), 0o600)
    (note,) = caplog.messages
    assert str(library) in note
    assert "not loaded" in note


@pytest.mark.parametrize("name", cases(OF_A_FOLDER))
def test_a_folder_that_others_may_change_is_not_used(name: str, kept: Path, caplog: pytest.LogCaptureFixture) -> None:
    library = library_in(kept)
    OF_A_FOLDER[name](kept)
    assert works()
    assert works()
    assert library_in(kept) == library
    (note,) = caplog.messages
    assert str(kept.parent if "above" in name else kept) in note
    assert machine_code.CACHE in note


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="loads by path")
def test_the_file_that_was_checked_is_the_one_that_is_loaded(
    kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    poisoned = library_in(kept)
    monkeypatch.setenv(machine_code.CACHE, str(tmp_path / "sound"))
    assert works()
    sound, load = library_in(tmp_path / "sound"), ctypes.CDLL

    def load_late(name: str) -> ctypes.CDLL:
        os.replace(poisoned, sound)
        return load(name)

    monkeypatch.setattr(machine_code.ctypes, "CDLL", load_late)
    assert machine_code.loaded(sound).rp_answer() == NUMBER
    assert not poisoned.exists()


@pytest.mark.parametrize("mask", [0o000, 0o002, 0o077, 0o177])
def test_modes_do_not_depend_on_the_umask(mask: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if mask == 0o177 and os.geteuid() != 0:
        pytest.skip("a compiler cannot enter the folders that this user makes")
    monkeypatch.setenv(machine_code.CACHE, str(tmp_path / "above" / "kept"))
    before = os.umask(mask)
    try:
        assert works()
    finally:
        os.umask(before)
    folder = tmp_path / "above" / "kept"
    modes = [stat.S_IMODE(path.stat().st_mode) for path in (folder.parent, folder, library_in(folder))]
    assert modes == [0o700, 0o700, 0o600]


def test_relative_folders_are_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A folder that somebody is in may come from anywhere; XDG's specification has relative paths ignored."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.delenv(machine_code.CACHE)
    assert works()
    assert machine_code.cache_folder() == tmp_path / "home" / ".cache" / "redundancy_pin"
    assert library_in(tmp_path / "home" / ".cache" / "redundancy_pin").suffix == ".so"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "absolute"))
    assert machine_code.cache_folder() == tmp_path / "absolute" / "redundancy_pin"
    assert not caplog.records
    for variable, value in ((machine_code.CACHE, "relative"), ("HOME", "relative")):
        monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
        monkeypatch.delenv(machine_code.CACHE, raising=False)
        monkeypatch.setenv(variable, value)
        assert works()
        assert machine_code.cache_folder() is None
    assert len(caplog.records) == 2
    assert "relative" in caplog.text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["absolute", "home"]


@as_root
def test_another_user_than_root_trusts_only_its_own(kept: Path) -> None:
    """In a process that becomes somebody else; folders above belong to root, as everywhere."""
    poisoned = library_in(kept)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        place.chmod(0o755)
        own = place / "own"
        own.mkdir(0o700)
        to_nobody(own)
        file = own / poisoned.name
        os.environ[machine_code.CACHE] = str(own)
        for owner, expected in ((NOBODY, POISON), (0, NUMBER)):
            shutil.copyfile(poisoned, file)
            file.chmod(0o644)
            os.chown(file, owner, owner)
            child = os.fork()
            if child == 0:
                try:
                    os.setgroups([])
                    os.setgid(NOBODY)
                    os.setuid(NOBODY)
                    os._exit(answer()[0] or 0)
                finally:
                    os._exit(1)
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == expected
        assert (file.stat().st_uid, stat.S_IMODE(file.stat().st_mode)) == (NOBODY, 0o600)
        # root does not trust what is nobody's
        assert works()


# --- compilers whose caller is gone ----------------------------------------------------------------------------------


def alive(process: int) -> bool:
    """Return whether a process runs; one that has ended may wait for its parent to ask."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def compiler_that_hangs(folder: Path) -> tuple[str, Path]:
    """Return a compiler as gcc is, which starts another program and has temporary files; and where it says who runs."""
    log = folder / "processes"
    text = f'sleep 300 & touch "$TMPDIR/half.s"; echo $$ $! > {log}.new; mv {log}.new {log}; wait'
    return script(folder, text), log


def running(log: Path) -> list[int]:
    for _ in range(1000):
        if log.exists():
            return [int(word) for word in log.read_text().split()]
        time.sleep(0.01)
    raise AssertionError("no compiler has been started")


def ended(processes: list[int]) -> bool:
    for _ in range(500):
        if not any(map(alive, processes)):
            return True
        time.sleep(0.01)
    return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
@pytest.mark.parametrize(
    ("how", "where"),
    [(signal.SIGKILL, "cache"), (signal.SIGKILL, "temporary"), (signal.SIGTERM, "cache"), (signal.SIGINT, "cache")],
)
def test_a_killed_compile_leaves_no_compiler_and_the_next_one_works(
    how: signal.Signals, where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary, kept = tmp_path / "temporary", tmp_path / "cache"
    temporary.mkdir()
    compiler, log = compiler_that_hangs(tmp_path)
    monkeypatch.setenv(machine_code.CACHE, str(kept) if where == "cache" else "")
    environment = {**os.environ, "CC": compiler, "TMPDIR": str(temporary)}
    code = (  # a shell's background job, and all it starts, would ignore SIGINT
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from redundancy_pin import machine_code as m\n"
        "m.built(lambda compiler: 'x', lambda: 'int rp_answer(void) { return 1; }', m.loaded)"
    )
    with subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.DEVNULL) as process:
        processes = running(log)
        assert all(map(alive, processes))
        process.send_signal(how)
        process.wait()
        assert ended(processes)
    place = tmp_path / where
    assert len(list(place.iterdir())) == (how != signal.SIGINT)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    assert works()
    assert [path.suffix for path in place.iterdir() if path.is_file()] == ([".so"] if where == "cache" else [])


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
def test_a_compiler_that_hangs_is_killed_with_what_it_has_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler, log = compiler_that_hangs(tmp_path)
    monkeypatch.setenv("CC", compiler)
    monkeypatch.setattr(machine_code, "PATIENCE", 0.5)
    made, why = answer()
    assert (made, "did not end" in why) == (None, True)
    assert ended(running(log))
