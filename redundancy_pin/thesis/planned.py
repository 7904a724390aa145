"""The chapter on the thesis's own planners: both backends, working modes, limits, and the same machine compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.errors import CrossCheckError, InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.thesis import cases, measures
from redundancy_pin.thesis.case import Case, Mode, Plans
from redundancy_pin.thesis.cases import CORNERS, CROSSINGS, MODE_CASES, NONE, PARKED, Extent
from redundancy_pin.thesis.measures import bounds, numbers, read
from redundancy_pin.thesis.statements import claim, counted, judge_all, needed, ratios, sensitivity, thesis, verdict
from redundancy_pin.thesis.table import Record, grouped, mode_text, text

Chapter = dict[str, Any]
"""Records of the tables of a chapter, by name."""

Progress = Callable[[str], None]
"""Called with the name of each finished part."""

PLAN_TOLERANCE = 1e-8
"""Largest relative difference of two plans: carriers are integrated with error control, which rounding steers."""

STATED_FORCE = 0.005
"""Smallest force on switching on that the thesis would print, N: half a unit of its last digit."""

POINTS = 4
"""Points inside each step at which stepwise plans are looked at."""

MOVING = "carriers moving"


def independent(extent: Extent) -> list[tuple[Case, str]]:
    """Return the plans of the chapter that do not depend on one another, each with its backend."""
    moded = [replace(case, working_mode=mode) for mode in extent.modes for case in MODE_CASES.values()]
    first = (*needed(extent), *moded, *map(cases.without_carriers, moded))
    shortest = [case.with_options(return_time="shortest") for case in CROSSINGS]
    others = [*shortest, *map(cases.parked, (*CROSSINGS, *moded)), *_squares(extent.modes).values()]
    both = [(case, backend) for case in (*CROSSINGS, *CORNERS) for backend in case.backends]
    return both + [(case, case.backends[0]) for case in (*first, *others, cases.HEAVY_CROSSING)]


def run_planned(plans: Plans, extent: Extent, progress: Progress) -> Chapter:
    """Run the chapter, on several processes."""
    plans.prepare(independent(extent), extent.jobs, progress)
    parity = [plan_parity(plans, case) for case in (*CROSSINGS, *CORNERS)]
    progress("parity")
    judged = judge_all(plans, extent)
    progress("statements")
    modes, rows = working_modes(plans, extent.modes), list(thesis()["rows"])
    chapter: Chapter = {
        "rule": thesis()["rule"],
        "parity": parity,
        "against_thesis": sorted([*judged, *modes.pop("judged")], key=lambda record: rows.index(record["row"])),
        "between_samples": between_records(plans),
        **modes,
        "shortest_returns_on_square": square_returns(plans, extent.modes),
    }
    progress("working modes")
    chapter["crossings"] = [crossing_record(plans, case) for case in CROSSINGS]
    chapter["heavy_end_effector"] = heavy_record(plans)
    progress("limits of the crossings")
    chapter["fair_comparison"] = machine_records(plans, extent.modes)
    progress("comparison of machines")
    chapter["sensitivity"] = sensitivity(plans, extent)
    progress("sensitivity")
    return chapter | {"conclusions": conclusions(chapter)}


def plan_parity(plans: Plans, case: Case) -> Record:
    """Plan a case with both backends; CrossCheckError if the plans differ by too much, or in status."""
    first, second = (plans.plan(case, backend) for backend in case.backends)
    differences = measures.plan_differences(first, second)
    worst = float(np.max(list(differences.values())))
    if first.status is not second.status or not worst <= PLAN_TOLERANCE:
        raise CrossCheckError(
            f"The plans of {case.name} by the two backends differ by {worst:.3g} (relative; at most {PLAN_TOLERANCE:g} "
            f"is allowed); they are {first.status.value} and {second.status.value}.",
            remedy="One of them is wrong: run `redundancy-pin validate` to see where.",
            parity=differences,
        )
    return {"case": case.name, **differences, "status": first.status.value, "worst": worst}


def between_records(plans: Plans) -> list[Record]:
    """Return the main stepwise plans at and between their samples, while the optimiser works: (3,) |τ|, N·m."""
    records = []
    for case in CORNERS:
        plan = plans.plan(case)
        optimised = plan.phase == plan.phases.index("optimise")
        steps = np.flatnonzero(np.diff(plan.t) * optimised[1:] > 0.0)
        times = plan.t[steps, None] + np.diff(plan.t)[steps, None] * np.arange(1, POINTS + 1) / (POINTS + 1)
        between = np.abs(plan.efforts_at(times.ravel(), case.dynamics())).max(axis=0)
        baseline = np.abs(plans.plan(cases.without_carriers(case)).tau).max(axis=0)
        records.append({"case": case.name, "at_samples": np.abs(plan.tau[optimised]).max(axis=0), "between": between,
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
        "beyond_track_at_exit": max(0.0, read("position_at_exit", plan)[0] - end),
        "beyond_track": max(0.0, read("farthest_position", plan)[0] - end),
        "shortest": float(measures.window(shortest)["return_time"]) if isinstance(shortest, Plan) else math.nan,
        "no_shortest": "" if isinstance(shortest, Plan) else shortest.message,
        "jump": read("exit_forces", plan),
        "peak_on_return": read("peak_in", plan, "return")[0],
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
    raised = [case for case in MODE_CASES.values() if case.option("speed") or case.option("acceleration")]
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
"""How far from half, in units of the baseline's peak, a torque may be and still count as half."""

SMALL_JUMP = 0.05
"""Smallest jump of a torque, N·m, that shows in a figure."""


@dataclass(frozen=True, eq=False)
class Compared:
    """A plan and that of the machine without carriers (``baseline``), at the same samples."""

    plan: Plan
    baseline: Plan

    @property
    def tau(self) -> Array:
        """(N, m) torque of the plan, without the samples added for braking, N·m."""
        return self.plan.tau[: len(self.baseline.t)]

    @property
    def accelerating(self) -> BoolArray:
        """(N,) whether the platform accelerates."""
        return measures.accelerating(self.baseline)

    @property
    def decided(self) -> BoolArray:
        """(N,) the same, without the second halves of two-sided samples: those are outcome, not choice, of a step."""
        chosen: BoolArray = self.accelerating & ~self.baseline.motion.jumps
        return chosen

    def limited(self, kind: str | None = None, carrier: int | None = None) -> BoolArray:
        """Return (N,) whether a carrier is at a limit; see ``measures.bounds``."""
        t = self.baseline.t
        at = np.zeros(len(t), dtype=bool)
        for _, _, start, end in bounds(self.plan, kind, carrier):
            at |= (t >= start) & (t <= end)
        return at

    def inside(self, start: float, end: float) -> BoolArray:
        """Return (N,) whether a sample lies between two times, s."""
        within: BoolArray = (self.baseline.t >= start - 1e-9) & (self.baseline.t <= end + 1e-9)
        return within

    @property
    def corner(self) -> BoolArray:
        """(N,) whether the platform is in the (first) corner."""
        jumps = self.baseline.t[self.baseline.motion.jumps]
        return self.inside(float(jumps[0]), float(jumps[1]))

    def peaks(self, where: BoolArray) -> tuple[Array, Array]:
        """Return (m,) largest |τ| of the plan and of the baseline at some samples, N·m."""
        largest = [np.abs(tau[where]).max(axis=0, initial=0.0) for tau in (self.tau, self.baseline.tau)]
        return largest[0], largest[1]


Runs = Mapping[str, Compared]
"""The runs of one working mode, by the names in ``MODE_CASES``."""

Outcome = tuple[bool, str]
"""Whether a claim holds, and the number that decides."""


def runs_of(plans: Plans, mode: Mode) -> dict[str, Compared]:
    """Return all runs of a working mode."""
    moded = {name: replace(case, working_mode=mode) for name, case in MODE_CASES.items()}
    return {name: Compared(plans.plan(case), plans.plan(cases.without_carriers(case))) for name, case in moded.items()}


# --- the claims of the data file -----------------------------------------------------------------------------------


def small_torque(runs: Runs) -> Outcome:
    """Hold if torques are of the order of 0.1 N·m at most away from limits."""
    run = runs["wide"]
    value = float(run.peaks(run.accelerating & ~run.limited())[0].max())
    return value <= 0.1 * np.sqrt(10.0), f"{value:.2g} N·m"


def second_exceeds_at_speed_limit(runs: Runs) -> Outcome:
    """Hold if τ2 exceeds the baseline where carrier 2 is at its speed limit before the corner."""
    run = runs["wide"]
    at = run.limited("speed", 2) & run.inside(0.0, 0.8)
    if not at.any():
        return False, "carrier 2 is never at its speed limit"
    ours, other = (peaks[1] for peaks in run.peaks(at))
    return bool(ours > other), f"{ours:.2g} against {other:.2g} N·m"


def sharp_exceeds(runs: Runs) -> Outcome:
    """Hold if τ2 and τ3 exceed the baseline in the sharp corner, at an acceleration limit."""
    run = runs["sharp"]
    ours, other = (peaks[1:] for peaks in run.peaks(run.corner))
    reached = bool((run.limited("acceleration") & run.corner).any())
    return bool((ours > other).all()) and reached, f"τ2, τ3 {_against(ours, other)}"


def cured_by_acceleration(runs: Runs) -> Outcome:
    """Hold if with 12 m/s² τ2 and τ3 stay below the baseline in the sharp corner."""
    run = runs["sharp 12"]
    ours, other = (peaks[1:] for peaks in run.peaks(run.corner))
    return bool((ours < other).all()), f"τ2, τ3 {_against(ours, other)}"


def first_jumps(runs: Runs) -> Outcome:
    """Hold if τ1 jumps as the sharp corner is entered, at an acceleration limit."""
    run = runs["sharp"]
    entered = int(np.flatnonzero(run.baseline.motion.jumps)[0])
    step, start = float(abs(run.tau[entered, 0] - run.tau[entered - 1, 0])), float(run.baseline.t[entered])
    limited = bool((run.limited("acceleration") & run.inside(start, start + 0.02)).any())
    return step > SMALL_JUMP and limited, f"{step:.2g} N·m, acceleration limit {'met' if limited else 'not met'}"


def wide_half(runs: Runs, name: str = "wide half") -> Outcome:
    """Hold if the torque is half of the baseline's at the wide corner."""
    run = runs[name]
    other = run.baseline.tau
    off = float(np.abs(run.tau - 0.5 * other)[run.decided].max() / np.abs(other).max())
    return off <= HALF, f"off half by {off:.2g} of the baseline's peak"


def square_half(runs: Runs) -> Outcome:
    """Hold if the torque is half of the baseline's in ramps and corners of the square."""
    return wide_half(runs, "square half")


def no_limit(runs: Runs) -> Outcome:
    """Hold if no carrier meets a limit."""
    met = sorted({f"{kind} of {carrier}" for carrier, kind, _, _ in bounds(runs["wide half"].plan)})
    return not met, ", ".join(met) if met else "none met"


def returns_exceed(runs: Runs) -> Outcome:
    """Hold if all torques exceed the baseline while carriers return."""
    run = runs["square half"]
    ours, other = run.peaks((run.plan.phase == run.plan.phases.index("return"))[: len(run.baseline.t)])
    return bool((ours > other).all()), _against(ours, other)


def first_accelerates_least(runs: Runs) -> Outcome:
    """Hold if carrier 1 accelerates least on the return at 1.1 s."""
    plan = runs["square half"].plan
    first, second, third = np.abs(plan.carriers.sdd[int(np.abs(plan.t - 1.1).argmin())])
    return bool(first < min(second, third)), f"{first:.2g}, {second:.2g}, {third:.2g} m/s²"


def square_spikes(runs: Runs) -> Outcome:
    """Hold if torques at the speed limits on the square exceed the baseline's peak."""
    run = runs["square"]
    at = run.limited("speed") & run.accelerating
    if not at.any():
        return False, "no speed limit met"
    ours, other = float(run.peaks(at)[0].max()), float(np.abs(run.baseline.tau).max())
    return ours > other, f"{ours:.2g} against {other:.2g} N·m"


def cured_by_speed(runs: Runs) -> Outcome:
    """Hold if with 1.2 m/s torques stay below the baseline's peaks while the platform accelerates."""
    run = runs["square 1.2"]
    ours, other = run.peaks(run.accelerating)[0], np.abs(run.baseline.tau).max(axis=0)
    return bool((ours < other).all()), _against(ours, other)


def _against(ours: Array, other: Array) -> str:
    return f"{text(ours, '.2g')} against {text(other, '.2g')} N·m"


# --- records -------------------------------------------------------------------------------------------------------


def working_modes(plans: Plans, modes: Sequence[Mode]) -> dict[str, list[Record]]:
    """Return records of each mode and case, of each claim with its outcome in each mode, and those as verdicts."""
    runs = {mode: runs_of(plans, mode) for mode in modes}
    records = [
        {"mode": mode, "case": MODE_CASES[name].name, "baseline_peak": np.abs(run.baseline.tau).max(axis=0),
         "peak": run.plan.peak_effort_at_samples, "rms": run.plan.rms_effort, "limits": measures.limits_met(run.plan),
         "status": run.plan.status.value}
        for mode, of_mode in runs.items()
        for name, run in of_mode.items()
    ]  # fmt: skip
    claims = []
    for entry in thesis()["claims"]:
        test: Callable[[Runs], Outcome] = globals()[entry["test"]]
        outcomes = {mode_text(mode): test(of_mode) for mode, of_mode in runs.items()}
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


# --- conclusions of the thesis, from the chapter on its own planners -----------------------------------------------


def conclusions(chapter: Mapping[str, Any]) -> list[Record]:
    """Return what becomes of the thesis's conclusions, from the records of the chapter."""
    crossings, machines = chapter["crossings"], chapter["fair_comparison"]
    records = [
        *_crossings(crossings, chapter["heavy_end_effector"]),
        _corner("wide_corner", machines, "corner-r0.025"),
        _corner("sharp_corner", machines, "corner-r0.013"),
        _square(machines),
        _shared(machines),
        _agreement(chapter["claims"]),
    ]
    return [{**record, "thesis": record["claim"]} for record in records]


def _crossings(crossings: Sequence[Record], heavy: Record | None) -> list[Record]:
    inside = [record["case"] for record in crossings if record["status"] == "ok"]
    broken = [record for record in crossings if record["status"] == "limit_violated"]
    exact, out = max(max(record["jump"]) for record in crossings), "beyond_track_at_exit"
    artefact = exact < STATED_FORCE
    return [
        claim("crossing", verdict(len(inside) + (heavy is None), len(crossings) + 1), crossed=len(crossings),
              inside=inside, heavy=heavy),
        counted("limits", len(crossings) - len(broken), len(crossings),
                broken=[record["case"] for record in broken],
                out=[(record["case"], record[out]) for record in crossings if record[out]],
                cured=[(record["case"], record["shortest"]) for record in broken if not record["no_shortest"]],
                never=[record["case"] for record in crossings if record["no_shortest"]]),
        claim("exit_forces", "does not stand" if artefact else "stands", artefact=artefact, exact=exact),
    ]  # fmt: skip


def _by_mode(machines: Sequence[Record], motion: str) -> list[dict[str, Record]]:
    """Return, for each working mode, the records of a motion by what moves."""
    groups = grouped([record for record in machines if record["motion"] == motion], "mode").values()
    return [{record["what"]: record for record in group} for group in groups]


def _corner(name: str, machines: Sequence[Record], motion: str) -> Record:
    groups, moving = _by_mode(machines, motion), f"{MOVING}, λ = 0"

    def below(what: str, other: str) -> int:
        return sum(group[what]["peak"] < group[other]["peak"] for group in groups)

    lower, total = below(moving, NONE), len(groups)
    # of the sharper corner the thesis says that torques exceed the baseline's
    good = total - lower if name == "sharp_corner" else lower
    raised = {what.rpartition(", ")[2]: below(what, NONE) for what in groups[0] if what.startswith(moving + ",")}
    factors, parked = (ratios([(group[what], group[NONE]) for group in groups], "peak") for what in (moving, PARKED))
    return counted(name, good, total, below=lower, below_parked=below(moving, PARKED), factors=factors, parked=parked,
                   raised=raised)  # fmt: skip


def _square(machines: Sequence[Record]) -> Record:
    groups = _by_mode(machines, "square")
    pairs = [(group[what], group[NONE]) for group in groups for what in group if what.startswith(MOVING)]
    better = sum(moving["peak"] < none["peak"] for moving, none in pairs)
    broken = sum(moving["status"] != "ok" for moving, _ in pairs)
    peaks, rms = ratios(pairs, "peak"), ratios(pairs, "rms")
    return counted("square", better, len(pairs), better=better, broken=broken, peaks=peaks, rms=rms)


def _shared(machines: Sequence[Record]) -> Record:
    groups = [group for motion in ("corner-r0.025", "corner-r0.013") for group in _by_mode(machines, motion)]
    pairs = [(group[f"{MOVING}, λ = 0"], group[NONE]) for group in groups]
    relieved = sum(all(moving[key] < none[key] for key in ("peak", "main_energy")) for moving, none in pairs)
    forces = [moving["carrier_force"] for moving, _ in pairs]
    return counted("shared", relieved, len(pairs), relieved=relieved, main=ratios(pairs, "main_energy"),
                   energy=ratios(pairs, "energy"), carrier_force=forces)  # fmt: skip


def _agreement(claims: Sequence[Record]) -> Record:
    counts = {mode: sum(entry["modes"][mode]["holds"] for entry in claims) for mode in claims[0]["modes"]}
    best, total = max(counts.values()), len(claims)
    complete = sum(count == total for count in counts.values())
    modes = [mode for mode, count in counts.items() if count == best]
    return claim("agreement", verdict(complete, len(counts)), total=total, best=best, modes=modes)
