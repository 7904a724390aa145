"""Sweeps: resumed after a kill without computing anything twice, on any backend of joblib, borders bisected."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from small_maps import corner, crossing, journal_lines

from redundancy_pin.errors import InfeasiblePlanError, InputError, RedundancyPinError
from redundancy_pin.experiments.feasibility import (
    STEPWISE,
    SWITCH_OFF,
    WHOLE,
    Axis,
    Cell,
    MapProblem,
    Verdict,
    feasibility_map,
    planning,
    sweep,
)
from redundancy_pin.experiments.feasibility.cell import Key

joblib = pytest.importorskip("joblib")

HERE = Path(__file__).resolve().parent


# -------------------------------------------------------------------------------------------- killed and taken up again

KILLED = """
import sys
sys.path.insert(0, {here!r})
import small_maps
from redundancy_pin.experiments.feasibility import feasibility_map, sweep
sweep._in_worker = small_maps.slow
feasibility_map(small_maps.corner(), {journal!r}, jobs=2)
"""


def test_workers_without_work_end_soon(asked: list[Key], monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of a caller that was killed wait for work until then; joblib's own five minutes are long."""
    given: dict[str, Any] = {}
    real = joblib.parallel_config

    def watched(**settings: Any) -> Any:
        given.update(settings)
        return real(**settings)

    monkeypatch.setattr(joblib, "parallel_config", watched)
    feasibility_map(corner(), jobs=1)
    assert asked
    assert 1.0 < given["idle_worker_timeout"] <= 30.0
    assert given["inner_max_num_threads"] == 1


def _heed_interrupts() -> None:
    """A shell starts what runs in its background with Ctrl-C ignored, and children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _start(journal: Path) -> subprocess.Popen[bytes]:
    """Start a sweep in a process group of its own, and wait until some cells are finished and some are not."""
    program = KILLED.format(here=str(HERE), journal=str(journal))
    sweeping = subprocess.Popen(
        [sys.executable, "-c", program],
        start_new_session=True,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        preexec_fn=_heed_interrupts,
    )
    patience = time.monotonic() + 120.0
    while not (journal.exists() and len(journal_lines(journal)) >= 4):
        if sweeping.poll() is not None or time.monotonic() > patience:
            os.killpg(sweeping.pid, signal.SIGKILL)
            pytest.fail(f"the sweep ended by itself: {sweeping.communicate()[1].decode()}")
        time.sleep(0.01)
    return sweeping


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_sweep_that_is_killed_goes_on_where_it_was(how: signal.Signals, tmp_path: Path, asked: list[Key]) -> None:
    journal = tmp_path / "journal.jsonl"
    sweeping = _start(journal)
    # SIGKILL takes everything at once; Ctrl-C goes to the whole group as well
    os.killpg(sweeping.pid, how)
    sweeping.communicate(timeout=60)
    assert sweeping.returncode != 0
    kept = [line for line in journal_lines(journal) if line.endswith(b"\n")]
    finished = {tuple(json.loads(line)[name] for name in ("planner", "x", "y")) for line in kept[1:]}
    assert 3 <= len(finished) < 18
    if how is signal.SIGKILL:  # the worst moment: in the middle of a line
        with journal.open("ab") as file:
            file.write(b'{"planner": "whole-traj')
    found = feasibility_map(corner(), journal, jobs=1)
    assert len(found.cells) == 18
    # nothing twice, nothing left out
    assert len(asked) == 18 - len(finished)
    assert not finished & set(asked)
    # what was finished is as it was, to the last byte
    assert journal_lines(journal)[: len(kept)] == kept
    assert len(journal_lines(journal)) == 19
    asked.clear()
    again = feasibility_map(corner(), journal, jobs=1)
    assert asked == []
    assert [cell.as_dict() for cell in again.cells] == [cell.as_dict() for cell in found.cells]


def test_a_finer_grid_takes_over_the_cells_it_shares(tmp_path: Path, asked: list[Key]) -> None:
    journal = tmp_path / "journal.jsonl"
    feasibility_map(crossing(), journal, jobs=1)
    assert len(asked) == 18
    finer = crossing(x=Axis("speed", (0.4, 0.6, 0.8, 2.0)), planners=(WHOLE,))
    asked.clear()
    found = feasibility_map(finer, journal, jobs=1)
    assert {x for _, x, _ in asked} == {0.6}
    assert len(found.cells) == 12


# ---------------------------------------------------------------------------------------------------- what may go wrong


def test_a_cell_that_fails_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def plan(made: Any, settings: Any) -> Any:
        if made.trajectory.duration > 2.0:
            raise ZeroDivisionError("by chance")
        raise InfeasiblePlanError("No.", constraint="track")

    monkeypatch.setattr(planning, "PLAN", {WHOLE: plan, STEPWISE: plan})
    found = feasibility_map(corner(), jobs=1)
    assert found.counts(WHOLE) == {"feasible": 0, "stopped_early": 0, "infeasible": 6, "failed": 3}
    assert all("by chance" in cell.message for cell in found.cells if cell.verdict is Verdict.FAILED)
    # failed cells have no border with infeasible ones
    assert found.border(WHOLE) == ()


def test_a_corner_of_the_map_may_be_out_of_the_domain() -> None:
    """At 1 m/s the ramps do not fit into the straights: those cells fail, the others do not."""
    problem = corner(x=Axis("speed", (0.1, 2.0)), y=Axis("stroke", (1.9, 2.0)), planners=(STEPWISE,))
    found = feasibility_map(problem, jobs=1)
    assert [cell.verdict for cell in found.cells if cell.x == 2.0] == [Verdict.FAILED] * 2
    assert all("InputError" in cell.message for cell in found.cells if cell.x == 2.0)
    assert Verdict.FAILED not in [cell.verdict for cell in found.cells if cell.x == 0.1]


def test_a_map_of_nothing_but_mistakes_is_refused_at_once(asked: list[Key]) -> None:
    with pytest.raises(InputError, match="ramp"):
        feasibility_map(corner(x=Axis("speed", (2.0, 3.0))), jobs=1)
    assert asked == []


def test_joblib_is_asked_for_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "joblib", None)
    with pytest.raises(RedundancyPinError, match=r"redundancy_pin\[parallel\]"):
        feasibility_map(corner())


def _die(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
    os._exit(1)


def test_a_worker_that_dies_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sweep, "_in_worker", _die)
    with pytest.raises(RedundancyPinError, match="worker process died"):
        feasibility_map(crossing(), tmp_path / "journal.jsonl", jobs=2)


# --------------------------------------------------------------------------------------------------------------- joblib


class Cluster(joblib._parallel_backends.ThreadingBackend):  # type: ignore[misc,name-defined]
    """A backend of somebody else; it counts what it is given, and hands over results only when all are there."""

    supports_return_generator = False
    given = 0

    def submit(self, func: Any, callback: Any = None) -> Any:
        type(self).given += 1
        return super().submit(func, callback)


def test_another_backend_of_joblib_computes_the_cells(asked: list[Key]) -> None:
    joblib.register_parallel_backend("cluster", Cluster)
    Cluster.given = 0
    with joblib.parallel_config(backend="cluster", n_jobs=2):
        found = feasibility_map(crossing(), jobs=None)
    assert Cluster.given == 18
    assert len(found.cells) == 18
    here = feasibility_map(crossing(), jobs=1)
    assert [cell.as_dict() for cell in here.cells] == [cell.as_dict() for cell in found.cells]


def _threads(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
    said = " ".join(os.environ.get(name, "") for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"))
    return Cell(planner, x, y, Verdict.FAILED, message=f"{os.getpid()} {said}")


def test_processes_have_one_thread_each(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sweep, "_in_worker", _threads)
    found = feasibility_map(crossing(), jobs=2)
    pids, *threads = zip(*(cell.message.split() for cell in found.cells), strict=True)
    assert str(os.getpid()) not in pids
    assert {*threads[0], *threads[1]} == {"1"}


def test_progress_counts_every_cell(asked: list[Key]) -> None:
    told: list[tuple[int, int, str]] = []
    feasibility_map(crossing(), jobs=1, progress=lambda *args: told.append(args))
    assert told[0] == (0, 18, "grid")
    assert [done for done, _, _ in told] == list(range(19))


# --------------------------------------------------------------------------------------------------------------- border


@pytest.mark.parametrize("along", ["x", "y"])
def test_the_border_is_bisected(along: Any, asked: list[Key]) -> None:
    problem = crossing(x=Axis("speed", (0.12, 0.17, 0.29)), planners=(WHOLE,))
    for refine in (0, 3):
        found = feasibility_map(problem, jobs=1, refine=refine, along=along)
        border = found.border(WHOLE)
        assert border
        axis = problem.x if along == "x" else problem.y
        widest = max(b - a for a, b in zip(axis.values[:-1], axis.values[1:], strict=True))
        for crossing_ in border:
            # the true border of `quick`: x = 0.1 + 0.2 y
            true = 0.1 + 0.2 * crossing_.line if along == "x" else (crossing_.line - 0.1) / 0.2
            assert crossing_.low <= true <= crossing_.high
            assert crossing_.high - crossing_.low <= widest / 2**refine * (1 + 1e-9)
            assert crossing_.possible == ("low" if along == "x" else "high")


def test_a_border_on_a_logarithmic_axis_is_halved_there(asked: list[Key]) -> None:
    problem = crossing(x=Axis("speed", (0.01, 1.0), "log"), planners=(SWITCH_OFF,))
    feasibility_map(problem, jobs=1, refine=1)
    assert (SWITCH_OFF, 0.1, 0.05) in asked
