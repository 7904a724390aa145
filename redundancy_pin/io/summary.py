"""What is worth knowing of a result: plain data by name, which prints itself as tables and warnings."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # rich is imported where something is printed
    from rich.table import Table

WIDTH = 140
"""Columns of a table that does not go to a terminal: rich would take 80 and cut numbers."""

_ROUNDING = 1e-12  # coordinates and directions below this are shown as zero


@dataclass
class TextTable:
    """Rows of text, without a head where there are no headings; columns of ``numbers`` stand to the right."""

    title: str
    rows: list[Sequence[str]]
    headings: Sequence[str] = ()
    numbers: bool = False

    def terminal(self) -> Table:
        """Return the table for a rich console."""
        from rich.table import Table

        table = Table(title=self.title, show_header=bool(self.headings))
        for place, heading in enumerate(self.headings):
            table.add_column(heading, justify="right" if self.numbers and place else "left")
        for cells in self.rows:
            table.add_row(*cells)
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
        self.tables, self.warnings = list(tables), list(warnings)

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
