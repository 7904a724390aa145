"""The study: all scenarios with all drives, many draws each, on several processes; what is finished is never lost."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from redundancy_pin.errors import InputError, OutputError
from redundancy_pin.experiments.journal import open_journal
from redundancy_pin.experiments.robustness.draws import Imperfections
from redundancy_pin.experiments.robustness.identity import identity
from redundancy_pin.experiments.robustness.journal import TRIALS
from redundancy_pin.experiments.robustness.scenarios import DRIVES, SCENARIOS, Drive, Scenario
from redundancy_pin.experiments.robustness.statistics import CellStatistics, cell_statistics
from redundancy_pin.experiments.robustness.trial import Key, Trial, run_trial
from redundancy_pin.workers import workers

DRAWS = 200

Progress = Callable[[int, int, str], None]
"""Called with trials done, trials in all, and what is being done."""

REMEDY = "Run again with fewer jobs: what a journal has is taken over from there."
"""When a process has died."""

_SCALED = ("mass", "length", "start_position", "start_speed", "noise")
_FRICTION = ("coulomb", "viscous")


@dataclass(frozen=True)
class Study:
    """A finished study.

    Attributes:
        imperfections: bounds of the draws.
        seed: of the draws.
        trials: all of them, by scenario, drive and number.
        cells: their statistics.
    """

    imperfections: Imperfections
    seed: int
    trials: tuple[Trial, ...]
    cells: tuple[CellStatistics, ...]


def scaled(imperfections: Imperfections, severity: float) -> Imperfections:
    """Return imperfections with errors of masses, lengths and start, friction and noise times a factor.

    Sampling, delay, encoders and limits stay.

    Raises:
        InputError: the factor is negative or not finite, or masses could become negative.
    """
    if not (np.isfinite(severity) and severity >= 0.0 and severity * imperfections.mass < 1.0):
        most = f"from 0 to below {1.0 / imperfections.mass:g}" if imperfections.mass > 0.0 else "that is not negative"
        raise InputError(f"severity is {severity}.", remedy=f"Pass a number {most}.")
    chosen = [
        field.name
        for field in fields(imperfections)
        if field.name in _SCALED or field.name.rsplit("_", 1)[-1] in _FRICTION
    ]
    return replace(imperfections, **{name: severity * getattr(imperfections, name) for name in chosen})


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
    """Run a study, taking over the trials that a journal already has.

    Draw number i is the same machine in every cell, so cells may be compared draw by draw.

    Args:
        draws: trials a cell.
        seed: of the draws, 0 or more.
        severity: factor on all errors, see ``scaled``.
        scenarios: planned crossings.
        drives: what controls the machine.
        imperfections: their bounds; the default ones when left out.
        journal: file for the finished trials, made if it is missing; None keeps them in memory alone.
        jobs: number of processes; all cores when left out. 1 runs in this process.
        progress: called whenever a trial is finished.

    Raises:
        InputError: a number out of its domain, or two scenarios of one name.
        OutputError: the journal is of another study or of other code, in use by another run, damaged, or cannot be
            written.
        RedundancyPinError: a process was killed from outside.
        InfeasiblePlanError: a scenario has no plan.
    """
    if draws < 1 or (jobs is not None and jobs < 1):
        raise InputError(f"draws is {draws}, jobs is {jobs}.", remedy="Pass positive whole numbers.")
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
    wanted = [(scenario, drive, number) for number in range(draws) for scenario, drive in cells]
    known: dict[Key, Trial] = {}
    with contextlib.ExitStack() as stack:
        put: Callable[[Trial], None] | None = None
        if journal is not None:
            _make_folder(Path(journal).expanduser().parent)
            book = stack.enter_context(open_journal(TRIALS, journal, identity(bounds, seed, scenarios)))
            known.update(book.records)
            put = book.add
        missing = [one for one in wanted if (one[0].name, one[1], one[2]) not in known]
        done = len(wanted) - len(missing)
        if progress:
            progress(done, len(wanted), "taken over" if done else "planning")
        for trial in _run(missing, bounds, seed, jobs or os.cpu_count() or 1):
            if put is not None:
                put(trial)
            known[trial.key] = trial
            done += 1
            if progress:
                progress(done, len(wanted), f"{trial.scenario}, {trial.drive}")
    trials = [
        known[scenario.name, drive, number] for (scenario, drive), number in itertools.product(cells, range(draws))
    ]
    grouped = [trials[i * draws : (i + 1) * draws] for i in range(len(cells))]
    return Study(bounds, seed, tuple(trials), tuple(cell_statistics(group) for group in grouped))


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"Cannot make the folder {folder}: {error.strerror}.", remedy="Choose another one."
        ) from error


def _run(wanted: Sequence[tuple[Scenario, Drive, int]], bounds: Imperfections, seed: int, jobs: int) -> Iterator[Trial]:
    """Give trials as they are finished, in whatever order that is."""
    if jobs == 1 or len(wanted) < 2:
        for scenario, drive, number in wanted:
            yield run_trial(scenario, drive, bounds, seed, number)
        return
    with workers(min(jobs, len(wanted)), REMEDY) as pool:
        futures: list[Future[Trial]] = [
            pool.submit(run_trial, scenario, drive, bounds, seed, number) for scenario, drive, number in wanted
        ]
        for future in as_completed(futures):
            yield future.result()
