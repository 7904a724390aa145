"""Motions without a planner, run by both backends; and the numbers read off them and off plans."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, largest, runs
from redundancy_pin.dynamics.backends import BACKENDS, RNEA, VIRTUAL_WORK
from redundancy_pin.dynamics.distribution import Distribution, distribute
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import CrossCheckError, InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.limits import worst_events
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.crossings import Crossing, find_crossings
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.thesis.cases import Case
from redundancy_pin.thesis.table import Record
from redundancy_pin.trajectory.csv_file import csv_rows, effort_columns, motion_columns

PARITY_TOLERANCE = 1e-10
"""Largest relative difference between the backends: both are exact, so a thousandth of this is rounding already."""

CSV_DIGITS = 12
"""Significant digits in CSV files: more than the backends differ by, in two thirds of the bytes of all digits."""

_SAME_INSTANT = 1e-9
"""Distance from a singular instant, s, below which a sampling time is left out."""


@dataclass(frozen=True, eq=False)
class MotionRun:
    """A motion by both backends, carriers parked or absent.

    Samples are every dt, two-sided at jumps, and at the singular instants. ``reduced`` (f, W, carrier forces) and
    ``solved`` (main efforts with their statuses) are by backend; ``parity`` has the largest differences of f, W,
    carrier_force and tau (regular samples) relative to the largest value.
    """

    case: Case
    robot: Robot
    crossings: Sequence[Crossing]
    motion: PlatformMotion
    reduced: Mapping[str, ReducedDynamics]
    solved: Mapping[str, Distribution]
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
    def regular(self) -> BoolArray:
        """(N,) whether a sample is neither singular nor near-singular."""
        regular: BoolArray = self.distribution.status == SampleStatus.OK
        return regular

    @property
    def worst_parity(self) -> float:
        """The largest difference of the backends; NaN if one of them is."""
        return float(np.max([*self.parity.values()]))

    @property
    def peaks(self) -> Array:
        """(m,) largest |τ| over the regular samples, N or N·m; arbitrary where efforts are unbounded."""
        return largest(self.distribution.tau[self.regular])

    @property
    def instants(self) -> list[Record]:
        """Singularities along the motion: time, s, platform coordinates, kind, and what happens to the efforts.

        ``uncontrolled`` is the unit platform velocity that no actuator resists, in scaled units, ``missing_force`` the
        norm of the part of f that no actuator balances, N, scaled: efforts near the instant are this over the margin.
        """
        places, solved = [int(np.argmin(np.abs(self.t - crossing.t))) for crossing in self.crossings], self.distribution
        statuses = [SampleStatus(solved.status[place]) for place in places]
        return [
            {"t": float(self.t[place]), "x": tuple(np.atleast_1d(self.motion.x[place]).tolist()),
             "kind": crossing.kind.label, "uncontrolled": tuple(solved.uncontrolled[place].tolist()),
             "missing_force": float(solved.residual[place]), "status": status.label,
             "unbounded": status is SampleStatus.SINGULAR_INCONSISTENT}
            for crossing, place, status in zip(self.crossings, places, statuses, strict=True)
        ]  # fmt: skip

    @property
    def statement(self) -> str:
        """Whether the efforts are bounded, in a line."""
        instants, peaks = self.instants, ", ".join(f"{peak:.3g}" for peak in self.peaks) + f" {self.case.unit}"
        if not instants:
            return f"bounded: peaks {peaks}"
        unbounded = [instant for instant in instants if instant["unbounded"]]
        places = ", ".join(f"{instant['t']:.4f} s" for instant in unbounded or instants)
        if not unbounded:
            return f"finite through the singularities at t = {places}: peaks {peaks}"
        missing = ", ".join(f"{instant['missing_force']:.3g}" for instant in unbounded)
        return f"unbounded at t = {places}: {missing} N that no actuator can carry there"

    def record(self) -> Record:
        """Return the run in numbers, for tables and JSON."""
        return {
            "title": self.case.title,
            "configuration": self.case.as_dict(),
            "duration": self.case.trajectory().duration,
            "samples": len(self.motion),
            "bounded": not any(instant["unbounded"] for instant in self.instants),
            "statement": self.statement,
            "effort_unit": self.case.unit,
            "regular_peaks": self.peaks,
            "carrier_force_peaks": largest(self.reduced[RNEA].carrier_force),
            "statuses": self.distribution.status_counts,
            "smallest_margin": self.distribution.margin.min(),
            "near_singular_windows": [(self.t[first], self.t[after - 1]) for first, after in runs(~self.regular)],
            "singular_instants": self.instants,
            "parity": {**self.parity, "worst": self.worst_parity},
        }

    def csv(self) -> str:
        """Return motion, efforts of both backends, carrier forces, status, margin and condition as CSV text.

        Jumps of the acceleration have two rows, before and after. Efforts without a finite value are ``nan``.
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
    """Run a motion, carriers parked or absent, by both backends; CrossCheckError where these differ."""
    robot, trajectory = case.load_robot(), case.trajectory()
    crossings = find_crossings(robot, trajectory)
    grid, instants = trajectory.sample(case.dt, two_sided=False).t, np.array([crossing.t for crossing in crossings])
    kept = np.abs(grid[:, None] - instants).min(axis=1, initial=np.inf) > _SAME_INSTANT
    motion = trajectory.sample(times=np.sort(np.concatenate([np.unique(grid[kept]), instants])))
    carriers = CarrierMotion.parked(len(motion), robot.k)
    reduced = {name: BACKENDS[name](robot).reduce(motion, carriers) for name in (RNEA, VIRTUAL_WORK)}
    solved = {name: distribute(reduction) for name, reduction in reduced.items()}
    (first, second), regular = reduced.values(), solved[RNEA].status == SampleStatus.OK
    pairs = {name: (getattr(first, name), getattr(second, name)) for name in ("f", "W", "carrier_force")}
    pairs["tau"] = (solved[RNEA].tau[regular], solved[VIRTUAL_WORK].tau[regular])
    parity = {name: relative_difference(*pair) for name, pair in pairs.items()}
    if not max(parity.values()) <= PARITY_TOLERANCE:
        listed = ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in parity.items())
        raise CrossCheckError(
            f"The backends differ along {case.name} by more than {PARITY_TOLERANCE:g} (relative): {listed}.",
            remedy="One of them is wrong: run `redundancy-pin validate` to see where.",
            experiment=case.name,
            parity=parity,
        )
    return MotionRun(case, robot, crossings, motion, reduced, solved, parity)


def relative_difference(a: Array, b: Array) -> float:
    """Return the largest |a − b| over the largest |a| or |b|; 0 where both are zero or empty, NaN if one has a NaN."""
    size = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
    return float(np.abs(a - b).max() / size) if size != 0.0 else 0.0


# --- measures: one number or several, NaN where there is none ------------------------------------------------------

Numbers = tuple[float, ...]

ACCELERATING = 1e-6
"""Fraction of the largest reference acceleration below which the platform does not accelerate."""

_SAME_TIME = 9
"""Decimals of a time, s, that agree for two samples to be the same: times of events differ by rounding."""


def read(subject: Plan | MotionRun, name: str, *arguments: Any) -> Numbers:
    """Return what a measure of ``MEASURES`` reads off a plan, or off a motion without a planner."""
    return tuple(np.atleast_1d(MEASURES[name](subject, *arguments)).astype(float).tolist())


def _peak_in(plan: Plan, phase: str) -> float:
    chosen = plan.phase == plan.phases.index(phase)
    return float(np.nanmax(np.abs(plan.tau[chosen]), initial=0.0)) if chosen.any() else math.nan


def _bound_nearest(plan: Plan, kind: str, carrier: int, instant: float) -> float:
    times = [float(np.clip(instant, start, end)) for _, _, start, end in bounds(plan, kind, carrier)]
    return min(times, key=lambda t: abs(t - instant), default=math.nan)


def _deceleration_start(run: MotionRun) -> float:
    speed = np.linalg.norm(run.motion.xd, axis=1)
    return float(run.t[np.flatnonzero(np.isclose(speed, np.median(speed), rtol=1e-9))[-1]])


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
    "position_at_exit": lambda plan: np.abs(window(plan)["carriers_at_exit"]["s"]).max(),
    # any plan: the condition number at an instant, s; the largest |s|, m; of the actuators the largest |τ|, also in a
    # phase, and the largest root mean square, N or N·m
    "condition_at": lambda plan, instant: np.interp(instant, plan.t, np.minimum(plan.condition, 1e6)),
    "farthest_position": lambda plan: np.abs(plan.carriers.s).max(),
    "peak": lambda plan: plan.peak_effort_at_samples.max(),
    "peak_in": _peak_in,
    "largest_rms": lambda plan: plan.rms_effort.max(),
    # stepwise plans: when a carrier first meets a limit, and when, nearest to an instant, it is at one, s
    "first_bound": lambda plan, kind, carrier: min((b[2] for b in bounds(plan, kind, carrier)), default=math.nan),
    "bound_nearest": _bound_nearest,
    # motions without a planner: total time, when the speed begins to fall for the last time, first and last jump of the
    # acceleration, s; x where it is singular, m; largest |τ| of each actuator, N·m or N
    "duration": lambda run: run.case.trajectory().duration,
    "deceleration_start": _deceleration_start,
    "arc_times": lambda run: run.case.trajectory().breaks[[0, -1]],
    "crossing_abscissae": lambda run: [instant["x"][0] for instant in run.instants],
    "peak_efforts": lambda run: run.peaks,
}
"""Measures by the name that the data file has for them."""


def window(plan: Plan) -> Mapping[str, Any]:
    """Return what a switch-off plan reports of its (first) window."""
    first: Mapping[str, Any] = plan.diagnostics["windows"][0]  # type: ignore[index]
    return first


def bounds(plan: Plan, kind: str | None = None, carrier: int | None = None) -> list[tuple[int, str, float, float]]:
    """Return the limits a stepwise plan meets: carrier (from 1), kind, first and last time, s.

    Kinds are "speed", "acceleration", "track" and "stop"; any kind, any carrier when left out.
    """
    events: Any = plan.diagnostics["bounds"]
    numbers = {name: i + 1 for i, name in enumerate(plan.robot.carriers)}
    met = [(numbers[event["joint"]], event["bound"], event["start"], event["end"]) for event in events]
    return [event for event in met if kind in (None, event[1]) and carrier in (None, event[0])]


# --- plans in numbers ----------------------------------------------------------------------------------------------


def numbers(plan: Plan | InfeasiblePlanError) -> Record:
    """Return a plan in numbers: efforts, energies, carriers against their limits; all NaN without a plan.

    ``before`` is the largest |τ| before the motors are off, NaN if a plan does not switch off; ``rms`` is of the norm
    of τ; energies are ∫ Σ |power| dt, J, what motors that recover nothing would draw; ``position``, ``speed`` and
    ``acceleration`` are the largest of any carrier; ``track``, ``speed_limit``, ``acceleration_limit`` their limits;
    ``broken`` the worst of each broken limit.
    """
    if isinstance(plan, InfeasiblePlanError):
        return {**dict.fromkeys(NUMBERS, math.nan), "status": ResultStatus.INFEASIBLE.value, "broken": "", "solver": ""}
    broken = [
        f"{event.quantity} of {event.joint} by {event.amount:.3g} at {event.worst:.2f} s"
        for event in worst_events(plan.limits.violated)
    ]
    shown = {name: float(measure(plan)) for name, measure in NUMBERS.items()}
    return {"status": plan.status.value, **shown, "broken": "; ".join(broken), "solver": plan.findings.solver}


def _before(plan: Plan) -> float:
    off = plan.phase == plan.phases.index("off") if plan.planner == "switch_off" else np.zeros(1, dtype=bool)
    return float(largest(plan.tau[: int(off.argmax())]).max()) if off.any() else math.nan


NUMBERS: Mapping[str, Callable[[Plan], Any]] = {
    "peak": lambda plan: plan.peak_effort_at_samples.max(),
    "before": _before,
    "reversals": lambda plan: plan.reversals.max(),
    "rms": lambda plan: np.linalg.norm(plan.rms_effort),
    "carrier_force": lambda plan: np.abs(plan.carrier_force).max(initial=0.0),
    "main_energy": lambda plan: plan.main_energy,
    "carrier_energy": lambda plan: plan.carrier_energy,
    "energy": lambda plan: plan.main_energy + plan.carrier_energy,
    "position": lambda plan: np.abs(plan.carriers.s).max(initial=0.0),
    "speed": lambda plan: np.abs(plan.carriers.sd).max(initial=0.0),
    "acceleration": lambda plan: np.abs(plan.carriers.sdd).max(initial=0.0),
    "track": lambda plan: max(plan.limits.judged_by.track[:, 1], default=math.nan),
    "speed_limit": lambda plan: max(plan.limits.judged_by.speed, default=math.nan),
    "acceleration_limit": lambda plan: max(plan.limits.judged_by.acceleration, default=math.nan),
}
"""Numbers of a plan, by name."""


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
