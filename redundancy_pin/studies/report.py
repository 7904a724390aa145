"""The report: tables of what came out, put into the page ``report.md.j2``; and that page as one HTML file."""

from __future__ import annotations

import base64
import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import jinja2
import yaml
from markdown_it import MarkdownIt
from markdown_it.common.utils import escapeHtml
from markdown_it.token import Token

from redundancy_pin.errors import OutputError
from redundancy_pin.studies.beyond import headline
from redundancy_pin.studies.cases import SINGULAR, TURNS, mode_text
from redundancy_pin.studies.claims import environment
from redundancy_pin.studies.figures import pictures
from redundancy_pin.studies.results import NOTES, Results, versions
from redundancy_pin.studies.table import NONE, Column, Link, Record, Table, span, text


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
    data: Mapping[str, Any] = yaml.safe_load(files(__package__).joinpath("tables.yaml").read_text(encoding="utf-8"))
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
    fair, first = chapter["fair_comparison"], results.extent.modes[0]
    over_modes = [
        {"motion": motion, "what": what} | {key: span([record[key] for record in same]) for key in RANGED}
        for (motion, what), same in _grouped([record for record in fair if record["mode"]], "motion", "what").items()
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
        "fair_comparison": table("fair_comparison", [record for record in fair if record["mode"] in ((), first)]),
        "fair_over_modes": table("fair_over_modes", over_modes),
        "sensitivity": table("sensitivity", sensitive),
    }


RANGED = ("peak", "rms", "carrier_force", "main_energy", "energy")
"""What the fair comparison shows as ranges over the working modes."""


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
        "headline": headline(plans),
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
