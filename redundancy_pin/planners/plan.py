"""A plan: platform motion, carrier motion and all efforts, with what limits them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import numpy as np

from redundancy_pin.arrays import Array, IntArray, largest, peak
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.archive import write_archive
from redundancy_pin.planners.limits import LimitReport
from redundancy_pin.planners.robot_record import RobotRecord

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
        sample_status: (N,) a ``dynamics.status.SampleStatus`` each.
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
