"""``redundancy-pin plan``: the plans of the Python API, limits told by the exit code, every mistake in one line."""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command_line import call, refused, write_motion

import redundancy_pin as rp
from redundancy_pin.cli.plan_parameters import STEPWISE, SWITCH_OFF, WHOLE_TRAJECTORY
from redundancy_pin.cli.plan_values import number, numbers
from redundancy_pin.errors import InputError
from redundancy_pin.experiments.trajectories import TRAJECTORIES
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.planners.stepwise import plan_stepwise
from redundancy_pin.planners.switch_off import plan_switch_off
from redundancy_pin.planners.whole_trajectory import plan_whole_trajectory
from redundancy_pin.trajectory import from_csv, reference

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "problem.yaml"

# a crossing within all limits: slow, along the line
LINE = ("plan", "switch-off", "--robot", "2rpr", "--trajectory", "line", "--threshold", "4", "--dt", "0.01")
CORNER = ("plan", "stepwise", "--robot", "3rrr", "--mode", "+++", "--trajectory", "corner", "--step", "0.02")


def _same(ours: Plan, theirs: Plan) -> None:
    """The same computation on the same input: equal to the last bit."""
    for name in ("tau", "carrier_force", "margin", "phase", "sample_status"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    np.testing.assert_array_equal(ours.motion.x, theirs.motion.x)
    np.testing.assert_array_equal(ours.carriers.s, theirs.carriers.s)
    assert ours.status is theirs.status
    assert ours.limits == theirs.limits
    assert ours.robot == theirs.robot


# ------------------------------------------------------------------------------------ what the Python API gives


def test_switch_off_is_that_of_the_python_api(tmp_path: Path) -> None:
    out, plot = tmp_path / "plan.npz", tmp_path / "plan.png"
    result = call(
        "plan", "switch-off", "--robot", "2rpr", "--set", "carrier_mass=2.0", "--backend", "virtual-work",
        "--trajectory", "circle", "--speed", "0.6", "--threshold", "7", "--return-time", "0.5", "--ramp-down", "0.02",
        "--dt", "0.005", "--datum", "0.01,-0.01", "--out", str(out), "--plot", str(plot),
    )  # fmt: skip
    robot = rp.load_robot("2rpr", carrier_mass=2.0)
    expected = plan_switch_off(
        rp.VirtualWork(robot),
        reference.circle(speed=0.6),
        threshold=7.0,
        return_time=0.5,
        ramp_down=0.02,
        dt=0.005,
        datum=[0.01, -0.01],
    )
    found = rp.load_plan(out)
    _same(found, expected)
    assert found.parameters["datum"] == [0.01, -0.01]
    assert plot.read_bytes().startswith(b"\x89PNG")
    # this crossing breaks limits: said by the exit code, in one line, and in the table
    assert expected.status is PlanStatus.VIOLATES_LIMITS
    assert result.exit_code == 3
    assert len(result.stderr.splitlines()) == 1
    worst = max(expected.limits.violated, key=lambda event: event.quantity == "track")
    assert f"{worst.quantity} of {worst.carrier} by {worst.amount:.3g}" in result.stderr
    assert "violates limits" in result.stdout
    assert f"{expected.peak_effort[0]:.6g}" in result.stdout
    assert f"{expected.carrier_energy:.6g}" in result.stdout


def test_a_plan_within_limits_is_silent_on_stderr(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    result = call(*LINE, "--out", out)
    assert (result.exit_code, result.stderr) == (0, "")
    expected = plan_switch_off(rp.RneaDynamics(rp.load_robot("2rpr")), reference.line(), threshold=4.0, dt=0.01)
    assert expected.status is PlanStatus.WITHIN_LIMITS
    _same(rp.load_plan(out), expected)


def test_stepwise_is_that_of_the_python_api(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    result = call(
        *CORNER, "--radius", "0.03", "--lam", "0.5", "--baseline", "carriers=false", "--max-speed", "0.8",
        "--max-acceleration", "6,7,8", "--track", "-0.9,0.9", "--brake-time", "0.4", "--no-anticipate", "--out", out,
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    expected = plan_stepwise(
        rp.RneaDynamics(rp.load_robot("3rrr", working_mode=(1, 1, 1))),
        reference.corner(radius=0.03).sample(0.02),
        lam=0.5,
        baseline=rp.RneaDynamics(rp.load_robot("3rrr", working_mode=(1, 1, 1), carriers=False)),
        speed=0.8,
        acceleration=[6.0, 7.0, 8.0],
        track=[-0.9, 0.9],
        brake_time=0.4,
        anticipate=False,
    )
    _same(rp.load_plan(out), expected)


def test_a_motion_from_a_file(tmp_path: Path) -> None:
    motion, out = write_motion(tmp_path / "motion.csv", reference.corner(), 0.02), tmp_path / "plan.npz"
    result = call("plan", "stepwise", "--robot", "3rrr", "--motion", motion, "--out", out)
    assert result.exit_code == 0, result.stderr
    _same(rp.load_plan(out), plan_stepwise(rp.RneaDynamics(rp.load_robot("3rrr")), from_csv(motion)))


def test_flags_and_keys_of_a_trajectory_are_the_same(tmp_path: Path) -> None:
    one, other = tmp_path / "one.npz", tmp_path / "other.npz"
    base = ("plan", "stepwise", "--robot", "3rrr", "--step", "0.02")
    call(*base, "--trajectory", "square", "--speed", "0.15", "--side", "0.1", "--out", one)
    call(*base, "--trajectory", "square:speed=0.15,side=0.1", "--out", other)
    assert one.read_bytes() == other.read_bytes()
    t = rp.load_plan(one).motion.t
    assert t[-1] >= reference.square(speed=0.15, side=0.1).duration


def test_json_is_pure_and_tells_what_the_plan_holds(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    result = call(*CORNER, "--json", "--out", out)
    found, plan = json.loads(result.stdout), rp.load_plan(out)
    assert found["status"] == plan.status.value
    assert found["peak_effort"] == plan.peak_effort.tolist()
    assert found["main_energy"] == plan.main_energy
    assert len(found["limits"]["binding"]) == len(plan.limits.binding)
    assert found["parameters"]["lam"] == 0.0
    assert found["out"] == str(out)


def test_nothing_need_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(*CORNER).exit_code == 0
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------------------------------------ problem files


def _write(path: Path, **data: Any) -> Path:
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_the_documented_problem_is_that_of_the_python_api(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    assert call("plan", "--problem", EXAMPLE, "--out", out).exit_code == 0
    vertices = [[1.0, 0.4], [1.0, 0.52], [0.9, 0.56]]
    path = rp.trajectory.with_constant(rp.trajectory.rounded_polygon(vertices, 0.025, closed=False), 0.0)
    motion = rp.trajectory.Trajectory(path, rp.trajectory.SpeedProfile(path.length, 0.2, 0.2)).sample(0.005)
    mode = {"working_mode": (1, 1, 1), "carrier_mass": 3.0}
    expected = plan_stepwise(
        rp.VirtualWork(rp.load_robot("3rrr", **mode)),
        motion,
        lam=0.5,
        baseline=rp.VirtualWork(rp.load_robot("3rrr", carriers=False, **mode)),
        speed=[1.0, 1.2, 1.0],
        acceleration=[7.0, 12.0, 7.0],
        start=[0.0, 0.1, 0.0],
    )
    _same(rp.load_plan(out), expected)


def test_the_documented_problem_names_every_key_there_is() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    for name, make in TRAJECTORIES.items():
        said = re.search(rf"^#   {name} +(.*)$", text, flags=re.MULTILINE)
        assert said, name
        keys = {key.strip() for key in said[1].partition(":")[0].split(",")}
        assert keys == set(inspect.signature(make).parameters), name
    words = set(re.findall(r"\w+", text))
    assert {*SWITCH_OFF, *STEPWISE, *WHOLE_TRAJECTORY} <= words
    assert {"planner", "robot", "set", "mode", "gravity", "backend", "motion", "step"} <= words


def test_every_parameter_of_the_planners_can_be_written() -> None:
    for planner, known in (
        (plan_switch_off, set(SWITCH_OFF)),
        (plan_stepwise, {*STEPWISE, "baseline"}),
        (plan_whole_trajectory, {*WHOLE_TRAJECTORY, "baseline", "progress"}),
    ):
        keywords = {
            name
            for name, parameter in inspect.signature(planner).parameters.items()
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY
        }
        # the command line samples the trajectory of a stepwise plan itself, with --step
        sampled_here = {"dt"} if planner is plan_stepwise else set()
        assert known == keywords - sampled_here


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
    problem = _write(
        tmp_path / "p.yaml", planner="stepwise", robot="3rrr", step=0.02, trajectory={**trajectory, "alpha": 0.1}
    )
    assert call("plan", "--problem", problem, "--out", tmp_path / "plan.npz").exit_code == 0
    x = rp.load_plan(tmp_path / "plan.npz").motion.x
    np.testing.assert_allclose(x[0], [1.0, 0.4, 0.1], atol=1e-12)
    # a spline passes through its points: the middle one lies between samples 2 mm apart
    assert np.linalg.norm(x[:, :2] - [1.02, 0.5], axis=1).min() < 2e-3


GOOD: dict[str, Any] = {"planner": "stepwise", "robot": "3rrr", "step": 0.05, "trajectory": {"name": "corner"}}
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
    "trajectory without a name": ({"trajectory": {"speed": 1}}, "'name'"),
    "trajectory that is a word": ({"trajectory": "corner"}, "not a mapping"),
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
    data = {**GOOD, **changes}
    if case == "no motion":
        data = {key: value for key, value in GOOD.items() if key != "trajectory"}
    if case == "not a number":
        data["parameters"] = {"brake_time": float("nan")}
    problem = _write(tmp_path / "p.yaml", **data)
    assert says in refused("plan", "--problem", problem, "--out", tmp_path / "plan.npz")
    assert list(tmp_path.iterdir()) == [problem]


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"planner: [", "not YAML"), (b"", "no mapping"), (b"- 1\n", "no mapping"), (b"\xff\xfe", "not YAML")],
)
def test_files_that_are_no_problem(content: bytes, says: str, tmp_path: Path) -> None:
    problem = tmp_path / "p.yaml"
    problem.write_bytes(content)
    assert says in refused("plan", "--problem", problem)


def test_a_missing_problem(tmp_path: Path) -> None:
    assert "cannot be read" in refused("plan", "--problem", tmp_path / "nowhere.yaml")
    assert "cannot be read" in refused("plan", "--problem", tmp_path)


# --------------------------------------------------------------------------------------------- mistakes in flags

BAD_FLAGS: dict[str, tuple[tuple[str, ...], str]] = {
    "two motions": (("--motion", "m.csv"), "either --trajectory or --motion"),
    "unknown trajectory": (("--trajectory", "lien"), "Did you mean 'line'"),
    "key of another trajectory": (("--radius", "0.1"), "no key 'radius'"),
    "key twice": (("--trajectory", "line:speed=0.1", "--speed", "0.2"), "given twice"),
    "pair that is none": (("--trajectory", "line:speed"), "KEY=VALUE"),
    "speed that is text": (("--speed", "fast"), "fast"),
    "threshold that is text": (("--threshold", "high"), "threshold is 'high'"),
    "threshold below one": (("--threshold", "0.5"), "threshold"),
    "unknown measure": (("--measure", "distance"), "distance"),
    "unknown scheme": (("--scheme", "euler"), "euler"),
    "unknown return": (("--return-time", "longest"), "longest"),
    "datum of three": (("--datum", "0,0,0"), "datum"),
    "datum that is text": (("--datum", "abc"), "datum"),
    "ramp of nothing": (("--ramp-down", "0"), "ramp_down"),
    "samples of nothing": (("--dt", "-1"), "dt"),
    "no such folder": (("--out", "nowhere/plan.npz"), "nowhere"),
    "picture of no format": (("--plot", "plan.txt"), "picture format"),
    "picture in no folder": (("--plot", "nowhere/plan.png"), "nowhere"),
    "both in one file": (("--out", "a.png", "--plot", "a.png"), "same file"),
    "unknown option": (("--treshold", "5"), "--treshold"),
    "unknown parameter": (("--set", "carrier_mas=2"), "carrier_mass"),
    "return that does not end": (("--return-time", "100"), "return"),
    "mass that nothing carries": (("--set", "end_effector_mass=1", "--trajectory", "circle"), "nothing can carry"),
}


@pytest.mark.parametrize("case", BAD_FLAGS)
def test_bad_flags_are_refused_in_one_line(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    extra, says = BAD_FLAGS[case]
    assert says in refused(*LINE, "--out", "plan.npz", *extra)
    assert list(tmp_path.iterdir()) == []


def test_inputs_are_not_overwritten(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.csv", reference.corner(), 0.05)
    before = motion.read_bytes()
    assert "--out" in refused("plan", "stepwise", "--robot", "3rrr", "--motion", motion, "--out", motion)
    assert motion.read_bytes() == before
    problem = _write(tmp_path / "p.yaml", **GOOD)
    before = problem.read_bytes()
    assert "--out" in refused("plan", "--problem", problem, "--out", problem)
    assert problem.read_bytes() == before


def test_flags_do_not_apply_to_a_motion_from_a_file(tmp_path: Path) -> None:
    motion = write_motion(tmp_path / "motion.csv", reference.corner(), 0.05)
    base = ("plan", "stepwise", "--robot", "3rrr", "--motion", motion)
    assert "--ramp-time" in refused(*base, "--ramp-time", "0.2")
    assert "own steps" in refused(*base, "--step", "0.2")


def test_a_robot_without_carriers_has_nothing_to_plan() -> None:
    assert "carrier" in refused(
        "plan", "stepwise", "--robot", "3rrr", "--set", "carriers=false", "--trajectory", "corner"
    )


def test_plan_alone_and_options_in_the_wrong_place(tmp_path: Path) -> None:
    assert "--problem" in refused("plan")
    assert "--problem" in refused("plan", "--out", tmp_path / "a.npz", *LINE[1:])


def test_a_picture_that_fails_leaves_no_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from redundancy_pin.cli import plan_output
    from redundancy_pin.errors import OutputError

    def fail(*_: object) -> None:
        raise OutputError("The disk is full.")

    monkeypatch.setattr(plan_output, "save", fail)
    assert "full" in refused(*LINE, "--out", tmp_path / "plan.npz", "--plot", tmp_path / "plan.png")
    assert list(tmp_path.iterdir()) == []


def test_examples_in_the_help_keep_their_lines() -> None:
    for command in ((), ("switch-off",), ("stepwise",), ("whole-trajectory",)):
        lines = [line.strip() for line in call("plan", *command, "--help").stdout.splitlines()]
        assert any(line.startswith("redundancy-pin plan") and line.endswith("\\") for line in lines)
        assert not any("\\b" in line for line in lines)


def test_numbers_as_users_write_them() -> None:
    assert number("x", "1e-3") == 1e-3
    assert numbers("x", "0.1, -0.2").tolist() == [0.1, -0.2]
    assert numbers("x", [[1, 2], ["3e0", 4]]).tolist() == [[1.0, 2.0], [3.0, 4.0]]
    for value in ("", None, {}, True, [None], [1, [2]], 10**400):
        with pytest.raises(InputError, match="x is"):
            numbers("x", value)


def test_a_plan_through_a_singularity_has_no_margin_left() -> None:
    """Whether a sample lies on the singular instant is chance: the plan crosses it all the same."""
    result = call("plan", "switch-off", "--robot", "2rpr", "--trajectory", "circle", "--threshold", "20", "--json")
    assert json.loads(result.stdout)["smallest_margin"] == 0.0
