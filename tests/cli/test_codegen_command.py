"""``redundancy-pin codegen``: what it writes, what it says, what it refuses."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from command_line import call, refused, write_motion
from generated_c import COMPILERS, compiled, run

from redundancy_pin.trajectory import reference


def test_it_writes_a_folder_and_says_what_is_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "code"
    result = call("codegen", "--robot", "four_bar", "--out", folder)
    assert result.exit_code == 0
    names = {path.name for path in folder.iterdir()}
    assert names == {"four_bar.c", "four_bar.h", "test_four_bar.c", "CMakeLists.txt", "README.md", "summary.json"}
    assert all(name in result.stdout for name in names)
    told = json.loads(call("codegen", "--robot", "four_bar", "--prefix", "bar", "--out", folder, "--json").stdout)
    assert told["prefix"] == "bar"
    assert set(told["files"]) == {path.name for path in folder.iterdir()}
    assert told["folder"] == str(folder)
    assert told["samples"] > 0
    for file in folder.iterdir():
        assert str(tmp_path) not in file.read_text(encoding="utf-8")


@pytest.mark.skipif(not COMPILERS, reason="there is no C compiler")
def test_a_motion_from_a_file_is_what_its_test_compares(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "in.csv", reference.circle(), 0.02, carriers=2)
    mass, folder = ("--set", "carrier_mass=2.0"), tmp_path / "code"
    assert call("codegen", "--robot", "2rpr", *mass, "--motion", motion, "--out", folder).exit_code == 0
    assert "| carrier_mass | 2.0 |" in (folder / "README.md").read_text(encoding="utf-8")
    sources = [folder / "robot_2rpr.c", folder / "test_robot_2rpr.c"]
    done = run(compiled(sources, tmp_path / "program", compiler=COMPILERS[0]))
    assert done.stdout.startswith("0 failures"), done.stdout


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cmake") is None or not COMPILERS, reason="cmake is not installed")
def test_cmake_builds_it(tmp_path: Path) -> None:
    assert call("codegen", "--robot", "four_bar", "--out", tmp_path / "code").exit_code == 0
    build = tmp_path / "build"
    steps = (["cmake", "-S", tmp_path / "code", "-B", build], ["cmake", "--build", build], ["ctest"])
    for command in steps:
        where = build if command == ["ctest"] else tmp_path
        done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, cwd=where)
        assert done.returncode == 0, done.stdout + done.stderr
    assert "100% tests passed" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--robot", "four_bar"), "--out"),
        (("--out", "code"), "--robot"),
        (("--robot", "four_ba", "--out", "code"), "four_bar"),
        (("--robot", "four_bar", "--out", "."), "current folder"),
        (("--robot", "four_bar", "--out", "no/such"), "no folder"),
        (("--robot", "four_bar", "--out", "mine"), r"notes.txt"),
        (("--robot", "four_bar", "--out", "code", "--prefix", "2bar"), "2bar"),
        (("--robot", "four_bar", "--out", "code", "--motion", "nowhere.csv"), "nowhere.csv"),
        (("--robot", "four_bar", "--set", "crank_length=9", "--out", "code"), "close"),
    ],
)
def test_mistakes_are_one_line(
    arguments: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").touch()
    assert says in refused("codegen", *arguments)
    assert {path.name for path in tmp_path.rglob("*")} == {"mine", "notes.txt"}


def test_help_has_an_example() -> None:
    result = call("codegen", "--help")
    assert "redundancy-pin codegen --robot 3rrr --out controller" in result.stdout
