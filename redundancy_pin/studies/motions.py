"""Motions without a planner: carriers parked or not there, by both backends, singular instants included exactly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.distribution import Distribution, SampleStatus, distribute
from redundancy_pin.errors import CrossCheckError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.crossings import Crossing, find_crossings
from redundancy_pin.studies.case import BACKENDS, RNEA, VIRTUAL_WORK, Case
from redundancy_pin.studies.table import Record, csv_text
from redundancy_pin.trajectory import Trajectory

PARITY_TOLERANCE = 1e-10
"""Largest relative difference between the backends: both are exact, so a thousandth of this is rounding already."""

CSV_DIGITS = 12
"""Significant digits in CSV files: beyond the differences between the backends, a third smaller than exact."""

_SAME_INSTANT = 1e-9
"""Sampling times this close to a singular instant, s, give way to it."""


@dataclass(frozen=True)
class SingularInstant:
    """A singularity that a motion passes.

    Attributes:
        t: time, s.
        x: platform coordinates there, m and rad.
        kind: ``"type_ii"`` and so on.
        uncontrolled: platform velocity that no actuator resists, unit length in scaled units.
        missing_force: norm of the part of f that no actuator effort balances, N, scaled. Near the instant the efforts
            grow as this force over the margin.
        status: name of the sample's status.
    """

    t: float
    x: tuple[float, ...]
    kind: str
    uncontrolled: tuple[float, ...]
    missing_force: float
    status: str

    @property
    def unbounded(self) -> bool:
        """Whether the efforts grow without bound towards the instant."""
        return self.status == SampleStatus.SINGULAR_INCONSISTENT.label


@dataclass(frozen=True, eq=False)
class MotionRun:
    """A motion by both backends.

    Samples of the motion are every dt, jumps two-sided, singular instants exact. ``reduced`` (f, W, carrier forces) and
    ``solved`` (main efforts with their statuses) are by backend; ``parity`` has the largest differences of f, W,
    carrier_force and tau (regular samples) relative to the largest value.
    """

    case: Case
    robot: Robot
    trajectory: Trajectory
    motion: PlatformMotion
    reduced: Mapping[str, ReducedDynamics]
    solved: Mapping[str, Distribution]
    instants: tuple[SingularInstant, ...]
    parity: Mapping[str, float]

    @property
    def t(self) -> Array:
        """(N,) time, s."""
        return self.motion.t

    @property
    def distribution(self) -> Distribution:
        """Efforts by the RNEA backend, from which figures and numbers are taken."""
        return self.solved[RNEA]

    @property
    def worst_parity(self) -> float:
        """The largest difference of the backends; NaN if one of them is."""
        return float(np.max(list(self.parity.values())))

    @property
    def peaks(self) -> Array:
        """(m,) largest |τ| over the regular samples, N or N·m.

        Towards a singularity at which efforts are unbounded this is a value at the edge of the near-singular window and
        says nothing about the machine; ``statement`` says so.
        """
        regular = self.distribution.status == SampleStatus.REGULAR
        largest: Array = np.abs(self.distribution.tau[regular]).max(axis=0, initial=0.0)
        return largest

    @property
    def status_counts(self) -> dict[str, int]:
        """Number of samples of each status that occurs."""
        counts = Counter(self.distribution.status.tolist())
        return {SampleStatus(value).label: counts[value] for value in sorted(counts)}

    @property
    def near_singular_windows(self) -> tuple[tuple[float, float], ...]:
        """Time intervals, s, in which samples are near-singular or singular."""
        return windows(self.t, self.distribution.status != SampleStatus.REGULAR)

    @property
    def bounded(self) -> bool:
        """Whether the efforts stay finite along the whole motion."""
        return not any(instant.unbounded for instant in self.instants)

    @property
    def statement(self) -> str:
        """What the efforts do, in a line."""
        peaks = ", ".join(f"{peak:.3g}" for peak in self.peaks) + f" {self.case.unit}"
        if not self.instants:
            return f"bounded: peaks {peaks}"
        shown = [instant for instant in self.instants if instant.unbounded or self.bounded]
        places = ", ".join(f"{instant.t:.4f} s" for instant in shown)
        if self.bounded:
            return f"finite through the singularities at t = {places}: peaks {peaks}"
        missing = ", ".join(f"{instant.missing_force:.3g}" for instant in shown)
        return f"unbounded at t = {places}: {missing} N that no actuator can carry there"

    def record(self) -> Record:
        """Return the run in numbers, for tables and JSON."""
        return {
            "title": self.case.title,
            "configuration": self.case.as_dict(),
            "duration": self.trajectory.duration,
            "samples": len(self.motion),
            "bounded": self.bounded,
            "statement": self.statement,
            "effort_unit": self.case.unit,
            "regular_peaks": self.peaks,
            "carrier_force_peaks": np.abs(self.reduced[RNEA].carrier_force).max(axis=0, initial=0.0),
            "statuses": self.status_counts,
            "smallest_margin": self.distribution.margin.min(),
            "near_singular_windows": self.near_singular_windows,
            "singular_instants": [{**vars(instant), "unbounded": instant.unbounded} for instant in self.instants],
            "parity": {**self.parity, "worst": self.worst_parity},
        }

    def csv(self) -> str:
        """Return motion, efforts of both backends, carrier forces, status, margin and condition as CSV text.

        An instant that occurs twice is a jump of the acceleration, seen from both sides. Efforts are ``nan`` where none
        exist.
        """
        motion, solved = self.motion, self.distribution
        columns = {"t": motion.t, "x": motion.x, "xd": motion.xd, "xdd": motion.xdd, "tau": solved.tau,
                   "tau_virtual_work": self.solved[VIRTUAL_WORK].tau,
                   "carrier_force": self.reduced[RNEA].carrier_force, "status": solved.status_labels,
                   "margin": solved.margin, "condition": solved.condition, "residual": solved.residual}  # fmt: skip
        return csv_text(columns, digits=CSV_DIGITS)


def run(case: Case) -> MotionRun:
    """Run a motion, carriers parked or none, by both backends; CrossCheckError where these differ."""
    robot, trajectory = case.load_robot(), case.trajectory()
    crossings = find_crossings(robot, trajectory)
    motion = sample_with(trajectory, case.dt, np.array([crossing.t for crossing in crossings]))
    carriers = CarrierMotion.parked(len(motion), robot.k)
    reduced = {name: backend(robot).reduce(motion, carriers) for name, backend in BACKENDS.items()}
    solved = {name: distribute(reduction) for name, reduction in reduced.items()}
    parity = _parity(list(reduced.values()), list(solved.values()))
    if not max(parity.values()) <= PARITY_TOLERANCE:
        listed = ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in parity.items())
        raise CrossCheckError(
            f"The backends differ along {case.name} by more than {PARITY_TOLERANCE:g} (relative): {listed}.",
            remedy="One of them is wrong: run `redundancy-pin validate` to see where.",
            experiment=case.name,
            parity=parity,
        )
    instants = tuple(_instant(crossing, motion, solved[RNEA]) for crossing in crossings)
    return MotionRun(case, robot, trajectory, motion, reduced, solved, instants, parity)


def sample_with(trajectory: Trajectory, dt: float, instants: Array) -> PlatformMotion:
    """Return samples every ``dt``, s, and at (c,) increasing instants, jumps of the acceleration two-sided.

    A regular time that all but coincides with an instant is left out.
    """
    grid = np.unique(trajectory.sample(dt, two_sided=False).t)
    if len(instants):
        apart = np.abs(grid[:, None] - instants[None, :]).min(axis=1) > _SAME_INSTANT
        grid = np.sort(np.concatenate([grid[apart], instants]))
    return trajectory.sample(times=grid)


def windows(t: Array, inside: BoolArray) -> tuple[tuple[float, float], ...]:
    """Return first and last time, s, of each run of true samples (N,) at times (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    return tuple((float(t[first]), float(t[after - 1])) for first, after in edges.reshape(-1, 2))


def relative_difference(a: Array, b: Array) -> float:
    """Return the largest |a − b| over the largest |a| or |b|; 0 where both are zero or empty, NaN if one has a NaN."""
    if a.size == 0:
        return 0.0
    size = max(float(np.abs(a).max()), float(np.abs(b).max()))
    return float(np.abs(a - b).max()) / size if size != 0.0 else 0.0


def _parity(reduced: Sequence[ReducedDynamics], solved: Sequence[Distribution]) -> dict[str, float]:
    first, second = reduced
    regular = solved[0].status == SampleStatus.REGULAR
    pairs = {name: (getattr(first, name), getattr(second, name)) for name in ("f", "W", "carrier_force")}
    pairs["tau"] = (solved[0].tau[regular], solved[1].tau[regular])
    return {name: relative_difference(*pair) for name, pair in pairs.items()}


def _instant(crossing: Crossing, motion: PlatformMotion, solved: Distribution) -> SingularInstant:
    sample = int(np.argmin(np.abs(motion.t - crossing.t)))
    return SingularInstant(
        t=float(motion.t[sample]),
        x=tuple(float(value) for value in np.atleast_1d(motion.x[sample])),
        kind=crossing.kind.label,
        uncontrolled=tuple(float(value) for value in solved.uncontrolled[sample]),
        missing_force=float(solved.residual[sample]),
        status=SampleStatus(solved.status[sample]).label,
    )
