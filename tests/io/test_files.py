"""Files and folders of results appear whole or not at all, and nobody else's are touched."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from redundancy_pin.errors import OutputError
from redundancy_pin.io import files
from redundancy_pin.io.files import replacing_file, replacing_folder, require_replaceable, write_text


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _write_results(folder: Path, *names: str) -> None:
    with replacing_folder(folder) as temporary:
        for name in names:
            write_text(temporary / name, name)
        write_text(temporary / "summary.json", json.dumps({"files": names}))


def test_file_is_written_and_replaced(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    for text in ("one\n", "two\n"):
        write_text(target, text)
        assert target.read_bytes() == text.encode()
    assert _names(tmp_path) == ["a.txt"]


def test_file_gets_the_usual_permissions(tmp_path: Path) -> None:
    mask = os.umask(0o022)
    try:
        write_text(tmp_path / "a.txt", "")
    finally:
        os.umask(mask)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o644


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write_half() -> None:
        with replacing_file(target) as temporary:
            temporary.write_text("half of the n")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert target.read_text() == "old"
    assert _names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("target", ["none/a.txt", "file/a.txt", "folder"])
def test_unwritable_file_is_refused(target: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="Cannot write"):
        write_text(tmp_path / target, "text")
    assert _names(tmp_path) == ["file", "folder"]


def test_folder_is_made_and_replaced_as_a_whole(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    _write_results(folder, "a.csv", "b.csv")
    _write_results(folder, "b.csv", "c.csv")
    assert _names(folder) == ["b.csv", "c.csv", "summary.json"]
    assert _names(tmp_path) == ["results"]


def test_empty_folder_is_used(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    _write_results(tmp_path / "results", "a.csv")
    assert _names(tmp_path / "results") == ["a.csv", "summary.json"]


@pytest.mark.parametrize("manifest", [None, "no json", "[]", '{"files": 3}', '{"files": ["other.csv"]}'])
def test_folder_with_other_files_is_left_alone(manifest: str | None, tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    if manifest is not None:
        (folder / "summary.json").write_text(manifest)
    with pytest.raises(OutputError, match=r"mine\.txt"):
        _write_results(folder, "a.csv")
    assert (folder / "mine.txt").read_text() == "mine"
    assert _names(tmp_path) == ["results"]


def test_file_put_there_meanwhile_is_found_before_the_swap(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    _write_results(folder, "a.csv")
    with pytest.raises(OutputError, match=r"late\.txt"), replacing_folder(folder):
        (folder / "late.txt").write_text("mine")
    assert _names(folder) == ["a.csv", "late.txt", "summary.json"]


def test_failed_swap_brings_the_old_folder_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "results"
    _write_results(folder, "a.csv")
    real = os.replace

    def second_fails(source: Path, target: Path) -> None:
        if Path(target) == folder and (Path(source) / "b.csv").exists():
            raise OSError(28, "No space left on device")
        real(source, target)

    monkeypatch.setattr(files.os, "replace", second_fails)
    with pytest.raises(OutputError, match="No space left"):
        _write_results(folder, "b.csv")
    assert _names(folder) == ["a.csv", "summary.json"]
    assert _names(tmp_path) == ["results"]


def test_current_folder_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    monkeypatch.chdir(inner)
    for target in (".", ".."):
        with pytest.raises(OutputError, match="current folder"):
            require_replaceable(target)
