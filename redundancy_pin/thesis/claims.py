"""Claims of the thesis and beyond it: each one function, with its text, its verdict and a sentence of its numbers."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis import cases
from redundancy_pin.thesis.cases import EFFORT, MOVING, NONE, PARKED, PEAK, STEPWISE, SWITCH_OFF, Case
from redundancy_pin.thesis.table import Record, grouped, span, text

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

NO_PLAN, BREAKS, NOT_JUDGED = "no plan exists", "breaks limits", "not judged"

Chapter = Mapping[str, Any]
Judged = tuple[int, int, str]
"""In how many of all cases a claim holds, and the sentence that shows the numbers."""

Judge = Callable[[Chapter], Judged]

NO_CASE = (0, 0, "No case of this kind is in this run.")


class Claim(NamedTuple):
    """Name, text, the function that judges a chapter, and whether quick runs have only some of its cases."""

    name: str
    text: str
    judge: Judge
    sampled: bool = False


CONCLUSIONS: list[Claim] = []
"""Conclusions of the thesis, judged by the chapter on its own planners."""

FINDINGS: list[Claim] = []
"""Findings of the chapter beyond the thesis."""


def claimed(to: list[Claim], *, sampled: bool = False) -> Callable[[Judge], Judge]:
    """Add the decorated function to a list of claims: its docstring is the text of the claim."""

    def add(judge: Judge) -> Judge:
        to.append(Claim(judge.__name__, inspect.getdoc(judge) or judge.__name__, judge, sampled))
        return judge

    return add


def verdicts(claims: Sequence[Claim], chapter: Chapter, *, complete: bool = True) -> list[Record]:
    """Return claims with their verdicts by the records of a chapter.

    If the run is not ``complete``, some cases of a sampled claim can show that it stands with conditions, and nothing
    else: no verdict of a quick run contradicts that of the full one.
    """
    records = []
    for claim in claims:
        good, total, here = claim.judge(chapter)
        stands = "stands" if good == total else "stands with conditions" if good else "does not stand"
        if not total or (claim.sampled and not complete and good in (0, total)):
            stands = NOT_JUDGED
        records.append({"name": claim.name, "claim": claim.text, "stands": stands, "good": good, "total": total,
                        "here": " ".join(here.split())})  # fmt: skip
    return records


_one, _factors = partial(text, form=".1g"), partial(span, form=".2g")


def _names(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def _ratios(pairs: Sequence[tuple[Record, Record]], key: str) -> list[float]:
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


# --- conclusions of the thesis ---------------------------------------------------------------------------------------


@claimed(CONCLUSIONS)
def crossing(chapter: Chapter) -> Judged:
    """Two actuated masses carry a 2-RPR through type II singularities with the main actuators off (5.1.1)."""
    crossings, heavy = chapter["crossings"], chapter["heavy_end_effector"]
    inside = [record["case"] for record in crossings if record["status"] == "ok"]
    here = f"""All {len(crossings)} crossings exist as motions of the massless machine; {len(inside)} keep the
        carriers' limits ({_names(inside)})."""
    if heavy:
        here += f""" With an {heavy["what"]} none exists: at the singular pose a force of
            {text(heavy["details"]["amount"])} N is left that neither set of actuators can carry."""
    return len(inside) + (heavy is None), len(crossings) + 1, here


@claimed(CONCLUSIONS)
def limits(chapter: Chapter) -> Judged:
    """Limits of the carriers need not be considered in the crossing, as the motions are small (section 3.4)."""
    crossings, total = chapter["crossings"], len(chapter["crossings"])
    broken = [record["case"] for record in crossings if record["status"] == "limit_violated"]
    return total - len(broken), total, f"{len(broken)} of {total} plans break a limit ({_names(broken)})."


@claimed(CONCLUSIONS)
def exit_forces(chapter: Chapter) -> Judged:
    """A larger threshold leads to larger forces when the actuators are switched on again (section 5.1.1)."""
    exact = max(max(record["jump"]) for record in chapter["crossings"])
    here = f"Solved exactly, forces begin from {_one(exact)} N at most on switching on, whatever the threshold."
    if exact >= STATED_FORCE:
        return 1, 1, here
    return 0, 1, f"{here} The stated jumps come from the discretisation, not from the inverse of the Jacobian."


def _by_mode(chapter: Chapter, motion: str) -> list[dict[str, Record]]:
    """Return, for each working mode, the records of a motion by what moves."""
    records = [record for record in chapter["fair_comparison"] if record["motion"] == motion]
    return [{record["what"]: record for record in group} for group in grouped(records, "mode").values()]


def _corner(chapter: Chapter, motion: str) -> Judged:
    groups = _by_mode(chapter, motion)
    moving, parked, none = ([group[what] for group in groups] for what in (f"{MOVING}, λ = 0", PARKED, NONE))
    factors, alone, against = (
        _ratios(list(zip(one, other, strict=True)), "peak")
        for one, other in ((moving, none), (parked, none), (moving, parked))
    )
    lower = sum(factor < 1.0 for factor in factors)
    here = f"""Against the machine without carriers the peak is lower in {lower} of {len(groups)} working modes
        ({_factors(factors)} times), against the same machine with parked carriers in
        {sum(factor < 1.0 for factor in against)}; parked carriers alone make it {_factors(alone)} times as large."""
    for what in groups[0]:
        if what.startswith(f"{MOVING}, λ = 0,"):  # with a raised limit
            raised = sum(group[what]["peak"] < group[NONE]["peak"] for group in groups)
            here += f" With {what.rpartition(', ')[2]} it is lower in {raised}."
    return lower, len(groups), here


@claimed(CONCLUSIONS, sampled=True)
def wide_corner(chapter: Chapter) -> Judged:
    """Moving carriers reduce the base torques at a corner (section 5.1.2)."""
    return _corner(chapter, "corner-r0.025")


@claimed(CONCLUSIONS, sampled=True)
def sharp_corner(chapter: Chapter) -> Judged:
    """At a sharper corner the optimised torques can exceed the baseline's (5.1.2)."""
    lower, total, here = _corner(chapter, "corner-r0.013")
    return total - lower, total, here


@claimed(CONCLUSIONS, sampled=True)
def square(chapter: Chapter) -> Judged:
    """Moving carriers lower the largest base torques on the square (section 4.4)."""
    groups = _by_mode(chapter, "square")
    pairs = [(group[what], group[NONE]) for group in groups for what in group if what.startswith(MOVING)]
    factors = _ratios(pairs, "peak")
    better = sum(factor < 1.0 for factor in factors)
    broken = sum(moving["status"] == ResultStatus.LIMIT_VIOLATED.value for moving, _ in pairs)
    here = f"""Over the whole square, returns of the carriers included, the peak is {_factors(factors)} times that of
        the machine without carriers; it is lower in {better} of {len(pairs)} plans. {broken} of the plans break a limit
        of the carriers."""
    return better, len(pairs), here


@claimed(CONCLUSIONS, sampled=True)
def shared(chapter: Chapter) -> Judged:
    """The effort is shared: tasks beyond the base actuators become feasible without changing them (5.1.2)."""
    groups = [group for motion in ("corner-r0.025", "corner-r0.013") for group in _by_mode(chapter, motion)]
    pairs = [(group[f"{MOVING}, λ = 0"], group[NONE]) for group in groups]
    relieved = sum(all(moving[key] < none[key] for key in ("peak", "main_energy")) for moving, none in pairs)
    here = f"""At both corners with λ = 0 the base actuators move {_factors(_ratios(pairs, "main_energy"))} times the
        energy they need without carriers, and are relieved in peak and energy in {relieved} of {len(pairs)} plans.
        With the carriers' own actuators it is {_factors(_ratios(pairs, "energy"))} times the energy."""
    return relieved, len(pairs), here


@claimed(CONCLUSIONS, sampled=True)
def agreement(chapter: Chapter) -> Judged:
    """The figures of chapter 4 show one machine in one working mode (not stated)."""
    claims = chapter["claims"]
    counts = {mode: sum(entry["modes"][mode]["holds"] for entry in claims) for mode in claims[0]["modes"]}
    most = max(counts.values())
    here = f"""The best working modes ({_names(mode for mode, count in counts.items() if count == most)}) reproduce
        {most} of the {len(claims)} statements made in words."""
    return sum(count == len(claims) for count in counts.values()), len(counts), here


# --- findings beyond the thesis --------------------------------------------------------------------------------------


def _singular_tasks(chapter: Chapter) -> dict[str, dict[str, Record]]:
    groups = by_task(chapter["plans"])
    return {task.name: groups[task.name] for task in cases.SINGULAR if task.name in groups}


def _both_sound(group: Mapping[str, Record]) -> bool:
    return bool(group[EFFORT]["sound"] and group[PEAK]["sound"])


@claimed(FINDINGS)
def singular(chapter: Chapter) -> Judged:
    """Singularities can be crossed with the main motors on and every limit kept."""
    groups = _singular_tasks(chapter)
    sound, off = sum(map(_both_sound, groups.values())), {task: group[SWITCH_OFF] for task, group in groups.items()}
    kept, none = (_names(t for t in off if off[t][key] is value) for key, value in (("sound", True), ("exists", False)))
    here = f"""Over the whole trajectory {sound} of {len(groups)} motions have plans within every limit, with both
        objectives. Switching off keeps the limits on {kept}, and has no plan for {none}."""
    late = [task for task, group in groups.items() if not off[task]["sound"] and group[cases.SWITCH_OFF_LATE]["sound"]]
    if late:
        here += f" Only beyond a condition number of {text(cases.LATE)} it keeps them on {_names(late)} too."
    both = [(group[EFFORT], off[task]) for task, group in groups.items()]
    if both := [pair for pair in both if all(one["exists"] for one in pair)]:
        here += f""" Where both have one, the plan of least effort has {_factors(_ratios(both, "worst"))} times the
            largest main force of switching off, which it reaches as the carriers return, and
            {_factors([whole["worst"] / other["before"] for whole, other in both])} times the largest before the motors
            are off."""
    return sound, len(groups), here


@claimed(FINDINGS)
def heavy(chapter: Chapter) -> Judged:
    """Machines with masses, for which switching off has no solution, can cross too."""
    without = {task: group for task, group in _singular_tasks(chapter).items() if not group[SWITCH_OFF]["exists"]}
    good = sum(map(_both_sound, without.values()))
    left = (f"{task} ({text(group[SWITCH_OFF]['missing'])} N)" for task, group in without.items())
    here = f"""Of {len(without)} motions that cannot be crossed with the motors off, {good} have plans within the
        limits. Force that nothing would carry with the motors off: {_names(left)}."""
    return good, len(without), here


@claimed(FINDINGS, sampled=True)
def speed(chapter: Chapter) -> Judged:
    """The circle can be crossed faster than at the thesis's 0.75 m/s within the limits."""
    circles = [race for race in chapter["fastest"] if race["task"].startswith("circle")]
    if not circles:
        return NO_CASE
    speeds = [race["fastest_with_plan"]["speed"] for race in circles]
    here = f"""Fastest with a plan: {", ".join(f"{fastest:.3f} m/s" for fastest in speeds)}. The problem is not convex:
        upper ends are verdicts of the solver, not proofs."""
    return sum(fastest > THESIS_SPEED for fastest in speeds), len(circles), here


def _turn(chapter: Chapter, task: Case) -> Judged:
    group = by_task(chapter["plans"])[task.name]
    alone = {"ratio": group[PEAK]["worst"] / group[NONE]["worst"], "rows": group}
    alone["lower"] = group[PEAK]["sound"] and alone["ratio"] < 1.0
    radius = task.option("radius") if task.path == "corner" else None
    same = [record for record in chapter["working_modes"] if record["radius"] == radius] or [alone]
    good, rows = sum(bool(record["lower"]) for record in same), [record["rows"] for record in same]

    def stepwise_lower(method: str) -> int:
        stepwise = [(row[STEPWISE], row[method]) for row in rows if row[STEPWISE]["exists"]]
        return sum(not one["worst"] >= other["worst"] for one, other in stepwise)

    here = f"""The least peak is lower in {good} of {len(same)} working modes
        ({_factors([record["ratio"] for record in same])} times). Stepwise planning has a lower one than the whole
        trajectory in {stepwise_lower(PEAK)}."""
    if cases.PEAK_FREE in rows[0]:
        here += f" With the end free, as stepwise planning leaves it, it has one in {stepwise_lower(cases.PEAK_FREE)}."
    return good, len(same), here


FINDINGS += [
    Claim(
        name,
        f"On the {where} the peak torque is lower than without carriers.",
        partial(_turn, task=task),
        task.path == "corner",
    )
    for name, where, task in zip(
        ("corner_wide", "corner_sharp", "corner_square"),
        ("corner of radius 0.025 m", "corner of radius 0.013 m", "square with corners of radius 0.025 m"),
        cases.TURNS,
        strict=True,
    )
]


def _optimised(chapter: Chapter) -> dict[str, Record]:
    """Return the plans over the whole trajectory, by name."""
    return {f"{one['task']} ({one['way']})": one for one in chapter["plans"]
            if one["way"] in cases.OBJECTIVES and one["exists"]}  # fmt: skip


@claimed(FINDINGS)
def cost(chapter: Chapter) -> Judged:
    """Moving carriers save energy on corners and square."""
    if not (pairs := cost_pairs(chapter)):
        return NO_CASE
    factors = _ratios(pairs, "energy")
    better = sum(factor < 1.0 for factor in factors)
    here = f"""With the carriers' own motors counted, {better} of {len(pairs)} plans need less energy than the machine
        without carriers; they need {_factors(factors)} times as much."""
    if least := [pair for pair in pairs if pair[0]["way"] == cases.ENERGY]:
        here += f""" Planned for least energy it is {_factors(_ratios(least, "energy"))} times, at
            {_factors(_ratios(least, "worst"))} times the peak torque."""
    return better, len(pairs), here


def cost_pairs(chapter: Chapter) -> list[tuple[Record, Record]]:
    """Return the plans over the whole trajectory, each with the machine without carriers on the same motion."""
    groups = by_task(chapter["plans"])
    return [(one, groups[one["task"]][NONE]) for one in _optimised(chapter).values() if NONE in groups[one["task"]]]


def _worst(values: Mapping[str, float], most: float) -> tuple[int, str]:
    """Return how many values are at most so large, and the name of the largest."""
    return sum(value <= most for value in values.values()), max(values, key=values.__getitem__)


@claimed(FINDINGS)
def between(chapter: Chapter) -> Judged:
    """What a plan promises at its nodes holds between them."""
    factors = {name: one["dense_peak"] / one["peak"] for name, one in _optimised(chapter).items()}
    if not factors:
        return NO_CASE
    good, worst = _worst(factors, BETWEEN)
    here = f"""On a grid 20 times finer than the nodes, and next to the singular instants, the peak is at most
        {text(BETWEEN)} times that at the nodes in {good} of {len(factors)} plans; at worst {factors[worst]:.3f} times
        ({worst})."""
    return good, len(factors), here


@claimed(FINDINGS)
def calm(chapter: Chapter) -> Judged:
    """The efforts are calm enough for motors as they are."""
    plans, groups = _optimised(chapter), by_task(chapter["plans"])
    turns = {name: float(one["reversals"]) for name, one in plans.items()}
    if not turns:
        return NO_CASE
    good, worst = _worst(turns, CALM)
    here = f"""In {good} of {len(turns)} plans over the whole trajectory every main effort reverses at most {CALM}
        times; at worst one reverses {text(turns[worst])} times ({worst}). Near a singularity W⁻¹ magnifies every kink
        of s̈."""
    if smooth := [one for one in plans.values() if one["way"] == cases.SMOOTH]:
        peaks = _ratios([(one, groups[one["task"]][EFFORT]) for one in smooth], "worst")
        here += f""" With a weight of {text(cases.SMOOTHING)} on the rate of the efforts they reverse at most
            {text(max(one["reversals"] for one in smooth))} times on the crossings, with {_factors(peaks)} times the
            peak of the least effort."""
    return good, len(turns), here


@claimed(FINDINGS, sampled=True)
def backends(chapter: Chapter) -> Judged:
    """Both backends lead to the same plan."""
    if not (compared := chapter["backends"]):
        return NO_CASE
    worst, good = max(compared, key=lambda record: float(record["worst"])), sum(one["same"] for one in compared)
    here = f"""{good} of {len(compared)} plans agree to {text(SAME_PLAN)} of the largest value, in status too; the
        largest difference is {_one(worst["worst"])} ({worst["case"]})."""
    if flat := [one["case"] for one in compared if not one["same"] and one["cost"] <= SAME_PLAN]:
        here += f" Where plans differ and costs do not ({_names(flat)}), the optimum is flat."
    return good, len(compared), here


@claimed(FINDINGS, sampled=True)
def first_guesses(chapter: Chapter) -> Judged:
    """Parked carriers are first guess enough."""
    if not (starts := chapter["first_guesses"]):
        return NO_CASE
    good, tried = sum(record["parked_is_best"] for record in starts), max(len(record["costs"]) for record in starts)
    here = f"""From {tried} first guesses each, parked carriers lead to the best plan known in {good} of {len(starts)}
        cases."""
    return good, len(starts), here
