"""From C to functions that Python calls: the compiler, and a folder of libraries that are compiled once and kept.

A library's name is a hash of all that goes into it, the compiler and its flags included. It is built in a folder of its
own and renamed, so that two processes may build at once; what cannot be loaded is built again.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.resources
import os
import platform
import shlex
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from redundancy_pin.errors import shortened

FLAGS = ("-std=c99", "-O3", "-fno-math-errno", "-fPIC", "-shared")
"""No -ffast-math: see ``NEEDS_INFINITY``."""

NEEDS_INFINITY = """\
#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "The statuses need NaN and infinity: compile without -ffast-math, -Ofast, -ffinite-math-only and /fp:fast."
#endif"""
"""Head of all C of this package: a compiler that assumes finite numbers leaves out the checks for others."""

NATIVE = "-march=native"
"""Flag for what no other machine is to run; its library's name has to tell what this one can (``processor``)."""

PATIENCE = 120.0
"""Seconds after which a compiler counts as hanging."""

CACHE = "REDUNDANCY_PIN_CACHE"
"""Environment variable: the folder for compiled libraries; empty for none that is kept."""

T = TypeVar("T")


@dataclass(frozen=True)
class Compiler:
    """A C compiler: the words of its command, and what tells it from an older one of the same path."""

    command: tuple[str, ...]
    identity: str


def find_compiler() -> Compiler | None:
    """Return the compiler that ``$CC`` names, with its arguments, or the first of cc, gcc and clang; None without."""
    for named in filter(None, (os.environ.get("CC"), "cc", "gcc", "clang")):
        try:
            program, *arguments = [named] if shutil.which(named) else shlex.split(named)
        except ValueError:  # a quotation without end, or nothing but spaces
            continue
        path = shutil.which(program)
        if path is not None:
            file = os.stat(path)
            return Compiler((path, *arguments), " ".join([path, *arguments, str(file.st_size), str(file.st_mtime_ns)]))
    return None


def processor() -> str:
    """Return what tells machines apart that ``NATIVE`` makes other code for."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # not on Linux
        lines = []
    kinds = ("model name", "flags", "Features", "CPU part")
    found = {line.partition(":")[0].strip(): line for line in reversed(lines) if line.startswith(kinds)}
    return "\n".join([platform.machine(), platform.processor(), *(found[name] for name in sorted(found))])


def digest(parts: Iterable[str]) -> str:
    """Return a name for a library: a hash of what goes into it, and of how this file has it compiled."""
    written = importlib.resources.files(__package__).joinpath("machine_code.py").read_text(encoding="utf-8")
    return hashlib.sha256("\0".join([*parts, written]).encode()).hexdigest()[:32]


def built(
    digest_of: Callable[[str], str], write: Callable[[], str], load: Callable[[Path], T], flags: Sequence[str] = FLAGS
) -> tuple[T | None, str]:
    """Return a library, from disk or new; or None and the reason why there is none.

    Args:
        digest_of: returns, from the identity of the compiler, what tells the library from all others (``digest``).
        write: returns the C.
        load: opens a library; raises what ``loaded`` raises where it is another one.
        flags: of the compiler.
    """
    compiler = find_compiler()
    if compiler is None:
        return None, "there is no C compiler (cc, gcc or clang; $CC names another)"
    own = digest_of(compiler.identity)
    name = f"{own}.so"
    folder = cache_folder()
    if folder is not None:
        library = _opened(folder / name, load)
        if library is not None:
            return library, ""
    text = f'{NEEDS_INFINITY}\n{write()}\nconst char {_KEY}[] = "{own}";\n'
    reason = ""
    for place in [None] if folder is None else [folder, None]:
        try:
            with tempfile.TemporaryDirectory(prefix="redundancy_pin-", dir=place) as work:
                made = Path(work) / name
                reason = _compile(compiler, flags, text, made)
                # opened where it was made: under its final name this process may have another one open, which it would
                # get again; what is open stays in memory when its file has gone
                library = None if reason else _opened(made, load)
                if library is not None and place is not None:
                    with contextlib.suppress(OSError):
                        os.replace(made, place / name)
        except OSError as error:  # a full disk, or one that no longer is what it was
            reason = f"there is no place to compile in: {error}"
            continue
        if library is not None:
            return library, ""
        if place is None or not _is_full(place):
            return None, reason or "what the compiler made cannot be loaded"
    return None, reason


_ROOM = 16 << 20
"""Bytes that must be free for a compiler's failure not to be put down to a full disk; a library takes one of them."""


def _is_full(folder: Path) -> bool:
    try:
        return shutil.disk_usage(folder).free < _ROOM
    except OSError:
        return False


def cache_folder() -> Path | None:
    """Return the folder of compiled libraries, made where it is missing; None where none can be kept."""
    named = os.environ.get(CACHE)
    if named == "":
        return None
    try:
        root = (
            Path(named)
            if named
            else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "redundancy_pin"
        )
        root.mkdir(parents=True, exist_ok=True, mode=0o700)
    except (OSError, RuntimeError):  # read-only, or no home
        return None
    # code is loaded from here: whoever else may write here may run code as this user
    status = root.stat()
    shared = hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & 0o022)
    return root if not shared and os.access(root, os.W_OK | os.X_OK) else None


def _opened(path: Path, load: Callable[[Path], T]) -> T | None:
    try:
        return load(path) if path.is_file() else None
    except (OSError, AttributeError, ValueError):  # half a file, another machine's, or of another name
        return None


def _compile(compiler: Compiler, flags: Sequence[str], text: str, target: Path) -> str:
    """Compile a library; return what went wrong, or nothing."""
    try:
        written = target.with_suffix(".c")
        written.write_text(text, encoding="utf-8")
        command = [*compiler.command, *flags, str(written), "-o", str(target), "-lm"]
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        )
        with process:
            try:
                _, complaints = process.communicate(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                _end(process)
                return f"{compiler.command[0]} did not end within {PATIENCE:g} s"
            except BaseException:  # an interrupt
                _end(process)
                raise
    except OSError as error:
        return f"{compiler.command[0]} cannot be used: {error}"
    message = complaints.decode(errors="replace").strip() or "no message"
    return "" if process.returncode == 0 else f"{compiler.command[0]} failed: {shortened(message)}"


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a compiler with the programs that it has started: one of them alive would keep us waiting for its output."""
    with contextlib.suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()


def loaded(path: Path) -> ctypes.CDLL:
    """Return a shared library that says itself that it is the one of its name.

    Raises:
        OSError, AttributeError, ValueError: it is half a file, another machine's, or of another name.
    """
    library = ctypes.CDLL(str(path))
    own = (ctypes.c_char * (len(path.stem) + 1)).in_dll(library, _KEY).value.decode(errors="replace")
    if own != path.stem:
        raise ValueError(f"{path} is the library {own}.")
    return library


_KEY = "rp_key"
"""In every library: the name that it was compiled under."""
