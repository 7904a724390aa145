"""Run a part of this package in a child process that has limits of time and memory.

Compilers of strangers' files are third-party code: what makes them loop or allocate ends with the child, and nothing
that the child returns is executed.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence

from redundancy_pin.errors import ModelFileError, RedundancyPinError

SECONDS = 20
"""s of processor time, and of waiting, that a child may take: MuJoCo needs 5 s for the largest humanoids."""

MEGABYTES = 3000
"""MB of address space of a child where the system can limit it; an interpreter with numpy and MuJoCo takes 1000."""

_REFUSED = 3
"""Exit code of a child that writes an error as JSON."""


def run_limited(module: str, arguments: Sequence[str], path: str) -> bytes:
    """Return what a module of this package writes when it runs in a child process; see ``answer``.

    Args:
        module: dotted name of a module that calls ``answer`` when it is run.
        arguments: of its command line.
        path: the file that it reads, for messages.

    Raises:
        ModelFileError: what the child raised, or a child that ended at a limit.
    """
    command = [sys.executable, "-m", module, *arguments]
    try:
        child = subprocess.run(command, capture_output=True, timeout=SECONDS, stdin=subprocess.DEVNULL, check=False)
    except subprocess.TimeoutExpired:
        raise _ended(path, f"takes more than {SECONDS} s") from None
    if child.returncode == _REFUSED:
        said = json.loads(child.stdout)
        raise ModelFileError(said["message"], remedy=said["remedy"], path=path)
    if child.returncode:
        raise _ended(path, f"takes more than {SECONDS} s or {MEGABYTES} MB, or fails (exit code {child.returncode})")
    return child.stdout


def _ended(path: str, what: str) -> ModelFileError:
    remedy = "Read it without untrusted=True if you trust its author, or make it smaller."
    return ModelFileError(f"{path}: reading the file {what}.", remedy=remedy, path=path)


def answer(function: Callable[..., bytes]) -> None:
    """Set the limits of this process, and write what a function of the command line's arguments returns.

    What libraries print goes to the error stream.
    """
    with contextlib.suppress(ImportError, ValueError, OSError):  # systems without such limits, or with lower ones
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (MEGABYTES << 20, MEGABYTES << 20))
    output = os.dup(1)
    os.dup2(2, 1)
    code = 0
    try:
        content = function(*sys.argv[1:])
    except RedundancyPinError as error:
        code, content = _REFUSED, json.dumps({"message": error.message, "remedy": error.remedy}).encode()
    except MemoryError:
        code, content = 1, b""
    with os.fdopen(output, "wb") as stream:
        stream.write(content)
    os._exit(code)  # libraries of a process that ran out of memory are not unloaded
