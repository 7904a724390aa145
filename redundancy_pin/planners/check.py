"""A plan judged anew: what the robot's dynamics say of its motion, against what the plan says of itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.dynamics.base import Dynamics, ReducedDynamics
from redundancy_pin.dynamics.distribution import SampleStatus
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_return import POINTS
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.limits import QUANTITIES, ROUNDING, LimitEvent, limit_bounds, limits_broken
from redundancy_pin.planners.plan import (
    BALANCE_TOLERANCE,
    Plan,
    PlanStatus,
    finish_plan,
    imbalance,
    require_dynamics,
)
from redundancy_pin.planners.robot_record import record_difference, robot_record

SAME = 1e-6
"""Deviation of forces, rates and motions, relative to the largest, that two backends, or two machines, may show."""

SAME_PEAK = 1e-3
"""Relative deviation of a peak between the samples: beside a singularity W⁻¹ magnifies the rounding of the plan."""


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
    """

    status: PlanStatus
    violated: tuple[LimitEvent, ...]
    peak_effort: Array
    imbalance: float
    deviations: tuple[Deviation, ...]
    wider_limits: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the plan is what it says; a plan that says that it breaks limits may be."""
        return not self.deviations


@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def check_plan(plan: Plan, dynamics: Dynamics) -> PlanCheck:
    """Judge a plan anew from its motion: W τ = f, limits, efforts between the samples, and the status that follows.

    What the plan says of itself (efforts, forces, rates, margins, limits, peaks, status) is compared with what the
    dynamics say of the motion of platform and carriers. Any backend of the plan's robot will do; the one that the plan
    was not made by judges it independently.

    Args:
        plan: the plan.
        dynamics: either backend of its robot, such as ``RneaDynamics(load_robot_of(plan))``.

    Returns:
        What they say, and where the plan deviates from it.

    Raises:
        InputError: no backend, or one of another robot.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as ``Dynamics.along``.
    """
    require_dynamics(dynamics)
    other = record_difference(plan.robot, robot_record(dynamics.robot))
    if other:
        raise InputError(
            f"The plan is for another robot than the dynamics: {other}", remedy="Pass a backend of load_robot_of(plan)."
        )
    along = dynamics.along(plan.motion)
    reduced = along.reduce(plan.carriers)
    unbalanced, balanced = _imbalance(plan, reduced)
    efforts = plan.parameters.get("effort")
    functions = None if plan.motion.is_pose and plan.functions is None else plan.functions_of_time
    again = finish_plan(
        along,
        plan.carriers,
        planner=plan.planner,
        phase=plan.phase,
        phases=plan.phases,
        parameters=plan.parameters,
        diagnostics={},
        prescribed=np.where(balanced[:, None], plan.tau, np.nan),
        carrier_limits=plan.limits.judged_by,
        effort_limit=None if efforts is None else np.array(efforts, dtype=float),
        extremes=_extremes(plan, functions),
        functions=functions,
        dynamics=dynamics,
        singular=np.flatnonzero(plan.sample_status == SampleStatus.SINGULAR_CONSISTENT),
        optimal=bool(plan.diagnostics.get("optimal", True)),
    )
    jerk = _jerk_broken(plan)
    if jerk:
        worse = again.status is PlanStatus.UNBOUNDED_EFFORT
        status = again.status if worse else PlanStatus.VIOLATES_LIMITS
        limits = replace(again.limits, violated=tuple(sorted((*again.limits.violated, *jerk), key=lambda e: e.start)))
        again = replace(again, status=status, limits=limits)
    deviations = [
        *_effort_deviations(plan, unbalanced, balanced),
        *_sample_deviations(plan, again),
        *_motion_deviations(plan, functions),
        *_verdict_deviations(plan, again),
    ]
    worst = float(np.nanmax(unbalanced, initial=0.0))
    return PlanCheck(
        again.status, again.limits.violated, again.peak_effort, worst, tuple(deviations), _wider_limits(plan, dynamics)
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


def _imbalance(plan: Plan, reduced: ReducedDynamics) -> tuple[Array, BoolArray]:
    """Return (N,) |W τ − f| relative to the largest f, NaN without efforts, and whether it counts as balanced."""
    left, size = imbalance(reduced, plan.tau)
    relative = left / (size or 1.0)
    return relative, relative <= BALANCE_TOLERANCE


def _extremes(plan: Plan, functions: PlanFunctions | None) -> list[tuple[Array, CarrierMotion]]:
    """Return the carriers densely along their returns, whose extremes lie between the samples."""
    if functions is None or plan.planner != "stepwise":
        return []
    spans = plan.diagnostics.get("returns", ())
    end = float(plan.t[-1])
    times = [np.linspace(first, min(last, end), POINTS)[:-1] for first, last in spans if first < end]  # type: ignore[attr-defined]
    return [(t, functions.carriers_at(t)) for t in times]


def _jerk_broken(plan: Plan) -> tuple[LimitEvent, ...]:
    limit = plan.parameters.get("jerk")
    if limit is None:
        return ()
    step = np.diff(plan.t)
    inside = step > 0.0
    jerk = np.diff(plan.carriers.sdd, axis=0)[inside] / step[inside, None]
    most = np.array(limit, dtype=float)
    return limits_broken("jerk", plan.robot.carriers, plan.t[:-1][inside], jerk, most, 1.0 + ROUNDING)


def _effort_deviations(plan: Plan, unbalanced: Array, balanced: BoolArray) -> list[Deviation]:
    wrong = ~balanced & (plan.sample_status <= SampleStatus.SINGULAR_CONSISTENT)
    if not wrong.any():
        return []
    worst = int(np.where(wrong, np.nan_to_num(unbalanced, nan=np.inf), -1.0).argmax())
    amount, t = float(unbalanced[worst]), float(plan.t[worst])
    much = f"W τ − f is {amount:.3g} of the largest f" if np.isfinite(amount) else "they are not finite"
    message = f"The main efforts of {int(wrong.sum())} samples do not balance the motion: at t = {t:.6g} s {much}."
    return [Deviation("main efforts", t, amount, message)]


def _sample_deviations(plan: Plan, again: Plan) -> list[Deviation]:
    names = {
        "carrier_force": "forces of the carriers",
        "actuated_rate": "rates of the main actuators",
        "margin": "margin",
    }
    return [
        deviation
        for name, what in names.items()
        for deviation in _compared(what, plan.t, getattr(plan, name), getattr(again, name), SAME)
    ]


def _motion_deviations(plan: Plan, functions: PlanFunctions | None) -> list[Deviation]:
    """Compare the samples with the functions of time that the plan carries."""
    if functions is None or plan.functions is None:
        return []
    there = functions.platform.sample_at(plan.t)
    left, right = (functions.carriers_at(plan.t, side) for side in ("left", "right"))
    deviations = []
    for name in ("x", "xd", "xdd"):
        ours = np.asarray(getattr(plan.motion, name)).reshape(len(plan.t), -1)
        theirs = np.asarray(getattr(there, name)).reshape(len(plan.t), -1)
        deviations += _compared(f"platform motion {name}", plan.t, ours, theirs, SAME)
    # backward differences move a carrier by its new speed, the motion by the mean of both: half a step apart
    step = float(np.diff(plan.t).max(initial=0.0))
    slack = step * float(np.abs(plan.carriers.sd).max(initial=0.0)) if _by_differences(plan) else 0.0
    for name, part in (("s", right.s), ("sd", right.sd)):
        allowed = slack if name == "s" else 0.0
        deviations += _compared(f"carrier motion {name}", plan.t, getattr(plan.carriers, name), part, SAME, allowed)
    nearest = np.minimum(np.abs(plan.carriers.sdd - left.sdd), np.abs(plan.carriers.sdd - right.sdd))
    nearest[0] = 0.0  # a sample belongs to the step that it ends, the first to none
    return deviations + _compared(
        "carrier motion sdd", plan.t, plan.carriers.sdd, plan.carriers.sdd - nearest, 1e3 * SAME
    )


def _by_differences(plan: Plan) -> bool:
    return plan.planner == "stepwise" or plan.parameters.get("scheme") == "backward_differences"


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
            deviations.append(
                Deviation(
                    "peak effort",
                    float(again.between.time[j]),
                    float(apart[j]),
                    f"The peak effort of {plan.robot.actuated[j]} is {theirs[j]:.6g}, not {ours[j]:.6g}.",
                )
            )
    said, broken = ({(one.carrier, one.quantity) for one in judged.limits.violated} for judged in (plan, again))
    for carrier, quantity in sorted(broken - said):
        event = next(one for one in again.limits.violated if (one.carrier, one.quantity) == (carrier, quantity))
        deviations.append(
            Deviation(
                "limits",
                event.worst,
                event.amount,
                f"The {quantity} of {carrier} exceeds its limit by {event.amount:.4g} at t = {event.worst:.6g} s.",
            )
        )
    unseen = plan.between is None and again.status is PlanStatus.UNRESOLVED  # version 0.1.0 did not look there
    if plan.status is not again.status and not unseen:
        message = f"The status is {again.status.value}, not {plan.status.value}."
        deviations.append(Deviation("status", float("nan"), float("nan"), message))
    return deviations
