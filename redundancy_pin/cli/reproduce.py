"""``redundancy-pin reproduce``: the experiments of the thesis, and a folder of results."""

from __future__ import annotations

from dataclasses import replace

import click

from redundancy_pin.cli import options
from redundancy_pin.cli.output import console, progress, report
from redundancy_pin.parallel import require_jobs
from redundancy_pin.thesis.cases import FULL, QUICK
from redundancy_pin.thesis.reproduce import reproduce as run_job
from redundancy_pin.thesis.reproduce import tables

_SHOWN = {
    "motions": ("name", "samples", "parity", "smallest_margin", "statement"),
    "thesis": ("source", "experiment", "quantity", "stated", "computed", "unit"),
    "judged": ("source", "quantity", "stated", "ours", "verdict"),
    "conclusions": ("claim", "stands", "here"),
    "findings": ("claim", "stands", "here"),
}
"""Columns by table that fit a terminal side by side; the files have all of them."""


@click.command()
@click.option("--out", default="results", show_default=True, metavar="FOLDER", help="Where the results go.")
@click.option("--quick", is_flag=True, help="A few motions, plans and figures, in less than a minute.")
@options.jobs_option(-1)
@options.json_option
def reproduce(out: str, quick: bool, jobs: int, as_json: bool) -> None:
    r"""Run the experiments of the thesis.

    Both backends compute every case; CSV, figures, summary.json, report.md and
    report.html go into the folder, with results beyond the thesis. It takes about
    three minutes on two cores.

    First the backends are checked against each other; if they disagree the job stops (exit code 1). The folder appears
    when everything is done. One of earlier results is replaced; one that holds anything else is left alone.

    \b
    Examples:
      redundancy-pin reproduce --out results
      redundancy-pin reproduce --quick --jobs 2
    """
    with progress("reproduce") as advance:
        done = run_job(out, extent=replace(QUICK if quick else FULL, jobs=require_jobs(jobs)), progress=advance)
    made = tables(done.results)
    for name, columns in _SHOWN.items() if not as_json else ():
        if name in made:
            console().print(made[name].only(*columns).terminal())
    end = f"cross-check passed: {len(done.results.check.rows)} checks. "
    if quick:
        end += "This is a quick run: numbers and verdicts of the full one differ. "
    end += f"Results are in {done.folder} (start with report.html or report.md)."
    report(as_json, done.summary, end)
