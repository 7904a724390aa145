"""One input at a time in a forked process: a crash, a hang or a full memory is an outcome, and not the end of the run.

The package is imported whole before the fork, so an input costs milliseconds beyond what it does.
"""

from __future__ import annotations

import functools
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
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
"""Beyond those of the process that forks, for what is refused."""

HANGS = 20
"""Seconds of the processor after which an input is ended: a busy machine is no fault of it."""

ASLEEP = 30
"""Times as many seconds on the clock after which it is ended too: it waits for something."""

MEMORY = 4 * 2**30
"""Bytes of address space beyond those of the process that forks."""

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


def run(action: Action, files: Mapping[str, bytes], patience: int = HANGS, seconds: float = SECONDS) -> Outcome:
    """Do something with files in a folder of its own, in a forked process; a refusal may take ``seconds``."""
    import_all()
    folder = Path(tempfile.mkdtemp(prefix="forked-"))
    try:
        for name, content in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        with tempfile.TemporaryFile() as complaints, tempfile.TemporaryFile() as answer:
            child = os.fork()
            if child == 0:
                _in_child(action, folder, complaints.fileno(), answer.fileno(), patience)
            _, status, usage = os.wait4(child, 0)
            complaints.seek(0)
            answer.seek(0)
            heard, reply = complaints.read().decode("utf-8", "replace").strip(), answer.read()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    taken = usage.ru_utime + usage.ru_stime
    # the resident memory of a forked child starts with that of its parent
    megabytes = max(usage.ru_maxrss - resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, 0) / 1024.0
    code = os.waitstatus_to_exitcode(status)
    if code in (-signal.SIGALRM, -signal.SIGXCPU):
        hangs = f"hangs for {patience} s of the processor" if code == -signal.SIGXCPU else "waits, and does nothing"
        return Outcome(WRONG, hangs, heard[-200:], taken, megabytes)
    if code != 0 or not reply:
        return Outcome(
            WRONG, f"crash: {signal.Signals(-code).name if code < 0 else code}", heard[-200:], taken, megabytes
        )
    verdict, reason, text = json.loads(reply)
    if verdict == REFUSED and taken > seconds:
        verdict, reason = WRONG, f"refused after more than {seconds:g} s"
    if verdict == REFUSED and megabytes > MEGABYTES:
        verdict, reason = WRONG, f"refused after more than {MEGABYTES:g} MB"
    if verdict != WRONG and heard:
        verdict, reason, text = WRONG, f"{verdict}, and a library complains on stderr", heard
    return Outcome(verdict, reason, text[:400], taken, megabytes)


def show(text: str) -> None:
    """Print a line, whatever an input has put into it."""
    sys.stdout.write(text.encode("ascii", "backslashreplace").decode() + "\n")
    sys.stdout.flush()


def _in_child(action: Action, folder: Path, complaints: int, answer: int, patience: int) -> NoReturn:
    try:
        os.setsid()
        os.chdir(folder)
        os.dup2(complaints, 2)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        signal.alarm(ASLEEP * patience)
        resource.setrlimit(resource.RLIMIT_CPU, (patience, resource.RLIM_INFINITY))
        resident = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (resident + MEMORY, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        types: tuple[str, str, str]
        try:
            wrong = action(folder)
            types = (RIGHT, "", "") if wrong is None else (WRONG, ": ".join(wrong.split(": ")[:2]), wrong)
        except RedundancyPinError as error:
            types = (REFUSED, "", str(error))
            if len(str(error)) > 10_000:
                types = (WRONG, "an error of more than 10,000 characters", "")
        except BaseException as error:
            place = next(
                (
                    f"{Path(frame.filename).name}:{frame.name}"
                    for frame in reversed(traceback.extract_tb(error.__traceback__))
                    if "redundancy_pin" in frame.filename
                ),
                "",
            )
            types = (WRONG, f"{type(error).__name__} in {place}", str(error)[:300])
        os.write(answer, json.dumps(types).encode())
    finally:
        os._exit(0)
