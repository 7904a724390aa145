"""Verdicts on the numbers that the thesis states (``thesis.yaml``), over grids of the parameters it does not state."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from redundancy_pin.planners.plan import Plan
from redundancy_pin.thesis.case import Case, Plans
from redundancy_pin.thesis.cases import BY_NAME, CORNERS, CROSSINGS, Extent
from redundancy_pin.thesis.measures import MotionRun, Numbers, read
from redundancy_pin.thesis.table import Record, data, mode_text, span, text

ROUNDING = 1e-12
"""A gap up to this is none: the limits of an interval are themselves rounded."""

_RAMP_DOWN = 0.03
"""Time in which the forces fall before the motors are off, on the circle, s."""

_LATE = 0.01
"""Largest delay with which the thesis notices an instant, s: its times have two decimals, its step may be 10 ms."""


@functools.cache
def thesis() -> Mapping[str, Any]:
    """Return ``thesis.yaml``; the numbers stated with each crossing are among ``motions``, ``planned`` and ``rows``."""
    stated = dict(data("thesis"))
    rows: dict[str, str] = {}
    motions, planned = list(stated["motions"]), []
    for one in stated["crossings"]:
        threshold, figure = one["threshold"], f"fig. {one['figure']}"
        parked = {"source": figure, "case": f"{one['motion']}-parked"}
        moving = {"source": figure, "case": f"{one['motion']}-cn{threshold}"}
        for edge, when, forces, switching in (("entry", "met", "falling", "off"), ("exit", "left", "rising", "on")):
            row, at = f"{one['figure']} {edge}", float(one[when])
            rows[row] = f"{one['motion'].replace('-', ' ')} m/s, CN {threshold}, switching {switching}"
            motions.append({**parked, "quantity": f"threshold {threshold} {when}", "unit": "s", "stated": [at],
                            "measure": [f"threshold_{when}", threshold], "note": one.get("note", "")})  # fmt: skip
            planned.append({**moving, "row": row, "quantity": f"threshold {when}", "unit": "s", "stated": [one[when]],
                            "measure": ["time_of", edge], "grids": [one["ramps"]], "late": _LATE,
                            "why": f"at {one[when]} s the condition number is {{:.3g}} here",
                            "of": ["condition_at", at]})  # fmt: skip
            planned.append({**moving, **stated["forces"][edge], "row": row, "unit": "N", "stated": one[forces],
                            "grids": [one["ramps"], "ramp_starts"] if edge == "entry" else ["returns"]})  # fmt: skip
        motions.append({**parked, "quantity": f"threshold {threshold}: forces", "unit": "N",
                        "stated": [float(force) for force in one["falling"]], "note": stated["forces"]["note"],
                        "measure": ["parked_forces", threshold, _RAMP_DOWN]})  # fmt: skip
    motions.sort(key=lambda entry: list(BY_NAME).index(entry["case"]))
    return {**stated, "motions": motions, "planned": [*planned, *stated["planned"]], "rows": rows | stated["rows"]}


# --- the rule ------------------------------------------------------------------------------------------------------


def interval(printed: str) -> tuple[float, float]:
    """Return what printed digits can stand for: ± half a unit of the last one; with a ``~``, a factor of √10."""
    if printed.startswith("~"):
        value = float(printed[1:])
        return value / math.sqrt(10.0), value * math.sqrt(10.0)
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


# --- what is unstated ----------------------------------------------------------------------------------------------

_RAMP_TIME = {"circle": 0.2, "line": 1.0, "corner": 0.4, "square": 0.2}
"""Duration T of the ramps, s."""

_CORNER_SPEED = 0.2
"""Cruising speed v of the 3-RRR, m/s; the 2-RPR's cases have their own."""

_PARAMETERS = {
    "ramp_length": ("ramp length p", "v T"),
    "return_time": ("return time", "s"),
    "dt": ("step δt", "ms"),
    "ramp_down": ("sample at which the ramp starts", "s before the threshold"),
    "threshold": ("threshold", ""),
    "working_mode": ("working mode", ""),
    "alpha": ("orientation α", "rad"),
}
"""What the parameters of a grid are called, and their units."""


def vary(case: Case, parameter: str, value: Any) -> Case:
    """Return a case with another value of one unstated parameter, all others as they are."""
    match parameter:
        case "ramp_length":
            return case.with_path(ramp_length=value * case.option("speed", _CORNER_SPEED) * _RAMP_TIME[case.path])
        case "alpha":
            return case.with_path(alpha=value)
        case "working_mode":
            return replace(case, working_mode=value)
        case "dt":
            return replace(case, dt=value)
    return case.with_options(**{parameter: value})


@dataclass(frozen=True)
class ParameterGrid:
    """Values of unstated parameters, by parameter; all combinations of them."""

    values: Mapping[str, Sequence[Any]]

    @property
    def parameter(self) -> str:
        """Names of the parameters."""
        return " and ".join(_PARAMETERS[name][0] for name in self.values)

    @property
    def shown(self) -> str:
        """The values, as text."""
        modes = self.values.get("working_mode")
        return f"{len(modes)} modes" if modes else "; ".join(_quantity(*pair) for pair in self.values.items())

    def cases(self, case: Case) -> list[tuple[Case, str]]:
        """Return the variations of a case, each with a label of the change."""
        variations = []
        for combination in product(*self.values.values()):
            changed, labels = case, []
            for name, value in zip(self.values, combination, strict=True):
                before, changed = changed, vary(changed, name, value)
                shown = f"mode {mode_text(value)}" if name == "working_mode" else _named(name, value)
                labels += [shown] if changed != before else []
            variations.append((changed, ", ".join(labels)))
        return variations


def _named(name: str, value: float) -> str:
    return f"{_PARAMETERS[name][0]} = {_quantity(name, [value])}"


def _quantity(name: str, values: Sequence[float]) -> str:
    """Return values of a parameter with its unit."""
    unit = _PARAMETERS[name][1]
    return (", ".join(f"{1e3 * value if unit == 'ms' else value:g}" for value in values) + f" {unit}").rstrip()


def grid(name: str, extent: Extent) -> ParameterGrid:
    """Return a grid of the data file; only the ends of its values unless whole grids are run."""
    values = {
        parameter: list(extent.modes) if entry == "all" else entry if extent.whole_grids else [entry[0], entry[-1]]
        for parameter, entry in thesis()["grids"][name].items()
    }
    return ParameterGrid(values)


# --- verdicts ------------------------------------------------------------------------------------------------------


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


def needed(extent: Extent) -> list[Case]:
    """Return every variation of the unstated parameters, to plan all at once."""
    judged = [(BY_NAME[entry["case"]], entry["grids"]) for entry in thesis()["planned"]]
    ranged = [(case, thesis()["sensitivity"][case.path]["grids"]) for case in _ranged(extent)]
    grids = [(case, grid(name, extent)) for case, names in (*judged, *ranged) for name in names]
    return [varied for case, over in grids for varied, _ in over.cases(case)]


def _ranged(extent: Extent) -> tuple[Case, ...]:
    return (*(CROSSINGS[:4] if extent.whole_grids else CROSSINGS[:1]), *CORNERS)


def judge_all(plans: Plans, extent: Extent) -> list[Record]:
    """Judge every number, and every joint statement, about the planned cases."""
    tests = {"growth_with_threshold": growth_with_threshold, "same_before_the_corner": same_before_the_corner}
    jointly = [
        {"deviation": "", "covered": "", **entry, **tests[entry["test"]](plans)} for entry in thesis()["jointly"]
    ]
    return [*(_judged(entry, plans, extent) for entry in thesis()["planned"]), *jointly]


def _judged(entry: Record, plans: Plans, extent: Extent) -> Record:
    case, late = BY_NAME[entry["case"]], entry.get("late", 0.0)
    printed, unit = [str(digits) for digits in entry["stated"]], entry["unit"]
    grids = [grid(name, extent) for name in entry["grids"]]
    outcomes = [(plans.outcome(varied), label) for over in grids for varied, label in over.cases(case)]
    plan = plans.plan(case)
    variations = [
        (read(one, *entry["measure"]), label) for one, label in [(plan, ""), *outcomes] if isinstance(one, Plan)
    ]
    ours = variations[0][0]
    as_run = given_by(printed, ours, late)
    # the nearest run: one that gives the numbers before one that does not
    fails, _, nearest = min(
        (not given_by(printed, varied, late), _miss(printed, varied), label) for varied, label in variations
    )
    ranges = [limits_of(column) for column in zip(*(values for values, _ in variations), strict=True)]
    beyond = max(excess(digits, low, high + late) for digits, (low, high) in zip(printed, ranges, strict=True))
    if not fails:
        reason = "" if as_run else f"with {nearest}"
    elif beyond <= ROUNDING:
        reason = "inside the range, but no single run gives it" + (f"; nearest with {nearest}" if nearest else "")
    else:
        reason = f"{beyond:.2g} {unit} beyond the range" if math.isfinite(beyond) else "never happens here"
        reason += "; " + entry["why"].format(*read(plan, *entry["of"])) if "why" in entry else ""
    over = [varied.parameter for varied in grids] + ([f"step up to {late:g} s"] if late else [])
    deviations = [text(value - _value(digits), "+.2g") for value, digits in zip(ours, printed, strict=True)]
    covered = ", ".join(span((low, high + late)) for low, high in ranges) + f" over {', '.join(over)}"
    return {"row": entry["row"], "source": entry["source"], "condition": thesis()["rows"][entry["row"]],
            "quantity": f"{entry['quantity']} [{unit}]", "stated": ", ".join(printed), "ours": text(ours),
            "deviation": ", ".join(deviations), "covered": covered, **_verdict(not fails, reason, as_run)}  # fmt: skip


def _verdict(reproduced: bool, reason: str, as_run: bool) -> Record:
    return {"verdict": "reproduced" if reproduced else "differs", "reason": reason, "as_run": as_run}


def _value(printed: str) -> float:
    return float(printed.removeprefix("~"))


def _miss(printed: Sequence[str], values: Numbers) -> float:
    miss = [abs(value - _value(digits)) for value, digits in zip(values, printed, strict=True)]
    return max(math.inf if math.isnan(value) else value for value in miss)


def growth_with_threshold(plans: Plans) -> Record:
    """Judge whether the forces on the line grow with threshold and speed."""
    slow, fast, high = (read(plans.plan(case), "entry_forces") for case in CROSSINGS[4:])
    holds, ours = max(slow) < max(fast) < max(high), "; ".join(text(pair, ".2g") for pair in (slow, fast, high))
    return {"ours": f"{ours} N", **_verdict(holds, "forces as they begin to fall", holds)}


def same_before_the_corner(plans: Plans) -> Record:
    """Judge whether carrier 2 can meet its speed limit at 0.65 s on one corner and at 0.4 s on the other."""
    wide, sharp = plans.plan(CORNERS[0]), plans.plan(CORNERS[2])
    entered = float(wide.motion.t[wide.motion.jumps][0])
    first, second = wide.t < entered - 1e-9, sharp.t < entered - 1e-9
    apart = float(np.abs(wide.carriers.s[first] - sharp.carriers.s[second]).max())
    met = [read(plan, "first_bound", "speed", 2)[0] for plan in (wide, sharp)]
    reason = f"up to {entered:.2g} s the plans differ by at most {apart:.1g} m: no set-up meets both times"
    return {"ours": f"{text(met[0])} and {text(met[1])}", **_verdict(not apart < 1e-9, reason, False)}


# --- sensitivity ---------------------------------------------------------------------------------------------------


def sensitivity(plans: Plans, extent: Extent) -> list[Record]:
    """Vary every unstated parameter, one at a time; NaN where a number exists nowhere on the grid."""
    return [
        record
        for case in _ranged(extent)
        for name in thesis()["sensitivity"][case.path]["grids"]
        for record in _ranges(case, grid(name, extent), plans)
    ]


def _ranges(case: Case, over: ParameterGrid, plans: Plans) -> list[Record]:
    outcomes = [plans.outcome(varied) for varied, _ in over.cases(case)]
    existing = [outcome for outcome in outcomes if isinstance(outcome, Plan)]
    records = []
    for quantity, reading in thesis()["sensitivity"][case.path]["quantities"].items():
        low, high = limits_of([value for plan in existing for value in read(plan, *reading)])
        records.append({"case": case.name, "quantity": quantity, "parameter": over.parameter, "grid": over.shown,
                        "ours": max(read(plans.plan(case), *reading)), "low": low, "high": high,
                        "plans": len(outcomes), "without": len(outcomes) - len(existing)})  # fmt: skip
    return records
