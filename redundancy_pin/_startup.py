"""Ctrl-C while the command ``redundancy-pin`` is still importing: one line and exit code 130, no traceback.

The imports take a second or two, before any code of the command line could catch an interrupt. A program that imports
the package keeps Python's own handling. This file is imported first, and imports only modules that every interpreter
has loaded already.
"""

from __future__ import annotations

import os
import signal
import sys

INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it


def install() -> None:
    """End quietly when interrupted, if this is the command; until ``done``."""
    command = os.path.splitext(os.path.basename(sys.argv[0]))[0] if sys.argv else ""
    # where interrupts are ignored, as behind nohup, they stay so
    if command == "redundancy-pin" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        try:
            signal.signal(signal.SIGINT, _end)
        except ValueError:
            return  # only the main thread may set handlers


def done() -> None:
    """Hand interrupts back to Python: the command line is there to catch them."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_: object) -> None:
    os.write(2, b"error: interrupted.\n")
    os._exit(INTERRUPTED)  # nothing has been begun that would have to be ended
