"""What becomes of claims: verdicts computed from the records of a chapter, and sentences of ``claims.yaml``."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from redundancy_pin.errors import InputError
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.planners.plan import PlanStatus
from redundancy_pin.studies import cases
from redundancy_pin.studies.beyond import BETWEEN, CALM, SAME_PLAN, THESIS_SPEED, by_task, headline_cell
from redundancy_pin.studies.case import Case
from redundancy_pin.studies.cases import EFFORT, NONE, OBJECTIVES, PARKED, PEAK, STEPWISE, SWITCH_OFF
from redundancy_pin.studies.planned import MOVING
from redundancy_pin.studies.table import Record, span, text

FILTERS = {
    "n": text,
    "n1": lambda value: text(value, ".1g"),
    "n2": lambda value: text(value, ".2g"),
    "r": lambda values: span(values, ".2g"),
}
"""Of templates: a number (in three, one, two digits), and a range of factors."""


def environment(loader: jinja2.BaseLoader | None = None) -> jinja2.Environment:
    """Return what renders Markdown templates: a name that does not exist is an error."""
    made = jinja2.Environment(
        loader=loader,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters.update(FILTERS)
    return made


@functools.cache
def claims() -> Mapping[str, Mapping[str, str]]:
    """Return the claims of the data file by name: ``claim`` and the template ``here``."""
    data: Mapping[str, Any] = read_yaml(Path(__file__).with_name("claims.yaml"), InputError).data
    return data


def verdict(good: int, total: int) -> str:
    """Return what may be said of a claim that holds in some of all cases."""
    if good == total:
        return "stands"
    return "stands with conditions" if good else "does not stand"


def claim(name: str, stands: str, **values: Any) -> Record:
    """Return what becomes of a claim of the data file: its verdict, and the numbers that its sentence shows."""
    claimed, here = (
        " ".join(environment().from_string(claims()[name][part]).render(values).split()) for part in ("claim", "here")
    )
    return {"name": name, "claim": claimed, "stands": stands, "here": here, "numbers": values}


def counted(name: str, good: int, total: int, /, **values: Any) -> Record:
    """Return what becomes of a claim that holds in some of all cases."""
    return claim(name, verdict(good, total), total=total, **values)


def ratios(pairs: Sequence[tuple[Record, Record]], key: str) -> list[float]:
    """Return the factors between the numbers of pairs of records."""
    return [one[key] / other[key] for one, other in pairs]


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
    inside = [record["case"] for record in crossings if record["status"] == "within_limits"]
    broken = [record for record in crossings if record["status"] == "violates_limits"]
    exact, stepped = (max(max(record[key]) for record in crossings) for key in ("jump", "jump_of_differences"))
    artefact, out = exact < 1e-3 * stepped, "beyond_track_at_exit"
    circles = [max(record["jump_of_differences"]) for record in crossings if record["case"].startswith("circle-0.5-")]
    return [
        claim("crossing", verdict(len(inside) + (heavy is None), len(crossings) + 1), crossed=len(crossings),
              inside=inside, heavy=heavy),
        counted("limits", len(crossings) - len(broken), len(crossings),
                broken=[record["case"] for record in broken],
                out=[(record["case"], record[out]) for record in crossings if record[out]],
                cured=[(record["case"], record["shortest"]) for record in broken if not record["no_shortest"]],
                never=[record["case"] for record in crossings if record["no_shortest"]]),
        claim("exit_forces", "does not stand" if artefact else "stands", artefact=artefact, exact=exact,
              stepped=stepped, step=crossings[0]["step"], by_threshold=circles,
              grows=len(circles) > 1 and sorted(circles) == circles),
    ]  # fmt: skip


def _by_mode(machines: Sequence[Record], motion: str) -> list[dict[str, Record]]:
    """Return, for each working mode, the records of a motion by what moves."""
    groups: dict[tuple[int, ...], dict[str, Record]] = {}
    for record in machines:
        if record["motion"] == motion:
            groups.setdefault(tuple(record["mode"]), {})[record["what"]] = record
    return list(groups.values())


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
    broken = sum(moving["status"] != "within_limits" for moving, _ in pairs)
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
    early = PlanStatus.STOPPED_EARLY.value
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
