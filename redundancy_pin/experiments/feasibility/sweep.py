"""Computing a feasibility map on all cores, or on whatever joblib is told to use; what is finished is never lost."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from redundancy_pin.arrays import frozen
from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.experiments.feasibility.cell import Cell, Key
from redundancy_pin.experiments.feasibility.journal import CELLS
from redundancy_pin.experiments.feasibility.machine import machine
from redundancy_pin.experiments.feasibility.planning import compute, require_parameters
from redundancy_pin.experiments.feasibility.problem import MapProblem, require_axes
from redundancy_pin.experiments.feasibility.result import (
    Direction,
    FeasibilityMap,
    axis_of,
    crossings,
    grid_keys,
    lines_of,
)
from redundancy_pin.experiments.journal import digest, open_journal
from redundancy_pin.kinematics.coordinates import require_matching
from redundancy_pin.robot import Robot

Progress = Callable[[int, int, str], None]
"""Called with cells done, cells in all as far as known, and what is being done."""

_IDLE = 20.0
"""Time, s, after which a worker process without a cell ends: how long it outlives a parent that was killed. A new one
takes about a second to start."""

_DIGITS = 9
"""Significant digits of a machine's numbers that must agree for its cells to be taken over."""


def feasibility_map(
    problem: MapProblem,
    journal: str | Path | None = None,
    *,
    jobs: int | None = -1,
    refine: int = 0,
    along: Direction = "x",
    progress: Progress | None = None,
) -> FeasibilityMap:
    """Compute a map, taking over the cells that a journal already has.

    Cells are independent, and are computed by ``joblib.Parallel``: by default in processes on this machine, each with
    one thread. Within ``joblib.parallel_config`` they go to the backend named there, such as a cluster.

    Args:
        problem: what the map is of.
        journal: file for the finished cells, made if it is missing; None keeps them in memory alone.
        jobs: number of processes, -1 for all cores; None for what ``joblib.parallel_config`` says.
        refine: how often the border is bisected between neighbouring cells of the grid.
        along: the axis along which it is bisected.
        progress: called whenever a cell is finished.

    Raises:
        InputError: an axis that is no parameter of the robot, the trajectory or the limits; a parameter that a planner
            does not take; or a robot or trajectory that cannot be made at any corner of the map.
        OutputError: the journal is of another problem, damaged, or cannot be written.
        RedundancyPinError: joblib is not installed, the robot does not load, or a worker process dies.
    """
    robot = require_sense(problem, jobs=jobs, refine=refine, along=along)
    known: dict[Key, Cell] = {}
    with contextlib.ExitStack() as stack:
        put = None
        if journal is not None:
            # the fingerprint says least to a user, and changes along with others: last
            identity = {**problem.identity(), "machine": fingerprint(robot)}
            book = stack.enter_context(open_journal(CELLS, journal, identity))
            known.update(book.records)
            put = book.add
        wanted = grid_keys(problem)
        for level in range(int(refine) + 1):
            if level:
                wanted += list(_between(problem, wanted, known, along))
            missing = [key for key in wanted if key not in known]
            what = f"border {level} of {refine}" if level else "grid"
            done = len(wanted) - len(missing)
            _tell(progress, done, len(wanted), what)
            for cell in _computed(problem, missing, jobs):
                if put is not None:
                    put(cell)
                known[cell.key] = cell
                done += 1
                _tell(progress, done, len(wanted), what)
    order = {planner: number for number, planner in enumerate(problem.planners)}
    cells = sorted((known[key] for key in wanted), key=lambda cell: (order[cell.planner], cell.x, cell.y))
    return FeasibilityMap(problem, tuple(cells), along)


def require_sense(problem: MapProblem, *, jobs: int | None, refine: int, along: Direction) -> Robot:
    """Check everything that can be checked before the first cell, and return the robot.

    Args:
        problem: what the map is of.
        jobs: see ``feasibility_map``.
        refine: the same.
        along: the same.

    Raises:
        RedundancyPinError: as ``feasibility_map``.
    """
    joblib()
    if along not in ("x", "y"):
        raise InputError(f"along is {along!r}.", remedy='Pass "x" or "y".')
    if int(refine) != refine or refine < 0:
        raise InputError(f"refine is {refine}.", remedy="Pass a whole number from zero up.")
    if jobs == 0:
        raise InputError("jobs is 0.", remedy="Pass the number of processes, or -1 for all cores.")
    robot = problem.loaded
    require_axes(problem, robot.parameters)
    require_parameters(problem)
    _require_some_corner(problem)
    return robot


def fingerprint(robot: Robot) -> str:
    """Return a hash of what a machine is, so that cells of a file that has changed since are not taken over."""
    numbers = [
        *(value for body in list(robot.model.inertias)[1:] for value in body.toDynamicParameters()),
        *robot.q_reference,
        *(value for limit in robot.carrier_limits for value in vars(limit).values()),
    ]
    # what is zero but for rounding may round either way
    return digest({"numbers": [f"{0.0 if abs(value) < 1e-12 else value:.{_DIGITS}g}" for value in frozen(numbers)]})


def joblib() -> Any:
    """Return the module joblib.

    Raises:
        RedundancyPinError: it is not installed.
    """
    try:
        import joblib as module
    except ImportError as error:
        raise RedundancyPinError(
            "Feasibility maps need joblib, which is not installed.",
            remedy="Install it with `pip install 'redundancy_pin[parallel]'`.",
        ) from error
    return module


def _require_some_corner(problem: MapProblem) -> None:
    """Refuse what cannot be made at any corner of the map; a corner alone may be out of the domain."""
    errors: list[RedundancyPinError] = []
    for x in (problem.x.values[0], problem.x.values[-1]):
        for y in (problem.y.values[0], problem.y.values[-1]):
            try:
                made = machine(problem, x, y)
            except RedundancyPinError as error:
                errors.append(error)
            else:
                # one for all corners: a motion with other coordinates than the robot's fits none of them
                require_matching(made.dynamics.robot, made.trajectory.sample_at([0.0]))
                return
    raise errors[0]


def _between(problem: MapProblem, wanted: Sequence[Key], known: Mapping[Key, Cell], along: Direction) -> Iterator[Key]:
    """Give the cells half way between neighbours of which one is possible and the other is not."""
    axis = axis_of(problem, along)
    for planner in problem.planners:
        cells = tuple(known[key] for key in wanted if key[0] == planner)
        for crossing in crossings(lines_of(cells, along), along):
            middle = axis.middle(crossing.low, crossing.high)
            if crossing.low < middle < crossing.high:
                yield (planner, crossing.line, middle) if along == "y" else (planner, middle, crossing.line)


def _computed(problem: MapProblem, keys: Sequence[Key], jobs: int | None) -> Iterator[Cell]:
    """Give the cells as they are finished, in whatever order that is."""
    if not keys:
        return
    module = joblib()
    with contextlib.ExitStack() as stack:
        backend, _ = module.parallel.get_active_backend()
        if type(backend).__name__ == "LokyBackend" and backend.inner_max_num_threads is None:
            # one thread each: the matrices are small, and every core has its own cells
            local = {"inner_max_num_threads": 1, "idle_worker_timeout": _IDLE}
            stack.enter_context(module.parallel_config(backend="loky", **local))
        settings = {} if jobs is None else {"n_jobs": jobs}
        calls = [module.delayed(_in_worker)(problem, *key) for key in keys]
        try:
            parallel = module.Parallel(**settings, batch_size=1, return_as="generator_unordered")
        except ValueError:  # a backend that gives results only when all are there: a few at a time, then
            parallel, some = module.Parallel(**settings, batch_size=1), max(1, 2 * module.effective_n_jobs(jobs or -1))
            for first in range(0, len(calls), some):
                yield from parallel(calls[first : first + some])
            return
        found = parallel(calls)
        try:
            yield from found
        except BrokenProcessPool as error:
            raise RedundancyPinError(
                "A worker process died while it computed a cell; it may have run out of memory.",
                remedy="Run again with fewer jobs: finished cells are taken over from the journal.",
            ) from error
        finally:
            found.close()


def _in_worker(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
    ignore_interrupts()
    return compute(problem, planner, x, y)


def ignore_interrupts() -> None:
    """Let a worker process leave Ctrl-C to its parent; nothing in a process that is none."""
    if multiprocessing.parent_process() is not None and threading.current_thread() is threading.main_thread():
        # Ctrl-C reaches the whole group of processes; the parent stops its workers itself
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _tell(progress: Progress | None, done: int, total: int, what: str) -> None:
    if progress is not None:
        progress(done, total, what)
