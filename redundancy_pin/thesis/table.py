"""Records as tables: columns by name in ``tables.yaml``, or given in code; as Markdown, CSV or on a terminal."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from redundancy_pin.errors import InputError
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.trajectory.csv_file import csv_rows

if TYPE_CHECKING:
    from rich.table import Table as TerminalTable

NONE = "–"
"""Stands for a number that does not exist."""

Record: TypeAlias = dict[str, Any]
"""A row: plain values by the name of their column."""


@functools.cache
def data(name: str) -> Mapping[str, Any]:
    """Return the content of a data file of this package: "tables", "thesis" or "claims"."""
    content: Mapping[str, Any] = read_yaml(Path(__file__).with_name(f"{name}.yaml"), InputError).data
    return content


@dataclass(frozen=True)
class Column:
    """A column; its name is the key of its values in records, CSV and JSON. ``value`` makes a cell of a record."""

    name: str
    title: str = ""
    format: str = ".3g"
    value: Callable[[Record], Any] | None = None

    @property
    def heading(self) -> str:
        """Heading of the column."""
        return self.title or self.name

    def cell(self, record: Record) -> Any:
        """Return the value of the column in a record."""
        return self.value(record) if self.value else entry(self.name, record)


@dataclass(frozen=True)
class Table:
    """Records under headings, with a title; entries that no column names are not shown."""

    columns: tuple[Column, ...]
    records: tuple[Record, ...]
    title: str = ""

    def only(self, *names: str) -> Table:
        """Return the table with some of its columns."""
        return replace(self, columns=tuple(column for column in self.columns if column.name in names))

    @property
    def texts(self) -> list[list[str]]:
        """Cells as texts."""
        return [[text(column.cell(record), column.format) for column in self.columns] for record in self.records]

    def markdown(self) -> str:
        """Return a table of GitHub's Markdown, without its title."""
        lines = [[column.heading.replace("|", "\\|") for column in self.columns], ["---"] * len(self.columns)]
        for record, texts in zip(self.records, self.texts, strict=True):
            cells = [column.cell(record) for column in self.columns]
            shown = [part.replace("|", "\\|") for part in texts]
            links = [f"[{cell.text}]({cell.path})" if isinstance(cell, Link) else "" for cell in cells]
            lines.append([link or part for link, part in zip(links, shown, strict=True)])
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)

    def terminal(self) -> TerminalTable:
        """Return the table for a rich console."""
        from rich.table import Table as TerminalTable

        shown = TerminalTable(title=self.title or None)
        for column in self.columns:
            shown.add_column(column.heading, overflow="fold")
        for row in self.texts:
            shown.add_row(*row)
        return shown


@dataclass(frozen=True)
class Link:
    """A cell that links to a file of the results folder."""

    text: str
    path: str

    def __str__(self) -> str:
        """Return the text."""
        return self.text


def records_csv(names: Sequence[str], records: Sequence[Record], digits: int | None = None) -> str:
    """Return entries of records as CSV text; floats to some significant digits, or exactly."""
    return csv_rows({name: ("", np.array([record[name] for record in records])) for name in names}, digits=digits)


def text(value: Any, form: str = ".3g") -> str:
    """Return a value as a cell: numbers formatted, several of them joined, a dash for None and NaN."""
    if value is None:
        return NONE
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return NONE if math.isnan(value) else "unbounded" if math.isinf(value) else f"{value:{form}}"
    if isinstance(value, (tuple, list, np.ndarray)):
        return ", ".join(text(part, form) for part in value)
    return str(value)


def span(values: Sequence[float], form: str = ".3g") -> str:
    """Return the range of the values that are numbers, ``"0.2 to 0.4"``; one number if both ends print the same."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return NONE
    low, high = text(min(known), form), text(max(known), form)
    return low if low == high else f"{low} to {high}"


def table(name: str, records: Sequence[Record], title: str = "", more: Sequence[Column] = ()) -> Table:
    """Return records as the table of a name in ``tables.yaml``, followed by further columns."""
    columns = []
    for key, shown in data("tables")[name].items():
        heading, kind, form = re.fullmatch(r"(.*?)(?: ([:=])(\S+))?", shown).groups()  # type: ignore[union-attr]
        columns.append(Column(key, heading, form if kind == ":" else ".3g", CELLS[form] if kind == "=" else None))
    return Table((*columns, *more), tuple(records), title)


def entry(key: str, record: Record) -> Any:
    """Return an entry of a record; a dot leads into a nested record, None if it is missing."""
    first, _, rest = key.partition(".")
    return entry(rest, record.get(first) or {}) if rest else record.get(first)


def grouped(records: Sequence[Record], *keys: str) -> dict[tuple[Any, ...], list[Record]]:
    """Return records by their entries of some keys, in order."""
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for record in records:
        groups.setdefault(tuple(record[key] for key in keys), []).append(record)
    return groups


def mode_text(mode: Sequence[int]) -> str:
    """Return a working mode as text: ``"++−"``."""
    return "".join("+" if sign > 0 else "\u2212" for sign in mode)


def _peak(record: Record) -> str:
    before = "" if math.isnan(record["before"]) else f" ({record['before']:.3g} until off)"
    return text(record["peak"]) + before if record["exists"] else "none"


def _of(value: str, limit: str) -> Callable[[Record], str]:
    return lambda record: NONE if math.isnan(record[limit]) else f"{record[value]:.3f} of {record[limit]:g}"


CELLS: Mapping[str, Callable[[Record], Any]] = {
    "counts": lambda record: ", ".join(f"{name} {count}" for name, count in record["statuses"].items()),
    "with_reason": lambda record: ": ".join(part for part in (record["verdict"], record["reason"]) if part),
    "mode": lambda record: mode_text(record["mode"]),
    "met": lambda record: "met" if record["met"] else "missed",
    "effort_limit": lambda record: "none" if math.isinf(record["effort_limit"]) else record["effort_limit"],
    "method": lambda record: Link(record["way"], f"{record['file']}.npz") if record["file"] else record["way"],
    "peak": _peak,
    "position": _of("position", "track"),
    "speed": _of("speed", "speed_limit"),
    "acceleration": _of("acceleration", "acceleration_limit"),
}
"""Cells that are more than an entry of a record; ``tables.yaml`` names them."""
