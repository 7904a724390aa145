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
from redundancy_pin.errors import PlanFileError, RedundancyPinError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.robot.urdf import models_root
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
        return plain.with_parameters(masses={"platform": 0.7})
    if kind == "lengths":
        return plain.with_parameters(lengths={"elbow_1": 0.31})
    if kind == "limits":
        return plain.with_limits(lower=-0.2, upper=0.25)
    if kind == "payload":
        return plain.loaded(rp.Payload("platform", 0.3))
    return rp.Robot.from_model(
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
            plan = rp.plan_stepwise(rp.RneaDynamics(robot), CORNER, lam=0.0, dt=0.2)
            known[kind] = robot, plan, rp.simulate(robot, plan, duration=0.02, stop_at=())
        return known[kind]

    return make


USES: dict[str, Callable[..., Any]] = {
    "show(plan)": lambda plan, run, **robot: rp.show(plan, **robot),
    "show(run)": lambda plan, run, **robot: rp.show(run, **robot),
    "plot.simulation": lambda plan, run, **robot: rp.plot.simulation(run, plan, **robot),
    "plot.path(plan)": lambda plan, run, **robot: rp.plot.path(plan, **robot),
    "plot.path(run)": lambda plan, run, **robot: rp.plot.path(run, **robot),
    "plot.condition": lambda plan, run, **robot: rp.plot.condition(run, **robot),
    "plan.table": lambda plan, run, **robot: plan.table(**robot),
    "run.table": lambda plan, run, **robot: run.table(**robot),
    "plan_reference": lambda plan, run, **robot: plan_reference(plan, **robot),
}
CONTROLLERS = {"ComputedTorque": ComputedTorque, "FeedForward": FeedForward}


@pytest.mark.parametrize("kind", KINDS)
def test_what_was_made_in_python_needs_no_files(kind: str, made: Callable[..., Any]) -> None:
    """They advised ``source=``, which none of them takes."""
    _, plan, run = made(kind)
    for name, use in USES.items():
        assert use(plan, run) is not None, name
    for controller in CONTROLLERS.values():
        assert controller(plan).reference.robot is plan.robot.made_of


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
    for controller in CONTROLLERS.values():
        with pytest.raises(PlanFileError, match=r"a controller takes plan_reference\(plan, robot=robot\)"):
            controller(plan)
        assert controller(plan_reference(plan, robot=robot)).reference.robot is robot


@pytest.mark.long_for("masses", "lengths", "limits")
@pytest.mark.parametrize("kind", KINDS)
def test_the_command_line_takes_what_python_writes(
    kind: str, made: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    robot, plan, _ = made(kind)
    plan.save("plan.npz")
    for command in COMMANDS:
        line = refused(*command)
        assert "source=" not in line
        (write,) = parts(line)
        eval(write, {"robot": robot})
        (flag,) = re.findall(r"--robot machine\.yaml", line)
        done = call(*command, *flag.split())
        assert done.exit_code in (0, 3, 4), done.stderr


COMMANDS = (
    ("show", "--plan", "plan.npz", "--html", "page.html"),
    ("check", "plan.npz"),
    ("export", "plan.npz", "--to", "plan.csv"),
    ("simulate", "--plan", "plan.npz", "--duration", "0.02", "--stop-at", "never"),
)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
def test_a_plan_outside_its_robots_folder(
    command: tuple[str, ...], own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All four said ``source=``; the flag that they take comes with the path that it needs."""
    monkeypatch.chdir(tmp_path)
    planned = call("plan", "stepwise", "--robot", own, "--trajectory", "corner", "--step", "0.2", "--lam", "0",
                   "--out", "plan.npz")  # fmt: skip
    assert planned.exit_code in (0, 3), planned.stderr
    line = refused(*command)
    assert "source=" not in line
    (flag,) = re.findall(r"--robot \S+robot\.yaml(?=\.)", line)
    assert call(*command, *flag.split()).exit_code in (0, 3)
    plan = rp.load_plan("plan.npz")
    with pytest.raises(PlanFileError) as caught:
        rp.show(plan)
    names: dict[str, Any] = {"rp": rp, "plan": plan}
    load, show, *_ = parts(caught.value.remedy)
    exec(load, names)
    assert eval(show, names).scene.title


def test_a_robot_that_moved(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(own.parent, tmp_path / "here")
    plan = rp.plan_stepwise(rp.RneaDynamics(rp.load_robot("here")), CORNER, lam=0.0, dt=0.2)
    plan.save("plan.npz")
    (tmp_path / "here").rename(tmp_path / "there")
    for command in COMMANDS:
        line = refused(*command)
        assert line.endswith("Name its robot.yaml where it is now: --robot robot.yaml.")
        assert call(*command, "--robot", "there/robot.yaml").exit_code in (0, 3)
    monkeypatch.chdir(tmp_path / "there")
    plan = rp.load_plan("../plan.npz")
    with pytest.raises(PlanFileError) as caught:
        rp.show(plan)
    names: dict[str, Any] = {"rp": rp, "plan": plan}
    load, show, *_ = parts(caught.value.remedy)
    exec(load, names)
    assert eval(show, names).scene.title
