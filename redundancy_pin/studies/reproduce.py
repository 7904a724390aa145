"""The main job: cross-check, run every experiment with and without planners, write all results or none.

Its files are data, plans, figures, and a report: the page ``report.md.j2`` with tables by ``tables.yaml``, as Markdown
and as one HTML file.
"""

from __future__ import annotations

import base64
import functools
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import jinja2
from markdown_it import MarkdownIt
from markdown_it.common.utils import escapeHtml
from markdown_it.token import Token

from redundancy_pin import crosscheck
from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.errors import CrossCheckError, InputError, OutputError
from redundancy_pin.io.files import MANIFEST, replacing_folder, require_replaceable, write_text
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.whole_trajectory.options import casadi
from redundancy_pin.studies import beyond, planned
from redundancy_pin.studies.case import Case
from redundancy_pin.studies.cases import (
    CHAPTERS,
    FULL,
    MOTIONS,
    SINGULAR,
    TASKS,
    TURNS,
    Extent,
    by_method,
    mode_text,
    motion_name,
)
from redundancy_pin.studies.claims import environment
from redundancy_pin.studies.figures import THESIS, pictures
from redundancy_pin.studies.motions import CSV_DIGITS
from redundancy_pin.studies.results import Results, compute
from redundancy_pin.studies.store import Progress
from redundancy_pin.studies.table import NONE, Column, Link, Record, Table, csv_text, span, text
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


def _count(motions: Sequence[Case], extent: Extent) -> int:
    """Return the steps of the progress bar."""
    names = [motion_name(case) for case in motions]
    comparisons = sum(names.count(name) > 1 for name in set(names))
    counts = {"planned": planned.PARTS + len(THESIS), "beyond": beyond.parts(extent) + len(TASKS) + 4,
              "replay": len(extent.replayed) + 2}  # fmt: skip
    return _CROSS_CHECK_STEPS + 3 * len(motions) + comparisons + sum(counts[chapter] for chapter in extent.chapters)


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
    page = report(results)
    write_text(folder / "report.md", page)
    write_text(folder / "report.html", html(page, folder))


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


# --- the report ---


def report(results: Results) -> str:
    """Return the report as Markdown; pictures and files are links into the folder."""
    template = environment(jinja2.PackageLoader("redundancy_pin.studies", "")).get_template("report.md.j2")
    chapters = {name: results.chapters.get(name) for name in CHAPTERS}
    return template.render(
        results=results, tables=tables(results), pictures=pictures(results), mode_text=mode_text, **chapters
    )


# --- tables --------------------------------------------------------------------------------------------------------


def tables(results: Results) -> dict[str, Table]:
    """Return every table of what was run, by the names in ``tables.yaml``."""
    runs = [{**run.record(), "name": Link(run.case.name, f"{run.case.name}.csv")} for run in results.runs]
    shown = {
        "cross_check": table("cross_check", [vars(row) for row in results.check.rows]),
        "motions": table("motions", runs, "experiments: Pinocchio (RNEA) against virtual work"),
        "thesis": table("thesis", results.compared, "what the thesis states (Parsa 2014), and what comes out here"),
    }
    chapters = results.chapters
    if "planned" in chapters:
        shown |= _planned(chapters["planned"], results)
    if "beyond" in chapters:
        shown |= _beyond(chapters["beyond"])
    if "replay" in chapters:
        shown["replays"] = table("replays", chapters["replay"]["replays"])
    return shown


@functools.cache
def _layout() -> Mapping[str, Mapping[str, str]]:
    data: Mapping[str, Any] = read_yaml(Path(__file__).with_name("tables.yaml"), InputError).data
    return data


def table(name: str, records: Sequence[Record], title: str = "", more: Sequence[Column] = ()) -> Table:
    """Return records as the table of a name in ``tables.yaml``, with further columns behind."""
    columns = []
    for key, shown in _layout()[name].items():
        heading, kind, form = re.fullmatch(r"(.*?)(?: ([:=])(\S+))?", shown).groups()  # type: ignore[union-attr]
        cell = CELLS[form] if kind == "=" else functools.partial(_at, key)
        columns.append(Column(key, heading, format=form if kind == ":" else ".3g", value=cell))
    return Table.of([*columns, *more], records, title)


def _at(key: str, record: Record) -> Any:
    """Return an entry of a record; a dot leads into a record inside, None if there is none."""
    first, _, rest = key.partition(".")
    return _at(rest, record.get(first) or {}) if rest else record.get(first)


def _of(value: str, limit: str) -> Callable[[Record], str]:
    return lambda record: NONE if math.isnan(record[limit]) else f"{record[value]:.3f} of {record[limit]:g}"


def _method(record: Record) -> str | Link:
    return Link(record["way"], f"{record['file']}.npz") if record["file"] else record["way"]


def _peak(record: Record) -> str:
    before = "" if math.isnan(record["before"]) else f" ({record['before']:.3g} until off)"
    return text(record["peak"]) + before if record["exists"] else "none"


CELLS: Mapping[str, Callable[[Record], Any]] = {
    "counts": lambda record: ", ".join(f"{name} {count}" for name, count in record["statuses"].items()),
    "with_reason": lambda record: ": ".join(part for part in (record["verdict"], record["reason"]) if part),
    "mode": lambda record: mode_text(record["mode"]),
    "met": lambda record: "met" if record["met"] else "missed",
    "effort_limit": lambda record: "none" if math.isinf(record["effort_limit"]) else record["effort_limit"],
    "method": _method,
    "peak": _peak,
    "position": _of("position", "track"),
    "speed": _of("speed", "speed_limit"),
    "acceleration": _of("acceleration", "acceleration_limit"),
}
"""What makes cells that are more than an entry of a record; ``tables.yaml`` names them."""


def _planned(chapter: Mapping[str, Any], results: Results) -> dict[str, Table]:
    machines, first = chapter["fair_comparison"], results.extent.modes[0]
    over_modes = [
        {"motion": motion, "what": what} | {key: span([record[key] for record in same]) for key in RANGED}
        for (motion, what), same in _grouped(
            [record for record in machines if record["mode"]], "motion", "what"
        ).items()
    ]
    sensitive = [
        {**same[0], "ranges": "; ".join(f"{one['parameter']}: {span((one['low'], one['high']))}" for one in same)}
        for same in _grouped(chapter["sensitivity"], "case", "quantity").values()
    ]
    keys = {name: f"modes.{name}.holds" for name in map(mode_text, results.extent.modes)}
    modes = [Column(key, name, value=functools.partial(_at, key)) for name, key in keys.items()]
    whole = ("working_modes", "between_samples", "shortest_returns_on_square", "crossings", "parity")
    return {
        **{name: table(name, chapter[name]) for name in whole},
        "conclusions": table("conclusions", chapter["conclusions"], "the thesis's conclusions"),
        "judged": table("judged", chapter["against_thesis"], "planned experiments against the thesis (Parsa 2014)"),
        "claims": table("claims", chapter["claims"], more=modes),
        "fair_comparison": table("fair_comparison", [record for record in machines if record["mode"] in ((), first)]),
        "fair_over_modes": table("fair_over_modes", over_modes),
        "sensitivity": table("sensitivity", sensitive),
    }


RANGED = ("peak", "rms", "carrier_force", "main_energy", "energy")
"""What the comparison of machines shows as ranges over the working modes."""


def _grouped(records: Sequence[Record], *keys: str) -> dict[tuple[Any, ...], list[Record]]:
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for record in records:
        groups.setdefault(tuple(record[key] for key in keys), []).append(record)
    return groups


def _beyond(chapter: Mapping[str, Any]) -> dict[str, Table]:
    plans, modes = chapter["plans"], chapter["working_modes"]
    peaks = [Column(method, value=_worst_by(method)) for method in (modes[0]["rows"] if modes else ())]
    ratio = Column("ratio", "least peak over no carriers", format=".2f")
    shown = {name: table(name, chapter[name]) for name in ("targets", "fastest", "backends", "first_guesses")}
    for name, tasks in (("singular", SINGULAR), ("turns", TURNS)):
        chosen = [record for record in plans if record["task"] in {task.name for task in tasks}]
        shown[f"{name}_limits"] = table("plans_limits", chosen)
        shown[f"{name}_costs"] = table("plans_costs", [record for record in chosen if record["exists"]])
    return shown | {
        "headline": beyond.headline(plans),
        "findings": table("findings", chapter["findings"], "beyond the thesis: planning over the whole trajectory"),
        "beyond_modes": table("beyond_modes", modes, more=[*peaks, ratio]),
        "trade_off": table("trade_off", [{**one, **point} for one in chapter["trade_off"] for point in one["points"]]),
    }


def _worst_by(method: str) -> Callable[[Record], str]:
    def cell(record: Record) -> str:
        row = record["rows"][method]
        shown = f"{row['worst']:.2f}" if row["exists"] else ""
        return shown if row["sound"] else f"{shown} ({row['status']})".strip()

    return cell


# --- one HTML file: no network, no file beside it, no script --------------------------------------------------------

VERDICTS = {
    "reproduced": "good",
    "reproduced:": "partly",
    "differs:": "bad",
    "met": "good",
    "missed": "bad",
    "stands": "good",
    "stands with conditions": "partly",
    "does not stand": "bad",
}
"""Class of a cell by its verdict; a colon is followed by a condition or reason."""


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
    for index, (token, inner) in enumerate(pairwise(tokens)):
        if token.type == "heading_open":
            anchor = f"s{index}-" + re.sub(r"[^a-z0-9]+", "-", inner.content.lower()).strip("-")
            token.attrSet("id", anchor)
            title = inner.content if token.tag == "h1" else title
            headings += [(anchor, inner.content)] if token.tag == "h2" else []
        elif token.type == "td_open":
            head, colon, _ = inner.content.partition(":")
            token.attrs = {"class": VERDICTS[head + colon]} if head + colon in VERDICTS else {}
    body = renderer.renderer.render(tokens, renderer.options, {})
    page = jinja2.Environment(loader=jinja2.PackageLoader("redundancy_pin.studies", ""), autoescape=True)
    return page.get_template("page.html.j2").render(title=title, headings=headings, body=body)


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
