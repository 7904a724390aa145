"""Blocks of a report as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from redundancy_pin.experiments.document import Block, Bullets, Cell, FileLink, Heading, Paragraph, Picture, Table


def markdown(blocks: Sequence[Block]) -> str:
    """Return a report as Markdown; pictures are links to files of the same folder."""
    return "\n\n".join(_block(block) for block in blocks) + "\n"


def _block(block: Block) -> str:
    match block:
        case Heading(text, level):
            return f"{'#' * level} {text}"
        case Paragraph(text):
            return text
        case Bullets(items):
            return "\n".join(f"- {item}" for item in items)
        case Picture(path, caption):
            return f"![{caption}]({path})\n\n{caption}"
        case Table(headings, rows, caption):
            lines: list[Sequence[Cell]] = [headings, ["---"] * len(headings), *rows]
            text = "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)
            return f"{caption}\n\n{text}" if caption else text


def _cell(cell: Cell) -> str:
    if isinstance(cell, FileLink):
        return f"[{cell.text}]({cell.path})"
    return cell.replace("|", "\\|")
