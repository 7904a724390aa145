"""Least effort one time step at a time (Parsa 2014, chapter 4), and the report of such a plan."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, IntArray, one_of, positive, runs
from redundancy_pin.dynamics.default import DynamicsLike, as_cached_dynamics, as_dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.base_wrench import weights_of
from redundancy_pin.planners.carrier_model import (
    EffortModel,
    effort_model,
    is_dynamics,
    require_carriers,
    target_effort,
)
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import Findings, PlannedMotion
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.options import (
    LARGEST_STEP,
    NO_NODES,
    Limits,
    Mesh,
    Objective,
    group_of,
    refuse_fields,
    return_duration,
    takes_groups,
)
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.course import (
    PHASES,
    RETURN,
    Active,
    Course,
    StepwiseSettings,
    Stop,
    plan_course,
)
from redundancy_pin.planners.stepwise.step import AccelerationBox, OptimisedSteps, gradient_tolerance
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.trajectory import sample_times

LEAST_MARGIN = 1e-3
"""Smallest margin of W that is accepted: efforts grow with its inverse."""

GOALS = ("effort", "tracking")
"""Objectives of a step, by the names of ``plan_whole_trajectory``."""

REFUSED = {
    **NO_NODES,
    "calm": "each step has one minimum, so no calmer one exists",
    "base_point": "the stepwise planner minimises no moment on the base",
    "jerk": "the carriers' accelerations jump from step to step; use plan_whole_trajectory",
}
"""Fields of groups that the planner does not take, and why."""

_ROUNDING = 1e-9
"""Of the largest speed or acceleration of the platform; below it is zero. The straights of a path leave rounding."""

_FEWEST_SAMPLES = 10
"""Second differences over fewer samples do not describe a motion."""


@takes_groups(REFUSED)
@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def plan_stepwise(
    dynamics: DynamicsLike,
    motion: PlatformMotion | TimedTrajectory,
    *,
    objective: str | Mapping[str, float] | Objective = "effort",
    limits: Limits | None = None,
    mesh: Mesh | None = None,
    active: Active = "always",
    start: ArrayLike = 0.0,
    datum: ArrayLike = 0.0,
    return_time: float | Literal["shortest"] = 0.5,
    stop: Stop = "after",
    brake_time: float = 0.5,
    anticipate: bool = True,
    least_margin: float = LEAST_MARGIN,
) -> Plan:
    """Plan the carriers so that each time step has the least main effort (Parsa 2014, section 4.1).

    At each sample s minimises Σ (τ_i − λ τ̂_i)², τ = W⁻¹ f(s, ṡ, s̈), with ṡ and s̈ the backward differences of s and ṡ
    over the steps of ``motion`` (eq. 4.1). Track, speed and acceleration limits are one box a step (eqs. 4.2 to 4.4),
    and each minimum is taken over the box. Where a step does not meet the first-order conditions of a minimum, the
    status is ``not_converged``; the diagnostics state the largest deviation from them.

    The steps may differ in length. A sample on a jump of the reference acceleration is optimised for the acceleration
    it states; on a grid of single samples that is the one after the jump. The carriers then accelerate up to one step
    before the platform does. That step has the full efforts of the jump: no sample shows it, but
    ``Plan.between`` does. A two-sided sample removes this: the step into it sees the acceleration before the jump, its
    second half has the s̈ of the step that follows.

    With ``active="accelerating"`` (the thesis's square) the optimiser works while ẍ is not zero. Afterwards the
    carriers return to ``datum`` by a polynomial of degree seven, and the next optimised segment starts from the state
    it finds. After the last one, with the platform at rest, they are only braked.

    The plan ends with the carriers at rest. ``stop="after"`` (the thesis's order) brakes them once the motion is over:
    samples with the platform at rest are added until they rest. ``stop="within"`` bounds the speeds to let them rest by
    the last sample.

    ``anticipate`` keeps every carrier able to stop before its track ends. Without it (the thesis's version) a carrier
    can run towards the end of its track until no admissible acceleration is left, which is an error. It is on by
    default: it changes nothing before that point, and the box is then never empty.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
        motion: N samples of the platform motion, whose steps need not be equal; or a trajectory, which is sampled.
        objective: "effort", λ = 0; or ``Objective(lam=..., baseline=...)``, where ``lam`` is λ, the fraction of the
            baseline effort to aim at, and ``baseline`` is needed for λ > 0: the baseline robot, or its name or path; a
            backend of it; or its efforts τ̂ (N, m), N or N·m.
        limits: in place of the robot's own. Those of efforts, carrier forces and actuators' rates are judged; there is
            none of the jerk, as accelerations jump from step to step.
        mesh: ``dt``, the time step of a trajectory, s, ``LARGEST_STEP`` when left out. Jumps of its acceleration are
            sampled from both sides.
        active: carriers move "always", or only while the motion is "accelerating".
        start: scalar or (k,) positions at the start, at rest, m.
        datum: scalar or (k,) positions to return to, m.
        return_time: duration of a return, s, or "shortest": the least that keeps the limits of track, speed and
            acceleration.
        stop: whether the carriers brake "after" the end of the motion, or "within" it.
        brake_time: time in which the carriers are braked at the end, s; less if the track is too short.
        anticipate: keep every carrier able to stop before its track ends.
        least_margin: smallest margin of W along the motion.

    Returns:
        A plan with the phases "parked", "optimise", "return", "brake". ṡ and s̈ are backward differences, except on
        returns, where they are the derivatives of the polynomial.

    Raises:
        InputError: a setting out of its domain, one that does not apply, or a baseline that does not fit.
        UnsupportedRobotError: no carriers, curved tracks, or too few main actuators.
        InfeasiblePlanError: the box of a step is empty; a carrier has no time to stop before the motion ends; no return
            keeps the limits; the motion comes too close to a type II singularity. Carries constraint, joint, time and
            amount.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as ``Dynamics.along``.

    Example:
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner())
        >>> round(float(plan.peak_effort.max()), 2)
        7.31
    """
    dynamics, mesh = as_cached_dynamics(dynamics), group_of(mesh, Mesh)
    own_steps = {"dt": "the motion has steps of its own"} if isinstance(motion, PlatformMotion) else {}
    refuse_fields({**REFUSED, **own_steps}, mesh)
    robot = dynamics.robot
    require_carriers(robot)
    source = None
    if not isinstance(motion, PlatformMotion):
        source, dt = as_motion(motion), LARGEST_STEP if mesh.dt is None else mesh.dt
        times = sample_times(source.end - source.start, source.breaks - source.start, dt, None, True)
        motion = source.sample_at(source.start + times)
    if len(motion) < _FEWEST_SAMPLES:
        raise InputError(
            f"The motion has {len(motion)} samples, too few to plan step by step.",
            remedy=f"Sample it more finely: at least {_FEWEST_SAMPLES} samples.",
            samples=len(motion),
        )
    platform = as_motion(motion) if source is None else source
    goal, given = Objective.of(objective), group_of(limits, Limits)
    one_of(active, "active", get_args(Active))
    one_of(stop, "stop", get_args(Stop))
    one_of(anticipate, "anticipate", (True, False))
    if len(weights_of(goal.weights or {}, GOALS)) > 1:
        raise InputError("Each step has one objective.", remedy=f"Use {' or '.join(GOALS)}.", name="objective")
    refuse_fields(REFUSED, goal, given)
    resolved = given.resolved(robot)
    if stop == "within" and np.isinf(resolved.acceleration).any():
        raise InputError(
            'stop="within" needs acceleration limits: without them the time to brake is not defined.',
            remedy='Declare or pass acceleration limits, or use stop="after".',
        )
    settings = StepwiseSettings(
        limits=resolved,
        lam=float(goal.lam),
        active=active,
        start=resolved.on_track(start, "start"),
        datum=resolved.on_track(datum, "datum"),
        anticipate=anticipate,
        return_time=return_duration(return_time, "return_time"),
        stop=stop,
        brake_time=positive(brake_time, "brake_time", "s"),
        least_margin=positive(least_margin, "least_margin", ""),
    )
    along = dynamics.along(motion)
    baseline = as_dynamics(goal.baseline) if isinstance(goal.baseline, (Robot, str, Path)) else goal.baseline
    target = target_effort(robot, motion, settings.lam, baseline)
    instants = np.flatnonzero(~motion.jumps)
    model = effort_model(along, settings.least_margin)
    missing = EffortModel(model.t[instants], (model.tau0 - target)[instants], model.tau_terms[instants])
    moving, accelerating = (_above_rounding(rate)[instants[1:]] for rate in (motion.xd, motion.xdd))
    box = AccelerationBox(settings.limits, settings.anticipate, float(motion.t[-1]) if stop == "within" else np.inf)
    course = plan_course(robot, settings, box, missing, accelerating | (active == "always"), ~moving)
    carriers, phase = _samples(motion, course, len(instants))
    added = course.t[len(instants) :]
    position = PiecewisePolynomial.joined(course.position).remove_offsets()
    aimed_at = None
    if baseline is not None:
        aimed_at = repr(baseline.robot) if is_dynamics(baseline) else "efforts"
    gradient = max((float(steps.gradient.max()) for _, steps in course.optimised), default=0.0)
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
        findings=Findings(gradient <= gradient_tolerance(missing), "Gauss-Newton by DAQP"),
        diagnostics=_diagnostics(course, gradient, settings.limits),
    )
    return finish_plan(planned)


def _above_rounding(rate: Array) -> BoolArray:
    """Return (N,) whether a rate of the platform (N, n) is not zero."""
    size = np.abs(rate).max(axis=1)
    return np.asarray(size > _ROUNDING * size.max())


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
    """Return the motion, with the platform at rest at its end for the added times."""
    x = np.concatenate([motion.x, np.repeat(motion.x[-1:], len(added), axis=0)])
    xd, xdd = (np.pad(part, ((0, len(added)), (0, 0))) for part in (motion.xd, motion.xdd))
    return PlatformMotion(np.append(motion.t, added), x, xd, xdd, check_rates=False)


def _diagnostics(course: Course, gradient: float, limits: ResolvedLimits) -> dict[str, object]:
    """Return the planner's results, as plain data.

    - ``largest_gradient``: the largest deviation of a step from the first-order conditions of a minimum, N or N·m: the
      gradient of ½ ‖r‖² over the largest slope.
    - ``bounds``: mappings with joint, the carrier's; bound (``speed``, ``acceleration``, ``track``, or ``stop``: the
      carrier is kept able to stop); side, start and end, s.
    - ``returns``: start and end of each, s; ``braking``: start and end, NaN where nothing moved.
    """
    events = [event for first, steps in course.optimised for event in _bounds_met(course.t[first + 1 :], steps, limits)]
    return {
        "largest_gradient": gradient,
        "bounds": tuple(sorted(events, key=lambda event: (event["start"], event["joint"]))),
        "returns": tuple(course.returns),
        "braking": course.braking,
    }


_MET = 1e-9
"""Distance from a bound that counts as met, relative to the bound or to the length of the track."""


def _bounds_met(t: Array, steps: OptimisedSteps, limits: ResolvedLimits) -> Iterator[dict[str, Any]]:
    """Give joint, bound, side, start and end, s, where the box of the steps binds; ``t`` (P,) ends of the steps."""
    length = np.diff(limits.track)[:, 0]
    slack = _MET * np.where(np.isfinite(length), length, 1.0)
    sides = ("upper", 1.0, steps.upper, limits.track[:, 1]), ("lower", -1.0, steps.lower, -limits.track[:, 0])
    for side, sign, box, end in sides:
        reached = {
            "speed": sign * steps.sd >= limits.speed * (1.0 - _MET),
            "acceleration": sign * steps.sdd >= limits.acceleration * (1.0 - _MET),
            "track": sign * steps.s >= end - slack,
        }
        reached["stop"] = ~np.any(list(reached.values()), axis=0)
        for bound, there in reached.items():
            for j, name in enumerate(limits.names):
                for a, b in runs((steps.sdd == box)[:, j] & there[:, j]):
                    yield {
                        "joint": name, "bound": bound, "side": side, "start": float(t[a]), "end": float(t[b - 1])
                    }  # fmt: skip
