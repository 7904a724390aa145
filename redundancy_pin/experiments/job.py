"""The main job: cross-check, run every experiment with and without planners, write all results or none."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from redundancy_pin import crosscheck
from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.errors import CrossCheckError
from redundancy_pin.experiments.beyond.files import write_figures, write_plans
from redundancy_pin.experiments.beyond.pictures import FIGURES as BEYOND_FIGURES
from redundancy_pin.experiments.beyond.settings import FULL as BEYOND_FULL
from redundancy_pin.experiments.beyond.settings import BeyondSettings
from redundancy_pin.experiments.beyond.study import Beyond, require_solver, run_beyond
from redundancy_pin.experiments.beyond.study import parts as beyond_parts
from redundancy_pin.experiments.csv_text import csv_text
from redundancy_pin.experiments.experiment import Experiment
from redundancy_pin.experiments.figures import comparison_figure, effort_figure, path_figure
from redundancy_pin.experiments.headline import headline
from redundancy_pin.experiments.html import html
from redundancy_pin.experiments.markdown import markdown
from redundancy_pin.experiments.planned.settings import FULL, StudySettings
from redundancy_pin.experiments.planned.study import PARTS, Study, run_study
from redundancy_pin.experiments.planned.thesis_figures import FIGURES
from redundancy_pin.experiments.replay.files import write_figures as write_replay_figures
from redundancy_pin.experiments.replay.files import write_table
from redundancy_pin.experiments.replay.pictures import FIGURES as REPLAY_FIGURES
from redundancy_pin.experiments.replay.study import FULL as REPLAY_FULL
from redundancy_pin.experiments.replay.study import Replays, ReplaySettings, run_replays
from redundancy_pin.experiments.replay.study import parts as replay_parts
from redundancy_pin.experiments.report import report
from redundancy_pin.experiments.result import Result
from redundancy_pin.experiments.run import run
from redundancy_pin.experiments.stated import Compared, compare_with_thesis
from redundancy_pin.experiments.summary import summary
from redundancy_pin.experiments.thesis import EXPERIMENTS
from redundancy_pin.io.files import MANIFEST, replacing_folder, require_replaceable, write_text
from redundancy_pin.visualisation.figures.style import require_matplotlib, save

CROSS_CHECK_SAMPLES = 2000
"""Random states of each robot before the job starts; `redundancy-pin validate` takes as many as one likes."""

CROSS_CHECK_SEED = 0

_CROSS_CHECK_STEPS = 10
"""Steps of the progress bar that the cross-check counts for: about its share of the time."""

CSV_DIGITS = 12
"""Significant digits in the CSV files: beyond the differences between the backends, a third smaller than exact."""

PICTURE_SUFFIXES = (".png", ".svg")

Progress = Callable[[int, int, str], None]
"""Called with steps done, steps in all, and what was done last."""


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What the main job found and where it put it.

    Attributes:
        folder: the results folder.
        check: the cross-check.
        results: of each experiment.
        compared: statements of the thesis beside our numbers.
        study: the planned experiments; None if they were left out.
        beyond: the chapter beyond the thesis; None if it was left out.
        replays: the chapter on replays; None if it was left out.
        summary: what ``summary.json`` holds.
    """

    folder: Path
    check: CrossCheckReport
    results: tuple[Result, ...]
    compared: tuple[Compared, ...]
    study: Study | None
    beyond: Beyond | None
    replays: Replays | None
    summary: dict[str, object]


def reproduce(
    folder: str | Path,
    experiments: Sequence[Experiment] = EXPERIMENTS,
    *,
    study: StudySettings | None = FULL,
    beyond: BeyondSettings | None = BEYOND_FULL,
    replay: ReplaySettings | None = REPLAY_FULL,
    samples: int = CROSS_CHECK_SAMPLES,
    progress: Progress | None = None,
) -> Reproduction:
    """Cross-check the backends, run experiments, and write the results.

    The folder appears, or replaces one of earlier results, when everything is done; on any error nothing is written.

    Args:
        folder: where to put the results.
        experiments: what to run without a planner.
        study: extent of the planned experiments; None leaves them out.
        beyond: extent of the chapter beyond the thesis; None leaves it out.
        replay: extent of the chapter on replays; None leaves it out.
        samples: random states of each robot in the cross-check.
        progress: told how far the job is.

    Raises:
        CrossCheckError: the backends disagree.
        OutputError: the folder cannot be written or holds other files.
        RedundancyPinError: an experiment cannot run, or matplotlib or, for the last chapters, casadi is not installed.
    """
    require_matplotlib()
    if beyond or replay:
        require_solver()
    require_replaceable(folder)
    planned = (PARTS + len(FIGURES) if study else 0) + (beyond_parts(beyond) + len(BEYOND_FIGURES) if beyond else 0)
    planned += replay_parts(replay) + len(REPLAY_FIGURES) if replay else 0
    steps = _Steps(2 * len(experiments) + planned + _CROSS_CHECK_STEPS, progress)
    robots = sorted({experiment.robot for experiment in experiments})
    check = require_agreement(robots, samples, lambda done, total: steps.part("cross-check", done / total))
    results = []
    for experiment in experiments:
        results.append(run(experiment))
        steps.next(experiment.name)
    compared = compare_with_thesis(results)
    found = run_study(study, steps.next) if study else None
    further = run_beyond(beyond, found.store if found else None, steps.next) if beyond else None
    replays = run_replays(replay, further.store if further else None, steps.next) if replay else None
    with replacing_folder(folder) as temporary:
        for result in results:
            write_result(temporary, result)
            steps.next(f"figures of {result.experiment.name}")
        write_comparisons(temporary, results)
        if found:
            write_thesis_figures(temporary, found, steps.next)
        if further:
            write_plans(temporary, further, CSV_DIGITS)
            write_figures(temporary, further, PICTURE_SUFFIXES, steps.next)
            write_text(temporary / "headline.md", headline(further.rows))
        if replays:
            write_table(temporary, replays)
            write_replay_figures(temporary, replays, PICTURE_SUFFIXES, steps.next)
        blocks = report(results, check, compared, found, further, replays)
        write_text(temporary / "report.md", markdown(blocks))
        write_text(temporary / "report.html", html(blocks, temporary))
        data = summary(results, check, compared, found, further, replays, [path.name for path in temporary.iterdir()])
        write_text(temporary / MANIFEST, json.dumps(data, indent=2, allow_nan=False) + "\n")
    return Reproduction(Path(folder), check, tuple(results), compared, found, further, replays, data)


def require_agreement(
    robots: Sequence[str], samples: int, progress: Callable[[int, int], None] | None = None
) -> CrossCheckReport:
    """Run the cross-check with the seed of the job.

    Args:
        robots: names of the robots.
        samples: random states of each.
        progress: told the states done and the states in all.

    Raises:
        CrossCheckError: a check fails; carries the failed rows.
    """
    check = crosscheck.run(robots, samples, CROSS_CHECK_SEED, progress)
    if not check.passed:
        failed = [row for row in check.rows if not row.passed]
        first = failed[0]
        raise CrossCheckError(
            f"The cross-check fails {len(failed)} of {len(check.rows)} checks; the first is {first.check!r} on "
            f"{first.robot}: worst {first.worst:.3g}, allowed {first.tolerance:.3g}. Nothing was written.",
            remedy="Run `redundancy-pin validate` for the whole table.",
            failed=tuple(failed),
        )
    return check


def write_result(folder: Path, result: Result) -> None:
    """Write the CSV file and the figures of one result.

    Raises:
        OutputError: a file cannot be written.
    """
    name = result.experiment.name
    write_text(folder / f"{name}.csv", result_csv(result))
    for kind, drawn in (("efforts", effort_figure(result)), ("path", path_figure(result))):
        save(drawn, *(folder / f"{name}-{kind}{suffix}" for suffix in PICTURE_SUFFIXES))


def write_comparisons(folder: Path, results: Sequence[Result]) -> None:
    """Write a figure for every motion that was run in more than one case.

    Raises:
        OutputError: a file cannot be written.
    """
    for motion_name in dict.fromkeys(result.experiment.motion_name for result in results):
        cases = [result for result in results if result.experiment.motion_name == motion_name]
        if len(cases) > 1:
            drawn = comparison_figure(cases)
            save(drawn, *(folder / f"{motion_name}-comparison{suffix}" for suffix in PICTURE_SUFFIXES))


def write_thesis_figures(folder: Path, study: Study, told: Callable[[str], None]) -> None:
    """Write the result figures of the thesis.

    Raises:
        OutputError: a file cannot be written.
    """
    for figure in FIGURES:
        save(figure.draw(study.store), *(folder / f"{figure.stem}{suffix}" for suffix in PICTURE_SUFFIXES))
        told(figure.title)


def result_csv(result: Result) -> str:
    """Return a result as CSV text: motion, efforts of both backends, carrier forces, status, margin, condition.

    An instant that occurs twice is a jump of the acceleration, seen from both sides. Efforts are ``nan`` where none
    exist.
    """
    motion, outcome = result.motion, result.rnea
    return csv_text(
        {
            "t": motion.t,
            "x": motion.x,
            "xd": motion.xd,
            "xdd": motion.xdd,
            "tau": outcome.distribution.tau,
            "tau_virtual_work": result.virtual_work.distribution.tau,
            "carrier_force": outcome.reduced.carrier_force,
            "status": outcome.distribution.status_labels,
            "margin": outcome.distribution.margin,
            "condition": outcome.distribution.condition,
            "residual": outcome.distribution.residual,
        },
        digits=CSV_DIGITS,
    )


class _Steps:
    """Counts steps and tells the progress function."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self._done, self._total, self._progress = _CROSS_CHECK_STEPS, total, progress

    def part(self, what: str, fraction: float) -> None:
        """Tell how far the cross-check, the first of the steps, is."""
        if self._progress:
            self._progress(int(fraction * _CROSS_CHECK_STEPS), self._total, what)

    def next(self, what: str) -> None:
        """Tell that an experiment was run or its figures were written."""
        self._done += 1
        if self._progress:
            self._progress(self._done, self._total, what)
