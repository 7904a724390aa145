"""The same work on a dask cluster of separate processes, which come and go: the result is that of one machine."""

from __future__ import annotations

import contextlib
import os
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import small_maps

from redundancy_pin import crosscheck, workers
from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.studies import feasibility
from redundancy_pin.studies.feasibility import Axis, FeasibilityMap, feasibility_map
from redundancy_pin.studies.robustness import robustness_study
from redundancy_pin.studies.trial import SCENARIOS, Scenario
from redundancy_pin.workers import cluster, parallel

distributed = pytest.importorskip("distributed")

HERE = Path(__file__).resolve().parent


class Machines:
    """A scheduler and workers, each a process that can be killed and started at any time."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        # the workers see what this process sees: the package, and the cells of the tests
        self.environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
        self.scheduler = self.schedule()
        self.workers: list[subprocess.Popen[bytes]] = []

    def _start(self, module: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-W", "ignore", "-m", f"distributed.cli.{module}", *options, "--no-dashboard"]
        with (self.folder / "cluster.log").open("ab") as log:
            process = subprocess.Popen(command, env=self.environment, cwd=self.folder, stdout=log, stderr=log)
        self.processes.append(process)
        return process

    def schedule(self) -> subprocess.Popen[bytes]:
        """Start a scheduler, and wait until it listens: on a busy machine its imports alone take ten seconds."""
        process = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-show")
        for _ in range(600):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1.0):
                return process
            time.sleep(0.1)
        raise TimeoutError("The scheduler does not listen.")

    def work(self, count: int = 1) -> None:
        self.workers += [
            self._start("dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--local-directory", "dask")
            for _ in range(count)
        ]

    def end(self, *processes: subprocess.Popen[bytes]) -> None:
        for process in processes:
            process.kill()
            process.wait()


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    running = Machines(tmp_path)
    yield running
    running.end(*running.processes)


def mapped(store: Path, told: Callable[[int], object] = lambda done: None, **axes: Any) -> FeasibilityMap:
    problem = small_maps.corner(**axes)
    return feasibility_map(problem, store, progress=lambda done, total, what: told(done))


def stored(path: Path) -> int:
    """Records of a store; that they differ is seen by whoever reads it."""
    with sqlite3.connect(path) as raw:
        ((count,),) = raw.execute("SELECT count(DISTINCT record) FROM record").fetchall()
        assert raw.execute("SELECT count(*) FROM record").fetchall() == [(count,)]
    raw.close()
    return int(count)


def test_a_map_of_a_cluster_is_that_of_one_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feasibility, "compute", small_maps.quick)
    seen: list[int] = []
    options: dict[str, Any] = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as local, cluster(local.scheduler_address):
        there = mapped(tmp_path / "store.sqlite", seen.append)
    assert seen == list(range(19))
    assert stored(tmp_path / "store.sqlite") == 18
    assert there.as_dict() == feasibility_map(small_maps.corner(), jobs=1).as_dict()


@pytest.mark.long
def test_a_map_of_a_cluster_that_loses_a_worker_is_that_of_one_machine(
    machines: Machines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feasibility, "compute", small_maps.slow)
    machines.work(2)

    def killed(done: int) -> None:
        if done == 3:
            machines.end(machines.workers[0])

    with cluster(machines.address):
        there = mapped(tmp_path / "store.sqlite", killed)
    assert stored(tmp_path / "store.sqlite") == 18
    monkeypatch.setattr(feasibility, "compute", small_maps.quick)
    assert there.as_dict() == feasibility_map(small_maps.corner(), jobs=1).as_dict()


@pytest.mark.long
def test_errors_of_calls_and_of_the_cluster_reach_the_caller(
    machines: Machines, monkeypatch: pytest.MonkeyPatch
) -> None:
    machines.work(1)
    with cluster(machines.address):
        with pytest.raises(InputError, match="fewest"):
            list(parallel(small_maps.refuses, [(1,), (2,)]))
        assert list(parallel(small_maps.place, [(i,) for i in range(20)], ordered=True)) == list(range(20))
        with monkeypatch.context() as patched:
            patched.setattr(workers, "own_version", lambda: "0.0.0")
            with pytest.raises(RedundancyPinError, match=r"the caller 0\.0\.0"):
                list(parallel(small_maps.place, [(1,)]))
        monkeypatch.setattr(workers, "PATIENCE", 1.0)
        machines.end(*machines.workers)
        with pytest.raises(RedundancyPinError, match="has no workers"):
            list(parallel(small_maps.place, [(1,)]))


def test_an_address_where_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "ANSWER", 0.5)
    with pytest.raises(InputError, match="No scheduler answers at tcp"), cluster("tcp://127.0.0.1:9"):
        pass
    with pytest.raises(InputError, match="No scheduler answers at nonsense://a"), cluster("nonsense://a"):
        pass


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(RedundancyPinError, match=r"redundancy_pin\[dask\]"), cluster("tcp://127.0.0.1:9"):
        pass


@pytest.mark.long
def test_workers_come_and_go_and_so_does_the_scheduler(
    machines: Machines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two workers; one is killed; two more come; the scheduler goes, with its workers, and both come back."""
    monkeypatch.setattr(feasibility, "compute", small_maps.slow)
    machines.work(2)
    values = tuple(0.05 + 0.01 * i for i in range(12))
    seen: list[int] = []

    def told(done: int) -> None:
        seen.append(done)
        if done == 5:
            machines.end(machines.workers[0])
        elif done == 15:
            machines.work(2)
        elif done == 30:
            machines.end(machines.scheduler, *machines.workers)
            machines.scheduler = machines.schedule()
            machines.work(2)

    with cluster(machines.address):
        there = mapped(tmp_path / "store.sqlite", told, x=Axis("speed", values))
    assert seen == list(range(73))  # nothing is given twice
    assert stored(tmp_path / "store.sqlite") == 72
    monkeypatch.setattr(feasibility, "compute", small_maps.quick)
    assert there.as_dict() == mapped(tmp_path / "alone.sqlite", x=Axis("speed", values)).as_dict()


@pytest.mark.long
def test_a_scheduler_that_stays_away_leaves_a_store_to_go_on_from(
    machines: Machines, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feasibility, "compute", small_maps.slow)
    machines.work(2)

    def leave(done: int) -> None:
        if done == 4:
            monkeypatch.setattr(workers, "PATIENCE", 3.0)
            machines.end(machines.scheduler)

    with (
        cluster(machines.address),
        pytest.raises(RedundancyPinError, match="what is finished is kept"),
    ):
        mapped(tmp_path / "store.sqlite", leave)
    kept = stored(tmp_path / "store.sqlite")
    assert 4 <= kept < 18
    monkeypatch.setattr(workers, "PATIENCE", 60.0)
    machines.end(*machines.workers)
    machines.scheduler = machines.schedule()
    machines.work(1)
    seen: list[int] = []
    with cluster(machines.address):
        mapped(tmp_path / "store.sqlite", seen.append)
    assert seen == list(range(kept, 19))


RAY = """
import joblib, ray
from ray.util.joblib import register_ray
from redundancy_pin import crosscheck
ray.init(num_cpus=2, include_dashboard=False, logging_level="ERROR", log_to_driver=False)
register_ray()
with joblib.parallel_config(backend="ray", n_jobs=2):
    there = crosscheck.run(["2rpr"], 40, jobs=2).rows
ray.shutdown()
assert there == crosscheck.run(["2rpr"], 40, jobs=1).rows
"""


@pytest.mark.long
def test_checks_by_ray_are_those_of_one_machine() -> None:
    pytest.importorskip("ray")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-W", "ignore", "-c", RAY], env=environment, check=True, timeout=600)


@pytest.mark.long
def test_real_cells_trials_and_checks_are_those_of_one_machine(machines: Machines, tmp_path: Path) -> None:
    machines.work(2)
    problem = small_maps.corner(x=Axis("speed", (0.1, 0.3)), y=Axis("stroke", (0.02, 2.0)))
    short = Scenario(SCENARIOS[0].case, 2.45, 2.55)
    options: dict[str, Any] = {"scenarios": (short,), "drives": ("open loop", "computed torque"), "seed": 3}

    def done(name: str) -> tuple[Any, ...]:
        cells = [
            {**cell.as_dict(), "seconds": 0.0} for cell in feasibility_map(problem, tmp_path / f"{name}.sqlite").cells
        ]
        return cells, robustness_study(2, **options).trials, crosscheck.run(["2rpr", "four_bar"], 40, jobs=2).rows

    with cluster(machines.address):
        there = done("there")
    assert there == done("here")
