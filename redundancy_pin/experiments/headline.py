"""The headline table: the largest main effort of every motion, planned in every way; the README shows it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.tasks import TASKS, Task
from redundancy_pin.experiments.beyond.ways import EFFORT, NONE, PEAK, STEPWISE, SWITCH_OFF, SWITCH_OFF_LATE
from redundancy_pin.experiments.document import table
from redundancy_pin.experiments.markdown import markdown
from redundancy_pin.planners.plan import PlanStatus

HEADINGS = ("motion", "no moving masses", "planner of the thesis", "whole trajectory: least effort", "... least peak")
NO_PLAN = "no plan exists"
BREAKS = "breaks limits"

_SAID = {PlanStatus.VIOLATES_LIMITS.value: BREAKS}
"""How a status is said where it is not the best one."""


def headline(rows: Sequence[Row]) -> str:
    """Return the table as Markdown.

    Args:
        rows: of the chapter beyond the thesis (in ``summary.json`` under ``beyond``, ``plans``); motions of which there
            is none are left out.
    """
    by_key = {(row.task, row.way): row for row in rows}
    found = [task for task in TASKS if (task.name, EFFORT) in by_key]
    return markdown([table(HEADINGS, [(task.title, *_cells(task, by_key)) for task in found])])


def _cells(task: Task, by_key: dict[tuple[str, str], Row]) -> list[str]:
    none, effort, peak = (by_key.get((task.name, way)) for way in (NONE, EFFORT, PEAK))
    thesis = (SWITCH_OFF, SWITCH_OFF_LATE) if task.crosses else (STEPWISE,)
    return [cell(row) for row in (none, best(by_key.get((task.name, way)) for way in thesis), effort, peak)]


def best(rows: Iterable[Row | None]) -> Row | None:
    """Return the plan of least main effort that keeps every limit; one that breaks limits only if none keeps them."""
    found = [row for row in rows if row is not None]
    return min(found, key=lambda row: (not row.exists, not row.sound, row.worst), default=None)


def cell(row: Row | None) -> str:
    """Return the largest main effort of a plan, at its samples or between them, and what is wrong with the plan."""
    if row is None:
        return "–"
    if not row.exists:
        return NO_PLAN
    largest = f"{f'{row.worst:#.3g}'.rstrip('.')} {row.unit}" if math.isfinite(row.worst) else "unbounded"
    return largest if row.sound else f"{largest}, {_SAID.get(row.status, row.status.replace('_', ' '))}"
