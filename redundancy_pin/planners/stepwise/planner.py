"""Least effort one time step at a time (Parsa 2014, chapter 4), and the report of such a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, IntArray, runs
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.base_wrench import BASE, base_wrench, load_at_rest
from redundancy_pin.planners.carrier_model import (
    EffortModel,
    effort_model,
    is_dynamics,
    require_carriers,
    target_effort,
)
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import PlannedMotion
from redundancy_pin.planners.limits import Limits, grouped, require_motion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.course import (
    OPTIMISE,
    PHASES,
    RETURN,
    Active,
    Course,
    StepwiseSettings,
    Stop,
    brake,
    checked_settings,
    run_course,
    track_size,
)
from redundancy_pin.planners.stepwise.optimiser import (
    AccelerationBox,
    OptimisedSteps,
    StepProblems,
    definiteness,
    optimality,
    step_problems,
)
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory, continuous_motion, is_timed
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

LEAST_MARGIN = 1e-3
"""Smallest margin of W that is accepted: efforts grow with its inverse."""

ACCELERATING = 1e-9
"""Of the largest reference acceleration or speed; what is below is zero. The straights of a path leave rounding."""


_FEWEST_SAMPLES = 10
"""Differences of second order over fewer steps than this have nothing to do with a motion."""


class SampledOnDemand(Protocol):
    """A trajectory that can be sampled at a time step."""

    def sample(self, dt: float) -> PlatformMotion:
        """Return samples ``dt`` seconds apart, with both sides of each jump of the acceleration."""


@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def plan_stepwise(
    dynamics: DynamicsLike,
    motion: PlatformMotion | SampledOnDemand,
    *,
    dt: float = 5e-3,
    objective: str | Mapping[str, float] = "effort",
    base_point: ArrayLike | None = None,
    lam: float = 0.0,
    baseline: DynamicsLike | ArrayLike | None = None,
    active: Active = "always",
    start: ArrayLike = 0.0,
    datum: ArrayLike = 0.0,
    return_time: float | Literal["shortest"] = 0.5,
    stop: Stop = "after",
    brake_time: float = 0.5,
    anticipate: bool = True,
    speed: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    track: ArrayLike | None = None,
    least_margin: float = LEAST_MARGIN,
    between: int = 0,
    limits: Limits | None = None,
) -> Plan:
    """Plan the carriers so that each time step has the least main effort (Parsa 2014, section 4.1).

    At each sample s minimises Σ (τ_i − λ τ̂_i)², τ = W⁻¹ f(s, ṡ, s̈), with ṡ and s̈ the backward differences of s and ṡ
    over the steps of ``motion`` (eq. 4.1). Track, speed and acceleration limits are one box a step (eqs. 4.2 to 4.4),
    and each minimum is the true one over the box. τ is quadratic in s with a tiny curvature, so it is also the only
    one; the diagnostics state how nearly the conditions of a minimum hold and the least curvature of the sum.

    Any time grid will do. A sample on a jump of the reference acceleration is optimised for the acceleration it
    states; on a grid of single samples that is the one after the jump. The carriers then accelerate up to one step
    before the platform does, and during that step the efforts are those of the jump in full, although no sample shows
    it (``between`` does). A two-sided sample removes this: the step into it sees the acceleration before the jump,
    its second half has the s̈ of the step that follows.

    ``active="accelerating"`` is the thesis's square: the optimiser works while ẍ is not zero; after it the carriers
    return to ``datum`` by a polynomial of degree seven; the next stretch takes over from the state it finds. After the
    last one, with the platform at rest, they are only braked.

    Other objectives, alone or by weights beside Σ (τ − λ τ̂)², are squares of what the base feels at the sample beyond
    the load at rest where the motion begins: "base_force", "base_moment" and "base_wrench" (both, the moment over the
    characteristic length). What takes it to zero takes a carrier wherever that leads, to the end of its track too.

    The plan ends with the carriers at rest. ``stop="after"`` (the thesis's order) brakes them once the motion is over:
    samples with the platform held are added until they rest. ``stop="within"`` bounds the speeds so that they rest by
    the last sample.

    ``anticipate`` keeps every carrier able to stop before its track ends. Without it (the thesis's version) a carrier
    can run towards the end of its track until no admissible acceleration is left, which is an error. It is on by
    default: it changes nothing before that point, and the box is then never empty.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
        motion: N samples of the platform motion, whose steps need not be equal; or a trajectory, which is sampled.
        dt: the time step of a trajectory, s. Jumps of its acceleration are sampled from both sides.
        objective: what to minimise, or weights of several: "effort", "base_force", "base_moment", "base_wrench".
        base_point: (3,) about which the moment on the base is taken, m; the world origin when left out.
        lam: λ, fraction of the baseline effort to aim at, 0 to 1.
        baseline: the baseline robot, or its name or path; a backend of it; or its efforts τ̂ (N, m), N or N·m. Needed
            where λ > 0.
        active: "always", or "accelerating": while the reference acceleration is not zero.
        start: scalar or (k,) positions at the start, at rest, m.
        datum: scalar or (k,) positions to return to, m.
        return_time: duration of a return, s, or "shortest": the least that keeps the limits of track, speed and
            acceleration.
        stop: "after" or "within".
        brake_time: time in which the carriers are braked at the end, s; sooner where the track is too short.
        anticipate: see above.
        speed: scalar or (k,) speed limits in place of the robot's own, m/s.
        acceleration: the same for the acceleration, m/s².
        track: (2,) or (k, 2) track ends in place of the robot's own, m.
        least_margin: smallest margin of W along the motion.
        between: number of points inside each step at which the efforts of the continuous motion are checked as well
            (``diagnostics["between_samples"]``, see ``between_samples``); 0 for none.
        limits: track, speed and acceleration as one value in place of the three keywords; the planner keeps to no
            others.

    Returns:
        A plan with the phases "parked", "optimise", "return", "brake". ṡ and s̈ are backward differences but for
        returns, where they are the derivatives of the polynomial.

    Raises:
        InputError: a setting out of its domain, or a baseline that does not fit.
        UnsupportedRobotError: no carriers, curved tracks, or too few main actuators.
        InfeasiblePlanError: the box of a step is empty; a carrier cannot stop; no return keeps the limits; the motion
            comes too close to a type II singularity. Carries constraint, carrier, time and amount.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as ``Dynamics.along``.
    """
    dynamics = as_dynamics(dynamics)
    require_motion(motion, "sample")
    robot = dynamics.robot
    require_carriers(robot)
    trajectory = motion
    if not isinstance(motion, PlatformMotion):
        motion = motion.sample(dt=dt)
    if 1 < len(motion) < _FEWEST_SAMPLES:
        raise InputError(
            f"The motion has {len(motion)} samples, too few to plan step by step.",
            remedy=f"Sample it more finely: at least {_FEWEST_SAMPLES} samples.",
            samples=len(motion),
        )
    if len(motion) < 2:
        raise InputError("The motion has a single instant.", remedy="Pass a motion of at least two instants.")
    settings = checked_settings(
        robot,
        grouped("limits", limits, Limits, track=track, speed=speed, acceleration=acceleration),
        objective=objective,
        base_point=base_point,
        lam=lam,
        active=active,
        start=start,
        datum=datum,
        return_time=return_time,
        stop=stop,
        brake_time=brake_time,
        anticipate=anticipate,
        least_margin=least_margin,
        between=between,
    )
    along = dynamics.along(motion)
    if isinstance(baseline, (Robot, str, Path)):
        baseline = as_dynamics(baseline)
    target, reference = target_effort(robot, motion, settings.lam, baseline)
    model, target = _goals(dynamics, along, settings, target)
    at = np.flatnonzero(~motion.jumps)
    problems = step_problems(model, target, at)
    moving, accelerating = _moving(motion)
    decides = accelerating[at[1:]] if active == "accelerating" else np.ones(len(at) - 1, dtype=bool)
    box = settings.box(float(motion.t[-1]))
    course = run_course(robot, settings, box, problems, decides, ~moving[at[1:]])
    course = brake(settings, box, course, float(np.median(problems.h)), not moving[-1])
    carriers, phase = _samples(motion, course, len(problems.t))
    added = course.t[len(problems.t) :]
    position = PiecewisePolynomial.joined(course.parts).made_continuous()
    platform = continuous_motion(trajectory if is_timed(trajectory) else motion)
    functions = PlanFunctions(platform.prolonged_until(position.end), position)
    report = diagnostics(problems, course, box)
    aimed_at = None
    if baseline is not None and reference is not None:
        aimed_at = repr(baseline.robot) if is_dynamics(baseline) else "efforts"
        report["baseline_peak"] = tuple(np.abs(reference).max(axis=0).tolist())
    plan = finish_plan(
        PlannedMotion(
            dynamics,
            functions,
            dynamics.along(_prolonged(motion, added)) if len(added) else along,
            carriers,
            settings.limits,
            "stepwise",
            phase=phase,
            phases=PHASES,
            parameters={**settings.parameters, "baseline": aimed_at},
            diagnostics=report,
        )
    )
    if settings.between:
        report["between_samples"] = between_samples(dynamics, plan, settings.between)
    peaks = {name: plan.tau[plan.phase == i] for i, name in enumerate(PHASES) if (plan.phase == i).any()}
    report["peak_effort"] = {name: tuple(np.abs(tau).max(axis=0).tolist()) for name, tau in peaks.items()}
    return replace(plan, diagnostics={**plan.diagnostics, **report})


def _goals(
    dynamics: Dynamics, along: DynamicsAlongMotion, settings: StepwiseSettings, target: Array
) -> tuple[EffortModel, Array]:
    """Return the model of what is minimised and its target, (N, r) each: efforts and base wrench, by their weights."""
    weights = settings.objective
    if not set(BASE) & set(weights):
        return effort_model(along, settings.least_margin), target
    rest = load_at_rest(dynamics, along.motion, settings.start, settings.base_point)
    goal, by_term = base_wrench(along, rest, settings.base_point).rows(weights, along.robot.characteristic_length)
    model, root = effort_model(along, settings.least_margin, goal.shape[1]), weights.get("effort", 0.0) ** 0.5
    tau0 = np.concatenate([root * model.tau0, goal], axis=1)
    tau_terms = np.concatenate([root * model.tau_terms, by_term], axis=1)
    return replace(model, tau0=tau0, tau_terms=tau_terms), np.pad(root * target, ((0, 0), (0, goal.shape[1])))


def _moving(motion: PlatformMotion) -> tuple[BoolArray, BoolArray]:
    """Return (N,) whether the platform moves, and whether it accelerates."""
    speed, acceleration = (np.abs(rate).max(axis=1) for rate in (motion.xd, motion.xdd))
    return speed > ACCELERATING * speed.max(), acceleration > ACCELERATING * acceleration.max()


def _samples(motion: PlatformMotion, course: Course, planned: int) -> tuple[CarrierMotion, IntArray]:
    """Return the carriers at the samples of the plan: those of the motion, two-sided ones included, and those added.

    ``planned``: number of instants of the course that are samples of the motion.
    """
    phase = np.append(course.phase[1:2], course.phase[1:])
    follows = np.minimum(np.arange(len(phase)) + 1, len(phase) - 1)
    after = np.where((phase[follows] == RETURN)[:, None], course.sdd, course.sdd[follows])
    added = np.arange(planned, len(course.t))
    which = np.concatenate([np.cumsum(~motion.jumps) - 1, added])
    second = np.pad(motion.jumps, (0, len(added)))
    acceleration: Array = np.where(second[:, None], after[which], course.sdd[which])
    return (
        CarrierMotion(course.s[which], course.sd[which], acceleration, check_rates=False),
        np.where(second, phase[follows][which], phase[which]),
    )


def _prolonged(motion: PlatformMotion, added: Array) -> PlatformMotion:
    """Return the motion with the platform held at its end for the added times."""
    x = np.concatenate([motion.x, np.repeat(motion.x[-1:], len(added), axis=0)])
    xd, xdd = (np.pad(part, ((0, len(added)), (0, 0))) for part in (motion.xd, motion.xdd))
    return PlatformMotion(np.append(motion.t, added), x, xd, xdd, check_rates=False)


_MET = 1e-9
"""Relative distance from a bound that counts as met; the solver puts what is bound exactly on it."""


def diagnostics(problems: StepProblems, course: Course, box: AccelerationBox) -> dict[str, object]:
    """Return what the planner found, as plain data.

    Keys: ``steps`` and ``optimised_steps``; ``iterations`` (sum) and ``most_iterations``; ``largest_gradient``, the
    largest deviation from the conditions of a minimum (N or N·m, see ``optimality``); ``least_curvature``, the smallest
    eigenvalue of the Hessian of a step over its largest; ``bounds``, a tuple of mappings with carrier, bound
    (``speed``, ``acceleration``, ``track``, or ``stop``: the carrier is kept able to stop), side, start and end, s;
    ``returns``, start and end of each; ``braking``, start and end, NaN where nothing moved.
    """
    counts = [stretch.iterations for _, stretch in course.stretches]
    gradients, curvatures = [], []
    for first, stretch in course.stretches:
        residual, jacobian = problems.linearised(first, stretch.s, stretch.sd, stretch.sdd)
        gradients.append(optimality(residual, jacobian, stretch.lower, stretch.upper, stretch.sdd))
        curvatures.append(definiteness(residual, jacobian, problems.C[first : first + len(residual)]))
    return {
        "steps": len(course.t) - 1,
        "optimised_steps": int(sum(len(count) for count in counts)),
        "iterations": int(sum(int(count.sum()) for count in counts)),
        "most_iterations": int(max((int(count.max()) for count in counts), default=0)),
        "largest_gradient": float(max((part.max() for part in gradients), default=0.0)),
        "least_curvature": float(min((part.min() for part in curvatures), default=np.inf)),
        "bounds": tuple(_bounds_met(course, box)),
        "returns": course.returns,
        "braking": course.braking,
    }


def _bounds_met(course: Course, limits: AccelerationBox) -> list[dict[str, object]]:
    events: list[dict[str, object]] = []
    for first, stretch in course.stretches:
        t = course.t[first + 1 : first + 1 + len(stretch.s)]
        for j, name in enumerate(limits.carriers):
            for side, box in (("upper", stretch.upper), ("lower", stretch.lower)):
                at = stretch.sdd[:, j] == box[:, j]
                for bound, here in _which(stretch, limits, j, side).items():
                    events += [
                        {"carrier": name, "bound": bound, "side": side, "start": float(t[a]), "end": float(t[b - 1])}
                        for a, b in runs(at & here)
                    ]
    return sorted(events, key=lambda event: (event["start"], event["carrier"]))


def _which(stretch: OptimisedSteps, limits: AccelerationBox, j: int, side: str) -> dict[str, BoolArray]:
    """Return for each kind of bound the steps at which it would be the one that binds on a side."""
    limit, upper = limits.limits[j], side == "upper"
    s, sd, sdd = ((part if upper else -part)[:, j] for part in (stretch.s, stretch.sd, stretch.sdd))
    speed = sd >= limit.speed * (1.0 - _MET)
    acceleration = sdd >= limit.acceleration * (1.0 - _MET)
    track = s >= (limit.upper if upper else -limit.lower) - _MET * track_size(limit)
    stop = ~(speed | acceleration | track)
    return {"speed": speed, "acceleration": acceleration, "track": track, "stop": stop}


def between_samples(
    dynamics: Dynamics, plan: Plan, points: int, trajectory: TimedTrajectory | None = None
) -> dict[str, object]:
    """Return the largest efforts of a stepwise plan between its samples.

    Samples alone flatter the method: the accelerations are chosen for them. Between them s̈ is constant and ṡ meets the
    plan's at the samples; the positions lag behind the plan's by up to half a step, because backward differences move a
    carrier by its new speed.

    ``dynamics``: a backend of the robot of the plan; ``points``: number of points inside each step;
    ``trajectory``: the platform motion that was sampled, for exact values between the samples; quintics through x, ẋ, ẍ
    of the samples where left out, which smear a jump that is not two-sided over one step.

    Returns:
        ``peak_effort`` (m) over these points, N or N·m, and ``time_of_peak`` (m), s; the same over the optimised steps,
        ``optimised_peak``, beside ``optimised_peak_at_samples``; ``largest_lag``, m.
    """
    left = np.flatnonzero(np.diff(plan.t) > 0.0)
    if trajectory is not None:
        left = left[plan.t[left + 1] <= trajectory.duration]
    times = plan.t[left, None] + np.diff(plan.t)[left, None] * (np.arange(1, points + 1) / (points + 1))
    functions = plan.functions if trajectory is None else plan.functions_along(trajectory)
    efforts = np.abs(replace(plan, functions=functions).efforts_at(times.ravel(), dynamics))
    optimised = np.repeat(plan.phase[left + 1] == OPTIMISE, points)
    at_samples = np.abs(plan.tau[plan.phase == OPTIMISE])
    worst = efforts.argmax(axis=0)
    return {
        "points": points,
        "peak_effort": tuple(efforts.max(axis=0).tolist()),
        "time_of_peak": tuple(times.ravel()[worst].tolist()),
        "optimised_peak": tuple(efforts[optimised].max(axis=0, initial=0.0).tolist()),
        "optimised_peak_at_samples": tuple(at_samples.max(axis=0, initial=0.0).tolist()),
        "largest_lag": float(np.abs(functions.carriers(plan.t) - plan.carriers.s).max(initial=0.0)),
    }
