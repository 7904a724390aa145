"""Integration in time: a library's integrator, a projection after every step, restarts where efforts jump.

Three things are done between the steps of scipy's solvers, which ``solve_ivp`` would not let us do. Each step is
projected onto the closures, at the level of positions and of rates, so constraints do not drift and need no
stabilisation. Integration starts anew where efforts jump, for no Runge-Kutta method keeps its order across a jump, and
step control would spend dozens of steps on finding it. And a digital controller is read between steps only, in order of
time.

What changes along the way is one value, ``SimulationProgress``: each step returns the next one.

Where the machine has forward dynamics in machine code, that takes the ordinary steps, in which nothing happens, by the
same method and rules; it stops before any other one, which is then taken here.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.integrate import DOP853, RK45, OdeSolver, Radau
from scipy.optimize import brentq

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.dynamics.forward import ForwardKernel, Integration, Progress, Rules
from redundancy_pin.errors import IllPosedModelError, InputError, RedundancyPinError, SingularPoseError
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.simulation.controllers.base import Command, Sampling
from redundancy_pin.simulation.events import (
    BETWEEN,
    BRIEF,
    RELEASE,
    Event,
    EventFunctions,
    Step,
    find_events,
    may_touch_zero,
)
from redundancy_pin.simulation.rank_loss import BEYOND, NEAR, WIDEST, Sheet, sheet_ahead
from redundancy_pin.simulation.stops import pushing, resolve_contact
from redundancy_pin.simulation.system import Machine
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

INTEGRATORS = {"DOP853": DOP853, "RK45": RK45, "Radau": Radau}
"""Runge-Kutta methods of scipy: explicit ones of order 8 and 5, the latter cheaper where a sampled controller makes
every step short; and the implicit Radau IIA of order 5 for stiff springs and dampers."""

EXPLICIT = ("DOP853", "RK45")
"""Those that machine code has."""

SAME = 1e-9
"""Instants closer than this fraction of a sampling period, or of the interval of the result's samples, are one."""

SHORTEST = 1e-8
"""Shortest ordinary step, share of the time scale: after many shorter ones in a row the integration is given up."""

_MOST_SHORT = 20

_MOST_SWITCHES = 50
"""Changes of what stops hold at one time, after which the integration is given up."""

_RELEASE_LOOKS = (0.25, 0.5, 0.75, 1.0)
"""Where in a step the forces of stops are looked at."""

_DIFFERENCE = 1e-7
"""Step of the differences for the Jacobian of an implicit integrator, share of a number or of its unit."""

_LITTLE_INERTIA = 1e-3
"""Share of the largest inertia below which an inertia is blamed for a motion that blows up."""

LARGEST_RESIDUAL = 1e-9
"""Closure residual, rad or characteristic lengths, that the projection must not leave."""

_JUMP, _STIR = 0.05, 1e-3
"""The projection may change a velocity by this share of the largest, and this much, characteristic lengths or rad in a
time scale. It takes away what a step has gained in error; a change beyond that leads to another branch."""

_TOUCHED = 1e-4, 0.05
"""Ratio of singular values of J_c below which a step has come through a rank loss, as far as it is resolved: at least,
and for each rad that it moves."""

_FARTHEST = 4.0 * np.pi
"""rad; a step that moves farther and may come to a rank loss is taken again, shorter."""

_STILL = 1e-12
"""rad; a step that moves less, as where stops hold all there is, comes to no rank loss."""

_LEAST_TRAVEL = 0.01
"""rad; a rank loss that is nearer, and cannot be carried across, is given up."""

_AT_REST, _AT = 1e-10, 1e-8
"""Speed, per time scale, and ratio of singular values at which a motion may go on on either sheet."""


@dataclass(frozen=True)
class SmoothInterval:
    """A time, s, over which the efforts are smooth.

    ``reads``: whether a digital controller reads the state at its start; ``acting``: number of the reading whose answer
    acts meanwhile, None where the controller answers at every instant.
    """

    start: float
    end: float
    reads: bool = False
    acting: int | None = None


def stretches(start: float, end: float, breaks: Array, sampling: Sampling | None) -> list[SmoothInterval]:
    """Return the stretches from a start to an end, s, with ``breaks`` between them.

    The reading at the start is taken before, and none is taken at the end.
    """
    if sampling is None:
        return [SmoothInterval(left, right) for left, right in pairwise([start, *breaks.tolist(), end])]
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
        result.append(SmoothInterval(left, right, new, max(min(int(act), taken) - 1, 0)))
    return result


@dataclass(frozen=True, eq=False)
class InitialValueProblem:
    """What is integrated, and how.

    Attributes:
        machine: the differential equation, with the joints that stops hold.
        free: the same without stops.
        held: (h,) stops that hold joints, by their places among the functions.
        functions: whose zeros are events.
        method: its name in ``INTEGRATORS``.
        settings: rtol, atol (nq + nv,) and max_step.
        time: s; the time scale of the motion: the shorter one of its duration and the time of ``robot.scales``.
        unit: (nq + nv,) the characteristic length or 1 rad for q, and over the time scale for v.
        max_steps: number of steps after which it is given up.
        grid: (G,) times at which to record, s, first and last included.
        breaks: inner times at which efforts jump, s.
        sampling: of a digital controller, or None.
    """

    machine: Machine
    free: Machine
    held: IntArray
    functions: EventFunctions
    method: str
    settings: Mapping[str, Any]
    time: float
    unit: Array
    max_steps: int
    grid: Array
    breaks: Array
    sampling: Sampling | None

    @property
    def shortest(self) -> float:
        """The shortest ordinary step, s."""
        return SHORTEST * self.time

    @property
    def largest_residual(self) -> float:
        """The closure residual, m, that the projection must not leave."""
        return LARGEST_RESIDUAL * self.machine.robot.characteristic_length


@dataclass(frozen=True, eq=False)
class SimulationProgress(Progress):
    """How far a simulation is.

    Attributes:
        sheet: what it is on where the closures lose rank, see ``rank_loss``.
        short: how many steps in a row were shorter than the shortest ordinary one.
        switches: how often in a row stops have begun or ended to push, at ``switched``, s.
        seconds: see ``Statistics``.
        status: None while it goes on.
        reason: why it failed.
    """

    sheet: Sheet | None = None
    short: int = 0
    switches: int = 0
    switched: float = -np.inf
    seconds: float = 0.0
    status: ResultStatus | None = None
    reason: str = ""

    def failed(self, why: str) -> SimulationProgress:
        """Return that it ends here."""
        return replace(self, status=ResultStatus.NOT_CONVERGED, reason=f"At t = {self.t:.9g} s {why.rstrip('.')}.")


@dataclass(frozen=True, eq=False)
class SimulatedSample:
    """A closed state y (nq + nv,) at time t, s, and the command that is held there (None: the controller's answer).

    ``machine``: what has moved it, with the closure rows that it used; None is that of the start.
    """

    t: float
    y: Array
    hold: Command | None
    sheet: Sheet | None
    machine: Machine | None = None


@dataclass(eq=False)
class SimulationRecord:
    """Samples and events in order of time, as they come in."""

    samples: list[SimulatedSample] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)


def integrate(
    problem: InitialValueProblem, y: Array, values: Array, first: Command, sheet: Sheet | None
) -> tuple[SimulationRecord, SimulationProgress]:
    """Integrate from a closed state y at the first time of the grid, where a controller gave its first command.

    Raises:
        InputError: the controller returns something else than finite efforts.
    """
    began, machine, grid = time.perf_counter(), problem.machine, problem.grid
    record, commands, hold = SimulationRecord(), [first], None
    progress = SimulationProgress(float(grid[0]), y, values, NEAR, sheet=sheet)
    parts = stretches(float(grid[0]), float(grid[-1]), problem.breaks, problem.sampling)
    kernel = machine.kernel if problem.method in EXPLICIT else None
    ordinary = None if kernel is None else OrdinarySteps(kernel, problem, parts)
    changed = -np.inf
    held_first = None if problem.sampling is None else first
    problem, progress = _past_stop(problem, progress, held_first, record, at_start=True) or (problem, progress)
    with np.errstate(all="ignore"):  # trial steps that overflow are given up for shorter ones
        for stretch in parts:
            if progress.t >= stretch.end:
                continue  # machine code went on beyond it
            if stretch.reads:
                commands.append(machine.amplifiers.command(machine.state(stretch.start, progress.y)))
            hold = None if stretch.acting is None else commands[stretch.acting]
            progress = _integrate_stretch(problem, progress, stretch, hold, record, ordinary)
            while progress.status is not None:
                going_on = _past_stop(problem, progress, hold, record)
                if going_on is None:
                    going_on = _with_all_rows(problem, progress, changed)
                    if going_on is None:
                        break
                    changed, ordinary = progress.t, None
                    going_on = _past_stop(*going_on, hold, record, at_start=True) or going_on
                problem, progress = going_on
                progress = _integrate_stretch(problem, progress, stretch, hold, record, ordinary)
            if progress.status is not None:
                break
    record.samples.append(_sample(problem.machine, progress.t, progress.y, hold, progress.sheet))
    status = progress.status or ResultStatus.OK
    return record, replace(progress, status=status, seconds=time.perf_counter() - began)


def _with_all_rows(
    problem: InitialValueProblem, progress: SimulationProgress, changed: float
) -> tuple[InitialValueProblem, SimulationProgress] | None:
    """Return how to go on where the closure rows in use have failed and dependent rows restore the rank.

    ``changed``: when that was done last, s; it is not done twice at one place.
    """
    if progress.status is not ResultStatus.NOT_CONVERGED or progress.t <= changed:
        return None
    q = progress.y[: problem.functions.nq]
    machine = problem.machine.with_all_rows(q)
    if machine is None:
        return None
    old = problem.functions
    functions = EventFunctions(machine.chain, old.stop_at, q, old.push_back, np.flatnonzero(old.touching(q)).tolist())
    going_on = replace(progress, status=None, reason="", sheet=None, near=NEAR, next_step=None, short=0)
    going_on = replace(going_on, values=functions.at_start(q))
    return replace(problem, machine=machine, free=machine, functions=functions), going_on


def _past_stop(
    problem: InitialValueProblem,
    progress: SimulationProgress,
    hold: Command | None,
    record: SimulationRecord,
    *,
    at_start: bool = False,
) -> tuple[InitialValueProblem, SimulationProgress] | None:
    """Return how to go on at a stop that pushes back, or lets go; None elsewhere."""
    functions, last = problem.functions, record.events[-1:]
    stopped = bool(last) and progress.status is ResultStatus.STOPPED and last[0].kind in (*functions.push_back, RELEASE)
    if not functions.push_back or not (stopped or at_start):
        return None
    met = functions.names.index(last[0].name) if stopped and last[0].name else None
    released = met if stopped and last[0].kind == RELEASE else None
    is_release = stopped and last[0].kind == RELEASE
    reached = [*problem.held.tolist(), *(() if met is None else (met,))]
    switches = progress.switches + 1 if progress.t <= progress.switched + problem.shortest else 1
    if switches > _MOST_SWITCHES:
        return problem, progress.failed("joints meet their stops and leave them again, without end")
    try:
        contact = resolve_contact(
            problem.free, functions, progress.t, progress.y, hold, problem.time, reached, released
        )
    except (IllPosedModelError, SingularPoseError) as error:
        return problem, progress.failed(str(error))
    if contact is None:
        return None
    if stopped:
        record.events.pop()
    hit = {event.name for event in contact.events}
    if stopped and not is_release and last[0].name not in hit:
        record.events.append(replace(last[0], terminal=False))
    record.events.extend(contact.events)
    let_go = [functions.names[i] for i in problem.held.tolist() if i not in contact.held]
    record.events.extend(Event(RELEASE, name, progress.t, terminal=False) for name in let_go)
    q = contact.y[: functions.nq]
    machine, at, held = contact.machine, contact.at.tolist(), contact.held.tolist()
    functions = EventFunctions(machine.chain, functions.stop_at, q, functions.push_back, at, held)
    going_on = replace(progress, y=contact.y, values=functions.at_start(q), status=None, reason="", next_step=None)
    going_on = replace(going_on, short=0, switches=switches, switched=progress.t)
    if held:  # the motion that the closures leave is another one
        going_on = replace(going_on, sheet=None, near=NEAR)
    return replace(problem, machine=machine, functions=functions, held=contact.held), going_on


class _Rate:
    """ẏ over one stretch, as scipy's solvers call it; ``failure`` says why a call of this step had no answer."""

    def __init__(self, problem: InitialValueProblem, hold: Command | None, end: float, sheet: Sheet | None) -> None:
        self._machine, self._unit = problem.machine, problem.unit
        self._hold, self._end, self.sheet = hold, end, sheet
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
            command = self._machine.amplifiers.command(state) if self._hold is None else self._hold
            return self._machine.rate(state, command, self.sheet)
        except (IllPosedModelError, SingularPoseError, InputError) as error:
            # a controller may have no answer to the state of a trial step that is too long
            self.failure = error
            return np.full(len(y), np.nan)

    def jacobian(self, t: float, y: Array) -> Array:
        """Return ∂ẏ/∂y by differences; scipy's own step grows without bound where nothing depends on a coordinate."""
        here, steps = self(t, y), _DIFFERENCE * np.maximum(self._unit, np.abs(y))
        columns = [(self(t, y + step * e) - here) / step for step, e in zip(steps, np.eye(len(y)), strict=True)]
        J: Array = np.nan_to_num(np.stack(columns, axis=1))  # no answer: Newton fails, and the step is shortened
        return J


class OrdinarySteps:
    """The steps that machine code takes.

    Args:
        kernel: machine code of the machine.
        problem: what is integrated.
        parts: its stretches.
    """

    def __init__(self, kernel: ForwardKernel, problem: InitialValueProblem, parts: list[SmoothInterval]) -> None:
        machine, grid, sampling = problem.machine, problem.grid, problem.sampling
        self._problem, self._sampled = problem, sampling is not None
        amplifiers = machine.amplifiers
        self._by_time = machine.heeds_time_only and (self._sampled or amplifiers.open_loop is not None)
        nothing = PiecewisePolynomial.constant(np.zeros(len(amplifiers.limits)), grid[0], grid[-1])
        self._hold: Command | None = None
        rules = Rules(
            method=problem.method,
            **problem.settings,
            grid=grid,
            time_tolerance=SAME * float(grid[1] - grid[0]),
            breaks=np.array([part.end for part in parts]),
            efforts=(amplifiers.open_loop or nothing) if self._by_time else None,
            loads=None if self._by_time else self._loads,
            prescribed=machine.prescribed,
            limits=amplifiers.limits,
            stops=problem.functions.stops,
            time=problem.time,
            brief=BRIEF,
            check_travel=BETWEEN,
            near_rank=NEAR,
            shortest=problem.shortest,
            tolerance=machine.manifold.tolerance,
            largest_residual=problem.largest_residual,
            velocity_change=_JUMP,
            velocity_floor=_STIR,
        )
        self._code: Integration = kernel.integration(rules)

    def _loads(self, t: float, q: Array, v: Array) -> tuple[Array, tuple[Array, Array, Array] | None]:
        return self._problem.machine.forces_at(t, q, v, self._hold)

    def take(
        self, progress: SimulationProgress, stretch: SmoothInterval, hold: Command | None, record: SimulationRecord
    ) -> SimulationProgress:
        """Take the ordinary steps ahead, to the end of the stretch, or where nothing is held to the end of all."""
        problem, grid = self._problem, self._problem.grid
        self._hold = hold
        if hold is not None and self._by_time:
            self._code.hold(np.concatenate(hold))
        end = stretch.end if self._sampled else float(grid[-1])
        if progress.next_step is None:  # scipy's first one
            rate = _Rate(problem, hold, stretch.end, None)
            first = float(_solver(problem, progress, stretch, rate).h_abs)
            progress = replace(progress, next_step=first, evaluations=progress.evaluations + rate.evaluations)
        before, stopped = progress.steps, False
        while not stopped and progress.t < end and progress.steps < problem.max_steps:
            # in portions, so that it can be interrupted
            portion, recorded = min(_PORTION, problem.max_steps - progress.steps), len(record.samples)
            progress, states, stopped = self._code.advance(progress, recorded, end, portion)
            times = grid[recorded : recorded + len(states)].tolist()
            record.samples.extend(SimulatedSample(t, y, hold, None) for t, y in zip(times, states, strict=True))
        return replace(progress, short=0) if progress.steps > before else progress


_PORTION = 1000
"""Steps of machine code between two looks of Python at its signals."""


def _integrate_stretch(
    problem: InitialValueProblem,
    progress: SimulationProgress,
    stretch: SmoothInterval,
    hold: Command | None,
    record: SimulationRecord,
    ordinary: OrdinarySteps | None,
) -> SimulationProgress:
    """Integrate over one stretch, and add its samples and events to the record."""
    while progress.status is None and progress.t < stretch.end:
        ordinary = None if len(problem.machine.held) else ordinary
        if ordinary is not None and progress.sheet is None:
            progress = ordinary.take(progress, stretch, hold, record)
            if progress.t >= stretch.end:
                break
        rate = _Rate(problem, hold, stretch.end, progress.sheet)
        solver = _solver(problem, progress, stretch, rate)
        progress = replace(progress, restarts=progress.restarts + 1)
        again = None
        while solver.status == "running" and progress.status is None and again is None:
            try:
                progress = _step(problem, progress, solver, rate, hold, record)
            except RetryStep as retry:  # from where it began, on a sheet or with a shorter step
                again = retry
            if ordinary is not None and progress.sheet is None:
                break  # the next one may be ordinary
        progress = replace(progress, next_step=solver.h_abs, evaluations=progress.evaluations + rate.evaluations)
        if again is not None and again.sheet is not None and len(problem.machine.held):
            progress = progress.failed("its closures lose rank while a joint is held by its stop")
        elif again is not None:
            progress = replace(progress, sheet=again.sheet, next_step=again.length)
            if again.reason and again.length < problem.shortest:
                progress = progress.failed(again.reason)
    return progress


def _solver(
    problem: InitialValueProblem, progress: SimulationProgress, stretch: SmoothInterval, rate: _Rate
) -> OdeSolver:
    """Return scipy's solver over the rest of a stretch; it selects the first step where none is suggested."""
    step = None if progress.next_step is None else min(progress.next_step, stretch.end - progress.t)
    implicit = {} if problem.method in EXPLICIT else {"jac": rate.jacobian}
    return INTEGRATORS[problem.method](
        rate, progress.t, progress.y, stretch.end, first_step=step, **implicit, **problem.settings
    )


def _step(
    problem: InitialValueProblem,
    progress: SimulationProgress,
    solver: OdeSolver,
    rate: _Rate,
    hold: Command | None,
    record: SimulationRecord,
) -> SimulationProgress:
    machine = problem.machine
    if progress.steps >= problem.max_steps:
        return progress.failed(f"{progress.steps} steps did not reach the end")
    before, earlier = (solver.y, solver.f), progress
    message = solver.step()
    if solver.status == "failed":
        _require_answers(rate)
        why = f"no step is short enough: {rate.failure or message}"
        q = progress.y[: problem.functions.nq]
        return progress.failed(why if rate.sheet is None else _at_pose(problem.functions, q, why))
    is_short = solver.step_size < problem.shortest and solver.status == "running"  # the last one may have to be
    short = progress.short + 1 if is_short else 0
    progress = replace(progress, t=solver.t, y=solver.y, steps=progress.steps + 1, short=short)
    if short >= _MOST_SHORT:
        _require_answers(rate)
        return progress.failed(f"the steps have shrunk to {solver.step_size:.2g} s: {_why(problem, earlier, hold)}")
    rate.failure = None
    # events and samples come from the interpolant, which is that of the step before its end is projected
    step = Step(solver, before)
    events, values, ratios = find_events(problem.functions, progress.values, step, problem.time, rate.sheet)
    near = progress.near
    if rate.sheet is None and may_touch_zero(ratios, near):
        require_no_rank_loss(problem, earlier, step)
        near = 0.5 * float(ratios.min())  # a look ahead takes as long as some steps: the next one from nearer by
    stop = events[-1].t if events and events[-1].terminal else None
    rest = None if rate.sheet is None else _rest(problem, step, rate.sheet)
    if rest is not None and (stop is None or rest < stop):
        events, stop = [event for event in events if event.t < rest], rest
    if len(machine.held):
        release = _release(problem, step, hold)
        if release is not None and (stop is None or release.t < stop):
            events, stop = [*(event for event in events if event.t < release.t), release], release.t
    y, gap, left = machine.project(solver.t, solver.y, rate.sheet)
    _require_continuous(problem, solver, before, y, rate.sheet)
    record.events.extend(events)
    _record(problem, step, solver.t if stop is None else stop, hold, record, rate.sheet)
    if stop is not None:
        y, _, _ = machine.project(stop, step(stop), rate.sheet)
        progress = replace(progress, t=stop, y=y, status=ResultStatus.STOPPED)
        if stop != rest:
            return progress
        why = "it rests where its closures lose rank, and its motion is undetermined"
        return progress.failed(_at_pose(problem.functions, y[: problem.functions.nq], why))
    largest = max(progress.largest_correction, gap)
    progress = replace(progress, y=y, values=values, largest_correction=largest)
    progress = replace(progress, near=near if ratios[-1] < NEAR else NEAR)
    if left > problem.largest_residual:
        return progress.failed(f"the closures leave a gap of {left:.3g} m")
    if rate.sheet is not None:
        q, v = np.split(y, [machine.robot.model.nq])
        place, speed = rate.sheet.position(q), rate.sheet.speed(v)
        if abs(place) > BEYOND * rate.sheet.half and place * speed > 0.0:
            progress, rate.sheet = replace(progress, sheet=None), None
    # the integrator goes on from the projected state, with the rate there: its first stage
    solver.y = y
    if solver.status == "running":
        solver.f = rate(solver.t, y)
    return progress


def _rest(problem: InitialValueProblem, step: Step, sheet: Sheet) -> float | None:
    """Return the time in a step at which a motion comes to rest at a rank loss, if it does."""
    functions = problem.functions

    def speed(fraction: float) -> float:
        return sheet.speed(step.at(fraction)[functions.nq :])

    turns = speed(0.0) * speed(1.0) < 0.0
    fraction = float(brentq(speed, 0.0, 1.0, xtol=1e-6)) if turns else 1.0
    lost = functions(step.at(fraction)[None, : functions.nq])[0, -1] < _AT
    return step.time(fraction) if lost and (turns or abs(speed(1.0)) * problem.time < _AT_REST) else None


def _release(problem: InitialValueProblem, step: Step, hold: Command | None) -> Event | None:
    """Return the event at which a stop would first have to pull the joint that it holds in a step, if it does.

    It names the stop where that comes to it in the step, not where it pulls from the start.
    """
    machine, functions = problem.machine, problem.functions
    side = functions.stops[2, problem.held]

    def push(fraction: float) -> Array:
        return pushing(machine, step.time(fraction), step.at(fraction), hold, side)

    left, before = 0.0, push(0.0)
    for right in _RELEASE_LOOKS:
        after = push(right)
        if (after < 0.0).any():
            roots = [
                float(brentq(lambda x, i=i: push(x)[i], left, right, xtol=1e-12)) if before[i] > 0.0 else left
                for i in np.flatnonzero(after < 0.0)
            ]
            first = int(np.argmin(roots))
            i = int(np.flatnonzero(after < 0.0)[first])
            # where efforts have jumped, which of them lets go is not known from their signs alone
            name = functions.names[problem.held[i]] if before[i] > 0.0 else ""
            return Event(RELEASE, name, step.time(roots[first]), terminal=False)
        left, before = right, after
    return None


class RetryStep(Exception):  # noqa: N818 - it tells the integration to go back, and is no failure
    """A step is to be taken again from its start, at most some length long, s, on a sheet or on none.

    ``reason`` is why it failed, if it cannot be shorter; empty where it will not.
    """

    def __init__(self, length: float, sheet: Sheet | None, reason: str) -> None:
        super().__init__(reason)
        self.length, self.sheet, self.reason = length, sheet, reason


def require_no_rank_loss(problem: InitialValueProblem, earlier: SimulationProgress, step: Step) -> None:
    """Raise RetryStep where the closures lose rank in a step, with the sheet that leads across if it is near enough."""
    machine, functions, length = problem.machine, problem.functions, step.end - step.start
    q, v = np.split(earlier.y, [machine.robot.model.nq])
    moved = pin.difference(machine.robot.model, q, step.at(1.0)[: len(q)]) / velocity_unit(machine.robot)
    moved[machine.robot.carrier_velocity] = 0.0
    travel = float(np.linalg.norm(moved))
    if travel < _STILL:
        return
    if travel > _FARTHEST:  # the way ahead is followed point by point
        raise RetryStep(0.5 * length, None, _at_pose(functions, q, "its closures may lose rank within a step of turns"))
    ahead = sheet_ahead(machine.chain, q, v, 1.2 * travel + WIDEST)
    if isinstance(ahead, Sheet):
        raise RetryStep(min(length, 0.5 * ahead.half / max(abs(ahead.speed(v)), 1e-300)), ahead, "")
    if ahead is None and functions.least_rank(step) > max(_TOUCHED[0], _TOUCHED[1] * travel):
        return
    if ahead is None or ahead <= 1.1 * travel:
        lost = "its closures lose rank just ahead, or nearly so, and no smooth motion is known to lead across"
        raise RetryStep(0.5 * length if travel > _LEAST_TRAVEL else 0.0, None, _at_pose(functions, q, lost))


def _require_continuous(
    problem: InitialValueProblem, solver: OdeSolver, before: tuple[Array, Array], y: Array, sheet: Sheet | None
) -> None:
    """Raise RetryStep where the projection changes a velocity by more than the error of a step."""
    machine = problem.machine
    nq, unit = machine.robot.model.nq, velocity_unit(machine.robot)
    v, projected = solver.y[nq:], y[nq:]
    jumps = np.abs(projected - v) / unit
    largest = max(float((np.abs(part) / unit).max(initial=0.0)) for part in (before[0][nq:], v))
    if not float(jumps.max(initial=0.0)) <= _JUMP * largest + _STIR / problem.time:
        i = int(jumps.argmax())
        raise RetryStep(
            0.25 * solver.step_size,
            sheet,
            f"the velocity of {_joint_of(machine, i)} would jump from {v[i]:.3g} to {projected[i]:.3g}: the step leads "
            "to another branch of the motion",
        )


def _at_pose(functions: EventFunctions, q: Array, why: str) -> str:
    """Return a reason with the pose and the singular values of the closures there."""
    pose, ratio = (np.round(q, 6) + 0.0).tolist(), float(functions(q[None])[0, -1])
    return f"{why} (q = {pose}, ratio of singular values {ratio:.2g})"


def _require_answers(rate: _Rate) -> None:
    """Raise what the controller returned in place of efforts, if that is why no step is short enough."""
    if isinstance(rate.failure, InputError):
        raise rate.failure


def _why(problem: InitialValueProblem, earlier: SimulationProgress, hold: Command | None) -> str:
    """Return what makes a motion blow up, as far as it shows."""
    machine, functions = problem.machine, problem.functions
    inertia = machine.least_inertia(earlier.t, earlier.y)
    if earlier.values[-1] < NEAR * NEAR:
        return _at_pose(functions, earlier.y[: functions.nq], "its closures have nearly lost rank")
    if inertia < _LITTLE_INERTIA:
        return (
            f"a free motion has hardly any inertia, {inertia:.2g} of the largest, so accelerations grow without "
            "bound. Give every part mass (such as end_effector_mass=0.1), and make plans and controllers anew for that "
            "robot"
        )
    state = machine.state(earlier.t, earlier.y)
    i = int(np.abs(state.v).argmax())
    command = machine.amplifiers.command(state) if hold is None else hold
    effort = max(float(np.abs(part).max(initial=0.0)) for part in command)
    driven = f"under efforts of up to {effort:.3g}" if effort else "while no actuator gives any effort"
    check = "the efforts of the controller" if effort else "the external forces and the start"
    what = f"joint {_joint_of(machine, i)!r} runs away at {state.v[i]:.3g} rad/s or m/s {driven}"
    return f"{_at_pose(functions, state.q, what)}: something grows without bound. Check {check}"


def _joint_of(machine: Machine, i: int) -> str:
    """Return the name of the joint that a tree velocity belongs to."""
    model = machine.robot.model
    return str([name for name, one in zip(model.names, model.joints, strict=True) if one.idx_v <= i][-1])


def _record(
    problem: InitialValueProblem,
    step: Step,
    end: float,
    hold: Command | None,
    record: SimulationRecord,
    sheet: Sheet | None,
) -> None:
    """Record the grid times before ``end``; what happens at the end of a stretch belongs to the next."""
    grid, same = problem.grid, SAME * float(problem.grid[1] - problem.grid[0])
    while (t := float(grid[len(record.samples)])) < end - same:
        record.samples.append(_sample(problem.machine, t, step(t), hold, sheet))


def _sample(machine: Machine, t: float, y: Array, hold: Command | None, sheet: Sheet | None) -> SimulatedSample:
    return SimulatedSample(t, machine.project(t, y, sheet)[0], hold, sheet, machine)
