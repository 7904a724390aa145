"""The report: tables of what came out, put into the page ``report.md.j2``; and that page as one HTML file."""

from __future__ import annotations

import base64
import functools
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import jinja2
from markdown_it import MarkdownIt
from markdown_it.common.utils import escapeHtml
from markdown_it.token import Token

from redundancy_pin.errors import OutputError
from redundancy_pin.studies.beyond import headline
from redundancy_pin.studies.cases import SINGULAR, TURNS, mode_text
from redundancy_pin.studies.claims import environment
from redundancy_pin.studies.figures import Picture, pictures
from redundancy_pin.studies.motions import MotionRun
from redundancy_pin.studies.results import NOTES, Results, versions
from redundancy_pin.studies.table import NONE, Column, Link, Record, Table, span, text

PARITY = tuple(
    Column(name, title, format=".1e")
    for name, title in (
        ("position", "s"),
        ("speed", "ṡ"),
        ("acceleration", "s̈"),
        ("tau", "τ"),
        ("carrier_force", "carrier force"),
    )
)


def report(results: Results) -> str:
    """Return the report as Markdown; pictures and files are links into the folder."""
    template = environment(jinja2.PackageLoader("redundancy_pin.studies", "")).get_template("report.md.j2")
    shown = tables(results)
    return template.render(
        results=results,
        tables=shown,
        pictures=pictures(results),
        versions=versions(),
        notes=NOTES,
        mode_text=mode_text,
        **{name: results.chapters.get(name) for name in ("planned", "beyond", "replay")},
    )


# --- tables --------------------------------------------------------------------------------------------------------


def tables(results: Results) -> dict[str, Table]:
    """Return every table of what was run, by name."""
    shown = {
        "cross_check": _cross_check(results),
        "motions": motions_table(results.runs),
        "thesis": _thesis(results.compared),
    }
    chapters = results.chapters
    if "planned" in chapters:
        shown |= _planned(chapters["planned"], results)
    if "beyond" in chapters:
        shown |= _beyond(chapters["beyond"])
    if "replay" in chapters:
        shown["replays"] = _replays(chapters["replay"]["replays"])
    return shown


def _cross_check(results: Results) -> Table:
    columns = [
        Column("robot"),
        Column("check"),
        Column("samples", "states"),
        Column("worst", format=".1e"),
        Column("tolerance", "allowed", format=".0e"),
        Column("passed"),
    ]
    return Table.of(columns, [vars(row) for row in results.check.rows])


def motions_table(runs: Sequence[MotionRun]) -> Table:
    """Return the motions without a planner, one a row."""
    columns = [
        Column("name", "experiment"),
        Column("duration", "time", "s", ".3f"),
        Column("samples"),
        Column("parity", "parity of the backends", format=".1e", value=lambda record: record["parity"]["worst"]),
        Column("smallest_margin", "smallest margin"),
        Column("statuses", "samples by status", value=_counts),
        Column("statement", "efforts"),
    ]
    records = [{**run.record(), "name": Link(run.case.name, f"{run.case.name}.csv")} for run in runs]
    return Table.of(columns, records, "experiments: Pinocchio (RNEA) against virtual work")


def _counts(record: Record) -> str:
    return ", ".join(f"{name} {count}" for name, count in record["statuses"].items())


def _thesis(compared: Sequence[Record]) -> Table:
    columns = [
        Column("source", "where"),
        Column("experiment"),
        Column("quantity"),
        Column("stated"),
        Column("computed"),
        Column("unit"),
        Column("note", "remark"),
    ]
    return Table.of(columns, compared, "what the thesis states (Parsa 2014), and what comes out here")


def _claims(records: Sequence[Record], title: str) -> Table:
    return Table.of([Column("claim"), Column("stands", "verdict"), Column("here")], records, title)


def _with_reason(record: Record) -> str:
    return f"{record['verdict']}: {record['reason']}" if record["reason"] else record["verdict"]


def _planned(chapter: Mapping[str, Any], results: Results) -> dict[str, Table]:
    first = results.extent.modes[0]
    judged = [
        Column("source", "where"),
        Column("condition"),
        Column("quantity"),
        Column("stated"),
        Column("ours"),
        Column("deviation"),
        Column("range", "range over"),
        Column("verdict", value=_with_reason),
    ]
    mode = Column("mode", value=lambda record: mode_text(record["mode"]))
    holds = [Column(name, value=_holds_in(name)) for name in chapter["claims"][0]["modes"]]
    crossing = [
        Column("case", "run"),
        Column("status"),
        Column("broken", "limits broken (m, m/s, m/s²)"),
        Column("beyond_track_at_exit", "beyond the track when switched on", "m", ".3f"),
        Column("beyond_track", "at worst", "m", ".3f"),
        Column("shortest", "shortest return within limits", "s", ".3f"),
        Column("jump", "jump of forces, exact", "N", ".1g"),
        Column("jump_of_differences", "by backward differences", "N", ".2g"),
        Column("peak_on_return", "peak on the return", "N"),
    ]
    energies = [
        Column("main_energy", "energy, base", "J"),
        Column("carrier_energy", "carriers", "J"),
        Column("energy", "all", "J"),
    ]
    fair = [
        Column("motion"),
        Column("what", "carriers"),
        Column("peak", "peak |τ|"),
        Column("unit"),
        Column("rms", "rms |τ|"),
        Column("carrier_force", "peak carrier force", "N"),
        *energies,
        Column("status"),
    ]
    ranged = ("peak", "rms", "carrier_force", "main_energy", "energy")
    headings = {column.name: column.heading for column in fair}
    over_modes = [
        {"motion": motion, "what": what, **{name: span([record[name] for record in same]) for name in ranged}}
        for (motion, what), same in _grouped(chapter["fair_comparison"], "motion", "what", "mode").items()
    ]
    sensitive = [
        {
            "case": case,
            "quantity": quantity,
            "ours": same[0]["ours"],
            "ranges": "; ".join(f"{entry['parameter']}: {span((entry['low'], entry['high']))}" for entry in same),
        }
        for (case, quantity), same in _grouped(chapter["sensitivity"], "case", "quantity").items()
    ]
    return {
        "conclusions": _claims(chapter["conclusions"], "the thesis's conclusions"),
        "judged": Table.of(judged, chapter["against_thesis"], "planned experiments against the thesis (Parsa 2014)"),
        "modes": Table.of(
            [mode, Column("case", "run"), Column("baseline_peak", "peak |τ| without carriers", "N·m"),
             Column("peak", "peak |τ|", "N·m"), Column("rms", "rms τ", "N·m"),
             Column("limits", "limits met (carrier, which, when first)"), Column("status")],
            chapter["working_modes"],
        ),
        "mode_claims": Table.of(
            [Column("source", "where"), Column("text", "statement holds in"), *holds], chapter["claims"]
        ),
        "between": Table.of(
            [Column("case", "run"), Column("baseline", "peak |τ| without carriers", "N·m"),
             Column("at_samples", "at the samples", "N·m"), Column("between", "between them", "N·m")],
            chapter["between_samples"],
        ),
        "returns": Table.of(
            [mode, Column("lam", "λ"), Column("durations", "shortest returns", "s"),
             Column("why", "why there is none")],
            chapter["shortest_returns_on_square"],
        ),
        "fair": Table.of(fair, [entry for entry in chapter["fair_comparison"] if entry["mode"] in ((), first)]),
        "fair_over_modes": Table.of(
            [Column("motion"), Column("what", "carriers"), *(Column(name, headings[name]) for name in ranged)],
            over_modes,
        ),
        "crossings": Table.of(crossing, chapter["crossings"]),
        "sensitivity": Table.of(
            [Column("case", "run"), Column("quantity"), Column("ours", "this run"), Column("ranges", "range over")],
            sensitive,
        ),
        "parity": Table.of([Column("case", "run"), *PARITY, Column("status")], chapter["parity"]),
    }  # fmt: skip


def _holds_in(mode: str) -> Callable[[Record], bool]:
    return lambda record: bool(record["modes"][mode]["holds"])


def _worst_by(method: str) -> Callable[[Record], str]:
    return lambda record: _marked(record["rows"][method])


def _grouped(records: Iterable[Record], *keys: str) -> dict[tuple[Any, Any], list[Record]]:
    """Return records by two keys; those without a value of a third one are left out."""
    groups: dict[tuple[Any, Any], list[Record]] = {}
    for record in records:
        if len(keys) < 3 or record[keys[2]]:
            groups.setdefault((record[keys[0]], record[keys[1]]), []).append(record)
    return groups


def _beyond(chapter: Mapping[str, Any]) -> dict[str, Table]:
    target = [
        Column("task", "motion"),
        Column("way", "plan"),
        Column("asked", "largest effort aimed at"),
        Column("found", "at the nodes"),
        Column("between", "between them"),
        Column("unit"),
        Column("met", "verdict", value=lambda record: "met" if record["met"] else "missed"),
    ]
    race = [
        Column("title", "motion"),
        Column("effort_limit", "limit of main forces"),
        Column("speed", "fastest with a plan", "m/s", ".3f", lambda record: record["fastest_with_plan"]["speed"]),
        Column("peak", "its peak force", "N", value=lambda record: record["fastest_with_plan"]["peak"]),
        Column("binding", "limits it touches", value=lambda record: record["fastest_with_plan"]["binding"]),
        Column("above", "slowest without", "m/s", ".3f", lambda record: _above(record)["speed"]),
        Column("why", "why there is none", value=lambda record: _above(record)["said"] or _above(record)["status"]),
        Column("suffices", "does what would suffice?"),
    ]
    modes = chapter["working_modes"]
    methods = list(modes[0]["rows"]) if modes else []
    peaks = [Column(method, value=_worst_by(method)) for method in methods]
    starts = [
        Column("case", "plan"),
        Column("step", "largest step", "s"),
        Column("costs", "guesses", value=lambda record: len(record["costs"])),
        Column("missing", "without a plan"),
        Column("best", "best cost", format=".6g"),
        Column("excess", "worst above best", format=".1e"),
        Column("optima"),
        Column("parked_is_best", "parked carriers lead to the best known"),
    ]
    points = [{**trade, **point} for trade in chapter["trade_off"] for point in trade["points"]]
    trade = [
        Column("task", "motion"),
        Column("ratio", "weight"),
        Column("weight", "w"),
        Column("rms_effort", "rms |τ|", format=".4g"),
        Column("rms_acceleration", "rms s̈", "m/s²", ".4g"),
        Column("peak", "peak |τ|", format=".4g"),
        Column("unit"),
        Column("status"),
    ]
    backends = [Column("case", "plan"), *PARITY, Column("cost", format=".1e"), Column("statuses"), Column("same")]
    shown = {
        "headline": headline(chapter["plans"]),
        "findings": _claims(chapter["findings"], "beyond the thesis: planning over the whole trajectory"),
        "targets": Table.of(target, chapter["targets"]),
        "fastest": Table.of(race, chapter["fastest"]),
        "beyond_modes": Table.of(
            [Column("radius", unit="m"), Column("mode", value=lambda record: mode_text(record["mode"])), *peaks,
             Column("ratio", "least peak over no carriers", format=".2f")],
            modes,
        ),
        "backends": Table.of(backends, chapter["backends"]),
        "first_guesses": Table.of(starts, chapter["first_guesses"]),
        "trade_off": Table.of(trade, points),
    }  # fmt: skip
    for name, tasks in (("singular", SINGULAR), ("turns", TURNS)):
        chosen = {task.name for task in tasks}
        records = [record for record in chapter["plans"] if record["task"] in chosen]
        shown[f"{name}_limits"] = Table.of(LIMITS, records)
        shown[f"{name}_costs"] = Table.of(COSTS, [record for record in records if record["exists"]])
    return shown


def _above(race: Record) -> Record:
    """Return the slowest speed without a plan; the ramps may leave none to try."""
    none = {"speed": math.nan, "said": "the ramps have no room for faster motions", "status": ""}
    return race["slowest_without"] or none


def _marked(record: Record) -> str:
    shown = f"{record['worst']:.2f}" if record["exists"] else ""
    return shown if record["sound"] else f"{shown} ({record['status']})".strip()


def _of(value: str, limit: str) -> Callable[[Record], str]:
    return lambda record: NONE if math.isnan(record[limit]) else f"{record[value]:.3f} of {record[limit]:g}"


def _method(record: Record) -> str | Link:
    return Link(record["way"], f"{record['file']}.npz") if record["file"] and record["exists"] else record["way"]


def _peak(record: Record) -> str:
    before = "" if math.isnan(record["before"]) else f" ({record['before']:.3g} until off)"
    return text(record["peak"]) + before if record["exists"] else "none"


LIMITS = (
    Column("task", "motion"),
    Column("way", "planner", value=_method),
    Column("status"),
    Column("peak", "peak at the samples", value=_peak),
    Column("dense_peak", "peak between them"),
    Column("unit"),
    Column("position", "farthest carrier [m], of", value=_of("position", "track")),
    Column("speed", "fastest [m/s], of", value=_of("speed", "speed_limit")),
    Column("acceleration", "hardest [m/s²], of", value=_of("acceleration", "acceleration_limit")),
    Column("broken", "limits broken", value=lambda record: record["broken"] or ("none" if record["exists"] else "")),
)
COSTS = (
    Column("task", "motion"),
    Column("way", "planner"),
    Column("rms", "rms |τ|", "N or N·m"),
    Column("reversals"),
    Column("main_energy", "energy, main motors", "J"),
    Column("carrier_force", "peak carrier force", "N"),
    Column("carrier_energy", "energy, carriers", "J"),
    Column("energy", "energy, all", "J"),
)


def _replays(records: Sequence[Record]) -> Table:
    columns = [
        Column("plan"),
        Column("drive"),
        Column("status"),
        Column("largest", "largest error", "m", ".2g"),
        Column("rms", unit="m", format=".2g"),
        Column("last", "at the end", "m", ".2g"),
        Column("carrier_error", "carriers", "m", ".2g"),
        Column("carrier_lag", "carrier lag of the plan", "m", ".2g"),
        Column("off_track", "off the track", "m", ".2g"),
        Column("effort", "largest |τ|", "N or N·m", ".2g"),
        Column("carrier_force", "largest carrier force", "N", ".2g"),
    ]
    return Table.of(columns, records)


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
    """Return a report as a self-contained HTML page.

    Args:
        markdown: the report; its first heading becomes the title.
        folder: where the pictures are; they are embedded. Links to other files become text.

    Raises:
        OutputError: a picture cannot be read.
    """
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


def listing(chosen: Mapping[str, Sequence[Picture]]) -> list[Picture]:
    """Return the figures of all chapters in one list."""
    return [picture for chapter in chosen.values() for picture in chapter]
