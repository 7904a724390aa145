"""The chapter beyond the thesis: makes every plan once, and compares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from redundancy_pin.experiments.beyond.fastest import Fastest, fastest
from redundancy_pin.experiments.beyond.findings import Finding, findings
from redundancy_pin.experiments.beyond.modes import ModeRows, mode_rows
from redundancy_pin.experiments.beyond.optimality import BackendRow, StartsRow, backend_row, starts_row
from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.settings import FULL, BeyondSettings, Race
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.targets import Target, targets
from redundancy_pin.experiments.beyond.tasks import CORNERS, CROSSINGS, TASKS, Task
from redundancy_pin.experiments.beyond.tradeoff import Trade, trade
from redundancy_pin.experiments.beyond.ways import EFFORT, PEAK, SWITCH_OFF, case_of, corner_rows, crossing_rows
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.planners.whole_trajectory.objectives import casadi

Told = Callable[[str], None]
"""Called after each part with what was done."""

_LIGHT, _HEAVY, _LINE, _FIVE_BAR = (CROSSINGS[i] for i in (0, 2, 4, 5))
_STARTED: tuple[Task, ...] = (_LIGHT, _HEAVY, _FIVE_BAR, *CORNERS[:2])
_TRADED: tuple[Task, ...] = (_LIGHT, CORNERS[0])
_CAPPED_COARSER = 2.0
"""Factor on the step, and on the width of the bracket, of the race with limited efforts: many more limits bind."""


@dataclass(frozen=True, eq=False)
class Beyond:
    """What the chapter says.

    Attributes:
        settings: extent.
        store: the plans, for figures and files.
        rows: every way to carry out every motion.
        targets: what was asked for.
        fastest: the fastest motions.
        modes: the corners in all working modes.
        backends: plans by both backends.
        starts: plans from several first guesses.
        trades: effort against acceleration.
        findings: what follows.
    """

    settings: BeyondSettings
    store: BeyondStore
    rows: tuple[Row, ...]
    targets: tuple[Target, ...]
    fastest: tuple[Fastest, ...]
    modes: tuple[ModeRows, ...]
    backends: tuple[BackendRow, ...]
    starts: tuple[StartsRow, ...]
    trades: tuple[Trade, ...]
    findings: tuple[Finding, ...]

    def of(self, task: Task) -> tuple[Row, ...]:
        """Return the rows of a motion."""
        return tuple(row for row in self.rows if row.task == task.name)

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {
            "plans": [row.as_dict() for row in self.rows],
            "targets": [target.as_dict() for target in self.targets],
            "fastest": [race.as_dict() for race in self.fastest],
            "working_modes": [row.as_dict() for row in self.modes],
            "backends": [row.as_dict() for row in self.backends],
            "first_guesses": [row.as_dict() for row in self.starts],
            "trade_off": [found.as_dict() for found in self.trades],
            "findings": [finding.as_dict() for finding in self.findings],
        }


def parts(settings: BeyondSettings) -> int:
    """Return how often ``run_beyond`` tells of progress."""
    return 2 * len(TASKS) + len(settings.races) + 1 + len(_STARTED) + len(_TRADED)


def require_solver() -> None:
    """Check that whole-trajectory plans can be made.

    Raises:
        RedundancyPinError: casadi is not installed.
    """
    casadi()


def run_beyond(settings: BeyondSettings = FULL, thesis: PlanStore | None = None, told: Told | None = None) -> Beyond:
    """Compare the thesis's planners with the whole-trajectory planner.

    Args:
        settings: how much of it.
        thesis: plans of the thesis's chapters, if they were made already.
        told: called after each of ``parts(settings)`` parts.

    Raises:
        RedundancyPinError: casadi is not installed.
        InfeasiblePlanError: a motion of which every other number depends has no plan.
    """
    require_solver()
    tell = told or (lambda what: None)
    store = BeyondStore(thesis if thesis is not None else PlanStore())
    rows: list[Row] = []
    for task in TASKS:
        if task.crosses:
            rows += crossing_rows(store, task, settings.coarser)
        else:
            rows += corner_rows(store, task, settings.coarser, energy=task.path == "corner")
        tell(f"whole trajectory: {task.name}")
    races = []
    for race in settings.races:
        races.append(_race(store, settings, race, rows))
        tell(f"as fast as the limits allow: {race}")
    modes = mode_rows(store, settings.modes, settings.coarser)
    tell("whole trajectory in the working modes")
    backends = []
    for task in TASKS:
        if len(task.machine.backends) > 1:
            ways = (EFFORT, PEAK) if settings.both_backends else (EFFORT,)
            backends += [backend_row(store, case_of(task, way, settings.coarser)) for way in ways]
        tell(f"both backends: {task.name}")
    starts = []
    for task in _STARTED:
        for way in (EFFORT, PEAK):
            case = case_of(task, way, settings.starts_coarser)
            starts.append(starts_row(store, replace(case, starts=settings.starts, refinements=0)))
        tell(f"first guesses: {task.name}")
    trades = []
    for task in _TRADED:
        trades.append(trade(store, task, settings.ratios, settings.coarser))
        tell(f"trade-off: {task.name}")
    found = tuple(rows)
    asked = targets(found)
    return Beyond(
        settings, store, found, asked, tuple(races), modes, tuple(backends), tuple(starts), tuple(trades),
        findings(found, races, modes, backends, starts),
    )  # fmt: skip


def _race(store: BeyondStore, settings: BeyondSettings, which: Race, rows: list[Row]) -> Fastest:
    """Bracket the fastest motion of a race."""
    if which != "light, limited force":
        return fastest(store, {"light": _LIGHT, "heavy": _HEAVY, "line": _LINE}[which], settings)
    cap = next(row.before for row in rows if (row.task, row.way) == (_LIGHT.name, SWITCH_OFF))
    coarser, tolerance = settings.coarser * _CAPPED_COARSER, settings.tolerance * _CAPPED_COARSER
    return fastest(store, _LIGHT, replace(settings, coarser=coarser, tolerance=tolerance), cap)
