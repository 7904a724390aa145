"""Claims of the thesis and beyond it: each one function, with its text, its verdict and a sentence of its numbers."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis import cases
from redundancy_pin.thesis.case import Case
from redundancy_pin.thesis.cases import EFFORT, MOVING, NONE, PARKED, PEAK, STEPWISE, SWITCH_OFF
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
    """Name, text, and the function that judges a chapter."""

    name: str
    text: str
    judge: Judge


CONCLUSIONS: list[Claim] = []
"""Conclusions of the thesis, judged by the chapter on its own planners."""

FINDINGS: list[Claim] = []
"""Findings of the chapter beyond the thesis."""


def claimed(to: list[Claim]) -> Callable[[Judge], Judge]:
    """Add the decorated function to a list of claims: its docstring is the text of the claim."""

    def add(judge: Judge) -> Judge:
        to.append(Claim(judge.__name__, inspect.getdoc(judge) or judge.__name__, judge))
        return judge

    return add


def verdicts(claims: Sequence[Claim], chapter: Chapter) -> list[Record]:
    """Return claims with their verdicts by the records of a chapter."""
    records = []
    for claim in claims:
        good, total, here = claim.judge(chapter)
        stands = "stands" if good == total else "stands with conditions" if good else "does not stand"
        records.append({"name": claim.name, "claim": claim.text, "stands": stands if total else NOT_JUDGED,
                        "good": good, "total": total, "here": " ".join(here.split())})  # fmt: skip
    return records


_one, _two, _factors = partial(text, form=".1g"), partial(text, form=".2g"), partial(span, form=".2g")


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
    else:
        here += " So does that with a massive end-effector."
    return len(inside) + (heavy is None), len(crossings) + 1, here


@claimed(CONCLUSIONS)
def limits(chapter: Chapter) -> Judged:
    """Limits of the carriers need not be considered in the crossing, as the motions are small (section 3.4)."""
    crossings, total = chapter["crossings"], len(chapter["crossings"])
    broken = [record for record in crossings if record["status"] == "limit_violated"]
    here = [f"{len(broken)} of {total} plans break a limit."]
    for record in crossings:
        if out := record["beyond_track_at_exit"]:
            here.append(f"{record['case']} is {out:.3f} m beyond its track already when switched on.")
    for record in broken:
        if not record["no_shortest"]:
            here.append(f"A return of {record['shortest']:.3f} s cures {record['case']}.")
    if never := [record["case"] for record in crossings if record["no_shortest"]]:
        here.append(f"No duration of the return keeps the limits of {_names(never)}.")
    return total - len(broken), total, " ".join(here)


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
    groups, moving = _by_mode(chapter, motion), f"{MOVING}, λ = 0"

    def below(what: str, other: str) -> int:
        return sum(group[what]["peak"] < group[other]["peak"] for group in groups)

    lower, total = below(moving, NONE), len(groups)
    factors, parked = (_ratios([(group[what], group[NONE]) for group in groups], "peak") for what in (moving, PARKED))
    here = f"""Against the machine without carriers the peak is lower in {lower} of {total} working modes
        ({_factors(factors)} times), against the same machine with parked carriers in {below(moving, PARKED)}; parked
        carriers alone make it {_factors(parked)} times as large."""
    for what in groups[0]:
        if what.startswith(moving + ","):
            here += f" With {what.rpartition(', ')[2]} it is lower in {below(what, NONE)}."
    return lower, total, here


@claimed(CONCLUSIONS)
def wide_corner(chapter: Chapter) -> Judged:
    """Moving carriers reduce the base torques at a corner (section 5.1.2)."""
    return _corner(chapter, "corner-r0.025")


@claimed(CONCLUSIONS)
def sharp_corner(chapter: Chapter) -> Judged:
    """At a sharper corner the optimised torques can exceed the baseline's (5.1.2)."""
    lower, total, here = _corner(chapter, "corner-r0.013")
    return total - lower, total, here


@claimed(CONCLUSIONS)
def square(chapter: Chapter) -> Judged:
    """Moving carriers lower the largest base torques on the square (section 4.4)."""
    groups = _by_mode(chapter, "square")
    pairs = [(group[what], group[NONE]) for group in groups for what in group if what.startswith(MOVING)]
    better = sum(moving["peak"] < none["peak"] for moving, none in pairs)
    broken = sum(moving["status"] != "ok" for moving, _ in pairs)
    here = f"""Over the whole square, returns included, the peak is {_factors(_ratios(pairs, "peak"))} times and the
        rms {_factors(_ratios(pairs, "rms"))} times that of the machine without carriers; the peak is lower in
        {better} of {len(pairs)} plans, and {broken} of them break a limit of the carriers on a return."""
    if not better:
        here += " What is gained in the corners is lost, many times over, in bringing the carriers back."
    return better, len(pairs), here


@claimed(CONCLUSIONS)
def shared(chapter: Chapter) -> Judged:
    """The effort is shared: tasks beyond the base actuators become feasible without changing them (5.1.2)."""
    groups = [group for motion in ("corner-r0.025", "corner-r0.013") for group in _by_mode(chapter, motion)]
    pairs = [(group[f"{MOVING}, λ = 0"], group[NONE]) for group in groups]
    relieved = sum(all(moving[key] < none[key] for key in ("peak", "main_energy")) for moving, none in pairs)
    forces, energy = [moving["carrier_force"] for moving, _ in pairs], _ratios(pairs, "energy")
    here = f"""At both corners with λ = 0 the base actuators move {_factors(_ratios(pairs, "main_energy"))} times the
        energy they need without carriers, and are relieved in peak and energy in {relieved} of {len(pairs)} plans.
        With the carriers' own actuators, which need {_factors(forces)} N, it is {_factors(energy)} times the energy."""
    return relieved, len(pairs), here + " The effort is not shared but multiplied." * (min(energy) >= 1.0)


@claimed(CONCLUSIONS)
def agreement(chapter: Chapter) -> Judged:
    """The figures of chapter 4 show one machine in one working mode (not stated)."""
    claims = chapter["claims"]
    counts = {mode: sum(entry["modes"][mode]["holds"] for entry in claims) for mode in claims[0]["modes"]}
    best, total = max(counts.values()), len(claims)
    modes = [mode for mode, count in counts.items() if count == best]
    here = f"""The best working modes ({_names(modes)}) reproduce {best} of the {total} statements made in words;
        {"one" if best == total else "no single"} working mode gives them all."""
    return sum(count == total for count in counts.values()), len(counts), here


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
    sound = sum(map(_both_sound, groups.values()))
    off = {task: group[SWITCH_OFF] for task, group in groups.items()}
    broken = [task for task, record in off.items() if record["exists"] and not record["sound"]]
    here = f"""Over the whole trajectory {sound} of {len(groups)} motions have plans within every limit, with both
        objectives. Switching off keeps the limits on {_names(task for task in off if off[task]["sound"])}, breaks
        them on {_names(broken)}, and has no plan for {_names(task for task in off if not off[task]["exists"])}."""
    for task in broken:
        late = groups[task].get(cases.SWITCH_OFF_LATE)
        if late and late["sound"]:
            here += f""" Switching off only beyond a condition number of {text(cases.LATE)} keeps them on {task} too,
                with a largest main force of {peak_text(late)}."""
    both = [(group[EFFORT], off[task]) for task, group in groups.items()]
    both = [(whole, other) for whole, other in both if whole["exists"] and other["exists"]]
    if both:
        before = [whole["worst"] / other["before"] for whole, other in both if not math.isnan(other["before"])]
        here += f""" Where both have one, the plan of least effort has {_factors(_ratios(both, "worst"))} times the
            largest main force of switching off (which it reaches as the carriers return), and {_factors(before)}
            times the largest until the motors are off."""
    return sound, len(groups), here


@claimed(FINDINGS)
def heavy(chapter: Chapter) -> Judged:
    """Machines with masses, for which switching off has no solution, can cross too."""
    without = {task: group for task, group in _singular_tasks(chapter).items() if not group[SWITCH_OFF]["exists"]}
    good = sum(map(_both_sound, without.values()))
    here = f"Of {len(without)} motions that cannot be crossed with the motors off, {good} have plans within the limits:"
    for task, group in without.items():
        here += f""" {task} ({text(group[SWITCH_OFF]["missing"])} N would be left that nothing can carry):
            {peak_text(group[EFFORT])} for the least effort, {peak_text(group[PEAK])} for the least peak."""
    return good, len(without), here


@claimed(FINDINGS)
def speed(chapter: Chapter) -> Judged:
    """The circle can be crossed faster than at the thesis's 0.75 m/s within the limits."""
    here = []
    for race in chapter["fastest"]:
        slower, faster, unit, cap = race["fastest_with_plan"], race["slowest_without"], race["unit"], ""
        if math.isfinite(race["effort_limit"]):
            cap = f" with main forces up to {text(race['effort_limit'])} {unit}"
        end = "the fastest that the ramps allow."
        if faster and faster["constraint"] == "seconds":
            end = f"no verdict in time at {faster['speed']:.3f} m/s."
        elif faster:
            why = f" ({faster['constraint']} of {faster['joint'] or 'a carrier'})" if faster["constraint"] else ""
            end = f"none found at {faster['speed']:.3f} m/s{why}."
        peak = f"{text(slower['peak'])} {unit}"
        here.append(f"{race['title']}{cap}: a plan at {slower['speed']:.3f} m/s (peak {peak}), {end}")
    here.append("The problem is not convex: upper ends are verdicts of the solver, not proofs.")
    circles = [race for race in chapter["fastest"]
               if race["task"].startswith("circle") and math.isinf(race["effort_limit"])]  # fmt: skip
    good = sum(race["fastest_with_plan"]["speed"] > THESIS_SPEED for race in circles)
    return good, len(circles), " ".join(here)


def _turn(chapter: Chapter, task: Case) -> Judged:
    group = by_task(chapter["plans"])[task.name]
    none, aims = group[NONE], {"effort": group[EFFORT], "peak": group[PEAK]}
    radius = task.option("radius") if task.path == "corner" else None
    same = [record for record in chapter["working_modes"] if record["radius"] == radius]
    alone = int(group[PEAK]["sound"] and group[PEAK]["worst"] < none["worst"])
    good = sum(record["lower"] for record in same) if same else alone

    def stepwise_lower(method: str) -> int:
        rows = [record["rows"] for record in same if record["rows"][STEPWISE]["exists"]]
        return sum(not row[STEPWISE]["worst"] >= row[method]["worst"] for row in rows)

    here = f"""Peaks: without carriers {text(none["worst"])} N·m; stepwise {peak_text(group[STEPWISE])}; over the
        whole trajectory {peak_text(group[EFFORT])} for least effort, {peak_text(group[PEAK])} for least peak."""
    if len(same) > 1:
        here += f""" Over the working modes the least peak is lower in {good} of {len(same)}
            ({_factors([record["ratio"] for record in same])} times). Stepwise planning, which leaves the carriers
            where they are, has a lower one in {stepwise_lower(PEAK)}; with the end free as well, in
            {stepwise_lower(cases.PEAK_FREE)}."""
    for aim, record in aims.items():
        if record["exists"]:
            factors = (_two(record[key] / none[key]) for key in ("worst", "rms", "main_energy", "energy"))
            here += f""" Least {aim}: {_names(factors)} times the machine without carriers (peak, rms, energy of the
                base motors, of all motors)."""
    return good, len(same) or 1, here


FINDINGS += [
    Claim(name, f"On the {where} the peak torque is lower than without carriers.", partial(_turn, task=task))
    for name, where, task in zip(
        ("corner_wide", "corner_sharp", "corner_square"),
        ("corner of radius 0.025 m", "corner of radius 0.013 m", "square with corners of radius 0.025 m"),
        cases.TURNS,
        strict=True,
    )
]


def _optimised(chapter: Chapter, exists: bool = True) -> dict[str, Record]:
    """Return the plans over the whole trajectory that exist, or those that do not, by name."""
    return {f"{one['task']} ({one['way']})": one for one in chapter["plans"]
            if one["way"] in cases.OBJECTIVES and one["exists"] is exists}  # fmt: skip


@claimed(FINDINGS)
def cost(chapter: Chapter) -> Judged:
    """Moving carriers save energy on corners and square."""
    pairs = cost_pairs(chapter)
    if not pairs:
        return NO_CASE
    better = sum(record["energy"] < none["energy"] for record, none in pairs)
    here = f"""With the carriers' own motors counted, {better} of {len(pairs)} plans need less energy than the machine
        without carriers; they need {_factors(_ratios(pairs, "energy"))} times as much, and carrier forces of up to
        {text(max(record["carrier_force"] for record, _ in pairs))} N."""
    if least := [pair for pair in pairs if pair[0]["way"] == cases.ENERGY]:
        here += f""" Planned for least energy it is {_factors(_ratios(least, "energy"))} times, at
            {_factors(_ratios(least, "worst"))} times the peak torque."""
    return better, len(pairs), here


def cost_pairs(chapter: Chapter) -> list[tuple[Record, Record]]:
    """Return the plans over the whole trajectory, each with the machine without carriers on the same motion."""
    groups = by_task(chapter["plans"])
    return [(one, groups[one["task"]][NONE]) for one in _optimised(chapter).values() if NONE in groups[one["task"]]]


@claimed(FINDINGS)
def between(chapter: Chapter) -> Judged:
    """What a plan promises at its nodes holds between them."""
    existing, missing = _optimised(chapter), _optimised(chapter, exists=False)
    factors = {name: one["dense_peak"] / one["peak"] for name, one in existing.items()}
    if not factors:
        return NO_CASE
    worst, good = max(factors, key=factors.__getitem__), sum(factor <= BETWEEN for factor in factors.values())
    early = [name for name, one in existing.items() if one["status"] == ResultStatus.NOT_CONVERGED.value]
    here = f"""On a grid 20 times finer than the nodes, and right beside the singular instants, the peak is at most
        {text(BETWEEN)} times that at the nodes in {good} of {len(factors)} plans; at worst {factors[worst]:.3f} times
        ({worst}). {len(early) or "No"} plans stopped before an optimum{f" ({_names(early)})" if early else ""}."""
    return good, len(factors), here + (f" No plan was found for {_names(missing)}." if missing else "")


@claimed(FINDINGS)
def calm(chapter: Chapter) -> Judged:
    """The efforts are calm enough for motors as they are."""
    existing, groups = _optimised(chapter), by_task(chapter["plans"])
    turns = {name: float(one["reversals"]) for name, one in existing.items()}
    if not turns:
        return NO_CASE
    worst, good = max(turns, key=turns.__getitem__), sum(not count > CALM for count in turns.values())
    restless = sorted({existing[name]["task"] for name, count in turns.items() if count > CALM})
    here = f"""In {good} of {len(turns)} plans over the whole trajectory every main effort turns round at most {CALM}
        times; at worst one does {text(turns[worst])} times ({worst}). Restless are plans of
        {", ".join(restless) or "no motion"}; beside a singularity W⁻¹ magnifies every kink of s̈."""
    if smooth := [one for one in existing.values() if one["way"] == cases.SMOOTH]:
        peaks = _ratios([(one, groups[one["task"]][EFFORT]) for one in smooth], "worst")
        here += f""" With a weight of {text(cases.SMOOTHING)} on the rate of the efforts they turn round at most
            {text(max(one["reversals"] for one in smooth))} times on the crossings, with {_factors(peaks)} times the
            peak of the least effort."""
    return good, len(turns), here


@claimed(FINDINGS)
def backends(chapter: Chapter) -> Judged:
    """Both backends lead to the same plan."""
    backends = chapter["backends"]
    if not backends:
        return NO_CASE
    worst, good = max(backends, key=lambda record: float(record["worst"])), sum(one["same"] for one in backends)
    here = f"""{good} of {len(backends)} plans agree to {text(SAME_PLAN)} of the largest value, in status too; the
        largest difference is {_one(worst["worst"])} ({worst["case"]}), and the costs differ by at most
        {_one(max(record["cost"] for record in backends))}."""
    if flat := [one["case"] for one in backends if not one["same"] and one["cost"] <= SAME_PLAN]:
        here += f" Where plans differ and costs do not ({_names(flat)}), the optimum is flat."
    return good, len(backends), here


@claimed(FINDINGS)
def first_guesses(chapter: Chapter) -> Judged:
    """Parked carriers are first guess enough."""
    starts = chapter["first_guesses"]
    if not starts:
        return NO_CASE
    good, tried = sum(record["parked_is_best"] for record in starts), max(len(record["costs"]) for record in starts)
    here = f"""From {tried} first guesses each, parked carriers lead to the best plan known in {good} of {len(starts)}
        cases."""
    several = [record for record in starts if record["optima"] > 1]
    for record in several:
        here += f" {record['case']} has {record['optima']} optima, up to {_two(100 * record['excess'])} % worse."
    if not several:
        here += " No guess led to another optimum, which is no proof that there is none."
    return good, len(starts), here
