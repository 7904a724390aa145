"""Motions without a planner, run by both backends; and the numbers read off them and off plans."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, runs
from redundancy_pin.dynamics.backends import BACKENDS, RNEA, VIRTUAL_WORK
from redundancy_pin.dynamics.distribution import Distribution, distribute
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import CrossCheckError, InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.limits import worst_events
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.crossings import Crossing, find_crossings
from redundancy_pin.status import SampleStatus
from redundancy_pin.thesis.case import Case
from redundancy_pin.thesis.table import Record
from redundancy_pin.trajectory import Trajectory
from redundancy_pin.trajectory.csv_file import csv_rows, effort_columns, motion_columns

# --- motions without a planner: carriers parked or not there, singular instants included exactly --------------------

PARITY_TOLERANCE = 1e-10
"""Largest relative difference between the backends: both are exact, so a thousandth of this is rounding already."""

CSV_DIGITS = 12
"""Significant digits in CSV files: beyond the differences between the backends, a third smaller than exact."""

_SAME_INSTANT = 1e-9
"""Sampling times this close to a singular instant, s, give way to it."""


@dataclass(frozen=True)
class PassedSingularity:
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
    instants: tuple[PassedSingularity, ...]
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
        no property of the machine; see ``statement``.
        """
        regular = self.distribution.status == SampleStatus.OK
        largest: Array = np.abs(self.distribution.tau[regular]).max(axis=0, initial=0.0)
        return largest

    @property
    def near_singular_windows(self) -> tuple[tuple[float, float], ...]:
        """Time intervals, s, in which samples are near-singular or singular."""
        return windows(self.t, self.distribution.status != SampleStatus.OK)

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
            "statuses": self.distribution.status_counts,
            "smallest_margin": self.distribution.margin.min(),
            "near_singular_windows": self.near_singular_windows,
            "singular_instants": [{**vars(instant), "unbounded": instant.unbounded} for instant in self.instants],
            "parity": {**self.parity, "worst": self.worst_parity},
        }

    def csv(self) -> str:
        """Return motion, efforts of both backends, carrier forces, status, margin and condition as CSV text.

        An instant that occurs twice is a jump of the acceleration, seen from both sides. Efforts without
        a finite value are ``nan``.
        """
        solved, robot = self.distribution, self.robot
        columns = {
            **motion_columns(robot, self.motion),
            **effort_columns(robot.actuated, solved.tau, robot),
            **effort_columns(robot.actuated, self.solved[VIRTUAL_WORK].tau, robot, "tau_virtual_work"),
            **effort_columns(robot.carriers, self.reduced[RNEA].carrier_force, robot),
            "status": ("", solved.status_labels), "margin": ("", solved.margin), "condition": ("", solved.condition),
            "residual": ("N", solved.residual),
        }  # fmt: skip
        return csv_rows(columns, digits=CSV_DIGITS)


def run(case: Case) -> MotionRun:
    """Run a motion, carriers parked or none, by both backends; CrossCheckError where these differ."""
    robot, trajectory = case.load_robot(), case.trajectory()
    crossings = find_crossings(robot, trajectory)
    motion = sample_with(trajectory, case.dt, np.array([crossing.t for crossing in crossings]))
    carriers = CarrierMotion.parked(len(motion), robot.k)
    reduced = {name: BACKENDS[name](robot).reduce(motion, carriers) for name in (RNEA, VIRTUAL_WORK)}
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
    return tuple((float(t[first]), float(t[after - 1])) for first, after in runs(inside))


def relative_difference(a: Array, b: Array) -> float:
    """Return the largest |a − b| over the largest |a| or |b|; 0 where both are zero or empty, NaN if one has a NaN."""
    if a.size == 0:
        return 0.0
    size = max(float(np.abs(a).max()), float(np.abs(b).max()))
    return float(np.abs(a - b).max()) / size if size != 0.0 else 0.0


def _parity(reduced: Sequence[ReducedDynamics], solved: Sequence[Distribution]) -> dict[str, float]:
    first, second = reduced
    regular = solved[0].status == SampleStatus.OK
    pairs = {name: (getattr(first, name), getattr(second, name)) for name in ("f", "W", "carrier_force")}
    pairs["tau"] = (solved[0].tau[regular], solved[1].tau[regular])
    return {name: relative_difference(*pair) for name, pair in pairs.items()}


def _instant(crossing: Crossing, motion: PlatformMotion, solved: Distribution) -> PassedSingularity:
    sample = int(np.argmin(np.abs(motion.t - crossing.t)))
    return PassedSingularity(
        t=float(motion.t[sample]),
        x=tuple(float(value) for value in np.atleast_1d(motion.x[sample])),
        kind=crossing.kind.label,
        uncontrolled=tuple(float(value) for value in solved.uncontrolled[sample]),
        missing_force=float(solved.residual[sample]),
        status=SampleStatus(solved.status[sample]).label,
    )


# --- measures: one number or several, NaN where there is none ------------------------------------------------------

Numbers = tuple[float, ...]
Measure = Callable[[Any], Numbers]

ACCELERATING = 1e-6
"""Fraction of the largest reference acceleration below which the platform does not accelerate."""

_SAME_TIME = 9
"""Digits of a time, s, that have to agree for two samples to be the same: those at events may be apart by rounding."""


def read(name: str, subject: Plan | MotionRun, *arguments: Any) -> Numbers:
    """Return what a measure of ``MEASURES`` reads off a plan, or off a motion without a planner."""
    return tuple(float(value) for value in np.atleast_1d(MEASURES[name](subject, *arguments)))


def measure(name: str, *arguments: Any) -> Measure:
    """Return a measure with the arguments behind its subject bound."""
    return lambda subject: read(name, subject, *arguments)


def _largest(values: Any) -> Any:
    return np.abs(values).max()


def _peak_in(plan: Plan, phase: str) -> float:
    chosen = plan.phase == plan.phases.index(phase)
    return float(np.nanmax(np.abs(plan.tau[chosen]), initial=0.0)) if chosen.any() else math.nan


def _bound_nearest(plan: Plan, kind: str, carrier: int, instant: float) -> float:
    times = [float(np.clip(instant, start, end)) for _, _, start, end in bounds(plan, kind, carrier)]
    return min(times, key=lambda t: abs(t - instant), default=math.nan)


def _cruising(run: MotionRun) -> IntArray:
    speed = np.linalg.norm(run.motion.xd, axis=1)
    return np.flatnonzero(np.isclose(speed, np.median(speed), rtol=1e-9))


def _parked_forces(run: MotionRun, threshold: float, ramp: float) -> list[float]:
    start = _threshold_times(run, threshold)[0] - ramp
    return [abs(float(np.interp(start, run.t, tau))) for tau in run.distribution.tau.T]


def _threshold_times(run: MotionRun, threshold: float) -> tuple[float, float]:
    """Return when the condition number first and last exceeds a threshold, s.

    The circle passes two singularities, between which the condition number falls to about 17; the thesis treats
    them as one region, so the first entry and the last exit count.
    """
    # the logarithm of the condition number is nearly straight between samples, and finite below the threshold
    condition = np.minimum(run.distribution.condition, 1e6)
    above = windows(run.t, condition > threshold)
    first = int(np.searchsorted(run.t, above[0][0]))
    last = int(np.searchsorted(run.t, above[-1][1], side="right")) - 1

    def level(left: int) -> float:
        a, b = np.log(condition[left : left + 2])
        return float(run.t[left] + (np.log(threshold) - a) / (b - a) * (run.t[left + 1] - run.t[left]))

    return level(first - 1), level(last)


MEASURES: Mapping[str, Callable[..., Any]] = {
    # switch-off plans: when the condition number meets the threshold ("entry") and falls below it, or forces begin to
    # fall, s; |τ| as they begin to, N; its jump at switch-on, N; its largest rise
    # from the start of the ramp-down to the threshold, carriers parked, N; the largest |s| at switch-on, m
    "time_of": lambda plan, event: window(plan)[event],
    "entry_forces": lambda plan: np.abs(window(plan)["effort_at_ramp_start"]),
    "exit_forces": lambda plan: window(plan)["exit_jump"],
    "rise_to_threshold": lambda plan: np.max(
        np.abs(window(plan)["parked_effort_at_entry"]) - np.abs(window(plan)["effort_at_ramp_start"])
    ),
    "position_at_exit": lambda plan: _largest(window(plan)["carriers_at_exit"]["s"]),
    # any plan: the condition number at an instant, s; the largest |s|, m; of the actuators the largest |τ|, also in a
    # phase, and the largest root mean square, N or N·m
    "condition_at": lambda plan, instant: np.interp(instant, plan.t, np.minimum(plan.condition, 1e6)),
    "farthest_position": lambda plan: _largest(plan.carriers.s),
    "peak": lambda plan: plan.peak_effort_at_samples.max(),
    "peak_in": _peak_in,
    "largest_rms": lambda plan: plan.rms_effort.max(),
    # stepwise plans: when a carrier first meets a limit, and when, nearest to an instant, it is at one, s
    "first_bound": lambda plan, kind, carrier: min((b[2] for b in bounds(plan, kind, carrier)), default=math.nan),
    "bound_nearest": _bound_nearest,
    # motions without a planner: total time, when the speed begins to fall for the last time, first and last jump of the
    # acceleration, s; x where it is singular, m; largest |τ| of each actuator, N·m or N
    "duration": lambda run: run.trajectory.duration,
    "deceleration_start": lambda run: run.t[_cruising(run)[-1]],
    "arc_times": lambda run: (run.trajectory.breaks[0], run.trajectory.breaks[-1]),
    "crossing_abscissae": lambda run: [instant.x[0] for instant in run.instants],
    "peak_efforts": lambda run: run.peaks,
    # when the threshold is met and left, and one ramp before it is met the time, s, and |τ| of each actuator, N
    "threshold_met": lambda run, threshold: _threshold_times(run, threshold)[0],
    "threshold_left": lambda run, threshold: _threshold_times(run, threshold)[1],
    "switch_off_start": lambda run, threshold, ramp: _threshold_times(run, threshold)[0] - ramp,
    "parked_forces": _parked_forces,
}
"""Measures by the name that the data file has for them."""


# --- switch-off plans ----------------------------------------------------------------------------------------------


def window(plan: Plan) -> Mapping[str, Any]:
    """Return what a switch-off plan reports of its (first) window."""
    first: Mapping[str, Any] = plan.diagnostics["windows"][0]  # type: ignore[index]
    return first


def peak_until_off(plan: Plan) -> float:
    """Return the largest |τ| until the motors are off, N or N·m; NaN of plans that do not switch off."""
    off = plan.phase == plan.phases.index("off") if plan.planner == "switch_off" else np.zeros(1, dtype=bool)
    return float(np.nanmax(np.abs(plan.tau[: int(off.argmax())]))) if off.any() else math.nan


# --- plans of any kind ---------------------------------------------------------------------------------------------


def rms_acceleration(plan: Plan) -> float:
    """Return the root mean square over time of the norm of s̈, m/s²."""
    return float(np.sqrt(square_integral(plan.t, plan.carriers.sdd) / (plan.t[-1] - plan.t[0])))


def square_integral(t: Array, values: Array) -> float:
    """Return ∫ Σ v² dt by the trapezoidal rule, from (N,) times and (N, k) v."""
    return float(np.trapezoid((values**2).sum(axis=1), t))


def broken_limits(plan: Plan) -> str:
    """Return the limits broken, the worst of each carrier and quantity: ``"track of carrier_1 by 0.05 at 0.9 s"``."""
    return "; ".join(
        f"{event.quantity} of {event.joint} by {event.amount:.3g} at {event.worst:.2f} s"
        for event in worst_events(plan.limits.violated)
    )


def accelerating(plan: Plan) -> BoolArray:
    """Return (N,) whether the platform accelerates."""
    size = np.abs(plan.motion.xdd).max(axis=1)
    moving: BoolArray = size > ACCELERATING * size.max()
    return moving


# --- limits that a stepwise plan meets -----------------------------------------------------------------------------


def bounds(plan: Plan, kind: str | None = None, carrier: int | None = None) -> list[tuple[int, str, float, float]]:
    """Return the limits a stepwise plan meets: carrier (from 1), kind, first and last time, s.

    Kinds are "speed", "acceleration", "track" and "stop"; any kind, any carrier when left out.
    """
    events: Any = plan.diagnostics["bounds"]
    numbers = {name: i + 1 for i, name in enumerate(plan.robot.carriers)}
    met = [(numbers[event["joint"]], event["bound"], event["start"], event["end"]) for event in events]
    return [event for event in met if kind in (None, event[1]) and carrier in (None, event[0])]


def limits_met(plan: Plan) -> str:
    """Return which carriers meet which limit first when: ``"2 speed 0.34 s, 2 acceleration 0.82 s"``."""
    first: dict[tuple[int, str], float] = {}
    for carrier, kind, start, _ in bounds(plan):
        first.setdefault((carrier, kind), start)
    return ", ".join(f"{carrier} {kind} {start:.2f} s" for (carrier, kind), start in first.items()) or "none"


# --- plans in numbers ----------------------------------------------------------------------------------------------


def numbers(plan: Plan) -> dict[str, Any]:
    """Return a plan in numbers: efforts, energies, carriers against their limits.

    ``rms`` is that of the norm of τ; energies are ∫ Σ |power| dt, J, what motors that recover nothing would draw;
    ``position``, ``speed`` and ``acceleration`` are the largest of any carrier, ``track``, ``speed_limit`` and
    ``acceleration_limit`` what they are judged by.
    """
    carriers, limits = plan.carriers, plan.limits.judged_by
    return {
        "status": plan.status.value,
        "peak": float(plan.peak_effort_at_samples.max()),
        "before": peak_until_off(plan),
        "reversals": float(plan.reversals.max()),
        "rms": float(np.linalg.norm(plan.rms_effort)),
        "carrier_force": float(np.abs(plan.carrier_force).max(initial=0.0)),
        "main_energy": plan.main_energy,
        "carrier_energy": plan.carrier_energy,
        "energy": plan.main_energy + plan.carrier_energy,
        "position": float(np.abs(carriers.s).max(initial=0.0)),
        "speed": float(np.abs(carriers.sd).max(initial=0.0)),
        "acceleration": float(np.abs(carriers.sdd).max(initial=0.0)),
        "track": max(limits.track[:, 1], default=math.nan),
        "speed_limit": max(limits.speed, default=math.nan),
        "acceleration_limit": max(limits.acceleration, default=math.nan),
        "broken": broken_limits(plan),
        "solver": plan.findings.solver,
    }


def plan_differences(first: Plan, second: Plan) -> dict[str, float]:
    """Return the largest differences of two plans over the largest value, at the samples that both have."""
    a, b = (np.round(plan.t, _SAME_TIME) for plan in (first, second))
    one = other = np.arange(len(a))
    if not np.array_equal(a, b):
        _, one, other = np.intersect1d(a, b, return_indices=True)
    left, right = (
        {"position": plan.carriers.s, "speed": plan.carriers.sd, "acceleration": plan.carriers.sdd,
         "tau": np.nan_to_num(plan.tau), "carrier_force": plan.carrier_force}
        for plan in (first, second)
    )  # fmt: skip
    return {name: relative_difference(left[name][one], right[name][other]) for name in left}


def missing_force(error: InfeasiblePlanError) -> float:
    """Return the force that nothing can carry at a singular pose, N, if that is why there is no plan, or NaN."""
    amount = error.details.get("amount") if error.details.get("constraint") == "singular_pose" else None
    return amount if isinstance(amount, float) else math.nan
