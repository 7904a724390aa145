"""The chapter on the thesis's own planners: both backends, working modes, limits, and the same machine compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import largest
from redundancy_pin.errors import CrossCheckError, InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.thesis import cases, measures
from redundancy_pin.thesis.cases import CORNERS, CROSSINGS, MODE_CASES, MOVING, NONE, Case, Plans
from redundancy_pin.thesis.claims import CONCLUSIONS, verdicts
from redundancy_pin.thesis.in_words import judge_in_words, mode_records, runs_of
from redundancy_pin.thesis.measures import numbers, read
from redundancy_pin.thesis.statements import judge_all, needed, sensitivity, thesis
from redundancy_pin.thesis.table import Record

PLAN_TOLERANCE = 1e-8
"""Largest relative difference of two plans: rounding changes the steps of the integrator of the carriers."""

POINTS = 4
"""Points inside each step at which stepwise plans are evaluated."""


def calls(extent: cases.Extent) -> list[cases.Call]:
    """Return the calls that make the plans of the chapter."""
    moded = [replace(case, working_mode=mode) for mode in extent.modes for case in MODE_CASES]
    first = (*needed(extent), *moded, *map(cases.without_carriers, moded))
    shortest = [case.with_options(return_time="shortest") for case in (*CROSSINGS, *_squares(extent.modes))]
    others = [*shortest, *map(cases.parked, (*CROSSINGS, *moded)), cases.HEAVY_CROSSING]
    both = [cases.call_of(case, backend) for case in extent.parity for backend in case.backends]
    return both + [cases.call_of(case) for case in (*CROSSINGS, *CORNERS, *first, *others)]


def run_planned(plans: Plans, extent: cases.Extent) -> dict[str, Any]:
    """Return the records of the chapter."""
    runs = {mode: runs_of(plans, mode) for mode in extent.modes}
    claims, judged = judge_in_words(runs)
    rows = list(thesis()["rows"])
    chapter = {
        "rule": thesis()["rule"],
        "parity": [plan_parity(plans, case) for case in extent.parity],
        "against_thesis": sorted([*judge_all(plans, extent), *judged], key=lambda record: rows.index(record["row"])),
        "between_samples": [_between_record(plans, case) for case in CORNERS],
        "working_modes": mode_records(runs),
        "claims": claims,
        "shortest_returns_on_square": [_return_record(plans, case) for case in _squares(extent.modes)],
        "crossings": [_crossing_record(plans, case) for case in CROSSINGS],
        "heavy_end_effector": _heavy_record(plans),
        "fair_comparison": _machine_records(plans, extent.modes),
        "sensitivity": sensitivity(plans, extent),
    }
    return chapter | {"conclusions": verdicts(CONCLUSIONS, chapter, complete=extent.complete)}


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


def _between_record(plans: Plans, case: Case) -> Record:
    """Return a stepwise plan at and between its samples, while the optimiser works: (3,) |τ|, N·m."""
    plan = plans.plan(case)
    optimised = plan.phase == plan.phases.index("optimise")
    steps = np.flatnonzero(np.diff(plan.t) * optimised[1:] > 0.0)
    times = plan.t[steps, None] + np.diff(plan.t)[steps, None] * np.arange(1, POINTS + 1) / (POINTS + 1)
    return {"case": case.name, "at_samples": largest(plan.tau[optimised]),
            "between": largest(plan.efforts_at(times.ravel(), case.dynamics())),
            "baseline": largest(plans.plan(cases.without_carriers(case)).tau)}  # fmt: skip


def _crossing_record(plans: Plans, case: Case) -> Record:
    """Return what became of a crossing: limits broken, the shortest return, the jump on switching on."""
    plan, shortest = plans.plan(case), plans.outcome(case.with_options(return_time="shortest"))
    end = float(plan.limits.judged_by.track[:, 1].max())
    return {
        "case": case.name,
        "status": plan.status.value,
        "broken": numbers(plan)["broken"],
        "beyond_track_at_exit": max(0.0, read(plan, "position_at_exit")[0] - end),
        "beyond_track": max(0.0, read(plan, "farthest_position")[0] - end),
        "shortest": read(shortest, "time_of", "return_time")[0] if isinstance(shortest, Plan) else math.nan,
        "no_shortest": "" if isinstance(shortest, Plan) else shortest.message,
        "jump": read(plan, "exit_forces"),
        "peak_on_return": read(plan, "peak_in", "return")[0],
    }


def _heavy_record(plans: Plans) -> Record | None:
    """Return why the circle cannot be crossed with a massive end-effector; None if it can."""
    outcome = plans.outcome(cases.HEAVY_CROSSING)
    if not isinstance(outcome, InfeasiblePlanError):
        return None
    mass = dict(cases.HEAVY_CROSSING.arguments)["end_effector_mass"]
    return {"what": f"end-effector of {mass:g} kg", "message": outcome.message, "details": dict(outcome.details)}


def _squares(modes: Sequence[cases.Mode]) -> list[Case]:
    return [replace(case, working_mode=mode) for mode in modes for case in (CORNERS[5], CORNERS[4])]


def _return_record(plans: Plans, case: Case) -> Record:
    """Return the shortest returns on the square within all limits, s, or why there are none."""
    outcome = plans.outcome(case.with_options(return_time="shortest"))
    spans, why = np.empty((0, 2)), ""
    if isinstance(outcome, Plan):
        spans = np.asarray(outcome.diagnostics["returns"], dtype=float).reshape(-1, 2)
    else:
        why = outcome.message
    return {"mode": case.working_mode, "lam": case.option("lam"), "durations": spans[:, 1] - spans[:, 0], "why": why}


# --- no carriers, carriers parked, carriers moving; both sets of actuators counted ---------------------------------


def _machine_records(plans: Plans, modes: Sequence[cases.Mode]) -> list[Record]:
    """Compare for every motion of the thesis; corners and square in every working mode."""
    rows: list[tuple[str, cases.Mode, str, Case]] = []
    for case in CROSSINGS:
        motion = cases.motion_name(case)
        if motion not in [row[0] for row in rows]:
            rows.append((motion, (), cases.PARKED, cases.parked(case)))
        rows.append((motion, (), f"{MOVING}, off above CN {case.option('threshold'):g}", case))
    raised = [case for case in MODE_CASES if case.option("speed") or case.option("acceleration")]
    for mode in modes:
        for motion in ("corner-r0.025", "corner-r0.013", "square"):
            moded = [replace(case, working_mode=mode) for case in (*CORNERS, *raised) if case.name.startswith(motion)]
            rows.append((motion, mode, NONE, cases.without_carriers(moded[0])))
            rows.append((motion, mode, cases.PARKED, cases.parked(moded[0])))
            for case in moded:
                acceleration, speed = case.option("acceleration"), case.option("speed")
                limit = f", {acceleration:g} m/s²" if acceleration else f", {speed:g} m/s" if speed else ""
                rows.append((motion, mode, f"{MOVING}, λ = {case.option('lam'):g}{limit}", case))
    return [_machine(*row, plans.plan(row[-1])) for row in rows]


def _machine(motion: str, mode: cases.Mode, how: str, case: Case, plan: Plan) -> Record:
    bounded = plan.status is not ResultStatus.UNBOUNDED
    # along a singular motion efforts without a plan grow without bound between samples, even if no sample is singular
    bounded &= not (how == cases.PARKED and (plan.sample_status != SampleStatus.OK).any())
    shown = numbers(plan)
    if not bounded:
        shown |= dict.fromkeys(("peak", "rms", "main_energy", "energy"), math.inf) | {"status": "unbounded"}
    kept = ("peak", "rms", "carrier_force", "main_energy", "carrier_energy", "energy", "status")
    return {"motion": motion, "mode": mode, "what": how, "unit": case.unit,
            **{name: shown[name] for name in kept}}  # fmt: skip
