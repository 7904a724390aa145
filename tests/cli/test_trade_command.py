"""``redundancy-pin trade``: its files and JSON are those of the Python function; mistakes in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import call, refused

pytest.importorskip("matplotlib")

SHORT = ("trade", "--robot", "3rrr", "--trajectory", "corner:radius=0.025", "--x", "track", "--y", "effort",
         "--points", "2", "--between", "0.2:1", "--jobs", "1", "--parameter", "dt=0.03",
         "--parameter", "acceleration=20", "--parameter", "refinements=0")  # fmt: skip


def test_files_and_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = call(*SHORT, "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    told = json.loads(result.stdout)
    assert {path.name for path in (tmp_path / "trade-3rrr").iterdir()} == {
        "trade.md", "trade.csv", "trade.json", "trade.svg", "trade.png"}  # fmt: skip
    low, high = told["points"]
    assert low["x"] <= 0.4
    assert low["x"] < high["x"]
    assert low["y"] > high["y"]
    assert json.loads((tmp_path / "trade-3rrr" / "trade.json").read_text())["points"] == told["points"]
    assert (tmp_path / "trade-3rrr" / "trade.csv").read_text().count("\n") == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("trade", "--robot", "3rrr"), "needs a motion"),
        (("trade", "--robot", "3rrr", "--trajectory", "corner", "--x", "peak"), "Both quantities"),
        (("trade", "--robot", "3rrr", "--trajectory", "corner", "--between", "1"), "LOW:HIGH"),
        (("trade", "--robot", "3rrr", "--trajectory", "corner", "--parameter", "objective=peak"), "--y"),
        (("trade", "--robot", "3rrr", "--trajectory", "corner", "--parameter", "spede=5"), "spede"),
        (("trade", "--robot", "3rrr", "--trajectory", "corner", "--points", "1"), "points"),
    ],
)
def test_mistakes(arguments: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in refused(*arguments)
    assert not list(tmp_path.iterdir())
