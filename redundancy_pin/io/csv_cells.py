"""Texts in the cells of CSV files, which people open with spreadsheets: a name from a file is never a formula."""

from __future__ import annotations

import re

# What begins a formula in a cell of a spreadsheet, in full width too, and the apostrophe, which makes a cell plain text
_FORMULA = "['=+\\-@＝＋－＠]"
_NO_FORMULA = re.compile(r"[-+]*(\d[\d.]*(e[-+]?\d+)?|nan|inf)?")
_STARTS = "(^|[,;|\\t])"  # of a cell, also where a program divides at something else than commas


def escape_formula(text: str) -> str:
    """Return the name of a column, or another text of a cell, as no spreadsheet takes it for a formula.

    An apostrophe precedes each character that could begin a formula; ``unescape_formula`` removes it.
    """
    return re.sub(f"{_STARTS}(?={_FORMULA})", r"\1'", text)


def escape_value(text: str) -> str:
    """Return a text as ``escape_formula`` does, except numbers and working modes, which may begin with a sign."""
    return text if _NO_FORMULA.fullmatch(text) else escape_formula(text)


def unescape_formula(cell: str) -> str:
    """Return the text of a cell that ``escape_formula`` wrote."""
    return re.sub(f"{_STARTS}'(?={_FORMULA})", r"\1", cell)
