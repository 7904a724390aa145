"""Joint stops that push back: unilateral, inelastic, without friction.

A stop allows a joint to move inward and pushes, never pulls. Where joints reach stops their velocities jump to the
nearest ones that the stops allow, v⁺ = v⁻ + N δ, and at rest there accelerations are the nearest allowed ones to those
without stops (Gauss's principle of least constraint):

    min δᵀ (Nᵀ M N) δ   subject to   g + G δ ≥ 0,   G = −side N_i,

g the inward velocities, or accelerations, of the stopped joints without the stops. The multipliers μ ≥ 0 are the
impulses, or the forces, of the stops (J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics,
1988). It is Lawson and Hanson's problem of least distance, which scipy's ``nnls`` solves. Stops that push hold their
joints (``Machine.held``) until they would have to pull.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, nnls

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import IllPosedModelError, SingularPoseError
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.simulation.controllers.base import Command
from redundancy_pin.simulation.events import RELEASE, Event, EventFunctions, Step
from redundancy_pin.simulation.problem import InitialValueProblem, SimulationProgress, SimulationRecord
from redundancy_pin.simulation.rank_loss import NEAR
from redundancy_pin.simulation.system import Machine
from redundancy_pin.status import ResultStatus

_ROUNDING = 1e-12
"""Rates that are none: characteristic lengths or rad over the time scale, accelerations over its square."""

_NO_PUSH = 1e-9
"""Force of a stop, relative to the largest, that is none: where one redundant stop takes over from another, both are
zero but for rounding."""

_CONSISTENT = 1e-6
"""Contradiction between rates of stopped joints, relative to the largest, that is none."""

_MOST_SWITCHES = 50
"""Changes of what stops hold at one time, after which the integration is given up."""

_RELEASE_LOOKS = (0.25, 0.5, 0.75, 1.0)
"""Where in a step the forces of stops are looked at."""


@dataclass(frozen=True, eq=False)
class Contact:
    """What the stops make of a state.

    Attributes:
        y: (nq + nv,) the state after the impact.
        machine: the machine with the joints held that stops push.
        at: (l,) stops that joints are at, by their places among the event functions.
        held: (h,) those of them that push.
        events: an impact each, with its impulse.
    """

    y: Array
    machine: Machine
    at: IntArray
    held: IntArray
    events: tuple[Event, ...]


def resolve_contact(
    free: Machine,
    functions: EventFunctions,
    t: float,
    y: Array,
    hold: Command | None,
    time: float,
    reached: Sequence[int] = (),
    released: int | None = None,
) -> Contact | None:
    """Return what the stops make of a closed state; None where no joint is at one.

    Args:
        free: the machine without stops.
        functions: the event functions of the machine at this configuration.
        t: time, s.
        y: (nq + nv,) the state, from before an impact.
        hold: command that is held; None where the controller answers at this instant.
        time: time scale, s, for what is rounding.
        reached: stops that joints are at all the same, though an integration step was off: one that was just met, and
            those that have held.
        released: a stop that has just let go.

    Raises:
        IllPosedModelError, SingularPoseError: as ``Machine.rate``.
    """
    nq = functions.nq
    at = functions.touching(y[:nq]) & functions.pushes[: functions.stops.shape[1]]
    at[list(reached)] = True
    if not at.any():
        return None
    stops = np.flatnonzero(at)
    columns, side = functions.stops[1, stops].astype(np.intp), functions.stops[2, stops]
    q, v = y[:nq], y[nq:].copy()
    basis, inertia = free.dynamics.reduced_inertia(q, v)
    moves = -side[:, None] * basis[columns]
    nothing = _ROUNDING * velocity_unit(free.robot)[columns] / time
    step, impulse = least_constraint(inertia, moves, _rounded(-side * v[columns], nothing))
    hit = impulse > 0.0
    v += basis @ step
    v[columns[hit]] = 0.0
    y = np.concatenate([q, v])
    events = tuple(
        Event(functions.kinds[i], functions.names[i], t, terminal=False, impulse=float(size))
        for i, size in zip(stops[hit], impulse[hit], strict=True)
    )
    state = free.state(t, y)
    command = free.amplifiers.command(state) if hold is None else hold
    a = free.rate(state, command)[-len(v) :]
    # a bar that rocks from stop to stop meets them infinitely often in finite time: what comes back from within the
    # slack is at rest
    outward = np.maximum(side * a[columns], 0.0)
    rests = -side * v[columns] <= np.sqrt(2.0 * outward * functions.slack[stops])
    rests &= stops != (-1 if released is None else released)
    _, force = least_constraint(inertia, moves[rests], _rounded(-side * a[columns], nothing / time)[rests])
    pushed = np.flatnonzero(rests)[force > _NO_PUSH * force.max(initial=0.0)]
    held, own = columns[pushed], moves[pushed]
    if len(held):
        response = np.linalg.solve(inertia, own.T)
        v -= basis @ (response @ np.linalg.solve(own @ response, -side[pushed] * v[held]))
        v[held] = 0.0
    return Contact(np.concatenate([q, v]), free.holding(held, q), stops, stops[pushed], events)


def _rounded(rate: Array, nothing: Array) -> Array:
    """Return rates (l,) with zeros in place of rounding."""
    return np.where(np.abs(rate) <= nothing, 0.0, rate)


def least_constraint(inertia: Array, moves: Array, rate: Array) -> tuple[Array, Array]:
    """Return δ (d,) and μ (l,): the least δ, by the inertia (d, d), with rate + moves δ ≥ 0, and its multipliers.

    Args:
        inertia: (d, d) of the free motions.
        moves: (l, d) inward rates of the stopped joints that go with them.
        rate: (l,) their inward rates as they are.

    Raises:
        SingularPoseError: no motion keeps all of the stops.
    """
    if not len(rate) or (rate >= 0.0).all():
        return np.zeros(len(inertia)), np.zeros(len(rate))
    lower = np.linalg.cholesky(inertia)
    responses = solve_triangular(lower, moves.T, lower=True)
    length = np.linalg.norm(responses, axis=0)
    length[length == 0.0] = 1.0
    wanted = -rate / length
    size = np.abs(wanted).max()
    responses /= length
    motion = np.linalg.lstsq(responses.T, -wanted, rcond=None)[0]
    if np.abs(responses.T @ motion + wanted).max() <= _CONSISTENT * size:
        # the rates are of a motion, which rest stops: of redundant stops but for squares of speeds that count as rest
        scaled, _ = nnls(responses, -motion)
        return solve_triangular(lower, responses @ scaled, lower=True, trans=1), scaled / length
    weights, _ = nnls(np.vstack([responses, wanted / size]), np.append(np.zeros(len(inertia)), 1.0))
    slack = 1.0 - float(wanted @ weights) / size
    if not slack > np.finfo(float).eps:
        raise SingularPoseError(
            "Joints are driven into their stops: no motion keeps all of them.",
            remedy="Limit what is driven by motion, or drive it by forces.",
        )
    scaled = weights * (size / slack)
    return solve_triangular(lower, responses @ scaled, lower=True, trans=1), scaled / length


def past_stop(
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


def first_release(problem: InitialValueProblem, step: Step, hold: Command | None) -> Event | None:
    """Return the event at which a stop would first have to pull the joint that it holds in a step, if it does.

    It names the stop where that comes to it in the step, not where it pulls from the start.
    """
    machine, functions = problem.machine, problem.functions
    side = functions.stops[2, problem.held]

    def push(fraction: float) -> Array:
        return _pushing(machine, step.time(fraction), step.at(fraction), hold, side)

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


def _pushing(machine: Machine, t: float, y: Array, hold: Command | None, side: Array) -> Array:
    """Return (h,) the forces with which stops push held joints inward, N or N·m; negative where they would pull."""
    state = machine.state(t, y)
    command = machine.amplifiers.command(state) if hold is None else hold
    inward: Array = -side * machine.solve(state, command).stop_force[machine.held]
    return inward
