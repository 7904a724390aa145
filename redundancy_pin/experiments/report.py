"""The results in words: tables for the terminal, and the blocks of the report."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table as TerminalTable

from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.experiments.beyond.sections import chapter
from redundancy_pin.experiments.beyond.study import Beyond
from redundancy_pin.experiments.document import (
    Block,
    Bullets,
    Cell,
    FileLink,
    Heading,
    Paragraph,
    Picture,
    Table,
    table,
)
from redundancy_pin.experiments.planned.sections import figures, findings
from redundancy_pin.experiments.planned.study import Study
from redundancy_pin.experiments.replay.sections import chapter as replay_chapter
from redundancy_pin.experiments.replay.study import Replays
from redundancy_pin.experiments.result import Result
from redundancy_pin.experiments.stated import Compared
from redundancy_pin.experiments.summary import NOTES, numbers, versions


def terminal_table(results: Sequence[Result]) -> TerminalTable:
    """Return the results as a table, one row an experiment."""
    found = TerminalTable(title="experiments: Pinocchio (RNEA) against virtual work")
    found.add_column("experiment")
    found.add_column("samples", justify="right")
    found.add_column("parity", justify="right")
    found.add_column("smallest margin", justify="right")
    found.add_column("efforts")
    for result in results:
        found.add_row(
            result.experiment.name,
            str(len(result.motion)),
            f"{result.parity.worst:.1e}",
            f"{result.rnea.distribution.margin.min():.3g}",
            result.statement,
        )
    return found


def thesis_table(compared: Sequence[Compared]) -> TerminalTable:
    """Return the statements of the thesis beside our numbers as a table."""
    found = TerminalTable(title="what the thesis states (Parsa 2014), and what comes out here")
    for heading in ("where", "experiment", "quantity"):
        found.add_column(heading)
    for heading in ("stated", "computed"):
        found.add_column(heading, justify="right")
    found.add_column("unit")
    for row in compared:
        stated = row.stated
        found.add_row(
            stated.source, stated.experiment, stated.quantity, numbers(stated.values), numbers(row.ours), stated.unit
        )
    return found


def judged_table(study: Study) -> TerminalTable:
    """Return the verdicts of the planned experiments as a table."""
    found = TerminalTable(title="planned experiments against the thesis (Parsa 2014)")
    for heading in ("where", "quantity", "stated", "ours", "verdict"):
        found.add_column(heading)
    for row in study.judged:
        found.add_row(row.source, row.quantity, row.stated, row.ours, row.said)
    return found


def findings_table(beyond: Beyond) -> TerminalTable:
    """Return what follows from the chapter beyond the thesis as a table."""
    found = TerminalTable(title="beyond the thesis: planning over the whole trajectory")
    for heading in ("claim", "verdict", "here"):
        found.add_column(heading)
    for row in beyond.findings:
        found.add_row(row.claim, row.stands, row.here)
    return found


def report(
    results: Sequence[Result],
    check: CrossCheckReport,
    compared: Sequence[Compared],
    study: Study | None = None,
    beyond: Beyond | None = None,
    replays: Replays | None = None,
) -> list[Block]:
    """Return the report as blocks, to be written as Markdown or HTML.

    Args:
        results: of the motions without a planner.
        check: the cross-check.
        compared: statements about these motions.
        study: the planned experiments; None if they were not run.
        beyond: the chapter beyond the thesis; None if it was not run.
        replays: the chapter on replays; None if it was not run.
    """
    return [
        Heading("Results: internal redundancy in parallel manipulators", 1),
        Paragraph(
            "The experiments of S. S. Parsa's thesis (University of New Brunswick, 2014) repeated. Every number comes "
            "from this run but for those in columns named 'stated'."
        ),
        Paragraph("Made with " + ", ".join(f"{name} {version}" for name, version in versions().items()) + "."),
        *(findings(study) if study else ()),
        *(chapter(beyond) if beyond else ()),
        *(replay_chapter(replays) if replays else ()),
        Heading("Cross-check of the backends on random states"),
        _cross_check(check),
        Heading("Motions without a planner"),
        Bullets(NOTES),
        _experiments(results),
        Heading("Motions without a planner, against the thesis"),
        Paragraph("Stated values are those in the text of Parsa 2014; computed ones come from this run."),
        _thesis(compared),
        *(figures(study) if study else ()),
        Heading("Figures of the motions without a planner"),
        *(block for result in results for block in _figures(result)),
        *_comparisons(results),
    ]


def _cross_check(check: CrossCheckReport) -> Table:
    rows = [
        [
            row.robot,
            row.check,
            str(row.samples),
            f"{row.worst:.1e}",
            f"{row.tolerance:.0e}",
            "ok" if row.passed else "FAILED",
        ]
        for row in check.rows
    ]
    return table(["robot", "check", "states", "worst", "allowed", ""], rows)


def _experiments(results: Sequence[Result]) -> Table:
    rows: list[list[Cell]] = [
        [
            FileLink(result.experiment.name, f"{result.experiment.name}.csv"),
            f"{result.trajectory.duration:.3f}",
            f"{result.parity.worst:.1e}",
            ", ".join(f"{name} {count}" for name, count in result.status_counts.items()),
            result.statement,
        ]
        for result in results
    ]
    return table(["experiment", "time [s]", "parity of the backends", "samples by status", "efforts"], rows)


def _thesis(compared: Sequence[Compared]) -> Table:
    rows = [
        [
            row.stated.source,
            row.stated.experiment,
            row.stated.quantity,
            f"{numbers(row.stated.values)} {row.stated.unit}",
            f"{numbers(row.ours)} {row.stated.unit}",
            row.stated.note,
        ]
        for row in compared
    ]
    return table(["where", "experiment", "quantity", "stated", "computed", "remark"], rows)


def _figures(result: Result) -> tuple[Block, ...]:
    name, title = result.experiment.name, result.experiment.title
    return (
        Heading(title, 3),
        Picture(f"{name}-efforts.png", f"Efforts of run {name} by both backends: {result.statement}."),
        Picture(f"{name}-path.png", f"Mechanism, path and condition number of run {name}."),
    )


def _comparisons(results: Sequence[Result]) -> list[Block]:
    names = [result.experiment.motion_name for result in results]
    return [
        Picture(f"{name}-comparison.png", f"{name}: efforts with parked carriers and without carriers.")
        for name in dict.fromkeys(name for name in names if names.count(name) > 1)
    ]
