"""``redundancy-pin reproduce``: tables or JSON on stdout, and nothing written where it cannot be done."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import call, refused

from redundancy_pin.cli import reproduce as command
from redundancy_pin.crosscheck import CheckRow, CrossCheckReport, run
from redundancy_pin.thesis import reproduce as job
from redundancy_pin.thesis.cases import BY_NAME, FULL, QUICK
from redundancy_pin.thesis.figures import Picture


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two coarse experiments, a passing cross-check, no pictures: the job has tests of its own."""
    rows = (CheckRow("2rpr", "power balance", 10, 1e-15, 1e-10, True),)
    monkeypatch.setattr(job.crosscheck, "run", lambda *_: CrossCheckReport(rows, 0))
    small = tuple(replace(BY_NAME[name], dt=0.05) for name in ("circle-0.5-parked", "corner-r0.025-baseline"))
    monkeypatch.setattr(command, "FULL", replace(FULL, motions=small, chapters=()))
    monkeypatch.setattr(command, "QUICK", replace(QUICK, motions=small[1:], chapters=()))
    monkeypatch.setattr(Picture, "draw", lambda *_: None)
    monkeypatch.setattr(job, "save", lambda _, *paths: [path.write_bytes(b"") for path in paths])


def test_tables(tmp_path: Path) -> None:
    result = call("reproduce", "--jobs", "1", "--out", str(tmp_path / "results"))
    assert result.exit_code == 0
    assert result.stderr == ""
    assert "unbounded at t = 0.5194 s" in result.stdout
    assert "bounded: peaks" in result.stdout
    assert "section 3.2" in result.stdout
    assert "report.md" in result.stdout


def test_json_is_the_summary(tmp_path: Path) -> None:
    result = call("reproduce", "--jobs", "1", "--out", str(tmp_path / "results"), "--json")
    assert json.loads(result.stdout) == json.loads((tmp_path / "results" / "summary.json").read_text())


def test_quick_runs_the_quick_extent(tmp_path: Path) -> None:
    result = call("reproduce", "--quick", "--jobs", "1", "--out", str(tmp_path / "results"), "--json")
    summary = json.loads(result.stdout)
    assert list(summary["experiments"]) == ["corner-r0.025-baseline"]
    assert summary["extent"] == "quick"


@pytest.mark.parametrize("quick", [True, False])
def test_quick_results_are_called_so(quick: bool, tmp_path: Path) -> None:
    result = call("reproduce", *(["--quick"] if quick else []), "--jobs", "1", "--out", str(tmp_path / "results"))
    assert ("This is a quick run" in result.stdout) is quick
    for name in ("report.md", "report.html"):
        assert ("This is a quick run" in (tmp_path / "results" / name).read_text()) is quick
    summary = json.loads((tmp_path / "results" / "summary.json").read_text())
    assert summary["extent"] == ("quick" if quick else "full")


def test_a_log_shows_how_far_it_is(tmp_path: Path) -> None:
    result = call("reproduce", "--jobs", "1", "--out", str(tmp_path / "results"), "--json", every=0.05)
    assert json.loads(result.stdout)["cross_check"]["passed"]
    lines = result.stderr.splitlines()
    assert any(re.fullmatch(r"reproduce: .+, \d+ of \d+, 0:00:\d\d elapsed", line) for line in lines)
    assert all(line.startswith("reproduce: ") and line.endswith(" elapsed") for line in lines)


def test_failed_cross_check_is_exit_code_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = (CheckRow("3rrr", "parity: f", 10, 2.0, 1e-10, False),)
    monkeypatch.setattr(job.crosscheck, "run", lambda *_: CrossCheckReport(rows, 0))
    assert "parity: f" in refused("reproduce", "--out", tmp_path / "results", code=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_its_rows_are_left_out_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job.crosscheck, "run", lambda *_: run(["2rpr"], 8))
    assert call("reproduce", "--jobs", "1", "--out", tmp_path / "results").exit_code == 0
    report = (tmp_path / "results" / "report.md").read_text()
    (row,) = (line for line in report.splitlines() if line.endswith("| left out |"))
    assert "there is no C compiler" in row
    assert "pip install 'redundancy_pin[compiler]'" in row
    assert "7 of 8 checks passed; the table says why the others are left out." in report


def test_unwritable_output(tmp_path: Path) -> None:
    assert "no folder" in refused("reproduce", "--out", tmp_path / "no" / "results")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "notes.txt").write_text("mine")
    assert "notes.txt" in refused("reproduce", "--out", tmp_path / "results")
    assert [path.name for path in (tmp_path / "results").iterdir()] == ["notes.txt"]
