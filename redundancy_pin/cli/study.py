"""``redundancy-pin study``: how well plans and controllers stand up to machines that are not quite as planned."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

from redundancy_pin.cli.options import json_option, scheduler_option
from redundancy_pin.cli.output import report, resumable
from redundancy_pin.io.files import expanded, write_text
from redundancy_pin.studies.robustness import DRAWS, robustness_study, study_caption, study_csv, study_table
from redundancy_pin.studies.store import FILE
from redundancy_pin.studies.table import json_data
from redundancy_pin.workers import cluster

# columns of the table that fit a terminal side by side; all of them are in study.md
_SHOWN = ("scenario", "drive", "success", "largest", "worst", "statuses")


@click.command()
@click.option("--draws", default=DRAWS, show_default=True, metavar="N", help="Machines drawn for each cell.")
@click.option("--seed", default=0, show_default=True, metavar="N", help="Of the draws.")
@click.option("--severity", default=1.0, show_default=True, metavar="X", help="Factor on errors, friction and noise.")
@click.option("--jobs", type=int, default=None, metavar="N", help="Processes; all cores when left out.")
@scheduler_option
@click.option("--out", default="study", show_default=True, metavar="FOLDER", help="Where store and tables go.")
@json_option
def study(
    draws: int, seed: int, severity: float, jobs: int | None, scheduler: str | None, out: str, as_json: bool
) -> None:
    r"""Drive imperfect machines through singularities, many times.

    Masses, lengths, starts, friction, encoders and force noise are drawn at random; planned crossings are driven open
    loop, by computed torque and by LQR, digital and with a delay. Finished trials are in FOLDER/store.sqlite: the same
    command goes on where it was interrupted, and with more draws adds to it.

    \b
    Example:
      redundancy-pin study --draws 200 --out study
    """
    folder = expanded(out)
    with cluster(scheduler), resumable("study", "trials", folder / FILE) as advance:
        result = robustness_study(
            draws, seed=seed, severity=severity, jobs=jobs, journal=folder / FILE, progress=advance
        )
    extent = f"Seed {seed}, severity {severity:g}, {draws} {'draw' if draws == 1 else 'draws'} a cell."
    table, caption = study_table(result), study_caption(result)
    write_text(folder / "study.md", f"# Robustness\n\n{extent}\n\n{caption}\n\n{table.markdown()}\n")
    write_text(folder / "trials.csv", study_csv(result))
    summary = {
        "seed": seed,
        "severity": severity,
        "imperfections": asdict(result.imperfections),
        "cells": [asdict(cell) for cell in result.cells],
    }
    write_text(folder / "summary.json", json.dumps(json_data(summary), indent=2, allow_nan=False) + "\n")
    files = f"Tables and store are in {folder}: study.md, trials.csv, summary.json, {FILE}."
    report(as_json, summary, extent, table.only(*_SHOWN), caption, files)
