"""``redundancy-pin study``: how well plans and controllers stand up to machines that are not quite as planned."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from redundancy_pin.cli.options import json_option
from redundancy_pin.cli.output import console, print_json, progress, table_of
from redundancy_pin.experiments.document import Heading, Paragraph
from redundancy_pin.experiments.markdown import markdown
from redundancy_pin.experiments.robustness import DRAWS, Study, robustness_study, study_csv, study_table
from redundancy_pin.io.files import write_text

JOURNAL = "journal.jsonl"

_SHOWN = (0, 1, 3, 4, 5, 9)
"""Columns of the table that fit a terminal side by side; all of them are in study.md."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


@click.command()
@click.option("--draws", default=DRAWS, show_default=True, metavar="N", help="Machines drawn for each cell.")
@click.option("--seed", default=0, show_default=True, metavar="N", help="Of the draws.")
@click.option("--severity", default=1.0, show_default=True, metavar="X", help="Factor on errors, friction and noise.")
@click.option("--jobs", type=int, default=None, metavar="N", help="Processes; all cores when left out.")
@click.option("--out", default="study", show_default=True, metavar="FOLDER", help="Where journal and tables go.")
@json_option
def study(draws: int, seed: int, severity: float, jobs: int | None, out: str, as_json: bool) -> None:
    r"""Drive imperfect machines through singularities, many times.

    Masses, lengths, starts, friction, encoders and force noise are drawn at random; planned crossings are driven open
    loop, by computed torque and by LQR, digital and with a delay. Finished trials are in the journal: the same command
    goes on where it was interrupted, and with more draws adds to it.

    \b
    Example:
      redundancy-pin study --draws 200 --out study
    """
    folder = Path(out).expanduser()
    done = [0, 0]
    try:
        with progress("study") as advance:

            def tell(count: int, total: int, what: str) -> None:
                done[:] = count, total
                advance(count, total, what)

            found = robustness_study(
                draws, seed=seed, severity=severity, jobs=jobs, journal=folder / JOURNAL, progress=tell
            )
    except KeyboardInterrupt:
        said = f"{done[0]} of {done[1]} trials are in {folder / JOURNAL}; the same command goes on from there."
        click.echo(f"interrupted: {said}", err=True)
        raise click.exceptions.Exit(INTERRUPTED) from None
    text = markdown([Heading("Robustness", 1), Paragraph(_said(found, severity)), study_table(found)])
    write_text(folder / "study.md", text)
    write_text(folder / "trials.csv", study_csv(found))
    data = summary(found, severity)
    write_text(folder / "summary.json", json.dumps(data, indent=2, allow_nan=False) + "\n")
    if as_json:
        print_json(data)
        return
    shown = study_table(found)
    console().print(_said(found, severity))
    rows = [[str(row[column]) for column in _SHOWN] for row in shown.rows]
    console().print(table_of("robustness", [shown.headings[column] for column in _SHOWN], rows))
    console().print(shown.caption)
    console().print(f"Tables and journal are in {folder}: study.md, trials.csv, summary.json, {JOURNAL}.")


def summary(found: Study, severity: float) -> dict[str, Any]:
    """Return a study as plain data."""
    return {
        "seed": found.seed,
        "severity": severity,
        "imperfections": asdict(found.imperfections),
        "cells": [_plain(asdict(cell)) for cell in found.cells],
    }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    return None if isinstance(value, float) and value != value else value


def _said(found: Study, severity: float) -> str:
    draws = found.cells[0].draws
    return f"Seed {found.seed}, severity {severity:g}, {draws} {'draw' if draws == 1 else 'draws'} a cell."
