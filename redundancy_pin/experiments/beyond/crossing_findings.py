"""Findings on the crossings: claim, what this run says, verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence

from redundancy_pin.experiments.beyond.fastest import UNDECIDED, Fastest
from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.ways import EFFORT, LATE, PEAK, SWITCH_OFF, SWITCH_OFF_LATE
from redundancy_pin.experiments.planned.conclusions import verdict

THESIS_SPEED = 0.75
"""Fastest circle of the thesis, m/s."""

Said = tuple[str, str, str]


def times(values: Sequence[float]) -> str:
    """Return a range of factors as text."""
    low, high = min(values), max(values)
    return f"{low:.2g}" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g}"


def crossing_finding(rows: Sequence[Row]) -> Said:
    """Say on how many motions each planner stays within the limits."""
    groups = _by_task(rows)
    sound = [task for task, ways in groups.items() if ways[EFFORT].sound and ways[PEAK].sound]
    offs = {task: ways[SWITCH_OFF] for task, ways in groups.items()}
    kept = [task for task, row in offs.items() if row.sound]
    broken = [task for task, row in offs.items() if row.exists and not row.sound]
    none = [task for task, row in offs.items() if not row.exists]
    here = (
        f"Over the whole trajectory {len(sound)} of {len(groups)} motions have plans within every limit, with both "
        f"objectives. Switching off keeps the limits on {_named(kept)}, breaks them on {_named(broken)}, and has no "
        f"plan for {_named(none)}."
    )
    late = [task for task, ways in groups.items() if SWITCH_OFF_LATE in ways and ways[SWITCH_OFF_LATE].sound]
    if saved := [task for task in late if task in broken]:
        forces = ", ".join(f"{groups[task][SWITCH_OFF_LATE].worst:.3g} {offs[task].unit}" for task in saved)
        here += (
            f" Switching off only beyond a condition number of {LATE:g} keeps the limits on {_named(saved)} too, with "
            f"a largest main force of {forces}."
        )
    pairs = [(ways[EFFORT], ways[SWITCH_OFF]) for ways in groups.values() if ways[EFFORT].exists and
             ways[SWITCH_OFF].exists]  # fmt: skip
    if pairs:
        before = [whole.worst / off.before for whole, off in pairs if not math.isnan(off.before)]
        here += (
            f" Where both have one, the plan of least effort has {times([a.worst / b.worst for a, b in pairs])} times "
            f"the largest main force of switching off (which it reaches as the carriers return)"
        )
        here += f", and {times(before)} times the largest until the motors are off." if before else "."
    return (
        "Singularities can be crossed with the main motors on and every limit kept.", here,
        verdict(len(sound), len(groups)),
    )  # fmt: skip


def heavy_finding(rows: Sequence[Row]) -> Said:
    """Say whether motions without a switch-off plan have one over the whole trajectory."""
    groups = {task: ways for task, ways in _by_task(rows).items() if not ways[SWITCH_OFF].exists}
    parts = []
    for task, ways in groups.items():
        off, least, peak = ways[SWITCH_OFF], ways[EFFORT], ways[PEAK]
        left = f" ({off.missing:.3g} N that nothing can carry)" if not math.isnan(off.missing) else ""
        plan = f"{least.worst:.3g} {off.unit} for the least effort" if least.sound else f"{least.status}, {least.why}"
        plan += f", {peak.worst:.3g} {off.unit} for the least peak" if peak.sound else f"; {peak.status}, {peak.why}"
        parts.append(f"{task}{left}: {plan}")
    good = sum(ways[EFFORT].sound and ways[PEAK].sound for ways in groups.values())
    here = (
        f"Of {len(groups)} motions that cannot be crossed with the motors off, {good} have plans within the limits "
        f"with largest main efforts of: {'; '.join(parts)}."
        if groups
        else "Every motion here has a plan with the motors off."
    )
    claim = "Machines with masses, for which switching off has no solution, can cross too."
    return claim, here, verdict(good, len(groups)) if groups else "does not stand"


def speed_finding(races: Sequence[Fastest]) -> Said:
    """Say how fast the motions can be, and how sure that is."""
    circles = [race for race in races if race.task.startswith("circle") and math.isinf(race.effort)]
    good = [race for race in circles if race.slower.speed > THESIS_SPEED]
    here = " ".join(bracket(race) for race in races)
    local = [race for race in races if race.faster is not None]
    if local:
        here += (
            " The problem is not convex, so that the upper ends are verdicts of the solver, from "
            f"{max(race.starts for race in local)} first guesses with two objectives each, not proofs."
        )
    claim = f"The circle can be crossed faster than at the thesis's {THESIS_SPEED:g} m/s within the limits."
    return claim, here, verdict(len(good), len(circles))


def bracket(race: Fastest) -> str:
    """Return a bracket in a sentence."""
    capped = "" if math.isinf(race.effort) else f" with main forces up to {race.effort:.3g} {race.unit}"
    slower, faster = race.slower, race.faster
    text = f"{race.title.rpartition(' at ')[0]}{capped}: a plan at {slower.speed:.3f} m/s"
    text += f" (peak {slower.peak:.3g} {race.unit}, between the nodes included)"
    if faster is None:
        return text + ", the fastest tried before the ramps no longer fit in."
    if faster.constraint == UNDECIDED:
        return text + f", no verdict in time at {faster.speed:.3f} m/s."
    text += f", none found at {faster.speed:.3f} m/s"
    if faster.constraint:
        text += f", where the {faster.constraint} of {faster.carrier or 'a carrier'} is in the way"
        if not math.isnan(faster.limit):
            text += f" ({abs(faster.limit):.4g} {faster.unit} would suffice"
            text += {True: ", and does", False: ", but no plan was found with it", None: ""}[race.suffices] + ")"
    return text + "."


def _by_task(rows: Sequence[Row]) -> dict[str, dict[str, Row]]:
    groups: dict[str, dict[str, Row]] = {}
    for row in rows:
        groups.setdefault(row.task, {})[row.way] = row
    return groups


def _named(tasks: Sequence[str]) -> str:
    return ", ".join(tasks) if tasks else "none"
