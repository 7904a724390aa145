"""The chapter on replays: plans in, tracking errors out, on several processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.experiments.replay.cases import CASES, ReplayCase
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.replay import Drive, Replay, replay
from redundancy_pin.workers import parallel

Told = Callable[[str], None]


@dataclass(frozen=True)
class ReplaySettings:
    """Extent of the chapter.

    Attributes:
        cases: plans that are replayed.
        coarser: factor on the step of whole-trajectory plans, that of the chapter before.
        jobs: processes; all cores when None.
    """

    cases: tuple[ReplayCase, ...] = CASES
    coarser: float = 1.0
    jobs: int | None = None


FULL = ReplaySettings()
QUICK = ReplaySettings((CASES[0], CASES[2], CASES[10]), 4.0, 1)
"""For tests: a massless plan, one that does not exist, and a corner."""


@dataclass(frozen=True, eq=False)
class Replays:
    """What the chapter says.

    Attributes:
        settings: extent.
        rows: a replay for each plan and drive.
        missing: why there is no plan, by case name.
    """

    settings: ReplaySettings
    rows: tuple[Replay, ...]
    missing: dict[str, str]

    def of(self, name: str) -> tuple[Replay, ...]:
        """Return the replays of a case."""
        return tuple(row for row in self.rows if row.plan == name)

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON; None where nothing was simulated."""
        return {"replays": [_plain(row) for row in self.rows], "without_plan": dict(self.missing)}


def parts(settings: ReplaySettings) -> int:
    """Return how often ``run_replays`` tells of progress."""
    return len(settings.cases)


def run_replays(settings: ReplaySettings = FULL, store: BeyondStore | None = None, told: Told | None = None) -> Replays:
    """Replay plans of all planners, open loop and under control.

    Args:
        settings: how much of it.
        store: plans that were made already.
        told: called after each of ``parts(settings)`` cases.

    Raises:
        RedundancyPinError: casadi is not installed.
    """
    kept = store if store is not None else BeyondStore(PlanStore())
    missing: dict[str, str] = {}
    plans: list[tuple[ReplayCase, Plan]] = []
    for case in settings.cases:
        found = case.plan(kept, settings.coarser)
        if isinstance(found, InfeasiblePlanError):
            missing[case.name] = str(found)
        else:
            plans.append((case, found))
    tell = told or (lambda what: None)
    for name in missing:
        tell(f"no plan to replay: {name}")
    rows: list[Replay] = []
    for found_rows in _run(plans, settings.jobs or -1):
        rows += found_rows
        tell(f"replay: {found_rows[0].plan}")
    return Replays(settings, tuple(rows), missing)


def _run(plans: Sequence[tuple[ReplayCase, Plan]], jobs: int) -> Iterator[list[Replay]]:
    """Give the replays of each plan, in order."""
    calls = [(case, plan, drive) for case, plan in plans for drive in case.drives]
    rows = parallel(replay_case, calls, jobs, ordered=True)
    for case, _ in plans:
        yield [next(rows) for _ in case.drives]


def replay_case(case: ReplayCase, plan: Plan, drive: Drive) -> Replay:
    """Replay one plan with one drive."""
    return replay(plan, drive, name=case.name, motion=case.task.trajectory())


def _plain(row: Replay) -> dict[str, object]:
    data = {key: value for key, value in asdict(row).items() if key not in ("t", "error")}
    return {key: None if isinstance(value, float) and np.isnan(value) else value for key, value in data.items()}
