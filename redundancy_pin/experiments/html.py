"""Blocks of a report as one HTML file that needs nothing else: no network, no file beside it, no script."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

from redundancy_pin.errors import OutputError
from redundancy_pin.experiments.document import Block, Bullets, Cell, FileLink, Heading, Paragraph, Picture, Table

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; margin: 0 auto; padding: 2rem 1.5rem;
  max-width: 72rem; }
h1 { font-size: 1.8rem; margin: 0 0 .5rem; }
h2 { font-size: 1.35rem; margin: 2.6rem 0 .6rem; padding-top: .6rem; border-top: 1px solid #d5d5d5; }
h3 { font-size: 1.08rem; margin: 1.8rem 0 .4rem; }
p, li { max-width: 50rem; }
nav { margin: 1.2rem 0; padding: .7rem 1rem; background: #f6f6f6; border-radius: 4px; columns: 2; }
nav a { display: block; color: #0b4f8a; text-decoration: none; }
nav a:hover { text-decoration: underline; }
.scroll { overflow-x: auto; margin: .8rem 0 1.2rem; }
table { border-collapse: collapse; font-size: .84rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; padding: .3rem 0; color: #444; max-width: 50rem; }
th, td { text-align: left; vertical-align: top; padding: .28rem .6rem; border-bottom: 1px solid #e4e4e4; }
thead th { border-bottom: 2px solid #888; background: #fff; }
tbody tr:nth-child(even) { background: #fafafa; }
td.good { box-shadow: inset 4px 0 #009e73; }
td.partly { box-shadow: inset 4px 0 #8fd3bf; }
td.bad { box-shadow: inset 4px 0 #d55e00; }
.mode { white-space: nowrap; }
figure { margin: 1.2rem 0 1.8rem; }
figure img { max-width: 100%; height: auto; }
figcaption { color: #333; font-size: .88rem; max-width: 50rem; }
@media (max-width: 45rem) { nav { columns: 1; } }
@media print { nav { display: none; } h2 { break-after: avoid; } figure, tr { break-inside: avoid; } }
"""


_VERDICTS = {
    "reproduced": ' class="good"',
    "reproduced:": ' class="partly"',
    "differs:": ' class="bad"',
    "met": ' class="good"',
    "missed:": ' class="bad"',
    "stands": ' class="good"',
    "stands with conditions": ' class="partly"',
    "does not stand": ' class="bad"',
}
"""Colour of a cell by its verdict; a colon is followed by a condition or reason."""


def html(blocks: Sequence[Block], folder: Path) -> str:
    """Return a report as a self-contained HTML page.

    Args:
        blocks: the report; its first heading becomes the title.
        folder: where the pictures are; they are embedded.

    Raises:
        OutputError: a picture cannot be read.
    """
    headings = [block for block in blocks if isinstance(block, Heading)]
    title = headings[0].text if headings else "Report"
    body: list[str] = []
    numbers = iter(range(len(blocks)))
    for block in blocks:
        body.append(_block(block, folder, next(numbers)))
        if block is headings[0]:
            body.append(_contents(blocks))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def _contents(blocks: Sequence[Block]) -> str:
    entries = [
        f'<a href="#{_anchor(block.text, index)}">{escape(block.text)}</a>'
        for index, block in enumerate(blocks)
        if isinstance(block, Heading) and block.level == 2
    ]
    return f'<nav aria-label="Contents">{"".join(entries)}</nav>'


def _block(block: Block, folder: Path, index: int) -> str:
    match block:
        case Heading(text, level):
            return f'<h{level} id="{_anchor(text, index)}">{escape(text)}</h{level}>'
        case Paragraph(text):
            return f"<p>{_text(text)}</p>"
        case Bullets(items):
            return "<ul>" + "".join(f"<li>{_text(item)}</li>" for item in items) + "</ul>"
        case Picture(path, caption):
            image = f'<img src="{_embedded(folder / path)}" alt="{escape(caption, quote=True)}" loading="lazy">'
            return f"<figure>{image}<figcaption>{_text(caption)}</figcaption></figure>"
        case Table(headings, rows, caption):
            head = "".join(f'<th scope="col">{_text(heading)}</th>' for heading in headings)
            lines = "".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>" for row in rows)
            said = f"<caption>{_text(caption)}</caption>" if caption else ""
            return (
                f'<div class="scroll"><table>{said}<thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table></div>'
            )


def _cell(cell: Cell) -> str:
    text = cell.text if isinstance(cell, FileLink) else cell
    return f"<td{_VERDICTS.get(text.partition(':')[0] + text.partition(':')[1], '')}>{_text(text)}</td>"


def _text(text: str) -> str:
    """Return text with ``code`` between backquotes set as such, and working modes that no line break splits."""
    coded = re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text, quote=False))
    return re.sub("([+\u2212]{2,})", r'<span class="mode">\1</span>', coded)


def _anchor(text: str, index: int) -> str:
    return f"s{index}-" + re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def _embedded(path: Path) -> str:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise OutputError(f"Cannot read {path}: {error.strerror or error}.", path=str(path)) from error
    return "data:image/png;base64," + base64.b64encode(content).decode("ascii")
