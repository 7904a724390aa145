"""One input at a time in a forked process: a crash, a hang or a full memory is an outcome, and not the end of the run.

The package is imported whole before the fork, so an input costs milliseconds beyond what it does.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import json
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import click

import redundancy_pin as rp
from redundancy_pin.cli import COMMANDS, main
from redundancy_pin.errors import RedundancyPinError

SECONDS = 2.0
"""Of the processor, for what is refused."""

MEGABYTES = 500.0
"""Beyond what the process has when it starts, for what is refused."""

HANGS = 20
"""Seconds of the processor after which an input is ended: a busy machine is no fault of it."""

ASLEEP = 30
"""Times as many seconds on the clock after which it is ended too: it waits for something."""

MEMORY = 4096.0
"""MB of address space beyond those of the process that forks."""

RIGHT, REFUSED, WRONG = "right", "refused", "wrong"

Action = Callable[[Path], str | None]
"""Does something with the files of a folder; returns None or what is wrong, such as "accepted: class: numbers"."""


@dataclass(frozen=True)
class Outcome:
    """How an input ended: ``verdict`` is RIGHT, REFUSED or WRONG, ``reason`` a class of what is wrong."""

    verdict: str
    reason: str = ""
    text: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0


@functools.cache
def import_all() -> None:
    """Import what is imported when it is used: in each fork anew it would count as the time of each input."""
    for library in ("rich.console", "rich.table", "scipy.linalg", "scipy.optimize", "scipy.spatial.transform"):
        importlib.import_module(library)
    for name in rp.__all__:
        getattr(rp, name)
    for name in COMMANDS:
        main.get_command(click.Context(main), name)


@dataclass(frozen=True)
class Ended:
    """How a forked process ended: its exit code, negative for a signal, what it printed, seconds and MB it took."""

    code: int
    out: str
    err: str
    seconds: float
    megabytes: float


def fork(body: Callable[[], int], folder: Path, patience: int, clock: int) -> Ended:
    """Run something in a forked process in a folder, with streams, time and memory of its own.

    ``patience``: seconds of the processor, ``clock``: those on the clock, after which it is ended. ``body`` returns the
    exit code, or raises ``SystemExit``; after another error its traceback is printed, and the code is 1.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err, tempfile.TemporaryFile() as base:
        sys.stdout.flush()
        sys.stderr.flush()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child has none of its own to wait for
            child = os.fork()
        if child == 0:
            _in_child(body, folder, (out.fileno(), err.fileno(), base.fileno()), patience, clock)
        _, status, usage = os.wait4(child, 0)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child, signal.SIGKILL)  # workers it may have left
        for stream in (out, err, base):
            stream.seek(0)
        printed, complaints = (stream.read().decode("utf-8", "replace") for stream in (out, err))
        megabytes = usage.ru_maxrss / 1024.0 - float(base.read())
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, printed, complaints, usage.ru_utime + usage.ru_stime, max(megabytes, 0.0))


def _megabytes(column: int) -> float:
    """Return the virtual (0) or resident (1) memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[column])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _in_child(
    body: Callable[[], int], folder: Path, handles: tuple[int, int, int], patience: int, clock: int
) -> NoReturn:
    code = 99
    try:
        os.setsid()  # so that workers of the child are no workers of the test
        os.chdir(folder)
        for number, handle in enumerate((os.open(os.devnull, os.O_RDONLY), *handles[:2])):
            os.dup2(handle, number)
        sys.stdin, sys.stdout, sys.stderr = (
            os.fdopen(number, mode, encoding="utf-8", errors="backslashreplace", closefd=False)
            for number, mode in ((0, "r"), (1, "w"), (2, "w"))
        )
        for one in (signal.SIGALRM, signal.SIGXCPU):
            signal.signal(one, signal.SIG_DFL)
        signal.alarm(clock)
        resource.setrlimit(resource.RLIMIT_CPU, (patience, resource.RLIM_INFINITY))
        # pages of the parent that a child shares without having read them do not count for it
        os.write(handles[2], repr(_megabytes(1)).encode())
        most = int((_megabytes(0) + MEMORY) * 2**20)
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        try:
            code = body()
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else 0 if leaving.code is None else 1
        except BaseException:
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def run(action: Action, files: Mapping[str, bytes], patience: int = HANGS, seconds: float = SECONDS) -> Outcome:
    """Do something with files in a folder of its own, in a forked process; a refusal may take ``seconds``."""
    import_all()
    with tempfile.TemporaryDirectory(prefix="forked-") as name, tempfile.TemporaryFile() as answer:
        folder = Path(name)
        for file, content in files.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_bytes(content)
        ended = fork(lambda: _answer(action, folder, answer.fileno()), folder, patience, ASLEEP * patience)
        answer.seek(0)
        reply, heard = answer.read(), ended.err.strip()
    if ended.code in (-signal.SIGALRM, -signal.SIGXCPU):
        hangs = (
            f"hangs for {patience} s of the processor" if ended.code == -signal.SIGXCPU else "waits, and does nothing"
        )
        return Outcome(WRONG, hangs, heard[-200:], ended.seconds, ended.megabytes)
    if ended.code != 0 or not reply:
        name = signal.Signals(-ended.code).name if ended.code < 0 else str(ended.code)
        return Outcome(WRONG, f"crash: {name}", heard[-200:], ended.seconds, ended.megabytes)
    verdict, reason, text = json.loads(reply)
    if verdict == REFUSED and ended.seconds > seconds:
        verdict, reason = WRONG, f"refused after more than {seconds:g} s"
    if verdict == REFUSED and ended.megabytes > MEGABYTES:
        verdict, reason = WRONG, f"refused after more than {MEGABYTES:g} MB"
    if verdict != WRONG and heard:
        verdict, reason, text = WRONG, f"{verdict}, and a library complains on stderr", heard
    return Outcome(verdict, reason, text[:400], ended.seconds, ended.megabytes)


def _answer(action: Action, folder: Path, answer: int) -> int:
    """Do something in the child, and write down verdict, class and text of how it ended."""
    try:
        wrong = action(folder)
        types = (RIGHT, "", "") if wrong is None else (WRONG, ": ".join(wrong.split(": ")[:2]), wrong)
    except RedundancyPinError as error:
        types = (REFUSED, "", str(error))
        if len(str(error)) > 10_000:
            types = (WRONG, "an error of more than 10,000 characters", "")
    except BaseException as error:
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "redundancy_pin" in frame.filename]
        place = f"{Path(frames[-1].filename).name}:{frames[-1].name}" if frames else ""
        types = (WRONG, f"{type(error).__name__} in {place}", str(error)[:300])
    os.write(answer, json.dumps(types).encode())
    return 0


def show(text: str) -> None:
    """Print a line, whatever an input has put into it."""
    sys.stdout.write(text.encode("ascii", "backslashreplace").decode() + "\n")
    sys.stdout.flush()
