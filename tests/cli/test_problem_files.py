"""``redundancy-pin plan --problem``: what problem files say, and every mistake in them in one line, with its place."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from command_line import call, refused, write_motion
from plan_cases import PROBLEM, same, write_problem

import redundancy_pin as rp
from redundancy_pin.cli.options import keywords_of, numbers, weights
from redundancy_pin.cli.problem import read_problem
from redundancy_pin.errors import InputError
from redundancy_pin.planners.registry import PLANNERS
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.reference import TRAJECTORIES

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "problem.yaml"


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_documented_problem_is_that_of_the_python_api() -> None:
    assert call("plan", "--problem", EXAMPLE, "--out", "plan.npz").exit_code == 0
    vertices = [[1.0, 0.4], [1.0, 0.52], [0.9, 0.56]]
    path = rp.trajectory.with_constant(rp.trajectory.rounded_polygon(vertices, 0.025, closed=False), 0.0)
    motion = rp.trajectory.Trajectory(path, rp.trajectory.SpeedProfile(path.length, 0.2, 0.2))
    mode = {"working_mode": (1, 1, 1), "carrier_mass": 3.0}
    expected = rp.plan_stepwise(
        rp.VirtualWork(rp.load_robot("3rrr", **mode)),
        motion,
        objective=rp.Objective(lam=0.5, baseline=rp.VirtualWork(rp.load_robot("3rrr", carriers=False, **mode))),
        limits=rp.Limits(speed=[1.0, 1.2, 1.0], acceleration=[7.0, 12.0, 7.0]),
        mesh=rp.Mesh(dt=0.001),
        start=[0.0, 0.1, 0.0],
    )
    same(rp.load_plan("plan.npz"), expected)


def test_the_documented_problem_names_every_key_there_is() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    for name, make in TRAJECTORIES.items():
        match = re.search(rf"^#   {name} +(.*)$", text, flags=re.MULTILINE)
        assert match, name
        keys = {key.strip() for key in match[1].partition(":")[0].split(",")}
        assert keys == set(inspect.signature(make).parameters), name
    words = set(re.findall(r"\w+", text))
    assert {"planner", "robot", "set", "working_mode", "gravity", "backend", "motion", "parameters"} <= words
    for planner in PLANNERS.values():
        assert set(keywords_of(planner)) <= words


def test_every_keyword_of_a_planner_has_a_text_and_a_form() -> None:
    for name, planner in PLANNERS.items():
        for one in keywords_of(planner).values():
            assert len(one.text) > 8, (name, one)
            assert one.metavar or isinstance(one.default, bool)
    assert not {"refinements", "steps"} & set(keywords_of(PLANNERS["switch-off"]))  # refused by the planner


def test_paths_are_seen_from_the_folder_of_the_file() -> None:
    Path("task").mkdir()
    write_motion(Path("task/motion.csv"), reference.corner(), 0.005)
    Path("task/way.csv").write_text("x,y\n0.15,0.3\n0.2,0.2\n0.25,0.3\n")
    # 1e-1 is text for YAML 1.1, and a number for whoever wrote it
    text = "planner: stepwise\nrobot: 3rrr\nmotion: motion.csv\nparameters: {brake_time: 4e-1}\n"
    Path("task/p.yaml").write_text(text, encoding="utf-8")
    assert call("plan", "--problem", "task/p.yaml", "--out", "plan.npz").exit_code == 0
    assert rp.load_plan("plan.npz").parameters["brake_time"] == 0.4
    text = "planner: switch-off\nrobot: 2rpr\nmotion: {name: way.csv, speed: 0.2}\n"
    Path("task/p.yaml").write_text(text, encoding="utf-8")
    expected = rp.trajectory.from_points("task/way.csv", speed=0.2).sample(0.1).x
    assert (read_problem("task/p.yaml").motion.sample(0.1).x == expected).all()  # type: ignore[union-attr]
    # as the flag writes it, too
    Path("task/p.yaml").write_text(text.replace("{name: way.csv, speed: 0.2}", "way.csv:speed=0.2"), encoding="utf-8")
    assert (read_problem("task/p.yaml").motion.sample(0.1).x == expected).all()  # type: ignore[union-attr]


def test_a_trajectory_comes_before_a_file_of_its_name_and_files_need_no_suffix() -> None:
    Path("task").mkdir()
    for name in ("circle", "task/samples"):
        write_motion(Path(name), reference.corner(), 0.05)
    text = "planner: switch-off\nrobot: 2rpr\nmotion: {}\n"
    Path("task/p.yaml").write_text(text.format("circle"), encoding="utf-8")
    assert read_problem("task/p.yaml").motion.duration == reference.circle().duration  # type: ignore[union-attr]
    Path("task/p.yaml").write_text(text.format("samples"), encoding="utf-8")
    motion = read_problem("task/p.yaml").motion
    assert isinstance(motion, rp.PlatformMotion)
    assert motion.t[-1] == pytest.approx(reference.corner().duration)
    shown = call("inverse-dynamics", "--robot", "2rpr", "--motion", "circle", "--out", "tau.csv", "--json")
    assert '"circle' in shown.stdout


@pytest.mark.parametrize(
    ("planner", "parameters", "flags"),
    [
        ("whole-trajectory", {"objective": {"effort": 1, "peak": 2e-1}, "track": [[-0.1, 0.1], [-0.15, 0.15]],
                              "dt": 0.08},
         ("--objective", "effort", "--objective", "peak=0.2", "--track=-0.1,0.1;-0.15,0.15", "--dt", "0.08")),
        ("time-optimal", {"effort": 300, "steps": 20, "lap": False},
         ("--effort", "300", "--steps", "20", "--no-lap")),
    ],
)  # fmt: skip
def test_a_file_gives_the_plan_of_the_flags(planner: str, parameters: dict[str, Any], flags: tuple[str, ...]) -> None:
    circle = {"name": "line", "speed": 0.3}
    write_problem(Path("p.yaml"), planner=planner, robot="2rpr", motion=circle, parameters=parameters)
    first = call("plan", "--problem", "p.yaml", "--out", "file.npz")
    second = call("plan", planner, "--robot", "2rpr", "--motion", "line:speed=0.3", *flags, "--out", "flags.npz")
    assert (first.exit_code, second.exit_code) == (0, 0), first.stderr + second.stderr
    ours, theirs = rp.load_plan("file.npz"), rp.load_plan("flags.npz")
    assert ours.t[-1] == theirs.t[-1]
    if planner == "whole-trajectory":
        assert ours.parameters["objective"] == theirs.parameters["objective"] == {"effort": 1.0, "peak": 0.2}
        for plan in (ours, theirs):
            assert plan.limits.judged_by.track.tolist() == [[-0.1, 0.1], [-0.15, 0.15]]


def test_values_as_users_write_them() -> None:
    assert numbers("x", "1e-3") == 1e-3
    assert numbers("x", "0.1, -0.2").tolist() == [0.1, -0.2]
    assert numbers("x", [[1, 2], ["3e0", 4]]).tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert numbers("x", "1,2; 3e0,4").tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert weights("objective", ("effort",)) == weights("objective", "effort") == "effort"
    assert weights("objective", ("effort", "peak=2")) == {"effort": 1.0, "peak": 2.0}
    assert weights("objective", {"peak": "1e-1"}) == {"peak": 0.1}
    for value in ("", None, {}, True, [None], [1, [2]], 10**400, "1,2;3", ";"):
        with pytest.raises(InputError, match="x is"):
            numbers("x", value)
    for value in (None, 1, [1], ("peak=", "effort")):
        with pytest.raises(InputError):
            weights("objective", value)


WHOLE = {"planner": "whole-trajectory", "robot": "2rpr", "motion": {"name": "circle"}}
MISTAKES: tuple[tuple[dict[str, Any], str], ...] = (
    ({"planer": 1}, "Did you mean 'planner'"),
    ({"parameters": {"lamb": 0.5}}, "Did you mean 'lam'"),
    ({"motion": {"name": "coner"}}, "Did you mean 'corner'"),
    ({"motion": {"name": "corner", "radios": 1}}, "Did you mean 'radius'"),
    ({"planner": "step-wise"}, "Did you mean 'stepwise'"),
    ({"backend": "virtual_work"}, "Did you mean 'virtual-work'"),
    ({"set": {"carrier_mas": 1}}, "carrier_mass"),
    ({"robot": None}, "`robot` is None"),
    ({"robot": "4rrr"}, "4rrr"),
    ({"motion": "m.csv"}, "m.csv"),
    ({"motion": None}, "A plan needs a motion"),
    ({"trajectory": {"name": "corner"}}, "Unknown key `trajectory`"),
    ({"motion": {"name": {"": ""}}}, "The trajectory is {'': ''}"),
    ({"motion": {"speed": 1}}, "'name'"),
    ({"motion": ["corner"]}, "{name: circle, speed: 0.6}"),
    ({"motion": "coner"}, "Did you mean 'corner'"),
    ({"motion": {"name": "polygon", "radius": 1}}, "'vertices'"),
    ({"motion": {"name": "points", "points": [[1, 2], [3]], "speed": 1, "ramp_time": 1}}, "points"),
    *(({"motion": {"name": "corner", "speed": value}}, "speed") for value in ([1], {"a": 1}, -1, True)),
    ({"motion": {"name": "corner", "radius": None}}, "radius"),
    ({"motion": {"name": "circle"}}, "moves in 3 (x, y, rz)"),
    ({"parameters": [1]}, "`parameters` is [1]"),
    ({"parameters": {"lam": "half"}}, "lam is 'half'"),
    ({"parameters": {"lam": True}}, "lam is True"),
    ({"parameters": {"lam": 2}}, "lam"),
    ({"parameters": {"lam": 0.5}}, "baseline"),
    ({"parameters": {"brake_time": float("nan")}}, "brake_time"),
    ({"parameters": {"active": 1}}, "active is 1"),
    ({"parameters": {"active": "sometimes"}}, "sometimes"),
    ({"parameters": {"anticipate": 1}}, "anticipate is 1"),
    ({"parameters": {"track": [[1, 2], [3]]}}, "track"),
    ({"parameters": {"speed": [1, 2]}}, "speed"),
    ({"parameters": {"acceleration": [1, 2]}}, "acceleration is [1.0, 2.0], expected 3"),
    ({"parameters": {"dt": "small"}}, "dt is 'small'"),
    ({"parameters": {"dt": 0}}, "dt is 0 s"),
    ({"working_mode": [1, 1, 1]}, "working_mode"),
    ({"working_mode": "++"}, "+++"),
    ({"working_mode": "abc"}, "working_mode"),
    ({"robot": "five_bar", "backend": "virtual-work", "motion": {"name": "line"}}, "Use the backend rnea"),
    ({"gravity": [0, 1]}, "three numbers"),
    ({"gravity": 9.81}, "three numbers"),
    ({"set": {"carrier_mass": [1]}}, "carrier_mass` is [1]"),
    ({"baseline": {"carriers": False}}, "Unknown key `carriers`"),
    ({"baseline": "none"}, "`baseline` is 'none'"),
    ({**WHOLE, "parameters": {"steps": 10}}, "no key 'steps'"),
    ({**WHOLE, "parameters": {"objective": 3}}, "objective is 3"),
    ({**WHOLE, "parameters": {"objective": {"peak": "high"}}}, "peak in objective is 'high'"),
    ({**WHOLE, "parameters": {"starts": 1.5}}, "starts is 1.5, not a whole number"),
    ({**WHOLE, "parameters": {"starts": float("inf")}}, "starts is inf"),
)


@pytest.mark.parametrize(("changes", "says"), MISTAKES, ids=[f"{changes}"[:70] for changes, _ in MISTAKES])
def test_mistakes_are_one_line(changes: dict[str, Any], says: str) -> None:
    problem = write_problem(Path("p.yaml"), **{**PROBLEM, **changes})
    assert says in refused("plan", "--problem", problem, "--out", "plan.npz")
    assert [path.name for path in Path().iterdir()] == ["p.yaml"]


def test_a_baseline_that_the_planner_does_not_take() -> None:
    Path("p.yaml").write_text("planner: switch-off\nrobot: 2rpr\nmotion: {name: line}\nbaseline:\n  set: {}\n")
    said = refused("plan", "--problem", "p.yaml")
    assert "p.yaml, line 4: plan_switch_off has no keyword 'baseline'" in said


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"planner: [", "not readable YAML"), (b"", "no mapping"), (b"- 1\n", "no mapping"),
     (b"\xff\xfe", "not text in UTF-8")],
)  # fmt: skip
def test_files_that_are_no_problem(content: bytes, says: str) -> None:
    Path("p.yaml").write_bytes(content)
    assert says in refused("plan", "--problem", "p.yaml")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("parameters:\n  lam: 0\n  brake_time: soon\n", 7),
        ("parameters: [1]\n", 5),
        ("set:\n  carrier_mass: []\n", 6),
        ("stop: 3\n", 5),
        ("gravity: 2026-11-22\n", 5),
        ("parameters: {brake_time: 1}\nset: {brake_time: 2}\n", 6),  # no xacro argument
        ("set: {carrier_mass: 2}\nbaseline:\n  set:\n    carrier_mass: heavy\n", 8),
        ("set: {carrier_mass: 2}\nbaseline:\n  set:\n    carrier_mass: [1]\n", 8),
        ("set: {carrier_mass: 2}\nbaseline: {working_mode: abc}\n", 6),
        ("set: {carrier_mass: heavy}\nbaseline: {gravity: [0, 0, -9]}\n", 5),
        ("parameters:\n  datum: 0\n  track: [0, x]\n", 7),
        ("parameters:\n  datum: 0\n  track: [0.1, -0.1]\n", 7),
        ("set: &two\n  carrier_mass: [1]\nbaseline: {set: {<<: *two}}\n", 6),
        ("parameters:\n  speed: fast\n", 6),  # a key of the trajectory, too
        ("  speed: fast\nparameters:\n  speed: 1.0\n", 5),
        ("parameters:\n  dt: 0.05\n  active: sometimes\n", 7),  # refused by the planner
        ("parameters:\n  dt: 0.05\n  start: 5\n", 7),
        ("parameters:\n  dt: 0.05\n  effort: [1, 2]\n", 7),
        ("parameters:\n  baseline: {carriers: false}\n", 6),
    ],
)
def test_each_mistake_has_its_line(text: str, line: int) -> None:
    head = "planner: stepwise\nrobot: 3rrr\nmotion:\n  name: corner\n"
    Path("p.yaml").write_text(head + text, encoding="utf-8")
    assert re.match(rf"error: p.yaml, line {line}(, column \d+)?: ", refused("plan", "--problem", "p.yaml"))


def test_names_of_strangers() -> None:
    """The robot's own file is named inside that of the problem; codes of a terminal are not printed."""
    Path("robot.yaml").write_text("name: x\nurdf: x.urdf\nname: y\n", encoding="utf-8")
    write_problem(Path("p.yaml"), **{**PROBLEM, "robot": "robot.yaml"})
    assert re.search(r"p\.yaml.*: .*robot\.yaml, line 3", refused("plan", "--problem", "p.yaml"))
    Path("p.yaml").write_text(yaml.safe_dump({**PROBLEM, "\x1b[2J": 1}), encoding="utf-8")
    assert "\x1b" not in refused("plan", "--problem", "p.yaml")
