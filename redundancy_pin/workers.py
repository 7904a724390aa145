"""The same function on many arguments: in processes of this machine or on a cluster, by joblib and dask."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib
import math
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import joblib

from redundancy_pin.errors import InputError, RedundancyPinError, optional

R = TypeVar("R")

_PER_CORE = 8
"""Processes on each core of this machine at the most: more of them only take memory."""

PATIENCE = 60.0
"""How long a scheduler may be away, or without workers, s."""

ANSWER = 10.0
"""How long it may take to answer at first, s."""

_WATCH = 1.0
"""How often a worker process looks whether its parent is still there, and a caller how large the cluster is, s."""

_POLL = 0.01
"""How often results of a cluster are collected, s."""

_AHEAD = 4
"""Calls under way for each thread of a cluster: while one is computed, the next ones are there already."""


def parallel(
    function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], jobs: int | None = -1, *, ordered: bool = False
) -> Iterator[R]:
    """Give what a function returns for each of many arguments.

    Processes of this machine have one thread of linear algebra each: the matrices are small, and every core has its own
    work. Within ``joblib.parallel_config`` the work goes to the backend named there, and within ``cluster`` to a
    scheduler of dask.

    Args:
        function: of a module, so that other processes find it.
        arguments: positional ones, a tuple a call.
        jobs: number of processes, 1 for none but this one, -1 for all cores; None for what ``joblib.parallel_config``
            says. A cluster has as many as it has.
        ordered: whether results come in the order of the arguments, or as they get ready.

    Raises:
        RedundancyPinError: a process died, or a cluster is gone for longer than ``PATIENCE``.
    """
    for results in ready(function, arguments, jobs, ordered=ordered):
        yield from results


def ready(
    function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], jobs: int | None = -1, *, ordered: bool = False
) -> Iterator[list[R]]:
    """Give the same as ``parallel``, together what is ready together: a cluster may be faster than a disk."""
    backend, _ = joblib.parallel.get_active_backend()
    if not arguments:
        return
    if type(backend).__name__ == "DaskDistributedBackend":
        # joblib's own loop waits for whole batches there, and does not outlive a scheduler
        yield from _on_cluster(backend.client, function, arguments, ordered)
    else:
        yield from ([result] for result in _by_joblib(backend, function, arguments, jobs, ordered))


def _by_joblib(
    backend: Any, function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], jobs: int | None, ordered: bool
) -> Iterator[R]:
    with contextlib.ExitStack() as stack:
        if jobs is not None and type(backend).__name__ == "LokyBackend":
            require_jobs(jobs)
        if type(backend).__name__ == "LokyBackend" and backend.inner_max_num_threads is None:
            started = os.getpid(), threading.current_thread() is threading.main_thread()
            own = {"inner_max_num_threads": 1, "initializer": _begin, "initargs": started}
            stack.enter_context(joblib.parallel_config(backend="loky", **own))
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


def require_jobs(jobs: int) -> int:
    """Return a number of processes of this machine, after checking that it is -1, or positive and not too large.

    Raises:
        InputError: zero, below -1, or many times the cores there are.
    """
    cores = os.cpu_count() or 1
    most = max(64, _PER_CORE * cores)
    if jobs != -1 and not 1 <= jobs <= most:
        raise InputError(
            f"jobs is {jobs}; this machine has {cores} cores.",
            remedy=f"Pass 1 to {most}, or -1 for one process for each core.",
            jobs=jobs,
        )
    return jobs


# --- processes of this machine -------------------------------------------------------------------------------------


def _call(caller: int, function: Callable[..., R], *given: Any) -> R:
    if os.getppid() == caller:
        _settle(caller)
    return function(*given)


def _begin(parent: int, by_its_main_thread: bool) -> None:
    """Prepare a process of loky, before its first call."""
    # The watch below gets no turn while a solver computes in C and holds Python's lock; the kernel needs none. It takes
    # the end of the thread that started a process for that of the parent, and the main thread alone lasts as long.
    if sys.platform == "linux" and by_its_main_thread:
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    _settle(parent)


@functools.cache  # once a process
def _settle(parent: int) -> None:
    """Make this process one that leaves Ctrl-C to its parent, and that ends with it."""
    if threading.current_thread() is threading.main_thread():
        # Ctrl-C reaches the whole group of processes, and the parent ends its workers itself
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    # a parent that is killed cannot end its workers, and loky's workers would wait for work for minutes
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH)
    os._exit(1)


# --- a cluster -----------------------------------------------------------------------------------------------------

_ONE = threading.Lock()
"""One call at a time in a process: its threads would only take turns in the solvers, and share a robot's caches."""


@contextlib.contextmanager
def cluster(scheduler: str | None) -> Iterator[None]:
    """Let ``parallel`` compute on the workers of a dask scheduler; None leaves it as it is.

    Args:
        scheduler: its address, ``"tcp://host:8786"``. Its workers need this version of the package.

    Raises:
        InputError: no scheduler answers there.
        RedundancyPinError: dask is not installed.
    """
    if scheduler is None:
        yield
        return
    distributed = optional("distributed", "A cluster needs", "Install it with `pip install 'redundancy_pin[dask]'`.")
    try:
        distributed.Client(scheduler, timeout=ANSWER, set_as_default=False).close()
        client = distributed.Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"No scheduler answers at {scheduler}: {error}",
            remedy="Start one with `dask scheduler`.",
            address=scheduler,
        ) from error
    with client, joblib.parallel_config(backend="dask", client=client):
        yield


def _on_cluster(
    client: Any, function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], ordered: bool
) -> Iterator[list[R]]:
    """Give the results of all calls, each once, whatever becomes of workers and scheduler while they are computed.

    A call whose worker dies is given to another by the scheduler. What a scheduler forgets as it goes is given to it
    anew when it is back.
    """
    distributed: Any = importlib.import_module("distributed")
    waiting, running = deque(range(len(arguments))), dict[Any, int]()
    finished = distributed.as_completed(loop=client.loop, with_results=True, raise_errors=False)
    results: dict[int, R] = {}
    following, threads, counted = 0, 0, -math.inf
    while waiting or running:
        if time.monotonic() - counted > _WATCH:  # workers come and go
            threads, counted = _threads(client), time.monotonic()
        while waiting and len(running) < _AHEAD * threads:
            index = waiting.popleft()
            future = client.submit(_remote, own_version(), function, *arguments[index], pure=False)
            running[future] = index
            finished.add(future)
        # not waited for: a cluster that loses its last worker finishes nothing, and says so above
        if not (batch := finished.next_batch(block=False)):
            time.sleep(_POLL)
        completed: list[R] = []
        for future, result in batch:
            index = running.pop(future)
            if future.status == "error":
                error = result[1]
                if not isinstance(error, distributed.scheduler.KilledWorker):
                    raise error
                raise RedundancyPinError(
                    f"Workers of the cluster died again and again at the same call ({error}).",
                    remedy="See whether they run out of memory; what is finished is kept.",
                ) from error
            if future.status != "finished" or isinstance(result, distributed.CancelledError):
                waiting.appendleft(index)
                counted = -math.inf
            elif ordered:
                results[index] = result
            else:
                completed.append(result)
        while following in results:
            completed.append(results.pop(following))
            following += 1
        yield completed


def _threads(client: Any) -> int:
    """Return the threads of a cluster, once it has some; it may be away, or without workers, for ``PATIENCE``."""
    patience = time.monotonic() + PATIENCE
    while True:
        try:
            if client.status == "running" and (threads := sum(client.nthreads().values())):
                return int(threads)
            why = "has no workers" if client.status == "running" else "is gone"
        except (OSError, TimeoutError) as error:
            why = f"is gone ({type(error).__name__})"
        if client.status == "closed" or time.monotonic() > patience:
            raise RedundancyPinError(
                f"The scheduler {client.scheduler.address if client.scheduler else ''} {why}.",
                remedy="Start it, and workers, and run again: what is finished is kept.",
            )
        time.sleep(0.1 * _WATCH)


def _remote(version: str, function: Callable[..., R], *given: Any) -> R:
    if version != own_version():
        raise RedundancyPinError(
            f"A worker of the cluster has redundancy_pin {own_version()}, the caller {version}.",
            remedy="Install the same version everywhere.",
        )
    with _ONE:
        return function(*given)


def own_version() -> str:
    """Return the version of this package."""
    # the package itself stands above this room, so it is not imported
    return str(sys.modules["redundancy_pin"].__version__)
