"""Columns as the text of a CSV file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

EXACT = None
"""Number of digits that brings every float back bit by bit."""


def csv_text(columns: Mapping[str, NDArray[Any]], digits: int | None = EXACT) -> str:
    """Return a CSV table: a row of names, then one row a sample, comma separated; NaN as ``nan``.

    Args:
        columns: by name: (N,) numbers or texts, or (N, c) numbers, which become name0, name1, ....
        digits: significant digits of numbers; the shortest text that brings the float back when left out.
    """
    names: list[str] = []
    cells: list[list[str]] = []
    for name, values in columns.items():
        table = np.asarray(values)
        parts = [table] if table.ndim == 1 else list(table.T)
        names += [name] if table.ndim == 1 else [f"{name}{i}" for i in range(len(parts))]
        cells += [_texts(part, digits) for part in parts]
    rows = (",".join(row) for row in zip(*cells, strict=True))
    return "\n".join([",".join(names), *rows]) + "\n"


def _texts(values: NDArray[Any], digits: int | None) -> list[str]:
    if values.dtype.kind in "US":
        return [str(value) for value in values.tolist()]
    if digits is None:
        return [repr(value) for value in values.tolist()]
    return [f"{value:.{digits}g}" for value in values.tolist()]
