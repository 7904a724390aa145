"""The chapter on replays: what the machine does with the plans, open loop and under control, on several processes."""

from __future__ import annotations

from dataclasses import asdict

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.replay import Drive, Replay, replay
from redundancy_pin.studies.case import Plans
from redundancy_pin.studies.cases import Extent, Replayed
from redundancy_pin.studies.planned import Chapter, Tell
from redundancy_pin.workers import parallel


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
    jobs = [(replayed, plan, drive) for replayed, plan in pairs for drive in replayed.drives]
    results: list[Replay] = []
    for job, result in zip(jobs, parallel(_replay, jobs, extent.jobs, ordered=True), strict=True):
        results.append(result)
        if job[2] == job[0].drives[-1]:
            tell(f"replay: {result.plan}")
    return {"replays": [_record(result) for result in results], "without_plan": missing}, tuple(results)


def _replay(replayed: Replayed, plan: Plan, drive: Drive) -> Replay:
    return replay(plan, drive, name=replayed.name, motion=replayed.task.trajectory())


def _record(result: Replay) -> dict[str, object]:
    return {key: value for key, value in asdict(result).items() if key not in ("t", "error")}
