"""Processes that share the cores: one thread of linear algebra each."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait

from redundancy_pin.errors import RedundancyPinError

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def workers(jobs: int, remedy: str = "Run again with fewer jobs.") -> Iterator[ProcessPoolExecutor]:
    """Start processes for many small matrices; work that has not begun is dropped at the end.

    They are spawned, not forked: the parent may have threads. They end with the parent, even where that is killed.
    Libraries read how many threads to start when they are loaded, before anything of ours runs in the new process, so
    the environment is set here while processes may start.

    Args:
        jobs: number of processes.
        remedy: what to do when a process has died.

    Yields:
        The pool.

    Raises:
        RedundancyPinError: a process died.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_end_in_time)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise RedundancyPinError(
            "A worker process died; it may have run out of memory.",
            remedy=remedy,
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _end_in_time() -> None:
    """Have this process end with Ctrl-C, at once and without a traceback, and with its parent.

    What to say of an interrupt is the parent's. A parent that was killed can tell nobody to end: its processes would
    wait for work for ever.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(parent: int) -> None:
    """Wait until a process ends, and end this one."""
    wait([parent])
    os._exit(1)
