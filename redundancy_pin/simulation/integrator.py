"""Integration in time: scipy's solvers, a projection after every step, restarts where efforts jump.

``solve_ivp`` allows nothing between two steps. Here each step is projected onto the closures, at the level of positions
and of rates: constraints do not drift and need no stabilisation. Integration restarts where efforts jump: no
Runge-Kutta method keeps its order across a jump, and step control would spend dozens of steps on finding it. A digital
controller reads the state between steps only, in order of time.

All that changes is one value, ``SimulationProgress``. A step (``_step``) has four functions, in order: ``_advance``
integrates, ``_locate_events`` finds the events in it, ``_project`` closes its end, ``_record`` adds samples and events.
The second and third may return the progress at the start of the step: the step is then taken again.

Forward dynamics in machine code take the ordinary steps, those without events, by the same method and rules; they stop
before any other step, which is then taken here.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.integrate import OdeSolver
from scipy.optimize import brentq

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.simulation.events import Event, EventFunctions, Step, find_events, may_touch_zero
from redundancy_pin.simulation.problem import (
    SAME,
    InitialValueProblem,
    SimulationProgress,
    SmoothInterval,
    smooth_intervals,
)
from redundancy_pin.simulation.rank_loss import BEYOND, NEAR, WIDEST, Sheet, sheet_ahead
from redundancy_pin.simulation.steppers import EXPLICIT, VELOCITY_CHANGE, VELOCITY_FLOOR, OrdinarySteps, Rate, solver
from redundancy_pin.simulation.stops import first_release, past_stop
from redundancy_pin.simulation.system import Machine
from redundancy_pin.status import ResultStatus

_MOST_SHORT = 20
"""Number of successive steps shorter than the shortest ordinary one at which the integration fails."""

_LITTLE_INERTIA = 1e-3
"""Share of the largest inertia below which an inertia is the reported cause of a motion that blows up."""

_TOUCHED = 1e-4, 0.05
"""Ratio of singular values of J_c below which a step comes through a rank loss: absolute, and per rad of travel."""

_FARTHEST = 4.0 * np.pi
"""rad; a step that moves farther and may come to a rank loss is taken again, shorter."""

_STILL = 1e-12
"""rad; a step that moves less, as with all joints at stops, comes to no rank loss."""

_LEAST_TRAVEL = 0.01
"""rad; the integration fails at a nearer rank loss that no smooth branch passes."""

_REST = "rest"
"""Kind of the internal event of a motion that comes to rest at a rank loss."""

_AT_REST, _AT = 1e-10, 1e-8
"""Speed, per time scale, and ratio of singular values at which a motion may continue on either sheet."""


def integrate(problem: InitialValueProblem, progress: SimulationProgress) -> SimulationProgress:
    """Integrate from a closed state, at the first time of the grid, to the last time or to an event that ends it.

    A digital controller has given its first command there, ``progress.hold``.

    Raises:
        InputError: the controller returns something else than finite efforts.
    """
    began, commands = time.perf_counter(), [progress.hold]
    intervals = smooth_intervals(progress.t, float(problem.grid[-1]), problem.breaks, problem.sampling)
    kernel = progress.machine.kernel if problem.method in EXPLICIT else None
    ordinary = None if kernel is None else OrdinarySteps(kernel, problem, progress, intervals)
    progress = past_stop(problem, progress) or progress
    with np.errstate(all="ignore"):  # trial steps that overflow are given up for shorter ones
        for interval in intervals:
            if progress.t >= interval.end:
                continue  # machine code went on beyond it
            if interval.reads:
                machine = progress.machine
                commands.append(machine.amplifiers.command(machine.state(interval.start, progress.y)))
            if interval.acting is not None:
                progress = replace(progress, hold=commands[interval.acting])
            progress = _integrate_interval(problem, progress, interval, ordinary)
            while (resumed := _resumed(problem, progress)) is not None:
                progress = _integrate_interval(problem, resumed, interval, ordinary)
            if progress.status is not None:
                break
    progress.samples.append(progress.sample(progress.t, progress.y))
    return replace(progress, status=progress.status or ResultStatus.OK, seconds=time.perf_counter() - began)


def _resumed(problem: InitialValueProblem, progress: SimulationProgress) -> SimulationProgress | None:
    """Return the restart of a simulation that has ended: past a stop that pushes back, or with other closure rows.

    Other rows take over if those in use have failed and dependent rows restore the rank, once at one place.
    """
    if progress.status is ResultStatus.STOPPED:
        return past_stop(problem, progress)
    if progress.status is not ResultStatus.NOT_CONVERGED or progress.t <= progress.rows_renewed:
        return None
    functions, q = progress.functions, progress.y[: progress.functions.nq]
    machine = progress.machine.with_all_rows(q)
    if machine is None:
        return None
    renewed = replace(progress, sheet=None, near=NEAR, rows_renewed=progress.t)
    renewed = renewed.restarted(machine, np.flatnonzero(functions.touching(q)).tolist(), functions.held)
    return past_stop(problem, renewed) or renewed


def _integrate_interval(
    problem: InitialValueProblem,
    progress: SimulationProgress,
    interval: SmoothInterval,
    ordinary: OrdinarySteps | None,
) -> SimulationProgress:
    """Integrate over one interval."""
    if progress.machine.kernel is None:  # machine code holds no joints, and has the independent rows alone
        ordinary = None
    while progress.status is None and progress.t < interval.end:
        if ordinary is not None and progress.sheet is None:
            progress = ordinary.take(progress, interval)
            if progress.t >= interval.end:
                break
        stepper, rate = solver(problem, progress, interval)
        progress, retried = replace(progress, restarts=progress.restarts + 1), False
        while stepper.status == "running" and progress.status is None and not retried:
            result = _step(problem, progress, stepper, rate)
            progress, retried = result, result.t == progress.t
            problem.notify(progress)
            if ordinary is not None and progress.sheet is None:
                break  # the next one may be ordinary
        progress = replace(progress, evaluations=progress.evaluations + rate.evaluations)
    return progress


def _retry(
    problem: InitialValueProblem, progress: SimulationProgress, length: float, sheet: Sheet | None, reason: str
) -> SimulationProgress:
    """Return the start of a step that is taken again.

    Args:
        problem: the problem that is integrated.
        progress: the start of the step.
        length: largest length of the next try, s.
        sheet: solution branch for it, or None.
        reason: cause of the failure if it cannot be that short; empty if it cannot fail.
    """
    if sheet is not None and len(progress.machine.held):
        return progress.failed("its closures lose rank while a joint is held by its stop")
    if reason and length < problem.shortest:
        return progress.failed(reason)
    return replace(progress, sheet=sheet, next_step=length)


def _step(
    problem: InitialValueProblem, progress: SimulationProgress, stepper: OdeSolver, rate: Rate
) -> SimulationProgress:
    """Take one step: integrate, locate events in it, project its end onto the closures, record what happened."""
    before = stepper.y, stepper.f
    stepped = _advance(problem, progress, stepper, rate)
    if stepped.status is not None:
        return stepped
    # events and samples come from the interpolant of the step before its end is projected
    step = Step(stepper, before)
    located = _locate_events(problem, progress, step)
    if isinstance(located, SimulationProgress):
        return located
    projected = _project(problem, progress, stepped, step)
    if projected.t == progress.t:
        return projected
    _record(problem, progress, step, located)
    if located.end is not None:
        return _stopped(stepped, step, located.end)
    stepped = replace(projected, values=located.values, near=located.near)
    if stepped.status is not None:
        return stepped
    if stepped.sheet is not None and _leaves(stepped.sheet, *np.split(stepped.y, [stepped.functions.nq])):
        stepped, rate.sheet = replace(stepped, sheet=None), None
    # the integrator continues from the projected state, with the rate there: its first stage
    stepper.y = stepped.y
    if stepper.status == "running":
        stepper.f = rate(stepper.t, stepped.y)
    return stepped


def _advance(
    problem: InitialValueProblem, progress: SimulationProgress, stepper: OdeSolver, rate: Rate
) -> SimulationProgress:
    """Take a step of the integrator; the result has failed if no step is short enough or too many steps are short."""
    if progress.steps >= problem.max_steps:
        return progress.failed(f"{progress.steps} steps did not reach the end")
    message = stepper.step()
    failed, is_last = stepper.status == "failed", stepper.status == "finished"  # the last step may have to be short
    short = progress.short + 1 if not (failed or is_last) and stepper.step_size < problem.shortest else 0
    if isinstance(rate.failure, InputError) and (failed or short >= _MOST_SHORT):
        raise rate.failure  # what the controller returned in place of efforts
    if failed:
        why = f"no step is short enough: {rate.failure or message}"
        return progress.failed(why if progress.sheet is None else _at_pose(progress, progress.y, why))
    stepped = replace(
        progress, t=stepper.t, y=stepper.y, next_step=stepper.h_abs, steps=progress.steps + 1, short=short
    )
    if short >= _MOST_SHORT:
        return stepped.failed(f"the steps have shrunk to {stepper.step_size:.2g} s: {_why(progress)}")
    rate.failure = None
    return stepped


@dataclass(frozen=True, eq=False)
class Located:
    """Events in a step.

    Attributes:
        events: reported events, up to the one at which the step ends.
        values: (w,) the event functions at its end.
        near: ratio of singular values below which the next search for a rank loss begins.
        end: the last event if it ends the step early, or None.
    """

    events: list[Event]
    values: Array
    near: float
    end: Event | None


def _locate_events(
    problem: InitialValueProblem, progress: SimulationProgress, step: Step
) -> Located | SimulationProgress:
    """Return the events in a step from ``progress``: zeros of the event functions, rest, and release.

    If the step must be taken again: ``progress``, with the length and the sheet of the next try.
    """
    sheet, near = progress.sheet, progress.near
    events, values, ratios = find_events(progress.functions, progress.values, step, problem.time, sheet)
    if sheet is None and may_touch_zero(ratios, near):
        retry = retry_at_rank_loss(problem, progress, step)
        if retry is not None:
            return retry
        near = 0.5 * float(ratios.min())  # a search takes as long as some steps: the next one from nearer by
    near = near if ratios[-1] < NEAR else NEAR
    end, early = events[-1] if events and events[-1].terminal else None, None
    if sheet is not None:  # then no stop holds a joint
        early = _rest(progress.functions, step, sheet, problem.time)
    elif len(progress.machine.held):
        early = first_release(progress, step)
    if early is not None and (end is None or early.t < end.t):
        events, end = [*(event for event in events if event.t < early.t), early], early
    return Located(events, values, near, end)


def _project(
    problem: InitialValueProblem, progress: SimulationProgress, stepped: SimulationProgress, step: Step
) -> SimulationProgress:
    """Project the end of a step onto the closures.

    A velocity that jumps there is one of another branch: the step is taken again from ``progress``.
    """
    machine, nq = stepped.machine, stepped.functions.nq
    y, before, left = machine.project(stepped.t, stepped.y, stepped.sheet)
    v, unit = stepped.y[nq:], velocity_unit(machine.robot)
    jumps = np.abs(y[nq:] - v) / unit
    largest = max(float((np.abs(part) / unit).max(initial=0.0)) for part in (step.at(0.0)[nq:], v))
    if not float(jumps.max(initial=0.0)) <= VELOCITY_CHANGE * largest + VELOCITY_FLOOR / problem.time:
        i = int(jumps.argmax())
        why = (
            f"the velocity of {_joint_of(machine, i)} would jump from {v[i]:.3g} to {y[nq + i]:.3g}: the step leads "
            "to another branch of the motion"
        )
        return _retry(problem, progress, 0.25 * (step.end - step.start), progress.sheet, why)
    projected = replace(stepped, y=y, largest_correction=max(stepped.largest_correction, before))
    if left > machine.manifold.largest_residual:
        return projected.failed(f"the closures leave a gap of {left:.3g} m")
    return projected


def _record(problem: InitialValueProblem, progress: SimulationProgress, step: Step, located: Located) -> None:
    """Record events, and samples at the grid times in a step; its end belongs to the next step."""
    progress.events.extend(event for event in located.events if event.kind != _REST)
    samples, grid, end = progress.samples, problem.grid, step.end if located.end is None else located.end.t
    while (t := float(grid[len(samples)])) < end - SAME * float(grid[1] - grid[0]):
        samples.append(progress.sample(t, step(t)))


def _stopped(stepped: SimulationProgress, step: Step, end: Event) -> SimulationProgress:
    """Return the end of a step that an event ends early; rest at a rank loss is a failure, not an event."""
    y = stepped.machine.project(end.t, step(end.t), stepped.sheet)[0]
    stopped = replace(stepped, t=end.t, y=y, status=ResultStatus.STOPPED)
    if end.kind != _REST:
        return stopped
    why = "it rests where its closures lose rank, and its motion is undetermined"
    return stopped.failed(_at_pose(stopped, y, why))


def _leaves(sheet: Sheet, q: Array, v: Array) -> bool:
    """Return whether a state moves away from a rank loss and is far enough away to leave its sheet."""
    place = sheet.position(q)
    return abs(place) > BEYOND * sheet.passage.half and place * sheet.speed(v) > 0.0


def _rest(functions: EventFunctions, step: Step, sheet: Sheet, time: float) -> Event | None:
    """Return the event at which a motion comes to rest at a rank loss in a step, or None; ``time``: time scale, s."""

    def speed(fraction: float) -> float:
        return sheet.speed(step.at(fraction)[functions.nq :])

    turns = speed(0.0) * speed(1.0) < 0.0
    fraction = float(brentq(speed, 0.0, 1.0, xtol=1e-6)) if turns else 1.0
    lost = functions.rank(step.states([fraction]))[0] < _AT
    rests = lost and (turns or abs(speed(1.0)) * time < _AT_REST)
    return Event(_REST, "", step.time(fraction), terminal=True) if rests else None


def retry_at_rank_loss(
    problem: InitialValueProblem, progress: SimulationProgress, step: Step
) -> SimulationProgress | None:
    """Return the start of a step in which the closures lose rank, to take it on the sheet across, or shorter."""
    machine, functions, length = progress.machine, progress.functions, step.end - step.start
    robot, (q, v) = machine.robot, np.split(progress.y, [functions.nq])
    moved = pin.difference(robot.model, q, step.at(1.0)[: len(q)]) / velocity_unit(robot)
    moved[robot.carrier_velocity] = 0.0
    travel = float(np.linalg.norm(moved))
    if travel < _STILL:
        return None
    if travel > _FARTHEST:  # the way ahead is followed point by point
        turns = _at_pose(progress, q, "its closures may lose rank within a step of turns")
        return _retry(problem, progress, 0.5 * length, None, turns)
    ahead = sheet_ahead(machine.chain, q, v, 1.2 * travel + WIDEST)
    if isinstance(ahead, Sheet):
        length = min(length, 0.5 * ahead.passage.half / max(abs(ahead.speed(v)), 1e-300))
        return _retry(problem, progress, length, ahead, "")
    if ahead is None and functions.least_rank(step) > max(_TOUCHED[0], _TOUCHED[1] * travel):
        return None
    if ahead is None or ahead <= 1.1 * travel:
        lost = "its closures lose rank just ahead, or nearly so, and no smooth motion is known to lead across"
        length = 0.5 * length if travel > _LEAST_TRAVEL else 0.0
        return _retry(problem, progress, length, None, _at_pose(progress, q, lost))
    return None


def _at_pose(progress: SimulationProgress, y: Array, why: str) -> str:
    """Return a reason with the pose q, the first nq of y, and the singular values of the closures there."""
    q = y[: progress.functions.nq]
    pose, ratio = (np.round(q, 6) + 0.0).tolist(), float(progress.functions.rank(q[None])[0])
    return f"{why} (q = {pose}, ratio of singular values {ratio:.2g})"


def _why(before: SimulationProgress) -> str:
    """Return the likely cause of a motion that blows up in the step after ``before``."""
    machine = before.machine
    inertia = machine.least_inertia(before.t, before.y)
    if before.values[-1] < NEAR * NEAR:
        return _at_pose(before, before.y, "its closures have nearly lost rank")
    if inertia < _LITTLE_INERTIA:
        return (
            f"a free motion has hardly any inertia, {inertia:.2g} of the largest, so accelerations grow without "
            "bound. Give every part mass (such as end_effector_mass=0.1, on the command line by --set), and make plans "
            "and controllers anew for that robot"
        )
    state = machine.state(before.t, before.y)
    i = int(np.abs(state.v).argmax())
    effort = max(float(np.abs(part).max(initial=0.0)) for part in machine.command(state, before.hold))
    driven = f"under efforts of up to {effort:.3g}" if effort else "while no actuator gives any effort"
    check = "the efforts of the controller" if effort else "the external forces and the start"
    what = f"joint {_joint_of(machine, i)!r} runs away at {state.v[i]:.3g} rad/s or m/s {driven}"
    return f"{_at_pose(before, state.q, what)}: something grows without bound. Check {check}"


def _joint_of(machine: Machine, i: int) -> str:
    """Return the name of the joint that a tree velocity belongs to."""
    model = machine.robot.model
    return str([name for name, one in zip(model.names, model.joints, strict=True) if one.idx_v <= i][-1])
