"""Turn a planned carrier motion into a ``Plan``: efforts, statuses, limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, frozen, read_only
from redundancy_pin.dynamics.base import DynamicsAlongMotion
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.status import SampleStatus
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.limits import LimitEvent, check_limits
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.robot import CarrierLimits

BALANCE_TOLERANCE = 1e-6
"""Largest imbalance W τ − f, relative to the size of f along the motion, of efforts that a planner prescribes."""


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
    between: Sequence[tuple[Array, CarrierMotion]] = (),
) -> Plan:
    """Evaluate the backend once more along the planned motion and collect everything a plan carries.

    Args:
        along: dynamics along the platform motion of the plan.
        carriers: planned carrier motion, N samples.
        planner: name of the planner.
        phase: (N,) index of the phase of each sample.
        phases: names of the phases.
        parameters: the planner's parameters.
        diagnostics: what it found.
        prescribed: (N, m) main efforts the planner decided on, NaN where W τ = f decides. Their imbalance is checked
            and reported, never corrected.
        carrier_limits: limits to judge the plan by in place of the robot's own, one for each carrier.
        between: times, s, and carrier motions between the samples at which the limits of track, speed and acceleration
            are judged as well.
    """
    robot = along.robot
    reduced = along.reduce(carriers)
    solved = distribute(reduced)
    tau, status, residual = np.array(solved.tau), np.array(solved.status), np.array(solved.residual)
    if prescribed is not None:
        given = np.isfinite(prescribed).all(axis=1)
        tau[given] = prescribed[given]
        imbalance = np.einsum("nij,nj->ni", reduced.W, tau) - reduced.f
        imbalance = np.linalg.norm(imbalance / reduced.row_scale, axis=1)
        residual[given] = imbalance[given]
        size = float(np.abs(reduced.f / reduced.row_scale).max())
        status[given] = _status_of_prescribed(imbalance[given] <= BALANCE_TOLERANCE * size)
    judged = robot if carrier_limits is None else replace(robot, carrier_limits=carrier_limits)
    limits = check_limits(judged, along.motion.t, carriers, reduced.carrier_force)
    for times, motion in between:
        # the forces are not known there
        inner = check_limits(judged, times, motion, np.zeros_like(motion.s))
        limits = replace(limits, violated=_merged(limits.violated, inner.violated))
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
        limits=limits,
        status=_plan_status(tau, status, bool(limits.violated)),
        planner=planner,
        backend=_backend_name(along),
        robot=robot_record(robot),
        parameters=dict(parameters),
        diagnostics=dict(diagnostics),
    )


def _merged(at_samples: tuple[LimitEvent, ...], between: tuple[LimitEvent, ...]) -> tuple[LimitEvent, ...]:
    """Return the events, an event at samples replaced by one that overlaps it and exceeds the limit by more."""
    kept = list(at_samples)
    for event in between:
        same = [
            other
            for other in kept
            if (other.carrier, other.quantity, other.limit) == (event.carrier, event.quantity, event.limit)
            and other.start <= event.end
            and event.start <= other.end
        ]
        if all(event.amount > other.amount for other in same):
            kept = [other for other in kept if other not in same] + [event]
    return tuple(sorted(kept, key=lambda event: event.start))


def _status_of_prescribed(balanced: BoolArray) -> IntArray:
    status: IntArray = np.where(balanced, SampleStatus.REGULAR, SampleStatus.SINGULAR_INCONSISTENT).astype(np.intp)
    return status


def _plan_status(tau: Array, status: IntArray, violated: bool) -> PlanStatus:
    if not np.isfinite(tau).all() or (status > SampleStatus.SINGULAR_CONSISTENT).any():
        return PlanStatus.UNBOUNDED_EFFORT
    return PlanStatus.VIOLATES_LIMITS if violated else PlanStatus.WITHIN_LIMITS


def _backend_name(along: DynamicsAlongMotion) -> str:
    return type(along).__name__.replace("AlongMotion", "").replace("Along", "")
