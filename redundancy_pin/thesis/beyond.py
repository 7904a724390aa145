"""The chapters beyond the thesis: its planners against the whole-trajectory planner, checks of plans, future work."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.base_wrench import load_at_rest
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot.lookup import find_joint_index
from redundancy_pin.simulation.replay import replay
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis import cases
from redundancy_pin.thesis.cases import EFFORT, NONE, PEAK, STEPWISE, TASKS, Case, Extent, Plans, by_method
from redundancy_pin.thesis.claims import BETWEEN, FINDINGS, SAME_PLAN, by_task, peak_text, verdicts
from redundancy_pin.thesis.measures import numbers
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

TARGETS = (
    ("circle-0.5", EFFORT, 0.21),
    ("circle-0.5", PEAK, 0.11),
    ("corner-r0.025", PEAK, 2.27),
    ("corner-r0.013", PEAK, 7.2),
)
"""Task, method, and the largest |τ| at the nodes that was aimed at, N or N·m."""

MODE_METHODS = (NONE, cases.PARKED, STEPWISE, cases.STEPWISE_HALF, EFFORT, PEAK, cases.PEAK_FREE)
"""Plans of the corners in each mode; the last leaves the end free, as stepwise planning does."""


def _moded(extent: Extent) -> list[Case]:
    return [replace(task, working_mode=mode) for task in cases.TURNS[:2] for mode in extent.modes]


def _compared(extent: Extent) -> list[Case]:
    compared = [by_method(task, method, extent.coarser) for task, method in extent.compared]
    return [case for case in compared if len(case.backends) > 1]


def _started(extent: Extent) -> list[Case]:
    guesses = {"starts": extent.starts, "refinements": 0}
    return [by_method(task, method, extent.starts_coarser).with_options(**guesses)
            for task in extent.started for method in (EFFORT, PEAK)]  # fmt: skip


def _trades(extent: Extent) -> list[cases.Call]:
    return [(f"trade-off: {task.name}", trade_record, task, extent) for task in cases.TRADED if extent.ratios]


def calls(extent: Extent) -> list[cases.Call]:
    """Return the calls that make races, trade-offs and plans of the chapter."""
    races = [(f"as fast as the limits allow: {task.name}", run_race, task, extent) for task in extent.races]
    first = [by_method(task, method, extent.coarser) for task in TASKS for method in cases.methods(task)]
    first += [by_method(task, method, extent.coarser) for task in _moded(extent) for method in MODE_METHODS]
    second = [cases.call_of(case, backend) for case in _compared(extent) for backend in case.backends[1:]]
    # a race takes as long as a hundred plans: it begins before them, so that no process waits for it in the end
    return [*races, *_trades(extent), *map(cases.call_of, (*first, *_started(extent))), *second]


def run_beyond(plans: Plans, extent: Extent) -> dict[str, Any]:
    """Return the records of the chapter."""
    records = [plan_record(plans, task, method, extent.coarser) for task in TASKS for method in cases.methods(task)]
    chapter = {
        "plans": records,
        "targets": targets(records) if extent.coarser == 1.0 else [],  # for the steps of the full run
        "fastest": [plans.result("", run_race, task, extent) for task in extent.races],
        "working_modes": [mode_record(plans, task, extent.coarser) for task in _moded(extent)],
        "backends": [backend_record(plans, case) for case in _compared(extent)],
        "first_guesses": [starts_record(plans, case) for case in _started(extent)],
        "trade_off": [plans.result(*call) for call in _trades(extent)],
    }
    return chapter | {"findings": verdicts(FINDINGS, chapter, complete=extent.complete)}


def plan_record(plans: Plans, task: Case, method: str, coarser: float = 1.0) -> Record:
    """Return a task by a method in numbers.

    ``peak`` is at the samples, ``dense_peak`` between them, ``worst`` the larger one; ``sound`` plans have finite
    efforts within all limits and, of an optimiser, are optimal; NaN without a plan, whose reason is ``why``.
    """
    case = by_method(task, method, coarser)
    outcome = plans.outcome(case)
    record = {"task": task.name, "way": method, "unit": task.unit, **numbers(outcome),
              "exists": isinstance(outcome, Plan), "sound": False, "dense_peak": math.nan, "worst": math.nan,
              "missing": math.nan, "file": "", "why": ""}  # fmt: skip
    if isinstance(outcome, InfeasiblePlanError):
        singular = outcome.details.get("constraint") == "singular_pose"
        missing = outcome.details.get("amount", math.nan) if singular else math.nan
        return record | {"why": outcome.message, "missing": missing}
    between, saved = float(outcome.peak_effort.max()), method in cases.OBJECTIVES or cases.crosses(task)
    return record | {"dense_peak": between, "worst": max(record["peak"], between),
                     "file": f"beyond-{case.name}" if saved else "",
                     "sound": outcome.status is ResultStatus.OK}  # fmt: skip


def targets(records: Sequence[Record]) -> list[Record]:
    """Return every number that was aimed at with what came out: met if sound, reached, and no worse between nodes."""
    groups, results = by_task(records), []
    for task, method, aim in TARGETS:
        record = groups[task][method]
        nodes, between, sound = record["peak"], record["dense_peak"], record["sound"]
        met = bool(sound and nodes <= aim and between <= BETWEEN * nodes)
        results.append({"task": task, "way": method, "unit": record["unit"], "asked": aim, "found": nodes,
                        "between": between, "met": met})  # fmt: skip
    return results


def headline(records: Sequence[Record]) -> Table:
    """Return the largest main effort of every motion by every planner; the README shows this table."""
    groups, rows = by_task(records), []
    for task in TASKS:
        group = groups.get(task.name, {})
        thesis = (cases.SWITCH_OFF, cases.SWITCH_OFF_LATE) if cases.crosses(task) else (STEPWISE,)
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


def run_race(task: Case, extent: Extent) -> Record:
    """Bracket the fastest motion in any process."""
    return fastest(Plans(), task, extent)


def fastest(plans: Plans, task: Case, extent: Extent) -> Record:
    """Bracket the fastest motion that has a plan.

    Speeds are tried with parked carriers as the first guess; the upper end of the bracket then from all first guesses,
    and the bisection continues if one of them gives a plan.

    Raises:
        InfeasiblePlanError: the task has no plan at its own speed.
    """
    whole = by_method(task, EFFORT, extent.coarser).with_options(refinements=1)
    trials: dict[float, Record] = {}

    def feasible(speed: float, **starts: int) -> bool | None:  # None where the ramps do not fit in
        if speed not in trials or (starts and not trials[speed]["feasible"]):
            case = cases.at_speed(whole.with_options(**starts), speed)
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
    plans.plan(cases.at_speed(whole, own))
    feasible(own)
    low, high = bracket(own, own * GROWTH)
    while high is not None and feasible(high, starts=extent.starts):
        low, high = bracket(high, high * (1.0 + extent.tolerance))
    above, suffices = None if high is None else trials[high], None
    if above and above["constraint"] == "acceleration" and not math.isnan(above["limit"]):
        # the planner says which acceleration would do: does it?
        enough = whole.with_options(acceleration=_MORE * abs(above["limit"]))
        suffices = isinstance(plans.outcome(cases.at_speed(enough, above["speed"])), Plan)
    return {"task": task.name, "title": task.title.rpartition(" at ")[0], "unit": task.unit,
            "fastest_with_plan": trials[low], "slowest_without": above, "suffices": suffices,
            "trials": [trials[speed] for speed in sorted(trials)]}  # fmt: skip


def attempt(plans: Plans, case: Case) -> Record:
    """Try one speed from the first guesses of a case, with its objective and with the gentlest motion as the aim."""
    reasons = {"constraint": "", "joint": "", "limit": math.nan, "fraction": math.nan}
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


def mode_record(plans: Plans, task: Case, coarser: float) -> Record:
    """Return a corner in a working mode by all of ``MODE_METHODS``."""
    rows = {method: plan_record(plans, task, method, coarser) for method in MODE_METHODS}
    ratio, mode = rows[PEAK]["worst"] / rows[NONE]["worst"], task.working_mode
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
    starts: Any = outcome.diagnostics["starts"] if not isinstance(outcome, InfeasiblePlanError) else {}
    costs = [float(cost) for cost in starts.get("costs", [math.nan] * case.option("starts"))]
    reached = np.sort([cost for cost in costs if not math.isnan(cost)])
    least, most = (reached[0], reached[-1]) if len(reached) else (math.nan, math.nan)
    return {"case": case.name, "step": case.dt, "costs": costs, "missing": len(costs) - len(reached), "best": least,
            "excess": (most - least) / least, "parked_is_best": bool(costs[0] <= least * (1.0 + SAME_COST)),
            "optima": int((np.diff(reached, prepend=-math.inf) > SAME_COST * abs(reached)).sum())}  # fmt: skip


def trade_record(task: Case, extent: Extent) -> Record:
    """Return effort against the carriers' acceleration: what each weight between the two leads to.

    A weight is ``ratio`` times the one at which both parts of the cost are the same for the plan of least effort.
    """
    case, points = by_method(task, EFFORT, extent.coarser), []
    least = case.plan()
    equal = least.diagnostics["objective"]["effort"] / _square_integral(least)  # type: ignore[index]
    for ratio in (0.0, *extent.ratios):
        aims = (("effort", 1.0), ("carrier_acceleration", ratio * equal))
        outcome = cases.plan_or_error(case.with_options(objective=aims), case.backends[0]) if ratio else least
        shown, acceleration = numbers(outcome), math.nan
        if isinstance(outcome, Plan):
            acceleration = math.sqrt(_square_integral(outcome) / (outcome.t[-1] - outcome.t[0]))
        points.append({"ratio": ratio, "weight": ratio * equal, "rms_effort": shown["rms"], "peak": shown["peak"],
                       "rms_acceleration": acceleration, "status": shown["status"]})  # fmt: skip
    planned = [point for point in points if point["status"] != INFEASIBLE]
    # between global optima effort rises and acceleration falls with the weight
    monotone = rises([one["rms_effort"] for one in planned]) and rises([-one["rms_acceleration"] for one in planned])
    return {"task": task.name, "title": task.title, "unit": task.unit, "monotone": monotone, "points": points}


def _square_integral(plan: Plan) -> float:
    """Return ∫ Σ s̈² dt by the trapezoidal rule, m²/s³."""
    return float(np.trapezoid((plan.carriers.sdd**2).sum(axis=1), plan.t))


def rises(values: Sequence[float]) -> bool:
    """Return whether values rise, within ``ORDERED``."""
    return all(after >= before - ORDERED * abs(before) for before, after in pairwise(values))


# --- future work named by the thesis: carriers elsewhere, balancing, design, time and space ------------------------


def coarsened(case: Case, extent: Extent) -> Case:
    """Return a case with the steps of an extent, up to a factor of two: fewer nodes do not show the crossings."""
    return replace(case, dt=case.dt * min(extent.coarser, 2.0))


def future_calls(extent: Extent) -> list[cases.Call]:
    """Return the calls that make the rows of future work."""
    planned = {key: coarsened(cases.FUTURE[key], extent) for key in extent.future}
    return [(": ".join(key), future_record, *key, case) for key, case in planned.items()]


def run_future(plans: Plans, extent: Extent) -> dict[str, Any]:
    """Return the rows of future work."""
    return {"plans": [plans.result(*call) for call in future_calls(extent)]}


def future_record(task: str, method: str, case: Case) -> Record:
    """Plan a case of future work and return its row, or the reason why it has no plan."""
    outcome = cases.plan_or_error(case, case.backends[0])
    if isinstance(outcome, InfeasiblePlanError):
        return {"task": task, "way": method, "status": f"{INFEASIBLE}: {outcome.message}"}
    dynamics, carriers = case.dynamics(), outcome.carriers
    robot, point = dynamics.robot, np.array(cases.CENTRE if case.robot == "3rrr" else (0.0, 0.0, 0.0))
    push = outcome.base_wrench(dynamics, point) - load_at_rest(dynamics, outcome.motion, carriers.s[0], point)
    added = sum(robot.model.inertias[find_joint_index(robot.model, name)].mass for name in robot.carriers)
    return {
        **numbers(outcome),
        "task": task,
        "way": method,
        "unit": case.unit if case.robot != "gough" else "N",
        "added": float(added),
        "duration": float(outcome.t[-1] - outcome.t[0]),
        "peak": float(outcome.peak_effort.max()),
        "stroke": float(np.ptp(carriers.s, axis=0).max(initial=0.0)),
        "base_force": float(np.linalg.norm(push[:, :3], axis=1).max()),
        "base_moment": float(np.linalg.norm(push[:, 3:], axis=1).max()),
        "replay": replay(outcome, backend=as_dynamics).largest,
        "singular_instants": list(outcome.findings.singular_instants),
    }
