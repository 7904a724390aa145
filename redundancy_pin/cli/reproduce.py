"""``redundancy-pin reproduce``: the experiments of the thesis, as tables, pictures and a report."""

from __future__ import annotations

import click

from redundancy_pin.cli.options import json_option
from redundancy_pin.cli.output import progress, report
from redundancy_pin.studies.reproduce import reproduce as run_job
from redundancy_pin.studies.reproduce import tables

_SHOWN = {
    "motions": ("name", "samples", "parity", "smallest_margin", "statement"),
    "thesis": ("source", "experiment", "quantity", "stated", "computed", "unit"),
    "judged": ("source", "quantity", "stated", "ours", "verdict"),
    "conclusions": ("claim", "stands", "here"),
    "findings": ("claim", "stands", "here"),
    "study": ("scenario", "drive", "success", "largest", "worst", "statuses"),
}
"""By table, the columns that fit a terminal side by side; the files have all of them."""


@click.command()
@click.option("--out", default="results", show_default=True, metavar="FOLDER", help="Where the results go.")
@json_option
def reproduce(out: str, as_json: bool) -> None:
    r"""Run the experiments of the thesis.

    Both backends compute every case; CSV, figures, summary.json, report.md and
    report.html go into the folder.

    First the backends are checked against each other; if they disagree the job stops (exit code 1). The folder appears
    when everything is done. One of earlier results is replaced; one that holds anything else is left alone.

    \b
    Example:
      redundancy-pin reproduce --out results
    """
    with progress("reproduce") as advance:
        done = run_job(out, progress=advance)
    made = tables(done.results)
    shown = [made[name].only(*columns) for name, columns in _SHOWN.items() if name in made]
    passed = f"cross-check passed: {len(done.results.check.rows)} checks"
    report(
        as_json, done.summary, *shown, f"{passed}. Results are in {done.folder} (start with report.html or report.md)."
    )
