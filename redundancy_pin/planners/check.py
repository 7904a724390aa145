"""One judgement of plans: of a new one as its planner hands it over, and of one that says something of itself already.

``finish_plan`` judges: W τ = f at the samples, limits at the samples and between them, the peaks of the continuous
motion, and the status that follows. ``check_plan`` has it judge a plan anew and compares.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, frozen, read_only, require_type
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion, ReducedDynamics
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.branch import known_state
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.functions import (
    PIECE_DEGREE,
    SINGULAR_SAMPLE,
    BetweenSamples,
    DenseCheck,
    PlanFunctions,
    dense_check,
    least_effort,
)
from redundancy_pin.planners.limits import (
    QUANTITIES,
    LimitEvent,
    check_limits,
    limit_bounds,
    limit_events,
    motion_broken,
    ranges_left,
)
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import record_difference, robot_record
from redundancy_pin.planners.samples_only import reconstruction_error
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.singularities.roots import zeros
from redundancy_pin.status import ResultStatus, SampleStatus, solved_status
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

BALANCE_TOLERANCE = 1e-6
"""Largest imbalance W τ − f, relative to the size of f along the motion, of efforts that a planner prescribes."""

SAME = 1e-6
"""Deviation of forces, rates and motions, relative to the largest, that two backends, or two machines, may show."""

SAME_PEAK = 1e-3
"""Relative deviation of a peak between the samples: beside a singularity W⁻¹ magnifies the rounding of the plan."""

RANK_LOST = 1e-6
"""Smallest over largest singular value of the closures at which their rank counts as lost: known to 1e-8 there."""


def finish_plan(
    along: DynamicsAlongMotion,
    carriers: CarrierMotion,
    *,
    planner: str,
    phase: IntArray,
    phases: tuple[str, ...],
    parameters: Mapping[str, object],
    diagnostics: Mapping[str, object],
    prescribed: Array | None = None,
    carrier_limits: tuple[CarrierLimits, ...] | None = None,
    functions: PlanFunctions | None = None,
    position: PiecewisePolynomial | None = None,
    dynamics: Dynamics | None = None,
    between: BetweenSamples | None = None,
    singular: IntArray | None = None,
    reconstructed: Array | None = None,
) -> Plan:
    """Evaluate the backend once more along the planned motion and collect everything a plan carries.

    ``along``: dynamics along the platform motion of the plan; ``carriers``: planned carrier motion, N samples;
    ``phase`` (N,) index of the phase of each sample; ``parameters``: limits "effort" (m,), "actuator_speed" (m,)
    and "jerk" (k,) among them are judged; ``diagnostics``: "optimal" says whether the planner had an optimum;
    ``prescribed`` (N, m) main efforts the planner decided on, NaN where W τ = f decides. Their imbalance is checked and
    reported, never corrected;
    ``carrier_limits``: limits to judge the plan by in place of the robot's own, one for each carrier; ``functions``:
    what the planner made, between the samples too; ``position``: the carriers alone, where there are no functions;
    ``dynamics``: the backend, to look between the samples; ``between``: what was seen there already; ``singular``:
    samples at which the efforts are the limits from both sides; ``reconstructed``: the ``reconstruction_error`` of
    functions that were put together from samples.
    """
    robot, t = along.robot, along.motion.t
    judged = robot if carrier_limits is None else replace(robot, carrier_limits=carrier_limits)
    reduced = along.reduce(carriers)
    solved = distribute(reduced)
    tau, status, residual = np.array(solved.tau), np.array(solved.status), np.array(solved.residual)
    if prescribed is not None:
        given = np.isfinite(prescribed).all(axis=1)
        tau[given] = prescribed[given]
        left, size = imbalance(reduced, tau)
        residual[given] = left[given]
        balanced = left[given] <= BALANCE_TOLERANCE * size
        fine = np.where(status[given] == SampleStatus.OUT_OF_RANGE, SampleStatus.OUT_OF_RANGE, SampleStatus.OK)
        status[given] = np.where(balanced, fine, SampleStatus.SINGULAR_INCONSISTENT)
    if singular is not None:  # however well W τ = f looks at one instant
        regular = singular[status[singular] == SampleStatus.OK]
        status[regular] = SampleStatus.SINGULAR_CONSISTENT
    effort, rate = (
        np.array(parameters.get(name, np.full(robot.m, np.inf)), dtype=float) for name in ("effort", "actuator_speed")
    )
    findings = dict(diagnostics)
    limits = check_limits(judged, t, carriers, reduced.carrier_force)
    at_samples, touched = limit_events("effort", robot.actuated, t, tau, effort)
    if functions is not None and dynamics is not None:
        findings["closure_rank"] = closure_rank_losses(dynamics, along, functions.platform)
        if between is None:
            on_it = np.unique(t[solved.margin <= SINGULAR_SAMPLE * solved.margin.max(initial=0.0)])
            between = dense_check(dynamics, functions, judged, t, tau, least_effort(reduced), effort, on_it, rate)
        touched = between.touched
    position = position if functions is None else functions.carriers
    exceeded: tuple[LimitEvent, ...] = () if between is None else between.violated
    if position is not None:
        exceeded = (*exceeded, *motion_broken(judged, position, reconstructed))
    jerks = _jerk_events(along, carriers, position, parameters)
    platform = None if functions is None else functions.platform
    at_samples = (*limits.violated, *at_samples, *jerks[0], *_ranges_left(along, platform))
    violated = merged_events(at_samples, exceeded)
    overall = ResultStatus.OK if diagnostics.get("optimal", True) else ResultStatus.NOT_CONVERGED
    check = None if between is None else between.check
    if check is not None:
        findings["dense_check"] = _summary(check, tau)
        overall = overall if check.passed else ResultStatus.UNRESOLVED
    if violated:
        overall = ResultStatus.LIMIT_VIOLATED
    lost = not np.isfinite(tau).all() or not solved_status(status).all()
    if lost or (check is not None and not np.isfinite(check.peak).all()):
        overall = ResultStatus.UNBOUNDED
    return Plan(
        motion=along.motion,
        carriers=carriers,
        tau=frozen(tau),
        carrier_force=reduced.carrier_force,
        actuated_rate=read_only(np.einsum("nim,ni->nm", reduced.W, along.motion.xd)),
        sample_status=read_only(status),
        residual=read_only(residual),
        margin=solved.margin,
        condition=solved.condition,
        phase=read_only(np.array(phase, dtype=np.intp)),
        phases=phases,
        limits=replace(limits, violated=violated, binding=_touched(limits.binding, (*touched, *jerks[1]), violated)),
        status=overall,
        planner=planner,
        backend=type(along).__name__.replace("AlongMotion", "").replace("Along", ""),
        robot=robot_record(robot),
        parameters=dict(parameters),
        diagnostics=findings,
        functions=functions,
        between=check,
    )


def imbalance(reduced: ReducedDynamics, tau: Array) -> tuple[Array, float]:
    """Return (N,) |W τ − f| for efforts (N, m), N, moments over the characteristic length; and the largest f."""
    left = (np.einsum("nij,nj->ni", reduced.W, tau) - reduced.f) / reduced.row_scale
    return np.linalg.norm(left, axis=1), float(np.abs(reduced.f / reduced.row_scale).max(initial=0.0))


def closure_rank_losses(
    dynamics: Dynamics, along: DynamicsAlongMotion, platform: ContinuousMotion
) -> list[dict[str, object]]:
    """Return "time", s, and pose "x" of each rank loss of the closures on the way: the branch is carried across it.

    ``along``: dynamics along samples of the platform's motion. Only where these show a rank loss are more needed.
    """
    t, first = np.unique(along.motion.t, return_index=True)
    known = along.closure_margin()[first]

    def margin(times: Array) -> Array:
        if times is t:
            return known
        every = np.union1d(t, times)  # the branch is followed from the start
        there = dynamics.along(platform.sample_at(every), unreachable="mark").closure_margin()
        return there[np.searchsorted(every, times)]

    roots = [zero.t for zero in zeros(margin, t, RANK_LOST)] if len(t) > 1 else []
    return [{"time": time, "x": platform.sample_at(np.array([time])).x[0].tolist()} for time in roots]


Events = tuple[LimitEvent, ...]


def _jerk_events(
    along: DynamicsAlongMotion,
    carriers: CarrierMotion,
    position: PiecewisePolynomial | None,
    parameters: Mapping[str, object],
) -> tuple[Events, Events]:
    """Return where jerks exceed their limit, and where they touch it.

    ``position``: of the carriers as a function of time; without it s̈ is linear between samples. Where s̈ jumps it is
    changed within the shorter of the pieces that meet there.
    """
    most = np.array(np.inf if parameters.get("jerk") is None else parameters["jerk"], dtype=float)
    if not np.isfinite(most).any():
        return (), ()
    if position is None:
        t, step = along.motion.t[:-1], np.diff(along.motion.t)
        moving = step > 0.0
        t, jerk = t[moving], np.diff(carriers.sdd, axis=0)[moving] / step[moving, None]
    else:
        edges, (least, largest) = position.edges, position.derivative(3).ranges()
        sdd, step = position.derivative(2), np.diff(edges)
        jump = (sdd(edges[1:-1]) - sdd(edges[1:-1], "left")) / np.minimum(step[:-1], step[1:])[:, None]
        inside = np.where(-least > largest, least, largest)
        t, jerk = np.append(edges[:-1], edges[1:-1]), np.append(inside, jump, axis=0)
    return limit_events("jerk", along.robot.carriers, t, jerk, most)


INSIDE = 8
"""Parts of a step, at whose ends joints are looked at that come near the end of their range there."""


def _ranges_left(along: DynamicsAlongMotion, platform: ContinuousMotion | None) -> Events:
    """Return where joints, passive ones too, leave their ranges: at the samples, and between them along a platform."""
    robot, t, q, gamma = along.robot, along.motion.t, along.q, along.gamma
    joints = joint_ranges(robot)
    if not joints:
        return ()
    if q is None or gamma is None:  # of a closed form, which knows no passive joints
        with warnings.catch_warnings():  # a note that another backend takes longer is none about this one
            warnings.simplefilter("ignore", RuntimeWarning)
            tree = as_dynamics(robot).along(along.motion, unreachable="mark")
        q, gamma = tree.q, tree.gamma
    if q is None or gamma is None:
        raise ValueError("The default backend has no tree.")
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    if platform is not None and len(known) > 1:
        at, near = t[known], np.zeros(len(known) - 1, dtype=bool)
        for joint in joints:
            beyond, step = joint.excess(q[known, joint.at], True), np.abs(np.diff(q[known, joint.at]))
            near |= np.maximum(beyond[:-1], beyond[1:]) > -step
        near &= np.diff(at) > 0.0
        bounds = np.flatnonzero(np.diff(near, prepend=False, append=False)).reshape(-1, 2)
        for first, last in bounds:  # each run of steps from the sample before it
            own, parts = at[first : last + 1], np.arange(1, INSIDE) / INSIDE
            inside = (own[:-1, None] + np.diff(own)[:, None] * parts).ravel()
            times = np.sort(np.concatenate([own[1:], inside]))
            start = known_state(robot, along.motion.x[known[first]], q[known[first]], gamma[known[first]])
            between = inverse_kinematics(robot, platform.sample_at(times), mark_unreachable=True, start=start)
            new = np.isin(times, inside)
            t, q = np.append(t, times[new]), np.append(q, between.q[new], axis=0)
        order = np.argsort(t, kind="stable")
        t, q = t[order], q[order]
    return ranges_left(robot, t, q)


def _touched(at_samples: Events, between: Events, violated: Events) -> Events:
    """Return limits that are touched: those of carriers at samples, and of others unless they are exceeded."""
    known = {(event.carrier, event.quantity) for event in (*at_samples, *violated)}
    others = (event for event in between if (event.carrier, event.quantity) not in known)
    return tuple(sorted((*at_samples, *others), key=lambda event: event.start))


def _summary(check: DenseCheck, tau: Array) -> dict[str, object]:
    """Return the dense check as plain data."""
    worst = int(np.argmax(check.peak))
    return {
        "finer": PIECE_DEGREE + 1,
        "points": check.points,
        "peak_effort": float(check.peak[worst]),
        "time_of_peak": float(check.time[worst]),
        "peak_effort_at_nodes": float(np.nanmax(np.abs(tau), initial=0.0)),
        "ratio": check.ratio,
        "passed": check.passed,
    }


def merged_events(at_samples: tuple[LimitEvent, ...], between: tuple[LimitEvent, ...]) -> tuple[LimitEvent, ...]:
    """Return the events, an event at samples replaced by one that overlaps it and exceeds the limit by more.

    An effort that is exceeded has one event from first to last, whatever its sign.
    """
    kept = list(at_samples)
    for event in between:
        same = [
            one
            for one in kept
            if (one.carrier, one.quantity) == (event.carrier, event.quantity)
            and (
                event.quantity == "effort"
                or (one.limit == event.limit and one.start <= event.end and event.start <= one.end)
            )
        ]
        if all(event.amount > other.amount for other in same):
            kept = [other for other in kept if other not in same] + [event]
    return tuple(sorted(kept, key=lambda event: event.start))


# --- a plan judged anew ---


@dataclass(frozen=True)
class Deviation:
    """Where a plan says something else than the dynamics of its robot.

    Attributes:
        quantity: what deviates, such as "main efforts" or "status".
        time: where it does most, s; NaN for what has no time.
        amount: by how much, in the unit of the quantity; NaN for what has none.
        message: the same in words.
    """

    quantity: str
    time: float
    amount: float
    message: str


@dataclass(frozen=True, eq=False)
class PlanCheck:
    """What the dynamics of the robot say of a plan.

    Attributes:
        status: status by this evaluation.
        violated: limits that are broken, by time.
        peak_effort: (m,) largest |τ| of the continuous motion, N or N·m.
        imbalance: largest |W τ − f| at a sample, relative to the largest f.
        deviations: where the plan says something else; none if it is what it says.
        wider_limits: notes of limits that are wider than the robot's own, in words: a plan is judged by the limits it
            was made with, which its user may have chosen.
        closure_rank: "time", s, and pose "x" of each rank loss of the closures on the way: branches meet there, and the
            machine may take another one than the plan.
    """

    status: ResultStatus
    violated: tuple[LimitEvent, ...]
    peak_effort: Array
    imbalance: float
    deviations: tuple[Deviation, ...]
    wider_limits: tuple[str, ...] = ()
    closure_rank: tuple[Mapping[str, object], ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the plan is what it says; a plan that says that it breaks limits may be."""
        return not self.deviations


@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def check_plan(plan: Plan, dynamics: DynamicsLike) -> PlanCheck:
    """Judge a plan anew from its motion: W τ = f, limits, efforts between the samples, and the status that follows.

    What the plan says of itself (efforts, forces, rates, margins, limits, peaks, status) is compared with what the
    dynamics say of the motion of platform and carriers. Any backend of the plan's robot will do; the one that the plan
    was not made by judges it independently.

    Args:
        plan: the plan.
        dynamics: the robot of the plan (``load_robot_of(plan)``), for generated code (``as_dynamics``); or a backend.

    Returns:
        What they say, and where the plan deviates from it.

    Raises:
        InputError: neither a robot nor a backend, or of another robot.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as ``Dynamics.along``.
    """
    require_type(plan, Plan, "A plan", "Pass load_plan(...).")
    dynamics = as_dynamics(dynamics)
    other = record_difference(plan.robot, robot_record(dynamics.robot))
    if other:
        raise InputError(
            f"The plan is for another robot than the dynamics: {other}",
            remedy="Pass load_robot_of(plan), or a backend of it.",
        )
    along = dynamics.along(plan.motion)
    left, size = imbalance(along.reduce(plan.carriers), plan.tau)
    unbalanced = left / (size or 1.0)
    balanced = unbalanced <= BALANCE_TOLERANCE
    again = finish_plan(
        along,
        plan.carriers,
        planner=plan.planner,
        phase=plan.phase,
        phases=plan.phases,
        parameters=plan.parameters,
        diagnostics={"optimal": plan.diagnostics.get("optimal", True)},
        prescribed=np.where(balanced[:, None], plan.tau, np.nan),
        carrier_limits=plan.limits.judged_by,
        functions=plan.functions_of_time,
        dynamics=dynamics,
        singular=np.flatnonzero(plan.sample_status == SampleStatus.SINGULAR_CONSISTENT),
        reconstructed=reconstruction_error(plan) if plan.functions is None else None,
    )
    return PlanCheck(
        status=again.status,
        violated=again.limits.violated,
        peak_effort=again.peak_effort,
        imbalance=float(np.nanmax(unbalanced, initial=0.0)),
        deviations=(
            *_effort_deviations(plan, unbalanced, balanced),
            *_sample_deviations(plan, again),
            *_motion_deviations(plan),
            *_verdict_deviations(plan, again),
        ),
        wider_limits=_wider_limits(plan, dynamics),
        closure_rank=tuple(again.diagnostics.get("closure_rank", ())),  # type: ignore[arg-type]
    )


def _wider_limits(plan: Plan, dynamics: Dynamics) -> tuple[str, ...]:
    own, used = (limit_bounds(limits) for limits in (dynamics.robot.carrier_limits, plan.limits.judged_by))
    return tuple(
        f"{name}: judged by a {quantity} of {used[0][i, j]:g} to {used[1][i, j]:g}, the robot's own is "
        f"{own[0][i, j]:g} to {own[1][i, j]:g}."
        for j, name in enumerate(dynamics.robot.carriers)
        for i, quantity in enumerate(QUANTITIES)
        if used[0][i, j] < own[0][i, j] or used[1][i, j] > own[1][i, j]
    )


def _effort_deviations(plan: Plan, unbalanced: Array, balanced: BoolArray) -> list[Deviation]:
    wrong = ~balanced & solved_status(plan.sample_status)
    if not wrong.any():
        return []
    worst = int(np.where(wrong, np.nan_to_num(unbalanced, nan=np.inf), -1.0).argmax())
    amount, t = float(unbalanced[worst]), float(plan.t[worst])
    much = f"W τ − f is {amount:.3g} of the largest f" if np.isfinite(amount) else "they are not finite"
    message = f"The main efforts of {int(wrong.sum())} samples do not balance the motion: at t = {t:.6g} s {much}."
    return [Deviation("main efforts", t, amount, message)]


def _sample_deviations(plan: Plan, again: Plan) -> list[Deviation]:
    deviations = []
    for name, what in (
        ("carrier_force", "forces of the carriers"),
        ("actuated_rate", "rates of the main actuators"),
        ("margin", "margin"),
    ):
        deviations += _compared(what, plan.t, getattr(plan, name), getattr(again, name), SAME)
    return deviations


def _motion_deviations(plan: Plan) -> list[Deviation]:
    """Compare the samples with the functions of time that the plan carries."""
    functions = plan.functions
    if functions is None:
        return []
    there = functions.platform.sample_at(plan.t)
    left, right = (functions.carriers_at(plan.t, side) for side in ("left", "right"))
    # backward differences move a carrier by its new speed, the motion by the mean of both: half a step apart
    step = float(np.diff(plan.t).max(initial=0.0))
    slack = step * float(np.abs(plan.carriers.sd).max(initial=0.0)) if plan.planner == "stepwise" else 0.0
    nearest = np.minimum(np.abs(plan.carriers.sdd - left.sdd), np.abs(plan.carriers.sdd - right.sdd))
    nearest[0] = 0.0  # a sample belongs to the step that it ends, the first to none
    deviations = []
    for name in ("x", "xd", "xdd"):
        ours, theirs = getattr(plan.motion, name), getattr(there, name)
        deviations += _compared(f"platform motion {name}", plan.t, ours, theirs, SAME)
    for name, ours, theirs, allowed, room in (
        ("s", plan.carriers.s, right.s, SAME, slack),
        ("sd", plan.carriers.sd, right.sd, SAME, 0.0),
        ("sdd", plan.carriers.sdd, plan.carriers.sdd - nearest, 1e3 * SAME, 0.0),
    ):
        deviations += _compared(f"carrier motion {name}", plan.t, ours, theirs, allowed, room)
    return deviations


def _compared(what: str, t: Array, ours: Array, theirs: Array, allowed: float, slack: float = 0.0) -> list[Deviation]:
    """Return where values (N, ...) of a plan deviate most, if by more than a fraction of the largest and a slack."""
    ours, theirs = np.asarray(ours).reshape(len(t), -1), np.asarray(theirs).reshape(len(t), -1)
    known = np.isfinite(ours), np.isfinite(theirs)
    apart = np.abs(np.where(known[0], ours, 0.0) - np.where(known[1], theirs, 0.0))
    apart[known[0] != known[1]] = np.inf
    size = float(np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0))
    worst = int(apart.max(axis=1, initial=0.0).argmax())
    amount = float(apart[worst].max(initial=0.0))
    if amount <= allowed * max(size, 1e-9) + slack:
        return []
    time = float(t[worst])
    return [Deviation(what, time, amount, f"{what.capitalize()}: off by {amount:.3g} at t = {time:.6g} s.")]


def _verdict_deviations(plan: Plan, again: Plan) -> list[Deviation]:
    deviations = []
    if plan.between is not None and again.between is not None:
        ours, theirs = plan.between.peak, again.between.peak
        apart = np.abs(ours - theirs) if np.isfinite([ours, theirs]).all() else np.where(ours == theirs, 0.0, np.inf)
        if (apart > SAME_PEAK * max(float(theirs.max(initial=0.0)), 1e-9)).any():
            j = int(apart.argmax())
            message = f"The peak effort of {plan.robot.actuated[j]} is {theirs[j]:.6g}, not {ours[j]:.6g}."
            deviations.append(Deviation("peak effort", float(again.between.time[j]), float(apart[j]), message))
    reported = {(one.carrier, one.quantity) for one in plan.limits.violated}
    seen = {(one.carrier, one.quantity): one for one in reversed(again.limits.violated)}  # the first of each counts
    for (carrier, quantity), event in sorted(seen.items(), key=lambda item: item[0]):
        if (carrier, quantity) not in reported:
            message = f"The {quantity} of {carrier} exceeds its limit by {event.amount:.4g} at t = {event.worst:.6g} s."
            deviations.append(Deviation("limits", event.worst, event.amount, message))
    unseen = plan.between is None and again.status is ResultStatus.UNRESOLVED  # version 0.1.0 did not look there
    if plan.status is not again.status and not unseen:
        message = f"The status is {again.status.value}, not {plan.status.value}."
        deviations.append(Deviation("status", float("nan"), float("nan"), message))
    return deviations
