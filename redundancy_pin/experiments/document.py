"""A report as a list of blocks, apart from how it is written (Markdown, HTML)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True)
class FileLink:
    """A file of the results folder, as a table cell. A self-contained report shows its text alone.

    Attributes:
        text: what to show.
        path: relative to the folder.
    """

    text: str
    path: str


Cell: TypeAlias = "str | FileLink"


@dataclass(frozen=True)
class Heading:
    """A heading: level 1 is the title, 2 a section, 3 a part of one."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """Plain text."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """A list of plain texts."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Attributes:
        headings: of the columns.
        rows: one text or link a column.
        caption: what it shows; may be empty.
    """

    headings: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure of the results folder.

    Attributes:
        path: the PNG file, relative to the folder.
        caption: what it shows, and from which run.
    """

    path: str
    caption: str


Block: TypeAlias = "Heading | Paragraph | Bullets | Table | Picture"


def table(headings: Sequence[str], rows: Sequence[Sequence[Cell]], caption: str = "") -> Table:
    """Return a table from any sequences."""
    return Table(tuple(headings), tuple(tuple(row) for row in rows), caption)
