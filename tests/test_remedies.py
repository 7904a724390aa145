"""Remedies in messages work: each test gets a message, does what it says, and sees the work done."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import call, refused

import redundancy_pin as rp
from redundancy_pin.errors import (
    CarrierLimitError,
    DeclarationError,
    InputError,
    PlanFileError,
    RedundancyPinError,
    UnreachablePoseError,
)
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.robot.shipped import models_root
from redundancy_pin.simulation import load_simulation, plan_reference
from redundancy_pin.simulation.controllers import ComputedTorque, FeedForward

CORNER = rp.trajectory.reference.corner(radius=0.025)


def parts(text: str) -> list[str]:
    """Return the calls that a remedy writes out."""
    return re.findall(r"(?:robot = )?(?:rp|robot)\.[\w.]+\([^()]*\)", text)


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot in a folder of its own."""
    folder = tmp_path_factory.mktemp("robots") / "mine"
    shutil.copytree(models_root() / "3rrr", folder)
    return folder / "robot.yaml"


def changed(kind: str) -> Robot:
    plain = rp.load_robot("3rrr")
    if kind == "masses":
        return rp.with_parameters(plain, masses={"platform": 0.7})
    if kind == "lengths":
        return rp.with_parameters(plain, lengths={"elbow_1": 0.31})
    if kind == "limits":
        return rp.with_limits(plain, lower=-0.2, upper=0.25)
    if kind == "payload":
        return plain.loaded(rp.Payload("platform", 0.3))
    return rp.robot_from_model(
        plain.model, closures=plain.closures, actuated=plain.actuated, carriers=plain.carriers,
        independent=plain.platform, reference=np.array(plain.q_reference),
    )  # fmt: skip


KINDS = ("masses", "lengths", "limits", "payload", "model")


@pytest.fixture(scope="module")
def made() -> Callable[[str], tuple[Robot, Plan, Any]]:
    """Return a changed robot, a plan for it and a simulation of it, made once."""
    known: dict[str, tuple[Robot, Plan, Any]] = {}

    def make(kind: str) -> tuple[Robot, Plan, Any]:
        if kind not in known:
            robot = changed(kind)
            plan = rp.plan_stepwise(rp.RneaDynamics(robot), CORNER, mesh=rp.Mesh(dt=0.2))
            known[kind] = robot, plan, rp.simulate(robot, plan, duration=0.02, stop_at=())
        return known[kind]

    return make


USES: dict[str, Callable[..., Any]] = {
    "show(plan)": lambda plan, run, **robot: rp.show(plan, **robot),
    "show(run)": lambda plan, run, **robot: rp.show(run, **robot),
    "plot.overview": lambda plan, run, **robot: rp.plot.overview(run, plan, **robot),
    "plot.path(plan)": lambda plan, run, **robot: rp.plot.path(plan, **robot),
    "plot.path(run)": lambda plan, run, **robot: rp.plot.path(run, **robot),
    "plot.condition": lambda plan, run, **robot: rp.plot.condition(run, **robot),
    "plan.table": lambda plan, run, **robot: plan.table(**robot),
    "run.table": lambda plan, run, **robot: run.table(**robot),
    "plan_reference": lambda plan, run, **robot: plan_reference(plan, **robot),
}
CONTROLLERS = {"ComputedTorque": ComputedTorque, "FeedForward": FeedForward}


@pytest.mark.long_for("lengths", "payload", "limits")
@pytest.mark.parametrize("kind", KINDS)
def test_what_was_made_in_python_needs_no_files(kind: str, made: Callable[..., Any]) -> None:
    """They advised ``source=``, which none of them takes."""
    _, plan, run = made(kind)
    for name, use in USES.items():
        assert use(plan, run) is not None, name
    for controller in CONTROLLERS.values():
        assert controller(plan).reference.robot is plan.robot.made_of


@pytest.mark.long_for("lengths", "payload", "limits", "model")
@pytest.mark.parametrize("kind", KINDS)
def test_read_again_it_asks_for_the_robot_and_takes_it(kind: str, made: Callable[..., Any], tmp_path: Path) -> None:
    robot, plan, run = made(kind)
    plan.save(tmp_path / "plan.npz")
    run.save(tmp_path / "run.npz")
    plan, run = rp.load_plan(tmp_path / "plan.npz"), load_simulation(tmp_path / "run.npz")
    for use in USES.values():
        with pytest.raises(RedundancyPinError) as caught:
            use(plan, run)
        assert "source=" not in str(caught.value)
        assert "robot=robot" in caught.value.remedy
        assert use(plan, run, robot=robot) is not None
    drawn = (rp.plot.path(one, **given) for one, given in ((made(kind)[2], {}), (run, {"robot": robot})))
    first, second = ([line.get_ydata() for axes in figure.axes for line in axes.lines] for figure in drawn)
    for expected, line in zip(first, second, strict=True):
        np.testing.assert_array_equal(line, expected)
    for controller in CONTROLLERS.values():
        with pytest.raises(PlanFileError, match=r"a controller takes plan_reference\(plan, robot=robot\)"):
            controller(plan)
        assert controller(plan_reference(plan, robot=robot)).reference.robot is robot


@pytest.mark.long_for("masses", "lengths", "limits")
@pytest.mark.parametrize("kind", KINDS)
def test_the_command_line_says_how_python_shows_what_it_made(
    kind: str, made: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    robot, plan, _ = made(kind)
    plan.save("plan.npz")
    for command in COMMANDS:
        line = refused(*command)
        assert "source=" not in line
        (show,) = parts(line)
        assert eval(show, {"rp": rp, "plan": rp.load_plan("plan.npz"), "robot": robot}).scene.title


COMMANDS = (
    ("show", "--plan", "plan.npz", "--html", "page.html"),
    ("check", "plan.npz"),
    ("export", "plan.npz", "--to", "plan.csv"),
    ("simulate", "--plan", "plan.npz", "--duration", "0.02", "--stop-at", "never"),
)


def require_working_remedy(plan: rp.Plan) -> None:
    """Run the Python that the refusal to show a plan recommends."""
    with pytest.raises(PlanFileError) as caught:
        rp.show(plan)
    names: dict[str, Any] = {"rp": rp, "plan": plan}
    load, show, *_ = parts(caught.value.remedy)
    exec(load, names)
    assert eval(show, names).scene.title


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_a_plan_outside_its_robots_folder(
    command: tuple[str, ...], own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All four said ``source=``; the flag that they take comes with the path that it needs."""
    monkeypatch.chdir(tmp_path)
    planned = call("plan", "stepwise", "--robot", own, "--motion", "corner", "--dt", "0.005", "--lam", "0",
                   "--out", "plan.npz")  # fmt: skip
    assert planned.exit_code in (0, 3), planned.stderr
    line = refused(*command)
    assert "source=" not in line
    (flag,) = re.findall(r"--robot \S+robot\.yaml(?=\.)", line)
    assert call(*command, *flag.split()).exit_code in (0, 3)
    plan = rp.load_plan("plan.npz")
    require_working_remedy(plan)


def test_a_robot_that_moved(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(own.parent, tmp_path / "here")
    plan = rp.plan_stepwise(rp.RneaDynamics(rp.load_robot("here")), CORNER, mesh=rp.Mesh(dt=0.005))
    plan.save("plan.npz")
    (tmp_path / "here").rename(tmp_path / "there")
    for command in COMMANDS:
        line = refused(*command)
        assert line.endswith("On the command line: --robot robot.yaml.")
        assert call(*command, "--robot", "there/robot.yaml").exit_code in (0, 3)
    monkeypatch.chdir(tmp_path / "there")
    plan = rp.load_plan("../plan.npz")
    require_working_remedy(plan)


# --- declarations and files ---


def variant(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """Return a copy of a shipped robot with other text in its declaration or its xacro."""
    shutil.copytree(models_root() / name, folder)
    for old, new in changes:
        files = [path for path in folder.iterdir() if old in path.read_text(encoding="utf-8")]
        assert files, old
        files[0].write_text(files[0].read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    return folder / "robot.yaml"


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


_WELD = ("axes: [x, y]}", "axes: [x, y, z, rx, ry, rz]}\n\nredundant_rows: true")
_IN_LINE = (
    ('ground_length" default="0.4"', 'ground_length" default="0.35"'),
    ('rocker_length" default="0.25"', 'rocker_length" default="0.1"'),
    ("joints: {crank: 1.0}", "joints: {crank: 0.0}"),
    ("guess: {crank: 1.0, rocker: 1.9, coupler: 2.0}", "guess: {crank: 0.0}"),
)


def test_redundant_rows_are_no_remedy_where_they_are_declared(tmp_path: Path) -> None:
    """Both messages said "say `redundant_rows: true`" to a declaration that says it."""
    weld = variant(tmp_path / "weld", "four_bar", _WELD)
    with pytest.raises(DeclarationError, match=r"left out already\. Take axes out of a closure that holds") as caught:
        rp.load_robot(weld)
    assert "redundant_rows" not in caught.value.remedy
    edit(weld, "ry, rz]", "ry]")
    assert rp.load_robot(weld).constraint_names == ("x of crank_tip = coupler_tip", "y of crank_tip = coupler_tip")
    line = variant(tmp_path / "line", "four_bar", *_IN_LINE, (_WELD[0], "axes: [x, y]}\n\nredundant_rows: true"))
    with pytest.raises(DeclarationError, match=r"left out already; .* Move the reference to where") as caught:
        rp.load_robot(line)
    assert "redundant_rows" not in caught.value.remedy
    edit(line, "joints: {crank: 0.0}", "joints: {crank: 1.0}")
    assert rp.load_robot(line).n == 1


@pytest.mark.parametrize(("old", "new"), [(", rz]", ", rz, rx]"), ("redundant_rows: true", "redundant_rows: false")])
def test_where_they_are_not_declared_they_are(old: str, new: str, tmp_path: Path) -> None:
    spatial = ("axes: [x, y]}", "axes: [x, y, z, rx, ry]}")
    robot = variant(tmp_path / "robot", "four_bar", spatial)
    with pytest.raises(DeclarationError, match="say `redundant_rows: true`"):
        rp.load_robot(robot)
    robot.write_text(robot.read_text(encoding="utf-8") + "\nredundant_rows: true\n", encoding="utf-8")
    assert rp.load_robot(robot).n == 1


@pytest.mark.parametrize(
    ("before", "after", "place"),
    [
        ("  joints: {crank: 1.0}", "\tjoints: {crank: 1.0}", "column 1"),
        ("  signs: [1]", "  \tsigns: [1]", "column 3"),
        ("  - {frames", "\t- {frames", "column 1"),
    ],
)
def test_tabs_are_named_and_spaces_take_their_place(before: str, after: str, place: str, tmp_path: Path) -> None:
    robot = variant(tmp_path / "robot", "four_bar", (before, after))
    number = robot.read_text(encoding="utf-8").split(after)[0].count("\n") + 1
    line = refused("info", "--robot", robot)
    assert f"line {number}, {place}: a tab, where YAML allows spaces alone. Put spaces in its place." in line
    edit(robot, after, before)
    assert call("info", "--robot", robot).exit_code == 0


def test_a_plain_urdf_has_no_arguments(tmp_path: Path) -> None:
    """It said "Its arguments: none." and no more."""
    xacro = models_root() / "four_bar" / "four_bar.urdf.xacro"
    robot = variant(tmp_path / "robot", "four_bar", (f"urdf: {xacro.name}", "urdf: four_bar.urdf"))
    text = robot.read_text(encoding="utf-8")
    robot.write_text(re.sub(r"requires:\n(  - .*\n)+", "", text), encoding="utf-8")
    (tmp_path / "robot" / xacro.name).unlink()
    plain = tmp_path / "robot" / "four_bar.urdf"
    plain.write_text(rp.load_robot("four_bar").urdf, encoding="utf-8")
    line = refused("info", "--robot", robot, "--set", "load=2.5")
    assert "four_bar.urdf has no argument 'load', nor any other." in line
    loaded = rp.load_robot(robot)
    assert "rp.with_parameters(robot, masses={...}, lengths={...})" in line
    heavy = rp.with_parameters(loaded, masses={"rocker_link": 2.5}, lengths={"rocker": 0.41})
    assert heavy.model.inertias[heavy.model.getJointId("rocker")].mass == 2.5
    # as the other half says: renamed, a namespace, an argument
    (name,) = re.findall(r"rename it (\S+),", line)
    (namespace,) = re.findall(r"xmlns:xacro=\"[^\"]+\"", line)
    (argument,) = re.findall(r"<xacro:arg name=\"load\" default=\"\.\.\.\"/>", line)
    (value,) = re.findall(r"\$\(arg load\)", line)
    edit(robot, "urdf: four_bar.urdf", f"urdf: {name}")
    renamed = plain.rename(plain.with_name(name))
    edit(renamed, '<robot name="four_bar"', f'<robot {namespace} name="four_bar"')
    urdf = renamed.read_text(encoding="utf-8")
    start = urdf.index(">", urdf.index("<robot")) + 1
    urdf = urdf[:start] + argument.replace("...", "0.5") + urdf[start:]
    assert urdf.count('mass value="0.5"') == 1
    renamed.write_text(urdf.replace('mass value="0.5"', f'mass value="{value}"'), encoding="utf-8")
    argued = rp.load_robot(robot, load=2.5)
    assert argued.model.inertias[argued.model.getJointId("rocker")].mass == 2.5
    assert "Its arguments: load." in refused("info", "--robot", robot, "--set", "lod=1")


def test_too_few_motors_are_counted_and_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It was `underactuated`, `unbounded` and NaN, and nowhere how many motors there are."""
    # logged once in a process for a name: one that no other test loads
    robot = variant(tmp_path / "robot", "five_bar", ("name: five_bar", "name: half_driven"),
                    ("actuated: [base_1, base_2]", "actuated: [base_1]"),
                    ("gravity: [0, 0, 0]", "gravity: [0, -9.81, 0]"))  # fmt: skip
    says = "half_driven has 2 degrees of freedom and 1 actuated joint (base_1): efforts cannot balance a general motion"
    motion = tmp_path / "motion.csv"
    rows = "".join(f"{t!r},{0.25 + t!r},0.7,1.0,0,0,0\n" for t in (0.0, 0.01, 0.02))
    motion.write_text("t,x,y,xd,yd,xdd,ydd\n" + rows, encoding="utf-8")
    balance = ("inverse-dynamics", "--backend", "rnea")  # compiles nothing
    for command, code in (
        (("info",), 0),
        ((*balance, "--motion", motion, "--out", tmp_path / "out.csv"), 3),
    ):
        done = call(*command, "--robot", robot)
        assert done.exit_code == code
        assert says in done.stderr
        assert (
            "Declare more joints as `actuated`. Passive joints that could be: base_2, elbow_1, elbow_2." in done.stderr
        )
    assert says in " ".join(call("info", "--robot", robot).stdout.split())
    assert (
        says in call("plan", "stepwise", "--backend", "rnea", "--robot", robot, "--motion", motion, "--lam", "0").stderr
    )
    rp.load_robot(robot)
    assert says in caplog.text
    for candidate in ("base_2", "elbow_1", "elbow_2"):
        edit(robot, "actuated: [base_1]", f"actuated: [base_1, {candidate}]")
        done = call(*balance, "--motion", motion, "--out", tmp_path / "out.csv", "--robot", robot)
        assert (done.exit_code, done.stderr) == (0, "")
        edit(robot, f"actuated: [base_1, {candidate}]", "actuated: [base_1]")


# --- units ---


MILLIMETRES = "times its size, .* m: it looks like millimetres; write metres."


def test_lengths_in_millimetres_are_guessed_where_they_are_refused(tmp_path: Path) -> None:
    robot = variant(tmp_path / "robot", "five_bar", ('platform: ["base_distance / 2", "', 'platform: [250, "1000 * '))
    with pytest.raises(DeclarationError, match=f"gap of .*{MILLIMETRES}"):
        rp.load_robot(robot)
    edit(robot, 'platform: [250, "1000 * ', 'platform: [0.25, "')
    five = rp.load_robot(robot)
    motion = rp.PlatformMotion([0.0, 1.0], [[250.0, 700.0]] * 2, np.zeros((2, 2)), np.zeros((2, 2)))
    for ask in (
        lambda m: rp.RneaDynamics(five).reduce(m),
        lambda m: rp.CompiledDynamics(five).reduce(m),
    ):
        with pytest.raises(UnreachablePoseError, match=MILLIMETRES):
            ask(motion)
        assert ask(rp.PlatformMotion(motion.t, 1e-3 * motion.x, motion.xd, motion.xdd)) is not None
    far = rp.PlatformMotion(motion.t, [[1.5, 1.5]] * 2, motion.xd, motion.xdd)
    with pytest.raises(UnreachablePoseError) as caught:
        rp.RneaDynamics(five).reduce(far)
    assert "millimetres" not in str(caught.value)  # merely too far


def test_generated_code_and_crossings_guess_too() -> None:
    motion = rp.PlatformMotion([0.0, 1.0], [[250.0, 700.0]] * 2, np.zeros((2, 2)), np.zeros((2, 2)))
    with pytest.raises(UnreachablePoseError, match=MILLIMETRES):
        rp.CompiledDynamics("five_bar").reduce(motion)
    with pytest.raises(UnreachablePoseError, match=MILLIMETRES):
        rp.find_crossings("five_bar", motion)


def test_other_lengths_and_times() -> None:
    three = rp.load_robot("3rrr", working_mode=(1, 1, 1))
    corner = CORNER.sample(0.1)
    in_mm = rp.PlatformMotion(corner.t, corner.x * [1e3, 1e3, 1.0], corner.xd * [1e3, 1e3, 1.0],
                              corner.xdd * [1e3, 1e3, 1.0])  # fmt: skip
    with pytest.raises(UnreachablePoseError, match=MILLIMETRES):
        rp.VirtualWork(three).reduce(in_mm)
    parked = rp.CarrierMotion.parked(len(corner), 3, 100.0)
    with pytest.raises(CarrierLimitError, match=MILLIMETRES):
        rp.inverse_dynamics(rp.RneaDynamics(three), corner, parked)
    points = rp.trajectory.from_points([[0.0, 0.0], [0.1, 0.0], [0.2, 0.1]], [0.0, 5e4, 2e4 + 8e4])
    with pytest.raises(InputError, match=r"milliseconds\? 100000 ms are 100 s"):
        points.sample(1e-3)
    assert len(rp.trajectory.from_points(points.path.points, [0.0, 0.5, 1.0]).sample(1e-3)) == 1001
