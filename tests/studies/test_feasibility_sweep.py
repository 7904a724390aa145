"""Sweeps: resumed after a kill without computing anything twice, on any backend of joblib, borders bisected."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import joblib
import pytest
from small_maps import corner, crossing

from redundancy_pin.errors import InfeasiblePlanError, InputError, OutputError, RedundancyPinError
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies import feasibility
from redundancy_pin.studies.case import Case
from redundancy_pin.studies.feasibility import STEPWISE, SWITCH_OFF, WHOLE, Axis, MapProblem, feasibility_map
from redundancy_pin.studies.verdicts import Cell, Key

HERE = Path(__file__).resolve().parent


# ----------------------------------------------------------------------------------------------------- killed, resumed

KILLED = """
import sys
sys.path.insert(0, {here!r})
import small_maps
from redundancy_pin.studies import feasibility
from redundancy_pin.studies.feasibility import feasibility_map
feasibility.compute = small_maps.slow
feasibility_map(small_maps.corner(), {store!r}, jobs=2, progress=lambda done, total, what: print(done, flush=True))
"""


def _heed_interrupts() -> None:
    """A shell starts what runs in its background with Ctrl-C ignored, and children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.long
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_sweep_that_is_killed_goes_on_where_it_was(how: signal.Signals, tmp_path: Path, computed: list[Key]) -> None:
    store = tmp_path / "store.sqlite"
    program = KILLED.format(here=str(HERE), store=str(store))
    with subprocess.Popen(
        [sys.executable, "-c", program],
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        preexec_fn=_heed_interrupts,
    ) as sweeping:
        assert sweeping.stdout is not None
        assert [sweeping.stdout.readline() for _ in range(5)] == [f"{done}\n" for done in range(5)]
        # SIGKILL takes everything at once; Ctrl-C goes to the whole group as well
        os.killpg(sweeping.pid, how)
        sweeping.wait(timeout=60)
    assert sweeping.returncode != 0
    first = feasibility_map(corner(), store, jobs=1)
    # nothing twice, nothing left out; up to one a process may be lost on the way to the store
    assert len(first.cells) == 18
    assert 8 <= len(set(computed)) == len(computed) <= 14
    computed.clear()
    again = feasibility_map(corner(), store, jobs=1)
    assert computed == []
    assert again.as_dict() == first.as_dict()


def test_a_finer_grid_takes_over_the_cells_it_shares(tmp_path: Path, computed: list[Key]) -> None:
    feasibility_map(crossing(), tmp_path / "store", jobs=1)
    assert len(computed) == 18
    computed.clear()
    finer = feasibility_map(
        crossing(x=Axis("speed", (0.4, 0.6, 0.8, 2.0)), planners=(WHOLE,)), tmp_path / "store", jobs=1
    )
    assert {x for _, x, _ in computed} == {0.6}
    assert len(finer.cells) == 12


def test_another_problem_is_refused_and_named(tmp_path: Path, computed: list[Key]) -> None:
    store = tmp_path / "store"
    feasibility_map(corner(), store, jobs=1)
    before = store.read_bytes()
    for changed, says in (
        (corner(limits={"max_effort": 4.0}), "for limits.max_effort it has 5.0, now it is 4.0"),
        (corner(parameters={}), "parameters"),
        (corner(mode=(-1, -1, -1)), "mode"),
        (corner(settings={"carrier_mass": 1.0}), "settings"),
        (corner(y=Axis("max_speed", (0.1, 1.0))), "axes"),
        (corner(options={"radius": 0.013}), "options"),
    ):
        with pytest.raises(OutputError, match="another feasibility map") as caught:
            feasibility_map(changed, store, jobs=1)
        assert says in caught.value.message
    assert store.read_bytes() == before


def test_a_robot_whose_file_has_changed_is_another_problem(
    tmp_path: Path, computed: list[Key], monkeypatch: pytest.MonkeyPatch
) -> None:
    feasibility_map(corner(), tmp_path / "store", jobs=1)
    monkeypatch.setattr(feasibility, "fingerprint", lambda robot: "another")
    with pytest.raises(OutputError, match="machine"):
        feasibility_map(corner(), tmp_path / "store", jobs=1)


def test_a_cell_without_meaning_is_damage(tmp_path: Path, computed: list[Key]) -> None:
    store = tmp_path / "store"
    feasibility_map(corner(), store, jobs=1)
    with sqlite3.connect(store) as raw:
        raw.execute("""UPDATE record SET record = replace(record, '"infeasible"', '"perhaps"')""")
    raw.close()
    with pytest.raises(OutputError, match="damaged"):
        feasibility_map(corner(), store, jobs=1)


def test_cells_survive_the_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = (
        ResultStatus.INFEASIBLE,
        ("track", "end"),
        "c",
        0.1,
        float("nan"),
        None,
        1.1,
        0.5,
        "",
        "ü",
        {"a": [1.0, "b"]},
    )
    monkeypatch.setattr(feasibility, "compute", lambda problem, *key: Cell(*key, *given))
    before = feasibility_map(corner(), tmp_path / "store", jobs=1)
    again = feasibility_map(corner(), tmp_path / "store", jobs=1)
    assert [cell.as_dict() for cell in again.cells] == [cell.as_dict() for cell in before.cells]
    assert again.cells[0].amount is None  # JSON knows no NaN


# ---------------------------------------------------------------------------------------------------- what may go wrong


def test_a_cell_that_fails_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def plan(case: Case, backend: str) -> Any:
        if case.trajectory().duration > 2.0:
            raise ZeroDivisionError("by chance")
        raise InfeasiblePlanError("No.", constraint="track")

    monkeypatch.setattr(Case, "plan", plan)
    result = feasibility_map(corner(), jobs=1)
    assert result.counts(WHOLE) == {"ok": 0, "not_converged": 0, "unresolved": 3, "infeasible": 6}
    assert all("by chance" in cell.message for cell in result.cells if cell.verdict is ResultStatus.UNRESOLVED)
    # failed cells have no border with infeasible ones
    assert result.border(WHOLE) == ()


def test_a_corner_of_the_map_may_be_out_of_the_domain() -> None:
    """At 1 m/s the ramps do not fit into the straights: those cells fail, the others do not."""
    problem = corner(x=Axis("speed", (0.1, 2.0)), y=Axis("stroke", (1.9, 2.0)), planners=(STEPWISE,))
    result = feasibility_map(problem, jobs=1)
    assert [cell.verdict for cell in result.cells if cell.x == 2.0] == [ResultStatus.UNRESOLVED] * 2
    assert all("InputError" in cell.message for cell in result.cells if cell.x == 2.0)
    assert ResultStatus.UNRESOLVED not in [cell.verdict for cell in result.cells if cell.x == 0.1]


def test_a_map_of_nothing_but_mistakes_is_refused_at_once(computed: list[Key]) -> None:
    with pytest.raises(InputError, match="ramp"):
        feasibility_map(corner(x=Axis("speed", (2.0, 3.0))), jobs=1)
    assert computed == []


def _die(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
    os._exit(1)


@pytest.mark.long
def test_a_worker_that_dies_is_one_clear_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(feasibility, "compute", _die)
    with pytest.raises(RedundancyPinError, match="worker process died"):
        feasibility_map(crossing(), tmp_path / "store", jobs=2)


# --------------------------------------------------------------------------------------------------------------- joblib


class Cluster(joblib._parallel_backends.ThreadingBackend):  # type: ignore[misc,name-defined]
    """A backend of somebody else; it counts what it is given, and hands over results only when all are there."""

    supports_return_generator = False
    given = 0

    def submit(self, func: Any, callback: Any = None) -> Any:
        type(self).given += 1
        return super().submit(func, callback)


def test_another_backend_of_joblib_computes_the_cells(computed: list[Key]) -> None:
    joblib.register_parallel_backend("cluster", Cluster)
    Cluster.given = 0
    with joblib.parallel_config(backend="cluster", n_jobs=2):
        there = feasibility_map(crossing(), jobs=None)
    assert Cluster.given == 18
    here = feasibility_map(crossing(), jobs=1)
    assert here.as_dict() == there.as_dict()


def test_progress_counts_every_cell(computed: list[Key]) -> None:
    seen: list[tuple[int, int, str]] = []
    feasibility_map(crossing(), jobs=1, progress=lambda *args: seen.append(args))
    assert seen[0] == (0, 18, "grid")
    assert [done for done, _, _ in seen] == list(range(19))


# --------------------------------------------------------------------------------------------------------------- border


@pytest.mark.parametrize("along", ["x", "y"])
def test_the_border_is_bisected(along: Any, computed: list[Key]) -> None:
    problem = crossing(x=Axis("speed", (0.12, 0.17, 0.29)), planners=(WHOLE,))
    for refine in (0, 3):
        border = feasibility_map(problem, jobs=1, refine=refine, along=along).border(WHOLE)
        assert border
        axis = problem.x if along == "x" else problem.y
        widest = max(b - a for a, b in zip(axis.values[:-1], axis.values[1:], strict=True))
        for crossing_ in border:
            # the true border of `quick`: x = 0.1 + 0.2 y
            true = 0.1 + 0.2 * crossing_.line if along == "x" else (crossing_.line - 0.1) / 0.2
            assert crossing_.low <= true <= crossing_.high
            assert crossing_.high - crossing_.low <= widest / 2**refine * (1 + 1e-9)
            assert crossing_.possible == ("low" if along == "x" else "high")


def test_a_border_on_a_logarithmic_axis_is_halved_there(computed: list[Key]) -> None:
    problem = crossing(x=Axis("speed", (0.01, 1.0), "log"), planners=(SWITCH_OFF,))
    feasibility_map(problem, jobs=1, refine=1)
    assert (SWITCH_OFF, 0.1, 0.05) in computed
