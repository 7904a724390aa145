"""From C to functions that Python calls: the compiler, and a folder of libraries that are compiled once and kept.

A library's name is a hash of all that goes into it, the compiler and its flags included. It is built in a folder of its
own and renamed, so that two processes may build at once; what cannot be loaded is built again.

Whoever can change a library that is loaded runs code as this user. So its folder and its file belong to this user, who
alone may write to them, and no other user but root can rename a folder above. What is otherwise is not loaded.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.resources
import importlib.util
import itertools
import logging
import os
import platform
import shlex
import shutil
import signal
import stat
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

from redundancy_pin.errors import shortened

_LOG = logging.getLogger(__name__)

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
"""Environment variable: the folder for compiled libraries, an absolute path; empty for none that is kept."""

T = TypeVar("T")


@dataclass(frozen=True)
class Compiler:
    """A C compiler: the words of its command, and an identity that changes with its version."""

    command: tuple[str, ...]
    identity: str


NO_COMPILER = "there is no C compiler (cc, gcc or clang; $CC names another)"
"""Why nothing can be compiled on a system without a compiler."""

REMEDY = "Install a C compiler, or one that pip brings: `pip install 'redundancy_pin[compiler]'`."
"""What to do without a compiler."""


def find_compiler() -> Compiler | None:
    """Return the C compiler of this system; None without one.

    The first of these that exists: what ``$CC`` names, with its arguments; cc, gcc, clang on the path; the Zig compiler
    of the package ziglang (extra ``compiler``), which compiles C as clang does.
    """
    for named in filter(None, (os.environ.get("CC"), "cc", "gcc", "clang")):
        try:
            program, *arguments = [named] if shutil.which(named) else shlex.split(named)
        except ValueError:  # a quotation without end, or nothing but spaces
            continue
        path = shutil.which(program)
        if path is not None:
            return _identified(path, *arguments)
    return _find_ziglang()


def _find_ziglang() -> Compiler | None:
    """Return the C compiler of the package ziglang, where that is installed."""
    package = importlib.util.find_spec("ziglang")
    for folder in package.submodule_search_locations or () if package is not None else ():
        program = shutil.which("zig", path=folder)
        if program is not None:
            # Zig compiles for this processor unless told otherwise, and the cache may be shared with other machines; a
            # later -march=native (``NATIVE``) overrides the option
            return _identified(program, "cc", "-mcpu=baseline")
    return None


def _identified(path: str, *arguments: str) -> Compiler:
    file = os.stat(path)
    return Compiler((path, *arguments), " ".join([path, *arguments, str(file.st_size), str(file.st_mtime_ns)]))


def processor() -> str:
    """Return an identity of the processor; ``NATIVE`` makes other code for another one."""
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
    """Return a library, from disk or new; or None and the reason.

    Args:
        digest_of: returns, from the identity of the compiler, the identity of the library (``digest``).
        write: returns the C.
        load: opens a library; raises as ``loaded`` if it is another library.
        flags: of the compiler.
    """
    compiler = find_compiler()
    if compiler is None:
        return None, NO_COMPILER
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
            with tempfile.TemporaryDirectory(dir=place, prefix=".", ignore_cleanup_errors=True) as work:
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
    """Return the folder of compiled libraries, created if missing; None if none can be kept."""
    named = os.environ.get(CACHE)
    if named == "":
        return None
    try:
        folder = Path(named) if named else _user_cache() / "redundancy_pin"
        reason = _make_trusted(folder := folder.resolve()) if folder.is_absolute() else f"{folder} is a relative path"
    except (OSError, RuntimeError):  # read-only, or no home
        return None
    if reason:
        _note(f"No compiled library is loaded or kept: {reason}. Change that, or name another folder in ${CACHE}.")
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def _user_cache() -> Path:
    """Return ``$XDG_CACHE_HOME``, or ``~/.cache`` if that is not an absolute path: its specification ignores those."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return named if named.is_absolute() else Path.home() / ".cache"


def _make_trusted(folder: Path) -> str:
    """Make a folder where it is missing, and return why other users could change what it holds; empty if they cannot.

    From the root down: what is above a folder is known to be safe before that folder is looked at, so no other user can
    replace it between this check and its use.
    """
    if not hasattr(os, "geteuid"):
        return ""
    user = os.geteuid()
    for each in (*reversed(folder.parents), folder):
        if not each.exists():
            with contextlib.suppress(FileExistsError):  # another process was quicker
                each.mkdir(0o700)
                each.chmod(0o700)  # the umask may have taken rights of the user
        status, last = each.lstat(), each == folder
        if not stat.S_ISDIR(status.st_mode):
            return f"{each} is no folder"
        if status.st_uid != user and (last or status.st_uid != 0):
            return f"{each} belongs to user {status.st_uid}"
        # in a folder that has the sticky bit, such as /tmp, others cannot rename what is not theirs
        if status.st_mode & 0o022 and (last or not status.st_mode & stat.S_ISVTX):
            return f"others may write to {each} (mode {stat.S_IMODE(status.st_mode):04o})"
    return ""


@lru_cache(maxsize=100)  # once for each process
def _note(text: str) -> None:
    _LOG.warning(text)


def _opened(path: Path, load: Callable[[Path], T]) -> T | None:
    try:
        return load(path)
    except PermissionError as error:
        _note(f"A compiled library is not loaded, and is compiled again: {error}.")
    except (OSError, AttributeError, ValueError):  # none, half a file, another machine's, or of another name
        pass
    return None


def _compile(compiler: Compiler, flags: Sequence[str], text: str, target: Path) -> str:
    """Compile a library; return what went wrong, or nothing."""
    try:
        written = target.with_suffix(".c")
        written.write_text(text, encoding="utf-8")
        command = [*_WATCHED, *compiler.command, *flags, str(written), "-o", str(target), "-lm"]
        # its own temporary files too go where they are removed
        environment = {**os.environ, "TMPDIR": str(target.parent)}
        with (
            _pipe() as end,
            subprocess.Popen(
                command[0 if os.name == "posix" else len(_WATCHED) :],
                env=environment,
                stdin=end,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,
            ) as process,
        ):
            try:
                _, complaints = process.communicate(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                _end(process)
                return f"{compiler.command[0]} did not end within {PATIENCE:g} s"
            except BaseException:  # an interrupt
                _end(process)
                raise
        if process.returncode == 0 and target.exists():
            target.chmod(0o600)  # whatever the umask
    except OSError as error:
        return f"{compiler.command[0]} cannot be used: {error}"
    message = complaints.decode(errors="replace").strip() or "no message"
    return "" if process.returncode == 0 else f"{compiler.command[0]} failed: {shortened(message)}"


_WATCHED = (
    "/bin/sh",
    "-c",
    """exec 3<&0 </dev/null
{ read -r line <&3; kill -KILL 0; } >/dev/null 2>&1 &
"$@"
status=$?
kill -KILL $! 2>/dev/null
exit $status""",
    "compiler",
)
"""Runs a command, and kills its process group when the pipe that is its standard input is closed at the other end.

The kernel closes it when the caller is killed, by SIGKILL too. The death signal of ``prctl`` would reach the compiler's
driver and not what that has started; and what Python runs between fork and exec may deadlock where there are threads.
"""


@contextlib.contextmanager
def _pipe() -> Iterator[int]:
    """Give the end of a pipe for a child to read, whose other end no child has and closes with this process."""
    reading, writing = os.pipe()
    try:
        yield reading
    finally:
        os.close(reading)
        os.close(writing)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a compiler with the programs that it has started: one of them alive would keep us waiting for its output."""
    with contextlib.suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()


def loaded(path: Path) -> ctypes.CDLL:
    """Return a shared library whose own identity matches its name.

    Raises:
        OSError, AttributeError, ValueError: it is half a file, another machine's, or of another name. PermissionError:
            it is not this user's file, or others may write to it.
    """
    with _checked(path) as name:
        library = ctypes.CDLL(name)
    own = (ctypes.c_char * (len(path.stem) + 1)).in_dll(library, _KEY).value.decode(errors="replace")
    if own != path.stem:
        raise ValueError(f"{path} is the library {own}.")
    return library


@contextlib.contextmanager
def _checked(path: Path) -> Iterator[str]:
    """Give the name under which to load a file that only this user can have written."""
    if not hasattr(os, "geteuid"):
        yield str(path)
        return
    if path.is_symlink():
        raise PermissionError(f"{path} is a link")
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise PermissionError(f"{path} is no file")
        if status.st_uid != os.geteuid():
            raise PermissionError(f"{path} belongs to user {status.st_uid}")
        if status.st_mode & 0o022:
            raise PermissionError(f"others may write to {path} (mode {stat.S_IMODE(status.st_mode):04o})")
        # through its descriptor: the file that was checked, whatever has that path now. Without /proc, as on macOS, the
        # folder has to do, in which nobody else can put another file there (``_make_trusted``)
        yield f"{_DESCRIPTORS}{_unused()}/{handle}" if os.path.isdir(_DESCRIPTORS) else str(path)
    finally:
        os.close(handle)


def _unused() -> str:
    """Return slashes and dots that change no path, never the same twice.

    glibc takes a name that it has loaded for the library of then, and numbers of descriptors are given again.
    """
    return "".join("/." if digit == "1" else "/" for digit in f"{next(_LOADS):b}")


_DESCRIPTORS, _LOADS = "/proc/self/fd", itertools.count(1)

_KEY = "rp_key"
"""In every library: the name that it was compiled under."""
