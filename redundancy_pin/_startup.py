"""Ctrl-C while the command ``redundancy-pin`` is still importing: one line and exit code 130, no traceback.

The imports take a second or two, before any code of the command line could catch an interrupt. A program that imports
the package keeps Python's own handling.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

INTERRUPTED = 130  # exit code after Ctrl-C, as shells have it


def install() -> None:
    """End quietly when interrupted, if this is the command; until ``done``."""
    command = Path(sys.argv[0]).stem if sys.argv else ""
    # where interrupts are ignored, as behind nohup, they stay so; only the main thread may set handlers
    default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if command == "redundancy-pin" and default and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, _end)


def done() -> None:
    """Hand interrupts back to Python: the command line is there to catch them."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(*_: object) -> None:
    os.write(2, b"error: interrupted.\n")
    os._exit(INTERRUPTED)  # nothing has been begun that would have to be ended
