"""Validation of plans: of a new plan as its planner returns it, and of a plan with recorded results.

``finish_plan`` judges: W τ = f at the samples, limits at the samples and between them, the peaks of the continuous
motion, and the status that follows. ``check_plan`` validates a plan again and compares the results.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, read_only, require_type
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.io.summary import Summary, TextTable, number, row
from redundancy_pin.planners.intersample_check import (
    BALANCE_TOLERANCE,
    IntersampleCheck,
    PlannedMotion,
    closure_rank_losses,
    imbalance,
    intersample_check,
)
from redundancy_pin.planners.limits import OF_CARRIERS, LimitEvent, LimitReport, worst_events
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import record_difference, robot_record
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus, SampleStatus, solved_status

SAME = 1e-6
"""Deviation of forces, rates and motions, relative to the largest, that two backends, or two machines, may show."""

SAME_PEAK = 1e-3
"""Relative deviation of a peak between the samples: near a singularity W⁻¹ magnifies the rounding of the plan."""


def finish_plan(planned: PlannedMotion, check: IntersampleCheck | None = None) -> Plan:
    """Evaluate a planned motion at its samples and between them, and collect everything a plan carries.

    Args:
        planned: the motion, its dynamics and its limits.
        check: what ``intersample_check`` found, where the planner has it already.

    Returns:
        The plan, with the status that follows. An imbalance of prescribed efforts is reported, never corrected.
    """
    robot, along, samples, limits = planned.dynamics.robot, planned.along, planned.samples, planned.limits
    motion, carriers, reduced = planned.motion, planned.carriers, planned.reduced
    check = intersample_check(planned) if check is None else check
    status = ResultStatus.OK if check.peaks.passed else ResultStatus.UNRESOLVED
    if not planned.findings.optimal:
        status = ResultStatus.NOT_CONVERGED
    if check.violated:
        status = ResultStatus.LIMIT_VIOLATED
    known = np.isfinite(samples.tau).all() and solved_status(samples.status).all()
    if not known or not np.isfinite(check.peaks.peak).all():
        status = ResultStatus.UNBOUNDED
    phase = np.zeros(len(motion)) if planned.phase is None else planned.phase
    return Plan(
        motion=motion,
        carriers=carriers,
        tau=samples.tau,
        carrier_force=reduced.carrier_force,
        actuated_rate=read_only(np.einsum("nim,ni->nm", reduced.W, motion.xd)),
        sample_status=samples.status,
        residual=samples.residual,
        margin=samples.margin,
        condition=samples.condition,
        phase=read_only(np.array(phase, dtype=np.intp)),
        phases=planned.phases,
        limits=LimitReport(check.violated, check.touched, limits),
        status=status,
        planner=planned.planner,
        backend=type(along).__name__.replace("AlongMotion", "").replace("Along", ""),
        robot=robot_record(robot),
        parameters=dict(planned.parameters),
        findings=replace(
            planned.findings,
            closure_rank=closure_rank_losses(planned.dynamics, along, planned.functions.platform),
        ),
        diagnostics=dict(planned.diagnostics),
        functions=planned.functions,
        between=check.peaks,
    )


# --- a plan validated again ---


@dataclass(frozen=True)
class Deviation:
    """A difference between the values recorded in a plan and the dynamics of its robot.

    Attributes:
        quantity: what deviates, such as "main efforts" or "status".
        time: time of the largest deviation, s; NaN for a quantity without a time.
        amount: by how much, in the unit of the quantity; NaN for what has none.
        message: the same in words.
    """

    quantity: str
    time: float
    amount: float
    message: str


@dataclass(frozen=True, eq=False)
class PlanCheck:
    """Result of evaluating a plan by the dynamics of its robot.

    Attributes:
        status: status by this evaluation.
        violated: limits that are broken, by time.
        peak_effort: (m,) largest |τ| of the continuous motion, N or N·m.
        imbalance: largest |W τ − f| at a sample, relative to the largest f.
        deviations: differences between the recorded and the evaluated plan; empty if they agree.
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
        """Whether the recorded and the evaluated plan agree; a plan whose status reports broken limits can pass."""
        return not self.deviations

    def summary(self, plan: Plan) -> Summary:
        """Return a summary of the check: a mapping, whose ``print`` is a table. ``plan``: the plan that was checked.

        Example:
            >>> print(check_plan(plan, robot).summary(plan))
        """
        facts: dict[str, Any] = {
            "passed": self.passed,
            "status": self.status.value,
            "saved_status": plan.status.value,
            **{name: getattr(self, name) for name in ("imbalance", "peak_effort", "wider_limits", "closure_rank")},
            "limits": {"violated": [vars(event) for event in self.violated]},
            "deviations": [vars(deviation) for deviation in self.deviations],
        }
        rows = [
            ("is what it says", "yes" if self.passed else "NO"),
            ("status", self.status.value.replace("_", " ")),
            ("largest imbalance of W τ = f", number(self.imbalance)),
            (f"peak main effort [{plan.robot.effort_units[0]}]", row(self.peak_effort)),
            ("limits broken", str(len(self.violated)) if self.violated else "none"),
            *(("deviation", deviation.message) for deviation in self.deviations),
            *(("wider limit", note) for note in self.wider_limits),
        ]
        losses: Any = self.closure_rank
        for loss in losses:
            where = f"at t = {loss['time']:.6g} s, x = {row(np.ravel(loss['x']))}"
            rows.append(("closures lose rank", f"{where}: solution branches meet there"))
        return Summary(facts, TextTable(f"{plan.robot.name}, {plan.planner.replace('_', ' ')}", rows))


@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def check_plan(plan: Plan, dynamics: DynamicsLike) -> PlanCheck:
    """Validate a plan again from its motion: W τ = f, limits, efforts between the samples, and the status that follows.

    The recorded values (efforts, forces, rates, margins, limits, peaks, status) are compared with the dynamics of the
    motion of platform and carriers. Any backend of the plan's robot will do; the one that the plan
    was not made by judges it independently. Whether the plan is an optimum is not judged again.

    Args:
        plan: the plan.
        dynamics: the robot of the plan (``load_robot_of(plan)``), for generated code (``as_dynamics``); or a backend.

    Returns:
        Result of the dynamics, and the deviations of the plan from it.

    Raises:
        InputError: neither a robot nor a backend, or of another robot.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as ``Dynamics.along``.

    Example:
        >>> plan = rp.plan_switch_off("2rpr", rp.trajectory.reference.line(speed=0.2), threshold=5.0)
        >>> rp.check_plan(plan, rp.RneaDynamics("2rpr")).passed
        True
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
    # W τ = f does not determine the efforts there: their limit is computed again
    on_singularity = plan.sample_status == SampleStatus.SINGULAR_CONSISTENT
    again = finish_plan(
        PlannedMotion(
            dynamics,
            plan.functions,
            along,
            plan.carriers,
            plan.limits.judged_by,
            plan.planner,
            prescribed=np.where((balanced & ~on_singularity)[:, None], plan.tau, np.nan),
            singular=np.flatnonzero(on_singularity),
            phase=plan.phase,
            phases=plan.phases,
            parameters=plan.parameters,
            findings=plan.findings,
        )
    )
    return PlanCheck(
        status=again.status,
        violated=again.limits.violated,
        peak_effort=again.peak_effort,
        imbalance=float(np.nanmax(unbalanced, initial=0.0)),
        deviations=_deviations(plan, again, unbalanced),
        wider_limits=_wider_limits(plan, dynamics.robot),
        closure_rank=again.findings.closure_rank,
    )


def _wider_limits(plan: Plan, robot: Robot) -> tuple[str, ...]:
    """Return notes of limits that are wider than the robot's own."""
    judged = plan.limits.judged_by
    own, used = Limits(effort=np.inf).resolved(robot).bounds, judged.bounds
    carriers = (
        f"{name}: judged by a {quantity} of {used[0][i, j]:g} to {used[1][i, j]:g}, the robot's own is "
        f"{own[0][i, j]:g} to {own[1][i, j]:g}."
        for j, name in enumerate(robot.carriers)
        for i, quantity in enumerate(OF_CARRIERS)
        if used[0][i, j] < own[0][i, j] or used[1][i, j] > own[1][i, j]
    )
    declared = (
        ("effort", *robot.effort_limits, judged.effort),
        ("speed", -robot.speed_limits, robot.speed_limits, judged.actuator_speed),
    )
    motors = (
        f"{name}: judged by {quantity} up to {bound:g}, the robot's own is "
        + (f"{most:g}." if least == -most else f"{least:g} to {most:g}.")
        for quantity, *columns in declared
        for name, least, most, bound in zip(robot.actuated, *columns, strict=True)
        if -bound < least or bound > most
    )
    return (*carriers, *motors)


def _deviations(plan: Plan, again: Plan, unbalanced: Array) -> tuple[Deviation, ...]:
    """Return the deviations of a plan from its evaluation ``again``; ``unbalanced`` (N,): of its efforts."""
    motion, carriers, platform = plan.motion, plan.carriers, plan.functions.platform.sample_at(plan.t)
    left, right = plan.functions.carriers_at(plan.t, "left"), plan.functions.carriers_at(plan.t, "right")
    sdd = np.where(np.abs(carriers.sdd - left.sdd) < np.abs(carriers.sdd - right.sdd), left.sdd, right.sdd)
    step = 0.0
    if plan.planner == "stepwise":
        # Backward differences (Parsa 2014, eqs. 4.3 and 4.4) move a carrier by its new speed, a motion by the mean of
        # both speeds: positions differ by half a step. A sample belongs to the step that it ends, the first to none.
        # The samples keep the thesis's motion: its largest efforts at samples differ by up to 2 % from the function's.
        step, sdd[0] = float(np.diff(plan.t).max(initial=0.0)), carriers.sdd[0]
    slack = step * float(np.abs(carriers.sd).max(initial=0.0))
    table = (
        ("forces of the carriers", plan.carrier_force, again.carrier_force, SAME, 0.0),
        ("rates of the main actuators", plan.actuated_rate, again.actuated_rate, SAME, 0.0),
        ("margin", plan.margin, again.margin, SAME, 0.0),
        ("platform motion x", motion.x, platform.x, SAME, 0.0),
        ("platform motion xd", motion.xd, platform.xd, SAME, 0.0),
        ("platform motion xdd", motion.xdd, platform.xdd, SAME, 0.0),
        ("carrier motion s", carriers.s, right.s, SAME, slack),
        ("carrier motion sd", carriers.sd, right.sd, SAME, 0.0),
        ("carrier motion sdd", carriers.sdd, sdd, 1e3 * SAME, 0.0),
    )
    compared = (_compared(what, plan.t, ours, theirs, part, room) for what, ours, theirs, part, room in table)
    found = (
        _unbalanced(plan, unbalanced),
        _other_limit_efforts(plan, again),
        *compared,
        _other_peak(plan, again),
        *_other_limits(plan, again),
    )
    status = None
    if plan.status is not again.status:
        message = f"The status is {again.status.value}, not {plan.status.value}."
        status = Deviation("status", float("nan"), float("nan"), message)
    return tuple(one for one in (*found, status) if one is not None)


def _compared(what: str, t: Array, ours: Array, theirs: Array, allowed: float, slack: float) -> Deviation | None:
    """Return where values (N, ...) of a plan deviate most, if by more than a fraction of the largest and a slack."""
    ours, theirs = np.asarray(ours).reshape(len(t), -1), np.asarray(theirs).reshape(len(t), -1)
    known = np.isfinite(ours), np.isfinite(theirs)
    distance = np.abs(np.where(known[0], ours, 0.0) - np.where(known[1], theirs, 0.0))
    distance[known[0] != known[1]] = np.inf
    size = float(np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0))
    worst = int(distance.max(axis=1, initial=0.0).argmax())
    amount, time = float(distance[worst].max(initial=0.0)), float(t[worst])
    if amount <= allowed * max(size, 1e-9) + slack:
        return None
    return Deviation(what, time, amount, f"{what.capitalize()}: off by {amount:.3g} at t = {time:.6g} s.")


def _unbalanced(plan: Plan, unbalanced: Array) -> Deviation | None:
    wrong = ~(unbalanced <= BALANCE_TOLERANCE) & solved_status(plan.sample_status)
    if not wrong.any():
        return None
    worst = int(np.where(wrong, np.nan_to_num(unbalanced, nan=np.inf), -1.0).argmax())
    amount, t = float(unbalanced[worst]), float(plan.t[worst])
    much = f"W τ − f is {amount:.3g} of the largest f" if np.isfinite(amount) else "they are not finite"
    message = f"The main efforts of {int(wrong.sum())} samples do not balance the motion: at t = {t:.6g} s {much}."
    return Deviation("main efforts", t, amount, message)


def _other_limit_efforts(plan: Plan, again: Plan) -> Deviation | None:
    """Return where efforts on a type II singularity are not those that W⁻¹ f tends to (``SingularInstant``)."""
    at = np.flatnonzero(plan.sample_status == SampleStatus.SINGULAR_CONSISTENT)
    distance = np.abs(plan.tau[at] - again.tau[at]).max(axis=1, initial=0.0)
    size = float(np.abs(again.tau[np.isfinite(again.tau)]).max(initial=1e-9))
    if not (distance > SAME_PEAK * size).any():
        return None
    worst = int(distance.argmax())
    amount, t = float(distance[worst]), float(plan.t[at[worst]])
    message = f"The main efforts at the singular instant t = {t:.6g} s are off by {amount:.3g} from their limits."
    return Deviation("main efforts", t, amount, message)


def _other_peak(plan: Plan, again: Plan) -> Deviation | None:
    ours, theirs = plan.between.peak, again.between.peak
    distance = np.abs(ours - theirs) if np.isfinite([ours, theirs]).all() else np.where(ours == theirs, 0.0, np.inf)
    if (distance <= SAME_PEAK * max(float(theirs.max(initial=0.0)), 1e-9)).all():
        return None
    j = int(distance.argmax())
    message = f"The peak effort of {plan.robot.actuated[j]} is {theirs[j]:.6g}, not {ours[j]:.6g}."
    return Deviation("peak effort", float(again.between.time[j]), float(distance[j]), message)


def _other_limits(plan: Plan, again: Plan) -> list[Deviation]:
    """Return where a plan reports limits as exceeded that are not, or not as much, or leaves one out."""
    deviations = []
    reported, found = (
        {(event.joint, event.quantity): event for event in worst_events(one.limits.violated)} for one in (plan, again)
    )
    for key in sorted({*reported, *found}):
        event = found[key] if key in found else reported[key]
        stated, true = (events[key].amount if key in events else 0.0 for events in (reported, found))
        same = stated == true or abs(stated - true) <= SAME_PEAK * max(abs(event.value), abs(event.limit))
        if not same or (key in found and key not in reported):
            exceeds = f"exceeds its limit by {true:.4g}" if key in found else "keeps its limit"
            message = f"The {event.quantity} of {event.joint} {exceeds} at t = {event.worst:.6g} s"
            by = f", not by {stated:.4g}." if key in reported else "."
            deviations.append(Deviation("limits", event.worst, abs(true - stated), message + by))
    return deviations
