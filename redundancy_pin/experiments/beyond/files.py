"""The files of the chapter: a table of all plans, the plans themselves, their curves as CSV, and figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from redundancy_pin.experiments.beyond.pictures import FIGURES, plan_of
from redundancy_pin.experiments.beyond.study import Beyond
from redundancy_pin.experiments.beyond.tasks import TASKS
from redundancy_pin.experiments.csv_text import csv_text
from redundancy_pin.io.files import write_text
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.figures.style import save

_CLOCK = ("seconds", "solver_seconds")
"""Diagnostics that differ from run to run; without them the same run writes the same bytes."""

_COLUMNS = (
    "task", "way", "unit", "status", "peak", "dense_peak", "before", "reversals", "rms", "carrier_force", "main_energy",
    "carrier_energy", "position", "speed", "acceleration",
)  # fmt: skip
"""Of the table of all plans; see ``Row``."""


def write_plans(folder: Path, beyond: Beyond, digits: int) -> None:
    """Write the table of all plans, and each plan of the chapter with its curves.

    Args:
        folder: where to.
        beyond: the chapter.
        digits: significant digits in CSV files.

    Raises:
        OutputError: a file cannot be written.
    """
    rows = beyond.rows
    write_text(
        folder / "beyond.csv", csv_text({name: np.array([getattr(row, name) for row in rows]) for name in _COLUMNS})
    )
    for task in TASKS:
        for row in beyond.of(task):
            if row.exists and row.file:
                plan = plan_of(beyond, task, row.way)
                kept = {key: value for key, value in plan.diagnostics.items() if key not in _CLOCK}
                replace(plan, diagnostics=kept).save(folder / f"{row.file}.npz")
                write_text(folder / f"{row.file}.csv", plan_csv(plan, digits))


def write_figures(folder: Path, beyond: Beyond, suffixes: tuple[str, ...], told: Callable[[str], None]) -> None:
    """Write the figures.

    Args:
        folder: where to.
        beyond: the chapter.
        suffixes: formats, ``(".png",)``.
        told: called after each.

    Raises:
        OutputError: a file cannot be written.
    """
    for figure in FIGURES:
        save(figure.draw(beyond), *(folder / f"{figure.stem}{suffix}" for suffix in suffixes))
        told(figure.title)


def plan_csv(plan: Plan, digits: int) -> str:
    """Return a plan as CSV text: motion, carriers, efforts, condition number; a time occurs twice at a jump."""
    motion, carriers = plan.motion, plan.carriers
    return csv_text(
        {
            "t": motion.t,
            "x": motion.x,
            "xd": motion.xd,
            "xdd": motion.xdd,
            "s": carriers.s,
            "sd": carriers.sd,
            "sdd": carriers.sdd,
            "tau": plan.tau,
            "carrier_force": plan.carrier_force,
            "condition": plan.condition,
        },
        digits=digits,
    )
