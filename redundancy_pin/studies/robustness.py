"""The study: all scenarios with all drives, many draws each, on several processes; what is finished is never lost."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

import redundancy_pin
from redundancy_pin.arrays import Array, whole
from redundancy_pin.errors import InputError
from redundancy_pin.io.json_data import json_data
from redundancy_pin.robot.shipped import models_root
from redundancy_pin.simulation.controllers.by_name import DRIVES, Drive
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.encoders import Encoders
from redundancy_pin.simulation.controllers.lqr import TimeVaryingLqr, bryson_weights
from redundancy_pin.studies.store import Progress, Store, versions
from redundancy_pin.studies.table import NONE, Column, Record, Table, csv_text, text
from redundancy_pin.studies.trial import (
    ATOL,
    MASSES,
    RTOL,
    SCENARIOS,
    SUCCESS,
    Imperfections,
    Scenario,
    Trial,
    run_trial,
)
from redundancy_pin.workers import require_jobs

DRAWS, MOST_DRAWS = 200, 100_000

CONFIDENCE = 0.95

RESAMPLES = 2000
"""Of the bootstrap; its seed is fixed, so the same trials give the same intervals."""

LIBRARIES = ("casadi", "numpy", "pin", "scipy")
"""Whose versions may change a digit of a plan or a simulation."""

UNUSED = ("__main__.py", "_startup.py", "cli", "crosscheck", "studies", "view.py", "visualisation", "workers.py")
"""Parts of the package that no trial uses, but for ``OWN``."""

OWN = ("studies/case.py", "studies/trial.py")

_SCALED = (
    *("mass", "length", "start_position", "start_speed", "noise"),
    *("prismatic_coulomb", "prismatic_viscous", "revolute_coulomb", "revolute_viscous"),
)


@dataclass(frozen=True)
class Estimate:
    """An estimate with its 95 % interval of confidence."""

    value: float
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True)
class CellStatistics:
    """One scenario with one drive.

    Attributes:
        scenario, drive: names.
        draws: number of trials.
        success: share of crossings that succeeded, with Wilson's interval.
        largest: mean of the largest distance of each trial from its plan, m, with the bootstrap's interval; over all
            trials that were simulated, failed ones up to where they ended. ``worst`` is the largest of them.
        rms: mean of the root mean square distances, m.
        effort, carrier_force: largest |τ| and |F| of any trial, N.
        statuses: how often each status came about.
        given_up: largest share of readings at which a computed torque found no answer.
    """

    scenario: str
    drive: str
    draws: int
    success: Estimate
    largest: Estimate
    worst: float
    rms: Estimate
    effort: float
    carrier_force: float
    statuses: dict[str, int]
    given_up: float


@dataclass(frozen=True)
class Study:
    """A finished study: bounds and seed of the draws, trials by scenario, drive and number, and their statistics."""

    imperfections: Imperfections
    seed: int
    trials: tuple[Trial, ...]
    cells: tuple[CellStatistics, ...]


def robustness_study(
    draws: int = DRAWS,
    *,
    seed: int = 0,
    severity: float = 1.0,
    scenarios: Sequence[Scenario] = SCENARIOS,
    drives: Sequence[Drive] = DRIVES,
    imperfections: Imperfections | None = None,
    journal: str | Path | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Study:
    """Run a study, taking over the trials that a store already has.

    Draw number i is the same machine in every cell, so cells may be compared draw by draw.

    Args:
        draws: trials a cell.
        seed: of the draws, 0 or more.
        severity: factor on all errors, see ``scaled``.
        scenarios: planned crossings.
        drives: what controls the machine.
        imperfections: their bounds; the default ones when left out.
        journal: file of the store of finished trials, made with its folder if it is missing; None keeps them in memory.
        jobs: number of processes; all cores when left out. 1 runs in this process.
        progress: called whenever a trial is finished.

    Raises:
        InputError: a number out of its domain, or two scenarios of one name.
        OutputError: as ``Store.open``, for a store of another study or of other code.
        RedundancyPinError: a process was killed from outside.
        InfeasiblePlanError: a scenario has no plan.
    """
    whole(draws, "draws", 1, MOST_DRAWS)
    if jobs is not None:
        require_jobs(whole(jobs, "jobs", 1, 2**31))
    names = [scenario.name for scenario in scenarios]
    if len(set(names)) < len(names):
        raise InputError(
            f"Two of the scenarios are named {max(names, key=names.count)!r}: their trials could not be told apart.",
            remedy="Run them as studies of their own.",
        )
    if seed < 0:
        raise InputError(f"seed is {seed}.", remedy="Pass a whole number from 0 on.")
    bounds = scaled(imperfections or Imperfections(), severity)
    cells = [(scenario, drive) for scenario in scenarios for drive in drives]
    # draws first: an interrupted study has about as many trials in every cell
    wanted = {
        (scenario.name, drive, number): (scenario, drive, bounds, seed, number)
        for number in range(draws)
        for scenario, drive in cells
    }
    known = identity(bounds, seed, scenarios)
    with Store.open(journal, "robustness study", known, lambda data: Trial(**data)) as store:
        store.complete(run_trial, wanted, -1 if jobs is None else jobs, progress, "trials")
        groups = [[store.records[scenario.name, drive, i] for i in range(draws)] for scenario, drive in cells]
    return Study(bounds, seed, tuple(chain.from_iterable(groups)), tuple(cell_statistics(group) for group in groups))


def scaled(imperfections: Imperfections, severity: float) -> Imperfections:
    """Return imperfections with errors of masses, lengths and start, friction and noise times a factor.

    Sampling, delay, encoders and limits stay.

    Raises:
        InputError: the factor is negative or not finite, or masses could become negative.
    """
    if not (np.isfinite(severity) and severity >= 0.0 and severity * imperfections.mass < 1.0):
        most = f"from 0 to below {1.0 / imperfections.mass:g}" if imperfections.mass > 0.0 else "that is not negative"
        raise InputError(f"severity is {severity}.", remedy=f"Pass a number {most}.")
    return replace(imperfections, **{name: severity * getattr(imperfections, name) for name in _SCALED})


def cell_statistics(trials: Sequence[Trial]) -> CellStatistics:
    """Return the statistics of the trials of one cell, one or more."""
    simulated = [trial for trial in trials if np.isfinite(trial.largest)]

    def most(name: str) -> float:
        return float(np.max([getattr(trial, name) for trial in simulated])) if simulated else math.nan

    return CellStatistics(
        scenario=trials[0].scenario,
        drive=trials[0].drive,
        draws=len(trials),
        success=wilson(sum(trial.success for trial in trials), len(trials)),
        largest=mean_interval(np.array([trial.largest for trial in simulated])),
        worst=most("largest"),
        rms=mean_interval(np.array([trial.rms for trial in simulated])),
        effort=most("effort"),
        carrier_force=most("carrier_force"),
        statuses=dict(sorted(Counter(trial.status for trial in trials).items())),
        given_up=most("given_up"),
    )


def wilson(successes: int, count: int) -> Estimate:
    """Return a rate with Wilson's interval (Wilson 1927)."""
    from scipy.stats import binomtest  # takes 0.3 s to load: not for every command

    interval = binomtest(successes, count).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(successes / count, float(interval.low), float(interval.high))


def mean_interval(values: Array) -> Estimate:
    """Return a mean with the percentile interval of the bootstrap; without an interval for fewer than two values."""
    from scipy.stats import bootstrap  # as above

    if len(values) < 2:
        return Estimate(float(values[0]) if len(values) else math.nan)
    mean = float(values.mean())
    if np.ptp(values) == 0.0:  # the bootstrap warns
        return Estimate(mean, mean, mean)
    random, kind = np.random.default_rng(0), "percentile"
    interval = bootstrap(
        (values,), np.mean, confidence_level=CONFIDENCE, n_resamples=RESAMPLES, method=kind, random_state=random
    ).confidence_interval
    return Estimate(mean, float(interval.low), float(interval.high))


# ------------------------------------------------------------------------------------------------------------- tables


def study_table(study: Study) -> Table:
    """Return a row for each cell."""
    columns = (
        Column("scenario", "crossing, plan"),
        Column("drive"),
        Column("draws"),
        Column("success", unit="%", value=lambda cell: _interval(cell["success"], 100.0, 1)),
        Column("largest", "largest error, mean", "mm", value=lambda cell: _interval(cell["largest"], 1e3, 2)),
        Column("worst", unit="mm", format=".2f", value=lambda cell: 1e3 * cell["worst"]),
        Column("rms", "rms error, mean", "mm", value=lambda cell: _interval(cell["rms"], 1e3, 2)),
        Column("effort", "largest main force", "N", ".2f"),
        Column("carrier_force", "largest carrier force", "N", ".2f"),
        Column("statuses", "how it ended", value=_ended),
    )
    return Table.of(columns, [asdict(cell) for cell in study.cells], "robustness")


def study_caption(study: Study) -> str:
    """Return what the numbers of a table are."""
    caption = (
        f"Success: the simulation reached its end with the platform never farther than {1e3 * SUCCESS:g} mm from its "
        "plan. In brackets 95 % intervals: Wilson's for rates, of the bootstrap for means."
    )
    if any(math.isnan(interval.low) for cell in study.cells for interval in (cell.largest, cell.rms)):
        caption += f" {NONE}: none; an interval of a mean takes two simulated draws or more."
    return caption


def study_csv(study: Study) -> str:
    """Return all trials as CSV."""
    names = [field.name for field in fields(Trial) if field.name != "reason"]
    columns = {name: np.array([getattr(trial, name) for trial in study.trials]) for name in names}
    columns["scenario"] = np.array([trial.scenario.replace(",", ";") for trial in study.trials])
    return csv_text({**columns, "success": np.array([int(trial.success) for trial in study.trials])})


def _interval(interval: Mapping[str, float], factor: float, digits: int) -> str:
    """Return a value with its interval, a dash for either where there is none."""
    value, low, high = (text(factor * interval[name], f".{digits}f") for name in ("value", "low", "high"))
    if NONE in (low, high):
        return value if value == NONE else f"{value} [{NONE}]"
    return f"{value} [{low}, {high}]"


def _ended(cell: Record) -> str:
    ended = ", ".join(f"{status} {count}" for status, count in cell["statuses"].items())
    given_up = 100.0 * cell["given_up"]
    return ended + (f", gave up at {given_up:.1f} % of the readings" if given_up > 0.0 else "")


# ----------------------------------------------------------------------------------------------------------- identity


def identity(bounds: Imperfections, seed: int, scenarios: Sequence[Scenario]) -> dict[str, Any]:
    """Return what decides the outcome of each trial but scenario, drive and number, as plain data.

    What says most to a user comes first; a change of the code that nothing else tells is in the digest at the end.
    """
    return {
        "seed": seed,
        "imperfections": asdict(bounds),
        "scenarios": {one.name: json_data(asdict(one)) for one in scenarios},
        "machine": MASSES,
        "tolerances": [RTOL, ATOL],
        "computed torque": _defaults(ComputedTorque.__init__),
        "LQR": {**_defaults(TimeVaryingLqr.__init__), **_defaults(bryson_weights)},
        "encoders": _defaults(Encoders.__init__),
        "libraries": versions(*LIBRARIES),
        "code": code_digest(),
    }


def code_digest() -> str:
    """Return a hash of the source files of the package that trials use, and of the shipped models."""
    root, models = Path(redundancy_pin.__file__).parent, models_root()
    parts = [path for path in root.iterdir() if path.name not in (*UNUSED, models.name)]
    files = [file for part in parts for file in ([part] if part.is_file() else part.rglob("*.py"))]
    files += [root / name for name in OWN]
    named = {f"package/{file.relative_to(root)}": file for file in files if file.suffix == ".py"}
    named.update({f"models/{file.relative_to(models)}": file for file in models.rglob("*") if file.is_file()})
    digest = hashlib.sha256()
    for name in sorted(named):
        # line ends differ between systems
        digest.update(f"{name}\n".encode() + named[name].read_bytes().replace(b"\r\n", b"\n") + b"\n")
    return digest.hexdigest()[:16]


def _defaults(made: Callable[..., Any]) -> Mapping[str, float]:
    """Return the settings with which the study makes something: the numbers among the defaults."""
    given: Mapping[str, object] = getattr(made, "__kwdefaults__", None) or {}
    return {name: value for name, value in given.items() if isinstance(value, (int, float))}
