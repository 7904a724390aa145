"""The results in words: a table for the terminal and ``report.md``."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.experiments.result import Result
from redundancy_pin.experiments.stated import Compared
from redundancy_pin.experiments.summary import NOTES, numbers, versions


def terminal_table(results: Sequence[Result]) -> Table:
    """Return the results as a table, one row an experiment."""
    table = Table(title="experiments: Pinocchio (RNEA) against virtual work")
    table.add_column("experiment")
    table.add_column("samples", justify="right")
    table.add_column("parity", justify="right")
    table.add_column("smallest margin", justify="right")
    table.add_column("efforts")
    for result in results:
        table.add_row(
            result.experiment.name,
            str(len(result.motion)),
            f"{result.parity.worst:.1e}",
            f"{result.rnea.distribution.margin.min():.3g}",
            result.statement,
        )
    return table


def thesis_table(compared: Sequence[Compared]) -> Table:
    """Return the statements of the thesis beside our numbers as a table."""
    table = Table(title="what the thesis states (Parsa 2014), and what comes out here")
    for heading in ("where", "experiment", "quantity"):
        table.add_column(heading)
    for heading in ("stated", "computed"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for row in compared:
        stated = row.stated
        table.add_row(
            stated.source, stated.experiment, stated.quantity, numbers(stated.values), numbers(row.ours), stated.unit
        )
    return table


def report(results: Sequence[Result], check: CrossCheckReport, compared: Sequence[Compared]) -> str:
    """Return the report as Markdown."""
    parts = [
        "# Results",
        _versions(),
        "## Cross-check",
        _cross_check(check),
        "## Experiments",
        "\n".join(f"- {note}" for note in NOTES),
        _experiments(results),
        "## Against the thesis",
        "Stated values are those in the text of Parsa 2014; computed ones come from this run.",
        _thesis(compared),
        "## Figures",
        *(_figures(result) for result in results),
        *_comparisons(results),
    ]
    return "\n\n".join(parts) + "\n"


def _versions() -> str:
    return "Made with " + ", ".join(f"{name} {version}" for name, version in versions().items()) + "."


def _cross_check(check: CrossCheckReport) -> str:
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
    return _table(["robot", "check", "states", "worst", "allowed", ""], rows)


def _experiments(results: Sequence[Result]) -> str:
    rows = [
        [
            f"[{result.experiment.name}]({result.experiment.name}.csv)",
            f"{result.trajectory.duration:.3f}",
            f"{result.parity.worst:.1e}",
            ", ".join(f"{name} {count}" for name, count in result.status_counts.items()),
            result.statement,
        ]
        for result in results
    ]
    return _table(["experiment", "time [s]", "parity of the backends", "samples by status", "efforts"], rows)


def _thesis(compared: Sequence[Compared]) -> str:
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
    return _table(["where", "experiment", "quantity", "stated", "computed", "remark"], rows)


def _figures(result: Result) -> str:
    name = result.experiment.name
    lines = [f"### {result.experiment.title}", f"![efforts]({name}-efforts.png)", f"![path]({name}-path.png)"]
    return "\n\n".join(lines)


def _comparisons(results: Sequence[Result]) -> list[str]:
    names = [result.experiment.motion_name for result in results]
    compared = dict.fromkeys(name for name in names if names.count(name) > 1)
    return [f"### {name}: with and without carriers\n\n![comparison]({name}-comparison.png)" for name in compared]


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
