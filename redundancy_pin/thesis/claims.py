"""Claims of the thesis and beyond it: verdicts computed from records, with the sentences of ``claims.yaml``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jinja2

from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis import cases
from redundancy_pin.thesis.case import Case
from redundancy_pin.thesis.cases import EFFORT, NONE, OBJECTIVES, PARKED, PEAK, STEPWISE, SWITCH_OFF
from redundancy_pin.thesis.table import Record, data, grouped, span, text

STATED_FORCE = 0.005
"""Smallest force on switching on that the thesis would print, N: half a unit of its last digit."""

THESIS_SPEED = 0.75
"""Fastest circle of the thesis, m/s."""

BETWEEN = 1.05
"""Largest peak between the nodes over the peak at the nodes that is accepted."""

CALM = 10
"""Largest number of reversals of a calm effort: a few for each ramp, corner and crossing of the motion."""

SAME_PLAN = 1e-6
"""Relative difference up to which plans of two backends count as the same."""

MOVING = "carriers moving"
NO_PLAN = "no plan exists"
BREAKS = "breaks limits"
NOT_JUDGED = "not judged"

FILTERS = {
    "n": text,
    "n1": lambda value: text(value, ".1g"),
    "n2": lambda value: text(value, ".2g"),
    "r": lambda values: span(values, ".2g"),
}
"""Of templates: a number (in three, one, two digits), and a range of factors."""


def environment(loader: jinja2.BaseLoader | None = None) -> jinja2.Environment:
    """Return what renders Markdown templates: a name that does not exist is an error."""
    settings: Any = dict.fromkeys(("trim_blocks", "lstrip_blocks", "keep_trailing_newline"), True)
    made = jinja2.Environment(loader=loader, undefined=jinja2.StrictUndefined, **settings)
    made.filters.update(FILTERS)
    return made


def verdict(good: int, total: int) -> str:
    """Return the verdict on a claim that holds in some of all cases."""
    if total == 0:
        return NOT_JUDGED
    if good == total:
        return "stands"
    return "stands with conditions" if good else "does not stand"


def claim(name: str, stands: str, **values: Any) -> Record:
    """Return a claim of the data file with its verdict, and the sentence that shows the numbers."""
    template = environment().from_string
    texts = {key: " ".join(template(wording).render(values).split()) for key, wording in data("claims")[name].items()}
    return {"name": name, "claim": texts["claim"], "stands": stands, "here": texts["here"], "numbers": values}


def counted(name: str, good: int, total: int, /, **values: Any) -> Record:
    """Return a claim that holds in some of all cases."""
    return claim(name, verdict(good, total), total=total, **values)


def not_run(name: str) -> Record:
    """Return a claim for which this run has no case."""
    here = "No case of this kind is in this run."
    return {"name": name, "claim": data("claims")[name]["claim"], "stands": NOT_JUDGED, "here": here, "numbers": {}}


def ratios(pairs: Sequence[tuple[Record, Record]], key: str) -> list[float]:
    """Return the factors between the numbers of pairs of records."""
    return [one[key] / other[key] for one, other in pairs]


def by_task(records: Sequence[Record]) -> dict[str, dict[str, Record]]:
    """Return records by task and method."""
    return {task: {record["way"]: record for record in group} for (task,), group in grouped(records, "task").items()}


def peak_text(record: Record | None) -> str | None:
    """Return the largest main effort of a plan, at its samples or between them, and the defect of the plan."""
    if record is None:
        return None
    if not record["exists"]:
        return NO_PLAN
    worst = record["worst"]
    largest = f"{f'{worst:#.3g}'.rstrip('.')} {record['unit']}" if math.isfinite(worst) else "unbounded"
    wrong = BREAKS if record["status"] == ResultStatus.LIMIT_VIOLATED.value else record["status"].replace("_", " ")
    return largest if record["sound"] or wrong == largest else f"{largest}, {wrong}"


# --- conclusions of the thesis, from the chapter on its own planners -------------------------------------------------


def conclusions(chapter: Mapping[str, Any]) -> list[Record]:
    """Return the thesis's conclusions with their verdicts."""
    machines = chapter["fair_comparison"]
    records = [
        *_crossings(chapter["crossings"], chapter["heavy_end_effector"]),
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
        claim("exit_forces", verdict(not artefact, 1), artefact=artefact, exact=exact),
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
    # about the sharper corner the thesis states that torques exceed the baseline's
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


# --- findings beyond the thesis --------------------------------------------------------------------------------------


def findings(chapter: Mapping[str, Any]) -> list[Record]:
    """Return the findings of the chapter beyond the thesis with their verdicts."""
    groups = by_task(chapter["plans"])
    singular = {task.name: groups[task.name] for task in cases.SINGULAR if task.name in groups}
    turns = zip(("corner_wide", "corner_sharp", "corner_square"), cases.TURNS, strict=True)
    planned = {f"{one['task']} ({one['way']})": one for one in chapter["plans"] if one["way"] in OBJECTIVES}
    return [
        _singular(singular),
        _heavy(singular),
        _speed(chapter["fastest"]),
        *(_turn(name, task, groups[task.name], chapter["working_modes"]) for name, task in turns),
        _cost([(one, groups[one["task"]][NONE]) for one in planned.values() if NONE in groups[one["task"]]]),
        _between(planned),
        _calm({name: one for name, one in planned.items() if one["exists"]}, groups),
        _backends(chapter["backends"]),
        _starts(chapter["first_guesses"]),
    ]


def _both_sound(group: Mapping[str, Record]) -> bool:
    return bool(group[EFFORT]["sound"] and group[PEAK]["sound"])


def _singular(groups: Mapping[str, Mapping[str, Record]]) -> Record:
    sound = [task for task, group in groups.items() if _both_sound(group)]
    off = {task: group[SWITCH_OFF] for task, group in groups.items()}
    broken = [task for task, record in off.items() if record["exists"] and not record["sound"]]
    late = {task: group[cases.SWITCH_OFF_LATE] for task, group in groups.items() if cases.SWITCH_OFF_LATE in group}
    both = [(group[EFFORT], off[task]) for task, group in groups.items()]
    both = [(whole, other) for whole, other in both if whole["exists"] and other["exists"]]
    return counted(
        "singular",
        len(sound),
        len(groups),
        sound=sound,
        kept=[task for task, record in off.items() if record["sound"]],
        broken=broken,
        without=[task for task, record in off.items() if not record["exists"]],
        late=cases.LATE,
        saved=[(task, peak_text(late[task])) for task in broken if task in late and late[task]["sound"]],
        factors=ratios(both, "worst"),
        before=[whole["worst"] / other["before"] for whole, other in both if not math.isnan(other["before"])],
    )


def _heavy(groups: Mapping[str, Mapping[str, Record]]) -> Record:
    without = {task: group for task, group in groups.items() if not group[SWITCH_OFF]["exists"]}
    good = sum(_both_sound(group) for group in without.values())
    motions = [
        {"task": task, "missing": group[SWITCH_OFF]["missing"], "effort": peak_text(group[EFFORT]),
         "peak": peak_text(group[PEAK])}
        for task, group in without.items()
    ]  # fmt: skip
    return counted("heavy", good, len(without), good=good, motions=motions)


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
        stepwise=peak_text(group[STEPWISE]),
        **{aim: peak_text(record) for aim, record in aims.items()},
        factors=[record["ratio"] for record in same if not math.isnan(record["ratio"])],
        stepwise_lower=stepwise_lower(PEAK),
        stepwise_lower_free=stepwise_lower(cases.PEAK_FREE),
        against=[{"aim": aim, "factors": against(record)} for aim, record in aims.items() if record["exists"]],
    )


def _cost(compared: Sequence[tuple[Record, Record]]) -> Record:
    """Compare energies of plans with the machine without carriers."""
    compared = [pair for pair in compared if pair[0]["exists"]]
    if not compared:
        return not_run("cost")
    least = [pair for pair in compared if pair[0]["way"] == cases.ENERGY]
    better = sum(record["energy"] < none["energy"] for record, none in compared)
    return counted("cost", better, len(compared), better=better, factors=ratios(compared, "energy"),
                   carrier_force=max(record["carrier_force"] for record, _ in compared), least=ratios(least, "energy"),
                   least_peaks=ratios(least, "worst"))  # fmt: skip


def _between(planned: Mapping[str, Record]) -> Record:
    factors = {name: one["dense_peak"] / one["peak"] for name, one in planned.items() if one["exists"]}
    if not factors:
        return not_run("between")
    worst, good = max(factors, key=factors.__getitem__), sum(factor <= BETWEEN for factor in factors.values())
    early = [name for name, one in planned.items() if one["status"] == ResultStatus.NOT_CONVERGED.value]
    missing = [name for name in planned if name not in factors]
    return counted("between", good, len(factors), good=good, accepted=BETWEEN, worst=factors[worst], worst_plan=worst,
                   early=early, missing=missing)  # fmt: skip


def _calm(planned: Mapping[str, Record], groups: Mapping[str, Mapping[str, Record]]) -> Record:
    if not planned:
        return not_run("calm")
    turns = {name: float(one["reversals"]) for name, one in planned.items()}
    worst, good = max(turns, key=turns.__getitem__), sum(not count > CALM for count in turns.values())
    restless = {planned[name]["task"] for name, count in turns.items() if count > CALM}
    smooth = [one for one in planned.values() if one["way"] == cases.SMOOTH]
    return counted("calm", good, len(turns), good=good, accepted=CALM, worst=turns[worst], worst_plan=worst,
                   restless=sorted(restless), weight=cases.SMOOTHING,
                   smooth_reversals=max((one["reversals"] for one in smooth), default=None),
                   smooth_peaks=ratios([(one, groups[one["task"]][EFFORT]) for one in smooth], "worst"))  # fmt: skip


def _backends(backends: Sequence[Record]) -> Record:
    if not backends:
        return not_run("backends")
    worst = max(backends, key=lambda record: float(record["worst"]))
    good = sum(record["same"] for record in backends)
    apart = [record["case"] for record in backends if not record["same"] and record["cost"] <= SAME_PLAN]
    return counted("backends", good, len(backends), good=good, accepted=SAME_PLAN, worst=worst["worst"],
                   worst_plan=worst["case"], cost=max(record["cost"] for record in backends), apart=apart)  # fmt: skip


def _starts(starts: Sequence[Record]) -> Record:
    if not starts:
        return not_run("first_guesses")
    good = sum(record["parked_is_best"] for record in starts)
    tried = max(len(record["costs"]) for record in starts)
    several = [(record["case"], record["optima"], record["excess"]) for record in starts if record["optima"] > 1]
    return counted("first_guesses", good, len(starts), good=good, tried=tried, several=several)
