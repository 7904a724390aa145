"""Everything that a run of the main job made, and its summary as data."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import redundancy_pin
from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.simulation.replay import Replay
from redundancy_pin.studies.case import Plans
from redundancy_pin.studies.cases import Extent
from redundancy_pin.studies.motions import MotionRun
from redundancy_pin.studies.statements import thesis
from redundancy_pin.studies.table import Record, json_data

FORMAT = "redundancy_pin results"
FORMAT_VERSION = 1

_PACKAGES = ("pin", "numpy", "scipy", "xacrodoc", "matplotlib", "casadi")

NOTES = (
    "Efforts are positive when they do positive work on the joint rate; the thesis has the opposite sign.",
    "Near-singular samples (margin below the threshold) are left out of peaks: towards a singular instant at which a "
    "part of the required force is outside what the actuators can carry, efforts grow as that part over the margin.",
    "The 2-RPR of the thesis is massless but for its carriers, so it has no baseline without them.",
)


@dataclass(frozen=True, eq=False)
class Results:
    """What was run and what came out.

    Attributes:
        extent: how much was run.
        check: the cross-check.
        runs: the motions without a planner.
        compared: statements of the thesis about these, beside our numbers.
        chapters: records of the tables of each chapter that was run, by their names in ``summary.json``.
        plans: the plans, for figures and files.
        replays: one for each plan and drive.
    """

    extent: Extent
    check: CrossCheckReport
    runs: tuple[MotionRun, ...]
    compared: tuple[Record, ...]
    chapters: Mapping[str, Mapping[str, Any]]
    plans: Plans
    replays: tuple[Replay, ...] = ()

    def summary(self, files: Sequence[str]) -> dict[str, Any]:
        """Return everything worth keeping as plain data; None stands for numbers that do not exist.

        Args:
            files: every file of the results folder, relative to it; a later run replaces the folder only if these are
                all.
        """
        data: dict[str, Any] = json_data(
            {
                "format": FORMAT,
                "format_version": FORMAT_VERSION,
                "versions": versions(),
                "cross_check": self.check.as_dict(),
                "experiments": {run.case.name: _with_source(run) for run in self.runs},
                "thesis": self.compared,
                **{name: self.chapters.get(name) for name in ("planned", "beyond", "replay")},
                "notes": NOTES,
                "files": sorted(files),
            }
        )
        return data


def _with_source(run: MotionRun) -> Record:
    record = run.record()
    return {**record, "configuration": {**record["configuration"], "source": thesis()["sources"][run.case.robot]}}


def versions() -> dict[str, str]:
    """Return the versions of this package, of Python and of what the numbers depend on."""
    installed = {"redundancy_pin": redundancy_pin.__version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            installed[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return installed
