"""A plan: platform motion, carrier motion and all efforts, with what limits them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, frozen, largest, peak, read_only
from redundancy_pin.dynamics.base import DynamicsAlongMotion
from redundancy_pin.dynamics.distribution import SampleStatus, distribute
from redundancy_pin.errors import InputError
from redundancy_pin.io.archive import write_archive
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.limits import LimitEvent, LimitReport, check_limits
from redundancy_pin.planners.robot_record import RobotRecord, robot_record
from redundancy_pin.robot import CarrierLimits

PLAN_FORMAT = "redundancy_pin plan"
"""What a saved plan calls itself."""

PLAN_VERSION = 1
"""Version of the file format: counts up whenever an older reader would misread a newer file."""


class PlanStatus(Enum):
    """What may be said of a plan as a whole."""

    WITHIN_LIMITS = "within_limits"
    """Every sample has finite efforts and every limit of the carriers holds."""
    VIOLATES_LIMITS = "violates_limits"
    """Efforts are finite, but a limit of a carrier is broken: see ``limits.violated``."""
    UNBOUNDED_EFFORT = "unbounded_effort"
    """Some sample has no finite main effort: see ``sample_status``."""
    STOPPED_EARLY = "stopped_early"
    """Every limit holds, but the optimiser stopped before it had an optimum: there may be a better plan."""


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """What a planner returns; the arrays are read-only. N samples, n coordinates, m main actuators, k carriers.

    Attributes:
        motion: platform motion; instants where an acceleration jumps appear twice.
        carriers: carrier motion.
        tau: (N, m) main efforts, N or N·m.
        carrier_force: (N, k) forces of the carriers' actuators, N.
        actuated_rate: (N, m) rates of the main actuators, m/s or rad/s.
        sample_status: (N,) a ``dynamics.distribution.SampleStatus`` each.
        residual: (N,) scaled norm of W τ − f, N.
        margin: (N,) smallest singular value of the scaled W.
        condition: (N,) condition number of the scaled W.
        phase: (N,) index into ``phases``: what the planner was doing.
        phases: names of the phases.
        limits: limits broken and touched.
        status: what may be said of the whole.
        planner: name of the planner.
        backend: name of the backend.
        robot: the robot, in plain data.
        parameters: the planner's parameters, in plain data.
        diagnostics: the planner's findings (instants, counts, …), in plain data.
    """

    motion: PlatformMotion
    carriers: CarrierMotion
    tau: Array
    carrier_force: Array
    actuated_rate: Array
    sample_status: IntArray
    residual: Array
    margin: Array
    condition: Array
    phase: IntArray
    phases: tuple[str, ...]
    limits: LimitReport
    status: PlanStatus
    planner: str
    backend: str
    robot: RobotRecord
    parameters: Mapping[str, object] = field(default_factory=dict)
    diagnostics: Mapping[str, object] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return what tells plans apart, not their arrays."""
        main, moved = self.robot.actuated, self.robot.carriers
        return (
            f"Plan({self.robot.name!r}, {self.planner!r}, {self.backend!r}, {self.status.value}; "
            f"N={len(self.t)}, t={self.t[0]:g}..{self.t[-1]:g} s, n={self.motion.xd.shape[1]}, m={len(main)}, "
            f"k={len(moved)}; {peak('tau', self.tau, self.robot.effort_unit(*main))}, "
            f"{peak('carrier_force', self.carrier_force, self.robot.effort_unit(*moved))})"
        )

    @property
    def t(self) -> Array:
        """(N,) time, s."""
        return self.motion.t

    @property
    def main_power(self) -> Array:
        """(N, m) power of the main actuators, W."""
        power: Array = self.tau * self.actuated_rate
        return power

    @property
    def carrier_power(self) -> Array:
        """(N, k) power of the carriers' actuators, W."""
        power: Array = self.carrier_force * self.carriers.sd
        return power

    @property
    def main_energy(self) -> float:
        """∫ Σ |τ q̇| dt of the main actuators, J: what motors that cannot recover energy would draw."""
        return _absolute_integral(self.main_power, self.t)

    @property
    def carrier_energy(self) -> float:
        """∫ Σ |F ṡ| dt of the carriers' actuators, J."""
        return _absolute_integral(self.carrier_power, self.t)

    @property
    def peak_effort(self) -> Array:
        """(m,) largest |τ| of each main actuator over the samples with finite efforts, N or N·m."""
        return largest(self.tau)

    @property
    def rms_effort(self) -> Array:
        """(m,) root mean square of each main effort over time, N or N·m."""
        duration = float(self.t[-1] - self.t[0])
        square = np.where(np.isfinite(self.tau), self.tau, 0.0) ** 2
        mean: Array = np.sqrt(np.trapezoid(square, self.t, axis=0) / duration) if duration > 0 else np.abs(self.tau[0])
        return mean

    def save(self, path: str | Path) -> None:
        """Write the plan to a file without loss (npz with JSON inside); ``load_plan`` reads it.

        Raises:
            OutputError: the file cannot be written; an earlier one is as it was.
            InputError: ``parameters`` or ``diagnostics`` hold something that is not plain data.
        """
        write_archive(path, PLAN_FORMAT, PLAN_VERSION, self)


def _absolute_integral(power: Array, t: Array) -> float:
    return float(np.trapezoid(np.abs(np.where(np.isfinite(power), power, 0.0)).sum(axis=1), t))


def require_dynamics(dynamics: object) -> None:
    """Check that the first argument of a planner is a backend.

    Raises:
        InputError: it is a robot, or something else.
    """
    if not (hasattr(dynamics, "along") and hasattr(dynamics, "robot")):
        raise InputError(
            f"The planner was given {type(dynamics).__name__} for the dynamics.",
            remedy="Pass a backend of the robot: RneaDynamics(robot) or VirtualWork(robot).",
        )


def require_motion(motion: object, *methods: str) -> None:
    """Check that a motion is sampled, or a trajectory that offers some methods.

    Raises:
        InputError: it is neither.
    """
    if not isinstance(motion, PlatformMotion) and not all(hasattr(motion, method) for method in methods):
        raise InputError(
            f"The planner was given {type(motion).__name__} for the motion.",
            remedy="Pass a trajectory, such as trajectory.reference.circle(), or a PlatformMotion.",
        )


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
