"""``redundancy-pin validate``: the table of the cross-check, and its exit code."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from command_line import call, refused

from redundancy_pin import crosscheck
from redundancy_pin.crosscheck import CheckRow, CrossCheckReport


def test_small_run_passes_and_is_the_api() -> None:
    # a robot without closed form, whose checks are few; the checks have tests of their own
    robot = ("--robot", "four_bar")
    result = call("validate", *robot, "--samples", "20", "--seed", "3", "--json")
    assert result.exit_code == 0
    assert result.stderr == ""
    facts = json.loads(result.stdout)
    assert facts == json.loads(json.dumps(crosscheck.run(["four_bar"], 20, 3).as_dict()))
    assert facts["passed"]


def test_all_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def run(*arguments: object, **_: object) -> CrossCheckReport:
        calls.append(arguments[-1])
        return CrossCheckReport((), 0)

    monkeypatch.setattr(crosscheck, "run", run)
    for jobs in ("1", "3", "-1"):
        call("validate", "--jobs", jobs)
    assert calls == [1, 3, os.cpu_count()]


def test_failure_shows_in_table_json_and_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = (CheckRow("2rpr", "parity: f", 10, 1e-15, 1e-10, True), CheckRow("2rpr", "parity: W", 10, 0.5, 1e-10, False))
    monkeypatch.setattr(crosscheck, "run", lambda *_, **__: CrossCheckReport(rows, 0))
    result = call("validate")
    assert result.exit_code == 1
    assert "FAILED" in result.stdout
    assert result.stderr == "error: 1 of 2 checks failed.\n"
    result = call("validate", "--json")
    assert result.exit_code == 1
    assert not json.loads(result.stdout)["passed"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [(("--samples", "0"), "0"), (("--samples", "many"), "many"), (("--robot", "nope", "--samples", "5"), "nope")],
)
def test_bad_input(arguments: tuple[str, ...], says: str) -> None:
    assert says in refused("validate", *arguments)


def test_what_a_declaration_says_wrong_is_said_and_not_drawn_again(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("name: x\nurdf: nowhere.urdf\nactuated: 3\n", encoding="utf-8")
    message = refused("validate", "--robot", path, "--samples", "5")
    assert message == refused("info", "--robot", path)
    assert "nowhere.urdf" in message
