"""The chapter on replays: rows, reasons, files, blocks of the report."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from pathlib import Path

from redundancy_pin.experiments.document import Paragraph, Picture, Table
from redundancy_pin.experiments.replay import QUICK, Replays, run_replays
from redundancy_pin.experiments.replay.files import write_figures, write_table
from redundancy_pin.experiments.replay.sections import chapter
from redundancy_pin.experiments.replay.study import parts

SMALL = replace(QUICK, cases=(replace(QUICK.cases[0], drives=("open loop",)), QUICK.cases[1],
                              replace(QUICK.cases[2], drives=("open loop",))))  # fmt: skip


@functools.cache
def replays() -> Replays:
    told: list[str] = []
    found = run_replays(SMALL, told=told.append)
    assert len(told) == parts(SMALL)
    return found


def test_each_plan_is_replayed_or_the_reason_is_there():
    found = replays()
    massless, corner = found.rows
    assert massless.status == "ill_posed"
    assert "no inertia" in massless.reason
    assert corner.status == "completed"
    assert corner.largest < 1e-6
    assert list(found.missing) == [SMALL.cases[1].name]
    assert "nothing can carry the inertial force" in found.missing[SMALL.cases[1].name]


def test_the_chapter_shows_all_of_it():
    blocks = chapter(replays())
    table = next(block for block in blocks if isinstance(block, Table))
    assert len(table.rows) == 2
    texts = " ".join(block.text for block in blocks if isinstance(block, Paragraph))
    assert "end_effector_mass" in texts
    assert "No plan for heavy-0.5" in texts
    assert [block.path for block in blocks if isinstance(block, Picture)] == ["replay-corner-r0.025.png"]


def test_files_and_summary(tmp_path: Path):
    write_table(tmp_path, replays())
    write_figures(tmp_path, replays(), (".png",), lambda what: None)
    assert {path.name for path in tmp_path.iterdir()} == {"replay.csv", "replay-corner-r0.025.png"}
    lines = (tmp_path / "replay.csv").read_text().splitlines()
    assert {line.count(",") for line in lines} == {11}
    data = json.loads(json.dumps(replays().as_dict(), allow_nan=False))
    assert data["replays"][0]["largest"] is None
    assert data["replays"][1]["status"] == "completed"
