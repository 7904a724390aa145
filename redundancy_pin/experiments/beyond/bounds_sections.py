"""Sections on how fast, how sure and at what price: brackets, backends, first guesses, trade-off."""

from __future__ import annotations

import math

from redundancy_pin.experiments.beyond.crossing_findings import bracket
from redundancy_pin.experiments.beyond.fastest import Fastest, Trial
from redundancy_pin.experiments.beyond.optimality import SAME_COST, SAME_PLAN
from redundancy_pin.experiments.beyond.study import Beyond
from redundancy_pin.experiments.document import Block, Bullets, Heading, Paragraph, Picture, table

FASTEST_FIGURE = "beyond-fastest"
TRADE_FIGURE = "beyond-trade-off"


def fastest_section(beyond: Beyond) -> list[Block]:
    """Return the section on the fastest motions."""
    rows = [
        (
            race.task.rpartition("-")[0],
            "none" if math.isinf(race.effort) else f"{race.effort:.3g} {race.unit}",
            f"{race.slower.speed:.3f}" + _mark(race.slower),
            f"{race.slower.peak:.3g} {race.unit}",
            ", ".join(race.slower.binding) or "none at the nodes",
            "none tried" if race.faster is None else f"{race.faster.speed:.3f}",
            _verdict(race),
            {True: "yes", False: "no", None: "–"}[race.suffices],
        )
        for race in beyond.fastest
    ]
    return [
        Heading("As fast as the limits allow", 3),
        Paragraph(
            "Bisection on the cruising speed, ramps as before. A speed is out of reach if the planner finds no plan; "
            "at the upper end of the bracket it has tried parked carriers and random swings as first guesses, for the "
            "least effort and for the least acceleration of the carriers. As the problem is not convex this is a "
            "verdict about what was found, not a proof. What would suffice is the planner's own answer (all limits of "
            "a kind let out by the same fraction); the last column says whether a plan exists with 1 % more than that."
        ),
        table(
            (
                "motion",
                "limit of main forces",
                "fastest with a plan [m/s]",
                "its peak force",
                "limits it touches",
                "slowest without [m/s]",
                "why there is none",
                "does it suffice?",
            ),
            rows,
        ),
        Bullets(tuple(bracket(race) for race in beyond.fastest)),
        Picture(
            f"{FASTEST_FIGURE}.png",
            "Largest main force of the plans of least effort over speed: every speed tried that has a plan (dots), and "
            "those without (crosses, on the lower edge). Towards the fastest motion the force grows without measure: "
            "the carriers have no freedom left to relieve the motors.",
        ),
    ]


def optimality_section(beyond: Beyond) -> list[Block]:
    """Return the section on backends and first guesses."""
    plans = [
        (
            row.case,
            *(f"{value:.1e}" for value in (row.position, row.speed, row.acceleration, row.tau, row.carrier_force)),
            f"{row.cost:.1e}",
            row.statuses[0] if row.statuses[0] == row.statuses[1] else " and ".join(row.statuses),
            "same" if row.same else "differs",
        )
        for row in beyond.backends
    ]
    guesses = [
        (
            row.case,
            f"{1e3 * row.step:g} ms",
            str(len(row.costs)),
            str(sum(math.isnan(cost) for cost in row.costs)),
            f"{min(row.reached):.6g}" if row.reached else "–",
            f"{row.excess:.1e}" if row.reached else "–",
            str(row.optima),
            "yes" if row.parked_is_best else "no",
        )
        for row in beyond.starts
    ]
    return [
        Heading("How sure the plans are", 3),
        Paragraph(
            "The same plans by virtual work and by RNEA: largest differences over the largest value along the plan. "
            f"Up to {SAME_PLAN:g} they count as the same. The five-bar has one backend only."
        ),
        table(("plan", "s", "ṡ", "s̈", "τ", "carrier force", "cost", "status", "verdict"), plans),
        Paragraph(
            "Plans from several first guesses: parked carriers, then random swings (seeded). Costs are scaled; optima "
            f"whose costs differ by less than {SAME_COST:g} (relative) count as one."
        ),
        table(
            (
                "plan",
                "largest step",
                "guesses",
                "without a plan",
                "best cost",
                "worst above best",
                "optima",
                "parked carriers lead to the best known",
            ),
            guesses,
        ),
    ]


def trade_section(beyond: Beyond) -> list[Block]:
    """Return the section on effort against acceleration."""
    rows = [
        (
            found.task,
            f"{point.ratio:g}",
            f"{point.weight:.3g}",
            f"{point.rms_effort:.4g} {found.unit}",
            f"{point.rms_acceleration:.4g}",
            f"{point.peak:.4g} {found.unit}",
            point.status,
        )
        for found in beyond.trades
        for point in found.points
    ]
    said = [
        f"{found.task}: effort rises and acceleration falls with every step of the weight."
        if found.monotone
        else f"{found.task}: effort or acceleration moves the wrong way somewhere, so not every point is optimal."
        for found in beyond.trades
    ]
    return [
        Heading("Effort against the carriers' acceleration", 3),
        Paragraph(
            "Cost ∫ Σ τ² dt + w ∫ Σ s̈² dt. The first column is w over the weight at which both parts would be the same "
            "for the plan of least effort."
        ),
        Picture(
            f"{TRADE_FIGURE}.png",
            "Trade-off between the main motors' effort and the carriers' acceleration: each point is the optimum for "
            "one weight.",
        ),
        table(("motion", "weight", "w", "rms |τ|", "rms s̈ [m/s²]", "peak |τ|", "status"), rows),
        Bullets(tuple(said)),
    ]


def _mark(trial: Trial) -> str:
    return "" if trial.status == "within_limits" else f" ({trial.status})"


def _verdict(race: Fastest) -> str:
    if race.faster is None:
        return "the ramps have no room for faster motions"
    return race.faster.said or race.faster.status
