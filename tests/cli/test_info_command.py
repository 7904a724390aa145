"""``redundancy-pin info``, and what all commands have in common: help, version, missing command."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from command_line import call, refused

import redundancy_pin
from redundancy_pin import load_robot
from redundancy_pin.cli import main
from redundancy_pin.dynamics.description import describe
from redundancy_pin.io import limited
from redundancy_pin.robot.shipped import shipped_robots

COMMANDS = ("reproduce", "inverse-dynamics", "singularities", "validate", "info")


def test_lists_the_shipped_robots() -> None:
    facts = json.loads(call("info", "--json").stdout)["robots"]
    assert tuple(entry["name"] for entry in facts) == shipped_robots()
    text = call("info").stdout
    for entry in facts:
        assert entry["description"]
        assert entry["name"] in text


@pytest.mark.long_for(*set(shipped_robots()) - set(shipped_robots(gallery=False)))
@pytest.mark.parametrize("name", shipped_robots())
def test_describes_every_robot(name: str) -> None:
    robot = load_robot(name)
    facts = json.loads(call("info", "--robot", name, "--json").stdout)
    assert facts["counts"] == {
        "independent velocities n": robot.n,
        "main actuators m": robot.m,
        "carriers k": robot.k,
        "nq": robot.model.nq,
        "nv": robot.model.nv,
    }
    roles = [joint["role"] for joint in facts["joints"]]
    assert roles.count("actuated") == robot.m
    assert roles.count("carrier") == robot.k
    assert roles.count("passive") == robot.model.njoints - 1 - robot.m - robot.k
    assert [closure["axes"] for closure in facts["closures"]] == [list(c.axes) for c in robot.closures]
    assert facts["reference"]["type_ii_margin"] > 0.0
    assert [facts["motor_limits"][motor]["speed"] for motor in robot.actuated] == robot.speed_limits.tolist()
    text = call("info", "--robot", name).stdout
    for parameter in robot.parameters:
        assert parameter in text


def test_defaults_are_of_files_and_a_robot_in_python_has_no_column_of_them() -> None:
    assert "default" in call("info", "--robot", "3rrr").stdout
    facts = describe(load_robot("3rrr"))
    assert "default" not in str(facts)
    assert facts["parameters"]["carrier_mass"].keys() == {"value"}


def test_colons_in_names_make_no_pictures(tmp_path: Path) -> None:
    """``rod:a:universal``, a frame that the reader of MuJoCo's models makes, was shown with an emoji in it."""
    file = tmp_path / "arm.xml"
    file.write_text(
        """<mujoco model="arm:a:"><worldbody><body><joint name="hinge:b:1"/><geom size="0.1"/></body></worldbody>
        <actuator><motor joint="hinge:b:1"/></actuator></mujoco>""",
        encoding="utf-8",
    )
    assert call("info", "--robot", str(file)).stdout.count("hinge:b:1") >= 2
    assert "arm:a:" in call("validate", "--robot", str(file), "--samples", "2").stdout


@pytest.mark.parametrize(
    ("line", "shown", "facts"),
    [
        ("2rpr", ["reference [m] ", "[m/s²]", "[N]"], {"carrier_limits.carrier_1.position": [-0.2, 0.2]}),
        ("four_bar", ["reference [rad] "], {}),
        # a pose as its declaration has it, without the rounding of a closure
        ("gough", ["reference [m, rad] ", "xyz 0, 0, 0.6; rpy 0, 0, 0 "], {"carrier_limits": {}}),
        (
            "3rrr --set carrier_mass=2 --set platform_mass=1 --working-mode +-+ --gravity 0,-9.81,0",
            ["reference [m, rad] ", "carrier_mass", "+-+ of "],
            {
                "parameters.carrier_mass": {"value": 2.0, "default": 3.0},
                "parameters.platform_mass": {"value": 1.0, "default": 0.5},
                "working_mode": "+-+",
            },
        ),
        ("3rrr --gravity 0,0,-9.81", ["normal to the plane of motion, no effect on efforts"], {"gravity_acts": False}),
    ],
)
def test_what_is_shown_and_the_facts(line: str, shown: list[str], facts: dict[str, object]) -> None:
    result = call("info", "--robot", *line.split())
    for text in shown:
        assert text in result.stdout
    assert ("no effect" in result.stdout) == ("is normal to the plane in which 3rrr moves" in result.stderr)
    found = json.loads(call("info", "--robot", *line.split(), "--json").stdout)
    for path, expected in facts.items():
        entry = found
        for key in path.split("."):
            entry = entry[key]
        assert entry == expected, path


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(command: str) -> None:
    result = call(command, "--help")
    assert result.exit_code == 0
    assert "Example" in result.stdout
    assert f"redundancy-pin {command} " in result.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_completion_is_produced(shell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_REDUNDANCY_PIN_COMPLETE", f"{shell}_source")
    monkeypatch.setattr("click.shell_completion.BashComplete._check_version", lambda *_: None)
    result = CliRunner().invoke(main, [], prog_name="redundancy-pin")
    assert "_REDUNDANCY_PIN_COMPLETE" in result.stdout
    monkeypatch.setenv("_REDUNDANCY_PIN_COMPLETE", f"{shell}_complete")
    monkeypatch.setenv("COMP_WORDS", "redundancy-pin plan switch-off --ramp")
    monkeypatch.setenv("COMP_CWORD", "3" if shell != "fish" else "--ramp")
    assert "--ramp-down" in CliRunner().invoke(main, [], prog_name="redundancy-pin").stdout


def test_version() -> None:
    assert redundancy_pin.__version__ in call("--version").stdout


def test_a_robot_without_description_and_parameters_has_no_empty_places(tmp_path: Path) -> None:
    (tmp_path / "bare.urdf").write_text(
        '<robot name="bare"><link name="base"/><link name="arm"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="crank" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>'
        "</robot>"
    )
    (tmp_path / "robot.yaml").write_text(
        "name: bare\nurdf: bare.urdf\nactuated: [crank]\nindependent: {joints: [crank]}\n"
        "reference: {joints: {crank: 0.7}}\n"
    )
    text = call("info", "--robot", tmp_path).stdout
    assert "bare:" not in text
    assert "--set" not in text
    # a continuous joint has no limits, and is at an angle all the same
    assert any("crank" in line and "0.7" in line for line in text.splitlines())
    assert '"reference": 0.7' in call("info", "--robot", tmp_path, "--json").stdout


def test_a_strangers_file_is_read_in_a_process_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """``--untrusted`` ends a reader that takes too long, and no file is both."""
    shutil.copytree(Path(__file__).parents[2] / "models" / "five_bar", tmp_path / "five_bar")
    xacro, calls, run = tmp_path / "five_bar" / "robot.yaml", list[str](), limited.run_limited
    monkeypatch.setattr(
        "redundancy_pin.robot.formats.xacro_engine.run_limited", lambda *given: calls.append(given[0]) or run(*given)
    )
    assert call("info", "--robot", xacro, "--untrusted").stdout == call("info", "--robot", xacro).stdout
    assert len(calls) == 2  # the robot, and its defaults
    assert "trust and untrusted are both true" in refused("info", "--robot", xacro, "--untrusted", "--trust")
    monkeypatch.setattr(limited, "SECONDS", 0.01)
    for arguments in (
        ("info", "--robot", xacro),
        ("new", xacro.with_name("five_bar.urdf.xacro"), "--out", tmp_path / "x.yaml"),
    ):
        assert "takes more than 0.01 s" in refused(*arguments, "--untrusted")
