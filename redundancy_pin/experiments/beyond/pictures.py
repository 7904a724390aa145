"""The figures of the chapter: what each shows, and the files they are in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.experiments.beyond.bounds_sections import FASTEST_FIGURE, TRADE_FIGURE
from redundancy_pin.experiments.beyond.modes import RADII
from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.study import Beyond
from redundancy_pin.experiments.beyond.tasks import TASKS, Task
from redundancy_pin.experiments.beyond.tradeoff import rms_acceleration
from redundancy_pin.experiments.beyond.ways import (
    EFFORT,
    NONE,
    PEAK,
    SMOOTH,
    STEPWISE,
    SWITCH_OFF,
    SWITCH_OFF_LATE,
    case_of,
    stepwise_case,
    switch_off_case,
)
from redundancy_pin.experiments.document import Block, Picture
from redundancy_pin.experiments.planned.cases import mode_text
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.figures.comparisons import plot_side_by_side
from redundancy_pin.visualisation.figures.summaries import (
    Attempts,
    TradeCurve,
    plot_bars,
    plot_speed_border,
    plot_trade_off,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN = (NONE, STEPWISE, SWITCH_OFF, EFFORT, PEAK, SMOOTH)
"""Ways that the figures of a motion show, left to right, where there is a plan."""


@dataclass(frozen=True)
class BeyondFigure:
    """A figure of the chapter.

    Attributes:
        stem: name of its files without suffix.
        title: for the progress bar.
        draw: makes it.
    """

    stem: str
    title: str
    draw: Callable[[Beyond], Figure]


def pictures(beyond: Beyond, tasks: Sequence[Task], *, modes: bool = False) -> list[Block]:
    """Return the figures of motions, or of the working modes, as blocks of the report."""
    if modes:
        return [
            Picture(
                f"{_mode_stem(radius)}.png",
                f"Largest |τ| at the corner of radius {radius:g} m in every working mode, at the samples or between "
                "them. Stepwise plans leave the carriers where they are; the others bring them back.",
            )
            for radius in RADII
        ]
    return [Picture(f"{_stem(task)}.png", _caption(task, beyond.of(task))) for task in tasks]


def plans_of(beyond: Beyond, task: Task) -> dict[str, Plan]:
    """Return the plans of a motion that exist and are shown, by way."""
    found = {}
    for row in beyond.of(task):
        if row.exists and row.way in _SHOWN:
            found[row.way] = plan_of(beyond, task, row.way)
    return {way: found[way] for way in _SHOWN if way in found}


def plan_of(beyond: Beyond, task: Task, way: str) -> Plan:
    """Return the plan behind a row.

    Raises:
        InfeasiblePlanError: there is none.
    """
    store = beyond.store
    if way in (SWITCH_OFF, SWITCH_OFF_LATE):
        return store.plan(switch_off_case(task, way), task.machine.backends[0])
    if way == NONE:
        return store.thesis.baseline(stepwise_case(task, 0.0))
    if way == STEPWISE:
        return store.thesis.plan(stepwise_case(task, 0.0))
    return store.plan(case_of(task, way, beyond.settings.coarser), task.machine.backends[0])


def _stem(task: Task) -> str:
    return f"beyond-{task.name}"


def _mode_stem(radius: float) -> str:
    return f"beyond-modes-r{radius:g}"


def _caption(task: Task, rows: Sequence[Row]) -> str:
    parts = [
        f"{row.way} ({row.status.replace('_', ' ')}): peak {row.worst:.3g} {row.unit}"
        for row in rows
        if row.exists and row.way in _SHOWN
    ]
    none = [row.way for row in rows if not row.exists]
    text = f"{task.title}: main efforts, and position, speed and acceleration of the carriers with their limits. "
    text += "; ".join(parts) + "."
    if none:
        text += f" No plan: {', '.join(none)}."
    return text + (" Dotted: singular instants." if task.crosses else "")


def _draw_task(task: Task) -> Callable[[Beyond], Figure]:
    def draw(beyond: Beyond) -> Figure:
        plans = plans_of(beyond, task)
        crossed: Any = next((plan.diagnostics.get("singular_instants") for way, plan in plans.items() if way == EFFORT),
                            ())  # fmt: skip
        return plot_side_by_side(task.title, plans, task.unit, instants=[float(t) for t in crossed or ()])

    return draw


def _draw_modes(radius: float) -> Callable[[Beyond], Figure]:
    def draw(beyond: Beyond) -> Figure:
        rows = [row for row in beyond.modes if row.radius == radius]
        series = {way: np.array([row.rows[way].worst for row in rows]) for way in (NONE, STEPWISE, EFFORT, PEAK)}
        title = f"3-RRR, corner of radius {radius:g} m: largest torque in every working mode"
        return plot_bars(title, [mode_text(row.mode) for row in rows], "working mode", "largest |τ| [N·m]", series)

    return draw


def _draw_fastest(beyond: Beyond) -> Figure:
    attempts = [
        Attempts(
            race.title.rpartition(" at ")[0] + ("" if np.isinf(race.effort) else f", up to {race.effort:.2g} N"),
            np.array([(trial.speed, trial.peak) for trial in race.trials if trial.feasible]),
            np.array([trial.speed for trial in race.trials if not trial.feasible]),
        )
        for race in beyond.fastest
    ]
    return plot_speed_border("2-RPR: largest main force over speed, carriers within their limits", attempts)


def _draw_trade(beyond: Beyond) -> Figure:
    curves = []
    for found in beyond.trades:
        task = next(task for task in TASKS if task.name == found.task)
        points = np.array([(p.rms_acceleration, p.rms_effort) for p in found.points if p.status != "infeasible"])
        marks = {
            row.way: (rms_acceleration(plan_of(beyond, task, row.way)), row.rms)
            for row in beyond.of(task)
            if row.way in (NONE, STEPWISE, SWITCH_OFF) and row.exists
        }
        curves.append(TradeCurve(found.title, found.unit, points, marks))
    return plot_trade_off("Main effort against the carriers' acceleration", curves)


FIGURES: tuple[BeyondFigure, ...] = (
    *(BeyondFigure(_stem(task), f"figure of {task.name}", _draw_task(task)) for task in TASKS),
    BeyondFigure(FASTEST_FIGURE, "figure of the fastest motions", _draw_fastest),
    *(BeyondFigure(_mode_stem(radius), f"figure of the working modes, r {radius:g}", _draw_modes(radius))
      for radius in RADII),
    BeyondFigure(TRADE_FIGURE, "figure of the trade-off", _draw_trade),
)  # fmt: skip
"""In the order of the report."""
