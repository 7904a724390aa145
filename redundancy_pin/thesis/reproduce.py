"""The main job: cross-check, run every experiment with and without planners, write all results or none.

Its files are data, plans, figures, and a report: the page ``report.md.j2`` with tables by ``tables.yaml``, as Markdown
and as one HTML file.
"""

from __future__ import annotations

import base64
import functools
import importlib.metadata
import json
import os
import platform
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import jinja2
from markdown_it import MarkdownIt
from markdown_it.common.utils import escapeHtml
from markdown_it.token import Token

import redundancy_pin
from redundancy_pin import crosscheck
from redundancy_pin.crosscheck import CheckRow, CrossCheckReport
from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.errors import CrossCheckError, InfeasiblePlanError, OutputError
from redundancy_pin.io.files import MANIFEST, replacing_folder, require_replaceable, write_text
from redundancy_pin.io.json_data import json_data
from redundancy_pin.parallel import parallel
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.simulation.replay import Drive, Replay, replay
from redundancy_pin.thesis import beyond, cases, future, planned
from redundancy_pin.thesis.case import Plans
from redundancy_pin.thesis.figures import IN_FRONT, Results, pictures
from redundancy_pin.thesis.measures import CSV_DIGITS, MotionRun, run
from redundancy_pin.thesis.statements import compare_motions, environment, thesis
from redundancy_pin.thesis.table import Column, Link, Record, Table, grouped, mode_text, records_csv, span, table
from redundancy_pin.trajectory.csv_file import csv_rows, effort_columns, motion_columns
from redundancy_pin.visualisation.figures.style import save

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
    folder: str | Path,
    extent: cases.Extent = cases.FULL,
    *,
    progress: Progress | None = None,
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
    total, steps, notify = _count(extent), count(_CROSS_CHECK_STEPS + 1), progress or (lambda *_: None)

    def checked(done: int, states: int) -> None:
        notify(int(done / states * _CROSS_CHECK_STEPS), total, "cross-check")

    def step(what: str) -> None:
        notify(min(next(steps), total - 1), total, what)  # the last step is that everything is in its place

    check = require_agreement(sorted({case.robot for case in extent.motions}), extent.samples, checked, extent.jobs)
    results = compute(extent, check, step)
    with replacing_folder(folder) as temporary:
        write(temporary, results, step)
        record = summary(results, [path.name for path in temporary.iterdir()])
        write_text(temporary / MANIFEST, json.dumps(record, indent=2, allow_nan=False) + "\n")
    notify(total, total, "results")
    return Reproduction(Path(folder), results, record)


def _count(extent: cases.Extent) -> int:
    """Return the steps of the progress bar: about one per plan, replay and figure."""
    plans = {"planned": planned.independent(extent), "beyond": beyond.independent(extent), "future": future.PLANNED}
    made = sum(len(cases) for chapter, cases in plans.items() if chapter in extent.chapters)
    return _CROSS_CHECK_STEPS + 3 * len(extent.motions) + made + len(extent.replayed) + 60 * extent.figures


def require_agreement(
    robots: Sequence[str], samples: int, progress: Callable[[int, int], None] | None = None, jobs: int = 1
) -> CrossCheckReport:
    """Run the cross-check with the seed of the job; CrossCheckError, with the failed rows, where a check fails."""
    check = crosscheck.run(robots, samples, CROSS_CHECK_SEED, progress, jobs if jobs > 0 else os.cpu_count() or 1)
    if not check.passed:
        failed = [row for row in check.rows if row.verdict == "FAILED"]
        what = f"finds nothing to judge {', '.join(check.unjudged)} by"
        if failed:
            first = failed[0]
            what = (
                f"fails {len(failed)} of {len(check.rows)} checks; the first is {first.check!r} on {first.robot}: "
                f"worst {first.worst:.3g}, allowed {first.tolerance:.3g}"
            )
        raise CrossCheckError(
            f"The cross-check {what}. Nothing was written.",
            remedy="Run `redundancy-pin validate` for the whole table.",
            failed=tuple(failed),
        )
    return check


def compute(extent: cases.Extent, check: CrossCheckReport, notify: Callable[[str], None]) -> Results:
    """Run the motions and the chapters; every plan is made once."""
    runs: list[MotionRun] = []
    for result in parallel(run, [(case,) for case in extent.motions], extent.jobs, ordered=True):
        runs.append(result)
        notify(result.case.name)
    plans = Plans()
    replays: list[Replay] = []
    chapters: dict[str, dict[str, Any]] = {}
    if "planned" in extent.chapters:
        chapters["planned"] = planned.run_planned(plans, extent, notify)
    if "beyond" in extent.chapters:
        chapters["beyond"] = beyond.run_beyond(plans, extent, notify)
    if "future" in extent.chapters:
        chapters["future"] = future.run_future(plans, extent, notify)
    if "replay" in extent.chapters:
        replays, missing = run_replays(plans, extent, notify)
        records = [{key: value for key, value in asdict(one).items() if key not in ("t", "error")} for one in replays]
        chapters["replay"] = {"replays": records, "without_plan": missing}
    return Results(extent, check, tuple(runs), tuple(compare_motions(runs)), chapters, plans, tuple(replays))


def summary(results: Results, files: Sequence[str]) -> dict[str, Any]:
    """Return everything worth keeping as plain data; None for numbers that do not exist.

    ``files`` are all of the results folder: a later run replaces the folder only if there are no others.
    """
    experiments = {one.case.name: one.record() for one in results.runs}
    for one in results.runs:
        experiments[one.case.name]["configuration"]["source"] = thesis()["sources"][one.case.robot]
    about = {"format": "redundancy_pin results", "format_version": 1, "versions": made_with()}
    chapters = {name: results.chapters.get(name) for name in cases.CHAPTERS}
    checked, compared = results.check.as_dict(), results.compared
    shown = {"cross_check": checked, "experiments": experiments, "thesis": compared, **chapters}
    return dict(json_data({**about, **shown, "notes": NOTES, "files": sorted(files)}))


def made_with() -> dict[str, str]:
    """Return the versions of this package, of Python and of what the numbers depend on, if installed."""
    installed = {distribution.metadata["Name"] for distribution in importlib.metadata.distributions()}
    known = [name for name in ("pin", "numpy", "scipy", "xacro", "matplotlib", "casadi") if name in installed]
    own = {"redundancy_pin": redundancy_pin.__version__, "python": platform.python_version()}
    return own | {name: importlib.metadata.version(name) for name in known}


def run_replays(
    plans: Plans, extent: cases.Extent, notify: Callable[[str], None]
) -> tuple[list[Replay], dict[str, str]]:
    """Replay plans of all planners with each of their drives; return what came out, and why some plans do not exist."""
    missing: dict[str, str] = {}
    jobs: list[tuple[cases.Replayed, Plan, Drive]] = []
    for replayed in extent.replayed:
        outcome = plans.outcome(replayed.case(extent.coarser))
        if isinstance(outcome, InfeasiblePlanError):
            missing[replayed.name] = str(outcome)
            notify(f"no plan to replay: {replayed.name}")
        else:
            jobs += [(replayed, outcome, drive) for drive in replayed.drives]
    results: list[Replay] = []
    for (replayed, _, drive), result in zip(jobs, parallel(_replay, jobs, extent.jobs, ordered=True), strict=True):
        results.append(result)
        if drive == replayed.drives[-1]:
            notify(f"replay: {result.plan}")
    return results, missing


def _replay(replayed: cases.Replayed, plan: Plan, drive: Drive) -> Replay:
    return replay(plan, drive, name=replayed.name, motion=replayed.task.trajectory(), backend=as_dynamics)


# --- files ---------------------------------------------------------------------------------------------------------


def write(folder: Path, results: Results, notify: Callable[[str], None]) -> None:
    """Write everything but the summary: data, plans, figures, and the report, which embeds the figures."""
    for motion in results.runs:
        write_text(folder / f"{motion.case.name}.csv", motion.csv())
    if "beyond" in results.chapters:
        write_plans(folder, results)
        records = results.chapters["beyond"]["plans"]
        write_text(folder / "beyond.csv", records_csv(_BEYOND_COLUMNS, records))
        write_text(folder / "headline.md", beyond.headline(records).markdown() + "\n")
    if "replay" in results.chapters:
        records = results.chapters["replay"]["replays"]
        # names with commas would need quotes, which not every reader of CSV knows
        rows = [{**row, **{key: row[key].replace(",", ";") for key in ("plan", "drive")}} for row in records]
        write_text(folder / "replay.csv", records_csv(_REPLAY_COLUMNS, rows, digits=4))
    drawn = [picture for chapter in pictures(results).values() for picture in chapter]
    files = [[folder / f"{picture.stem}{suffix}" for suffix in PICTURE_SUFFIXES] for picture in drawn]
    # a picture is drawn in no time beside that of its layout and its files
    saving = [(picture.draw(results), *paths) for picture, paths in zip(drawn, files, strict=True)]
    for picture, _ in zip(drawn, parallel(save, saving, results.extent.jobs, ordered=True), strict=True):
        notify(picture.title)
    page = report(results)
    write_text(folder / "report.md", page)
    write_text(folder / "report.html", html(page, folder))


def write_plans(folder: Path, results: Results) -> None:
    """Write the plans of the chapter beyond the thesis, each with its curves as CSV; a time occurs twice at a jump."""
    tasks = {task.name: task for task in cases.TASKS}
    for record in results.chapters["beyond"]["plans"]:
        if record["exists"] and record["file"]:
            plan = results.plans.plan(cases.by_method(tasks[record["task"]], record["way"], results.extent.coarser))
            kept = {key: value for key, value in plan.diagnostics.items() if key not in _CLOCK}
            replace(plan, diagnostics=kept).save(folder / f"{record['file']}.npz")
            robot = robot_of_record(plan.robot)
            columns = {
                **motion_columns(robot, plan.motion, plan.carriers),
                **effort_columns(robot.actuated, plan.tau, robot),
                **effort_columns(robot.carriers, plan.carrier_force, robot),
                "condition": ("", plan.condition),
            }
            write_text(folder / f"{record['file']}.csv", csv_rows(columns, digits=CSV_DIGITS))


def report(results: Results) -> str:
    """Return the report as Markdown; pictures and files are links into the folder."""
    template = environment(jinja2.PackageLoader("redundancy_pin.thesis", "")).get_template("report.md.j2")
    shown = {"tables": tables(results), "pictures": pictures(results), "versions": made_with(), "notes": NOTES}
    chapters = {name: results.chapters.get(name) for name in cases.CHAPTERS}
    return template.render(results=results, mode_text=mode_text, in_front=IN_FRONT, **shown, **chapters)


# --- tables --------------------------------------------------------------------------------------------------------


def tables(results: Results) -> dict[str, Table]:
    """Return every table of what was run, by the names in ``tables.yaml``."""
    runs = [{**run.record(), "name": Link(run.case.name, f"{run.case.name}.csv")} for run in results.runs]
    chapters = results.chapters
    return {
        "cross_check": table("cross_check", [_check_record(row) for row in results.check.rows]),
        "motions": table("motions", runs, "experiments: Pinocchio (RNEA) against virtual work"),
        "thesis": table("thesis", results.compared, "what the thesis states (Parsa 2014), and what comes out here"),
        **(_planned(chapters["planned"], results.extent) if "planned" in chapters else {}),
        **(_beyond(chapters["beyond"]) if "beyond" in chapters else {}),
        **({"future": table("future", chapters["future"]["plans"])} if "future" in chapters else {}),
        **({"replays": table("replays", chapters["replay"]["replays"])} if "replay" in chapters else {}),
    }


RANGED = ("peak", "rms", "carrier_force", "main_energy", "energy")
"""What the comparison of machines shows as ranges over the working modes."""


def _check_record(row: CheckRow) -> dict[str, Any]:
    """Return a row of the cross-check for its table: without numbers, and with the reason, where it is left out."""
    return {**row.as_dict(), "check": row.title, **({"worst": None, "tolerance": None} if row.note else {})}


def _planned(chapter: Mapping[str, Any], extent: cases.Extent) -> dict[str, Table]:
    machines, modes = chapter["fair_comparison"], [mode_text(mode) for mode in extent.modes]
    moded = grouped([record for record in machines if record["mode"]], "motion", "what")
    over_modes = [same[0] | {key: span([one[key] for one in same]) for key in RANGED} for same in moded.values()]
    sensitive = [
        {**same[0], "ranges": "; ".join(f"{one['parameter']}: {span((one['low'], one['high']))}" for one in same)}
        for same in grouped(chapter["sensitivity"], "case", "quantity").values()
    ]
    holds = [Column(f"modes.{name}.holds", name) for name in modes]
    alone = [record for record in machines if record["mode"] in ((), extent.modes[0])]
    whole = ("working_modes", "between_samples", "shortest_returns_on_square", "crossings", "parity")
    return {
        **{name: table(name, chapter[name]) for name in whole},
        "conclusions": table("conclusions", chapter["conclusions"], "the thesis's conclusions"),
        "judged": table("judged", chapter["against_thesis"], "planned experiments against the thesis (Parsa 2014)"),
        "claims": table("claims", chapter["claims"], more=holds),
        "fair_comparison": table("fair_comparison", alone),
        "fair_over_modes": table("fair_over_modes", over_modes),
        "sensitivity": table("sensitivity", sensitive),
    }


def _beyond(chapter: Mapping[str, Any]) -> dict[str, Table]:
    plans, modes = chapter["plans"], chapter["working_modes"]
    peaks = [Column(method, value=functools.partial(_worst, method)) for method in (modes[0]["rows"] if modes else ())]
    ratio = Column("ratio", "least peak over no carriers", format=".2f")
    shown = {name: table(name, chapter[name]) for name in ("targets", "fastest", "backends", "first_guesses")}
    for name, tasks in (("singular", cases.SINGULAR), ("turns", cases.TURNS)):
        chosen = [record for record in plans if record["task"] in {task.name for task in tasks}]
        shown[f"{name}_limits"] = table("plans_limits", chosen)
        shown[f"{name}_costs"] = table("plans_costs", [record for record in chosen if record["exists"]])
    return shown | {
        "headline": beyond.headline(plans),
        "findings": table("findings", chapter["findings"], "beyond the thesis: planning over the whole trajectory"),
        "beyond_modes": table("beyond_modes", modes, more=[*peaks, ratio]),
        "trade_off": table("trade_off", [{**one, **point} for one in chapter["trade_off"] for point in one["points"]]),
    }


def _worst(method: str, record: Record) -> str:
    row = record["rows"][method]
    shown = f"{row['worst']:.2f}" if row["exists"] else ""
    return shown if row["sound"] else f"{shown} ({row['status']})".strip()


# --- one HTML file: no network, no file beside it, no script --------------------------------------------------------

VERDICTS = {
    "good": ("reproduced", "met", "stands"),
    "partly": ("reproduced:", "stands with conditions"),
    "bad": ("differs:", "missed", "does not stand"),
}
"""Cells by their class; a colon is followed by a condition or reason."""


def html(markdown: str, folder: Path) -> str:
    """Return a report as one HTML page: its pictures, of the folder, embedded, links to other files as text."""
    renderer = MarkdownIt("commonmark", {"html": False}).enable("table")
    # rules of a renderer get the tokens, the index of theirs, options and an environment
    rules: dict[str, Callable[..., str]] = {
        "image": functools.partial(_image, folder),
        "text": lambda tokens, index, *_: _words(tokens[index].content),
        "link_open": lambda *_: "",
        "link_close": lambda *_: "",
        "table_open": lambda *_: '<div class="scroll"><table>\n',
        "table_close": lambda *_: "</table></div>\n",
    }
    renderer.renderer.rules.update(rules)  # type: ignore[attr-defined]
    tokens = renderer.parse(markdown)
    headings: list[tuple[str, str]] = []
    title = "Report"
    shown: list[Token] = []
    for index, token in enumerate(tokens):
        inner = tokens[min(index + 1, len(tokens) - 1)].content
        if token.type == "heading_open":
            anchor = f"s{index}-" + re.sub(r"[^a-z0-9]+", "-", inner.lower()).strip("-")
            title = inner if token.tag == "h1" else title
            if token.tag == "h2":
                # what came out is the page; each chapter behind it unfolds, also when a link leads into it
                layer = "</div></details>\n<details><summary>" if len(headings) > 1 else "<details><summary>"
                shown += [_html(layer)] if headings else []
                headings.append((anchor, inner))
            if token.tag != "h2" or len(headings) == 1:
                token.attrSet("id", anchor)
        elif token.type == "td_open":
            head, colon, _ = inner.partition(":")
            classes = [name for name, verdicts in VERDICTS.items() if head + colon in verdicts]
            token.attrs = {"class": classes[0]} if classes else {}
        shown.append(token)
        if token.type == "heading_close" and token.tag == "h2" and len(headings) > 1:
            shown.append(_html(f'</summary><div id="{headings[-1][0]}">\n'))
    tokens = shown + [_html("</div></details>\n")] * (len(headings) > 1)
    body = renderer.renderer.render(tokens, renderer.options, {})
    page = jinja2.Environment(loader=jinja2.PackageLoader("redundancy_pin.thesis", ""), autoescape=True)
    return page.get_template("page.html.j2").render(title=title, headings=headings, body=body)


def _html(content: str) -> Token:
    return Token("html_block", "", 0, content=content)


def _words(content: str) -> str:
    """Return text with working modes that no line break splits."""
    return re.sub("([+\u2212]{2,})", r'<span class="mode">\1</span>', escapeHtml(content))


def _image(folder: Path, tokens: Sequence[Token], index: int, *_: object) -> str:
    path = folder / str(tokens[index].attrs["src"])
    try:
        content = base64.b64encode(path.read_bytes()).decode("ascii")
    except OSError as error:
        raise OutputError(f"Cannot read {path}: {error.strerror or error}.", path=str(path)) from error
    return f'<img src="data:image/png;base64,{content}" alt="{escapeHtml(tokens[index].content)}" loading="lazy">'
