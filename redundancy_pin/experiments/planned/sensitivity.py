"""How much the numbers depend on what the thesis leaves unstated: one parameter at a time, as ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from redundancy_pin.experiments.planned import grids
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import CORNERS, CROSSINGS, Case, SwitchOffCase
from redundancy_pin.experiments.planned.grids import Grid
from redundancy_pin.experiments.planned.settings import StudySettings
from redundancy_pin.experiments.planned.statements import (
    CORNER_RAMPS,
    ORIENTATIONS,
    RETURNS,
    SQUARE_RETURNS,
    STEPS,
    STEPWISE_STEPS,
    span,
)
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.experiments.planned.verdict import Range

CIRCLE_RAMPS = (0.4, 0.5, 0.6, 0.7, 0.765, 0.8)
"""Ramp lengths of the circle over v T, from the shortest that does not run backwards."""


@dataclass(frozen=True)
class SensitivityRow:
    """The range of a number over the grid of a parameter.

    Attributes:
        case: the run that is varied.
        quantity: the number, with its unit.
        parameter: what is varied.
        grid: over which values.
        ours: in the run itself; the largest where there are several.
        low, high: NaN where the number exists nowhere on the grid.
        plans: number of plans on the grid.
        without: how many of them do not exist.
    """

    case: str
    quantity: str
    parameter: str
    grid: str
    ours: float
    low: float
    high: float
    plans: int
    without: int

    @property
    def covered(self) -> str:
        """The range as text."""
        return span(Range(self.low, self.high))


_CROSSING: tuple[tuple[str, m.Measure], ...] = (
    ("threshold met [s]", m.entry_time),
    ("force as it begins to fall [N]", m.entry_forces),
    ("threshold left [s]", m.exit_time),
    ("jump of the force on switching on [N]", m.exit_forces),
    ("largest |s| when switched on [m]", m.position_at_exit),
    ("largest |s| [m]", m.farthest_position),
    ("largest force on the return [N]", m.peak_in("return")),
)
_CORNER: tuple[tuple[str, m.Measure], ...] = (
    ("largest torque [N·m]", m.peak),
    ("largest rms torque [N·m]", lambda plan: (float(plan.rms_effort.max()),)),
    ("carrier 2 meets its speed limit [s]", m.first_bound("speed", 2)),
)
_SQUARE: tuple[tuple[str, m.Measure], ...] = (
    ("largest torque while optimised [N·m]", m.peak_in("optimise")),
    ("largest torque on a return [N·m]", m.peak_in("return")),
    ("carrier 2 meets its speed limit [s]", m.first_bound("speed", 2)),
)


def sensitivity(store: PlanStore, settings: StudySettings) -> tuple[SensitivityRow, ...]:
    """Vary every unstated parameter, one at a time."""
    full = settings.sensitivity

    def some(values: Sequence[float]) -> Sequence[float]:
        return values if full else (values[0], values[-1])

    circle = (grids.ramp_lengths(some(CIRCLE_RAMPS)), grids.return_times(some(RETURNS)), grids.steps(some(STEPS)))
    corner = (
        grids.ramp_lengths(some(CORNER_RAMPS)),
        grids.steps(some(STEPWISE_STEPS)),
        grids.modes(settings.modes),
        grids.orientations(some(ORIENTATIONS)),
    )
    square = (*corner, grids.return_times(some(SQUARE_RETURNS)))
    crossings = CROSSINGS[:4] if full else CROSSINGS[:1]
    rows: list[SensitivityRow] = []
    for crossing in crossings:
        for grid in circle:
            # the step matters to backward differences only, so the run they are held against uses them too
            case = replace(crossing, scheme="backward_differences") if grid is circle[2] else crossing
            rows += _rows(store, case, grid, _CROSSING)
    for stepwise in CORNERS:
        on_square = stepwise.path == "square"
        for grid in square if on_square else corner:
            rows += _rows(store, stepwise, grid, _SQUARE if on_square else _CORNER)
    return tuple(rows)


def _rows(
    store: PlanStore, case: Case, grid: Grid, quantities: Sequence[tuple[str, m.Measure]]
) -> list[SensitivityRow]:
    found = [store.try_plan(variation) for variation in grid.cases(case)]
    plans = [plan for plan in found if plan is not None]
    own = store.plan(case)
    name = case.name + (" (backward differences)" if _differences(case) else "")
    rows = []
    for quantity, measure in quantities:
        over = Range.of([value for plan in plans for value in measure(plan)])
        rows.append(
            SensitivityRow(
                name, quantity, grid.parameter, grid.values, max(measure(own)), over.low, over.high, len(found),
                len(found) - len(plans),
            )
        )  # fmt: skip
    return rows


def _differences(case: Case) -> bool:
    return isinstance(case, SwitchOffCase) and case.scheme == "backward_differences"
