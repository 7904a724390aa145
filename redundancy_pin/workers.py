"""The same function on many arguments, in several processes: joblib, as this package wants it."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import joblib

from redundancy_pin.errors import RedundancyPinError

R = TypeVar("R")

_IDLE = 20.0
"""Time, s, after which a process without work ends: how long it outlives a parent that was killed. A new one takes
about a second to start."""


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
            local = {"inner_max_num_threads": 1, "idle_worker_timeout": _IDLE}
            stack.enter_context(joblib.parallel_config(backend="loky", **local))
        # None given outright would overrule parallel_config
        settings = {} if jobs is None else {"n_jobs": min(joblib.effective_n_jobs(jobs), len(arguments))}
        calls = [joblib.delayed(_call)(function, *given) for given in arguments]
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
                "A worker process died; it may have run out of memory.",
                remedy="Run again with fewer jobs; what a store holds is taken over from there.",
            ) from error
        finally:
            results.close()


def _call(function: Callable[..., R], *given: Any) -> R:
    if multiprocessing.parent_process() is not None and threading.current_thread() is threading.main_thread():
        # Ctrl-C reaches the whole group of processes, and the parent ends its workers itself
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return function(*given)
