"""Verdicts on the numbers that the thesis states (``thesis.yaml``), over grids of the parameters it does not state."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from redundancy_pin.planners.plan import Plan
from redundancy_pin.thesis.cases import BY_NAME, CORNERS, CROSSINGS, Case, Extent, Plans
from redundancy_pin.thesis.claims import NOT_JUDGED
from redundancy_pin.thesis.measures import MotionRun, Numbers, read
from redundancy_pin.thesis.table import Record, data, mode_text, span, text

ROUNDING = 1e-12
"""A gap up to this is none: the limits of an interval are themselves rounded."""

_LATE = 0.01
"""Largest delay with which the thesis notices an instant, s: its times have two decimals, its step may be 10 ms."""

Grid = Mapping[str, Sequence[Any]]
"""Values of unstated parameters, by parameter; all combinations of them."""


@functools.cache
def thesis() -> Mapping[str, Any]:
    """Return ``thesis.yaml``; the numbers stated with each crossing are among ``planned`` and ``rows``."""
    stated = dict(data("thesis"))
    rows: dict[str, str] = {}
    planned: list[Record] = []
    for one in stated["crossings"]:
        threshold, figure = one["threshold"], one["figure"]
        for edge, when, forces, switching in (("entry", "met", "falling", "off"), ("exit", "left", "rising", "on")):
            row = f"{figure} {edge}"
            moving = {"source": f"fig. {figure}", "case": f"{one['motion']}-cn{threshold}", "row": row}
            rows[row] = f"{one['motion'].replace('-', ' ')} m/s, CN {threshold}, switching {switching}"
            planned.append({**moving, "quantity": f"threshold {when}", "unit": "s", "stated": [one[when]],
                            "measure": ["time_of", edge], "grids": [one["ramps"]], "late": _LATE,
                            "why": f"at {one[when]} s the condition number is {{:.3g}} here",
                            "of": ["condition_at", float(one[when])]})  # fmt: skip
            planned.append({**moving, **stated["forces"][edge], "unit": "N", "stated": one[forces],
                            "grids": [one["ramps"], "ramp_starts"] if edge == "entry" else ["returns"]})  # fmt: skip
    return {**stated, "planned": [*planned, *stated["planned"]], "rows": rows | stated["rows"]}


def compare_motions(runs: Sequence[MotionRun]) -> list[Record]:
    """Return every statement about the motions that were run, with our numbers; no verdict."""
    by_name = {run.case.name: run for run in runs}
    return [
        {"source": entry["source"], "experiment": entry["case"], "quantity": entry["quantity"], "unit": entry["unit"],
         "stated": entry["stated"], "computed": read(by_name[entry["case"]], *entry["measure"]),
         "note": entry.get("note", "")}
        for entry in thesis()["motions"]
        if entry["case"] in by_name
    ]  # fmt: skip


# --- the rule ------------------------------------------------------------------------------------------------------


def interval(printed: str) -> tuple[float, float]:
    """Return what printed digits can stand for: ± half a unit of the last one; with a ``~``, a factor of √10."""
    if printed.startswith("~"):
        return _value(printed) / math.sqrt(10.0), _value(printed) * math.sqrt(10.0)
    half = 0.5 * 10.0 ** -len(printed.partition(".")[2])
    return float(printed) - half, float(printed) + half


def excess(printed: str, low: float, high: float) -> float:
    """Return how far a stated number is beyond a range of ours, 0 inside; infinite if our number is NaN."""
    bottom, top = interval(printed)
    return math.inf if math.isnan(low) else max(0.0, low - top, bottom - high)


def limits_of(values: Sequence[float]) -> tuple[float, float]:
    """Return smallest and largest of the values that are numbers; NaN if there are none."""
    known = [value for value in values if not math.isnan(value)]
    return (min(known), max(known)) if known else (math.nan, math.nan)


def given_by(printed: Sequence[str], values: Numbers, late: float = 0.0) -> bool:
    """Return whether one run gives all the numbers, as printed, that are stated together.

    Besides its rounding, a stated number may be larger than the run's by ``late``.
    """
    excesses = (excess(digits, value, value + late) for digits, value in zip(printed, values, strict=True))
    return max(excesses) <= ROUNDING


def _value(printed: str) -> float:
    return float(printed.removeprefix("~"))


# --- what is unstated ----------------------------------------------------------------------------------------------

_RAMP_TIME = {"circle": 0.2, "line": 1.0, "corner": 0.4, "square": 0.2}
"""Duration T of the ramps, s."""

_CORNER_SPEED = 0.2
"""Cruising speed v of the 3-RRR, m/s; the 2-RPR's cases have their own."""

_PARAMETERS = {
    "ramp_length": "ramp length p [v T]", "return_time": "return time [s]", "dt": "step δt [s]",
    "ramp_down": "start of the ramp before the threshold [s]", "threshold": "threshold", "working_mode": "working mode",
    "alpha": "orientation α [rad]",
}  # fmt: skip
"""Names of the parameters of a grid."""


def vary(case: Case, name: str, value: Any) -> Case:
    """Return a case with another value of one unstated parameter, all others as they are."""
    if name in ("dt", "working_mode"):
        return replace(case, **{name: value})
    if name == "ramp_length":
        value = value * case.option("speed", _CORNER_SPEED) * _RAMP_TIME[case.path]
    return (case.with_path if name in ("ramp_length", "alpha") else case.with_options)(**{name: value})


def variations(case: Case, values: Grid) -> list[tuple[Case, str]]:
    """Return a case with each combination of values, each with a label of the change."""
    varied = []
    for combination in product(*values.values()):
        changed, labels = case, []
        for name, value in zip(values, combination, strict=True):
            before, changed = changed, vary(changed, name, value)
            shown = mode_text(value) if name == "working_mode" else f"{value:g}"
            labels += [f"{_PARAMETERS[name]} {shown}"] if changed != before else []
        varied.append((changed, ", ".join(labels)))
    return varied


def _named(values: Grid) -> str:
    return " and ".join(_PARAMETERS[name] for name in values)


def grid(name: str, extent: Extent) -> Grid:
    """Return a grid of the data file; only the ends of its values unless whole grids are run."""
    return {
        parameter: list(extent.modes) if entry == "all" else entry if extent.whole_grids else [entry[0], entry[-1]]
        for parameter, entry in thesis()["grids"][name].items()
    }


def needed(extent: Extent) -> list[Case]:
    """Return every variation of the unstated parameters, to plan all at once."""
    judged = [(BY_NAME[entry["case"]], entry["grids"]) for entry in thesis()["planned"]]
    ranged = [(case, thesis()["sensitivity"][case.path]["grids"]) for case in _ranged(extent)]
    grids = [(case, grid(name, extent)) for case, names in (*judged, *ranged) for name in names]
    return [varied for case, over in grids for varied, _ in variations(case, over)]


def _ranged(extent: Extent) -> tuple[Case, ...]:
    return (*(CROSSINGS[:4] if extent.whole_grids else CROSSINGS[:1]), *CORNERS)


# --- verdicts ------------------------------------------------------------------------------------------------------


def judge_all(plans: Plans, extent: Extent) -> list[Record]:
    """Judge every number, and every joint statement, about the planned cases."""
    numbers = [_judged(entry, plans, extent) for entry in thesis()["planned"]]
    return [*numbers, growth_with_threshold(plans), same_before_the_corner(plans)]


def _judged(entry: Record, plans: Plans, extent: Extent) -> Record:
    case, late = BY_NAME[entry["case"]], entry.get("late", 0.0)
    printed, unit = [str(digits) for digits in entry["stated"]], entry["unit"]
    grids = [grid(name, extent) for name in entry["grids"]]
    outcomes = [(plans.outcome(varied), label) for over in grids for varied, label in variations(case, over)]
    plan = plans.plan(case)
    found = [(read(one, *entry["measure"]), label) for one, label in [(plan, ""), *outcomes] if isinstance(one, Plan)]
    ours = found[0][0]
    as_run = given_by(printed, ours, late)
    # the nearest run: one that gives the numbers before one that does not
    ranked = [(not given_by(printed, values, late), _miss(printed, values), label) for values, label in found]
    fails, _, nearest = min(ranked)
    ranges = [limits_of(column) for column in zip(*(values for values, _ in found), strict=True)]
    beyond = max(excess(digits, low, high + late) for digits, (low, high) in zip(printed, ranges, strict=True))
    if not fails:
        reason = "" if as_run else f"with {nearest}"
    elif beyond <= ROUNDING:
        reason = "inside the range, but no single run gives it" + (f"; nearest with {nearest}" if nearest else "")
    else:
        reason = f"{beyond:.2g} {unit} beyond the range" if math.isfinite(beyond) else "never happens here"
        reason += "; " + entry["why"].format(*read(plan, *entry["of"])) if "why" in entry else ""
    over = [*map(_named, grids), *([f"step up to {late:g} s"] if late else [])]
    deviations = [text(value - _value(digits), "+.2g") for value, digits in zip(ours, printed, strict=True)]
    covered = ", ".join(span((low, high + late)) for low, high in ranges) + f" over {', '.join(over)}"
    return verdict(entry["row"], entry["source"], f"{entry['quantity']} [{unit}]", ", ".join(printed), text(ours),
                   not fails, reason, as_run, complete=extent.complete, deviation=", ".join(deviations),
                   covered=covered)  # fmt: skip


def verdict(
    row: str, source: str, quantity: str, stated: str, ours: str, holds: bool, reason: str, as_run: bool,
    *, complete: bool = True, condition: str = "", deviation: str = "", covered: str = "",
) -> Record:  # fmt: skip
    """Return the verdict on a statement; ``as_run``: whether our own run reproduces it, without a variation.

    What a run that is not ``complete`` does not reproduce, a full run may: it is not judged.
    """
    failed = "differs" if complete else NOT_JUDGED
    return {"row": row, "source": source, "condition": condition or thesis()["rows"][row], "quantity": quantity,
            "stated": stated, "ours": ours, "deviation": deviation, "covered": covered,
            "verdict": "reproduced" if holds else failed, "reason": reason, "as_run": as_run}  # fmt: skip


def _miss(printed: Sequence[str], values: Numbers) -> float:
    miss = [abs(value - _value(digits)) for value, digits in zip(values, printed, strict=True)]
    return max(math.inf if math.isnan(value) else value for value in miss)


def growth_with_threshold(plans: Plans) -> Record:
    """Judge whether the forces on the line grow with threshold and speed."""
    slow, fast, high = (read(plans.plan(case), "entry_forces") for case in CROSSINGS[4:])
    holds, ours = max(slow) < max(fast) < max(high), "; ".join(text(pair, ".2g") for pair in (slow, fast, high))
    return verdict("3.21-3.22", "figs 3.19, 3.21, 3.22", "forces grow with speed and threshold", "in words",
                   f"{ours} N", holds, "forces as they begin to fall", holds,
                   condition="line, CN 4 at 0.1 m/s, CN 4 and 15 at 0.2 m/s")  # fmt: skip


def same_before_the_corner(plans: Plans) -> Record:
    """Judge whether carrier 2 can meet its speed limit at 0.65 s on one corner and at 0.4 s on the other."""
    wide, sharp = plans.plan(CORNERS[0]), plans.plan(CORNERS[2])
    entered = float(wide.motion.t[wide.motion.jumps][0])
    first, second = wide.t < entered - 1e-9, sharp.t < entered - 1e-9
    apart = float(np.abs(wide.carriers.s[first] - sharp.carriers.s[second]).max())
    met = [read(plan, "first_bound", "speed", 2)[0] for plan in (wide, sharp)]
    reason = f"up to {entered:.2g} s the plans differ by at most {apart:.1g} m: no set-up meets both times"
    return verdict("4.10-4.11", "figs 4.9, 4.11", "carrier 2 first meets its speed limit [s]", "0.65 and 0.4",
                   f"{text(met[0])} and {text(met[1])}", not apart < 1e-9, reason, False,
                   condition="both corners, λ 0: the same motion up to the corner")  # fmt: skip


def sensitivity(plans: Plans, extent: Extent) -> list[Record]:
    """Vary every unstated parameter, one at a time; NaN where a number exists nowhere on the grid."""
    records = []
    for case in _ranged(extent):
        stated = thesis()["sensitivity"][case.path]
        for over in (grid(name, extent) for name in stated["grids"]):
            outcomes = [plans.outcome(varied) for varied, _ in variations(case, over)]
            existing = [outcome for outcome in outcomes if isinstance(outcome, Plan)]
            for quantity, reading in stated["quantities"].items():
                low, high = limits_of([value for plan in existing for value in read(plan, *reading)])
                records.append({"case": case.name, "quantity": quantity, "parameter": _named(over), "low": low,
                                "ours": max(read(plans.plan(case), *reading)), "high": high, "plans": len(outcomes),
                                "without": len(outcomes) - len(existing)})  # fmt: skip
    return records
