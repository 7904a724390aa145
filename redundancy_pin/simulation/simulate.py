"""``simulate``: from a robot and its controller to a simulated motion."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, frozen, one_of, positive, read_only, require_type, whole
from redundancy_pin.dynamics.default import DynamicsLike
from redundancy_pin.errors import IllPosedModelError, InputError, SingularPoseError
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import angle_columns, coordinates
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.reference import plan_reference
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import force_terms, position_unit, velocity_unit
from redundancy_pin.simulation.controllers.base import (
    Amplifiers,
    CarrierDrive,
    CarrierLaw,
    Constant,
    Controller,
    EffortLaw,
    FeedForward,
    Sampling,
    as_controller,
    kernel_of,
    load_limits,
)
from redundancy_pin.simulation.events import KINDS, ONE_SIDED, EventFunctions
from redundancy_pin.simulation.integrator import integrate
from redundancy_pin.simulation.limits import broken_limits
from redundancy_pin.simulation.problem import InitialValueProblem, SimulationProgress
from redundancy_pin.simulation.rank_loss import NEAR, WIDEST, Sheet, sheet_ahead
from redundancy_pin.simulation.result import Simulation, Statistics
from redundancy_pin.simulation.state import State
from redundancy_pin.simulation.steppers import INTEGRATORS
from redundancy_pin.simulation.system import External, Machine
from redundancy_pin.status import ResultStatus

RTOL = 1e-11
"""Default relative tolerance of a step. Energy then drifts by some 1e-10 of itself in ten seconds."""

ATOL = 1e-12
"""Default absolute tolerance of a step, characteristic lengths or rad, for velocities per time scale."""

LEAST_RTOL = 2.5e-14
"""Below this scipy's step control sees rounding only."""

START_RESIDUAL = 1e-6
"""Closure residual, rad or characteristic lengths, of a start state, and in a time scale at the speed at which its
closures part. The start is projected."""


def simulate(
    robot: RobotLike,
    drive: Plan | Controller | EffortLaw | None = None,
    *,
    start: State | None = None,
    duration: float | None = None,
    dt: float = 5e-3,
    carriers: CarrierDrive = "force",
    sampling: Sampling | None = None,
    effort_limit: ArrayLike | None = None,
    carrier_force_limit: ArrayLike | None = None,
    external: External | None = None,
    stop_at: Sequence[str] = ("track", "joint_limit"),
    joint_stops: Literal["end", "inelastic"] = "end",
    rtol: float = RTOL,
    atol: float = ATOL,
    max_step: float = np.inf,
    max_steps: int = 200_000,
    integrator: Literal["DOP853", "RK45", "Radau"] = "DOP853",
    restart_at: Literal["breaks", "jumps"] = "breaks",
    dynamics: DynamicsLike | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Simulation:
    """Simulate a closed-chain robot under given efforts.

    Accelerations come from the equations of motion in independent coordinates chosen by the rank of the closures
    (``forward``), so type II poses need no special treatment. The integrated state is the tree's state; after every
    step it is projected onto the closures, at the level of positions and of velocities.

    Args:
        robot: the robot, or its name or path; it may differ from the one of a plan or controller.
        drive: a plan, whose efforts are fed forward (``FeedForward``); a ``Controller``, or any object with its
            ``effort``; or nothing: no efforts.
        start: state to start from, closed to within 1e-6 characteristic lengths; when left out, the start of the plan
            or controller, or the reference configuration at rest.
        duration: s; to the end of the plan or controller when left out.
        dt: interval between the samples of the result, s; the integrator chooses its own steps.
        carriers: whether forces drive the carriers, or they follow the motion of the plan or controller exactly and the
            result has the forces that takes.
        sampling: makes the controller a digital one; it is evaluated at every instant when left out.
        effort_limit: scalar or (m,) largest |τ| that the amplifiers give, N or N·m.
        carrier_force_limit: the same for the carriers, N.
        external: further generalised forces (nv,) as a function of the state: friction, disturbances.
        stop_at: kinds of events (``events.KINDS``) that end the simulation; all kinds are reported.
        joint_stops: effect of joint limits and track ends: "end", by ``stop_at``; or "inelastic", they push
            back: a joint that comes to one stays there until it is drawn off (``stops``), whatever ``stop_at`` is.
            Carriers that are driven by motion have none.
        rtol: relative tolerance of each step of the integrator.
        atol: its absolute tolerance, characteristic lengths or rad; for velocities over the shorter one of the duration
            and the time in which gravity or the start velocity moves the robot by its own length.
        max_step: longest step, s.
        max_steps: number of steps after which the simulation fails.
        integrator: explicit Runge-Kutta method of scipy: of order 8, or of order 5; or the implicit "Radau" of order 5,
            for machines with stiff springs or dampers, whose steps are not bound by them.
        restart_at: where integration restarts: at all breaks of the controller, where its efforts jump or kink, so
            that the integrator keeps its order; or at the jumps only, so that steps may be longer than in a plan,
            which pays if tolerances are loose. At tight ones the step control shortens many steps at the kinks.
        dynamics: this robot again, or its name or path, for generated code (``as_dynamics``); or a backend of it.
            Generated code then takes the ordinary steps of explicit integrators: many times as fast, the same to the
            tolerances. Backends without forward dynamics make no difference.
        progress: called with the time that is reached and the last one, s, after steps of the integrator.

    Returns:
        A ``Simulation``. Its status reports problems: an event at which it stopped; a failure with its reason, the
        samples before it kept; or, at the end, limits of the robot that it exceeded.

    Raises:
        InputError: a setting out of its domain, a start that is not closed or beyond a stop, a controller that returns
            something else than finite efforts at any time or was made for another sampling or drive of the carriers, no
            duration.
        IllPosedModelError: at the start, forces do not determine the acceleration: a free motion has no inertia.
        SingularPoseError: at the start, the closures have lost rank.
        UnsupportedRobotError: see ``FeedForward``.

    Example:
        >>> run = rp.simulate("four_bar", duration=0.1)
        >>> run.status.value, bool(run.gap.max() < 1e-12)
        ('ok', True)
    """
    robot = as_robot(robot)
    # before anything slow: the reference of a plan, generated code
    one_of(integrator, "integrator", INTEGRATORS)
    one_of(carriers, "carriers", get_args(CarrierDrive))
    one_of(joint_stops, "joint_stops", ("end", "inelastic"))
    one_of(restart_at, "restart_at", ("breaks", "jumps"))
    unknown = [kind for kind in stop_at if kind not in KINDS]
    if unknown:
        raise InputError(f"stop_at names {unknown[0]!r}.", remedy=f"Known kinds: {', '.join(KINDS)}.")
    positive(dt, "dt", "s")
    if sampling is not None:
        require_type(sampling, Sampling, "A Sampling", "Pass sampling=Sampling(period, delay), both in seconds.")
    if duration is not None:
        duration = positive(duration, "duration", "s")
    max_step = np.inf if max_step is np.inf else positive(max_step, "max_step", "s")
    max_steps = whole(max_steps, "max_steps", 1, sys.maxsize)
    rtol, atol = positive(rtol, "rtol", ""), positive(atol, "atol", "")
    if rtol < LEAST_RTOL:
        raise InputError(f"rtol is {rtol}.", remedy=f"Pass at least {LEAST_RTOL}: below it is rounding.", name="rtol")
    if carriers == "motion" and robot.k and carrier_force_limit is not None:
        raise InputError(
            "carrier_force_limit cannot hold for carriers that are driven by motion.",
            remedy='Leave it out, or pass carriers="force".',
        )
    limits = load_limits(robot, effort_limit, carrier_force_limit)
    controller = _controller(robot, drive, sampling)
    state = _start(robot, controller, start)
    grid, breaks = _times(controller, state.t, duration, dt, restart_at)
    law = _carrier_law(robot, controller, carriers)
    machine = Machine(robot, Amplifiers(controller, *limits), law, external, kernel_of(robot, dynamics))
    first = machine.state(state.t, np.concatenate([state.q, state.v]))
    machine.chain.place(first.q)
    if machine.chain.dependent_rows_restore_rank():
        machine = machine.with_all_rows(first.q) or machine
    push_back = () if joint_stops == "end" else ONE_SIDED if law is None else ONE_SIDED[1:]
    functions = EventFunctions(machine.chain, tuple(stop_at), first.q, push_back)
    time = _time_scale(robot, first.v, float(grid[-1] - grid[0]))
    _require_closed(machine, first, time)  # before it is projected, which would close any start
    ratio = functions(first.q[None])[0, functions.kinds.index("closure_rank")]
    sheet = _sheet_at_start(machine, first, float(ratio), time)
    y, _, _ = machine.project(first.t, np.concatenate([first.q, first.v]), sheet)
    values = functions.at_start(y[: robot.model.nq])
    command = machine.amplifiers.command(first)
    # an ill-posed start is an error, a pose that becomes ill-posed on the way a failure with samples before it
    if sheet is None:
        machine.dynamics.adapt(first.q)
    machine.solve(first, command, sheet)
    unit = np.concatenate([position_unit(robot), velocity_unit(robot) / time])
    problem = InitialValueProblem(
        method=integrator,
        settings={"max_step": float(max_step), "rtol": rtol, "atol": atol * unit},
        time=time,
        unit=unit,
        max_steps=int(max_steps),
        grid=grid,
        breaks=breaks,
        sampling=sampling,
        report=progress,
    )
    hold = None if sampling is None else command
    begin = SimulationProgress(first.t, y, values, NEAR, machine=machine, functions=functions, hold=hold, sheet=sheet)
    reached = integrate(problem, begin)
    parameters = {
        "drive": drive.planner if isinstance(drive, Plan) else controller.class_name(),
        "carriers": carriers,
        "sampling": None if sampling is None else (sampling.period, sampling.delay),
        "effort_limit": limits[0].tolist(),
        "carrier_force_limit": limits[1].tolist(),
        "external": external is not None,
        "stop_at": tuple(stop_at),
        "joint_stops": joint_stops,
        "rtol": rtol,
        "atol": atol,
        "max_step": max_step,
        "integrator": integrator,
        "restart_at": restart_at,
        "dt": dt,
        "motion_end": None if controller.end is None else float(controller.end),
    }
    return _simulation(machine, reached, parameters)


def _controller(robot: Robot, drive: Plan | Controller | EffortLaw | None, sampling: Sampling | None) -> Controller:
    if drive is None:
        return Constant(np.zeros(robot.m), np.zeros(robot.k))
    if isinstance(drive, Plan):
        # the efforts of a plan are those of the machine it was made for: another machine is driven by them all the
        # same, so that what an imperfect model costs can be simulated
        own = robot if drive.robot.describes(robot) else None
        return FeedForward(plan_reference(drive, robot=own))
    controller = as_controller(drive)
    made_for = controller.sampling
    if isinstance(made_for, Sampling) and made_for != sampling:
        raise InputError(
            f"{controller.class_name()} was made for {made_for}, and the simulation has {sampling}.",
            remedy=f"Pass sampling={made_for} to simulate, or make the controller for the sampling of the simulation.",
        )
    return controller


def _start(robot: Robot, controller: Controller, start: State | None) -> State:
    state = controller.start_state(robot) if start is None else start
    require_type(state, State, "A state to start from", "Make it with closed_state(robot, ...).")
    if state.q.shape != (robot.model.nq,) or state.v.shape != (robot.model.nv,):
        raise InputError(
            f"The start has q of shape {state.q.shape} and v of shape {state.v.shape}; {robot.name} has nq = "
            f"{robot.model.nq} and nv = {robot.model.nv}.",
            remedy="Make it with closed_state(robot, ...).",
        )
    return state


def _times(
    controller: Controller, start: float, duration: float | None, dt: float, restart_at: str
) -> tuple[Array, Array]:
    """Return the times to record and the times at which the integration restarts."""
    if duration is not None:
        last = start + duration
    elif controller.end is not None:
        last = float(controller.end)
    else:
        raise InputError("Nothing says how long to simulate.", remedy="Pass duration=, in seconds.")
    if not (np.isfinite(last) and last > start):
        raise InputError(
            f"The simulation would last from {start} to {last} s.", remedy="Pass a positive, finite duration."
        )
    steps = int(np.ceil((last - start) / dt - 1e-9))
    given = controller.breaks if restart_at == "breaks" or controller.jumps is None else controller.jumps
    breaks = np.unique(np.asarray(given, dtype=float))
    return np.append(start + dt * np.arange(steps), last), breaks[(breaks > start) & (breaks < last)]


def _carrier_law(robot: Robot, controller: Controller, carriers: str) -> CarrierLaw | None:
    if robot.k == 0:
        return None
    made_for = controller.carrier_drive
    if made_for in ("force", "motion") and made_for != carriers:
        raise InputError(
            f"{controller.class_name()} drives carriers by {made_for}, and this simulation does by {carriers}: "
            "its hold on them would be lost.",
            remedy=f'Pass carriers="{made_for}", or feed the efforts of the plan forward with FeedForward.',
        )
    return None if carriers == "force" else controller.carrier_motion


def _time_scale(robot: Robot, v: Array, duration: float) -> float:
    """Return the time scale, s, of a simulation that starts with a velocity (nv,)."""
    return min(duration, force_terms(robot).time(float(np.abs(v / velocity_unit(robot)).max())))


def _require_closed(machine: Machine, state: State, time: float) -> None:
    chain = machine.chain
    chain.update(state.q, state.v)
    length, columns = machine.robot.characteristic_length, chain.pose_columns
    parting = chain.closure_rows() @ (state.v[columns] / chain.system.step_unit)
    gap, rate = chain.largest_residual(), length * float(np.abs(parting).max(initial=0.0))
    if gap > START_RESIDUAL * length or rate > START_RESIDUAL * length / time:
        raise InputError(
            f"The start is not closed: a gap of {gap:.3g} m, opening at {rate:.3g} m/s.",
            remedy="Make it with closed_state(robot, x, xd, s, sd).",
            residual=gap,
            rate=rate,
        )


def _sheet_at_start(machine: Machine, start: State, ratio: float, time: float) -> Sheet | None:
    """Return what a motion is on that starts near a rank loss of its closures, by their ratio of singular values."""
    if not ratio < NEAR:
        return None
    sheet = sheet_ahead(machine.chain, start.q, start.v, WIDEST)
    motion = sheet.at(start.q, start.v) if isinstance(sheet, Sheet) else None
    unit = velocity_unit(machine.robot)
    away = 0.0 if motion is None else float(np.abs((motion.v - start.v) / unit).max())
    if away > START_RESIDUAL * max(1.0 / time, float(np.abs(start.v / unit).max())):
        raise SingularPoseError(
            f"The start is where the closures of {machine.robot.name} lose rank, and its velocity, though allowed, "
            f"is {away:.3g} 1/s from that of the nearest smooth motion through there.",
            remedy="Start with a velocity along one of the motions that meet there, or near that pose.",
            amount=away,
        )
    return sheet if isinstance(sheet, Sheet) else None


def _simulation(machine: Machine, end: SimulationProgress, parameters: dict[str, object]) -> Simulation:
    """Evaluate forces, accelerations and energies at the samples and put everything together."""
    robot, model, samples = machine.robot, machine.robot.model, end.samples
    status, system = end.status or ResultStatus.OK, constraint_system(robot)
    count, t = len(samples), frozen([sample.t for sample in samples])
    q, v = np.split(np.array([sample.y for sample in samples]), [model.nq], axis=1)
    a, energy = np.full((count, model.nv), np.nan), np.empty(count)
    tau, carrier_force = np.full((count, robot.m), np.nan), np.full((count, robot.k), np.nan)
    closure_force, stop_force = np.full((count, machine.chain.rows), np.nan), np.full((count, model.nv), np.nan)
    for i, sample in enumerate(samples):
        here = sample.machine
        state = here.state(sample.t, sample.y)
        energy[i] = here.energy(state)
        try:
            command = here.command(state, sample.hold)
            loads = here.solve(state, command, sample.sheet)
        except (IllPosedModelError, SingularPoseError):
            continue  # a failed simulation ends there: the efforts have no accelerations
        except InputError:
            if status is not ResultStatus.NOT_CONVERGED:
                raise
            continue  # what blows up may leave a controller without an answer
        tau[i], carrier_force[i] = command[0], loads.carrier_force
        a[i], closure_force[i], stop_force[i] = loads.a, loads.closure_force, loads.stop_force
        if here.chain.basis is not None:  # of the same effect, in the rows of the robot
            own = system.evaluate(state.q[None]).Jc[0]
            here.chain.update(state.q, state.v)
            effort = here.chain.jacobian().T @ loads.closure_force
            closure_force[i] = np.linalg.lstsq(own.T, effort, rcond=None)[0]
    columns = robot.carrier_velocity
    carriers = CarrierMotion(q[:, robot.carrier_position], v[:, columns], a[:, columns], check_rates=False)
    rates = v[:, robot.actuated_velocity]
    violated = broken_limits(robot, t, q, carriers, tau, carrier_force, rates)
    if violated and status is ResultStatus.OK:
        status = ResultStatus.LIMIT_VIOLATED
    evaluated, every = system.evaluate(q), system.every
    x, xd = coordinates(robot, evaluated), np.einsum("nij,nj->ni", evaluated.Jx, v)
    return Simulation(
        t=t,
        q=frozen(q),
        v=frozen(v),
        a=read_only(a),
        x=read_only(_unwrapped(robot, t, x, xd)),
        xd=read_only(xd),
        s=carriers.s,
        sd=carriers.sd,
        sdd=carriers.sdd,
        tau=read_only(tau),
        carrier_force=read_only(carrier_force),
        actuated_rate=frozen(rates),
        closure_force=read_only(closure_force),
        stop_force=read_only(stop_force),
        gap=frozen(every.largest_residual(every.evaluate(q).phi)),
        energy=read_only(energy),
        events=tuple(end.events),
        violated=violated,
        status=status,
        reason=end.reason,
        statistics=Statistics(**{field.name: getattr(end, field.name) for field in fields(Statistics)}),
        robot=robot_record(robot),
        parameters=parameters,
    )


def _unwrapped(robot: Robot, t: Array, x: Array, xd: Array) -> Array:
    """Let angles of the platform and of continuous joints run on past π.

    Turns are counted by how far the rates carry the angles from sample to sample: those may be many turns apart.
    """
    if x.ndim == 3:
        return x
    x, angles = x.copy(), angle_columns(robot)
    carried = np.zeros_like(x)
    carried[1:] = np.cumsum(0.5 * (xd[1:] + xd[:-1]) * np.diff(t)[:, None], axis=0)
    turns = np.round((carried + np.unwrap(x - carried, axis=0) - x) / (2.0 * np.pi))
    x[:, angles] += 2.0 * np.pi * turns[:, angles]
    return x
