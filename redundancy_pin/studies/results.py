"""Running the chapters, everything that a run of the main job made, and its summary as data."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import redundancy_pin
from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.replay import Drive, Replay, replay
from redundancy_pin.studies import beyond, planned
from redundancy_pin.studies.case import Case, Plans
from redundancy_pin.studies.cases import CHAPTERS, Extent, Replayed
from redundancy_pin.studies.claims import conclusions, findings
from redundancy_pin.studies.motions import MotionRun, run
from redundancy_pin.studies.statements import compare_motions, thesis
from redundancy_pin.studies.store import versions
from redundancy_pin.studies.table import Record, json_data
from redundancy_pin.workers import parallel

_NOTES = (
    "Efforts are positive when they do positive work on the joint rate; the thesis has the opposite sign.",
    "Near-singular samples (margin below the threshold) are left out of peaks: towards a singular instant at which a "
    "part of the required force is outside what the actuators can carry, efforts grow as that part over the margin.",
    "The 2-RPR of the thesis is massless but for its carriers, so it has no baseline without them.",
)


@dataclass(frozen=True, eq=False)
class Results:
    """What was run and what came out.

    ``runs`` are the motions without a planner, ``compared`` statements of the thesis about these; ``chapters`` has the
    records of each chapter that was run, by their names in ``summary.json``.
    """

    extent: Extent
    check: CrossCheckReport
    runs: tuple[MotionRun, ...]
    compared: tuple[Record, ...]
    chapters: Mapping[str, Mapping[str, Any]]
    plans: Plans
    replays: tuple[Replay, ...] = ()

    notes: ClassVar = _NOTES

    @property
    def versions(self) -> dict[str, str]:
        """Of this package, of Python and of what the numbers depend on, where it is installed."""
        known = versions("pin", "numpy", "scipy", "xacrodoc", "matplotlib", "casadi")
        own = {"redundancy_pin": redundancy_pin.__version__, "python": platform.python_version()}
        return own | {name: version for name, version in known.items() if version}

    def summary(self, files: Sequence[str]) -> dict[str, Any]:
        """Return everything worth keeping as plain data; None stands for numbers that do not exist.

        ``files`` are all of the results folder: a later run replaces the folder only if there are no others.
        """
        experiments = {one.case.name: one.record() for one in self.runs}
        for one in self.runs:
            experiments[one.case.name]["configuration"]["source"] = thesis()["sources"][one.case.robot]
        return dict(
            json_data(
                {
                    "format": "redundancy_pin results",
                    "format_version": 1,
                    "versions": self.versions,
                    "cross_check": self.check.as_dict(),
                    "experiments": experiments,
                    "thesis": self.compared,
                    **{name: self.chapters.get(name) for name in CHAPTERS},
                    "notes": self.notes,
                    "files": sorted(files),
                }
            )
        )


def compute(motions: Sequence[Case], extent: Extent, check: CrossCheckReport, tell: Callable[[str], None]) -> Results:
    """Run the motions and the chapters; every plan is made once."""
    runs: list[MotionRun] = []
    for case in motions:
        runs.append(run(case))
        tell(case.name)
    plans = Plans()
    chapters: dict[str, dict[str, Any]] = {}
    replays: tuple[Replay, ...] = ()
    if "planned" in extent.chapters:
        chapters["planned"] = planned.run_planned(plans, extent, tell)
        chapters["planned"]["conclusions"] = conclusions(chapters["planned"])
    if "beyond" in extent.chapters:
        chapters["beyond"] = beyond.run_beyond(plans, extent, tell)
        chapters["beyond"]["findings"] = findings(chapters["beyond"])
    if "replay" in extent.chapters:
        chapters["replay"], replays = run_replays(plans, extent, tell)
    return Results(extent, check, tuple(runs), tuple(compare_motions(runs)), chapters, plans, replays)


def run_replays(plans: Plans, extent: Extent, tell: Callable[[str], None]) -> tuple[dict[str, Any], tuple[Replay, ...]]:
    """Replay plans of all planners with each of their drives; return the records of the chapter, and the curves."""
    missing: dict[str, str] = {}
    jobs: list[tuple[Replayed, Plan, Drive]] = []
    for replayed in extent.replayed:
        outcome = plans.outcome(replayed.case(extent.coarser))
        if isinstance(outcome, InfeasiblePlanError):
            missing[replayed.name] = str(outcome)
            tell(f"no plan to replay: {replayed.name}")
        else:
            jobs += [(replayed, outcome, drive) for drive in replayed.drives]
    results: list[Replay] = []
    for (replayed, _, drive), result in zip(jobs, parallel(_replay, jobs, extent.jobs, ordered=True), strict=True):
        results.append(result)
        if drive == replayed.drives[-1]:
            tell(f"replay: {result.plan}")
    records = [{key: value for key, value in asdict(result).items() if key not in ("t", "error")} for result in results]
    return {"replays": records, "without_plan": missing}, tuple(results)


def _replay(replayed: Replayed, plan: Plan, drive: Drive) -> Replay:
    return replay(plan, drive, name=replayed.name, motion=replayed.task.trajectory())
