"""The chapter beyond the thesis on a small scale: its numbers against the saved plans and the other backend."""

from __future__ import annotations

import csv
import functools
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from redundancy_pin.experiments import Reproduction, job
from redundancy_pin.experiments.beyond import QUICK, Beyond
from redundancy_pin.experiments.beyond.pictures import FIGURES
from redundancy_pin.experiments.beyond.rows import Row
from redundancy_pin.experiments.beyond.tasks import TASKS, Task
from redundancy_pin.experiments.beyond.ways import EFFORT, NONE, PEAK, SWITCH_OFF, SWITCH_OFF_LATE

from redundancy_pin import CarrierMotion, Plan, distribute, load_plan
from redundancy_pin.crosscheck import CheckRow, CrossCheckReport
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.visualisation import style

ROUNDING = 1e-9
"""The same sums in another order."""

OTHER_BACKEND = 1e-7
"""Efforts by the other backend over the largest, where W is no worse conditioned than ``CONDITION``: 1e-12 of it."""

CONDITION = 1e4

BETWEEN = 0.02
"""Peaks on two grids, 20 points a step each but not the same ones; 5 ms to 80 ms a step here."""


ROWS = (CheckRow("2rpr", "parity: f", 10, 1e-15, 1e-10, True),)


@functools.cache
def done() -> Reproduction:
    """Run the main job once a process, the last chapter alone and coarsely."""
    folder = Path(tempfile.mkdtemp()) / "results"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(job, "PICTURE_SUFFIXES", (".png",))
        patched.setitem(style._SETTINGS, "savefig.dpi", 40)
        patched.setattr(job.crosscheck, "run", lambda *_: CrossCheckReport(ROWS, 0))  # has tests of its own
        return job.reproduce(folder, [], study=None, beyond=QUICK, replay=None)


def beyond() -> Beyond:
    found = done().beyond
    assert found is not None
    return found


def summary() -> dict[str, Any]:
    data: dict[str, Any] = json.loads((done().folder / "summary.json").read_text())["beyond"]
    return data


def saved() -> list[tuple[Task, Row, Plan]]:
    """Every row that has a file, with the plan read back from it."""
    by_name = {task.name: task for task in TASKS}
    rows = [row for row in beyond().rows if row.file]
    return [(by_name[row.task], row, load_plan(done().folder / f"{row.file}.npz")) for row in rows]


def other(task: Task) -> Dynamics:
    """The backend that did not make the plan, where there is one."""
    return task.machine.dynamics(task.machine.backends[-1])


def inside(plan: Plan, parts: int) -> tuple[np.ndarray[Any, Any], CarrierMotion]:
    """Times inside the steps and the carriers there, s̈ linear in a step, by Taylor series from its start."""
    t, c = plan.t, plan.carriers
    left = np.flatnonzero(np.diff(t) > 0.0)
    h = np.diff(t)[left]
    fraction = (np.arange(parts) + 0.5) / parts
    x = (fraction[None] * h[:, None])[..., None]
    jerk = ((c.sdd[left + 1] - c.sdd[left]) / h[:, None])[:, None]
    s, sd, sdd = (part[left][:, None] for part in (c.s, c.sd, c.sdd))
    k = c.s.shape[1]
    motion = CarrierMotion(
        (s + sd * x + sdd * x**2 / 2 + jerk * x**3 / 6).reshape(-1, k),
        (sd + sdd * x + jerk * x**2 / 2).reshape(-1, k),
        (sdd + jerk * x).reshape(-1, k),
    )
    return (t[left, None] + fraction[None] * h[:, None]).ravel(), motion


def test_every_motion_has_its_rows() -> None:
    assert {row.task for row in beyond().rows} == {task.name for task in TASKS}
    for task in TASKS:
        ways = {row.way for row in beyond().of(task)}
        assert {EFFORT, PEAK, SWITCH_OFF if task.crosses else NONE} <= ways
    assert {(row.task, row.way) for row in beyond().rows if not row.exists} == {
        (task, way) for task in ("heavy-0.5", "five-bar-0.3") for way in (SWITCH_OFF, SWITCH_OFF_LATE)
    }
    assert len([row for row in beyond().rows if row.file and row.exists]) >= 2 * len(TASKS)


def test_tables_hold_what_the_saved_plans_hold() -> None:
    for _, row, plan in saved():
        tau = np.abs(plan.tau)
        assert row.status == plan.status.value
        assert row.peak == pytest.approx(tau.max(), rel=ROUNDING)
        duration = plan.t[-1] - plan.t[0]
        assert row.rms == pytest.approx(np.sqrt(np.trapezoid((tau**2).sum(axis=1), plan.t) / duration), rel=ROUNDING)
        assert row.carrier_force == pytest.approx(np.abs(plan.carrier_force).max(), rel=ROUNDING)
        for value, part in zip((row.position, row.speed, row.acceleration), ("s", "sd", "sdd"), strict=True):
            assert value == pytest.approx(np.abs(getattr(plan.carriers, part)).max(), rel=ROUNDING)


def test_efforts_and_energies_follow_from_the_saved_motion_by_the_other_backend() -> None:
    for task, row, plan in saved():
        reduced = other(task).reduce(task.trajectory().sample_at(plan.t), plan.carriers, check_track=False)
        # W τ = f at every sample, singular ones and those with the motors off included
        imbalance = np.abs(np.einsum("nij,nj->ni", reduced.W, plan.tau) - reduced.f)
        smooth = np.append(True, np.diff(plan.t) > 0.0) & np.append(np.diff(plan.t) > 0.0, True)  # jumps have two sides
        assert imbalance[smooth].max() <= 1e-6 * np.abs(reduced.f).max(), row.file
        good = smooth & (plan.condition < CONDITION) & (plan.phase == 0)
        assert good.sum() > 0.2 * len(plan.t)
        tau = distribute(reduced).tau
        np.testing.assert_allclose(tau[good], plan.tau[good], atol=OTHER_BACKEND * row.peak, err_msg=row.file)
        rate = np.einsum("nij,ni->nj", reduced.W, plan.motion.xd)
        main = np.trapezoid(np.abs(plan.tau * rate).sum(axis=1), plan.t)
        assert row.main_energy == pytest.approx(main, rel=1e-6)
        own = np.trapezoid(np.abs(plan.carrier_force * plan.carriers.sd).sum(axis=1), plan.t)
        assert row.carrier_energy == pytest.approx(own, rel=1e-6)


def test_peaks_between_the_nodes_and_limits_by_the_other_backend() -> None:
    checked = 0
    for task, row, plan in saved():
        if row.way == SWITCH_OFF:
            continue
        times, motion = inside(plan, 20)
        tau = distribute(other(task).reduce(task.trajectory().sample_at(times), motion)).tau
        assert np.abs(tau).max() == pytest.approx(row.dense_peak, rel=BETWEEN), row.file
        if row.sound:
            for values, most in (
                (motion.s, row.track),
                (motion.sd, row.speed_limit),
                (motion.sdd, row.acceleration_limit),
            ):
                assert np.abs(values).max() <= most * (1.0 + ROUNDING), row.file
            checked += 1
    assert checked >= len(TASKS)


def test_the_files_agree_with_each_other() -> None:
    folder = done().folder
    text = (folder / "report.md").read_text()
    with (folder / "beyond.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    rows = summary()["plans"]
    assert len(table) == len(rows) == len(beyond().rows)
    for line, row in zip(table, rows, strict=True):
        assert (line["task"], line["way"], line["status"]) == (row["task"], row["way"], row["status"])
        if row["peak"] is None:
            assert line["peak"] == "nan"
            continue
        assert float(line["peak"]) == row["peak"]
        shown = f"[{row['way']}]({row['file']}.npz)" if row["file"] else row["way"]
        before = f" ({row['before']:.3g} until off)" if row["before"] is not None else ""
        cells = f"| {row['task']} | {shown} | {row['status']} | {row['peak']:.3g}{before} | {row['dense_peak']:.3g} |"
        assert cells in text
    listed = json.loads((folder / "summary.json").read_text())["files"]
    assert sorted([*listed, "summary.json"]) == sorted(path.name for path in folder.iterdir())


def test_every_figure_is_there_and_in_the_report() -> None:
    text = (done().folder / "report.md").read_text()
    for figure in FIGURES:
        assert (done().folder / f"{figure.stem}.png").read_bytes().startswith(b"\x89PNG")
        assert f"]({figure.stem}.png)" in text
    page = (done().folder / "report.html").read_text()
    assert page.count("data:image/png;base64,") == len(FIGURES)
    assert "Beyond the thesis" in page


def test_findings_are_in_the_report() -> None:
    text = (done().folder / "report.md").read_text()
    for finding, row in zip(beyond().findings, summary()["findings"], strict=True):
        assert f"| {finding.claim} | {finding.stands} | {finding.here}" in text
        assert row["stands"] == finding.stands
    for target in beyond().targets:
        assert target.said in text


def test_plans_that_do_not_exist_are_shown_with_the_force_that_is_missing() -> None:
    text = (done().folder / "report.md").read_text()
    heavy = next(row for row in beyond().rows if (row.task, row.way) == ("heavy-0.5", SWITCH_OFF))
    # by hand: mass of the end-effector times its acceleration along the force; the legs' own masses have no part in it
    motion = next(task for task in TASKS if task.name == "heavy-0.5").trajectory()
    whole = next(plan for _, row, plan in saved() if (row.task, row.way) == ("heavy-0.5", EFFORT))
    instant = whole.diagnostics["singular_instants"][0]  # type: ignore[index]
    assert f"t = {instant:.6g} s" in heavy.why
    assert f"{heavy.missing:.6g} N" in heavy.why
    acceleration = motion.sample_at(np.array([instant])).xdd[0, 0]
    assert heavy.missing == pytest.approx(0.5 * abs(acceleration), rel=1e-9)
    assert f"No plan for heavy-0.5, {SWITCH_OFF}: {heavy.why}" in text
    assert f"| heavy-0.5 | {SWITCH_OFF} | infeasible | none |" in text


def test_the_same_run_writes_the_same_plans() -> None:
    for _, _, plan in saved():
        assert not {"seconds", "solver_seconds"} & set(plan.diagnostics)


def test_progress_counts_up_to_the_total() -> None:
    from redundancy_pin.experiments.beyond import study

    told: list[str] = []
    with pytest.MonkeyPatch.context() as patched:
        for name in ("crossing_rows", "corner_rows"):
            patched.setattr(study, name, lambda *args, **options: ())
        for name in ("_race", "mode_rows", "backend_row", "starts_row", "trade", "targets", "findings"):
            patched.setattr(study, name, lambda *args: ())
        study.run_beyond(QUICK, told=told.append)
    assert len(told) == study.parts(QUICK)
