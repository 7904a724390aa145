"""The main job: cross-check, run every experiment with and without planners, write all results or none.

Its files are data, plans, figures, and a report: the page ``report.md.j2`` with tables by ``tables.yaml``, as Markdown
and as one HTML file.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

import redundancy_pin
from redundancy_pin import crosscheck
from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.errors import CrossCheckError, InfeasiblePlanError
from redundancy_pin.io.files import MANIFEST, replacing_folder, require_replaceable, write_text
from redundancy_pin.io.json_data import json_data
from redundancy_pin.parallel import parallel
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.simulation.replay import Replay, replay
from redundancy_pin.thesis import beyond, cases, planned
from redundancy_pin.thesis.cases import Call, Plans, plan_or_error
from redundancy_pin.thesis.claims import cost_pairs
from redundancy_pin.thesis.figures import IN_FRONT, Results, pictures
from redundancy_pin.thesis.measures import CSV_DIGITS, run
from redundancy_pin.thesis.page import html
from redundancy_pin.thesis.statements import compare_motions
from redundancy_pin.thesis.table import Record, Table, grouped, mode_text, span, table
from redundancy_pin.trajectory.csv_file import csv_rows, effort_columns, motion_columns
from redundancy_pin.visualisation.figures.style import save

CROSS_CHECK_SEED = 0

_CROSS_CHECK_STEPS = 10
"""Steps of the progress bar that the cross-check counts for: about its share of the time."""

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

Progress = Callable[[int, int, str], None]
"""Called with steps done, steps in all, and what is being done."""

NOTES = (
    "Efforts are positive when they do positive work on the joint rate; the thesis has the opposite sign.",
    "Near-singular samples (margin below the threshold) are left out of peaks: towards a singular instant at which a "
    "part of the required force is outside what the actuators can carry, efforts grow as that part over the margin.",
    "The 2-RPR of the thesis is massless but for its carriers, so it has no baseline without them.",
)


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What the main job made, the folder with it, and what ``summary.json`` there holds."""

    folder: Path
    results: Results
    summary: dict[str, Any]


def reproduce(
    folder: str | Path, extent: cases.Extent = cases.FULL, *, progress: Progress | None = None
) -> Reproduction:
    """Cross-check the backends, run experiments, and write the results.

    The folder appears, or replaces one of earlier results, when everything is done; on any error nothing is written.

    Args:
        folder: where to put the results.
        extent: which motions and chapters, and how much of them.
        progress: called with steps done, steps in all, and the current step.

    Raises:
        CrossCheckError: the backends disagree.
        OutputError: the folder cannot be written or holds other files.
        RedundancyPinError: an experiment cannot run.
    """
    require_replaceable(folder)
    todo, notify = calls(extent), progress or (lambda *_: None)
    files = len(extent.motions) + 30 * ("beyond" in extent.chapters) + (70 if extent.figures else 2)  # about
    total, steps = _CROSS_CHECK_STEPS + len({call[1:] for call in todo}) + files, count(_CROSS_CHECK_STEPS + 1)

    def checked(done: int, states: int) -> None:
        notify(int(done / states * _CROSS_CHECK_STEPS), total, "cross-check")

    def step(what: str) -> None:
        notify(min(next(steps), total - 1), total, what)  # the last step is that everything is in its place

    check = require_agreement(sorted({case.robot for case in extent.motions}), extent.samples, checked, extent.jobs)
    results = compute(extent, check, todo, step)
    with replacing_folder(folder) as temporary:
        write(temporary, results, step)
        record = summary(results, [path.name for path in temporary.iterdir()])
        write_text(temporary / MANIFEST, json.dumps(record, indent=2, allow_nan=False) + "\n")
    notify(total, total, "results")
    return Reproduction(Path(folder), results, record)


def require_agreement(
    robots: Sequence[str], samples: int, progress: Callable[[int, int], None] | None = None, jobs: int = 1
) -> CrossCheckReport:
    """Run the cross-check with the seed of the job; CrossCheckError, with the failed rows, where a check fails."""
    check = crosscheck.run(robots, samples, CROSS_CHECK_SEED, progress, jobs if jobs > 0 else os.cpu_count() or 1)
    if check.passed:
        return check
    what = f"finds nothing to judge {', '.join(check.unjudged)} by"
    if failed := [row for row in check.rows if row.verdict == "FAILED"]:
        first = failed[0]
        what = (
            f"fails {len(failed)} of {len(check.rows)} checks; the first is {first.check!r} on {first.robot}: "
            f"worst {first.worst:.3g}, allowed {first.tolerance:.3g}"
        )
    message, remedy = (
        f"The cross-check {what}. Nothing was written.",
        "Run `redundancy-pin validate` for the whole table.",
    )
    raise CrossCheckError(message, remedy=remedy, failed=tuple(failed))


def calls(extent: cases.Extent) -> list[Call]:
    """Return the calls that make motions, plans, replays and rows of all chapters, long ones first."""
    replays = [(f"replay: {one.name}", run_replays, one, extent.coarser) for one in extent.replayed]
    motions = [(case.name, run, case) for case in extent.motions]
    chapters = {"beyond": beyond.calls(extent), "replay": replays, "motions": motions,
                "future": beyond.future_calls(extent), "planned": planned.calls(extent)}  # fmt: skip
    return [call for name, needed in chapters.items() if name in ("motions", *extent.chapters) for call in needed]


def compute(
    extent: cases.Extent, check: CrossCheckReport, todo: Sequence[Call], notify: Callable[[str], None]
) -> Results:
    """Make all calls, and the records of the chapters from their results."""
    plans = Plans()
    plans.prepare(todo, extent.jobs, notify)
    runs = tuple(plans.result("", run, case) for case in extent.motions)
    makers = {"planned": planned.run_planned, "beyond": beyond.run_beyond, "future": beyond.run_future}
    chapters: dict[str, Any] = {name: make(plans, extent) for name, make in makers.items() if name in extent.chapters}
    replays: list[Replay] = []
    if "replay" in extent.chapters:
        outcomes = {one.name: plans.result("", run_replays, one, extent.coarser) for one in extent.replayed}
        missing = {name: outcome for name, outcome in outcomes.items() if isinstance(outcome, str)}
        replays = [one for name, outcome in outcomes.items() if name not in missing for one in outcome]
        records = [{key: value for key, value in asdict(one).items() if key not in ("t", "error")} for one in replays]
        chapters["replay"] = {"replays": records, "without_plan": missing}
    return Results(extent, check, runs, tuple(compare_motions(runs)), chapters, plans, tuple(replays))


def run_replays(replayed: cases.Replayed, coarser: float) -> list[Replay] | str:
    """Replay a plan with each of its drives; return the reason why no plan exists."""
    case, motion = replayed.case(coarser), replayed.task.trajectory()
    outcome = plan_or_error(case, case.backends[0])
    if isinstance(outcome, InfeasiblePlanError):
        return str(outcome)
    return [replay(outcome, drive, name=replayed.name, motion=motion, backend=as_dynamics) for drive in replayed.drives]


def summary(results: Results, files: Sequence[str]) -> dict[str, Any]:
    """Return everything worth keeping as plain data; None for numbers that do not exist.

    ``files`` are all of the results folder: a later run replaces the folder only if there are no others.
    """
    about = {"format": "redundancy_pin results", "format_version": 2, "extent": results.extent.name,
             "versions": made_with()}  # fmt: skip
    experiments = {one.case.name: one.record() for one in results.runs}
    shown = {"cross_check": results.check.as_dict(), "experiments": experiments, "thesis": results.compared}
    chapters = {name: results.chapters.get(name) for name in cases.CHAPTERS}
    return dict(json_data({**about, **shown, **chapters, "notes": NOTES, "files": sorted(files)}))


def made_with() -> dict[str, str]:
    """Return the versions of this package, of Python and of what the numbers depend on, if installed."""
    installed = {distribution.metadata["Name"] for distribution in importlib.metadata.distributions()}
    known = [name for name in ("pin", "numpy", "scipy", "xacro", "matplotlib", "casadi") if name in installed]
    own = {"redundancy_pin": redundancy_pin.__version__, "python": platform.python_version()}
    return own | {name: importlib.metadata.version(name) for name in known}


# --- files ---------------------------------------------------------------------------------------------------------


def write(folder: Path, results: Results, notify: Callable[[str], None]) -> None:
    """Write everything but the summary: data, plans, figures, and the report, which embeds the figures."""
    writing: list[tuple[Any, ...]] = [(write_text, folder / f"{run.case.name}.csv", run.csv()) for run in results.runs]
    if "beyond" in results.chapters:
        records, tasks = results.chapters["beyond"]["plans"], {task.name: task for task in cases.TASKS}
        for record in (one for one in records if one["file"]):
            case = cases.by_method(tasks[record["task"]], record["way"], results.extent.coarser)
            writing.append((write_plan, folder / record["file"], results.plans.plan(case)))
        write_text(folder / "beyond.csv", _records_csv(_BEYOND_COLUMNS, records))
        write_text(folder / "headline.md", beyond.headline(records).markdown() + "\n")
    if "replay" in results.chapters:
        records = results.chapters["replay"]["replays"]
        # names with commas would need quotes, which not every reader of CSV knows
        rows = [{**row, **{key: row[key].replace(",", ";") for key in ("plan", "drive")}} for row in records]
        write_text(folder / "replay.csv", _records_csv(_REPLAY_COLUMNS, rows, digits=4))
    for picture in [picture for chapter in pictures(results).values() for picture in chapter]:
        # drawing takes little time beside the layout and the files
        writing.append((save, picture.draw(), *(folder / f"{picture.stem}{suffix}" for suffix in (".png", ".svg"))))
    for _ in parallel(_done, writing, results.extent.jobs):
        notify("files")
    page = report(results)
    write_text(folder / "report.md", page)
    write_text(folder / "report.html", html(page, folder))


def _done(function: Callable[..., None], *arguments: Any) -> None:
    function(*arguments)


def _records_csv(names: Sequence[str], records: Sequence[Record], digits: int | None = None) -> str:
    return csv_rows({name: ("", np.array([record[name] for record in records])) for name in names}, digits=digits)


def write_plan(stem: Path, plan: Plan) -> None:
    """Write a plan, and its curves as CSV; a time occurs twice at a jump."""
    kept = {key: value for key, value in plan.diagnostics.items() if key not in _CLOCK}
    replace(plan, diagnostics=kept).save(f"{stem}.npz")
    robot = robot_of_record(plan.robot)
    columns = {
        **motion_columns(robot, plan.motion, plan.carriers),
        **effort_columns(robot.actuated, plan.tau, robot),
        **effort_columns(robot.carriers, plan.carrier_force, robot),
        "condition": ("", plan.condition),
    }
    write_text(f"{stem}.csv", csv_rows(columns, digits=CSV_DIGITS))


# --- the report ----------------------------------------------------------------------------------------------------


def report(results: Results) -> str:
    """Return the report as Markdown; pictures and files are links into the folder."""
    loader, chapters = jinja2.PackageLoader("redundancy_pin.thesis", ""), results.chapters
    settings: Any = dict.fromkeys(("trim_blocks", "lstrip_blocks", "keep_trailing_newline"), True)
    made = jinja2.Environment(loader=loader, undefined=jinja2.StrictUndefined, **settings)
    made.filters["factors"] = partial(span, form=".2g")
    findings = chapters.get("beyond", {}).get("findings", ())
    return made.get_template("report.md.j2").render(
        results=results,
        tables=tables(results),
        pictures=pictures(results),
        versions=made_with(),
        notes=NOTES,
        mode_text=mode_text,
        in_front=IN_FRONT,
        found={one["name"]: one for one in findings},
        cost=[one["energy"] / none["energy"] for one, none in cost_pairs(chapters["beyond"])] if findings else (),
        **{name: chapters.get(name) for name in cases.CHAPTERS},
    )


TITLES = {
    "motions": "experiments: Pinocchio (RNEA) against virtual work",
    "thesis": "what the thesis states (Parsa 2014), and what comes out here",
    "conclusions": "the thesis's conclusions",
    "judged": "planned experiments against the thesis (Parsa 2014)",
    "findings": "beyond the thesis: planning over the whole trajectory",
}
"""Titles of the tables that a terminal shows."""


def tables(results: Results) -> dict[str, Table]:
    """Return every table of what was run, by the names in ``tables.yaml``."""
    left_out = {"worst": None, "tolerance": None}
    rows: dict[str, Sequence[Record]] = {
        "cross_check": [{**row.as_dict(), "check": row.title, **(left_out if row.note else {})}
                        for row in results.check.rows],
        "motions": [{**run.record(), "name": run.case.name} for run in results.runs],
        "thesis": results.compared,
    }  # fmt: skip
    more: dict[str, Sequence[str]] = {}
    if "planned" in results.chapters:
        rows |= _planned(results.chapters["planned"], results.extent)
        more["claims"] = [mode_text(mode) for mode in results.extent.modes]
    if "beyond" in results.chapters:
        rows |= _beyond(results.chapters["beyond"])
        more["beyond_modes"] = (*beyond.MODE_METHODS, "least peak over no carriers")
    if "future" in results.chapters:
        rows["future"] = results.chapters["future"]["plans"]
    if "replay" in results.chapters:
        rows["replays"] = results.chapters["replay"]["replays"]
    made = {name: table(name, records, TITLES.get(name, ""), more.get(name, ())) for name, records in rows.items()}
    return made | (
        {"headline": beyond.headline(results.chapters["beyond"]["plans"])} if "beyond" in results.chapters else {}
    )


def _planned(chapter: Mapping[str, Any], extent: cases.Extent) -> dict[str, Sequence[Record]]:
    machines, ranged = chapter["fair_comparison"], ("peak", "rms", "carrier_force", "main_energy", "energy")
    moded = grouped([record for record in machines if record["mode"]], "motion", "what").values()
    several = grouped(chapter["sensitivity"], "case", "quantity").values()
    return {
        **{name: chapter[name] for name in (
            "working_modes", "between_samples", "shortest_returns_on_square", "crossings", "parity", "conclusions"
        )},
        "judged": chapter["against_thesis"],
        "claims": [one | {name: mode["holds"] for name, mode in one["modes"].items()} for one in chapter["claims"]],
        "fair_comparison": [record for record in machines if record["mode"] in ((), extent.modes[0])],
        "fair_over_modes": [same[0] | {key: span([one[key] for one in same]) for key in ranged} for same in moded],
        "sensitivity": [same[0] | {"ranges": "; ".join(map(_range, same))} for same in several],
    }  # fmt: skip


def _range(one: Record) -> str:
    missing = f" ({one['without']} of {one['plans']} without a plan)" if one["without"] else ""
    return f"{one['parameter']}: {span((one['low'], one['high']))}{missing}"


def _beyond(chapter: Mapping[str, Any]) -> dict[str, Sequence[Record]]:
    def worst(row: Record) -> str:
        shown = f"{row['worst']:.2f}" if row["exists"] else ""
        return shown if row["sound"] else f"{shown} ({row['status']})".strip()

    shown: dict[str, Sequence[Record]] = {
        **{name: chapter[name] for name in ("targets", "findings", "fastest", "backends", "first_guesses")},
        "beyond_modes": [
            {**one, **{method: worst(row) for method, row in one["rows"].items()},
             "least peak over no carriers": f"{one['ratio']:.2f}"}
            for one in chapter["working_modes"]
        ],
        "trade_off": [{**one, **point} for one in chapter["trade_off"] for point in one["points"]],
    }  # fmt: skip
    for name, tasks in (("singular", cases.SINGULAR), ("turns", cases.TURNS)):
        chosen = [record for record in chapter["plans"] if record["task"] in {task.name for task in tasks}]
        shown |= {f"{name}_limits": chosen, f"{name}_costs": [record for record in chosen if record["exists"]]}
    return shown
