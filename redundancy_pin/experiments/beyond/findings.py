"""What follows from the chapter, in sentences made from its numbers: they change with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from redundancy_pin.experiments.beyond.corner_findings import corner_finding, cost_finding
from redundancy_pin.experiments.beyond.crossing_findings import crossing_finding, heavy_finding, speed_finding, times
from redundancy_pin.experiments.beyond.fastest import Fastest
from redundancy_pin.experiments.beyond.modes import ModeRows
from redundancy_pin.experiments.beyond.optimality import SAME_PLAN, BackendRow, StartsRow
from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.targets import BETWEEN
from redundancy_pin.experiments.beyond.tasks import CORNERS, CROSSINGS
from redundancy_pin.experiments.beyond.ways import EFFORT, OBJECTIVES, SMOOTH, SMOOTHING
from redundancy_pin.experiments.planned.conclusions import verdict


@dataclass(frozen=True)
class Finding:
    """A claim about the whole-trajectory planner and what this run says of it.

    Attributes:
        claim: the claim.
        here: what this run says.
        stands: "stands", "stands with conditions" or "does not stand".
    """

    claim: str
    here: str
    stands: str

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return dict(vars(self))


def findings(
    rows: Sequence[Row],
    races: Sequence[Fastest],
    modes: Sequence[ModeRows],
    backends: Sequence[BackendRow],
    starts: Sequence[StartsRow],
) -> tuple[Finding, ...]:
    """Return every claim with what becomes of it."""
    crossings, corners = ([row for row in rows if row.task in {task.name for task in group}] for group in
                          (CROSSINGS, CORNERS))  # fmt: skip
    return (
        Finding(*crossing_finding(crossings)),
        Finding(*heavy_finding(crossings)),
        Finding(*speed_finding(races)),
        *(Finding(*corner_finding(corners, modes, task)) for task in CORNERS),
        Finding(*cost_finding(corners)),
        _between(rows),
        _calm(rows),
        _backends(backends),
        _starts(starts),
    )


def _between(rows: Sequence[Row]) -> Finding:
    found = [row for row in rows if row.way in OBJECTIVES and row.exists]
    ratios = {f"{row.task} ({row.way})": row.dense_peak / row.peak for row in found}
    good = [name for name, ratio in ratios.items() if ratio <= BETWEEN]
    worst = max(ratios, key=lambda name: ratios[name])
    early = [row for row in found if row.status == "stopped_early"]
    none = [row for row in rows if row.way in OBJECTIVES and not row.exists]
    here = (
        f"On a grid 20 times finer than the nodes, and right beside the singular instants, the peak is at most "
        f"{BETWEEN:g} times that at the nodes in {len(good)} of {len(ratios)} plans; at worst it is "
        f"{ratios[worst]:.3f} times as large ({worst})."
    )
    here += f" {len(early)} plans stopped before an optimum." if early else " No plan stopped before an optimum."
    if none:
        here += " No plan was found for " + ", ".join(f"{row.task} ({row.way})" for row in none) + "."
    return Finding("What a plan promises at its nodes holds between them.", here, verdict(len(good), len(ratios)))


CALM = 10
"""Reversals of an effort up to which it counts as calm: a few for each ramp, corner and crossing of the motion."""


def _calm(rows: Sequence[Row]) -> Finding:
    found = [row for row in rows if row.way in OBJECTIVES and row.exists]
    calm = [row for row in found if row.reversals <= CALM]
    worst = max(found, key=lambda row: row.reversals)
    here = (
        f"In {len(calm)} of {len(found)} plans over the whole trajectory every main effort turns round at most {CALM} "
        f"times; at worst one does {worst.reversals:.0f} times ({worst.task}, {worst.way})."
    )
    restless = sorted({row.task for row in found if row not in calm})
    crossing = {task.name for task in CROSSINGS}
    if restless:
        here += f" Restless plans are those of {', '.join(restless)}."
        if crossed := [task for task in restless if task in crossing]:
            here += (
                f" Of these, {', '.join(crossed)} cross a singularity: beside it W⁻¹ magnifies every kink of s̈, and "
                "within their limits efforts may swing from node to node. Peaks hold, but it asks much of a motor."
            )
    if smooth := [row for row in found if row.way == SMOOTH]:
        least = {row.task: row for row in found if row.way == EFFORT}
        peaks = [row.worst / least[row.task].worst for row in smooth if row.task in least]
        here += (
            f" With a weight of {SMOOTHING:g} on the rate of the efforts they turn round at most "
            f"{max(row.reversals for row in smooth):.0f} times on the {len(smooth)} crossings"
        )
        here += f", with {times(peaks)} times the peak of the least effort." if peaks else "."
    return Finding("The efforts are calm enough for motors as they are.", here, verdict(len(calm), len(found)))


def _backends(backends: Sequence[BackendRow]) -> Finding:
    same = [row for row in backends if row.same]
    worst = max(backends, key=lambda row: row.worst)
    here = (
        f"{len(same)} of {len(backends)} plans agree to {SAME_PLAN:g} of the largest value, in status too; the largest "
        f"difference is {worst.worst:.1e} ({worst.case}), and the costs differ by at most "
        f"{max(row.cost for row in backends):.1e}."
    )
    apart = [row for row in backends if not row.same and row.cost <= SAME_PLAN]
    if apart:
        listed = ", ".join(row.case for row in apart)
        here += f" Where plans differ and costs do not ({listed}), the optimum is flat: other plans are as good."
    return Finding("Both backends lead to the same plan.", here, verdict(len(same), len(backends)))


def _starts(starts: Sequence[StartsRow]) -> Finding:
    best = [row for row in starts if row.parked_is_best]
    several = [row for row in starts if row.optima > 1]
    tried = max(len(row.costs) for row in starts)
    here = (
        f"From {tried} first guesses each, parked carriers lead to the best plan known in {len(best)} of "
        f"{len(starts)} cases."
    )
    if several:
        listed = ", ".join(f"{row.case} ({row.optima}, up to {100.0 * row.excess:.2g} % worse)" for row in several)
        here += f" Other optima were met in {listed}."
    else:
        here += " No guess led to another optimum, which is no proof that there is none."
    return Finding("Parked carriers are first guess enough.", here, verdict(len(best), len(starts)))
