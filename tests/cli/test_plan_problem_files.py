"""``redundancy-pin plan --problem``: what problem files say, and every mistake in them in one line."""

from __future__ import annotations

import dataclasses
import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import call, refused, write_motion
from plan_cases import PROBLEM, same, write_problem

import redundancy_pin as rp
from redundancy_pin.cli.plan_problem import STEPWISE, SWITCH_OFF, TIME_OPTIMAL, WHOLE_TRAJECTORY
from redundancy_pin.planners.optimal import plan_time_optimal, plan_whole_trajectory
from redundancy_pin.planners.options import GROUPS
from redundancy_pin.planners.stepwise.planner import plan_stepwise
from redundancy_pin.planners.switch_off.planner import plan_switch_off
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.reference import TRAJECTORIES

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "problem.yaml"


def test_the_documented_problem_is_that_of_the_python_api(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    assert call("plan", "--problem", EXAMPLE, "--out", out).exit_code == 0
    vertices = [[1.0, 0.4], [1.0, 0.52], [0.9, 0.56]]
    path = rp.trajectory.with_constant(rp.trajectory.rounded_polygon(vertices, 0.025, closed=False), 0.0)
    motion = rp.trajectory.Trajectory(path, rp.trajectory.SpeedProfile(path.length, 0.2, 0.2)).sample(0.001)
    mode = {"working_mode": (1, 1, 1), "carrier_mass": 3.0}
    expected = plan_stepwise(
        rp.VirtualWork(rp.load_robot("3rrr", **mode)),
        motion,
        objective=rp.Objective(lam=0.5, baseline=rp.VirtualWork(rp.load_robot("3rrr", carriers=False, **mode))),
        limits=rp.Limits(speed=[1.0, 1.2, 1.0], acceleration=[7.0, 12.0, 7.0]),
        start=[0.0, 0.1, 0.0],
    )
    same(rp.load_plan(out), expected)


def test_the_documented_problem_names_every_key_there_is() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    for name, make in TRAJECTORIES.items():
        match = re.search(rf"^#   {name} +(.*)$", text, flags=re.MULTILINE)
        assert match, name
        keys = {key.strip() for key in match[1].partition(":")[0].split(",")}
        assert keys == set(inspect.signature(make).parameters), name
    words = set(re.findall(r"\w+", text))
    assert {*SWITCH_OFF, *STEPWISE, *WHOLE_TRAJECTORY} <= words
    assert {"planner", "robot", "set", "mode", "gravity", "backend", "motion", "step"} <= words


def test_every_parameter_of_the_planners_can_be_written() -> None:
    for planner, known in (
        (plan_switch_off, set(SWITCH_OFF)),
        (plan_stepwise, {*STEPWISE, "baseline"}),
        (plan_whole_trajectory, {*WHOLE_TRAJECTORY, "baseline", "progress", "objective"}),
        (plan_time_optimal, {*TIME_OPTIMAL, "progress"}),
    ):
        keywords = {
            name
            for name, parameter in inspect.signature(planner).parameters.items()
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY
        }
        # the command line samples the trajectory of a stepwise plan itself, with --step
        keywords -= {"dt"} if planner is plan_stepwise else set()
        # fields of groups are written one by one, except those that the planner refuses or only judges
        groups = keywords & GROUPS.keys()
        fields = {field.name for group in groups for field in dataclasses.fields(GROUPS[group])}
        one_by_one = keywords - groups
        assert one_by_one <= known
        assert known - one_by_one - {"objective"} <= fields


def test_paths_in_a_problem_are_seen_from_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "task"
    folder.mkdir()
    write_motion(folder / "motion.csv", reference.corner(), 0.05)
    # 1e-1 is text for YAML 1.1, and a number for whoever wrote it
    (folder / "p.yaml").write_text(
        "planner: stepwise\nrobot: 3rrr\nmotion: motion.csv\nparameters: {brake_time: 4e-1}\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    assert call("plan", "--problem", "task/p.yaml", "--out", "plan.npz").exit_code == 0
    assert rp.load_plan("plan.npz").parameters["brake_time"] == 0.4


def test_points_give_a_smooth_path(tmp_path: Path) -> None:
    trajectory = {"name": "points", "points": [[1.0, 0.4], [1.02, 0.5], [0.95, 0.6]], "speed": 0.1, "ramp_time": 0.2}
    problem = write_problem(
        tmp_path / "p.yaml", planner="stepwise", robot="3rrr", step=0.002, trajectory={**trajectory, "alpha": 0.1}
    )
    assert call("plan", "--problem", problem, "--out", tmp_path / "plan.npz").exit_code == 0
    x = rp.load_plan(tmp_path / "plan.npz").motion.x
    np.testing.assert_allclose(x[0], [1.0, 0.4, 0.1], atol=1e-12)
    # a spline passes through its points: the middle one lies between samples 0.2 mm apart
    assert np.linalg.norm(x[:, :2] - [1.02, 0.5], axis=1).min() < 2e-4


@pytest.mark.parametrize(
    ("wrong", "group"), [("fast", "trajectory"), ("0.2 m/s", "trajectory"), ("fast", "parameters")]
)
def test_a_bad_value_has_its_own_line(wrong: str, group: str, tmp_path: Path) -> None:
    """``speed`` is a key of the trajectory and a parameter of the planner."""
    problem = tmp_path / "p.yaml"
    values = {"trajectory": "0.2", "parameters": "1.0", group: wrong}
    lines = ["planner: stepwise", "robot: 3rrr", "parameters:", f"  speed: {values['parameters']}"]
    lines += ["trajectory:", "  name: corner", f"  speed: {values['trajectory']}"]
    problem.write_text("\n".join(lines), encoding="utf-8")
    expected = 1 + next(i for i, line in enumerate(lines) if line.endswith(wrong))
    line = refused("plan", "--problem", problem, "--out", tmp_path / "plan.npz")
    assert f"p.yaml, line {expected}: " in line


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("parameters: {brake_time: 1}\nset: {brake_time: 2}\n", 4),  # no xacro argument
        ("set: {carrier_mass: 2}\nbaseline:\n  set:\n    carrier_mass: heavy\n", 6),
        ("set: {carrier_mass: 2}\nbaseline:\n  set:\n    carrier_mass: [1]\n", 6),
        ("set: {carrier_mass: 2}\nbaseline: {mode: abc}\n", 4),
        ("set: {carrier_mass: heavy}\nbaseline: {gravity: [0, 0, -9]}\n", 3),
        ("parameters:\n  datum: 0\n  track: [0, x]\n", 5),
        ("set: &two\n  carrier_mass: [1]\nbaseline: {set: {<<: *two}}\n", 4),
    ],
)
def test_keys_of_one_name_have_their_own_lines(text: str, expected: int, tmp_path: Path) -> None:
    problem = tmp_path / "p.yaml"
    problem.write_text(f"planner: stepwise\nrobot: 3rrr\n{text}trajectory: {{name: corner}}\n", encoding="utf-8")
    assert f"p.yaml, line {expected}: " in refused("plan", "--problem", problem)


BAD_PROBLEMS: dict[str, tuple[dict[str, Any], str]] = {
    "misspelt key": ({"planer": 1}, "Did you mean 'planner'"),
    "misspelt parameter": ({"parameters": {"lamb": 0.5}}, "Did you mean 'lam'"),
    "misspelt trajectory": ({"trajectory": {"name": "coner"}}, "Did you mean 'corner'"),
    "misspelt key of a trajectory": ({"trajectory": {"name": "corner", "radios": 1}}, "Did you mean 'radius'"),
    "misspelt planner": ({"planner": "step-wise"}, "Did you mean 'stepwise'"),
    "misspelt backend": ({"backend": "virtual_work"}, "Did you mean 'virtual-work'"),
    "misspelt robot parameter": ({"set": {"carrier_mas": 1}}, "carrier_mass"),
    "no robot": ({"robot": None}, "robot is None"),
    "unknown robot": ({"robot": "4rrr"}, "4rrr"),
    "two motions": ({"motion": "m.csv"}, "either a trajectory or a motion"),
    "no motion": ({"trajectory": None, "motion": 3}, "either a trajectory or a motion"),
    "trajectory whose name is none": ({"trajectory": {"name": {"": ""}}}, "The trajectory is {'': ''}"),
    "trajectory without a name": ({"trajectory": {"speed": 1}}, "'name'"),
    "trajectory that is a word": ({"trajectory": "corner"}, "or {name: points.csv}"),
    "trajectory that lacks a key": ({"trajectory": {"name": "polygon", "radius": 1}}, "'vertices'"),
    "points that are none": (
        {"trajectory": {"name": "points", "points": [[1, 2], [3]], "speed": 1, "ramp_time": 1}},
        "points",
    ),
    "speed that is a list": ({"trajectory": {"name": "corner", "speed": [1]}}, "speed"),
    "speed that is a mapping": ({"trajectory": {"name": "corner", "speed": {"a": 1}}}, "speed"),
    "speed that is negative": ({"trajectory": {"name": "corner", "speed": -1}}, "speed"),
    "speed that is true": ({"trajectory": {"name": "corner", "speed": True}}, "speed"),
    "radius that is nothing": ({"trajectory": {"name": "corner", "radius": None}}, "radius"),
    "parameters that are a list": ({"parameters": [1]}, "not a mapping"),
    "number that is text": ({"parameters": {"lam": "half"}}, "lam is 'half'"),
    "number that is true": ({"parameters": {"lam": True}}, "lam is True"),
    "number out of its domain": ({"parameters": {"lam": 2}}, "lam"),
    "not a number": ({"parameters": {"brake_time": ".nan"}}, "brake_time"),
    "word that is a number": ({"parameters": {"active": 1}}, "active is 1"),
    "unknown word": ({"parameters": {"active": "sometimes"}}, "sometimes"),
    "flag that is a number": ({"parameters": {"anticipate": 1}}, "anticipate is 1"),
    "ragged numbers": ({"parameters": {"track": [[1, 2], [3]]}}, "track"),
    "numbers of another robot": ({"parameters": {"speed": [1, 2]}}, "speed"),
    "whole number that is none": ({"parameters": {"between": 1.5}}, "between"),
    "infinite whole number": ({"parameters": {"between": float("inf")}}, "between"),
    "mode that is a list": ({"mode": [1, 1, 1]}, "mode"),
    "mode of another robot": ({"mode": "++"}, "such as mode: +++"),
    "backend of another robot": (
        {"robot": "five_bar", "backend": "virtual-work", "trajectory": {"name": "line"}},
        "Write backend: rnea",
    ),
    "trajectory of another robot": ({"trajectory": {"name": "circle"}}, "Choose the trajectory corner, square"),
    "limits of another robot": ({"parameters": {"acceleration": [1, 2]}}, "acceleration is [1.0, 2.0], expected 3"),
    "mode of letters": ({"mode": "abc"}, "mode"),
    "gravity of two": ({"gravity": [0, 1]}, "three numbers"),
    "gravity that is a number": ({"gravity": 9.81}, "three numbers"),
    "set of a list": ({"set": {"carrier_mass": [1]}}, "carrier_mass"),
    "step that is text": ({"step": "small"}, "step is 'small'"),
    "step of zero": ({"step": 0}, "dt"),
    "fraction of no baseline": ({"parameters": {"lam": 0.5}}, "baseline"),
    "baseline of unknown keys": ({"baseline": {"carriers": False}}, "no key 'carriers'"),
    "baseline that is a word": ({"baseline": "none"}, "not a mapping"),
    "step of the other planner": (
        {"planner": "switch-off", "robot": "2rpr", "trajectory": {"name": "line"}},
        "takes no step",
    ),
}


@pytest.mark.parametrize("case", BAD_PROBLEMS)
def test_bad_problems_are_refused_in_one_line(case: str, tmp_path: Path) -> None:
    changes, says = BAD_PROBLEMS[case]
    data = {**PROBLEM, **changes}
    if case == "no motion":
        data = {key: value for key, value in PROBLEM.items() if key != "trajectory"}
    if case == "not a number":
        data["parameters"] = {"brake_time": float("nan")}
    problem = write_problem(tmp_path / "p.yaml", **data)
    assert says in refused("plan", "--problem", problem, "--out", tmp_path / "plan.npz")
    assert list(tmp_path.iterdir()) == [problem]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"planner: [", "not readable YAML"),
        (b"", "no mapping"),
        (b"- 1\n", "no mapping"),
        (b"\xff\xfe", "not text in UTF-8"),
    ],
)
def test_files_that_are_no_problem(content: bytes, says: str, tmp_path: Path) -> None:
    problem = tmp_path / "p.yaml"
    problem.write_bytes(content)
    assert says in refused("plan", "--problem", problem)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("parameters:\n  lam: 0\n  brake_time: soon\n", "p.yaml, line 7: brake_time is 'soon'"),
        ("parameters: [1]\n", "p.yaml, line 5: parameters is"),
        ("set:\n  carrier_mass: []\n", "p.yaml, line 6: carrier_mass"),
        ("stop: 3\n", "p.yaml, line 5: The problem"),
        ("step: 1\nstep: 2\n", "p.yaml, line 6, column 1: the key 'step' was given in line 5"),
        ("gravity: 2026-11-22\n", "p.yaml, line 5, column 10: `gravity` is '2026-11-22'"),
        ("backend: virtual\n", "p.yaml"),
    ],
)
def test_file_and_line_are_named(text: str, says: str, tmp_path: Path) -> None:
    problem = tmp_path / "p.yaml"
    problem.write_text(f"planner: stepwise\nrobot: 3rrr\ntrajectory:\n  name: corner\n{text}", encoding="utf-8")
    assert says in refused("plan", "--problem", problem)


def test_the_file_of_the_robot_is_named_inside_that_of_the_problem(tmp_path: Path) -> None:
    robot = tmp_path / "robot.yaml"
    robot.write_text("name: x\nurdf: x.urdf\nname: y\n", encoding="utf-8")
    problem = write_problem(tmp_path / "p.yaml", **{**PROBLEM, "robot": "robot.yaml"})
    assert f"p.yaml: {robot}, line 3" in refused("plan", "--problem", problem)


def test_codes_of_a_terminal_are_not_printed(tmp_path: Path) -> None:
    problem = write_problem(tmp_path / "p.yaml", **{**PROBLEM, "\x1b[2J": 1})
    assert "\x1b" not in refused("plan", "--problem", problem)


def test_a_missing_problem(tmp_path: Path) -> None:
    assert "cannot be read" in refused("plan", "--problem", tmp_path / "nowhere.yaml")
    assert "cannot be read" in refused("plan", "--problem", tmp_path)
