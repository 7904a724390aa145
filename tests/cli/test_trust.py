"""``--trust``: full Python in a robot's xacro, in every command that loads one, and said by no file."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
import yaml
from command_line import call, refused

import redundancy_pin as rp
from redundancy_pin import cli
from redundancy_pin.robot.shipped import models_root


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """Return the folder of a 2-RPR whose xacro has a lambda in it, under a name of its own."""
    folder = tmp_path / "own"
    folder.mkdir()
    for file in (models_root() / "2rpr").iterdir():
        text = file.read_text(encoding="utf-8")
        if file.suffix == ".xacro":
            first = text.index("<xacro:arg")
            text = f'{text[:first]}<xacro:property name="one" value="${{(lambda: 1)()}}"/>\n{text[first:]}'
            text = text.replace("</robot>", '<gazebo n="${one}"/></robot>')
        (folder / file.name).write_text(text, encoding="utf-8")
    return folder


COMMANDS = {
    "info": ("info",),
    "singularities": ("singularities", "--motion", "line"),
    "workspace": ("workspace", "--resolution", "3"),
    "show": ("show", "--html", "{folder}/out.html"),
    "validate": ("validate", "--samples", "1"),
    "codegen": ("codegen", "--out", "{folder}/code"),
    "plan": ("plan", "switch-off", "--motion", "line", "--threshold", "1000", "--dt", "0.01"),
}


@pytest.mark.long_for("codegen", "singularities", "validate", "workspace")
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_that_loads_robots(name: str, robot: Path, tmp_path: Path) -> None:
    command = [part.format(folder=tmp_path) for part in (*COMMANDS[name], "--robot", str(robot))]
    line = refused(*command)
    assert "lambda" in line
    assert "--trust" in line
    result = call(*command, "--trust")
    # 3: a plan that breaks limits; 1: the 2-RPR, without other masses than its carriers', has no forward dynamics
    assert result.exit_code in (0, 3) or (name, result.exit_code) == ("validate", 1), result.stderr
    assert "lambda" not in result.stderr


def test_a_problem_file_cannot_say_it(robot: Path, tmp_path: Path) -> None:
    problem = {
        "planner": "switch-off",
        "robot": str(robot),
        "motion": {"name": "line"},
        "parameters": {"threshold": 1000, "dt": 0.01},
    }
    path = tmp_path / "problem.yaml"
    path.write_text(yaml.safe_dump(problem))
    assert "lambda" in refused("plan", "--problem", str(path))
    assert call("plan", "--problem", str(path), "--trust").exit_code in (0, 3)
    path.write_text(yaml.safe_dump({**problem, "trust": True}))
    assert "Unknown key `trust`" in refused("plan", "--problem", str(path))
    path.write_text(yaml.safe_dump({**problem, "set": {"trust": True}}))
    assert "no argument 'trust'" in refused("plan", "--problem", str(path))
    assert "no argument 'trust'" in refused("info", "--robot", str(robot), "--set", "trust=true")
    assert "before the name of the planner" in refused("plan", "--trust", "switch-off", "--robot", "2rpr")


def test_the_robot_of_a_plan_is_trusted_by_who_loads_it(robot: Path, tmp_path: Path) -> None:
    loaded = rp.load_robot(robot, trust=True)
    assert loaded.n == 2
    path = tmp_path / "plan.npz"
    line = f"plan switch-off --robot {robot} --motion line --threshold 1000 --dt 0.01 --trust"
    command = line.split()
    assert call(*command, "--out", str(path)).exit_code in (0, 3)
    plan = rp.load_plan(path)
    with pytest.raises(rp.errors.PlanFileError, match="lambda"):
        rp.load_robot_of(plan, robot)
    assert rp.load_robot_of(plan, robot, trust=True).n == 2
    html = str(tmp_path / "out.html")
    assert "lambda" in refused("show", "--plan", str(path), "--robot", str(robot), "--html", html)
    assert call("show", "--plan", str(path), "--robot", str(robot), "--html", html, "--trust").exit_code == 0


def test_every_command_with_a_robot_has_the_flag() -> None:
    seen = 0
    for name in cli.COMMANDS:
        command = cli.main.get_command(click.Context(cli.main), name)  # type: ignore[attr-defined]
        for each in (command, *getattr(command, "commands", {}).values()):
            flags = {flag for parameter in each.params for flag in parameter.opts}
            if "--robot" in flags:
                assert "--trust" in flags, (name, each.name)
                seen += 1
    assert seen > 8
