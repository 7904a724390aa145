"""Replay of plans: simulate the machine with the plan, open loop and under control."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from math import nan
from typing import Literal, get_args

import numpy as np

from redundancy_pin.arrays import Array, frozen, one_of
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import IllPosedModelError, InfeasiblePlanError, SingularPoseError
from redundancy_pin.kinematics.coordinates import moved
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.reference import MotionReference, plan_reference
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.simulation.controllers.base import Controller, FeedForward, Sampling
from redundancy_pin.simulation.controllers.by_name import controller_by_name
from redundancy_pin.simulation.simulate import simulate
from redundancy_pin.simulation.state import State, closed_state
from redundancy_pin.simulation.summary import platform_error
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

Drive = Literal["open loop", "open loop, samples", "carriers by motion", "computed torque", "LQR"]

DRIVES: tuple[Drive, ...] = ("open loop", "open loop, samples", "computed torque", "LQR")

SAMPLING = Sampling(2e-3, 2e-3)
"""Of the controllers: 500 Hz, one sample of delay."""

AWAY, SPEED = 1e-3, 1e-2
"""Where controllers start: this far, m, and at this speed, m/s, from the planned start, along every coordinate together
(rotations over the characteristic length)."""

LQR_STEP = 0.01
"""Distance of the nodes of the LQR's linear model, s: twice its default, for half the time."""

MOST_STEPS = 1000
"""Steps in addition to those that samples and breaks ask for: towards a pose at which a massless machine has no
acceleration steps would shrink for ever."""

DT = 5e-3
"""Between the samples of an open-loop replay, s."""

RTOL, ATOL = 1e-10, 1e-12
"""Of the integrator open loop."""

CONTROLLED_RTOL, CONTROLLED_ATOL = 1e-7, 1e-9
"""Under control, where steps are as short as the sampling period anyway."""


@dataclass(frozen=True, eq=False)
class Replay:
    """One plan with one drive. Distances of rotations count times the characteristic length.

    Attributes:
        plan: name of the plan.
        drive: name of the controller.
        status: value of the simulation's ``ResultStatus``; "not_converged" also where forces do not determine the
            motion at the start (or no linear model exists), "unbounded" if the plan has no finite efforts.
        reason: why it is not "ok"; may be empty.
        t: (N,) times, s; empty where nothing was simulated.
        error: (N,) distance of the platform from the planned motion, m.
        largest, rms, last: of ``error``; NaN where nothing was simulated.
        carrier_error: largest distance of a carrier from the plan's motion, m.
        carrier_lag: largest distance of that motion from the plan's own samples, m: what backward differences leave.
        off_track: largest distance of a carrier beyond an end of its track, m; a machine would have hit its stop.
        effort: largest |τ|, N or N·m.
        carrier_force: largest |F|, N.
        gap: largest closure residual, m.
    """

    plan: str
    drive: str
    status: str
    reason: str
    t: Array = field(default_factory=lambda: frozen(()))
    error: Array = field(default_factory=lambda: frozen(()))
    largest: float = nan
    rms: float = nan
    last: float = nan
    carrier_error: float = nan
    carrier_lag: float = nan
    off_track: float = nan
    effort: float = nan
    carrier_force: float = nan
    gap: float = nan


def replay_table(
    plans: Mapping[str, Plan],
    motions: Mapping[str, TimedTrajectory] | None = None,
    *,
    drives: Sequence[Drive] = DRIVES,
    sampling: Sampling = SAMPLING,
) -> tuple[Replay, ...]:
    """Return ``replay`` of plans with each of several drives; ``motions`` by the names of the plans."""
    known = motions or {}
    return tuple(
        replay(plan, drive, name=name, motion=known.get(name), sampling=sampling)
        for name, plan in plans.items()
        for drive in drives
    )


def replay(
    plan: Plan,
    drive: Drive = "open loop",
    *,
    name: str = "",
    motion: TimedTrajectory | None = None,
    sampling: Sampling = SAMPLING,
    backend: Callable[[Robot], Dynamics | None] | None = None,
) -> Replay:
    """Replay a plan on its own robot.

    - "open loop": the efforts of the continuous motion of the plan, from its exact start.
    - "open loop, samples": the efforts at the samples of the plan, linear in between.
    - "carriers by motion": main efforts open loop, carriers follow their plan exactly.
    - "computed torque", "LQR": digital, from a start that is ``AWAY`` and ``SPEED`` off.

    Ends of tracks do not stop a replay, for plans may use the last micrometre of them; ``Replay.off_track`` is how
    far carriers went beyond.

    Args:
        plan: from any planner.
        drive: controller of the machine.
        name: of the plan, for the result.
        motion: the trajectory that was planned for.
        sampling: of the controllers.
        backend: makes the ``dynamics`` of ``simulate`` and of controllers for the plan's robot, ``as_dynamics`` to
            be fast.

    Raises:
        InputError: an unknown drive.
        PlanFileError: the plan's robot cannot be loaded.
    """
    one_of(drive, "drive", get_args(Drive))
    try:
        reference = plan_reference(plan, motion=motion)
        robot = reference.robot
        dynamics = backend and backend(robot)
        controller = _controller(plan, reference, drive, sampling, dynamics)
        duration, digital = reference.end - reference.start, controller.sampling
        run = simulate(
            robot,
            controller,
            start=None if digital is None else displaced(robot, reference),
            carriers="motion" if drive == "carriers by motion" else "force",
            sampling=digital,
            duration=duration,
            dt=DT if digital is None else digital.period,  # with every value that a digital controller puts out
            stop_at=(),
            max_steps=MOST_STEPS + 2 * max(len(plan.t), int(duration / sampling.period)),
            rtol=RTOL if digital is None else CONTROLLED_RTOL,
            atol=ATOL if digital is None else CONTROLLED_ATOL,
            integrator="DOP853" if digital is None else "RK45",
            dynamics=dynamics,
        )
    except (IllPosedModelError, SingularPoseError) as reason:
        return Replay(name, drive, ResultStatus.NOT_CONVERGED.value, str(reason))
    except InfeasiblePlanError as reason:
        return Replay(name, drive, ResultStatus.UNBOUNDED.value, str(reason))
    error = platform_error(run, reference, robot)
    return Replay(
        plan=name,
        drive=drive,
        status=run.status.value,
        reason=run.reason,
        t=run.t,
        error=error,
        largest=float(error.max()),
        rms=rms_over_time(run.t, error),
        last=float(error[-1]),
        carrier_error=float(np.abs(run.s - [reference.carriers(t)[0] for t in run.t.tolist()]).max(initial=0.0)),
        carrier_lag=float(reference.carrier_lag.max(initial=0.0)),
        off_track=distance_off_track(robot, run.s),
        effort=float(np.nanmax(np.abs(run.tau))),
        carrier_force=float(np.nanmax(np.abs(run.carrier_force), initial=0.0)),
        gap=float(run.gap.max()),
    )


def rms_over_time(t: Array, values: Array) -> float:
    """Return the root mean square over time of (N,) values at times (N,), s; the first value if there is one time."""
    span = float(t[-1] - t[0])
    return float(np.sqrt(np.trapezoid(values**2, t) / span)) if span > 0.0 else float(values[0])


def displaced(robot: Robot, reference: MotionReference) -> State:
    """Return a start ``AWAY`` and ``SPEED`` off the planned one."""
    point = reference.at(reference.start)
    along = 1.0 / row_scale(robot) / np.sqrt(robot.n)
    x = moved(robot, point.x[None], (AWAY * along)[None])[0]
    return closed_state(robot, x, point.xd + SPEED * along, point.s, point.sd, t=reference.start)


def _controller(
    plan: Plan, reference: MotionReference, drive: Drive, sampling: Sampling, dynamics: Dynamics | None
) -> Controller:
    if drive in ("open loop", "carriers by motion"):
        return FeedForward(reference)
    if drive == "open loop, samples":
        return _sample_efforts(plan, reference)
    settings = {"step": LQR_STEP} if drive == "LQR" else {}
    return controller_by_name(drive, reference, sampling=sampling, dynamics=dynamics, **settings)


def _sample_efforts(plan: Plan, reference: MotionReference) -> FeedForward:
    """Return the efforts of the samples, linear in between; where a sample occurs twice they jump."""
    efforts = np.concatenate([plan.tau, plan.carrier_force], axis=1)
    bad = ~np.isfinite(efforts).all(axis=1)
    if bad.any():
        t = float(plan.t[int(bad.argmax())])
        raise InfeasiblePlanError(
            f"The plan states no finite efforts at its sample at t = {t:.6g} s.",
            remedy="Replay the continuous motion of the plan: drive 'open loop'.",
            constraint="effort",
            time=t,
        )
    sampled = copy(reference)
    sampled.efforts = PiecewisePolynomial.linear(plan.t, efforts)
    sampled.jumps = sampled.efforts.jumps()
    controller = FeedForward(sampled)
    controller.breaks = np.unique(plan.t)[1:-1]
    return controller


def distance_off_track(robot: Robot, s: Array) -> float:
    """Return how far, m, carriers (N, k) go beyond an end of their tracks at most."""
    lower, upper = np.array([(limits.lower, limits.upper) for limits in robot.carrier_limits]).reshape(-1, 2).T
    return float(np.maximum(s - upper, lower - s).max(initial=0.0))
