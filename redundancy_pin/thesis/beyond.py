"""The chapter beyond the thesis: its planners against the whole-trajectory planner, and checks of the plans."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis import cases, measures
from redundancy_pin.thesis.case import Case, Mode, Plans
from redundancy_pin.thesis.cases import EFFORT, NONE, OBJECTIVES, PEAK, STEPWISE, SWITCH_OFF, TASKS, Extent, by_method
from redundancy_pin.thesis.planned import Chapter, Progress
from redundancy_pin.thesis.statements import claim, counted, ratios, verdict
from redundancy_pin.thesis.table import Record, Table, grouped, table, text

INFEASIBLE = ResultStatus.INFEASIBLE.value
"""Status of a record whose planner has no plan."""

BETWEEN = 1.05
"""Largest peak between the nodes over that at the nodes that is accepted."""

CALM = 10
"""Reversals of an effort up to which it counts as calm: a few for each ramp, corner and crossing of the motion."""

THESIS_SPEED = 0.75
"""Fastest circle of the thesis, m/s."""

SAME_PLAN = 1e-6
"""Relative difference up to which plans of two backends count as the same."""

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
"""Plans of the corners in each mode; the last has the freedom of stepwise planning, which brings no carrier back."""


def independent(extent: Extent) -> list[tuple[Case, str]]:
    """Return the plans of the chapter that do not depend on one another, each with its backend."""
    first = [by_method(task, method, extent.coarser) for task in TASKS for method in cases.methods(task)]
    first += [
        by_method(replace(task, working_mode=mode), method, extent.coarser)
        for task in cases.TURNS[:2]
        for mode in extent.modes
        for method in MODE_METHODS
    ]
    return [(case, case.backends[0]) for case in (*first, *_started(extent))] + [
        (case, backend) for case in _compared(extent) for backend in case.backends[1:]
    ]


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


def run_beyond(plans: Plans, extent: Extent, progress: Progress) -> Chapter:
    """Run the chapter, on several processes."""
    first = cases.SINGULAR[0]
    waited = [by_method(first, SWITCH_OFF, extent.coarser)]
    waited += [by_method(task, EFFORT, extent.coarser) for task in cases.TRADED]
    plans.prepare([(case, case.backends[0]) for case in waited], extent.jobs)
    cap = plan_record(plans, first, SWITCH_OFF, extent.coarser)["before"]
    weighted = [case for task in cases.TRADED for _, _, case in weights(plans, task, extent)]
    alone = independent(extent) + [(case, case.backends[0]) for case in weighted]
    # a race takes as long as a hundred plans: it begins before them, so that no process waits for it in the end
    races = plans.prepare(alone, extent.jobs, progress, first=[(run_race, race, extent, cap) for race in extent.races])
    for race in races:
        progress(f"as fast as the limits allow: {race['task']}")
    records = [plan_record(plans, task, method, extent.coarser) for task in TASKS for method in cases.methods(task)]
    trades = []
    for task in cases.TRADED:
        trades.append(trade_record(plans, task, extent))
        progress(f"trade-off: {task.name}")
    chapter = {
        "plans": records,
        "targets": targets(records),
        "fastest": races,
        "working_modes": mode_records(plans, extent.modes, extent.coarser),
        "backends": [backend_record(plans, case) for case in _compared(extent)],
        "first_guesses": [starts_record(plans, case) for case in _started(extent)],
        "trade_off": trades,
    }
    return chapter | {"findings": findings(chapter)}


def plan_record(plans: Plans, task: Case, method: str, coarser: float = 1.0) -> Record:
    """Return a task by a method in numbers.

    ``peak`` is at the samples, ``dense_peak`` between them, ``worst`` the larger one; ``sound`` plans have finite
    efforts within all limits and, of an optimiser, are optimal; NaN without a plan, whose reason is ``why``.
    """
    case = by_method(task, method, coarser)
    outcome = plans.outcome(case)
    saved = method not in (NONE, cases.PARKED, STEPWISE, cases.STEPWISE_HALF)
    record = {"task": task.name, "way": method, "unit": task.unit, "file": f"beyond-{case.name}" if saved else ""}
    if isinstance(outcome, InfeasiblePlanError):
        nothing = dict.fromkeys(("peak", "dense_peak", "worst", "before", "reversals", "rms", "carrier_force",
                                 "main_energy", "carrier_energy", "energy", "position", "speed", "acceleration",
                                 "track", "speed_limit", "acceleration_limit"), math.nan)  # fmt: skip
        return {**record, **nothing, "file": "", "status": INFEASIBLE, "exists": False, "sound": False, "broken": "",
                "solver": "", "why": outcome.message, "missing": measures.missing_force(outcome)}  # fmt: skip
    between, shown = float(outcome.peak_effort.max()), measures.numbers(outcome)
    return {**record, **shown, "dense_peak": between, "worst": max(shown["peak"], between), "exists": True,
            "sound": outcome.status is ResultStatus.OK, "why": "", "missing": math.nan}  # fmt: skip


def by_task(records: Sequence[Record]) -> dict[str, dict[str, Record]]:
    """Return records by task and method."""
    return {task: {record["way"]: record for record in group} for (task,), group in grouped(records, "task").items()}


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


# --- the headline --------------------------------------------------------------------------------------------------

NO_PLAN = "no plan exists"
BREAKS = "breaks limits"


def headline(records: Sequence[Record]) -> Table:
    """Return the largest main effort of every motion by every planner; the README shows this table."""
    groups = by_task(records)
    rows = []
    for task in TASKS:
        group = groups.get(task.name, {})
        thesis = (SWITCH_OFF, cases.SWITCH_OFF_LATE) if cases.crosses(task) else (STEPWISE,)
        if EFFORT in group:
            shown = {"none": group.get(NONE), "thesis": best(group.get(method) for method in thesis),
                     "effort": group[EFFORT], "peak": group.get(PEAK)}  # fmt: skip
            rows.append({"motion": task.title, **{name: headline_cell(record) for name, record in shown.items()}})
    return table("headline", rows)


def best(records: Iterable[Record | None]) -> Record | None:
    """Return the plan of least main effort that keeps every limit; one that breaks limits only if none keeps them."""
    existing = [record for record in records if record is not None]
    return min(existing, key=lambda r: (not r["exists"], not r["sound"], r["worst"]), default=None)


def headline_cell(record: Record | None) -> str | None:
    """Return the largest main effort of a plan, at its samples or between them, and the defect of the plan."""
    if record is None:
        return None
    if not record["exists"]:
        return NO_PLAN
    worst = record["worst"]
    largest = f"{f'{worst:#.3g}'.rstrip('.')} {record['unit']}" if math.isfinite(worst) else "unbounded"
    wrong = BREAKS if record["status"] == ResultStatus.LIMIT_VIOLATED.value else record["status"].replace("_", " ")
    return largest if record["sound"] or wrong == largest else f"{largest}, {wrong}"


# --- how fast: bisection on speed with the verdict of the planner --------------------------------------------------
#
# The problem is not convex, so a verdict "infeasible" is local: no plan was found from any first guess. A speed counts
# as out of reach only if every first guess fails with two objectives, which lead the solver to different places.


def run_race(race: cases.Race, extent: Extent, cap: float) -> Record:
    """Bracket a race in any process; ``cap`` limits the main efforts of a capped race."""
    if not race.capped:
        return fastest(Plans(), race.task, extent)
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

    def ramps_fit(speed: float) -> bool:
        try:
            case_at(speed).trajectory()
        except InputError:
            return False
        return True

    def tried(speed: float, starts: int = 1) -> Record:
        if speed not in trials or (starts > 1 and not trials[speed]["feasible"]):
            trials[speed] = attempt(plans, case_at(speed, **({"starts": starts} if starts > 1 else {})))
        return trials[speed]

    def bracket(low: float, high: float) -> tuple[float, float | None]:
        while ramps_fit(high) and tried(high)["feasible"]:
            low, high = high, high * GROWTH
        if not ramps_fit(high):
            return low, None
        while high - low > extent.tolerance * low:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if tried(middle)["feasible"] else (low, middle)
        return low, high

    own = task.option("speed")
    plans.plan(case_at(own))
    tried(own)
    low, high = bracket(own, own * GROWTH)
    while high is not None and tried(high, extent.starts)["feasible"]:
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


def mode_records(plans: Plans, modes: Sequence[Mode], coarser: float) -> list[Record]:
    """Return both corners in every working mode."""
    records = []
    for task in cases.TURNS[:2]:
        for mode in modes:
            moded = replace(task, working_mode=mode)
            rows = {method: plan_record(plans, moded, method, coarser) for method in MODE_METHODS}
            ratio = rows[PEAK]["worst"] / rows[NONE]["worst"]
            records.append({"radius": task.option("radius"), "mode": mode, "rows": rows, "ratio": ratio,
                            "lower": bool(rows[PEAK]["sound"] and ratio < 1.0)})  # fmt: skip
    return records


def backend_record(plans: Plans, case: Case) -> Record:
    """Plan a case with both backends and compare; the differences are infinite where only one backend has a plan."""
    first, second = (plans.outcome(case, backend) for backend in case.backends)
    statuses = [INFEASIBLE if isinstance(one, InfeasiblePlanError) else one.status.value for one in (first, second)]
    if isinstance(first, Plan) and isinstance(second, Plan):
        differences = measures.plan_differences(first, second)
        costs = [float(str(plan.diagnostics["cost"])) for plan in (first, second)]
        cost = abs(costs[0] - costs[1]) / max(abs(costs[0]), abs(costs[1]))
    else:
        cost = 0.0 if type(first) is type(second) else math.inf
        differences = dict.fromkeys(("position", "speed", "acceleration", "tau", "carrier_force"), cost)
    worst = max(differences.values())
    return {"case": case.name, **differences, "cost": cost, "statuses": statuses, "worst": worst,
            "same": worst <= SAME_PLAN and statuses[0] == statuses[1]}  # fmt: skip


def starts_record(plans: Plans, case: Case) -> Record:
    """Return the scaled costs of a case from each first guess, parked carriers first; NaN without a plan."""
    outcome = plans.outcome(case)
    starts: Any = {} if isinstance(outcome, InfeasiblePlanError) else outcome.diagnostics["starts"]
    given = starts.get("costs", [math.nan] * case.option("starts"))
    costs = [float(cost) for cost in given]
    reached = sorted(cost for cost in costs if not math.isnan(cost))
    optima, last = 0, -math.inf
    for cost in reached:
        if cost > last + SAME_COST * abs(cost):
            optima, last = optima + 1, cost
    best, last = (reached[0], reached[-1]) if reached else (math.nan, math.nan)
    return {"case": case.name, "step": case.dt, "costs": costs, "missing": len(costs) - len(reached), "best": best,
            "excess": (last - best) / best, "optima": optima,
            "parked_is_best": bool(reached) and costs[0] <= best * (1.0 + SAME_COST)}  # fmt: skip


def weights(plans: Plans, task: Case, extent: Extent) -> list[tuple[float, float, Case]]:
    """Return weights of the carriers' acceleration against the effort, each with its case.

    The first of each is over the weight at which both parts of the cost are the same for the plan of least effort.
    """
    case = by_method(task, EFFORT, extent.coarser)
    least = plans.plan(case)
    effort: Mapping[str, Any] = least.diagnostics["objective"]  # type: ignore[assignment]
    equal = float(effort["effort"]) / measures.square_integral(least.t, least.carriers.sdd)
    aims = [(ratio, ratio * equal, (("carrier_acceleration", ratio * equal),)) for ratio in extent.ratios]
    return [(ratio, weight, case.with_options(objective=(("effort", 1.0), *aim))) for ratio, weight, aim in aims]


def trade_record(plans: Plans, task: Case, extent: Extent) -> Record:
    """Return effort against the carriers' acceleration: what each weight between the two leads to."""
    points = [_trade_point(0.0, 0.0, plans.plan(by_method(task, EFFORT, extent.coarser)))]
    points += [_trade_point(ratio, weight, plans.outcome(case)) for ratio, weight, case in weights(plans, task, extent)]
    planned = [point for point in points if point["status"] != INFEASIBLE]
    efforts, accelerations = ([point[key] for point in planned] for key in ("rms_effort", "rms_acceleration"))
    # between global optima effort rises and acceleration falls with the weight
    monotone = rises(efforts) and rises(accelerations[::-1])
    return {"task": task.name, "title": task.title, "unit": task.unit, "monotone": monotone, "points": points}


def _trade_point(ratio: float, weight: float, outcome: Plan | InfeasiblePlanError) -> Record:
    nothing = dict.fromkeys(("rms_effort", "rms_acceleration", "peak"), math.nan)
    point = {"ratio": ratio, "weight": weight, **nothing}
    if isinstance(outcome, InfeasiblePlanError):
        return {**point, "status": INFEASIBLE}
    shown, acceleration = measures.numbers(outcome), measures.rms_acceleration(outcome)
    return {**point, "rms_effort": shown["rms"], "rms_acceleration": acceleration, "peak": shown["peak"],
            "status": shown["status"]}  # fmt: skip


def rises(values: Sequence[float]) -> bool:
    """Return whether values rise, up to rounding."""
    return all(after >= before * (1.0 - ORDERED) for before, after in pairwise(values))


# --- findings beyond the thesis ------------------------------------------------------------------------------------


def findings(chapter: Mapping[str, Any]) -> list[Record]:
    """Return what follows from the chapter beyond the thesis."""
    groups = by_task(chapter["plans"])
    singular = {task.name: groups[task.name] for task in cases.SINGULAR if task.name in groups}
    turns = zip(("corner_wide", "corner_sharp", "corner_square"), cases.TURNS, strict=True)
    return [
        _singular(singular),
        _heavy(singular),
        _speed(chapter["fastest"]),
        *(_turn(name, task, groups[task.name], chapter["working_modes"]) for name, task in turns),
        *_whole([record for record in chapter["plans"] if record["way"] in OBJECTIVES], groups),
        _backends(chapter["backends"]),
        _starts(chapter["first_guesses"]),
    ]


def _both_sound(group: Mapping[str, Record]) -> bool:
    return bool(group[EFFORT]["sound"] and group[PEAK]["sound"])


def _singular(groups: Mapping[str, Mapping[str, Record]]) -> Record:
    sound = [task for task, group in groups.items() if _both_sound(group)]
    off = {task: group[SWITCH_OFF] for task, group in groups.items()}
    broken = [task for task, record in off.items() if record["exists"] and not record["sound"]]
    both = [(group[EFFORT], off[task]) for task, group in groups.items() if group[EFFORT]["exists"]]
    both = [pair for pair in both if pair[1]["exists"]]
    late = {task: group[cases.SWITCH_OFF_LATE] for task, group in groups.items() if cases.SWITCH_OFF_LATE in group}
    return counted(
        "singular",
        len(sound),
        len(groups),
        sound=sound,
        kept=[task for task, record in off.items() if record["sound"]],
        broken=broken,
        without=[task for task, record in off.items() if not record["exists"]],
        late=cases.LATE,
        saved=[(task, headline_cell(late[task])) for task in broken if task in late and late[task]["sound"]],
        factors=ratios(both, "worst"),
        before=[whole["worst"] / other["before"] for whole, other in both if not math.isnan(other["before"])],
    )


def _heavy(groups: Mapping[str, Mapping[str, Record]]) -> Record:
    without = {task: group for task, group in groups.items() if not group[SWITCH_OFF]["exists"]}
    good = sum(_both_sound(group) for group in without.values())
    motions = [
        {"task": task, "missing": group[SWITCH_OFF]["missing"], "effort": headline_cell(group[EFFORT]),
         "peak": headline_cell(group[PEAK])}
        for task, group in without.items()
    ]  # fmt: skip
    stands = verdict(good, len(without)) if without else "does not stand"
    return claim("heavy", stands, total=len(without), good=good, motions=motions)


def _speed(races: Sequence[Record]) -> Record:
    circles = [race for race in races if race["task"].startswith("circle") and math.isinf(race["effort_limit"])]
    good = sum(race["fastest_with_plan"]["speed"] > THESIS_SPEED for race in circles)
    shown = [
        {**{key: race[key] for key in ("title", "unit", "effort_limit")}, "capped": math.isfinite(race["effort_limit"]),
         "slower": race["fastest_with_plan"], "faster": race["slowest_without"]}
        for race in races
    ]  # fmt: skip
    return claim("speed", verdict(good, len(circles)), thesis_speed=THESIS_SPEED, races=shown)


def _turn(name: str, task: Case, group: Mapping[str, Record], modes: Sequence[Record]) -> Record:
    none, aims = group[NONE], {"effort": group[EFFORT], "peak": group[PEAK]}
    same = [record for record in modes if task.path == "corner" and record["radius"] == task.option("radius")]
    alone = int(group[PEAK]["sound"] and group[PEAK]["worst"] < none["worst"])
    good = sum(record["lower"] for record in same) if same else alone

    def stepwise_lower(method: str) -> int:
        rows = [record["rows"] for record in same if record["rows"][STEPWISE]["exists"]]
        return sum(not row[STEPWISE]["worst"] >= row[method]["worst"] for row in rows)

    def against(record: Record) -> list[str]:
        return [text(record[key] / none[key], ".2g") for key in ("worst", "rms", "main_energy", "energy")]

    return counted(
        name,
        good,
        len(same) or 1,
        good=good,
        without=none["worst"],
        stepwise=headline_cell(group[STEPWISE]),
        **{aim: headline_cell(record) for aim, record in aims.items()},
        factors=[record["ratio"] for record in same if not math.isnan(record["ratio"])],
        stepwise_lower=stepwise_lower(PEAK),
        stepwise_lower_free=stepwise_lower(cases.PEAK_FREE),
        against=[{"aim": aim, "factors": against(record)} for aim, record in aims.items() if record["exists"]],
    )


def _whole(whole: Sequence[Record], groups: Mapping[str, Mapping[str, Record]]) -> list[Record]:
    """Return what follows for cost, efforts between the nodes, and calm, of all plans over the whole trajectory."""
    planned = {f"{record['task']} ({record['way']})": record for record in whole if record["exists"]}
    pairs = [(record, groups[record["task"]].get(NONE)) for record in planned.values()]
    compared = [(record, none) for record, none in pairs if none is not None]
    least = [pair for pair in compared if pair[0]["way"] == cases.ENERGY]
    better = sum(record["energy"] < none["energy"] for record, none in compared)
    factors = {name: record["dense_peak"] / record["peak"] for name, record in planned.items()}
    worst = max(factors, key=lambda name: factors[name])
    accepted = sum(factor <= BETWEEN for factor in factors.values())
    turns = {name: record["reversals"] for name, record in planned.items()}
    calm = sum(not count > CALM for count in turns.values())
    wildest = max(turns, key=lambda name: float(turns[name]))
    smooth = [record for record in planned.values() if record["way"] == cases.SMOOTH]
    early = ResultStatus.NOT_CONVERGED.value
    return [
        counted("cost", better, len(compared), better=better, factors=ratios(compared, "energy"),
                carrier_force=max(record["carrier_force"] for record, _ in compared), least=ratios(least, "energy"),
                least_peaks=ratios(least, "worst")),
        counted("between", accepted, len(factors), good=accepted, accepted=BETWEEN, worst=factors[worst],
                worst_plan=worst, early=[name for name, record in planned.items() if record["status"] == early],
                missing=[f"{record['task']} ({record['way']})" for record in whole if not record["exists"]]),
        counted("calm", calm, len(turns), good=calm, accepted=CALM, worst=turns[wildest], worst_plan=wildest,
                restless=sorted({planned[name]["task"] for name, count in turns.items() if count > CALM}),
                weight=cases.SMOOTHING,
                smooth_reversals=max((record["reversals"] for record in smooth), default=None),
                smooth_peaks=ratios([(record, groups[record["task"]][EFFORT]) for record in smooth], "worst")),
    ]  # fmt: skip


def _backends(backends: Sequence[Record]) -> Record:
    worst = max(backends, key=lambda record: float(record["worst"]))
    good = sum(record["same"] for record in backends)
    apart = [record["case"] for record in backends if not record["same"] and record["cost"] <= SAME_PLAN]
    return counted("backends", good, len(backends), good=good, accepted=SAME_PLAN, worst=worst["worst"],
                   worst_plan=worst["case"], cost=max(record["cost"] for record in backends), apart=apart)  # fmt: skip


def _starts(starts: Sequence[Record]) -> Record:
    good = sum(record["parked_is_best"] for record in starts)
    tried = max(len(record["costs"]) for record in starts)
    several = [(record["case"], record["optima"], record["excess"]) for record in starts if record["optima"] > 1]
    return counted("first_guesses", good, len(starts), good=good, tried=tried, several=several)
