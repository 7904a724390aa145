"""Records as tables, columns by name in ``tables.yaml``: as Markdown or on a terminal."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from redundancy_pin.errors import InputError
from redundancy_pin.io.yaml_file import read_yaml

if TYPE_CHECKING:
    from rich.table import Table as TerminalTable

NONE = "–"
"""Stands for a number that does not exist."""

Record: TypeAlias = dict[str, Any]
"""A row: plain values by the name of their column."""


@functools.cache
def data(name: str) -> Mapping[str, Any]:
    """Return the content of a data file of this package, "tables" or "thesis"."""
    content: Mapping[str, Any] = read_yaml(Path(__file__).with_name(f"{name}.yaml"), InputError).data
    return content


@dataclass(frozen=True)
class Table:
    """Texts under headings, with a title; ``names`` are the keys of the columns. Links are ``[text](path)``."""

    names: tuple[str, ...]
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""

    def markdown(self) -> str:
        """Return a table in GitHub's Markdown, without its title."""
        lines = [self.headings, ("---",) * len(self.headings), *self.rows]
        return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)

    def only(self, *names: str) -> Table:
        """Return the table with some of its columns."""
        places = [i for i, name in enumerate(self.names) if name in names]
        kept = [tuple(line[i] for i in places) for line in (self.names, self.headings, *self.rows)]
        return Table(kept[0], kept[1], tuple(kept[2:]), self.title)

    def terminal(self) -> TerminalTable:
        """Return the table for a rich console, without links."""
        from rich.table import Table as TerminalTable

        shown = TerminalTable(title=self.title or None)
        for heading in self.headings:
            shown.add_column(heading, overflow="fold")
        for row in self.rows:
            shown.add_row(*(re.sub(r"\[(.*)\]\(\S+\)", r"\1", cell) for cell in row))
        return shown


def table(name: str, records: Sequence[Record], title: str = "", more: Sequence[str] = ()) -> Table:
    """Return records as the table of a name in ``tables.yaml``, followed by further columns, named by their keys."""
    columns = {**data("tables")[name], **{key: key for key in more}}
    shown = [re.fullmatch(r"(.*?)(?: ([:=])(\S+))?", heading).groups() for heading in columns.values()]  # type: ignore[union-attr]
    rows = tuple(
        tuple(
            text(CELLS[form](record) if kind == "=" else entry(key, record), ".3g" if kind != ":" else form)
            for key, (_, kind, form) in zip(columns, shown, strict=True)
        )
        for record in records
    )
    return Table(tuple(columns), tuple(heading for heading, _, _ in shown), rows, title)


def entry(key: str, record: Record) -> Any:
    """Return an entry of a record; a dot leads into a nested record, None if it is missing."""
    first, _, rest = key.partition(".")
    return entry(rest, record.get(first) or {}) if rest and key not in record else record.get(key)


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


def _of(value: str, limit: str) -> Callable[[Record], Any]:
    return lambda record: None if math.isnan(record[limit]) else f"{record[value]:.3f} of {record[limit]:g}"


CELLS: Mapping[str, Callable[[Record], Any]] = {
    "counts": lambda record: ", ".join(f"{name} {count}" for name, count in record["statuses"].items()),
    "with_reason": lambda record: ": ".join(part for part in (record["verdict"], record["reason"]) if part),
    "mode": lambda record: mode_text(record["mode"]),
    "met": lambda record: "met" if record["met"] else "missed",
    "method": lambda record: f"[{record['way']}]({record['file']}.npz)" if record["file"] else record["way"],
    "motion": lambda record: f"[{record['name']}]({record['name']}.csv)",
    "peak": _peak,
    "position": _of("position", "track"),
    "speed": _of("speed", "speed_limit"),
    "acceleration": _of("acceleration", "acceleration_limit"),
}
"""Cells that are more than an entry of a record; ``tables.yaml`` names them."""
