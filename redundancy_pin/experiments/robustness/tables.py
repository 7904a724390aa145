"""A study as text: a table of its cells, all trials as CSV."""

from __future__ import annotations

import math

import numpy as np

from redundancy_pin.experiments.csv_text import csv_text
from redundancy_pin.experiments.document import Table, table
from redundancy_pin.experiments.robustness.statistics import Interval
from redundancy_pin.experiments.robustness.study import Study
from redundancy_pin.experiments.robustness.trial import SUCCESS, Trial

HEADINGS = (
    "crossing, plan",
    "drive",
    "draws",
    "success [%]",
    "largest error, mean [mm]",
    "worst [mm]",
    "rms error, mean [mm]",
    "largest main force [N]",
    "largest carrier force [N]",
    "how it ended",
)

NONE = "–"
"""Stands for a number that does not exist."""


def study_table(study: Study) -> Table:
    """Return a row for each cell."""
    rows = []
    for cell in study.cells:
        ended = ", ".join(f"{status} {count}" for status, count in cell.statuses.items())
        rows.append(
            (
                cell.scenario,
                cell.drive,
                str(cell.draws),
                _interval(cell.success, 100.0, 1),
                _interval(cell.largest, 1e3, 2),
                _number(cell.worst, 1e3, 2),
                _interval(cell.rms, 1e3, 2),
                _number(cell.effort, 1.0, 2),
                _number(cell.carrier_force, 1.0, 2),
                ended + (f", gave up at {100.0 * cell.given_up:.1f} % of the readings" if cell.given_up > 0.0 else ""),
            )
        )
    caption = (
        f"Success: the simulation reached its end with the platform never farther than {1e3 * SUCCESS:g} mm from its "
        "plan. In brackets 95 % intervals: Wilson's for rates, of the bootstrap for means."
    )
    intervals = [interval for cell in study.cells for interval in (cell.largest, cell.rms)]
    if any(math.isnan(interval.low) for interval in intervals):
        caption += f" {NONE}: none; an interval of a mean takes two simulated draws or more."
    return table(HEADINGS, rows, caption)


def study_csv(study: Study) -> str:
    """Return all trials as CSV."""
    names = [name for name in Trial.__dataclass_fields__ if name != "reason"]
    columns = {name: np.array([getattr(trial, name) for trial in study.trials]) for name in names}
    columns["scenario"] = np.array([trial.scenario.replace(",", ";") for trial in study.trials])
    return csv_text({**columns, "success": np.array([int(trial.success) for trial in study.trials])})


def _interval(found: Interval, factor: float, digits: int) -> str:
    """Return a value with its interval, a dash for either where there is none."""
    value = _number(found.value, factor, digits)
    if math.isnan(found.low) or math.isnan(found.high):
        return value if math.isnan(found.value) else f"{value} [{NONE}]"
    return f"{value} [{_number(found.low, factor, digits)}, {_number(found.high, factor, digits)}]"


def _number(value: float, factor: float, digits: int) -> str:
    return NONE if math.isnan(value) else f"{factor * value:.{digits}f}"
