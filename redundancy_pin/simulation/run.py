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

from redundancy_pin.arrays import Array
from redundancy_pin.errors import SingularPoseError
from redundancy_pin.simulation.control import Sampling
from redundancy_pin.simulation.events import Event, Watcher
from redundancy_pin.simulation.machine import Command, Machine
from redundancy_pin.simulation.result import SimulationStatus, Statistics

INTEGRATORS = {"DOP853": DOP853, "RK45": RK45}
"""Explicit Runge-Kutta methods of scipy of order 8 and 5. The lower order is cheaper where a sampled controller makes
every step short."""

_LOOKS = (0.25, 0.5, 0.75, 1.0)
"""Where in a step the watched functions are looked at: a carrier that touches its end stop and leaves within one step
is not missed."""

GAP_LIMIT = 1e-9
"""Closure gap, m, that the projection must not leave."""


class Step:
    """An accepted step of an integrator, as a function of time.

    Args:
        solver: the integrator, after the step.
        before: y and ẏ at the start of the step.
    """

    def __init__(self, solver: OdeSolver, before: tuple[Array, Array]) -> None:
        self.start, self.end = float(solver.t_old), float(solver.t)
        self._solver, self._before, self._after = solver, before, (solver.y, solver.f)

    @cached_property
    def _dense(self) -> Callable[[float], Array]:
        # three more evaluations: made only where something asks for it
        interpolant: Callable[[float], Array] = self._solver.dense_output()
        return interpolant

    def __call__(self, t: float) -> Array:
        """Return y at a time in the step, to the accuracy of the integrator."""
        if t == self.start:
            return self._before[0]
        return self._after[0] if t == self.end else self._dense(t)

    def guess(self, fraction: float) -> Array:
        """Return y at a fraction of the step, from the cubic through y and ẏ at both ends: good enough to look."""
        (y0, f0), (y1, f1) = self._before, self._after
        x, h = fraction, self.end - self.start
        if x == 1.0:
            return y1
        slope: Array = x * (1.0 - x) * h * ((1.0 - x) * f0 - x * f1)
        return slope + y0 + (y1 - y0) * x * x * (3.0 - 2.0 * x)


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
    """

    def __init__(
        self,
        machine: Machine,
        watcher: Watcher,
        settings: Settings,
        grid: Array,
        breaks: Array,
        sampling: Sampling | None,
    ) -> None:
        self._machine, self._watcher, self._settings = machine, watcher, settings
        self._grid, self._sampling, self._breaks = grid, sampling, breaks
        self._record = Record()
        self._events: list[Event] = []
        self._steps = self._restarts = self._next = 0
        self._correction = 0.0
        self._suggested: float | None = None
        self._reason = ""
        self._y: Array = np.empty(0)

    def __call__(self, y: Array) -> Outcome:
        """Integrate from y = (q, v) at the first time of the grid."""
        began = time.perf_counter()
        t, end = float(self._grid[0]), float(self._grid[-1])
        y = self._y = self._machine.project(t, y)[0]
        status = SimulationStatus.COMPLETED
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
        machine, same = self._machine, _SAME * sampling.period
        count = max(1, int(np.ceil((end - start) / sampling.period - _SAME)))
        reads: Array = start + sampling.period * np.arange(count, dtype=np.float64)
        acts = reads + sampling.delay
        commands: list[Command] = []
        acting = 0
        for left, right in itertools.pairwise(_merged([reads, acts, self._breaks], start, end, same)):
            if len(commands) < len(reads) and reads[len(commands)] <= left + same:
                commands.append(machine.checked_command(machine.state(left, self._y)))
            while acting + 1 < len(commands) and acts[acting + 1] <= left + same:
                acting += 1
            machine.held = commands[acting]
            yield left, right

    def _stretch(self, start: float, end: float, y: Array) -> tuple[float, Array, SimulationStatus]:
        """Integrate over one stretch; return where it ended."""
        machine, settings = self._machine, self._settings
        nq = machine.robot.model.nq
        self._restarts += 1
        machine.until = end
        machine.dynamics.adapt(y[:nq])
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
        values = self._watcher.values(y[:nq])
        while solver.status == "running":
            if self._steps >= settings.max_steps:
                return self._failed(solver.t, solver.y, f"{self._steps} steps did not reach the end")
            before = solver.y, solver.f
            message = solver.step()
            if solver.status == "failed":
                why = str(message) if machine.trouble is None else str(machine.trouble)
                return self._failed(solver.t, solver.y, f"no step is short enough: {why}")
            machine.trouble = None
            self._steps += 1
            step = Step(solver, before)
            values, stop = self._look(step, values)
            self._write_before(solver.t if stop is None else stop, step)
            if stop is not None:
                return stop, machine.project(stop, step(stop))[0], SimulationStatus.STOPPED_BY_EVENT
            projected, found, left = machine.project(solver.t, solver.y)
            self._correction = max(self._correction, found)
            if left > GAP_LIMIT:
                return self._failed(solver.t, projected, f"the closures leave a gap of {left:.3g} m")
            try:
                machine.dynamics.adapt(projected[:nq])
            except SingularPoseError as error:
                return self._failed(solver.t, projected, str(error))
            solver.y = projected
            if solver.status == "running":
                solver.f = machine(solver.t, projected)
        self._suggested = solver.h_abs
        return end, solver.y, SimulationStatus.COMPLETED

    def _failed(self, t: float, y: Array, why: str) -> tuple[float, Array, SimulationStatus]:
        self._reason = f"At t = {t:.9g} s {why.rstrip('.')}."
        return float(t), y, SimulationStatus.FAILED

    def _look(self, step: Step, before: Array) -> tuple[Array, float | None]:
        """Find events in a step; return the watched functions at its end and the time of the first terminal event."""
        nq = self._machine.robot.model.nq
        left = step.start
        found: list[Event] = []
        for look in _LOOKS:
            right = step.start + look * (step.end - step.start)
            after = self._watcher.values(step.guess(look)[:nq])
            for i in self._watcher.crossed(before, after):
                watch = self._watcher.watches[i]
                found.append(Event(watch.kind, watch.name, self._root(step, i, left, right), watch.terminal))
            left, before = right, after
        for event in sorted(found, key=lambda event: event.t):
            self._events.append(event)
            if event.terminal:
                return before, event.t
        return before, None

    def _root(self, step: Step, index: int, left: float, right: float) -> float:
        """Return when a watched function changes sign; the end that is nearer to it where rounding hides the change."""
        nq = self._machine.robot.model.nq

        def value(t: float) -> float:
            return float(self._watcher.values(step(t)[:nq])[index])

        at_left, at_right = value(left), value(right)
        if at_left * at_right >= 0.0:
            return left if abs(at_left) <= abs(at_right) else right
        return float(brentq(value, left, right, xtol=1e-14, rtol=1e-14))

    def _write_before(self, end: float, step: Step) -> None:
        """Record the grid times before ``end``; what happens at the end of a stretch belongs to the next."""
        while self._grid[self._next] < end:
            t = float(self._grid[self._next])
            self._write(t, step(t))
            self._next += 1

    def _write(self, t: float, y: Array) -> None:
        projected, _, left = self._machine.project(t, y)
        self._record.t.append(t)
        self._record.y.append(projected)
        self._record.held.append(self._machine.held)
        self._record.gap.append(left)


_SAME = 1e-9
"""Instants closer than this fraction of a sampling period are one."""


def _merged(parts: Sequence[Array], start: float, end: float, same: float) -> list[float]:
    """Return the sorted instants strictly between start and end, one of each group that is the same, with both ends."""
    inner = np.sort(np.concatenate(parts))
    inner = inner[(inner > start + same) & (inner < end - same)]
    kept = inner[np.diff(inner, prepend=-np.inf) > same]
    return [start, *kept.tolist(), end]
