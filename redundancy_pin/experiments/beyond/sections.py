"""The chapter as sections of the report."""

from __future__ import annotations

import math

from redundancy_pin.experiments.beyond.bounds_sections import fastest_section, optimality_section, trade_section
from redundancy_pin.experiments.beyond.pictures import pictures
from redundancy_pin.experiments.beyond.rows import SWING, Row
from redundancy_pin.experiments.beyond.study import Beyond
from redundancy_pin.experiments.beyond.tasks import CORNERS, CROSSINGS
from redundancy_pin.experiments.document import Block, Cell, FileLink, Heading, Paragraph, Table, table
from redundancy_pin.experiments.planned.cases import mode_text

SET_UP = (
    "The thesis plans point by point and, at a singularity, with the main motors off. Here its planners stand beside "
    "`plan_whole_trajectory`, which sees the whole motion, keeps the motors on and takes every limit of the carriers "
    "into account. Both have the same motions, with speed ramps of the 3-4-5 shape and length v T / 2, and the same "
    "limits. Carriers start at rest in the middle of their tracks; plans over the whole trajectory bring them back "
    "there unless the end is said to be free. Peaks are given at the samples (nodes) and between them: over the whole "
    "trajectory 20 points a step and closer beside singular instants, by W⁻¹ f of the backend; of switch-off plans "
    "while the motors are on. A status other than `within_limits` marks plans that break a limit, stopped before an "
    "optimum, or do not exist."
)


def chapter(beyond: Beyond) -> list[Block]:
    """Return the chapter."""
    return [
        Heading("Beyond the thesis: planning over the whole trajectory"),
        Paragraph(SET_UP),
        *_findings(beyond),
        *_targets(beyond),
        *_crossings(beyond),
        *fastest_section(beyond),
        *_corners(beyond),
        *_modes(beyond),
        *optimality_section(beyond),
        *trade_section(beyond),
    ]


def _findings(beyond: Beyond) -> list[Block]:
    return [
        Paragraph("What follows, in sentences and verdicts that change with the numbers of this run:"),
        table(("claim", "verdict", "here"), [(row.claim, row.stands, row.here) for row in beyond.findings]),
    ]


def _targets(beyond: Beyond) -> list[Block]:
    rows = [
        (row.task, row.way, f"{row.asked:g} {row.unit}", _number(row.found), _number(row.between), row.said)
        for row in beyond.targets
    ]
    return [
        Heading("What was aimed at", 3),
        table(("motion", "plan", "largest effort aimed at", "at the nodes", "between them", "verdict"), rows),
    ]


def _crossings(beyond: Beyond) -> list[Block]:
    rows = [row for task in CROSSINGS for row in beyond.of(task)]
    return [
        Heading("Through singularities", 3),
        _limits_table(rows),
        *_without_plan(rows),
        _cost_table(rows),
        *pictures(beyond, CROSSINGS),
    ]


def _corners(beyond: Beyond) -> list[Block]:
    rows = [row for task in CORNERS for row in beyond.of(task)]
    return [
        Heading("Corners and square", 3),
        Paragraph(
            "The machine without carriers is the non-redundant one of the thesis, without the added masses. Stepwise "
            "plans are those of the chapters above; on single corners they leave the carriers where they are."
        ),
        _limits_table(rows),
        *_without_plan(rows),
        _cost_table(rows),
        *pictures(beyond, CORNERS),
    ]


def _without_plan(rows: list[Row]) -> list[Block]:
    return [Paragraph(f"No plan for {row.task}, {row.way}: {row.why}") for row in rows if not row.exists]


def _modes(beyond: Beyond) -> list[Block]:
    ways = list(beyond.modes[0].rows)
    rows = [
        (f"{row.radius:g} m", mode_text(row.mode), *(_marked(row.rows[way]) for way in ways), f"{row.ratio:.2f}")
        for row in beyond.modes
    ]
    return [
        Heading("Corners in every working mode", 3),
        Paragraph(
            "Largest |τ| at the samples or between them, N·m; a mark names the status of plans that are unsound."
        ),
        table(("radius", "mode", *ways, "least peak over no carriers"), rows),
        *pictures(beyond, (), modes=True),
    ]


def _limits_table(rows: list[Row]) -> Table:
    cells: list[list[Cell]] = []
    for row in rows:
        before = "" if math.isnan(row.before) else f" ({row.before:.3g} until off)"
        name: Cell = FileLink(row.way, f"{row.file}.npz") if row.file and row.exists else row.way
        cells.append(
            [
                row.task,
                name,
                row.status,
                (_number(row.peak) + before) if row.exists else "none",
                _number(row.dense_peak),
                row.unit,
                _of(row.position, row.track),
                _of(row.speed, row.speed_limit),
                _of(row.acceleration, row.acceleration_limit),
                row.broken or ("none" if row.exists else ""),
            ]
        )
    return table(
        (
            "motion",
            "planner",
            "status",
            "peak at the samples",
            "peak between them",
            "unit",
            "farthest carrier [m], of",
            "fastest [m/s], of",
            "hardest [m/s²], of",
            "limits broken",
        ),
        cells,
    )


def _cost_table(rows: list[Row]) -> Table:
    cells = [
        (
            row.task,
            row.way,
            _number(row.rms),
            _number(row.reversals),
            _number(row.main_energy),
            _number(row.carrier_force),
            _number(row.carrier_energy),
            _number(row.energy),
        )
        for row in rows
        if row.exists
    ]
    return table(
        (
            "motion",
            "planner",
            "rms |τ| [N or N·m]",
            "reversals",
            "energy, main motors [J]",
            "peak carrier force [N]",
            "energy, carriers [J]",
            "energy, all [J]",
        ),
        cells,
        "What it costs. Reversals: how often, at most, a main effort turns round and then moves by more than "
        f"{100.0 * SWING:g} % of the plan's peak. Energy: ∫ Σ |power| dt, what motors that recover nothing draw.",
    )


def _marked(row: Row) -> str:
    if not row.exists:
        return row.status
    return f"{row.worst:.2f}" + ("" if row.sound else f" ({row.status})")


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.3g}"


def _of(value: float, limit: float) -> str:
    return "–" if math.isnan(value) or math.isnan(limit) else f"{value:.3f} of {limit:g}"
