"""Integration in time: a library's integrator, a projection after every step, restarts where efforts jump.

Three things are done between the steps of scipy's solvers, which ``solve_ivp`` would not let us do. Each step is
projected onto the closures, at the level of positions and of rates, so constraints do not drift and need no
stabilisation. Integration starts anew where efforts jump, for no Runge-Kutta method keeps its order across a jump, and
step control would spend dozens of steps on finding it. And a digital controller is read between steps only, in order of
time.

What changes along the way is one value, ``Progress``: each step returns the next one.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.integrate import DOP853, RK45, OdeSolver

from redundancy_pin.arrays import Array
from redundancy_pin.errors import IllPosedModelError, InputError, RedundancyPinError, SingularPoseError
from redundancy_pin.simulation.controllers.base import Command, Sampling
from redundancy_pin.simulation.events import Event, EventFunctions, Step, find_events
from redundancy_pin.simulation.result import SimulationStatus, Statistics
from redundancy_pin.simulation.system import Machine

INTEGRATORS = {"DOP853": DOP853, "RK45": RK45}
"""Explicit Runge-Kutta methods of scipy of order 8 and 5. The lower order is cheaper where a sampled controller makes
every step short."""

SAME = 1e-9
"""Instants closer than this fraction of a sampling period, or of the interval of the result's samples, are one."""

SHORTEST = 1e-8
"""s; a machine whose motion takes steps shorter than this, many in a row, is not one."""

_MOST_SHORT = 20

_LITTLE_INERTIA = 1e-3
"""Share of the largest inertia below which an inertia is blamed for a motion that blows up."""

GAP_LIMIT = 1e-9
"""Closure gap, m, that the projection must not leave."""


@dataclass(frozen=True)
class Settings:
    """Tolerances of a step, longest step, s, most steps, and a key of ``INTEGRATORS``."""

    rtol: float
    atol: float
    max_step: float
    max_steps: int
    integrator: str


@dataclass(frozen=True)
class Stretch:
    """A time over which the efforts are smooth.

    Attributes:
        start, end: s.
        reads: whether a digital controller reads the state at its start.
        acting: number of the reading whose answer acts meanwhile; None where the controller answers at every instant.
    """

    start: float
    end: float
    reads: bool = False
    acting: int | None = None


def stretches(start: float, end: float, breaks: Array, sampling: Sampling | None) -> list[Stretch]:
    """Return the stretches from a start to an end, s, with ``breaks`` between them.

    The reading at the start is taken before, and none is taken at the end.
    """
    if sampling is None:
        return [Stretch(left, right) for left, right in pairwise([start, *breaks.tolist(), end])]
    same = SAME * sampling.period
    count = max(1, int(np.ceil((end - start) / sampling.period - SAME)))
    reads = start + sampling.period * np.arange(count)
    acts = reads + sampling.delay
    edges = np.sort(np.concatenate([reads, acts, breaks]))
    edges = edges[(edges > start + same) & (edges < end - same)]
    edges = np.concatenate([[start], edges[np.diff(edges, prepend=-np.inf) > same], [end]])
    due, acted = (np.searchsorted(times, edges[:-1] + same, side="right") for times in (reads, acts))
    result, taken = [], 1
    for left, right, read, act in zip(edges[:-1].tolist(), edges[1:].tolist(), due, acted, strict=True):
        new = bool(read > taken)
        taken += new
        result.append(Stretch(left, right, new, max(min(int(act), taken) - 1, 0)))
    return result


@dataclass(frozen=True, eq=False)
class Problem:
    """What is integrated, and how.

    Attributes:
        machine: the differential equation.
        functions: whose zeros are events.
        settings: of the integration.
        grid: (G,) times at which to record, s, first and last included.
        breaks: inner times at which efforts jump, s.
        sampling: of a digital controller, or None.
    """

    machine: Machine
    functions: EventFunctions
    settings: Settings
    grid: Array
    breaks: Array
    sampling: Sampling | None


@dataclass(frozen=True, eq=False)
class Progress:
    """How far an integration is.

    Attributes:
        t: s.
        y: (nq + nv,) the closed state there.
        values: (w,) functions of the events there.
        next_step: length the integrator suggests for its next step, s; None before the first.
        short: how many steps in a row were shorter than ``SHORTEST``.
        steps, evaluations, restarts, largest_correction: see ``Statistics``.
        status: None while it goes on.
        reason: why it failed.
    """

    t: float
    y: Array
    values: Array
    next_step: float | None = None
    short: int = 0
    steps: int = 0
    evaluations: int = 0
    restarts: int = 0
    largest_correction: float = 0.0
    status: SimulationStatus | None = None
    reason: str = ""

    def failed(self, why: str) -> Progress:
        """Return that it ends here."""
        return replace(self, status=SimulationStatus.FAILED, reason=f"At t = {self.t:.9g} s {why.rstrip('.')}.")


@dataclass(frozen=True, eq=False)
class Sample:
    """A closed state y (nq + nv,) at time t, s, and the command that is held there (None: the controller's answer)."""

    t: float
    y: Array
    hold: Command | None


@dataclass(eq=False)
class Record:
    """Samples and events as they come in."""

    samples: list[Sample] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an integration leaves: samples and events in order of time, and how it ended."""

    samples: tuple[Sample, ...]
    events: tuple[Event, ...]
    status: SimulationStatus
    reason: str
    statistics: Statistics


def integrate(problem: Problem, y: Array, values: Array, first: Command) -> Outcome:
    """Integrate from a closed state y at the first time of the grid, where a controller gave its first command.

    Raises:
        InputError: the controller returns something else than finite efforts.
    """
    began, machine, grid = time.perf_counter(), problem.machine, problem.grid
    record, commands, hold = Record(), [first], None
    progress = Progress(float(grid[0]), y, values)
    with np.errstate(all="ignore"):  # trial steps that overflow are given up for shorter ones
        for stretch in stretches(float(grid[0]), float(grid[-1]), problem.breaks, problem.sampling):
            if stretch.reads:
                commands.append(machine.command(machine.state(stretch.start, progress.y)))
            hold = None if stretch.acting is None else commands[stretch.acting]
            progress = _integrate_stretch(problem, progress, stretch, hold, record)
            if progress.status is not None:
                break
    record.samples.append(_sample(machine, progress.t, progress.y, hold))
    seconds = time.perf_counter() - began
    counts = progress.steps, progress.evaluations, progress.restarts, progress.largest_correction
    status = progress.status or SimulationStatus.COMPLETED
    return Outcome(tuple(record.samples), tuple(record.events), status, progress.reason, Statistics(*counts, seconds))


class _Rate:
    """ẏ over one stretch, as scipy's solvers call it; ``failure`` says why a call of this step had no answer."""

    def __init__(self, machine: Machine, hold: Command | None, end: float) -> None:
        self._machine, self._hold, self._end = machine, hold, end
        self.evaluations = 0
        self.failure: RedundancyPinError | None = None

    def __call__(self, t: float, y: Array) -> Array:
        """Return ẏ; NaN where there is none: the integrator then tries a shorter step."""
        self.evaluations += 1
        if y[0] != y[0]:  # a stage after one that had no answer
            return np.full(len(y), np.nan)
        # efforts that jump at the end of a stretch are evaluated just before it
        state = self._machine.state(t if t < self._end else float(np.nextafter(self._end, -np.inf)), y)
        try:
            return self._machine.rate(state, self._machine.command(state) if self._hold is None else self._hold)
        except (IllPosedModelError, SingularPoseError, InputError) as error:
            # a controller may have no answer to the state of a trial step that is too long
            self.failure = error
            return np.full(len(y), np.nan)


def _integrate_stretch(
    problem: Problem, progress: Progress, stretch: Stretch, hold: Command | None, record: Record
) -> Progress:
    """Integrate over one stretch, and add its samples and events to the record."""
    settings, length = problem.settings, stretch.end - progress.t
    rate = _Rate(problem.machine, hold, stretch.end)
    solver = INTEGRATORS[settings.integrator](
        rate,
        progress.t,
        progress.y,
        stretch.end,
        rtol=settings.rtol,
        atol=settings.atol,
        max_step=settings.max_step,
        first_step=None if progress.next_step is None else min(progress.next_step, length),
    )
    progress = replace(progress, restarts=progress.restarts + 1)
    while solver.status == "running" and progress.status is None:
        progress = _step(problem, progress, solver, rate, hold, record)
    return replace(progress, next_step=solver.h_abs, evaluations=progress.evaluations + rate.evaluations)


def _step(
    problem: Problem, progress: Progress, solver: OdeSolver, rate: _Rate, hold: Command | None, record: Record
) -> Progress:
    machine, settings = problem.machine, problem.settings
    if progress.steps >= settings.max_steps:
        return progress.failed(f"{progress.steps} steps did not reach the end")
    before = solver.y, solver.f
    message = solver.step()
    if solver.status == "failed":
        _require_answers(rate)
        return progress.failed(f"no step is short enough: {rate.failure or message}")
    is_short = solver.step_size < SHORTEST and solver.status == "running"  # the last one may have to be
    short = progress.short + 1 if is_short else 0
    progress = replace(progress, t=solver.t, y=solver.y, steps=progress.steps + 1, short=short)
    if short >= _MOST_SHORT:
        _require_answers(rate)
        return progress.failed(f"the steps have shrunk to {solver.step_size:.2g} s: {_why(machine)}")
    rate.failure = None
    # events and samples come from the interpolant, which is that of the step before its end is projected
    step = Step(solver, before)
    events, values = find_events(problem.functions, progress.values, step)
    record.events.extend(events)
    stop = events[-1].t if events and events[-1].terminal else None
    _record(problem, step, solver.t if stop is None else stop, hold, record)
    if stop is not None:
        y, _, _ = machine.project(stop, step(stop))
        return replace(progress, t=stop, y=y, status=SimulationStatus.STOPPED_BY_EVENT)
    y, gap, left = machine.project(solver.t, solver.y)
    largest = max(progress.largest_correction, gap)
    progress = replace(progress, y=y, values=values, largest_correction=largest)
    if left > GAP_LIMIT:
        return progress.failed(f"the closures leave a gap of {left:.3g} m")
    # the integrator goes on from the projected state, with the rate there: its first stage
    solver.y = y
    if solver.status == "running":
        solver.f = rate(solver.t, y)
    return progress


def _require_answers(rate: _Rate) -> None:
    """Raise what the controller returned in place of efforts, if that is why no step is short enough."""
    if isinstance(rate.failure, InputError):
        raise rate.failure


def _why(machine: Machine) -> str:
    """Return what makes a motion blow up, as far as it shows."""
    inertia = machine.dynamics.least_inertia
    if inertia < _LITTLE_INERTIA:
        return (
            f"a free motion has hardly any inertia, {inertia:.2g} of the largest, so accelerations grow without "
            "bound. Give every part mass (such as end_effector_mass=0.1)"
        )
    return "something grows without bound. Check the efforts of the controller"


def _record(problem: Problem, step: Step, end: float, hold: Command | None, record: Record) -> None:
    """Record the grid times before ``end``; what happens at the end of a stretch belongs to the next."""
    grid, same = problem.grid, SAME * float(problem.grid[1] - problem.grid[0])
    while (t := float(grid[len(record.samples)])) < end - same:
        record.samples.append(_sample(problem.machine, t, step(t), hold))


def _sample(machine: Machine, t: float, y: Array, hold: Command | None) -> Sample:
    return Sample(t, machine.project(t, y)[0], hold)
