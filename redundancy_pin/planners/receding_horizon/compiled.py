"""The on-line planner as machine code: C for a robot's sizes, its memory, and its calls of a backend.

It is compiled once for each set of sizes and kept on disk (``machine_code``).
"""

from __future__ import annotations

import ctypes
import importlib.resources
from collections.abc import Mapping
from dataclasses import astuple
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, frozen, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.results import CarrierTerms
from redundancy_pin.errors import CompilerError, InfeasiblePlanError, InputError
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
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.carrier_model import SLIDING_TERMS, TURNING_TERMS, carrier_model
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.receding_horizon.command import Command, UpdatePlan, Weights
from redundancy_pin.planners.receding_horizon.constants import (
    CONSTANTS,
    CURVE,
    EXTRA,
    FULL,
    INSTANTS,
    MOST_ROOTS,
    NEAR,
)
from redundancy_pin.planners.receding_horizon.preview import Preview, place_of
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.scales import row_scale, turning_velocities
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.time_scaling import TimeScaling, scaled_rates

SOURCES = "window.c", "nodes.c", "programme.c", "solver.c", "update.c", "planner.c"

OK, UNSOLVED, RELAXED, REFUSED, FALLBACK, TIME_SCALED, STOPPED = range(7)
"""Return values of ``rp_planner_update``; ``UNSOLVED``: no plan yet; ``STOPPED``: by an exception in Python."""

STATUSES = {
    OK: UpdateStatus.OK,
    RELAXED: UpdateStatus.RELAXED,
    REFUSED: UpdateStatus.REFUSED,
    FALLBACK: UpdateStatus.FALLBACK,
    TIME_SCALED: UpdateStatus.TIME_SCALED,
}

REASONS = (
    "",
    "the solver found none",
    "no plan keeps every limit",
    "ahead {left:.0%} of the force is missing",
    "at t = {known:.6g} s the preview leads where the machine cannot go, to {place}",
    "between the nodes a carrier exceeds its speed",
    "between the nodes a carrier exceeds its force",
    "between the nodes the efforts exceed their limits",
)
"""In the order of ``planner.c``."""

BLOCKED = 4
"""The place of the fifth."""

_LIMITS = ("track", "speed", "acceleration", "jerk", "carrier_force", "effort")

_EVALUATE = ctypes.CFUNCTYPE(ctypes.c_long, ctypes.c_void_p, ctypes.c_long, *[ctypes.c_void_p] * 5)


class _Preview(ctypes.Structure):
    _fields_ = [
        ("evaluate", _EVALUATE),
        ("context", ctypes.c_void_p),
        ("start", ctypes.c_double),
        ("end", ctypes.c_double),
        ("broken", ctypes.c_void_p),
        ("breaks", ctypes.c_long),
        ("changing", ctypes.c_long),
        ("number", ctypes.c_long),
    ]


class _Polynomials(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("terms", "numbers", "near", "edge", "piece")),
        ("pieces", ctypes.c_long),
        ("order", ctypes.c_long),
        ("moves_until", ctypes.c_double),
        ("otherwise", _EVALUATE),
        ("context", ctypes.c_void_p),
    ]


class Terms:
    """W and f as terms of the carriers' motion at a few instants of a preview, by a backend.

    Args:
        dynamics: the backend.

    Attributes:
        count: of terms of each carrier.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        robot = dynamics.robot
        self.dynamics, self._checked = dynamics, False
        self._turning = bool(turning_velocities(robot)[robot.carrier_velocity].any())
        self.count = (TURNING_TERMS if self._turning else SLIDING_TERMS)[-1] + 1

    @property
    def generated(self) -> tuple[int, int, int] | None:
        """Addresses of ``rp_terms`` of generated code, its robot's numbers, and the state of this thread."""
        return self.dynamics.terms_call if self._checked and not self._turning else None

    def at(self, preview: Preview, t: Array, sigma: Array, rate: Array, bend: Array) -> CarrierTerms:
        """Return them at (N,) times t, s, at which the preview is at σ, s, with σ̇ and σ̈; NaN where out of reach."""
        once, place = np.unique(sigma, return_inverse=True)  # a platform at rest
        x, xd, xdd = (part[place] for part in preview.states(once))
        if (rate != 1.0).any() or bend.any():
            xd, xdd = scaled_rates(xd, xdd, rate, bend)
        if self._checked and not self._turning:
            return self.dynamics.carrier_terms(t, x, xd, xdd)
        along = self.dynamics.along(PlatformMotion(t, x, xd, xdd, check_rates=False), unreachable="mark")
        model = carrier_model(along, turning=self._turning)  # looks whether the terms are all there is
        self._checked = True
        own = np.arange(model.k)
        of_f = model.f_terms.transpose(0, 2, 3, 1)
        of_force = np.zeros((*of_f.shape[:3], model.k))
        of_force[:, own, :, own] = model.force_terms.transpose(1, 0, 2)
        constant = np.concatenate([model.f0, model.force0], axis=1)
        return CarrierTerms(model.W, constant, np.concatenate([of_f, of_force], axis=3))


class CompiledPlanner:
    """The planner's updates in fixed memory; one for each ``RecedingHorizon``.

    Args:
        dynamics: the backend.
        step, horizon: s.
        weights: of the objective.
        limits: active limits; ``set_limits`` changes them.
        slow_down: whether the platform may go more slowly where no plan keeps every limit.
        memory, last, number, layout: state of a running planner, with the number of its preview and a key that shows
            whether its memory has the layout used here.

    Attributes:
        last: the plan of the last update; None before the first.

    Raises:
        CompilerError: there is no C compiler, or it fails.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        step: float,
        horizon: float,
        weights: Weights,
        limits: ResolvedLimits,
        slow_down: bool,
        memory: Array | None = None,
        last: UpdatePlan | None = None,
        number: int = 0,
        layout: str = "",
    ) -> None:
        self._made_of = dynamics, step, horizon, weights
        self._slow_down, self._terms = slow_down, Terms(dynamics)
        sizes = sizes_of(dynamics.robot, step, horizon, self._terms.count)
        n, m, k, count = (sizes[name] for name in ("N", "M", "K", "COUNT"))
        self._shape, self._robot = (n, m, k, count), dynamics.robot
        self._library = library = planner_library(sizes)
        times, carriers = INSTANTS + count, 2 * (count + k)
        length = library.rp_planner_solution() // 8
        self._places = _places({
            "counts": 12, "numbers": 9, "row": n, "solution": length, "node": count, "at": 3 * count * k,
            "multiplier": count * n, "singular": MOST_ROOTS, "edge": carriers + 1, "piece": 4 * carriers * k,
            "effort_edge": 2 * times + 1, "effort": 4 * times * m, "force_edge": 2 * INSTANTS + 1,
            "force": 4 * INSTANTS * k,
        })  # fmt: skip
        self._layout = digest([planner_source(sizes), str(library.rp_planner_size())])
        if memory is not None and layout != self._layout:
            raise InputError(
                "The planner comes from another version of the package, or another compiler.",
                remedy="Make a new one, and pass s and sd to its first update.",
            )
        self._memory = np.zeros(library.rp_planner_size() // 8 + 1) if memory is None else memory.copy()
        self._address = ctypes.c_void_p(self._memory.ctypes.data)
        self._python = _EVALUATE(self._evaluate)
        self._given = _Preview(number=number)
        self._known: Preview | None = None
        self._breaks = np.empty(0)
        self._raised: BaseException | None = None
        self._nowhere = np.full(k, np.nan)
        self._changes, self._scaling = 0, None if last is None else last.command.scaling
        self.last = last
        self._limits = limits
        if memory is None:
            library.rp_planner_start(self._address, _address(self._settings()), ctypes.c_long(slow_down))

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild it, with separate memory, when it is copied or sent."""
        going_on = self._memory, self.last, self._given.number, self._layout
        return CompiledPlanner, (*self._made_of, self._limits, self._slow_down, *going_on)

    def _settings(self) -> Array:
        _, step, horizon, weights = self._made_of
        return np.concatenate([*map(np.ravel, settings_of(self._robot, step, horizon, weights, self._limits))])

    def set_limits(self, limits: ResolvedLimits) -> None:
        """Use limits from the next update on."""
        self._limits = limits
        self._library.rp_planner_set(self._address, _address(self._settings()))

    def time_of(self, t: float) -> float:
        """Return which time of the preview, s, the platform is at, at a time of the clock."""
        return float(self._library.rp_planner_sigma(self._address, ctypes.c_double(t)))

    @property
    def largest(self) -> float:
        """Largest |τ| so far, N or N·m."""
        return 0.0 if self.last is None else self.last.so_far

    @property
    def roots(self) -> Array:
        """Singular instants in the preview window or shortly before it, s."""
        return self._in_sight(0)

    @property
    def sharp(self) -> Array:
        """Instants in the preview window at which f of the parked machine has high curvature, s."""
        return self._in_sight(1)

    def _in_sight(self, which: int) -> Array:
        window = self._library.rp_planner_window(self._address)
        count = (ctypes.c_long * 2).from_address(window)[which]
        first = window + 16 + 8 * MOST_ROOTS * which
        return _at(first, count).copy()

    def _evaluate(self, _: object, count: int, *addresses: int) -> int:
        """Write W, f and forces by terms; return the number of instants before the first out of reach."""
        try:
            t, sigma, rate, bend = (_at(part, count).copy() for part in addresses[:4])
            if self._known is None:
                return -1
            read = self._terms.at(self._known, t, sigma, rate, bend)
            finite = np.isfinite(read.constant).all(axis=1)
            size = sum(part.size for part in read)
            np.concatenate([part.ravel() for part in read], out=_at(addresses[4], size))
            return count if finite.all() else int(finite.argmin())
        except BaseException as error:  # raised again by ``update``
            self._raised = error
            return -1

    def update(self, t: float, preview: Preview, given: tuple[Array | None, ...]) -> UpdatePlan:
        """Return the plan from a time on, s; ``given``: (k,) s and ṡ of the carriers, None where the last plan's count.

        Raises:
            InfeasiblePlanError: a first update has no plan.
        """
        own = self._given
        if preview is not self._known:
            breaks = np.ascontiguousarray(preview.breaks, dtype=np.float64)
            self._known, self._breaks = preview, breaks
            own.start, own.end, own.changing = preview.start, preview.end, preview.changing
            own.broken, own.breaks, own.number = breaks.ctypes.data, len(breaks), own.number + 1
            own.evaluate, own.context = self._python, None
        self._use_generated(preview)
        s, sd = (self._nowhere if part is None else np.ascontiguousarray(part, dtype=np.float64) for part in given)
        status = self._library.rp_planner_update(
            self._address, ctypes.c_double(t), ctypes.byref(own), _address(s), _address(sd)
        )
        if status == STOPPED:
            raised, self._raised = self._raised, None
            raise raised or InputError(
                "The preview is not finite within its window.", remedy="Pass a motion of finite numbers.", time=t
            )
        if status == UNSOLVED:
            raise InfeasiblePlanError(
                f"No plan was found at t = {t:.6g} s.", remedy="Start elsewhere, or widen the limits.", time=t
            )
        self.last = self._read()
        return self.last

    def _use_generated(self, preview: Preview) -> None:
        """Have polynomials evaluated by generated code, without Python, where the backend has it."""
        polynomials, call = preview.polynomials, self._terms.generated
        if polynomials is None or call is None:
            return
        if self._given.context is None:
            edges, pieces = (np.ascontiguousarray(part) for part in (polynomials.edges, polynomials.coefficients))
            self._pieces = edges, pieces
            own = self._polynomials = _Polynomials(
                edge=edges.ctypes.data, piece=pieces.ctypes.data, pieces=len(edges) - 1, order=len(pieces),
                moves_until=preview.moves_until, otherwise=self._python,
            )  # fmt: skip
            self._given.evaluate = ctypes.cast(self._library.rp_evaluate_polynomials, _EVALUATE)
            self._given.context = ctypes.addressof(own)
        self._polynomials.terms, self._polynomials.numbers, self._polynomials.near = call  # of this thread

    def _read(self) -> UpdatePlan:
        """Return the result in memory, copied."""
        places, (n, m, k, count) = self._places, self._shape
        here = self._library.rp_planner_result(self._address)
        result = read_only(_at(here, places["force"].stop).copy())
        numbers = result[places["numbers"]].tolist()
        counts = result[places["counts"]].view(np.int64).tolist()
        status, why, pieces, efforts, forces, known, iterations, rounds, _, _, singular, changes = counts
        t, residual, peak, left, largest, known_until, blocked, tau, so_far = numbers

        def function(edges: str, coefficients: str, order: int, pieces: int, width: int) -> PiecewisePolynomial:
            first, start = places[edges].start, places[coefficients].start
            used = result[start : start + order * pieces * width].reshape(order, pieces, width)
            return PiecewisePolynomial(result[first : first + pieces + 1], used)

        told = STATUSES[status], REASONS[why].format(left=left, known=0.0, place="")
        if why == BLOCKED:
            place = place_of(self._known.states(np.array([blocked]))[0][0]) if self._known else []
            told = told[0], REASONS[why].format(known=float(result[places["node"]][known]), place=place)
        scaling = self._scaling_after(changes)
        if scaling is not None and told[0] is UpdateStatus.TIME_SCALED:
            reason = f"the platform goes over to {scaling.final_rate:.1%} of the preview's speed"
            if scaling.final_rate < FULL:
                reason += ": with more of it no plan was found that keeps every limit"
            told = told[0], reason
        command = Command(
            t, *told, function("edge", "piece", 4, pieces, k), function("effort_edge", "effort", 2, efforts, m),
            function("force_edge", "force", 2, forces, k), residual, peak, result[places["singular"]][:singular],
            known_until, 0.0, scaling,
        )  # fmt: skip
        at = result[places["at"]].reshape(3, count, k)
        return UpdatePlan(
            command, result[places["node"]], (at[0], at[1], at[2]), result[places["multiplier"]].reshape(count, n),
            left, largest, iterations, rounds, tau, result[places["row"]], so_far,
        )  # fmt: skip

    def _scaling_after(self, changes: int) -> TimeScaling | None:
        """Return σ by the clock's time after so many changes: the same object until the next one."""
        if changes != self._changes:
            here = self._library.rp_planner_scaling(self._address)
            pieces = ctypes.c_long.from_address(here).value
            numbers = _at(here + 8, 6 * CURVE + 1)
            coefficients = numbers[CURVE + 1 :].reshape(CURVE, 5)[:pieces]
            edges = frozen(numbers[: pieces + 1])
            self._scaling = TimeScaling(PiecewisePolynomial(edges, frozen(coefficients.T[:, :, None])))
            self._changes = changes
        return self._scaling


def sizes_of(robot: Robot, step: float, horizon: float, terms: int) -> dict[str, int]:
    """Return the constants of C for a robot and its plans: ``COUNT``, nodes of a plan, among them."""
    steps = round(horizon / step)
    count = min(steps, NEAR) + max(steps - NEAR, 0) // 2 + EXTRA + 1
    places = 16 if is_pose(robot) else robot.n
    return {"N": robot.n, "PLACES": places, "M": robot.m, "K": robot.k, "TERMS": terms, "STEPS": steps, "COUNT": count}


def settings_of(robot: Robot, step: float, horizon: float, weights: Weights, limits: ResolvedLimits) -> list[Array]:
    """Return the members of ``Settings`` of ``planner.c``."""
    of_limits = (getattr(limits, name).ravel() for name in _LIMITS)
    return [np.array(step), np.array(horizon), row_scale(robot), np.array(astuple(weights)), *of_limits]


def planner_source(sizes: Mapping[str, int], *more: str) -> str:
    """Return the C of the planner of robots of some sizes, as of ``sizes_of``; ``more``: texts behind it."""
    head = [f"#define {name} {value}" for name, value in sizes.items()]
    for name, constant in CONSTANTS.items():
        if constant.in_c and isinstance(constant.value, tuple):
            rows = ", ".join(f"{{{', '.join(map(repr, row))}}}" for row in constant.value)
            head.append(f"static const double {name}[][{len(constant.value[0])}] = {{{rows}}};")
        elif constant.in_c:
            head.append(f"#define {name} {constant.value!r}")
    folder = importlib.resources.files(__package__)
    return "\n".join([*head, *(folder.joinpath(name).read_text("utf-8") for name in (*SOURCES, *more))])


def planner_library(sizes: Mapping[str, int]) -> ctypes.CDLL:
    """Return the library of robots of some sizes, as of ``sizes_of``, from disk or new.

    Raises:
        CompilerError: there is no C compiler, or it fails.
    """
    text = planner_source(sizes, "exports.c")
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
        library = loaded(path)  # AttributeError below where the file is another one
        for name in ("size", "solution"):
            getattr(library, f"rp_planner_{name}").restype = ctypes.c_long
        for name in ("result", "window", "scaling"):
            getattr(library, f"rp_planner_{name}").restype = ctypes.c_void_p
        library.rp_planner_sigma.restype = ctypes.c_double
        _ = library.rp_planner_start, library.rp_planner_set, library.rp_planner_update
        return library

    return built(lambda identity: digest([text, identity, *flags, machine]), lambda: text, load, flags)


def _places(parts: Mapping[str, int]) -> dict[str, slice]:
    """Return where parts of some lengths are that lie one behind the other."""
    ends = np.cumsum([0, *parts.values()]).tolist()
    return {name: slice(a, b) for name, a, b in zip(parts, ends[:-1], ends[1:], strict=True)}


def _at(address: int, count: int) -> Array:
    """Return numbers that are in memory there, without a copy."""
    numbers: Array = np.ctypeslib.as_array((ctypes.c_double * count).from_address(address))
    return numbers


def _address(array: Array) -> Any:
    return ctypes.c_void_p(array.ctypes.data)
