"""What is worth knowing of a result: plain data by name, which prints itself as tables and warnings."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # rich is imported where something is printed
    from rich.table import Table

WIDTH = 140
"""Columns of a table that does not go to a terminal: rich would take 80 and cut numbers."""

_ROUNDING = 1e-12  # coordinates and directions below this are shown as zero


@dataclass(frozen=True)
class TextTable:
    """Rows of text, shown as they stand.

    Attributes:
        title: above the table.
        rows: cells of each row; any iterable is kept as a tuple.
        headings: of the columns; no head when left out.
        left: how many of the columns with a heading are aligned to the left; all when left out.
        caption: below the table.
        colours: names of colours of rich by the cell that has one on a terminal.
    """

    title: str
    rows: Iterable[Sequence[str]]
    headings: Sequence[str] = ()
    left: int | None = None
    caption: str = ""
    colours: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Keep the rows of an iterator."""
        object.__setattr__(self, "rows", tuple(self.rows))

    def terminal(self) -> Table:
        """Return the table for a rich console."""
        from rich.table import Table
        from rich.text import Text

        caption = Text(self.caption) if self.caption else None
        table = Table(title=Text(self.title), show_header=bool(self.headings), caption=caption)
        table.caption_justify = "left"
        for place, heading in enumerate(self.headings):
            table.add_column(heading, justify="left" if self.left is None or place < self.left else "right")
        for cells in self.rows:
            table.add_row(*(Text(cell, self.colours.get(cell, "")) for cell in cells))
        return table


class Summary(dict[str, Any]):
    """Facts of a result by name, SI units; ``print`` shows them as tables, with what is wrong below.

    Attributes:
        tables: for people; each has the facts that fit.
        warnings: what is wrong, a sentence each.

    Example:
        >>> print(rp.load_plan("plan.npz").summary())
    """

    def __init__(self, facts: Mapping[str, Any], *tables: TextTable, warnings: Iterable[str] = ()) -> None:
        super().__init__(facts)
        self.tables, self.warnings = tables, list(warnings)

    def __str__(self) -> str:
        """Return the tables as plain text, and the warnings."""
        from rich.console import Console

        text = io.StringIO()
        for table in self.tables:
            Console(file=text, width=WIDTH, markup=False, emoji=False, highlight=False).print(table.terminal())
        return text.getvalue() + "".join(f"warning: {each}\n" for each in self.warnings)


def number(value: float) -> str:
    """Return a number with six digits, rounding to zero what is rounding of a number of size one."""
    return f"{0.0 if abs(value) < _ROUNDING else value:.6g}"


def row(values: Iterable[float], between: str = ", ") -> str:
    """Return numbers side by side."""
    return between.join(number(float(value)) for value in values)


def listed(texts: Sequence[str], most: int, between: str) -> str:
    """Return texts one after another; of more than ``most`` the rest is counted."""
    rest = [f"and {len(texts) - most} more"] if len(texts) > most else []
    return between.join([*texts[:most], *rest])
