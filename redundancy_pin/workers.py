"""The same function on many arguments, in several processes: joblib, as this package wants it."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import joblib

from redundancy_pin.errors import RedundancyPinError

R = TypeVar("R")

_WATCH = 1.0
"""How often a worker process looks whether its parent is still there, s."""


def parallel(
    function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], jobs: int | None = -1, *, ordered: bool = False
) -> Iterator[R]:
    """Give what a function returns for each of many arguments.

    Processes of this machine have one thread of linear algebra each: the matrices are small, and every core has its own
    work. Within ``joblib.parallel_config`` the work goes to the backend named there, such as a cluster.

    Args:
        function: of a module, so that other processes find it.
        arguments: positional ones, a tuple a call.
        jobs: number of processes, 1 for none but this one, -1 for all cores; None for what ``joblib.parallel_config``
            says.
        ordered: whether results come in the order of the arguments, or as they get ready.

    Raises:
        RedundancyPinError: a process died.
    """
    if not arguments:
        return
    with contextlib.ExitStack() as stack:
        backend, _ = joblib.parallel.get_active_backend()
        if type(backend).__name__ == "LokyBackend" and backend.inner_max_num_threads is None:
            stack.enter_context(joblib.parallel_config(backend="loky", inner_max_num_threads=1))
        # None given outright would overrule parallel_config
        settings = {} if jobs is None else {"n_jobs": min(joblib.effective_n_jobs(jobs), len(arguments))}
        calls = [joblib.delayed(_call)(os.getpid(), function, *given) for given in arguments]
        kind = "generator" if ordered else "generator_unordered"
        try:
            pool = joblib.Parallel(**settings, batch_size=1, return_as=kind)
        except ValueError:  # a backend that gives results only when all are there: a few at a time, then
            pool, some = joblib.Parallel(**settings, batch_size=1), 2 * joblib.effective_n_jobs(jobs or -1)
            for first in range(0, len(calls), some):
                yield from pool(calls[first : first + some])
            return
        results = pool(calls)
        try:
            yield from results
        except BrokenProcessPool as error:
            raise RedundancyPinError(
                "A worker process died; it may have run out of memory.", remedy="Run again with fewer jobs."
            ) from error
        finally:
            results.close()


def _call(caller: int, function: Callable[..., R], *given: Any) -> R:
    if os.getppid() == caller:
        _settle(caller)
    return function(*given)


@functools.cache  # once a process
def _settle(parent: int) -> None:
    if threading.current_thread() is threading.main_thread():
        # Ctrl-C reaches the whole group of processes, and the parent ends its workers itself
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    # a parent that is killed can tell nobody to end, and loky's workers would wait for work for minutes
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH)
    os._exit(1)
