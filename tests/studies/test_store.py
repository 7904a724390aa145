"""The store: it survives kills, a full disk and a second run, and refuses what is not its own."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pytest

from redundancy_pin.errors import OutputError
from redundancy_pin.studies.store import Store

IDENTITY = {"seed": 3, "bounds": {"b": 1.0, "a": 2.0}, "fingerprint": "f"}


@dataclass(frozen=True)
class Piece:
    number: int
    value: float
    text: str = ""

    @property
    def key(self) -> tuple[str, int, float]:
        return "piece", self.number, self.number / 3

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @staticmethod
    def read(data: Mapping[str, Any]) -> Piece:
        return Piece(**data)


def piece(number: int) -> Piece:
    return Piece(number, 0.1 * number, "ü")


def opened(path: Path | None, identity: Mapping[str, Any] = IDENTITY, kind: str = "map"):  # type: ignore[no-untyped-def]
    return Store.open(path, kind, identity, Piece.read)


def refused(store: AbstractContextManager[Store[Piece]], says: str) -> None:
    with pytest.raises(OutputError, match=says), store:
        pytest.fail("opened")


def filled(path: Path, count: int = 3) -> bytes:
    with opened(path) as store:
        for number in range(count):
            store.put(piece(number))
    return path.read_bytes()


@pytest.mark.parametrize("place", ["file", "memory"])
def test_what_is_put_is_there(place: str, tmp_path: Path) -> None:
    path = tmp_path / "store" if place == "file" else None
    with opened(path) as store:
        for number in (2, 0, 1):
            store.put(piece(number))
        assert store.records == {piece(number).key: piece(number) for number in range(3)}
    if path is not None:
        before = path.read_bytes()
        with opened(path) as again:
            assert list(again.records.values()) == [piece(2), piece(0), piece(1)]
        assert path.read_bytes() == before
        assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["file:store", "file:store?mode=memory", ":memory:", "a?b#c%20d"])
def test_a_name_that_sqlite_could_take_for_an_address_is_a_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    filled(Path(name))
    filled(Path(f"{name} 2") / "store")
    assert sorted(path.name for path in tmp_path.iterdir()) == [name, f"{name} 2"]


WRITER = """
import sys
sys.path.insert(0, {here!r})
from test_store import opened, piece
from pathlib import Path
with opened(Path(sys.argv[1])) as store:
    for number in range(len(store.records), 100000):
        store.put(piece(number))
        print(number, flush=True)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_kill_at_any_moment_loses_nothing_that_was_finished(tmp_path: Path) -> None:
    path, last = tmp_path / "store", -1
    for more in (0, 40):
        program = WRITER.format(here=str(Path(__file__).parent))
        with subprocess.Popen([sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            first = int(process.stdout.readline())
            assert first == last + 1
            refused(opened(path), "in use by another run")
            lines = [process.stdout.readline() for _ in range(more)]
            time.sleep(1e-3 * more)
            process.send_signal(signal.SIGKILL)
            told = [first, *(int(line) for line in (*lines, *process.stdout) if line.endswith("\n"))]
        assert process.returncode == -signal.SIGKILL
        with opened(path) as store:
            # what was finished, and perhaps one that could not tell it any more
            assert len(store.records) - 1 - told[-1] in (0, 1)
            assert list(store.records.values()) == [piece(number) for number in range(len(store.records))]
            last = len(store.records) - 1


def test_a_transaction_that_was_cut_off_is_rolled_back(tmp_path: Path) -> None:
    """The worst moment: pages of it are in the file already."""
    path, crashed = tmp_path / "store", tmp_path / "crashed"
    before = filled(path)
    raw = sqlite3.connect(path, isolation_level=None)
    raw.execute("PRAGMA cache_size = 1")
    raw.execute("BEGIN")
    raw.executemany("INSERT INTO record VALUES (?)", [("x" * 3000,) for _ in range(50)])
    shutil.copy(path, crashed)
    shutil.copy(f"{path}-journal", f"{crashed}-journal")
    raw.close()
    assert len(crashed.read_bytes()) > len(before)
    with opened(crashed) as store:
        assert len(store.records) == 3
    assert crashed.read_bytes() == before


def test_a_kill_while_it_began_leaves_what_can_be_begun(tmp_path: Path) -> None:
    (tmp_path / "store").touch()
    filled(tmp_path / "store")


def test_a_second_run_is_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    with opened(tmp_path / "store") as first:
        refused(opened(tmp_path / "store"), "in use by another run")
        first.put(piece(0))
        assert (tmp_path / "store-journal").exists()  # what a roll back needs is on the disk
        refused(opened(tmp_path / "store"), "in use by another run")
    with opened(tmp_path / "store") as again:
        assert len(again.records) == 1


def test_a_full_disk_spoils_nothing(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    path = tmp_path / "store"
    with opened(path) as store:
        store.put(piece(0))
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size, limits[1]))
        try:
            with pytest.raises(OutputError, match="make room"):
                store.put(Piece(1, 0.0, 20000 * "x"))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert list(store.records) == [piece(0).key]
        store.put(piece(2))
    with opened(path) as again:
        assert list(again.records.values()) == [piece(0), piece(2)]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"seed": 4, "fingerprint": "g"}, "of another map: for seed it has 3, now it is 4"),
        ({"bounds": {"a": 2.0, "b": 5.0}}, "for bounds.b it has 1.0, now it is 5.0"),
        ({"bounds": {"b": 1.0}}, r"for bounds it has \{'b': 1.0, 'a': 2.0\}, now it is \{'b': 1.0\}"),
        ({"fingerprint": "g"}, "for fingerprint it has 'f', now it is 'g'"),
        ({"further": 1}, "for further it has None, now it is 1"),
    ],
)
def test_what_differs_is_named_and_the_store_left_alone(changed: dict[str, Any], says: str, tmp_path: Path) -> None:
    path = tmp_path / "store"
    before = filled(path)
    refused(opened(path, {**IDENTITY, **changed}), says)
    assert path.read_bytes() == before
    with opened(path) as store:  # the lock is free again
        assert len(store.records) == 3


def test_another_version_of_the_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled(tmp_path / "store")
    monkeypatch.setattr("redundancy_pin.__version__", "99")
    refused(opened(tmp_path / "store"), r"for package it has .*, now it is '99'")


def test_files_that_are_no_store_of_this_kind_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "store"
    filled(path)
    refused(opened(path, kind="study"), "no store of a study, but of a map")
    for content in (b"mine\n", b'{"format": "redundancy_pin feasibility journal"}\n' + 5000 * b"x", b"\xff\n"):
        path.write_bytes(content)
        refused(opened(path), "no store of a map")
        assert path.read_bytes() == content
    path.unlink()
    with sqlite3.connect(path) as foreign:
        foreign.execute("CREATE TABLE mine (a TEXT)")
    foreign.close()
    before = path.read_bytes()
    refused(opened(path), "no store of a map")
    assert path.read_bytes() == before
    (tmp_path / "file").touch()
    refused(opened(tmp_path / "file" / "store"), "Cannot make the folder")
    refused(opened(tmp_path), "it is a folder")


def test_a_damaged_store_is_named(tmp_path: Path) -> None:
    path = tmp_path / "store"
    whole = filled(path, 300)
    path.write_bytes(whole[: len(whole) // 2])
    refused(opened(path), f"The store {path} is damaged")
    path.write_bytes(whole[:8192] + bytes(4096) + whole[12288:])
    refused(opened(path), f"The store {path} is damaged")
    for broken in ("{torn", "{}"):
        path.write_bytes(whole)
        with sqlite3.connect(path) as raw:
            raw.execute("UPDATE record SET record = ? WHERE rowid = 2", (broken,))
        raw.close()
        refused(opened(path), "Record 2 of the store .* damaged")


def test_a_store_that_would_compute_its_records_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "store"
    filled(path)
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS record FROM n"
    with sqlite3.connect(path) as raw:
        raw.execute("DROP TABLE record")
        raw.execute(f"CREATE VIEW record AS {endless}")
    raw.close()
    refused(opened(path), "no store of a map")


@pytest.mark.parametrize("identity", ["{torn", "3", "[1]", "[" * 100_000, None])
def test_a_damaged_identity_is_named(identity: str | None, tmp_path: Path) -> None:
    path = tmp_path / "store"
    filled(path)
    with sqlite3.connect(path) as raw:
        raw.execute("UPDATE study SET identity = ?", (identity,))
    raw.close()
    refused(opened(path), "identity in the store .* is damaged")


def test_a_table_whose_text_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "store"
    filled(path)
    path.write_bytes(path.read_bytes().replace(b"CREATE TABLE study", b"CREATE \xffABLE study"))
    refused(opened(path), "store")


def test_a_pipe_is_no_store(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "store")
    refused(opened(tmp_path / "store"), "pipe or a device")


# ------------------------------------------------------------------------------------------------- links, modes, places


def test_records_that_are_put_together_are_there_together(tmp_path: Path) -> None:
    with opened(tmp_path / "store") as store:
        store.put(piece(0), piece(1))
        with pytest.raises(TypeError):
            store.put(piece(2), Piece(3, object()))  # type: ignore[arg-type]
        store.put()
        store.put(piece(4))
    with opened(tmp_path / "store") as again:
        assert list(again.records.values()) == [piece(0), piece(1), piece(4)]


def test_a_store_behind_a_link_is_written_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    real, link, folder = tmp_path / "disk" / "real", tmp_path / "store", tmp_path / "folder"
    link.symlink_to(real)
    folder.symlink_to(tmp_path / "disk")
    filled(link)
    assert link.is_symlink()
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["real"]
    for path in (real, link, folder / "real"):
        with opened(path) as store:
            assert len(store.records) == 3
            for other in (real, link, folder / "real"):
                refused(opened(other), "in use by another run")
            # a kill now leaves its journal beside the file, where the next run looks for it
            store.put(piece(0))
            assert {place.name for place in (tmp_path / "disk").iterdir()} == {"real", "real-journal"}
        real.unlink()
        filled(real)
    link.unlink()
    link.symlink_to(tmp_path / "nowhere" / "real")
    refused(opened(link), "there is no folder .*nowhere")


def test_the_mode_of_a_store_stays_and_a_new_one_heeds_the_mask(tmp_path: Path) -> None:
    mask = os.umask(0o027)
    try:
        filled(tmp_path / "new")
    finally:
        os.umask(mask)
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o640
    (tmp_path / "new").chmod(0o604)
    filled(tmp_path / "new")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o604


def test_a_read_only_store_is_refused_and_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "store"
    before = filled(path)
    path.chmod(0o444)
    refused(opened(path), "store: it is read-only")
    assert path.read_bytes() == before
    path.chmod(0o644)
    filled(path)
