"""The main job: cross-check, run every experiment with and without planners, write all results or none."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

from redundancy_pin import crosscheck
from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.errors import CrossCheckError
from redundancy_pin.io.files import MANIFEST, replacing_folder, require_replaceable, write_text
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.whole_trajectory.options import casadi
from redundancy_pin.studies import beyond, planned
from redundancy_pin.studies.case import Case
from redundancy_pin.studies.cases import FULL, MOTIONS, TASKS, Extent, by_method, motion_name
from redundancy_pin.studies.figures import THESIS, pictures
from redundancy_pin.studies.motions import CSV_DIGITS
from redundancy_pin.studies.report import html, report
from redundancy_pin.studies.results import Results, compute
from redundancy_pin.studies.store import Progress
from redundancy_pin.studies.table import Column, Table, csv_text
from redundancy_pin.visualisation.figures.style import require_matplotlib, save

CROSS_CHECK_SAMPLES = 2000
"""Random states of each robot before the job starts; `redundancy-pin validate` takes as many as one likes."""

CROSS_CHECK_SEED = 0

_CROSS_CHECK_STEPS = 10
"""Steps of the progress bar that the cross-check counts for: about its share of the time."""

PICTURE_SUFFIXES = (".png", ".svg")

_CLOCK = ("seconds", "solver_seconds")
"""Diagnostics that differ from run to run; without them the same run writes the same bytes."""

_BEYOND_COLUMNS = (
    "task", "way", "unit", "status", "peak", "dense_peak", "before", "reversals", "rms", "carrier_force", "main_energy",
    "carrier_energy", "position", "speed", "acceleration",
)  # fmt: skip
_REPLAY_COLUMNS = (
    "plan", "drive", "status", "largest", "rms", "last", "carrier_error", "carrier_lag", "off_track", "effort",
    "carrier_force", "gap",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What the main job made, the folder with it, and what ``summary.json`` there holds."""

    folder: Path
    results: Results
    summary: dict[str, Any]


def reproduce(
    folder: str | Path,
    motions: Sequence[Case] = MOTIONS,
    *,
    extent: Extent = FULL,
    samples: int = CROSS_CHECK_SAMPLES,
    progress: Progress | None = None,
) -> Reproduction:
    """Cross-check the backends, run experiments, and write the results.

    The folder appears, or replaces one of earlier results, when everything is done; on any error nothing is written.

    Args:
        folder: where to put the results.
        motions: what to run without a planner.
        extent: which chapters, and how much of them.
        samples: random states of each robot in the cross-check.
        progress: told how far the job is.

    Raises:
        CrossCheckError: the backends disagree.
        OutputError: the folder cannot be written or holds other files.
        RedundancyPinError: an experiment cannot run, or matplotlib or, for the last chapters, casadi is not installed.
    """
    require_matplotlib()
    if {"beyond", "replay"} & set(extent.chapters):
        casadi()
    require_replaceable(folder)
    total, steps, tell = _count(motions, extent), count(_CROSS_CHECK_STEPS + 1), progress or (lambda *_: None)

    def checked(done: int, states: int) -> None:
        tell(int(done / states * _CROSS_CHECK_STEPS), total, "cross-check")

    def step(what: str) -> None:
        tell(min(next(steps), total - 1), total, what)  # the last step is that everything is in its place

    check = require_agreement(sorted({case.robot for case in motions}), samples, checked)
    results = compute(motions, extent, check, step)
    with replacing_folder(folder) as temporary:
        write(temporary, results, step)
        summary = results.summary([path.name for path in temporary.iterdir()])
        write_text(temporary / MANIFEST, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    tell(total, total, "results")
    return Reproduction(Path(folder), results, summary)


def require_agreement(
    robots: Sequence[str], samples: int, progress: Callable[[int, int], None] | None = None
) -> CrossCheckReport:
    """Run the cross-check with the seed of the job; CrossCheckError, with the failed rows, where a check fails."""
    check = crosscheck.run(robots, samples, CROSS_CHECK_SEED, progress)
    if not check.passed:
        failed = [row for row in check.rows if not row.passed]
        first = failed[0]
        raise CrossCheckError(
            f"The cross-check fails {len(failed)} of {len(check.rows)} checks; the first is {first.check!r} on "
            f"{first.robot}: worst {first.worst:.3g}, allowed {first.tolerance:.3g}. Nothing was written.",
            remedy="Run `redundancy-pin validate` for the whole table.",
            failed=tuple(failed),
        )
    return check


# --- files ---------------------------------------------------------------------------------------------------------


def write(folder: Path, results: Results, tell: Callable[[str], None]) -> None:
    """Write everything but the summary: data, plans, figures, and the report, which embeds the figures."""
    for motion in results.runs:
        write_text(folder / f"{motion.case.name}.csv", motion.csv())
    if "beyond" in results.chapters:
        write_plans(folder, results)
        records = results.chapters["beyond"]["plans"]
        write_text(folder / "beyond.csv", Table.of([Column(name) for name in _BEYOND_COLUMNS], records).csv())
        write_text(folder / "headline.md", beyond.headline(records).markdown() + "\n")
    if "replay" in results.chapters:
        records = results.chapters["replay"]["replays"]
        # names with commas would need quotes, which not every reader of CSV knows
        rows = [{**row, **{key: row[key].replace(",", ";") for key in ("plan", "drive")}} for row in records]
        write_text(folder / "replay.csv", Table.of([Column(name) for name in _REPLAY_COLUMNS], rows).csv(digits=4))
    for chapter in pictures(results).values():
        for picture in chapter:
            save(picture.draw(results), *(folder / f"{picture.stem}{suffix}" for suffix in PICTURE_SUFFIXES))
            tell(picture.title)
    text = report(results)
    write_text(folder / "report.md", text)
    write_text(folder / "report.html", html(text, folder))


def write_plans(folder: Path, results: Results) -> None:
    """Write the plans of the chapter beyond the thesis, each with its curves as CSV."""
    tasks = {task.name: task for task in TASKS}
    for record in results.chapters["beyond"]["plans"]:
        if record["exists"] and record["file"]:
            plan = results.plans.plan(by_method(tasks[record["task"]], record["way"], results.extent.coarser))
            kept = {key: value for key, value in plan.diagnostics.items() if key not in _CLOCK}
            replace(plan, diagnostics=kept).save(folder / f"{record['file']}.npz")
            write_text(folder / f"{record['file']}.csv", plan_csv(plan))


def plan_csv(plan: Plan) -> str:
    """Return a plan as CSV text: motion, carriers, efforts, condition number; a time occurs twice at a jump."""
    motion, carriers = plan.motion, plan.carriers
    columns = {"t": motion.t, "x": motion.x, "xd": motion.xd, "xdd": motion.xdd, "s": carriers.s, "sd": carriers.sd,
               "sdd": carriers.sdd, "tau": plan.tau, "carrier_force": plan.carrier_force,
               "condition": plan.condition}  # fmt: skip
    return csv_text(columns, digits=CSV_DIGITS)


def _count(motions: Sequence[Case], extent: Extent) -> int:
    """Return the steps of the progress bar."""
    names = [motion_name(case) for case in motions]
    comparisons = sum(names.count(name) > 1 for name in set(names))
    counts = {"planned": planned.PARTS + len(THESIS), "beyond": beyond.parts(extent) + len(TASKS) + 4,
              "replay": len(extent.replayed) + 2}  # fmt: skip
    return _CROSS_CHECK_STEPS + 3 * len(motions) + comparisons + sum(counts[chapter] for chapter in extent.chapters)
