"""The chapter on replays: what the machine does with the plans, open loop and under control, on several processes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.replay import Drive, Replay, replay
from redundancy_pin.studies.case import Plans
from redundancy_pin.studies.cases import Extent, Replayed
from redundancy_pin.studies.planned import Chapter, Tell
from redundancy_pin.workers import workers


def run_replays(plans: Plans, extent: Extent, tell: Tell) -> tuple[Chapter, tuple[Replay, ...]]:
    """Replay plans of all planners with each of their drives.

    Returns:
        The records of the chapter, and the replays with their curves.

    Raises:
        RedundancyPinError: casadi is not installed.
    """
    missing: dict[str, str] = {}
    pairs: list[tuple[Replayed, Plan]] = []
    for replayed in extent.replayed:
        outcome = plans.outcome(replayed.case(extent.coarser))
        if isinstance(outcome, InfeasiblePlanError):
            missing[replayed.name] = str(outcome)
            tell(f"no plan to replay: {replayed.name}")
        else:
            pairs.append((replayed, outcome))
    results: list[Replay] = []
    for of_plan in _run(pairs, extent.jobs or os.cpu_count() or 1):
        results += of_plan
        tell(f"replay: {of_plan[0].plan}")
    return {"replays": [_record(result) for result in results], "without_plan": missing}, tuple(results)


def _run(pairs: Sequence[tuple[Replayed, Plan]], jobs: int) -> Iterator[list[Replay]]:
    """Give the replays of each plan, in order."""
    if jobs == 1 or len(pairs) < 2:
        for replayed, plan in pairs:
            yield [_replay(replayed, plan, drive) for drive in replayed.drives]
        return
    with workers(min(jobs, len(pairs))) as pool:
        futures = [
            [pool.submit(_replay, replayed, plan, drive) for drive in replayed.drives] for replayed, plan in pairs
        ]
        for group in futures:
            yield [future.result() for future in group]


def _replay(replayed: Replayed, plan: Plan, drive: Drive) -> Replay:
    return replay(plan, drive, name=replayed.name, motion=replayed.task.trajectory())


def _record(result: Replay) -> dict[str, object]:
    return {key: value for key, value in asdict(result).items() if key not in ("t", "error")}
