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


def test_a_device_has_rows_of_its_own() -> None:
    result = call("validate", "--robot", "four_bar", "--samples", "5", "--device", "cpu", "--json")
    assert result.exit_code == 0
    rows = json.loads(result.stdout)["rows"]
    assert [row["passed"] for row in rows if "GpuDynamics, cpu" in row["check"]] == [True] * 3


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


def test_what_a_declaration_says_wrong_is_said_and_not_drawn_again(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("name: x\nurdf: nowhere.urdf\nactuated: 3\n", encoding="utf-8")
    message = refused("validate", "--robot", path, "--samples", "5")
    assert message == refused("info", "--robot", path)
    assert "nowhere.urdf" in message


def test_parameters_are_those_of_the_robot_that_is_checked(tmp_path: Path) -> None:
    """A model of MuJoCo that floats is held by base=fixed, which no file of its own could say."""
    file = tmp_path / "arm.xml"
    body = '<body name="trunk"><freejoint/><geom size="0.2"/><body><joint name="hip"/><geom size="0.1" pos="0.3 0 0"/>'
    motor = '<actuator><motor joint="hip"/></actuator>'
    file.write_text(f"<mujoco><worldbody>{body}</body></body></worldbody>{motor}</mujoco>", encoding="utf-8")
    robot = ("--robot", str(file), "--set", "base=fixed")
    facts = json.loads(call("validate", *robot, "--samples", "5", "--json").stdout)
    assert facts["passed"]
    assert facts == json.loads(json.dumps(crosscheck.run([str(file)], 5, 0, settings={"base": "fixed"}).as_dict()))
    assert any(row["check"].startswith("inverse") and row["samples"] == 5 for row in facts["rows"])  # six more fall
    assert "has no argument 'bass'" in refused("validate", *robot[:2], "--set", "bass=fixed")
    shipped = json.loads(
        call("validate", "--robot", "four_bar", "--set", "crank_length=0.12", "--samples", "5", "--json").stdout
    )
    assert shipped["passed"]


def test_states_that_were_skipped_are_counted_by_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    skipped = {"near_type_i": 30, "near_type_ii": 14}
    rows = (
        CheckRow("arm", "power balance (rnea)", 500, 1e-15, 1e-10, True),
        CheckRow("arm", "inverse -> forward (rnea)", 456, 1e-15, 1e-10, True, skipped=skipped),
        CheckRow("arm", "random states", 4, 0.0, 0.0, True, "drawn again", {"unreachable": 3}),
    )
    monkeypatch.setattr(crosscheck, "run", lambda *_, **__: CrossCheckReport(rows, 0))
    lines = [line for line in call("validate").stdout.splitlines() if "│" in line]
    cells = [[cell.strip() for cell in line.strip("│").split("│")][:3] for line in lines]
    assert cells == [
        ["arm", "power balance (rnea)", "500"],
        ["arm", "inverse -> forward (rnea)", "456 of 500"],
        ["", "skipped: near a type I singularity", "30"],
        ["", "skipped: near a type II singularity", "14"],
        ["arm", "random states: drawn again", "4 of 7"],
        ["", "skipped: a pose is unreachable: the chains do not close", "3"],
    ]
    facts = json.loads(call("validate", "--json").stdout)["rows"]
    assert [(row["samples"], row["total"], row["skipped"]) for row in facts] == [
        (500, 500, {}),
        (456, 500, skipped),
        (4, 7, {"unreachable": 3}),
    ]


def test_a_report_of_a_robot_that_loses_states_adds_up() -> None:
    """Some random states of the two arms are out of reach."""
    arguments = ("--robot", "two_arms", "--samples", "40", "--seed", "2")
    rows = json.loads(call("validate", *arguments, "--json").stdout)["rows"]
    assert any(row["skipped"] for row in rows)
    for row in rows:
        assert row["total"] == row["samples"] + sum(row["skipped"].values())
        assert row["total"] == 40 or row["check"] == "random states"
    assert next(row["samples"] for row in rows if row["check"] == "random states") == 40
