"""What ``redundancy-pin map`` prints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click
from rich.table import Table

from redundancy_pin.cli.output import console, print_json, table_of
from redundancy_pin.experiments.feasibility import Cell, FeasibilityMap, Verdict
from redundancy_pin.experiments.feasibility.pictured import axis_label, effort_unit


def print_map(found: FeasibilityMap, folder: Path, files: Sequence[Path], *, as_json: bool) -> None:
    """Print what a map says on stdout: counts, and the border line by line."""
    if as_json:
        data = {key: value for key, value in found.as_dict().items() if key != "cells"}
        print_json({**data, "folder": str(folder), "files": [str(path) for path in files]})
        return
    screen = console()
    screen.print(_counts(found))
    screen.print(_border(found))
    screen.print(f"Tables and pictures are in {folder}: {', '.join(path.name for path in files)}.")


def warn_of_failures(found: FeasibilityMap) -> None:
    """Say on stderr in how many cells nothing is known, and why in the first."""
    for planner in found.problem.planners:
        failed = [cell for cell in found.of(planner) if cell.verdict is Verdict.FAILED]
        if failed:
            first = failed[0]
            x, y = found.problem.x.name, found.problem.y.name
            click.echo(
                f"warning: {planner} failed in {len(failed)} cell(s), in the first ({x} {first.x:g}, {y} {first.y:g}) "
                f"with: {' '.join(first.message.split())}",
                err=True,
            )


def _counts(found: FeasibilityMap) -> Table:
    rows = []
    for planner in found.problem.planners:
        counts = found.counts(planner)
        why = ", ".join(f"{limit} {count}" for limit, count in found.in_the_way(planner).items())
        seconds = sum(cell.seconds for cell in found.of(planner))
        numbers = [str(counts[verdict.value]) for verdict in (Verdict.FEASIBLE, Verdict.STOPPED_EARLY)]
        last = (str(counts[Verdict.INFEASIBLE.value]), why, str(counts[Verdict.FAILED.value]), f"{seconds:.1f}")
        rows.append((planner, *numbers, *last))
    headings = ("planner", "possible", "stopped early", "not possible", "in the way", "failed", "time [s]")
    return table_of(f"{found.problem.robot}, {found.problem.trajectory}: cells", headings, rows)


def _border(found: FeasibilityMap) -> Table:
    problem = found.problem
    along, across = (problem.x, problem.y) if found.along == "x" else (problem.y, problem.x)
    unit = effort_unit(problem)
    table = Table(title=f"border: {axis_label(along.name, unit)} between a cell that is possible and one that is not")
    table.add_column(axis_label(across.name, unit), justify="right")
    for planner in problem.planners:
        table.add_column(planner)
    lines = {planner: found.lines(planner) for planner in problem.planners}
    borders = {planner: found.border(planner) for planner in problem.planners}
    for value in across.values:
        row = []
        for planner in problem.planners:
            met = [crossing for crossing in borders[planner] if crossing.line == value]
            said = "; ".join(f"{crossing.low:.4g} … {crossing.high:.4g}" for crossing in met)
            row.append(said or _without_border(lines[planner][value]))
        table.add_row(f"{value:g}", *row)
    return table


def _without_border(cells: Sequence[Cell]) -> str:
    known = {cell.possible for cell in cells}
    return "all possible" if known == {True} else "none possible" if known == {False} else "not known"
