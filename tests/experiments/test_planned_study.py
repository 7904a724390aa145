"""The planned study on a small scale, and the main job that writes it."""

from __future__ import annotations

import functools
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import cases
import numpy as np
import pytest
from redundancy_pin.experiments import Reproduction, job
from redundancy_pin.experiments.planned import QUICK, Study
from redundancy_pin.experiments.planned.cases import CORNERS
from redundancy_pin.experiments.planned.judged import ROWS
from redundancy_pin.experiments.planned.thesis_figures import FIGURES
from test_document import Seen

SECTION = {
    "3.11 entry", "3.11 exit", "3.13 entry", "3.13 exit", "3.14 entry", "3.14 exit", "3.16 entry", "3.16 exit",
    "3.18-3.20", "3.21-3.22", "4.8-4.9", "4.10-4.11", "4.12-4.14", "4.15-4.16", "4.17-4.18",
}  # fmt: skip
"""Result figures with numbers or statements in the text of the thesis."""

NUMBERS = [*(f"3.{i}" for i in range(6, 23)), *(f"4.{i}" for i in range(2, 19))]
"""Result figures of the thesis."""


@functools.cache
def done() -> Reproduction:
    """Run the main job once a process: one motion without a planner, two working modes, ends of the grids."""
    folder = Path(tempfile.mkdtemp()) / "results"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(job, "PICTURE_SUFFIXES", (".png",))  # half the time
        return job.reproduce(
            folder, [cases.experiment("corner-r0.025-baseline")], study=QUICK, beyond=None, replay=None, samples=4
        )


def study() -> Study:
    found = done().study
    assert found is not None
    return found


def test_every_statement_has_a_row() -> None:
    assert set(ROWS) == SECTION
    assert {row.row for row in study().judged} == SECTION
    for row in study().judged:
        assert row.stated
        assert row.ours
        assert row.verdict in ("reproduced", "differs")
        assert row.reason or row.verdict == "reproduced", row
    verdicts = [row.verdict for row in study().judged]
    assert "differs" in verdicts
    assert "reproduced" in verdicts


def test_every_result_figure_is_written_and_explained() -> None:
    assert [figure.number for figure in FIGURES] == NUMBERS
    text = (done().folder / "report.md").read_text()
    for figure in FIGURES:
        path = done().folder / f"{figure.stem}.png"
        assert path.read_bytes().startswith(b"\x89PNG")
        assert f"]({path.name})" in text
        assert figure.caption(study().store) in text


def test_html_needs_nothing_else() -> None:
    text = (done().folder / "report.html").read_text()
    page = Seen()
    page.feed(text)
    images = [str(attributes["src"]) for tag, attributes in page.tags if tag == "img"]
    assert len(images) == len(FIGURES) + 2
    assert all(image.startswith("data:image/png;base64,") for image in images)
    assert all(str(attributes["href"]).startswith("#") for _, attributes in page.tags if "href" in attributes)
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.tags}
    assert "http://" not in text
    assert "https://" not in text
    assert "url(" not in text


def test_summary_holds_the_study_and_lists_every_file() -> None:
    data = json.loads((done().folder / "summary.json").read_text())
    assert sorted([*data["files"], "summary.json"]) == sorted(path.name for path in done().folder.iterdir())
    planned = data["planned"]
    assert len(planned["against_thesis"]) == len(study().judged)
    assert planned["heavy_end_effector"]["details"]["amount"] > 0.0
    assert max(row["worst"] for row in planned["parity"]) < 1e-8
    assert max(row["worst"] for row in planned["parity"]) > 0.0  # not one backend twice


def test_the_track_is_left_where_it_is_left() -> None:
    """Rebuilt elsewhere: carrier 1 is at 0.247 m (0.5 m/s) and 0.260 m (0.75 m/s) as actuators are switched on."""
    rows = {row.case: row for row in study().crossings}
    assert rows["circle-0.5-cn5"].status == "violates_limits"
    assert rows["circle-0.5-cn5"].beyond_track_at_exit == pytest.approx(0.047, abs=5e-4)
    assert rows["circle-0.75-cn5"].beyond_track_at_exit == pytest.approx(0.060, abs=5e-4)
    assert rows["circle-0.5-cn20"].beyond_track == 0.0
    assert np.isnan(rows["circle-0.5-cn5"].shortest)
    assert "track" in rows["circle-0.5-cn5"].no_shortest


def test_ranges_contain_the_run_they_vary() -> None:
    for row in study().sensitivity:
        assert row.low <= row.high or np.isnan(row.low)
    by_mode = [row for row in study().sensitivity if row.parameter == "working mode" and not np.isnan(row.ours)]
    assert by_mode
    for row in by_mode:  # the run's own mode is on the grid
        assert row.low - 1e-12 <= row.ours <= row.high + 1e-12


def test_actuators_do_at_least_the_work_that_the_platform_gains_and_loses() -> None:
    """Without gravity ∫ Σ |power| dt is no less than the total variation of the kinetic energy."""
    for row in study().fair:
        if row.motion.startswith("corner") and not row.moving:
            case = next(case for case in CORNERS if case.name.startswith(row.motion))
            case = replace(case, mode=row.mode)
            alone = row.what == "no carriers"
            plan = study().store.baseline(case) if alone else study().store.parked(case)
            machine = case.baseline_dynamics("rnea") if alone else case.dynamics("rnea")
            energy = machine.along(plan.motion).energy()
            assert row.energy >= np.abs(np.diff(energy)).sum() * (1.0 - 1e-3)  # trapezoids of 5 ms
