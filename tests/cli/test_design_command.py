"""``redundancy-pin design``: its records are those of the Python function; mistakes in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import call, refused

import redundancy_pin as rp

MOTION = "circle:speed=0.5,ramp_time=0.2,ramp_length=0.05"
SHORT = ("design", "--robot", "2rpr", "--task", MOTION, "--vary", "carrier_mass=0.9:2", "--iterations", "1",
         "--parameter", "dt=0.03", "--parameter", "refinements=0", "--parameter", "acceleration=20")  # fmt: skip


def test_files_and_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = call(*SHORT, "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    first, made = json.loads(result.stdout)["records"]
    assert (first["machine"], made["machine"], made["task"]) == ("to begin with", "for circle", "circle")
    # without other masses the effort goes with the square of the carriers' mass, and energies with the mass
    assert (first["carrier_mass"], made["carrier_mass"]) == (1.0, 0.9)
    assert made["value"] == pytest.approx(0.81 * first["value"], rel=1e-5)
    assert made["energy"] == pytest.approx(0.9 * first["energy"], rel=1e-3)
    assert (first["mass"], made["mass"]) == (pytest.approx(2.0), pytest.approx(1.8))
    # one step is not enough to see that no other is better
    assert [(each["optimal"], each["search"]) for each in (first, made)] == [(None, None), (False, "not_converged")]
    folder = tmp_path / "design-2rpr"
    assert "not_converged" in (folder / "design.md").read_text()
    assert {path.name for path in folder.iterdir()} == {"design.md", "design.csv", "design.json"}
    assert json.loads((folder / "design.json").read_text())["records"] == [first, made]


def test_the_objective_time_designs_for_the_least_time_of_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The records' values are the durations that the planner finds for the machines of the table by itself."""
    monkeypatch.chdir(tmp_path)
    result = call("design", "--robot", "2rpr", "--set", "end_effector_mass=0.5", "--set", "carriers=false",
                  "--task", "polygon:vertices=0.2 0.4;0.3 0.4,radius=0.01,speed=0.4,ramp_time=0.2",
                  "--vary", "end_effector_mass=0.2:1",
                  "--iterations", "1", "--parameter", "objective=time", "--parameter", "effort=2",
                  "--parameter", "steps=20", "--json")  # fmt: skip
    assert (result.exit_code, result.stderr) == (0, "")
    facts = json.loads(result.stdout)
    first, made = facts["records"]
    assert made["end_effector_mass"] < first["end_effector_mass"] == 0.5
    path = rp.trajectory.reference.polygon(
        vertices=[(0.2, 0.4), (0.3, 0.4)], radius=0.01, speed=0.4, ramp_time=0.2
    ).path
    for record in (first, made):
        robot = rp.load_robot("2rpr", carriers=False, end_effector_mass=record["end_effector_mass"])
        plan = rp.plan_time_optimal(robot, path, limits=rp.Limits(effort=2.0), mesh=rp.Mesh(steps=20))
        assert record["value"] == pytest.approx(plan.t[-1], rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--task", "circle", "--vary", "carrier_mass"), "NAME=LOW:HIGH"),
        (("--task", "circle", "--vary", "carrier_mas=0.5:2"), "carrier_mas"),
        (("--task", "circel", "--vary", "carrier_mass=0.5:2"), "circel"),
        (("--task", "circle", "--vary", "carrier_mass=0.5:2", "--parameter", "objectiv=peak"), "objectiv"),
        (("--task", "circle", "--vary", "carrier_mass=0.5:2", "--iterations", "0"), "iterations"),
        (
            (
                "--task",
                "circle",
                "--vary",
                "carrier_mass=0.5:2",
                "--parameter",
                "objective=time",
                "--parameter",
                "dt=1",
            ),
            "dt",
        ),
    ],
)
def test_mistakes(arguments: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in refused("design", "--robot", "2rpr", *arguments)
    assert not list(tmp_path.iterdir())
