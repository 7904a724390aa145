"""The results as data (``summary.json``), with the versions that made them."""

from __future__ import annotations

import importlib.metadata
import math
import platform
from collections.abc import Sequence
from typing import Any

import redundancy_pin
from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.experiments.beyond.study import Beyond
from redundancy_pin.experiments.planned.study import Study
from redundancy_pin.experiments.replay.study import Replays
from redundancy_pin.experiments.result import Result
from redundancy_pin.experiments.stated import Compared

FORMAT = "redundancy_pin results"
FORMAT_VERSION = 1

_PACKAGES = ("pin", "numpy", "scipy", "xacrodoc", "matplotlib", "casadi")


def summary(
    results: Sequence[Result],
    check: CrossCheckReport,
    compared: Sequence[Compared],
    study: Study | None,
    beyond: Beyond | None,
    replays: Replays | None,
    files: Sequence[str],
) -> dict[str, Any]:
    """Return everything worth keeping of a run as plain data.

    Args:
        results: in the order they were run.
        check: the cross-check that came first.
        compared: statements of the thesis beside our numbers.
        study: the planned experiments; None if they were not run.
        beyond: the chapter beyond the thesis; None if it was not run.
        replays: the chapter on replays; None if it was not run.
        files: every file of the results folder, relative to it; a later run replaces the folder only if these are all.
    """
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "versions": versions(),
        "cross_check": check.as_dict(),
        "experiments": {result.experiment.name: _case(result) for result in results},
        "thesis": [row.as_dict() for row in compared],
        "planned": study.as_dict() if study else None,
        "beyond": beyond.as_dict() if beyond else None,
        "replay": replays.as_dict() if replays else None,
        "notes": list(NOTES),
        "files": sorted(files),
    }


NOTES = (
    "Efforts are positive when they do positive work on the joint rate; the thesis has the opposite sign.",
    "Near-singular samples (margin below the threshold) are left out of peaks: towards a singular instant at which a "
    "part of the required force is outside what the actuators can carry, efforts grow as that part over the margin.",
    "The 2-RPR of the thesis is massless but for its carriers, so it has no baseline without them.",
)


def versions() -> dict[str, str]:
    """Return the versions of this package, of Python and of what the numbers depend on."""
    found = {"redundancy_pin": redundancy_pin.__version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def _case(result: Result) -> dict[str, Any]:
    parity = result.parity
    return {
        "title": result.experiment.title,
        "configuration": result.experiment.as_dict(),
        "duration": result.trajectory.duration,
        "samples": len(result.motion),
        "bounded": result.bounded,
        "statement": result.statement,
        "effort_unit": result.effort_unit,
        "regular_peaks": result.peaks.tolist(),
        "carrier_force_peaks": abs(result.rnea.reduced.carrier_force).max(axis=0, initial=0.0).tolist(),
        "statuses": result.status_counts,
        "smallest_margin": float(result.rnea.distribution.margin.min()),
        "near_singular_windows": [list(window) for window in result.near_singular_windows],
        "singular_instants": [
            {
                "t": instant.t,
                "x": list(instant.x),
                "kind": instant.kind,
                "uncontrolled": list(instant.uncontrolled),
                "missing_force": instant.missing_force,
                "status": instant.status,
                "unbounded": instant.unbounded,
            }
            for instant in result.instants
        ],
        "parity": {
            "f": parity.f,
            "W": parity.W,
            "carrier_force": parity.carrier_force,
            "tau": parity.tau,
            "worst": parity.worst,
        },
    }


def numbers(values: Sequence[float], digits: int = 3) -> str:
    """Return numbers as text: ``2.35, 3.03``."""
    return ", ".join("–" if math.isnan(value) else f"{value:.{digits}g}" for value in values)
