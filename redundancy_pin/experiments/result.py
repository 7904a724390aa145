"""What running an experiment gives, and the numbers that are read off it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.distribution import Distribution, SampleStatus
from redundancy_pin.experiments.backends import RNEA, VIRTUAL_WORK
from redundancy_pin.experiments.experiment import Experiment
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class BackendOutcome:
    """What one backend says about the motion.

    Attributes:
        reduced: f, W and carrier forces.
        distribution: efforts of the main actuators with their statuses.
    """

    reduced: ReducedDynamics
    distribution: Distribution


@dataclass(frozen=True)
class SingularInstant:
    """A singularity that the motion passes.

    Attributes:
        t: time, s.
        sample: index of the sample at that time.
        x: platform coordinates there, m and rad.
        kind: ``"type_ii"`` and so on.
        uncontrolled: platform velocity that no actuator resists, unit length in scaled units.
        missing_force: norm of the part of f that no actuator effort balances, N, scaled. Near the instant the efforts
            grow as this force over the margin.
        status: name of the sample's status.
    """

    t: float
    sample: int
    x: tuple[float, ...]
    kind: str
    uncontrolled: tuple[float, ...]
    missing_force: float
    status: str

    @property
    def unbounded(self) -> bool:
        """Whether the efforts grow without bound towards the instant."""
        return self.status == SampleStatus.SINGULAR_INCONSISTENT.label


@dataclass(frozen=True)
class Parity:
    """Largest differences between the backends, relative to the largest value along the motion.

    Attributes:
        f: of the generalised force.
        W: of the actuation matrix.
        carrier_force: of the carrier forces; 0 without carriers.
        tau: of the efforts, over the regular samples.
    """

    f: float
    W: float
    carrier_force: float
    tau: float

    @property
    def worst(self) -> float:
        """The largest of them; NaN if one of them is."""
        return float(np.max([self.f, self.W, self.carrier_force, self.tau]))


@dataclass(frozen=True, eq=False)
class Result:
    """An experiment that has run.

    Attributes:
        experiment: what was run.
        robot: the robot.
        trajectory: the reference trajectory.
        motion: its samples: every dt, jumps two-sided, singular instants exact.
        carriers: motion of the carriers.
        outcomes: by name of the backend.
        instants: singular instants, in time.
        parity: difference of the backends.
    """

    experiment: Experiment
    robot: Robot
    trajectory: Trajectory
    motion: PlatformMotion
    carriers: CarrierMotion
    outcomes: Mapping[str, BackendOutcome]
    instants: tuple[SingularInstant, ...]
    parity: Parity

    @property
    def t(self) -> Array:
        """(N,) time, s."""
        return self.motion.t

    @property
    def rnea(self) -> BackendOutcome:
        """Outcome of the RNEA backend, from which figures and numbers are taken."""
        return self.outcomes[RNEA]

    @property
    def virtual_work(self) -> BackendOutcome:
        """Outcome of the virtual-work backend."""
        return self.outcomes[VIRTUAL_WORK]

    @property
    def effort_unit(self) -> str:
        """Unit of the main efforts."""
        angular = self.rnea.reduced.column_scale != 1.0
        return "N·m" if angular.all() else "N"

    @property
    def peaks(self) -> Array:
        """(m,) largest |τ| over the regular samples, N or N·m.

        Towards a singularity at which efforts are unbounded this is a value at the edge of the near-singular window and
        says nothing about the machine; ``statement`` says so.
        """
        regular = self.rnea.distribution.status == SampleStatus.REGULAR
        largest: Array = np.abs(self.rnea.distribution.tau[regular]).max(axis=0, initial=0.0)
        return largest

    @property
    def status_counts(self) -> dict[str, int]:
        """Number of samples of each status that occurs."""
        counts = Counter(self.rnea.distribution.status.tolist())
        return {SampleStatus(value).label: counts[value] for value in sorted(counts)}

    @property
    def near_singular_windows(self) -> tuple[tuple[float, float], ...]:
        """Time intervals, s, in which samples are near-singular or singular."""
        return windows(self.t, self.rnea.distribution.status != SampleStatus.REGULAR)

    @property
    def bounded(self) -> bool:
        """Whether the efforts stay finite along the whole motion."""
        return not any(instant.unbounded for instant in self.instants)

    @property
    def statement(self) -> str:
        """One sentence on what the efforts do."""
        unit = self.effort_unit
        peaks = ", ".join(f"{peak:.3g}" for peak in self.peaks)
        if not self.instants:
            return f"bounded: peaks {peaks} {unit}"
        places = ", ".join(f"{instant.t:.4f} s" for instant in self.instants)
        if self.bounded:
            return f"finite through the singularities at t = {places}: peaks {peaks} {unit}"
        at = ", ".join(f"{instant.t:.4f} s" for instant in self.instants if instant.unbounded)
        missing = ", ".join(f"{instant.missing_force:.3g}" for instant in self.instants if instant.unbounded)
        return f"unbounded at t = {at}: {missing} N that no actuator can carry there"


def windows(t: Array, inside: BoolArray) -> tuple[tuple[float, float], ...]:
    """Return the time intervals (first and last time) of runs of true samples.

    Args:
        t: (N,) times, s.
        inside: (N,) true where a sample belongs to a run.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    return tuple((float(t[first]), float(t[after - 1])) for first, after in edges.reshape(-1, 2))
