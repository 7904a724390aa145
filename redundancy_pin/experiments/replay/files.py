"""The files of the chapter: a table of all replays, and the figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from redundancy_pin.experiments.csv_text import csv_text
from redundancy_pin.experiments.replay.pictures import FIGURES
from redundancy_pin.experiments.replay.study import Replays
from redundancy_pin.io.files import write_text
from redundancy_pin.visualisation.figures.style import save

_COLUMNS = (
    "plan", "drive", "status", "largest", "rms", "last", "carrier_error", "carrier_lag", "off_track", "effort",
    "carrier_force", "gap",
)  # fmt: skip


def write_table(folder: Path, replays: Replays) -> None:
    """Write the table of all replays as CSV.

    Raises:
        OutputError: the file cannot be written.
    """
    columns = {name: np.array([getattr(row, name) for row in replays.rows]) for name in _COLUMNS}
    columns["plan"] = np.array([row.plan.replace(",", ";") for row in replays.rows])
    columns["drive"] = np.array([row.drive.replace(",", ";") for row in replays.rows])
    write_text(folder / "replay.csv", csv_text(columns, digits=4))


def write_figures(folder: Path, replays: Replays, suffixes: tuple[str, ...], told: Callable[[str], None]) -> None:
    """Write the figures.

    Raises:
        OutputError: a file cannot be written.
    """
    for figure in FIGURES:
        if replays.of(figure.case):
            save(figure.draw(replays), *(folder / f"{figure.stem}{suffix}" for suffix in suffixes))
        told(figure.title)
