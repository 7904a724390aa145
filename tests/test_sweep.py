"""Sweeps: every point once, in the order of the grid, by processes that come and go; finished points are kept."""

from __future__ import annotations

import functools
import itertools
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.errors import InputError, RedundancyPinError, shown
from redundancy_pin.parallel import parallel

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
GRID = {"a": [1, 2, 3], "b": [10.0, 20.0]}


def area(a: float, b: float) -> dict[str, Any]:
    return {"area": a * b, "status": "ok"}


def where(number: int) -> dict[str, Any]:
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    return {"process": os.getpid(), "threads": [os.environ.get(name) for name in THREADS], "ignored": ignored}


def counted(number: int, folder: str, fails: bool = False) -> int:
    """Leave a file for each call."""
    Path(folder, f"{number}-{time.monotonic_ns()}").touch()
    if fails and number == 2:
        raise InputError("The third is wrong.", remedy="Leave it out.", number=number)
    return number**2


def slow(number: int, folder: str) -> int:
    time.sleep(0.2)
    return counted(number, folder)


@pytest.mark.parametrize("jobs", [1, 2])
def test_records_are_in_the_order_of_the_grid(jobs: int) -> None:
    seen: list[tuple[int, int]] = []
    result = rp.sweep(area, GRID, jobs=jobs, progress=lambda done, total: seen.append((done, total)))
    assert [dict(record) for record in result.records] == [
        {"a": a, "b": b, "area": a * b, "status": "ok"} for a, b in itertools.product(*GRID.values())
    ]
    np.testing.assert_array_equal(result.values("area"), np.outer(GRID["a"], GRID["b"]))
    assert result.values("status").shape == (3, 2)
    assert seen == [(done, 6) for done in range(1, 7)]


def test_points_one_by_one_and_functions_of_one_value() -> None:
    result = rp.sweep(abs_of, [{"x": -3}, {"x": 2}])
    assert [record["value"] for record in result.records] == [3, 2]
    assert result.values("value").tolist() == [3, 2]
    assert len(result) == 2
    assert len(rp.sweep(abs_of, [])) == 0


def echoed(a: int, folder: str) -> dict[str, int]:
    counted(a, folder)
    return {"a": a, "square": a**2}


def test_an_entry_with_the_name_of_an_argument_is_refused_at_the_first_result(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'a' is an argument, and an entry"):
        rp.sweep(echoed, {"a": [1, 2, 3], "folder": [str(tmp_path)]}, jobs=1)
    assert len(list(tmp_path.iterdir())) == 1


def test_numbers_of_processes_are_whole_numbers_of_any_kind() -> None:
    assert len(rp.sweep(area, GRID, jobs=int_of(np.int64(1)))) == 6
    for jobs in (1.0, 1.5, "2", np.float64(1.0), 0, -2, 10**6):
        with pytest.raises(InputError, match=rf"jobs is {re.escape(shown(jobs))}; this machine has \d+ cores"):
            rp.sweep(area, GRID, jobs=jobs)  # type: ignore[arg-type]


def int_of(number: Any) -> int:
    """Return a number as it stands: of numpy's kind, which mypy does not take for an int."""
    return number  # type: ignore[no-any-return]


def abs_of(x: float) -> float:
    return abs(x)


def test_a_data_frame_has_a_row_per_point() -> None:
    pandas = pytest.importorskip("pandas")
    frame = rp.sweep(area, GRID, jobs=1).to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == ["a", "b", "area", "status"]
    assert frame.groupby("a")["area"].sum().tolist() == [30.0, 60.0, 90.0]


def test_a_cache_takes_no_function_with_values_of_its_own(tmp_path: Path) -> None:
    def times(factor: float) -> Any:
        return lambda a: factor * a

    for function in (times(2.0), functools.partial(area, b=3.0), len):
        with pytest.raises(InputError, match="values beside its arguments"):
            rp.sweep(function, {"a": [1.0]}, jobs=1, cache=tmp_path)
    assert rp.sweep(times(2.0), {"a": [1.0, 2.0]}, jobs=1).values("value").tolist() == [2.0, 4.0]


def test_what_a_grid_lacks_is_named() -> None:
    with pytest.raises(InputError, match="The argument 'b' has no values"):
        rp.sweep(area, {"a": [1], "b": []})
    with pytest.raises(InputError, match=r"no entry 'aera'.*a, b, area, status"):
        rp.sweep(area, GRID, jobs=1).values("aera")


def vector(a: int) -> dict[str, Any]:
    return {"all": np.arange(3.0) + a, "ragged": np.zeros(a)}


def test_entries_that_are_arrays() -> None:
    result = rp.sweep(vector, {"a": [1, 2]}, jobs=1)
    assert result.values("all").tolist() == [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]
    with pytest.raises(InputError, match="'ragged' have different shapes"):
        result.values("ragged")


def test_what_is_no_grid_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for grid, keywords, says in (
        ({"a": "3rrr", "b": [1]}, {}, "a is '3rrr', not a list"),  # it would be three letters
        ({"a": 3, "b": [1]}, {}, "a is 3, not a list"),
        ([1, 2], {}, "mapping for each point"),
        (GRID, {"jobs": 1, "cache": tmp_path / "file"}, "The cache .* cannot be made"),
    ):
        with pytest.raises(InputError, match=says):
            rp.sweep(area, grid, **keywords)  # type: ignore[arg-type]


def test_processes_have_one_thread_each_and_leave_the_environment_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS[0], "7")
    monkeypatch.delenv(THREADS[1], raising=False)
    records = rp.sweep(where, {"number": range(5)}, jobs=2).records
    assert os.getpid() not in {record["process"] for record in records}
    # the caller answers Ctrl-C
    assert all(record["threads"] == ["1"] * 3 and record["ignored"] for record in records)
    assert os.environ[THREADS[0]] == "7"
    assert THREADS[1] not in os.environ
    assert {record["process"] for record in rp.sweep(where, {"number": [0, 1]}, jobs=1).records} == {os.getpid()}


def test_an_error_reaches_the_caller_whole_and_what_is_finished_is_kept(tmp_path: Path) -> None:
    """The second attempt computes what is missing, and nothing twice."""
    calls, cache = tmp_path / "calls", tmp_path / "cache"
    calls.mkdir()
    grid = {"number": range(4), "folder": [str(calls)], "fails": [True]}
    with pytest.raises(InputError, match="The third is wrong") as caught:
        rp.sweep(counted, grid, jobs=1, cache=cache)
    assert caught.value.details == {"number": 2}
    rest = [{"number": number, "folder": str(calls), "fails": True} for number in (0, 1, 3)]
    assert [record["value"] for record in rp.sweep(counted, rest, jobs=2, cache=cache).records] == [0, 1, 9]
    assert sorted(path.name[0] for path in calls.iterdir()) == ["0", "1", "2", "3"]
    rp.sweep(counted, rest, jobs=2)  # without a cache each is computed again
    assert len(list(calls.iterdir())) == 7


def test_a_process_that_dies_is_one_clear_error() -> None:
    with pytest.raises(RedundancyPinError, match=r"worker process died.*fewer jobs"):
        list(parallel(os._exit, [(1,), (1,)], 2))


def test_a_sweep_of_plans_is_what_each_plan_is(tmp_path: Path) -> None:
    result = rp.sweep(peak_of_corner, {"radius": [0.025, 0.05]}, jobs=2, cache=tmp_path)
    for radius, record in zip((0.025, 0.05), result.records, strict=True):
        alone = peak_of_corner(radius)
        assert (record["peak"], record["status"]) == (alone["peak"], alone["status"])


def peak_of_corner(radius: float) -> dict[str, Any]:
    plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner(radius=radius).sample(0.1))
    return {"peak": float(plan.peak_effort_at_samples.max()), "status": plan.status.value}


# --- a cluster of processes, by joblib's own backend ---------------------------------------------------------------


class Cluster:
    """A scheduler and workers, each a process that can be killed and started at any time."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address, self.folder = f"tcp://127.0.0.1:{port}", folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-show")
        self.workers = [self.work(), self.work()]

    def _start(self, module: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-W", "ignore", "-m", f"distributed.cli.{module}", *options, "--no-dashboard"]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
        with (self.folder / "cluster.log").open("ab") as log:
            process = subprocess.Popen(command, env=environment, cwd=self.folder, stdout=log, stderr=log)
        self.processes.append(process)
        return process

    def work(self) -> subprocess.Popen[bytes]:
        return self._start("dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--local-directory", "dask")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    running = Cluster(tmp_path)
    yield running
    for process in running.processes:
        process.kill()
        process.wait()


def test_points_are_computed_where_joblib_is_told_to() -> None:
    """Threads of this process in place of a cluster, which takes seconds to start; in no order in particular."""
    with joblib.parallel_config("threading", n_jobs=2):
        result = rp.sweep(where, {"number": range(5)}, jobs=None)
    assert {record["process"] for record in result.records} == {os.getpid()}
    assert result.values("number").tolist() == [*range(5)]


@pytest.mark.long
def test_a_cluster_that_loses_and_gains_a_worker_gives_what_one_machine_gives(cluster: Cluster, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    calls = tmp_path / "calls"
    calls.mkdir()
    done_of: list[int] = []

    def progress(done: int, total: int) -> None:
        done_of.append(done)
        if done == 5:
            cluster.workers[0].kill()
            cluster.work()

    with distributed.Client(cluster.address, timeout=60.0) as client:
        client.wait_for_workers(2, timeout=60.0)
        with joblib.parallel_config("dask", client=client):
            result = rp.sweep(slow, {"number": range(20), "folder": [str(calls)]}, progress=progress)
        client.wait_for_workers(2, timeout=60.0)  # a loaded machine takes seconds to start one
        assert len(client.scheduler_info(n_workers=-1)["workers"]) == 2
    assert result.values("value").ravel().tolist() == [number**2 for number in range(20)]
    assert done_of == list(range(1, 21))
    assert {int(path.name.partition("-")[0]) for path in calls.iterdir()} == set(range(20))
