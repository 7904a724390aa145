"""One function at many points, in several processes: ``sweep`` for users, ``parallel`` for the package; by joblib."""

from __future__ import annotations

import inspect
import itertools
import operator
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import joblib
import numpy as np
from joblib.externals.loky.process_executor import TerminatedWorkerError
from numpy.typing import NDArray

from redundancy_pin.arrays import require_type
from redundancy_pin.errors import InputError, RedundancyPinError, optional, shown

R = TypeVar("R")

Progress = Callable[[int, int], None]
"""Called with points done and points in all."""

_MOST_JOBS_PER_CORE = 8
"""Processes per core of this machine at most: more of them only take memory."""


@dataclass(frozen=True, eq=False)
class SweepResult:
    """What a function returned at each point of a grid.

    Attributes:
        records: one per point, in the order of the grid: its arguments, and the values that the function returned.
        axes: values of each argument, if the grid is a product of axes; otherwise None.
    """

    records: tuple[Mapping[str, Any], ...]
    axes: Mapping[str, tuple[Any, ...]] | None = None

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.records)

    def values(self, name: str) -> NDArray[Any]:
        """Return an entry of every record: one dimension per axis of the grid, in its order; (N,) without axes.

        Entries that are arrays add their own dimensions at the end.

        Raises:
            InputError: a record has no such entry (the remedy lists the entries), or entries have different shapes.
        """
        missing = [record for record in self.records if name not in record]
        if missing:
            raise InputError(
                f"A record has no entry {name!r}.", remedy=f"Its entries are {', '.join(missing[0])}.", name=name
            )
        shape = [len(self.records)] if self.axes is None else [len(values) for values in self.axes.values()]
        try:
            found = np.array([record[name] for record in self.records])
        except ValueError as error:
            message = f"The entries {name!r} have different shapes."
            raise InputError(message, remedy="Read them from `records`.", name=name) from error
        return found.reshape(*shape, *found.shape[1:])

    def to_dataframe(self) -> Any:
        """Return the records as a pandas DataFrame, one row per point; needs the extra ``pandas``."""
        pandas = optional("pandas", "to_dataframe needs", "Install it with `pip install pandas`.")
        return pandas.DataFrame(list(self.records))


def sweep(
    function: Callable[..., Any],
    grid: Mapping[str, Iterable[Any]] | Iterable[Mapping[str, Any]],
    *,
    jobs: int | None = -1,
    cache: str | Path | None = None,
    progress: Progress | None = None,
) -> SweepResult:
    """Call a function at every point of a grid, in several processes.

    The function is called with keyword arguments and returns a mapping of values, or one value (entry ``value``). It
    loads its robots itself, from their names or paths. An error that it raises ends the sweep; a function that should
    continue where no plan exists catches ``InfeasiblePlanError`` and returns the status. With a cache, points that are
    finished are kept (``joblib.Memory``): the same call after an interruption computes only the others. A changed
    function, or another version of the package, computes all points again. Other things that it uses are not compared:
    after a change of a model file, of a global or of another function that it calls, delete the folder.

    Within ``joblib.parallel_config("dask")`` the points are computed by the workers of a dask cluster, which need the
    same version of the package; with a cache, the folder must be one that all of them share.

    Args:
        function: of the points' entries; of a module or notebook.
        grid: values by argument, of which all combinations are taken (the last argument varies fastest); or the points
            themselves, each a mapping.
        jobs: processes; -1 for one per core, 1 for this process alone, None for the setting of
            ``joblib.parallel_config``.
        cache: folder that keeps finished points; made if it is missing. None keeps nothing.
        progress: called as points finish.

    Raises:
        InputError: ``jobs`` is not a whole number, 0, below -1, or many times the cores; an argument has no values, or
            is not a list of them; points are not mappings; the function returns an entry with the name of an argument;
            with a cache, a folder that cannot be made, a closure or ``functools.partial``, whose values the cache would
            not see.
        RedundancyPinError: a process died.

    Example:
        >>> import redundancy_pin as rp
        >>> def peak(speed, radius):
        ...     motion = rp.trajectory.reference.corner(speed=speed, radius=radius)
        ...     try:
        ...         plan = rp.plan_whole_trajectory("3rrr", motion, mesh=rp.Mesh(dt=0.02))
        ...     except rp.errors.InfeasiblePlanError:
        ...         return {"status": "infeasible", "peak": float("nan")}
        ...     return {"status": plan.status.value, "peak": plan.peak_effort.max()}
        >>> result = rp.sweep(peak, {"speed": [0.1, 0.2], "radius": [0.02, 0.03]}, jobs=1)
        >>> result.values("peak").shape
        (2, 2)
    """
    axes: dict[str, tuple[Any, ...]] | None = None
    if not isinstance(grid, Mapping):
        points = list(_listed(grid, "grid"))
        for point in points:
            require_type(point, Mapping, "A mapping for each point", 'Pass [{"speed": 0.1}, {"speed": 0.2}].')
    else:
        axes = {name: _listed(values, name) for name, values in grid.items()}
        for name, values in axes.items():
            if not values:
                raise InputError(f"The argument {name!r} has no values.", remedy="Give at least one.", name=name)
        points = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    kept = function if cache is None else _memory(cache).cache(_require_named(function))
    records: list[Mapping[str, Any]] = [{}] * len(points)
    for done, (index, value) in enumerate(parallel(_call, [(kept, *pair) for pair in enumerate(points)], jobs), 1):
        entries = value if isinstance(value, Mapping) else {"value": value}
        if both := points[index].keys() & entries.keys():  # at the first result, not after a night of them
            name = min(both)
            message = f"{name!r} is an argument, and an entry that the function returns."
            raise InputError(message, remedy="Give the entry another name.", name=name)
        records[index] = {**points[index], **entries}
        if progress:
            progress(done, len(points))
    return SweepResult(tuple(records), axes)


def _listed(values: Any, name: str) -> tuple[Any, ...]:
    """Return the values of an argument; a text is one value, no list of its letters."""
    if isinstance(values, (str, bytes)) or not isinstance(values, Iterable):
        raise InputError(
            f"{name} is {shown(values)}, not a list of values.", remedy="Write [...] around it.", name=name
        )
    return tuple(values)


def _require_named(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function whose results can be kept: the cache compares nothing but its arguments.

    Raises:
        InputError: it is not a function of a module or notebook, or it has values of the function around it.
    """
    if not inspect.isfunction(function) or function.__closure__:
        raise InputError(
            f"The cache cannot tell {shown(function)} from others: it has values beside its arguments.",
            remedy="Pass a function of a module or notebook, and what else it needs as an entry of the grid.",
        )
    return function


def _memory(folder: str | Path) -> Any:
    # the package itself is above this module, so it is not imported
    place = Path(folder).expanduser() / f"redundancy_pin-{sys.modules['redundancy_pin'].__version__}"
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        message = f"The cache {folder} cannot be made: {error.strerror}."
        raise InputError(message, remedy="Name a folder that you may write to.", name="cache") from error
    return joblib.Memory(place, verbose=0)


def _call(function: Callable[..., Any], index: int, point: Mapping[str, Any]) -> tuple[int, Any]:
    return index, function(**point)


def parallel(
    function: Callable[..., R], arguments: Sequence[tuple[Any, ...]], jobs: int | None = -1, *, ordered: bool = False
) -> Iterator[R]:
    """Give the results of a function for many arguments, as they get ready or in order.

    Processes of this machine have one thread of linear algebra each: the matrices are small.

    Args:
        function: of a module, so that other processes find it.
        arguments: positional ones, a tuple per call.
        jobs: as of ``sweep``.
        ordered: whether results come in the order of the arguments.

    Raises:
        InputError: ``jobs`` is 0, below -1, or many times the cores.
        RedundancyPinError: a process died.
    """
    settings: dict[str, Any] = {}
    if jobs is not None:  # None given outright would overrule parallel_config
        settings["n_jobs"] = max(1, min(joblib.effective_n_jobs(require_jobs(jobs)), len(arguments)))
    backend, _ = joblib.parallel.get_active_backend()
    if type(backend).__name__ == "LokyBackend":
        # the caller answers Ctrl-C, and ends its processes itself
        quiet = {"initializer": signal.signal, "initargs": (signal.SIGINT, signal.SIG_IGN)}
        with joblib.parallel_config(backend="loky", inner_max_num_threads=backend.inner_max_num_threads or 1, **quiet):
            pool = joblib.Parallel(**settings, batch_size=1, return_as=_kind(ordered))
    else:
        pool = joblib.Parallel(**settings, batch_size=1, return_as=_kind(ordered))
    results = None
    try:
        results = pool(joblib.delayed(function)(*given) for given in arguments)
        yield from results
    except TerminatedWorkerError as error:
        raise RedundancyPinError(
            "A worker process died; it may have run out of memory.", remedy="Run again with fewer jobs."
        ) from error
    except BrokenProcessPool as error:  # it cannot read the function, its arguments, or an import of them
        raise RedundancyPinError(
            f"A worker process failed: {error}", remedy="Define the function in a module, or use jobs=1."
        ) from error
    finally:
        if results is not None:
            results.close()


def _kind(ordered: bool) -> str:
    return "generator" if ordered else "generator_unordered"


def require_jobs(jobs: int) -> int:
    """Return a number of processes; InputError if it is 0, below -1, or many times the cores of this machine."""
    cores = os.cpu_count() or 1
    most = max(64, _MOST_JOBS_PER_CORE * cores)
    try:
        count = operator.index(jobs)  # numpy's whole numbers too
    except TypeError:
        count = 0
    if count != -1 and not 1 <= count <= most:
        raise InputError(
            f"jobs is {shown(jobs)}; this machine has {cores} cores.",
            remedy=f"Pass 1 to {most}, or -1 for one process per core.",
            name="jobs",
        )
    return count
