"""A tick as machine code: ``tick.c`` for a robot's sizes, what it is given and what it gives back.

It is compiled once for each set of sizes and kept on disk (``machine_code``).
"""

from __future__ import annotations

import ctypes
import importlib.resources
import time
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, frozen, read_only
from redundancy_pin.errors import CompilerError
from redundancy_pin.machine_code import (
    FLAGS,
    NATIVE,
    REMEDY,
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
from redundancy_pin.planners.receding_horizon.constants import CONSTANTS, INSTANTS, MOST_SINGULAR, SAME
from redundancy_pin.planners.receding_horizon.preview import place_of
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

SOURCES = "tick_sight.c", "tick_programme.c", "tick_solver.c", "tick.c"
OK, UNSOLVED, RELAXED, REFUSED, MISSING = range(5)
"""What ``rp_tick`` returns: a plan that keeps every limit; none; the one that misses W τ = f least; one up
to where the machine cannot go; instants that are not evaluated yet."""

NONE = frozen([])
"""No singular instants."""

_COUNTS = ("instants", "edges", "nodes", "roots", "breaks", "sharps", "same_time", "first", "strict", "guesses")
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


@dataclass(frozen=True, eq=False)
class TickScales:
    """What unknowns and rows are divided by: ``tau``, N or N·m; ``row`` (n,), N or N·m."""

    tau: float
    row: Array


def units_of(limits: ResolvedLimits) -> tuple[Array, Array, Array]:
    """Return what s, ṡ and s̈ are divided by, (k,) each."""
    width = np.diff(limits.track, axis=1)[:, 0]
    return (
        np.where(np.isfinite(width), 0.5 * width, 1.0),
        np.where(np.isfinite(limits.speed), limits.speed, 1.0),
        np.where(np.isfinite(limits.acceleration), limits.acceleration, 10.0),
    )


class CompiledTick:
    """The planner's ticks in fixed memory; one for each planner.

    Args:
        library: as of ``tick_library``.
        sizes: which that was made of.
        step, horizon: s.
        weights: of the objective.
        limits: in force; ``set_limits`` changes them.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        sizes: Mapping[str, int],
        step: float,
        horizon: float,
        weights: Weights,
        limits: ResolvedLimits,
        guesses: int = 0,
    ) -> None:
        self._made_of = dict(sizes), step, horizon, weights
        self._guesses = guesses
        n, m, k, count = (sizes[name] for name in ("N", "M", "K", "COUNT"))
        library.rp_tick_work.restype = library.rp_tick_solution.restype = ctypes.c_long
        self._call, self._shape = library.rp_tick, (n, m, k, count)
        self._solution = library.rp_tick_solution() // 8
        parts = {
            "counts": 9, "numbers": 5, "row": n, "solution": self._solution,
            "node": count, "at": 3 * count * k, "multiplier": count * n,
            "edge": count + k + 1, "piece": 4 * (count + k) * k,
            "effort_edge": INSTANTS + count, "effort": 2 * (INSTANTS + count) * m,
            "force_edge": INSTANTS, "force": 2 * INSTANTS * k,
            "missing_time": count + 2 * MOST_SINGULAR + INSTANTS,
        }  # fmt: skip
        ends = np.cumsum([0, *parts.values()]).tolist()
        self._places = {name: slice(a, b) for name, a, b in zip(parts, ends[:-1], ends[1:], strict=True)}
        self._result = np.zeros(ends[-1])
        self._counts, self._numbers = self._result[self._places["counts"]].view(np.int64), self._result[9:14]
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
        """Make it again, in memory of its own, where it is copied or sent to."""
        return _again, (*self._made_of, self._limits, self._guesses)

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
            else:  # of another version
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
        last: TickPlan | None,
        sizes: TickScales | None,
        largest: float,
        *,
        strict: bool,
    ) -> tuple[TickPlan | None, TickScales | None]:
        """Return a plan about the last one, if there is any, and what is divided by; None as long as there is no plan.

        Args:
            ahead: what is in sight.
            t: the tick, s.
            until: until when the motion is known, s.
            given: (k,) s and ṡ of the carriers; None where those of the last plan are to be believed.
            last: the last plan, of cubic motions; None of a first one.
            sizes: what is divided by; None of a first one.
            largest: |τ| so far, N or N·m.
            strict: whether a plan that does not keep every limit is none.
        """
        own, first = self._given, last is None or sizes is None
        own.now, own.until, own.spacing, own.largest = t, until, ahead.spacing, largest
        own.roots, own.breaks, own.sharps = len(ahead.roots), len(ahead.preview.breaks), len(ahead.sharp)
        own.first, own.strict, own.guesses, own.same_time = first, strict, self._guesses, False
        if last is not None and sizes is not None:
            own.tau, own.peak, own.same_time = sizes.tau, last.command.peak, bool(last.command.t == t)
            self._point_to_last(last)
            self._point("row", sizes.row)
        else:
            own.edges = own.nodes = 0
            own.solution, self._begins = None, None
        self._point("root", ahead.roots)
        self._point("broken", ahead.preview.breaks)
        self._point("sharp", ahead.sharp)
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
        if status in (UNSOLVED, MISSING):
            return None, sizes
        if sizes is None:
            sizes = TickScales(float(self._numbers[4]), frozen(self._result[self._places["row"]]))
        self._guesses += int(self._counts[8])
        plan = self._made(t, ahead.roots, seconds)
        if status == OK:
            return plan, sizes
        told = UpdateStatus.RELAXED, "no plan keeps every limit"
        if status == REFUSED:
            blocked = plan.nodes[self._counts[4] : self._counts[4] + 1]
            where = place_of(ahead.preview.states(blocked)[0][0])
            reason = f"at t = {blocked[0]:.6g} s the preview leads where the machine cannot go, to {where}"
            told = UpdateStatus.REFUSED, reason
        elif not self._counts[7]:
            told = UpdateStatus.RELAXED, f"ahead {plan.left:.0%} of the force is missing"
        return replace(plan, command=replace(plan.command, status=told[0], reason=told[1])), sizes

    def _made(self, t: float, roots: Array, seconds: float) -> TickPlan:
        result = self._result.copy()
        base, own = ctypes.addressof(ctypes.c_double.from_buffer(result.data)), self._given  # sooner than by numpy
        read_only(result)
        (n, m, k, count), places = self._shape, self._places
        pieces, efforts, forces, _, known, iterations, rounds, _, _ = self._counts.tolist()
        residual, peak, left, largest, _ = self._numbers.tolist()

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
        return TickPlan(command, nodes, (at[0], at[1], at[2]), multipliers, left, largest, solution, iterations, rounds)


def tick_library(sizes: Mapping[str, int]) -> ctypes.CDLL:
    """Return the library of robots of some sizes, N, M, K, TERMS and COUNT, from disk or new.

    Raises:
        CompilerError: there is no C compiler, or it fails.
    """
    named = {**sizes, **{name: constant.value for name, constant in CONSTANTS.items() if constant.in_c}}
    head = [f"#define {name} {value!r}" for name, value in named.items()]
    folder = importlib.resources.files(__package__)
    text = "\n".join(["#define EXPORTED", *head, *(folder.joinpath(name).read_text("utf-8") for name in SOURCES)])
    compiler = find_compiler()
    where = "" if compiler is None else compiler.identity, str(cache_folder())
    # a sixth less time with it; not every compiler has it
    library, reason = _built(text, (*FLAGS, NATIVE), processor(), *where)
    if library is None:
        library, reason = _built(text, FLAGS, "", *where)
    if library is None:
        raise CompilerError(f"On-line planning runs in machine code, and {reason}.", remedy=REMEDY)
    return library


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


def _again(sizes: Mapping[str, int], *settings: Any) -> CompiledTick:
    return CompiledTick(tick_library(sizes), sizes, *settings)


def _address(array: Array) -> Any:
    return ctypes.c_void_p(array.ctypes.data)
