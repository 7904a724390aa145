"""A study as text: a table of its cells, all trials as CSV."""

from __future__ import annotations

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
                f"{1e3 * cell.worst:.2f}",
                _interval(cell.rms, 1e3, 2),
                f"{cell.effort:.2f}",
                f"{cell.carrier_force:.2f}",
                ended + (f", gave up at {100.0 * cell.given_up:.1f} % of the readings" if cell.given_up else ""),
            )
        )
    caption = (
        f"Success: the simulation reached its end with the platform never farther than {1e3 * SUCCESS:g} mm from its "
        "plan. In brackets 95 % intervals: Wilson's for rates, of the bootstrap for means."
    )
    return table(HEADINGS, rows, caption)


def study_csv(study: Study) -> str:
    """Return all trials as CSV."""
    names = [name for name in Trial.__dataclass_fields__ if name != "reason"]
    columns = {name: np.array([getattr(trial, name) for trial in study.trials]) for name in names}
    columns["scenario"] = np.array([trial.scenario.replace(",", ";") for trial in study.trials])
    return csv_text({**columns, "success": np.array([int(trial.success) for trial in study.trials])})


def _interval(found: Interval, factor: float, digits: int) -> str:
    low, high = factor * found.low, factor * found.high
    return f"{factor * found.value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
