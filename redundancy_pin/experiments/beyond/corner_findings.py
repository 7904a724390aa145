"""Findings on corners and square: what the carriers gain over the machine without them, and what that costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from redundancy_pin.experiments.beyond.crossing_findings import Said, times
from redundancy_pin.experiments.beyond.modes import ModeRows
from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.tasks import Task
from redundancy_pin.experiments.beyond.ways import EFFORT, ENERGY, NONE, OBJECTIVES, PEAK, PEAK_FREE, STEPWISE
from redundancy_pin.experiments.planned.conclusions import verdict

_QUANTITIES: tuple[tuple[str, Callable[[Row], float]], ...] = (
    ("peak", lambda row: row.worst),
    ("rms", lambda row: row.rms),
    ("energy of the base motors", lambda row: row.main_energy),
    ("energy of all motors", lambda row: row.energy),
)
"""What the machine without carriers is compared in."""


def corner_finding(rows: Sequence[Row], modes: Sequence[ModeRows], task: Task) -> Said:
    """Say whether the peak is lower than without carriers, where the baseline stays better, and in which modes."""
    ways = {row.way: row for row in rows if row.task == task.name}
    none, step, peak = ways[NONE], ways[STEPWISE], ways[PEAK]
    here = f"The machine without carriers has a peak of {none.worst:.3g} N·m"
    here += f", stepwise planning {step.worst:.3g} N·m" if step.exists else ", stepwise planning no plan"
    if step.exists and not step.sound:
        here += f" ({step.status})"
    for way, aim in ((EFFORT, "effort"), (PEAK, "peak")):
        row = ways[way]
        said = f"{row.worst:.3g} N·m" if row.exists else "no plan"
        here += f", planning over the whole trajectory for least {aim} {said}" + (
            f" ({row.status})" if row.exists and not row.sound else ""
        )
    here += ". "
    for way, aim in ((EFFORT, "effort"), (PEAK, "peak")):
        here += _against(ways[way], none, aim)
    same = [row for row in modes if task.path == "corner" and row.radius == task.radius]
    good = sum(row.lower for row in same) if same else int(peak.sound and peak.worst < none.worst)
    if same:
        factors = [row.ratio for row in same if row.ratio == row.ratio]
        here += f"Over the working modes the least peak is lower in {good} of {len(same)}"
        here += f" ({times(factors)} times that without carriers)." if factors else "."
        here += _beside_stepwise(same)
    claim = f"On the {task.title.partition(', ')[2]} the peak torque is lower than without carriers."
    return claim, here.strip(), verdict(good, len(same) or 1)


def cost_finding(rows: Sequence[Row]) -> Said:
    """Say whether any plan of the whole trajectory needs less energy, carriers included, than no carriers."""
    pairs = [
        (row, next(other for other in rows if other.task == row.task and other.way == NONE))
        for row in rows
        if row.way in OBJECTIVES and row.exists
    ]
    better = [row for row, none in pairs if row.energy < none.energy]
    factors = times([row.energy / none.energy for row, none in pairs])
    here = (
        f"With the carriers' own motors counted, {len(better)} of {len(pairs)} plans need less energy than the machine "
        f"without carriers; they need {factors} times as much, and carrier forces of up to "
        f"{max(row.carrier_force for row, _ in pairs):.3g} N."
    )
    least = [(row, none) for row, none in pairs if row.way == ENERGY]
    if least:
        here += f" Planned for least energy it is {times([row.energy / none.energy for row, none in least])} times,"
        here += f" at {times([row.worst / none.worst for row, none in least])} times the peak torque."
    if not better:
        here += " In energy the machine without the added masses stays better, always."
    return "Moving carriers save energy on corners and square.", here, verdict(len(better), len(pairs))


def _beside_stepwise(same: Sequence[ModeRows]) -> str:
    """Return how often stepwise planning, which brings no carrier back, has the lower peak."""
    lower, free = (
        sum(row.rows[STEPWISE].exists and not row.rows[STEPWISE].worst >= row.rows[way].worst for row in same)
        for way in (PEAK, PEAK_FREE)
    )
    return (
        f" Stepwise planning (λ = 0) has a lower peak than the least peak in {lower} of them: it leaves the carriers "
        f"where they are. With the end free as well it has a lower one in {free}."
    )


def _against(row: Row, none: Row, aim: str) -> str:
    """Return in what a plan is better and worse than the machine without carriers."""
    if not row.exists:
        return ""
    factors = {name: of(row) / of(none) for name, of in _QUANTITIES}
    better = [f"{name} ({factor:.2g} times)" for name, factor in factors.items() if factor < 1.0]
    worse = [f"{name} ({factor:.2g} times)" for name, factor in factors.items() if factor >= 1.0]
    text = f"Planned for least {aim} the carriers win in {', '.join(better) or 'nothing'}; "
    return text + f"without them the machine stays better in {', '.join(worse) or 'nothing'}. "
