"""Journals: every line is whole and belongs to one problem and one run; what does not fit is refused, left alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_maps import corner, journal_lines

from redundancy_pin.errors import OutputError
from redundancy_pin.experiments.feasibility import Axis, Cell, Verdict, feasibility_map, sweep
from redundancy_pin.experiments.feasibility.cell import Key
from redundancy_pin.experiments.feasibility.journal import CELLS
from redundancy_pin.experiments.journal import open_journal


def test_a_changed_problem_is_refused_and_named(tmp_path: Path, asked: list[Key]) -> None:
    journal = tmp_path / "journal.jsonl"
    feasibility_map(corner(), journal, jobs=1)
    before = journal.read_bytes()
    for changed, says in (
        (corner(limits={"max_effort": 4.0}), "for limits.max_effort it has 5.0, now it is 4.0"),
        (corner(parameters={}), "parameters"),
        (corner(mode=(-1, -1, -1)), "mode"),
        (corner(settings={"carrier_mass": 1.0}), "settings"),
        (corner(y=Axis("max_speed", (0.1, 1.0))), "axes"),
        (corner(options={"radius": 0.013}), "options"),
    ):
        with pytest.raises(OutputError, match="another problem") as caught:
            feasibility_map(changed, journal, jobs=1)
        assert says in caught.value.message
    assert journal.read_bytes() == before


def test_a_robot_whose_file_has_changed_is_another_problem(
    tmp_path: Path, asked: list[Key], monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = tmp_path / "journal.jsonl"
    feasibility_map(corner(), journal, jobs=1)
    monkeypatch.setattr(sweep, "fingerprint", lambda robot: "another")
    with pytest.raises(OutputError, match="machine"):
        feasibility_map(corner(), journal, jobs=1)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "no journal"),
        (b"planner,x,y\n", "no journal"),
        (b'{"format": "redundancy_pin feasibility journal", "version": 2, "digest": "", "problem": {}}\n', "version 2"),
        (b"\xff\xfe\n", "no journal"),
    ],
)
def test_files_that_are_no_journal_are_left_alone(content: bytes, says: str, tmp_path: Path, asked: list[Key]) -> None:
    journal = tmp_path / "journal.jsonl"
    journal.write_bytes(content)
    with pytest.raises(OutputError, match=says):
        feasibility_map(corner(), journal, jobs=1)
    assert journal.read_bytes() == content
    assert asked == []


@pytest.mark.parametrize("line", [b"{torn\n", b'{"planner": "x"}\n', b'{"verdict": "perhaps", "limits": []}\n', b"\n"])
def test_a_journal_that_is_damaged_in_the_middle_is_refused(line: bytes, tmp_path: Path, asked: list[Key]) -> None:
    journal = tmp_path / "journal.jsonl"
    feasibility_map(corner(), journal, jobs=1)
    lines = journal_lines(journal)
    journal.write_bytes(b"".join([*lines[:3], line, *lines[3:]]))
    with pytest.raises(OutputError, match="Line 4"):
        feasibility_map(corner(), journal, jobs=1)


def test_cells_survive_the_journal(tmp_path: Path) -> None:
    cell = Cell(
        "p",
        0.1,
        1 / 3,
        Verdict.INFEASIBLE,
        ("track", "end"),
        "c",
        0.1,
        float("nan"),
        None,
        1.1,
        0.5,
        "",
        "ü",
        {"a": 1.0},
    )
    with open_journal(CELLS, tmp_path / "j", {"a": 1}) as journal:
        journal.add(cell)
    with open_journal(CELLS, tmp_path / "j", {"a": 1}) as journal:
        (found,) = journal.records.values()
    # JSON knows no NaN
    assert found == Cell(
        "p", 0.1, 1 / 3, Verdict.INFEASIBLE, ("track", "end"), "c", 0.1, None, None, 1.1, 0.5, "", "ü", {"a": 1.0}
    )
