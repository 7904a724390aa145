"""The chapter beyond the thesis: its planners against the whole-trajectory planner, and checks of the plans."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis import cases, measures
from redundancy_pin.thesis.case import Call, Case, Mode, Plans, call_of, plan_or_error
from redundancy_pin.thesis.cases import EFFORT, NONE, PEAK, STEPWISE, SWITCH_OFF, TASKS, Extent, by_method
from redundancy_pin.thesis.claims import BETWEEN, FINDINGS, SAME_PLAN, by_task, peak_text, verdicts
from redundancy_pin.thesis.planned import compare_backends
from redundancy_pin.thesis.table import Record, Table, table

INFEASIBLE = ResultStatus.INFEASIBLE.value
"""Status of a record whose planner has no plan."""

SAME_COST = 1e-4
"""Relative difference of costs up to which two optima count as the same."""

ORDERED = 1e-6
"""Relative rise of a quantity that should fall which still counts as rounding of the solver."""

GROWTH = 1.3
"""Factor on the speed until it is too high."""

_MORE = 1.01
"""Factor on the acceleration that would suffice, to see whether a plan exists then: bounds are met to rounding."""

_CAPPED_COARSER = 2.0
"""Factor on the step, and on the width of the bracket, of the race with limited efforts: many more limits bind."""

TARGETS = (
    ("circle-0.5", EFFORT, 0.21),
    ("circle-0.5", PEAK, 0.11),
    ("corner-r0.025", PEAK, 2.27),
    ("corner-r0.013", PEAK, 7.2),
)
"""Task, method, and the largest |τ| at the nodes that was aimed at, N or N·m."""

MODE_METHODS = (NONE, cases.PARKED, STEPWISE, cases.STEPWISE_HALF, EFFORT, PEAK, cases.PEAK_FREE)
"""Plans of the corners in each mode; the last leaves the end free, as stepwise planning does."""


def _methods(extent: Extent) -> list[tuple[Case, Sequence[str]]]:
    """Return the tasks, and the corners in every working mode, with their methods."""
    moded = [replace(task, working_mode=mode) for task in cases.TURNS[:2] for mode in extent.modes]
    return [*((task, cases.methods(task)) for task in TASKS), *((task, MODE_METHODS) for task in moded)]


def _compared(extent: Extent) -> list[Case]:
    """Return the cases that both backends plan."""
    compared = (EFFORT, PEAK) if extent.both_backends else (EFFORT,)
    return [by_method(task, method, extent.coarser) for task in TASKS if len(task.backends) > 1 for method in compared]


def _started(extent: Extent) -> list[Case]:
    """Return the cases that are planned from several first guesses."""
    return [
        by_method(task, method, extent.starts_coarser).with_options(starts=extent.starts, refinements=0)
        for task in extent.started
        for method in (EFFORT, PEAK)
    ]


def calls(extent: Extent) -> list[Call]:
    """Return the calls that make races, trade-offs and plans of the chapter."""
    races = [(f"as fast as the limits allow: {race.task.name}", run_race, race, extent) for race in extent.races]
    trades = [(f"trade-off: {task.name}", trade_record, task, extent) for task in cases.TRADED]
    first = [by_method(task, method, extent.coarser) for task, several in _methods(extent) for method in several]
    second = [call_of(case, backend) for case in _compared(extent) for backend in case.backends[1:]]
    # a race takes as long as a hundred plans: it begins before them, so that no process waits for it in the end
    return [*races, *trades, *map(call_of, (*first, *_started(extent))), *second]


def run_beyond(plans: Plans, extent: Extent) -> dict[str, Any]:
    """Return the records of the chapter."""
    records = [plan_record(plans, task, method, extent.coarser) for task in TASKS for method in cases.methods(task)]
    chapter = {
        "plans": records,
        "targets": targets(records),
        "fastest": [plans.result("", run_race, race, extent) for race in extent.races],
        "working_modes": [
            mode_record(plans, task, mode, extent.coarser) for task in cases.TURNS[:2] for mode in extent.modes
        ],
        "backends": [backend_record(plans, case) for case in _compared(extent)],
        "first_guesses": [starts_record(plans, case) for case in _started(extent)],
        "trade_off": [plans.result("", trade_record, task, extent) for task in cases.TRADED],
    }
    return chapter | {"findings": verdicts(FINDINGS, chapter)}


def plan_record(plans: Plans, task: Case, method: str, coarser: float = 1.0) -> Record:
    """Return a task by a method in numbers.

    ``peak`` is at the samples, ``dense_peak`` between them, ``worst`` the larger one; ``sound`` plans have finite
    efforts within all limits and, of an optimiser, are optimal; NaN without a plan, whose reason is ``why``.
    """
    case = by_method(task, method, coarser)
    outcome = plans.outcome(case)
    saved = method in cases.OBJECTIVES or cases.crosses(task)
    record = {"task": task.name, "way": method, "unit": task.unit, **measures.numbers(outcome)}
    if isinstance(outcome, InfeasiblePlanError):
        singular = outcome.details.get("constraint") == "singular_pose"
        missing = outcome.details.get("amount", math.nan) if singular else math.nan
        return {**record, "dense_peak": math.nan, "worst": math.nan, "file": "", "exists": False,
                "sound": False, "why": outcome.message, "missing": missing}  # fmt: skip
    between = float(outcome.peak_effort.max())
    return {**record, "dense_peak": between, "worst": max(record["peak"], between), "exists": True, "missing": math.nan,
            "file": f"beyond-{case.name}" if saved else "", "sound": outcome.status is ResultStatus.OK,
            "why": ""}  # fmt: skip


def targets(records: Sequence[Record]) -> list[Record]:
    """Return every number that was aimed at with what came out: met if sound, reached, and no worse between nodes."""
    groups, results = by_task(records), []
    for task, method, aim in TARGETS:
        record = groups[task][method]
        nodes, between, sound = record["peak"], record["dense_peak"], record["sound"]
        met = bool(sound and nodes <= aim and between <= BETWEEN * nodes)
        results.append({"task": task, "way": method, "unit": record["unit"], "asked": aim, "found": nodes,
                      "between": between, "sound": sound, "met": met})  # fmt: skip
    return results


def headline(records: Sequence[Record]) -> Table:
    """Return the largest main effort of every motion by every planner; the README shows this table."""
    groups, rows = by_task(records), []
    for task in TASKS:
        group = groups.get(task.name, {})
        thesis = (SWITCH_OFF, cases.SWITCH_OFF_LATE) if cases.crosses(task) else (STEPWISE,)
        if EFFORT in group:
            shown = {"none": group.get(NONE), "thesis": best(group.get(method) for method in thesis),
                     "effort": group[EFFORT], "peak": group.get(PEAK)}  # fmt: skip
            rows.append({"motion": task.title, **{name: peak_text(record) for name, record in shown.items()}})
    return table("headline", rows)


def best(records: Iterable[Record | None]) -> Record | None:
    """Return the plan of least main effort that keeps every limit; one that breaks limits only if none keeps them."""
    existing = [record for record in records if record is not None]
    return min(existing, key=lambda r: (not r["exists"], not r["sound"], r["worst"]), default=None)


# --- how fast: bisection on speed with the verdict of the planner --------------------------------------------------
#
# The problem is not convex, so a verdict "infeasible" is local: no plan was found from any first guess. A speed counts
# as out of reach only if every first guess fails with two objectives, which lead the solver to different places.


def run_race(race: cases.Race, extent: Extent) -> Record:
    """Bracket a race in any process; main efforts of a capped one are limited to what switching off needs."""
    if not race.capped:
        return fastest(Plans(), race.task, extent)
    cap = plan_record(Plans(), race.task, SWITCH_OFF, extent.coarser)["before"]
    wider = replace(extent, coarser=extent.coarser * _CAPPED_COARSER, tolerance=extent.tolerance * _CAPPED_COARSER)
    return fastest(Plans(), race.task, wider, cap)


def fastest(plans: Plans, task: Case, extent: Extent, effort: float = math.inf) -> Record:
    """Bracket the fastest motion that has a plan.

    Speeds are tried with parked carriers as the first guess; the upper end of the bracket then from all first guesses,
    and the bisection continues if one of them gives a plan.

    Raises:
        InfeasiblePlanError: the task has no plan at its own speed.
    """
    trials: dict[float, Record] = {}
    limit = {} if math.isinf(effort) else {"effort": effort}

    def case_at(speed: float, **changed: Any) -> Case:
        whole = by_method(task, EFFORT, extent.coarser).with_options(refinements=1, **limit, **changed)
        return cases.at_speed(whole, speed)

    def feasible(speed: float, starts: int = 1) -> bool | None:  # None where the ramps do not fit in
        case = case_at(speed, **({"starts": starts} if starts > 1 else {}))
        if speed not in trials or (starts > 1 and not trials[speed]["feasible"]):
            try:
                case.trajectory()
            except InputError:
                return None
            trials[speed] = attempt(plans, case)
        return bool(trials[speed]["feasible"])

    def bracket(low: float, high: float) -> tuple[float, float | None]:
        while found := feasible(high):
            low, high = high, high * GROWTH
        if found is None:
            return low, None
        while high - low > extent.tolerance * low:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if feasible(middle) else (low, middle)
        return low, high

    own = task.option("speed")
    plans.plan(case_at(own))
    feasible(own)
    low, high = bracket(own, own * GROWTH)
    while high is not None and feasible(high, extent.starts):
        low, high = bracket(high, high * (1.0 + extent.tolerance))
    above = None if high is None else trials[high]
    suffices = None
    if above and above["constraint"] == "acceleration" and not math.isnan(above["limit"]):
        # the planner says which acceleration would do: does it?
        wider = plans.outcome(case_at(above["speed"], acceleration=_MORE * abs(above["limit"])))
        suffices = isinstance(wider, Plan)
    return {"task": task.name, "title": task.title.rpartition(" at ")[0], "unit": task.unit, "effort_limit": effort,
            "fastest_with_plan": trials[low], "slowest_without": above, "starts": extent.starts if above else 0,
            "suffices": suffices, "trials": [trials[speed] for speed in sorted(trials)]}  # fmt: skip


def attempt(plans: Plans, case: Case) -> Record:
    """Try one speed from the first guesses of a case, with its objective and with the gentlest motion as the aim."""
    reasons = {"constraint": "", "joint": "", "time": math.nan, "limit": math.nan, "unit": "", "fraction": math.nan}
    record = {"speed": case.option("speed"), "feasible": False, "status": INFEASIBLE, "peak": math.nan, "binding": [],
              **reasons, "said": ""}  # fmt: skip
    failed = record
    for attempted in (case, case.with_options(objective=(("carrier_acceleration", 1.0),))):
        outcome = plans.outcome(attempted)
        if isinstance(outcome, InfeasiblePlanError):
            details = {key: outcome.details[key] for key in reasons if outcome.details.get(key) is not None}
            failed = {**record, **details, "said": outcome.message}
        elif outcome.status in (ResultStatus.OK, ResultStatus.NOT_CONVERGED, ResultStatus.UNRESOLVED):
            binding = sorted({f"{event.quantity} of {event.joint}" for event in outcome.limits.binding})
            peak = float(outcome.peak_effort.max())
            return {**record, "feasible": True, "status": outcome.status.value, "peak": peak, "binding": binding}
        else:
            message = "the plan breaks limits or has no finite efforts"
            failed = {**record, "status": outcome.status.value, "said": message}
    return failed


# --- working modes, backends, first guesses, trade-off -------------------------------------------------------------


def mode_record(plans: Plans, task: Case, mode: Mode, coarser: float) -> Record:
    """Return a corner in a working mode by all of ``MODE_METHODS``."""
    moded = replace(task, working_mode=mode)
    rows = {method: plan_record(plans, moded, method, coarser) for method in MODE_METHODS}
    ratio = rows[PEAK]["worst"] / rows[NONE]["worst"]
    return {"radius": task.option("radius"), "mode": mode, "rows": rows, "ratio": ratio,
            "lower": bool(rows[PEAK]["sound"] and ratio < 1.0)}  # fmt: skip


def backend_record(plans: Plans, case: Case) -> Record:
    """Compare the plans and costs of a case by both backends."""
    compared, outcomes = compare_backends(plans, case), [plans.outcome(case, backend) for backend in case.backends]
    costs = [float(str(plan.diagnostics["cost"])) for plan in outcomes if isinstance(plan, Plan)]
    cost = (max(costs) - min(costs)) / max(map(abs, costs)) if len(costs) == 2 else compared["worst"]
    first, second = compared["statuses"]
    return {**compared, "cost": cost, "same": compared["worst"] <= SAME_PLAN and first == second}


def starts_record(plans: Plans, case: Case) -> Record:
    """Return the scaled costs of a case from each first guess, parked carriers first; NaN without a plan."""
    outcome = plans.outcome(case)
    starts: Any = {} if isinstance(outcome, InfeasiblePlanError) else outcome.diagnostics["starts"]
    costs = [float(cost) for cost in starts.get("costs", [math.nan] * case.option("starts"))]
    reached = sorted(cost for cost in costs if not math.isnan(cost))
    optima, last = 0, -math.inf
    for cost in reached:
        if cost > last + SAME_COST * abs(cost):
            optima, last = optima + 1, cost
    best, last = (reached[0], reached[-1]) if reached else (math.nan, math.nan)
    return {"case": case.name, "step": case.dt, "costs": costs, "missing": len(costs) - len(reached), "best": best,
            "excess": (last - best) / best, "optima": optima,
            "parked_is_best": bool(reached) and costs[0] <= best * (1.0 + SAME_COST)}  # fmt: skip


def trade_record(task: Case, extent: Extent) -> Record:
    """Return effort against the carriers' acceleration: what each weight between the two leads to.

    A weight is ``ratio`` times the one at which both parts of the cost are the same for the plan of least effort.
    """
    case = by_method(task, EFFORT, extent.coarser)
    least = case.plan()
    effort: Mapping[str, Any] = least.diagnostics["objective"]  # type: ignore[assignment]
    equal = float(effort["effort"]) / _square_integral(least)
    outcomes: list[tuple[float, Plan | InfeasiblePlanError]] = [(0.0, least)]
    for ratio in extent.ratios:
        weighted = case.with_options(objective=(("effort", 1.0), ("carrier_acceleration", ratio * equal)))
        outcomes.append((ratio, plan_or_error(weighted, case.backends[0])))
    points = []
    for ratio, outcome in outcomes:
        shown, acceleration = measures.numbers(outcome), math.nan
        if isinstance(outcome, Plan):
            acceleration = float(np.sqrt(_square_integral(outcome) / (outcome.t[-1] - outcome.t[0])))
        points.append({"ratio": ratio, "weight": ratio * equal, "rms_effort": shown["rms"], "peak": shown["peak"],
                       "rms_acceleration": acceleration, "status": shown["status"]})  # fmt: skip
    planned = [point for point in points if point["status"] != INFEASIBLE]
    efforts, accelerations = ([point[key] for point in planned] for key in ("rms_effort", "rms_acceleration"))
    # between global optima effort rises and acceleration falls with the weight
    monotone = rises(efforts) and rises(accelerations[::-1])
    return {"task": task.name, "title": task.title, "unit": task.unit, "monotone": monotone, "points": points}


def _square_integral(plan: Plan) -> float:
    """Return ∫ Σ s̈² dt by the trapezoidal rule, m²/s³."""
    return float(np.trapezoid((plan.carriers.sdd**2).sum(axis=1), plan.t))


def rises(values: Sequence[float]) -> bool:
    """Return whether values rise, within ``ORDERED``."""
    return all(after >= before * (1.0 - ORDERED) for before, after in pairwise(values))
