"""The chapter on the thesis's own planners: both backends, working modes, limits, and the same machine compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, largest
from redundancy_pin.errors import CrossCheckError, InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.thesis import cases, measures
from redundancy_pin.thesis.case import Call, Case, Mode, Plans, call_of
from redundancy_pin.thesis.cases import CORNERS, CROSSINGS, MODE_CASES, NONE, PARKED, Extent
from redundancy_pin.thesis.claims import MOVING, conclusions
from redundancy_pin.thesis.measures import bounds, numbers, read
from redundancy_pin.thesis.statements import judge_all, needed, sensitivity, thesis
from redundancy_pin.thesis.table import Record, mode_text, text

Chapter = dict[str, Any]
"""Records of the tables of a chapter, by name."""

PLAN_TOLERANCE = 1e-8
"""Largest relative difference of two plans: rounding changes the steps of the integrator of the carriers."""

POINTS = 4
"""Points inside each step at which stepwise plans are evaluated."""


def calls(extent: Extent) -> list[Call]:
    """Return the calls that make the plans of the chapter."""
    moded = [replace(case, working_mode=mode) for mode in extent.modes for case in MODE_CASES]
    first = (*needed(extent), *moded, *map(cases.without_carriers, moded))
    shortest = [case.with_options(return_time="shortest") for case in CROSSINGS]
    others = [*shortest, *map(cases.parked, (*CROSSINGS, *moded)), *_squares(extent.modes).values()]
    both = [call_of(case, backend) for case in extent.parity for backend in case.backends]
    return both + [call_of(case) for case in (*CROSSINGS, *CORNERS, *first, *others, cases.HEAVY_CROSSING)]


def run_planned(plans: Plans, extent: Extent) -> Chapter:
    """Return the records of the chapter."""
    modes, rows = working_modes(plans, extent.modes), list(thesis()["rows"])
    judged = [*judge_all(plans, extent), *modes.pop("judged")]
    chapter: Chapter = {
        "rule": thesis()["rule"],
        "parity": [plan_parity(plans, case) for case in extent.parity],
        "against_thesis": sorted(judged, key=lambda record: rows.index(record["row"])),
        "between_samples": between_records(plans),
        **modes,
        "shortest_returns_on_square": square_returns(plans, extent.modes),
        "crossings": [crossing_record(plans, case) for case in CROSSINGS],
        "heavy_end_effector": heavy_record(plans),
        "fair_comparison": machine_records(plans, extent.modes),
        "sensitivity": sensitivity(plans, extent),
    }
    return chapter | {"conclusions": conclusions(chapter)}


def compare_backends(plans: Plans, case: Case) -> Record:
    """Plan a case with both backends and compare; the differences are infinite where only one backend has a plan."""
    first, second = (plans.outcome(case, backend) for backend in case.backends)
    if isinstance(first, Plan) and isinstance(second, Plan):
        differences = measures.plan_differences(first, second)
    else:
        apart = 0.0 if type(first) is type(second) else math.inf
        differences = dict.fromkeys(("position", "speed", "acceleration", "tau", "carrier_force"), apart)
    statuses = [(one.status if isinstance(one, Plan) else ResultStatus.INFEASIBLE).value for one in (first, second)]
    return {"case": case.name, **differences, "statuses": statuses, "worst": float(np.max([*differences.values()]))}


def plan_parity(plans: Plans, case: Case) -> Record:
    """Compare the plans of a case by both backends; CrossCheckError if they differ by too much, or in status."""
    compared = compare_backends(plans, case)
    worst, (first, second) = compared["worst"], compared.pop("statuses")
    if first != second or not worst <= PLAN_TOLERANCE:
        raise CrossCheckError(
            f"The plans of {case.name} by the two backends differ by {worst:.3g} (relative; at most {PLAN_TOLERANCE:g} "
            f"is allowed); they are {first} and {second}.",
            remedy="One of them is wrong: run `redundancy-pin validate` to see where.",
            parity=compared,
        )
    return {**compared, "status": first}


def between_records(plans: Plans) -> list[Record]:
    """Return the main stepwise plans at and between their samples, while the optimiser works: (3,) |τ|, N·m."""
    records = []
    for case in CORNERS:
        plan = plans.plan(case)
        optimised = plan.phase == plan.phases.index("optimise")
        steps = np.flatnonzero(np.diff(plan.t) * optimised[1:] > 0.0)
        times = plan.t[steps, None] + np.diff(plan.t)[steps, None] * np.arange(1, POINTS + 1) / (POINTS + 1)
        between = largest(plan.efforts_at(times.ravel(), case.dynamics()))
        baseline = largest(plans.plan(cases.without_carriers(case)).tau)
        records.append({"case": case.name, "at_samples": largest(plan.tau[optimised]), "between": between,
                        "baseline": baseline})  # fmt: skip
    return records


def crossing_record(plans: Plans, case: Case) -> Record:
    """Return what became of a crossing: limits broken, the shortest return, the jump on switching on."""
    plan = plans.plan(case)
    end = float(plan.limits.judged_by.track[:, 1].max())
    shortest = plans.outcome(case.with_options(return_time="shortest"))
    return {
        "case": case.name,
        "status": plan.status.value,
        "broken": measures.broken_limits(plan),
        "beyond_track_at_exit": max(0.0, read(plan, "position_at_exit")[0] - end),
        "beyond_track": max(0.0, read(plan, "farthest_position")[0] - end),
        "shortest": float(measures.window(shortest)["return_time"]) if isinstance(shortest, Plan) else math.nan,
        "no_shortest": "" if isinstance(shortest, Plan) else shortest.message,
        "jump": read(plan, "exit_forces"),
        "peak_on_return": read(plan, "peak_in", "return")[0],
    }


def heavy_record(plans: Plans) -> Record | None:
    """Return why the circle cannot be crossed with a massive end-effector; None if it can."""
    outcome = plans.outcome(cases.HEAVY_CROSSING)
    if not isinstance(outcome, InfeasiblePlanError):
        return None
    mass = dict(cases.HEAVY_CROSSING.arguments)["end_effector_mass"]
    return {"what": f"end-effector of {mass:g} kg", "message": outcome.message, "details": dict(outcome.details)}


# --- no carriers, carriers parked, carriers moving; both sets of actuators counted ---------------------------------


def machine_records(plans: Plans, modes: Sequence[Mode]) -> list[Record]:
    """Compare for every motion of the thesis; corners and square in every working mode."""
    records: list[Record] = []
    for case in CROSSINGS:
        motion = case.name.rpartition("-")[0]
        if not any(record["motion"] == motion for record in records):
            records.append(_machine(motion, (), PARKED, cases.parked(case), plans))
        records.append(_machine(motion, (), f"{MOVING}, off above CN {case.option('threshold'):g}", case, plans))
    raised = [case for case in MODE_CASES if case.option("speed") or case.option("acceleration")]
    for mode in modes:
        for motion in ("corner-r0.025", "corner-r0.013", "square"):
            moded = [replace(case, working_mode=mode) for case in (*CORNERS, *raised) if case.name.startswith(motion)]
            records.append(_machine(motion, mode, NONE, cases.without_carriers(moded[0]), plans))
            records.append(_machine(motion, mode, PARKED, cases.parked(moded[0]), plans))
            for case in moded:
                acceleration, speed = case.option("acceleration"), case.option("speed")
                limit = f", {acceleration:g} m/s²" if acceleration else f", {speed:g} m/s" if speed else ""
                records.append(_machine(motion, mode, f"{MOVING}, λ = {case.option('lam'):g}{limit}", case, plans))
    return records


def _machine(motion: str, mode: Mode, how: str, case: Case, plans: Plans) -> Record:
    plan = plans.plan(case)
    bounded = plan.status is not ResultStatus.UNBOUNDED
    # along a singular motion efforts without a plan grow without bound between samples, even if no sample is singular
    bounded &= not (how == PARKED and (plan.sample_status != SampleStatus.OK).any())
    shown = numbers(plan)
    if not bounded:
        shown |= dict.fromkeys(("peak", "rms", "main_energy", "energy"), math.inf) | {"status": "unbounded"}
    kept = ("peak", "rms", "carrier_force", "main_energy", "carrier_energy", "energy", "status")
    return {"motion": motion, "mode": mode, "what": how, "unit": case.unit, "bounded": bool(bounded),
            **{name: shown[name] for name in kept}}  # fmt: skip


# --- the stepwise plans in every working mode of the 3-RRR, which the thesis does not state: what of its words holds

HALF = 0.05
"""Largest distance from half, over the baseline's peak, of a torque that counts as half."""

SMALL_JUMP = 0.05
"""Smallest jump of a torque, N·m, that shows in a figure."""

WIDE, SHARP = "corner-r0.025-lam0", "corner-r0.013-lam0"
SQUARE = "square-lam0"


@dataclass(frozen=True, eq=False)
class Compared:
    """A plan and the plan of the machine without carriers (``baseline``), at the same samples."""

    plan: Plan
    baseline: Plan

    @property
    def tau(self) -> Array:
        """(N, m) torque of the plan, without the samples added for braking, N·m."""
        return self.plan.tau[: len(self.baseline.t)]

    @property
    def accelerating(self) -> BoolArray:
        """(N,) whether the platform accelerates."""
        size = np.abs(self.baseline.motion.xdd).max(axis=1)
        moving: BoolArray = size > measures.ACCELERATING * size.max()
        return moving

    def limited(self, kind: str | None = None, carrier: int | None = None) -> BoolArray:
        """Return (N,) whether a carrier is at a limit; see ``measures.bounds``."""
        at = [self.inside(start, end, 0.0) for _, _, start, end in bounds(self.plan, kind, carrier)]
        return np.any(at, axis=0) if at else np.zeros(len(self.baseline.t), dtype=bool)

    def inside(self, start: float, end: float, slack: float = 1e-9) -> BoolArray:
        """Return (N,) whether a sample lies between two times, s."""
        within: BoolArray = (self.baseline.t >= start - slack) & (self.baseline.t <= end + slack)
        return within

    @property
    def corner(self) -> BoolArray:
        """(N,) whether the platform is in the (first) corner."""
        jumps = self.baseline.t[self.baseline.motion.jumps]
        return self.inside(float(jumps[0]), float(jumps[1]))


Runs = Mapping[str, Compared]
"""The runs of one working mode, by the names of the cases in ``MODE_CASES``."""

Outcome = tuple[bool, str]
"""Whether a claim holds, and the number that decides."""


def runs_of(plans: Plans, mode: Mode) -> dict[str, Compared]:
    """Return all runs of a working mode."""
    moded = [replace(case, working_mode=mode) for case in MODE_CASES]
    return {case.name: Compared(plans.plan(case), plans.plan(cases.without_carriers(case))) for case in moded}


# --- the claims of the data file -----------------------------------------------------------------------------------


def _against(ours: Array, other: Array) -> str:
    return f"{text(ours, '.2g')} against {text(other, '.2g')} N·m"


def small_torque(runs: Runs) -> Outcome:
    """Hold if torques are of the order of 0.1 N·m at most away from limits."""
    run = runs[WIDE]
    value = float(largest(run.tau[run.accelerating & ~run.limited()]).max())
    return value <= 0.1 * np.sqrt(10.0), f"{value:.2g} N·m"


def second_exceeds_at_speed_limit(runs: Runs) -> Outcome:
    """Hold if τ2 exceeds the baseline where carrier 2 is at its speed limit before the corner."""
    run = runs[WIDE]
    at = run.limited("speed", 2) & run.inside(0.0, 0.8)
    ours, other = largest(run.tau[at])[1], largest(run.baseline.tau[at])[1]
    return bool(ours > other), _against(ours, other) if at.any() else "carrier 2 is never at its speed limit"


def sharp_exceeds(runs: Runs) -> Outcome:
    """Hold if τ2 and τ3 exceed the baseline in the sharp corner, at an acceleration limit."""
    run = runs[SHARP]
    ours, other = largest(run.tau[run.corner])[1:], largest(run.baseline.tau[run.corner])[1:]
    reached = bool((run.limited("acceleration") & run.corner).any())
    return bool((ours > other).all()) and reached, f"τ2, τ3 {_against(ours, other)}"


def cured_by_acceleration(runs: Runs) -> Outcome:
    """Hold if with 12 m/s² τ2 and τ3 stay below the baseline in the sharp corner."""
    run = runs[f"{SHARP}-a12"]
    ours, other = largest(run.tau[run.corner])[1:], largest(run.baseline.tau[run.corner])[1:]
    return bool((ours < other).all()), f"τ2, τ3 {_against(ours, other)}"


def first_jumps(runs: Runs) -> Outcome:
    """Hold if τ1 jumps as the sharp corner is entered, at an acceleration limit."""
    run = runs[SHARP]
    entered = int(np.flatnonzero(run.baseline.motion.jumps)[0])
    step, start = float(abs(run.tau[entered, 0] - run.tau[entered - 1, 0])), float(run.baseline.t[entered])
    limited = bool((run.limited("acceleration") & run.inside(start, start + 0.02)).any())
    return step > SMALL_JUMP and limited, f"{step:.2g} N·m, acceleration limit {'met' if limited else 'not met'}"


def wide_half(runs: Runs, name: str = "corner-r0.025-lam0.5") -> Outcome:
    """Hold if the torque is half of the baseline's at the wide corner."""
    run = runs[name]
    # of samples at a jump only the first: the second one is a result of a step, and not chosen in it
    chosen, other = run.accelerating & ~run.baseline.motion.jumps, run.baseline.tau
    off = float(np.abs(run.tau - 0.5 * other)[chosen].max() / np.abs(other).max())
    return off <= HALF, f"off half by {off:.2g} of the baseline's peak"


def square_half(runs: Runs) -> Outcome:
    """Hold if the torque is half of the baseline's in ramps and corners of the square."""
    return wide_half(runs, "square-lam0.5")


def no_limit(runs: Runs) -> Outcome:
    """Hold if no carrier meets a limit."""
    met = sorted({f"{kind} of {carrier}" for carrier, kind, _, _ in bounds(runs["corner-r0.025-lam0.5"].plan)})
    return not met, ", ".join(met) or "none met"


def returns_exceed(runs: Runs) -> Outcome:
    """Hold if all torques exceed the baseline while carriers return."""
    run = runs["square-lam0.5"]
    returning = (run.plan.phase == run.plan.phases.index("return"))[: len(run.baseline.t)]
    ours, other = largest(run.tau[returning]), largest(run.baseline.tau[returning])
    return bool((ours > other).all()), _against(ours, other)


def first_accelerates_least(runs: Runs) -> Outcome:
    """Hold if carrier 1 accelerates least on the return at 1.1 s."""
    plan = runs["square-lam0.5"].plan
    first, second, third = np.abs(plan.carriers.sdd[int(np.abs(plan.t - 1.1).argmin())])
    return bool(first < min(second, third)), f"{first:.2g}, {second:.2g}, {third:.2g} m/s²"


def square_spikes(runs: Runs) -> Outcome:
    """Hold if torques at the speed limits on the square exceed the baseline's peak."""
    run = runs[SQUARE]
    at = run.limited("speed") & run.accelerating
    ours, other = largest(run.tau[at]).max(), np.abs(run.baseline.tau).max()
    return bool(ours > other), _against(ours, other) if at.any() else "no speed limit met"


def cured_by_speed(runs: Runs) -> Outcome:
    """Hold if with 1.2 m/s torques stay below the baseline's peaks while the platform accelerates."""
    run = runs[f"{SQUARE}-v1.2"]
    ours, other = largest(run.tau[run.accelerating]), largest(run.baseline.tau)
    return bool((ours < other).all()), _against(ours, other)


TESTS: Mapping[str, Callable[[Runs], Outcome]] = {
    test.__name__: test
    for test in (small_torque, second_exceeds_at_speed_limit, sharp_exceeds, cured_by_acceleration, first_jumps,
                 wide_half, no_limit, square_half, returns_exceed, first_accelerates_least, square_spikes,
                 cured_by_speed)
}  # fmt: skip
"""Tests of the claims in words, by the names in ``thesis.yaml``."""


# --- records -------------------------------------------------------------------------------------------------------


def working_modes(plans: Plans, modes: Sequence[Mode]) -> dict[str, list[Record]]:
    """Return records of each mode and case, of each claim with its outcome in each mode, and those as verdicts."""
    runs = {mode: runs_of(plans, mode) for mode in modes}
    records = [
        {"mode": mode, "case": name, "baseline_peak": largest(run.baseline.tau),
         "peak": run.plan.peak_effort_at_samples, "rms": run.plan.rms_effort, "limits": measures.limits_met(run.plan),
         "status": run.plan.status.value}
        for mode, of_mode in runs.items()
        for name, run in of_mode.items()
    ]  # fmt: skip
    claims = []
    for entry in thesis()["claims"]:
        outcomes = {mode_text(mode): TESTS[entry["test"]](of_mode) for mode, of_mode in runs.items()}
        shown = {mode: {"holds": bool(holds), "found": number} for mode, (holds, number) in outcomes.items()}
        claims.append({**entry, "modes": shown})
    return {"working_modes": records, "claims": claims, "judged": [_judged(entry) for entry in claims]}


def _judged(entry: Record) -> Record:
    outcomes: Mapping[str, Record] = entry["modes"]
    first, holding = next(iter(outcomes)), [mode for mode, outcome in outcomes.items() if outcome["holds"]]
    reason = f"in {len(holding) or 'none'} of {len(outcomes)} working modes"
    return {"row": entry["row"], "source": entry["source"], "condition": thesis()["rows"][entry["row"]],
            "quantity": entry["claim"], "stated": "in words", "ours": f"{first}: {outcomes[first]['found']}",
            "deviation": "", "covered": "", "verdict": "reproduced" if holding else "differs",
            "reason": f"{reason}: {', '.join(holding)}" if holding else f"{reason} ({entry['criterion']})",
            "as_run": first in holding}  # fmt: skip


def square_returns(plans: Plans, modes: Sequence[Mode]) -> list[Record]:
    """Return the shortest returns on the square within all limits, s, or why there are none."""
    records = []
    for (mode, lam), case in _squares(modes).items():
        outcome = plans.outcome(case)
        if isinstance(outcome, Plan):
            spans, why = np.asarray(outcome.diagnostics["returns"], dtype=float).reshape(-1, 2), ""
        else:
            spans, why = np.empty((0, 2)), outcome.message
        records.append({"mode": mode, "lam": lam, "durations": spans[:, 1] - spans[:, 0], "why": why})
    return records


def _squares(modes: Sequence[Mode]) -> dict[tuple[Mode, float], Case]:
    """Return the square with the shortest returns, by working mode and λ."""
    pairs = [(mode, lam) for mode in modes for lam in (0.0, 0.5)]
    return {(mode, lam): cases.square(lam, mode).with_options(return_time="shortest") for mode, lam in pairs}
