"""Joint stops that push back: unilateral, inelastic, without friction.

A stop allows a joint to move inward and pushes, never pulls. Where joints reach stops their velocities jump to the
nearest ones that the stops allow, v⁺ = v⁻ + N δ, and at rest there accelerations are the nearest allowed ones to those
without stops (Gauss's principle of least constraint):

    min δᵀ (Nᵀ M N) δ   subject to   g + G δ ≥ 0,   G = −side N_i,

g the inward velocities, or accelerations, of the stopped joints without the stops. The multipliers μ ≥ 0 are the
impulses, or the forces, of the stops (J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics,
1988). With g = G γ, the motion γ to the nearest rest, they solve a non-negative least-squares problem (scipy's
``nnls``). Stops that push keep their joints fixed (``Machine.held``) until they would have to pull.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import brentq, nnls

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import IllPosedModelError, SingularPoseError
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.simulation.events import RELEASE, Event, Step
from redundancy_pin.simulation.problem import InitialValueProblem, SimulationProgress
from redundancy_pin.simulation.rank_loss import NEAR
from redundancy_pin.status import ResultStatus

_ROUNDING = 1e-12
"""Rates that count as zero: characteristic lengths or rad over the time scale, accelerations over its square."""

_NO_PUSH = 1e-9
"""Force of a stop, relative to the largest, that counts as zero: while one redundant stop takes over from another, both
forces are zero to machine precision."""

_MOST_SWITCHES = 50
"""Number of changes of the stops that push, at one time, at which the integration fails."""

_RELEASE_LOOKS = (0.25, 0.5, 0.75, 1.0)
"""Fractions of a step at which the forces of stops are evaluated."""


def _resolve_contact(
    progress: SimulationProgress, time: float, stops: IntArray, released: int | None
) -> tuple[Array, Array, IntArray]:
    """Return the effect of stops on the state of a simulation.

    Args:
        progress: the simulation, before an impact.
        time: time scale, s, for tolerances.
        stops: (l,) stops that joints are at, by their places among the event functions.
        released: a stop that has just let go.

    Returns:
        (nq + nv,) the state after the impact; (l,) impulses, zero without an impact; (h,) those stops that push.

    Raises:
        IllPosedModelError, SingularPoseError: as ``Machine.rate``.
    """
    free, functions = progress.machine.free, progress.functions
    columns, side = functions.columns[stops], functions.side[stops]
    q, v = progress.y[: functions.nq], progress.y[functions.nq :].copy()
    basis, inertia = free.dynamics.reduced_inertia(q, v)
    moves = -side[:, None] * basis[columns]
    nothing = _ROUNDING * velocity_unit(free.robot)[columns] / time
    step, impulse = least_constraint(inertia, moves, _rounded(-side * v[columns], nothing))
    v += basis @ step
    v[columns[impulse > 0.0]] = 0.0
    state = free.state(progress.t, np.concatenate([q, v]))
    a = free.rate(state, free.command(state, progress.hold))[-len(v) :]
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
    return np.concatenate([q, v]), impulse, stops[pushed]


def _rounded(rate: Array, nothing: Array) -> Array:
    """Return rates (l,) with zeros in place of rounding."""
    return np.where(np.abs(rate) <= nothing, 0.0, rate)


def least_constraint(inertia: Array, moves: Array, rate: Array) -> tuple[Array, Array]:
    """Return δ (d,) and μ (l,): the least δ, by the inertia (d, d), with rate + moves δ ≥ 0, and its multipliers.

    Args:
        inertia: (d, d) of the free motions.
        moves: (l, d) inward rates of the stopped joints that go with them.
        rate: (l,) their inward rates. They belong to a motion, so that rest keeps all stops; squares of small speeds in
            the accelerations of redundant stops are ignored.
    """
    if not len(rate) or (rate >= 0.0).all():
        return np.zeros(len(inertia)), np.zeros(len(rate))
    lower = np.linalg.cholesky(inertia)
    responses = solve_triangular(lower, moves.T, lower=True)
    length = np.linalg.norm(responses, axis=0)
    length[length == 0.0] = 1.0
    responses /= length
    motion = np.linalg.lstsq(responses.T, rate / length, rcond=None)[0]
    scaled, _ = nnls(responses, -motion)
    return solve_triangular(lower, responses @ scaled, lower=True, trans=1), scaled / length


def past_stop(problem: InitialValueProblem, progress: SimulationProgress) -> SimulationProgress | None:
    """Return the restart at a stop that pushes back or lets go, or from a start at one; None elsewhere."""
    functions, events = progress.functions, progress.events
    last = events[-1] if progress.status is ResultStatus.STOPPED else None
    if not functions.push_back or (last is not None and last.kind not in (*functions.push_back, RELEASE)):
        return None
    met = functions.names.index(last.name) if last is not None and last.name else None
    released = met if last is not None and last.kind == RELEASE else None
    # the stop just met and those that held are among them, although an integration step was off
    at = functions.touching(progress.y[: functions.nq]) & functions.pushes[: len(functions.slack)]
    at[[*functions.held, *(() if met is None else (met,))]] = True
    if not at.any():
        return None
    switches = progress.switches + 1 if progress.t <= progress.switched + problem.shortest else 1
    if switches > _MOST_SWITCHES:
        return progress.failed("joints meet their stops and leave them again, without end")
    stops = np.flatnonzero(at)
    try:
        y, impulse, held = _resolve_contact(progress, problem.time, stops, released)
    except (IllPosedModelError, SingularPoseError) as error:
        return progress.failed(str(error))
    hit = stops[impulse > 0.0]
    if last is not None:
        events.pop()
        if last.kind != RELEASE and met not in hit:
            events.append(replace(last, terminal=False))
    here = partial(Event, t=progress.t, terminal=False)
    impacts = zip(hit, impulse[impulse > 0.0].tolist(), strict=True)
    events.extend(here(functions.kinds[i], functions.names[i], impulse=size) for i, size in impacts)
    events.extend(here(RELEASE, functions.names[i]) for i in functions.held if i not in held)
    machine = progress.machine.holding(functions.columns[held], y[: functions.nq])
    going_on = replace(progress, y=y, switches=switches, switched=progress.t)
    if len(held):  # the motion that the closures leave is another one
        going_on = replace(going_on, sheet=None, near=NEAR)
    return going_on.restarted(machine, stops.tolist(), held.tolist())


def first_release(progress: SimulationProgress, step: Step) -> Event | None:
    """Return the event at which a stop would first have to pull the joint that it holds in a step, or None.

    It names the stop whose force changes sign in the step, and none if a force pulls from the start.
    """
    machine, functions = progress.machine, progress.functions
    side = functions.side[functions.held]

    def push(fraction: float) -> Array:
        """Return (h,) the inward forces of the stops that hold joints, N or N·m; negative if they would pull."""
        state = machine.state(step.time(fraction), step.at(fraction))
        inward: Array = -side * machine.solve(state, machine.command(state, progress.hold)).stop_force[machine.held]
        return inward

    left, before = 0.0, push(0.0)
    for right in _RELEASE_LOOKS:
        after = push(right)
        pulls = np.flatnonzero(after < 0.0)
        if len(pulls):
            roots = [
                float(brentq(lambda x, i=i: push(x)[i], left, right, xtol=1e-12)) if before[i] > 0.0 else left
                for i in pulls
            ]
            first = int(np.argmin(roots))
            # where efforts have jumped, which of them lets go is not known from their signs alone
            name = functions.names[functions.held[pulls[first]]] if before[pulls[first]] > 0.0 else ""
            return Event(RELEASE, name, step.time(roots[first]), terminal=False)
        left, before = right, after
    return None
