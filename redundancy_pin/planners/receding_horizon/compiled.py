"""A tick as machine code: ``tick.c`` for a robot's sizes, what it is given and what it gives back.

It is compiled once for each set of sizes and kept on disk (``machine_code``). Without a C compiler there is none, and
every tick is planned in Python. So are those that it leaves: the first, and those without a plan that keeps every
limit.
"""

from __future__ import annotations

import ctypes
import importlib.resources
import time
from collections.abc import Mapping
from dataclasses import astuple
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, frozen, read_only
from redundancy_pin.machine_code import (
    FLAGS,
    NATIVE,
    built,
    cache_folder,
    digest,
    find_compiler,
    loaded,
    processor,
)
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.receding_horizon.ahead import Ahead, Coefficients
from redundancy_pin.planners.receding_horizon.command import Command, TickPlan, Weights
from redundancy_pin.planners.receding_horizon.preview import SAME
from redundancy_pin.planners.receding_horizon.programme import TickScales, units_of
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

SOURCES = "tick_sight.c", "tick_programme.c", "tick_solver.c", "tick.c"
OK, MISSING = 0, 5
"""What the function of ``tick.c`` returns: a plan that keeps every limit; instants that are not evaluated yet."""

SETTINGS = {
    "PRECISION": 1e-9,  # of what bounds, and rows of singular instants, are missed by, in units
    "BARRIER": 1e-9,  # mean of slacks times duals, of a cost of size one
    "STATIONARY": 1e-5,  # gradient over the largest in it: multipliers of singular instants are large, and rounded
    "ITERATIONS": 40,
    "CLOSE": 0.995,  # of the way to the nearest bound
    "ROOM": 0.05,  # least slack of a first point, in units
    "FIRST_BARRIER": 1e-2,  # slack times dual there
    "WARM_ROOM": 5e-3,  # the same where there is a solution of nearly the same programme
    "WARM_BARRIER": 3e-5,  # at least
    "WITHIN": 0.9,  # share of the limits of acceleration that a first point has at most
    "DAMPING": 1e-2,  # of a first point: weight of the efforts, that of accelerations being 1
    "SAME_ROW": 1e-8,  # share of the jerk in a row of a singular instant below which it has none
}
"""Of the interior point method; found by trial on random paths: half the iterations that PIQP has there."""

NONE = frozen([])
"""No singular instants."""

INSTANTS, BORDER = 160, 10
"""Most instants at which the efforts of a plan are evaluated, and rows of singular instants, as in ``tick.c``."""

_COUNTS = ("instants", "edges", "nodes", "roots", "breaks", "sharps", "same_time")
_SIGHT = ("t", "W", "constant", "terms", "known")
_PLAN = ("edge", "piece", "node", "at", "multiplier", "solution")
_POINTERS = (*_PLAN, "root", "broken", "sharp", "row_scale", "row", "track", "speed")
_LIMITS = ("acceleration", "jerk", "carrier_force", "effort")
_NUMBERS = ("now", "until", "step", "horizon", "spacing", "tau", "largest", "peak")


class _Given(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_long) for name in _COUNTS),
        *((name, ctypes.c_void_p) for name in (*_SIGHT, *_POINTERS, *_LIMITS, "unit", "weight", "s", "sd")),
        *((name, ctypes.c_double) for name in _NUMBERS),
    ]


class CompiledTick:
    """The planner's ticks in fixed memory; one for each planner.

    Args:
        library: as of ``tick_library``.
        sizes, constants: which that was made of.
        step, horizon: s.
        weights: of the objective.
        limits: in force; ``set_limits`` changes them.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        sizes: Mapping[str, int],
        constants: Mapping[str, float],
        step: float,
        horizon: float,
        weights: Weights,
        limits: ResolvedLimits,
    ) -> None:
        self._made_of = dict(sizes), dict(constants), step, horizon, weights
        n, m, k, count = (sizes[name] for name in ("N", "M", "K", "COUNT"))
        library.rp_tick_work.restype = library.rp_tick_solution.restype = ctypes.c_long
        self._call, self._shape = library.rp_tick, (n, m, k, count)
        self._solution = library.rp_tick_solution() // 8
        parts = {
            "pieces": 1, "efforts": 1, "forces": 1, "missing": 1, "known": 1, "iterations": 1,
            "residual": 1, "peak": 1, "left": 1, "largest": 1, "solution": self._solution,
            "node": count, "at": 3 * count * k, "multiplier": count * n,
            "edge": count + k + 1, "piece": 4 * (count + k) * k,
            "effort_edge": INSTANTS + count, "effort": 2 * (INSTANTS + count) * m,
            "force_edge": INSTANTS, "force": 2 * INSTANTS * k,
            "missing_time": count + 2 * BORDER + INSTANTS,
        }  # fmt: skip
        ends = np.cumsum([0, *parts.values()]).tolist()
        self._places = {name: slice(a, b) for name, a, b in zip(parts, ends[:-1], ends[1:], strict=True)}
        self._result = np.zeros(ends[-1])
        self._counts, self._numbers = self._result[:6].view(np.int64), self._result[6:10]
        self._work = np.zeros(library.rp_tick_work() // 8 + 1)
        self._given = _Given(step=step, horizon=horizon)
        self._kept: dict[str, tuple[Array, Array]] = {}
        self._known: Coefficients | None = None
        self._sight: tuple[object, float] = None, np.nan
        self._own: tuple[Array | None, Array | None] = None, None
        self._begins: Array | None = None
        self._nowhere = np.full(k, np.nan)
        self._arguments = ctypes.byref(self._given), *map(_address, (self._result, self._work))
        self._point("weight", np.array(astuple(weights)))
        self.set_limits(limits)

    def __reduce__(self) -> tuple[Any, ...]:
        """Make it again, in memory of its own, where it is copied or sent to; None where that has no compiler."""
        return _again, (*self._made_of, self._limits)

    def _point(self, name: str, array: Array) -> None:
        """Have an argument point to an array, which is kept as long."""
        if name not in self._kept or self._kept[name][0] is not array:
            laid_out = np.ascontiguousarray(array, dtype=np.float64)
            self._kept[name] = array, laid_out
            setattr(self._given, name, laid_out.ctypes.data)

    def _point_to_sight(self, known: Coefficients) -> None:
        """Have the arguments point to what is in sight, of which more may be known in the same memory."""
        self._given.instants, self._known = len(known.t), known
        begins = known.t.base, known.t[0]  # there is no other beginning at that time in the same memory
        if begins[0] is not self._sight[0] or begins[1] != self._sight[1]:
            self._sight = begins
            for name in _SIGHT:
                setattr(self._given, name, getattr(known, name).ctypes.data)

    def _point_to_last(self, last: TickPlan) -> None:
        """Have the arguments point to the last plan; this one's own it is in its memory already."""
        own, carriers = self._given, last.command.carriers
        own.edges, own.nodes = len(carriers.edges), len(last.nodes)
        if last.nodes is not self._own[0]:
            self._own = None, self._own[1]
            self._point("node", last.nodes)
            self._point("multiplier", last.multipliers)
        if carriers.edges is not self._own[1]:
            self._own = self._own[0], None
            self._point("edge", carriers.edges)
            self._point("piece", carriers.coefficients)
        solution = last.solution
        if solution is None or solution is not self._begins:
            self._begins = solution
            if solution is not None and len(solution) == self._solution:
                self._point("solution", solution)
            else:  # by Python, or of another version
                self._kept.pop("solution", None)
                own.solution = None
        if own.same_time:  # else it is not looked at
            self._point("at", np.array(last.at))

    def set_limits(self, limits: ResolvedLimits) -> None:
        """Use limits from now on."""
        self._limits = limits
        for name in ("track", "speed", *_LIMITS):
            self._point(name, getattr(limits, name))
        self._point("unit", np.array(units_of(limits)))

    def plan(
        self,
        ahead: Ahead,
        t: float,
        until: float,
        given: tuple[Array | None, ...],
        last: TickPlan,
        sizes: TickScales,
        largest: float,
    ) -> TickPlan | None:
        """Return a plan about the last one; None where there is none that keeps every limit.

        Args:
            ahead: what is in sight.
            t: the tick, s.
            until: until when the motion is known, s.
            given: (k,) s and ṡ of the carriers; None where those of the last plan are to be believed.
            last: the last plan, of cubic motions.
            sizes: what is divided by.
            largest: |τ| so far, N or N·m.
        """
        own, command = self._given, last.command
        own.now, own.until, own.spacing, own.largest = t, until, ahead.spacing, largest
        own.tau, own.peak = sizes.tau, command.peak
        own.same_time, own.roots, own.breaks = bool(command.t == t), len(ahead.roots), len(ahead.preview.breaks)
        self._point_to_last(last)
        self._point("root", ahead.roots)
        self._point("broken", ahead.preview.breaks)
        self._point("sharp", ahead.sharp)
        own.sharps = len(ahead.sharp)
        self._point("row", sizes.row)
        self._point("row_scale", ahead.row_scale)
        for name, array in zip(("s", "sd"), given, strict=True):
            self._point(name, self._nowhere if array is None else array)
        seconds, status = 0.0, MISSING
        for _ in range(3):  # once is enough
            self._point_to_sight(ahead.known)
            began = time.perf_counter()
            status = self._call(*self._arguments)
            seconds += time.perf_counter() - began
            if status != MISSING:
                break
            places = self._places["missing_time"]
            ahead.at(self._result[places][: self._counts[3]])
        return self._made(t, ahead.roots, seconds) if status == OK else None

    def _made(self, t: float, roots: Array, seconds: float) -> TickPlan:
        result = self._result.copy()
        base, own = ctypes.addressof(ctypes.c_double.from_buffer(result.data)), self._given  # sooner than by numpy
        read_only(result)
        (n, m, k, count), places = self._shape, self._places
        pieces, efforts, forces, _, known, iterations = self._counts.tolist()
        residual, peak, left, largest = self._numbers.tolist()

        def function(edges: str, coefficients: str, order: int, pieces: int, width: int) -> PiecewisePolynomial:
            first, start = places[edges].start, places[coefficients].start
            used = result[start : start + order * pieces * width].reshape(order, pieces, width)
            return PiecewisePolynomial(result[first : first + pieces + 1], used)

        at, nodes = result[places["at"]].reshape(3, count, k), result[places["node"]]
        carriers = function("edge", "piece", 4, pieces, k)
        coming = frozen(roots[roots > t - SAME]) if len(roots) else NONE
        command = Command(
            t, UpdateStatus.OK, "", carriers,
            function("effort_edge", "effort", 2, efforts, m), function("force_edge", "force", 2, forces, k),
            residual, peak, coming, float(nodes[max(known - 1, 0)]), 0.0, seconds,
        )  # fmt: skip
        for name in ("node", "multiplier", "solution", "edge", "piece"):
            setattr(own, name, base + 8 * places[name].start)
            self._kept.pop(name, None)
        multipliers, solution = result[places["multiplier"]].reshape(count, n), result[places["solution"]]
        self._own, self._begins = (nodes, carriers.edges), solution
        return TickPlan(command, nodes, (at[0], at[1], at[2]), multipliers, left, largest, solution, iterations)


def tick_library(sizes: Mapping[str, int], constants: Mapping[str, float]) -> tuple[ctypes.CDLL | None, str]:
    """Return the library of robots of some sizes, from disk or new; or None and the reason why there is none.

    Args:
        sizes: N, M, K, TERMS, COUNT.
        constants: of the planner, by the names that ``tick.c`` has.
    """
    named = {**sizes, **constants, **SETTINGS}
    head = [f"#define {name} {value!r}" for name, value in named.items()]
    folder = importlib.resources.files(__package__)
    text = "\n".join(["#define EXPORTED", *head, *(folder.joinpath(name).read_text("utf-8") for name in SOURCES)])
    compiler = find_compiler()
    where = "" if compiler is None else compiler.identity, str(cache_folder())
    # a sixth less time with it; not every compiler has it
    library, reason = _built(text, (*FLAGS, NATIVE), processor(), *where)
    return (library, reason) if library is not None else _built(text, FLAGS, "", *where)


@lru_cache(maxsize=16)  # where nothing is kept on disk too, it is compiled once, and what cannot be is tried once
def _built(
    text: str, flags: tuple[str, ...], machine: str, compiler: str, folder: str
) -> tuple[ctypes.CDLL | None, str]:
    def load(path: Path) -> ctypes.CDLL:
        library = loaded(path)
        # AttributeError where the file is another one
        _ = library.rp_tick, library.rp_tick_work, library.rp_tick_solution
        return library

    return built(lambda identity: digest([text, identity, *flags, machine]), lambda: text, load, flags)


def _again(sizes: Mapping[str, int], constants: Mapping[str, float], *settings: Any) -> CompiledTick | None:
    library, _ = tick_library(sizes, constants)
    return None if library is None else CompiledTick(library, sizes, constants, *settings)


def _address(array: Array) -> Any:
    return ctypes.c_void_p(array.ctypes.data)
