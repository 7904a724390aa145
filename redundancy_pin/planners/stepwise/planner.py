"""Least effort one time step at a time (Parsa 2014, chapter 4), and the report of such a plan."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, IntArray, runs
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.carrier_model import effort_model, is_dynamics, require_carriers, target_effort
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import PlannedMotion
from redundancy_pin.planners.limits import Limits, ResolvedLimits, grouped, require_motion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.course import (
    ON_TRACK,
    PHASES,
    RETURN,
    Active,
    Course,
    Stop,
    checked_settings,
    plan_course,
    track_size,
)
from redundancy_pin.planners.stepwise.step import AccelerationBox, OptimisedSteps, StepProblems
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.continuous_motion import continuous_motion, is_timed
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

LEAST_MARGIN = 1e-3
"""Smallest margin of W that is accepted: efforts grow with its inverse."""

ACCELERATING = 1e-9
"""Of the largest reference acceleration or speed; what is below is zero. The straights of a path leave rounding."""


_FEWEST_SAMPLES = 10
"""Second differences over fewer samples do not describe a motion."""


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
    limits: Limits | None = None,
) -> Plan:
    """Plan the carriers so that each time step has the least main effort (Parsa 2014, section 4.1).

    At each sample s minimises Σ (τ_i − λ τ̂_i)², τ = W⁻¹ f(s, ṡ, s̈), with ṡ and s̈ the backward differences of s and ṡ
    over the steps of ``motion`` (eq. 4.1). Track, speed and acceleration limits are one box a step (eqs. 4.2 to 4.4),
    and each minimum is taken over the box. Where a step does not meet the conditions of a minimum, the status is
    ``not_converged``; the diagnostics state the largest deviation from them.

    The steps may differ in length. A sample on a jump of the reference acceleration is optimised for the acceleration
    it states; on a grid of single samples that is the one after the jump. The carriers then accelerate up to one step
    before the platform does. During that step the efforts are those of the jump in full: no sample shows it, but
    ``Plan.between`` does. A two-sided sample removes this: the step into it sees the acceleration before the jump, its
    second half has the s̈ of the step that follows.

    With ``active="accelerating"`` (the thesis's square) the optimiser works while ẍ is not zero. Afterwards the
    carriers return to ``datum`` by a polynomial of degree seven, and the next optimised segment starts from the state
    it finds. After the last one, with the platform at rest, they are only braked.

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
        limits: track, speed and acceleration as one value in place of the three keywords; the planner keeps to no
            others.

    Returns:
        A plan with the phases "parked", "optimise", "return", "brake". ṡ and s̈ are backward differences, except on
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
    if len(motion) < _FEWEST_SAMPLES:
        raise InputError(
            f"The motion has {len(motion)} samples, too few to plan step by step.",
            remedy=f"Sample it more finely: at least {_FEWEST_SAMPLES} samples.",
            samples=len(motion),
        )
    settings = checked_settings(
        robot,
        grouped("limits", limits, Limits, track=track, speed=speed, acceleration=acceleration),
        lam=lam,
        active=active,
        start=start,
        datum=datum,
        return_time=return_time,
        stop=stop,
        brake_time=brake_time,
        anticipate=anticipate,
        least_margin=least_margin,
    )
    along = dynamics.along(motion)
    if isinstance(baseline, (Robot, str, Path)):
        baseline = as_dynamics(baseline)
    target, _ = target_effort(robot, motion, settings.lam, baseline)
    instants = np.flatnonzero(~motion.jumps)
    problems = StepProblems.of(effort_model(along, settings.least_margin), target, instants)
    moving, accelerating = _moving(motion)
    optimised = accelerating[instants[1:]] | (active == "always")
    box = AccelerationBox(settings.limits, settings.anticipate, float(motion.t[-1]) if stop == "within" else np.inf)
    course = plan_course(robot, settings, box, problems, optimised, ~moving[instants[1:]])
    carriers, phase = _samples(motion, course, len(instants))
    added = course.t[len(instants) :]
    position = PiecewisePolynomial.joined(course.position).made_continuous()
    platform = continuous_motion(trajectory if is_timed(trajectory) else motion)
    aimed_at = None
    if baseline is not None:
        aimed_at = repr(baseline.robot) if is_dynamics(baseline) else "efforts"
    planned = PlannedMotion(
        dynamics,
        PlanFunctions(platform.prolonged_until(position.end), position),
        dynamics.along(_prolonged(motion, added)) if len(added) else along,
        carriers,
        settings.limits,
        "stepwise",
        phase=phase,
        phases=PHASES,
        parameters={**settings.parameters, "baseline": aimed_at},
        diagnostics=diagnostics(problems, course, settings.limits),
    )
    return finish_plan(planned)


def _moving(motion: PlatformMotion) -> tuple[BoolArray, BoolArray]:
    """Return (N,) whether the platform moves, and whether it accelerates."""
    speed, acceleration = (np.abs(rate).max(axis=1) for rate in (motion.xd, motion.xdd))
    return speed > ACCELERATING * speed.max(), acceleration > ACCELERATING * acceleration.max()


def _samples(motion: PlatformMotion, course: Course, planned: int) -> tuple[CarrierMotion, IntArray]:
    """Return the carriers and phases at the samples of the motion, and at those added to it.

    The second sample of a jump shows the acceleration of the step that follows. ``planned``: number of instants of the
    course that are samples of the motion.
    """
    follows = np.minimum(np.arange(len(course.t)) + 1, len(course.t) - 1)
    after = np.where((course.phase[follows] == RETURN)[:, None], course.sdd, course.sdd[follows])
    added = np.arange(planned, len(course.t))
    which = np.concatenate([np.cumsum(~motion.jumps) - 1, added])
    second = np.pad(motion.jumps, (0, len(added)))
    acceleration: Array = np.where(second[:, None], after[which], course.sdd[which])
    return (
        CarrierMotion(course.s[which], course.sd[which], acceleration, check_rates=False),
        np.where(second, course.phase[follows][which], course.phase[which]),
    )


def _prolonged(motion: PlatformMotion, added: Array) -> PlatformMotion:
    """Return the motion with the platform held at its end for the added times."""
    x = np.concatenate([motion.x, np.repeat(motion.x[-1:], len(added), axis=0)])
    xd, xdd = (np.pad(part, ((0, len(added)), (0, 0))) for part in (motion.xd, motion.xdd))
    return PlatformMotion(np.append(motion.t, added), x, xd, xdd, check_rates=False)


def diagnostics(problems: StepProblems, course: Course, limits: ResolvedLimits) -> dict[str, object]:
    """Return what the planner found, as plain data.

    - ``steps``, ``optimised_steps``: their numbers.
    - ``iterations``, ``most_iterations``: quadratic programmes solved, in all and at most in a step.
    - ``solver``, ``optimal``: whether every step meets the conditions of a minimum.
    - ``largest_gradient``: the largest deviation from them, N or N·m (see ``optimality``).
    - ``bounds``: mappings with carrier, bound (``speed``, ``acceleration``, ``track``, or ``stop``: the carrier is kept
      able to stop), side, start and end, s.
    - ``returns``: start and end of each, s; ``braking``: start and end, NaN where nothing moved.
    """
    counts, gradients = (
        np.concatenate([[0], *(getattr(steps, name) for _, steps in course.optimised)])
        for name in ("iterations", "gradient")
    )
    largest = float(gradients.max())
    return {
        "steps": len(course.t) - 1,
        "optimised_steps": len(counts) - 1,
        "iterations": int(counts.sum()),
        "most_iterations": int(counts.max()),
        "solver": "Gauss-Newton by DAQP",
        "optimal": largest <= problems.tolerance,
        "largest_gradient": largest,
        "bounds": tuple(_bounds_met(course, limits)),
        "returns": tuple(course.returns),
        "braking": course.braking,
    }


def _bounds_met(course: Course, limits: ResolvedLimits) -> list[dict[str, object]]:
    events: list[dict[str, object]] = []
    for first, steps in course.optimised:
        t = course.t[first + 1 :]
        for j, name in enumerate(limits.names):
            for side, box in (("upper", steps.upper), ("lower", steps.lower)):
                met = steps.sdd[:, j] == box[:, j]
                for bound, reached in _reached(steps, limits, j, side).items():
                    events += [
                        {"carrier": name, "bound": bound, "side": side, "start": float(t[a]), "end": float(t[b - 1])}
                        for a, b in runs(met & reached)
                    ]
    return sorted(events, key=lambda event: (event["start"], event["carrier"]))


def _reached(steps: OptimisedSteps, limits: ResolvedLimits, j: int, side: str) -> dict[str, BoolArray]:
    """Return for each kind of bound the steps at whose ends a carrier has reached it on a side."""
    upper, (begin, end) = side == "upper", limits.track[j]
    s, sd, sdd = ((part if upper else -part)[:, j] for part in (steps.s, steps.sd, steps.sdd))
    speed = sd >= limits.speed[j] * (1.0 - ON_TRACK)
    acceleration = sdd >= limits.acceleration[j] * (1.0 - ON_TRACK)
    track = s >= (end if upper else -begin) - ON_TRACK * track_size(begin, end)
    return {"speed": speed, "acceleration": acceleration, "track": track, "stop": ~(speed | acceleration | track)}
