"""The march through time: an integrator of a library, a projection after every step, restarts where efforts jump."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.integrate import DOP853, RK45, OdeSolver
from scipy.optimize import brentq

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.errors import InputError
from redundancy_pin.simulation.controllers.base import Sampling
from redundancy_pin.simulation.events import Event, Watcher
from redundancy_pin.simulation.result import SimulationStatus, Statistics
from redundancy_pin.simulation.system import Command, Machine


class Step:
    """An accepted step of an integrator, as a function of time.

    Args:
        solver: the integrator, after the step.
        before: y and ẏ at the start of the step.
    """

    def __init__(self, solver: OdeSolver, before: tuple[Array, Array]) -> None:
        self.start, self.end = float(solver.t_old), float(solver.t)
        self._solver, self._before = solver, before
        self._after: tuple[Array, Array] = (solver.y, solver.f)

    @cached_property
    def _dense(self) -> Callable[[float], Array]:
        # three more evaluations: made only where something asks for it
        interpolant: Callable[[float], Array] = self._solver.dense_output()
        return interpolant

    def __call__(self, t: float) -> Array:
        """Return y at a time in the step, to the accuracy of the integrator."""
        if t <= self.start:
            return self._before[0]
        return self._after[0] if t >= self.end else self._dense(t)

    def time(self, fraction: float) -> float:
        """Return the time at a fraction of the step, s."""
        return self.end if fraction == 1.0 else self.start + fraction * (self.end - self.start)

    def exactly(self, fraction: float) -> Array:
        """Return y at a fraction of the step, to the accuracy of the integrator."""
        return self(self.time(fraction))

    def guesses(self, weights: Array) -> Array:
        """Return (N, nq + nv) y at fractions of the step, from the cubic through y and ẏ at both ends.

        It is good enough to look whether something is near, and takes no evaluation.

        Args:
            weights: (N, 4) ``cubic`` of the fractions.
        """
        (y0, f0), (y1, f1) = self._before, self._after
        h = self.end - self.start
        found: Array = weights.dot(np.array([y0, h * f0, h * f1, y1]))
        return found


def cubic(fractions: Sequence[float]) -> Array:
    """Return (N, 4) weights of y, h ẏ at the start and h ẏ, y at the end of a step of length h in Hermite's cubic."""
    x = np.array(fractions)
    late = x * x * (3.0 - 2.0 * x)
    return np.stack([1.0 - late, x * (1.0 - x) ** 2, -x * x * (1.0 - x), late], axis=1)


SAME = 1e-9
"""Instants closer than this fraction of a sampling period, or of the interval of the result's samples, are one."""


class Schedule:
    """Readings and changes of the efforts from a start to an end.

    Args:
        sampling: period and delay.
        start: time of the first reading, s.
        end: s; nothing is read there.
    """

    def __init__(self, sampling: Sampling, start: float, end: float) -> None:
        self._start, self._end, self._same = start, end, SAME * sampling.period
        count = max(1, int(np.ceil((end - start) / sampling.period - SAME)))
        self._reads: Array = start + sampling.period * np.arange(count, dtype=np.float64)
        self._acts: Array = self._reads + sampling.delay

    def edges(self, breaks: Array) -> list[float]:
        """Return the instants at which something changes, ``breaks`` among them; those that are the same only once."""
        inner = np.sort(np.concatenate([self._reads, self._acts, breaks]))
        inner = inner[(inner > self._start + self._same) & (inner < self._end - self._same)]
        kept = inner[np.diff(inner, prepend=-np.inf) > self._same]
        return [self._start, *kept.tolist(), self._end]

    def reads(self, t: float) -> int:
        """Return how many readings are due by time t."""
        return int(np.searchsorted(self._reads, t + self._same, side="right"))

    def acts(self, t: float) -> int:
        """Return how many outputs have had the time to act by time t."""
        return int(np.searchsorted(self._acts, t + self._same, side="right"))


INTEGRATORS = {"DOP853": DOP853, "RK45": RK45}
"""Explicit Runge-Kutta methods of scipy of order 8 and 5. The lower order is cheaper where a sampled controller makes
every step short."""

_LOOKS = (0.25, 0.5, 0.75, 1.0)
"""Where in a step the watched functions are looked at; and where a joint turns back before a stop, so that one that
passes it and returns between two looks is not missed."""

_BRIEF = 2e-3
"""s; in a step shorter than this only the end is looked at, and where joints turn back."""

_WEIGHTS = cubic((0.0, *_LOOKS))
_WEIGHTS_OF_ENDS = cubic((0.0, 1.0))

_TURN = 1e-6
"""Part of a step to which it is known where a joint turns back: what it moves meanwhile is of second order in it."""

SHORTEST = 1e-8
"""s; a machine whose motion takes steps shorter than this, many in a row, is not one."""

_MOST_SHORT = 20

_LITTLE_INERTIA = 1e-3
"""Share of the largest inertia below which an inertia is blamed for a motion that blows up."""

GAP_LIMIT = 1e-9
"""Closure gap, m, that the projection must not leave."""


@dataclass(frozen=True)
class Settings:
    """Settings of the integration.

    Attributes:
        rtol, atol: relative and absolute tolerance of a step.
        max_step: longest step, s.
        max_steps: most steps before it is given up.
        integrator: a key of ``INTEGRATORS``.
    """

    rtol: float
    atol: float
    max_step: float
    max_steps: int
    integrator: str


@dataclass(eq=False)
class Record:
    """Samples as they come in."""

    t: list[float] = field(default_factory=list)
    y: list[Array] = field(default_factory=list)
    held: list[Command | None] = field(default_factory=list)
    gap: list[float] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a run left: samples, events, how it ended."""

    record: Record
    events: tuple[Event, ...]
    status: SimulationStatus
    reason: str
    statistics: Statistics


class Run:
    """One integration from a state to an end.

    Args:
        machine: what is integrated.
        watcher: what is watched for.
        settings: of the integration.
        grid: (G,) times at which to record, s, first and last included.
        breaks: inner times at which efforts jump, s.
        sampling: of a digital controller, or None.
        first: efforts that the controller commands at the start.
    """

    def __init__(
        self,
        machine: Machine,
        watcher: Watcher,
        settings: Settings,
        grid: Array,
        breaks: Array,
        sampling: Sampling | None,
        first: Command,
    ) -> None:
        self._machine, self._watcher, self._settings = machine, watcher, settings
        self._grid, self._sampling, self._breaks = grid, sampling, breaks
        self._record, self._first = Record(), first
        self._same = SAME * float(grid[1] - grid[0])
        self._events: list[Event] = []
        self._steps = self._restarts = self._next = self._short = 0
        self._correction = 0.0
        self._suggested: float | None = None
        self._reason = ""
        self._y: Array = np.empty(0)
        self._watched: Array = np.empty(0)

    def __call__(self, y: Array) -> Outcome:
        """Integrate from y = (q, v) at the first time of the grid.

        Raises:
            InputError: the controller returns something else than finite efforts.
        """
        began = time.perf_counter()
        t, end = float(self._grid[0]), float(self._grid[-1])
        y = self._y = self._machine.project(t, y)[0]
        self._watched = self._watcher.at_start(y[: self._machine.robot.model.nq])
        status = SimulationStatus.COMPLETED
        with np.errstate(all="ignore"):  # trial steps that overflow are given up for shorter ones
            for left, right in self._stretches(t, end):
                t, y, status = self._stretch(left, right, y)
                self._y = y
                if status is not SimulationStatus.COMPLETED:
                    break
        self._write(t, y)
        statistics = Statistics(
            self._steps, self._machine.evaluations, self._restarts, self._correction, time.perf_counter() - began
        )
        return Outcome(self._record, tuple(self._events), status, self._reason, statistics)

    def _stretches(self, start: float, end: float) -> Iterator[tuple[float, float]]:
        """Yield stretches over which the efforts are smooth; set what a sampled controller holds before each."""
        if self._sampling is None:
            edges = [start, *self._breaks.tolist(), end]
            yield from itertools.pairwise(edges)
        else:
            yield from self._sampled(self._sampling, start, end)

    def _sampled(self, sampling: Sampling, start: float, end: float) -> Iterator[tuple[float, float]]:
        """Yield the stretches between readings of the state, changes of the held efforts, and breaks."""
        machine, commands, acting = self._machine, [self._first], 0
        schedule = Schedule(sampling, start, end)
        for left, right in itertools.pairwise(schedule.edges(self._breaks)):
            if schedule.reads(left) > len(commands):
                commands.append(machine.asked(machine.state(left, self._y)))
            acting = max(acting, min(schedule.acts(left), len(commands)) - 1)
            machine.held = commands[acting]
            yield left, right

    def _stretch(self, start: float, end: float, y: Array) -> tuple[float, Array, SimulationStatus]:
        """Integrate over one stretch; return where it ended.

        Raises:
            InputError: the controller returns something else than finite efforts, at trial steps however short.
        """
        machine, settings = self._machine, self._settings
        self._restarts += 1
        machine.until = end
        solver = INTEGRATORS[settings.integrator](
            machine,
            start,
            y,
            end,
            rtol=settings.rtol,
            atol=settings.atol,
            max_step=settings.max_step,
            first_step=None if self._suggested is None else min(self._suggested, end - start),
        )
        while solver.status == "running":
            if self._steps >= settings.max_steps:
                return self._failed(solver.t, solver.y, f"{self._steps} steps did not reach the end")
            before = solver.y, solver.f
            message = solver.step()
            if solver.status == "failed":
                self._require_answers()
                why = str(message) if machine.trouble is None else str(machine.trouble)
                return self._failed(solver.t, solver.y, f"no step is short enough: {why}")
            self._steps += 1
            short = solver.step_size < SHORTEST and solver.status == "running"
            self._short = self._short + 1 if short else 0
            if self._short >= _MOST_SHORT:
                self._require_answers()
                return self._failed(
                    solver.t, solver.y, f"the steps have shrunk to {solver.step_size:.2g} s: {self._why()}"
                )
            machine.trouble = None
            step = Step(solver, before)
            stop = self._look(step)
            self._write_before(solver.t if stop is None else stop, step)
            if stop is not None:
                return stop, machine.project(stop, step(stop))[0], SimulationStatus.STOPPED_BY_EVENT
            projected, found, left = machine.project(solver.t, solver.y)
            self._correction = max(self._correction, found)
            if left > GAP_LIMIT:
                return self._failed(solver.t, projected, f"the closures leave a gap of {left:.3g} m")
            solver.y = projected
            if solver.status == "running":
                solver.f = machine(solver.t, projected)
        self._suggested = solver.h_abs
        return end, solver.y, SimulationStatus.COMPLETED

    def _require_answers(self) -> None:
        """Check, where no step is short enough, that it is not the controller that has no answer.

        Raises:
            InputError: what it returned instead, and when.
        """
        if isinstance(self._machine.trouble, InputError):
            raise self._machine.trouble

    def _why(self) -> str:
        """Return what makes a motion blow up, as far as it shows."""
        inertia = self._machine.dynamics.least_inertia
        if inertia < _LITTLE_INERTIA:
            return (
                f"a free motion has hardly any inertia, {inertia:.2g} of the largest, so accelerations grow without "
                "bound. Give every part mass (such as end_effector_mass=0.1)"
            )
        return "something grows without bound. Check the efforts of the controller"

    def _failed(self, t: float, y: Array, why: str) -> tuple[float, Array, SimulationStatus]:
        self._reason = f"At t = {t:.9g} s {why.rstrip('.')}."
        return float(t), y, SimulationStatus.FAILED

    def _look(self, step: Step) -> float | None:
        """Find events in a step; return the time of the first terminal one."""
        looks, weights = (_LOOKS, _WEIGHTS) if step.end - step.start > _BRIEF else (_LOOKS[-1:], _WEIGHTS_OF_ENDS)
        guessed = step.guesses(weights)
        values = self._watcher.values_at(guessed[1:, : self._machine.robot.model.nq])
        before = np.concatenate([self._watched[None], values[:-1]])
        if self._watcher.any_crossed(before, values) or self._turning(step, guessed, looks).any():
            return self._look_exactly(step, looks)
        self._watched = values[-1]
        return None

    def _look_exactly(self, step: Step, looks: Sequence[float]) -> float | None:
        """Find events on the integrator's own interpolant, which costs more."""
        looks = self._with_turns(step, looks)
        values = self._watcher.values_at(np.array([step.exactly(x) for x in looks])[:, : self._machine.robot.model.nq])
        events = []
        left, before = 0.0, self._watched
        for right, after in zip(looks, values, strict=True):
            for i in self._watcher.crossed(before, after):
                watch = self._watcher.watches[i]
                events.append(Event(watch.kind, watch.name, self._root(step, i, left, right), watch.terminal))
            left, before = right, after
        self._watched = before
        for event in sorted(events, key=lambda event: event.t):
            self._events.append(event)
            if event.terminal:
                return event.t
        return None

    def _turning(self, step: Step, states: Array, looks: Sequence[float]) -> BoolArray:
        """Return (N, l) which joints turn back before a stop in which of N parts of a step.

        Args:
            step: the step.
            states: (N + 1, nq + nv) states at its start and at the ends of the parts.
            looks: fractions of the step at which the parts end.
        """
        away, rate = self._watcher.stops(states)
        length = np.diff(looks, prepend=0.0)[:, None] * (step.end - step.start)
        reach = length * np.maximum(np.abs(rate[:-1]), np.abs(rate[1:]))
        turning: BoolArray = (rate[:-1] < 0.0) & (rate[1:] > 0.0) & (np.minimum(away[:-1], away[1:]) < reach)
        return turning

    def _with_turns(self, step: Step, looks: Sequence[float]) -> list[float]:
        """Return the fractions at which to look, with those at which a joint turns back before a stop."""
        ends = [0.0, *looks]
        turning = self._turning(step, np.array([step.exactly(x) for x in ends]), looks)

        def rate(x: float, joint: int) -> float:
            return float(self._watcher.stops(step.exactly(x)[None])[1][0, joint])

        turns = [brentq(rate, ends[part], ends[part + 1], (i,), xtol=_TURN) for part, i in np.argwhere(turning)]
        return sorted([*looks, *turns])

    def _root(self, step: Step, index: int, left: float, right: float) -> float:
        """Return the time at which a watched function changes sign between two fractions of a step."""
        nq = self._machine.robot.model.nq

        def value(fraction: float) -> float:
            return float(self._watcher.values(step.exactly(fraction)[:nq])[index])

        at_left, at_right = value(left), value(right)
        if at_left * at_right < 0.0:
            fraction = float(brentq(value, left, right, xtol=1e-14, rtol=1e-14))
        else:  # zero to rounding at one end: it starts or ends there
            fraction = left if abs(at_left) <= abs(at_right) else right
        return step.time(fraction)

    def _write_before(self, end: float, step: Step) -> None:
        """Record the grid times before ``end``; what happens at the end of a stretch belongs to the next."""
        while self._grid[self._next] < end - self._same:
            t = float(self._grid[self._next])
            self._write(t, step(t))
            self._next += 1

    def _write(self, t: float, y: Array) -> None:
        projected, _, left = self._machine.project(t, y)
        self._record.t.append(t)
        self._record.y.append(projected)
        self._record.held.append(self._machine.held)
        self._record.gap.append(left)
