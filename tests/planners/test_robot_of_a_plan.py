"""Which robot a saved plan may load: a shipped one, one in its own folder, or what its user names; nothing else."""

from __future__ import annotations

import inspect
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command_line import call, refused

import redundancy_pin as rp
from redundancy_pin.errors import PlanFileError
from redundancy_pin.planners.plan import Plan, load_plan, load_robot_of
from redundancy_pin.robot.shipped import models_root


@pytest.fixture(scope="module")
def shipped_plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    path = tmp_path_factory.mktemp("saved") / "plan.npz"
    circle = rp.trajectory.reference.circle(speed=0.5)
    rp.plan_switch_off(rp.VirtualWork(rp.load_robot("2rpr")), circle, threshold=7.0, mesh=rp.Mesh(dt=0.01)).save(path)
    return load_plan(path)


def copy_of(folder: Path) -> Path:
    """Put the robot of the plan into a folder, and return its declaration."""
    shutil.copytree(models_root() / "2rpr", folder)
    return folder / "robot.yaml"


def saved(plan: Plan, path: Path, source: object) -> Plan:
    """Return a plan that was loaded from a file which names its robot so."""
    path.parent.mkdir(exist_ok=True, parents=True)
    replace(plan, robot=replace(plan.robot, source=str(source), folder=None)).save(path)
    return load_plan(path)


def stored_source(path: Path) -> str:
    with np.load(path) as arrays:
        return str(json.loads(str(arrays["metadata"]))["record"]["robot"]["source"])


def outside(plan: Plan) -> str:
    with pytest.raises(PlanFileError, match="outside its own folder") as caught:
        load_robot_of(plan)
    assert "robot = rp.load_robot_of(plan, " in caught.value.remedy
    assert "robot=robot" in caught.value.remedy
    return str(caught.value)


def test_a_robot_made_in_python_is_passed() -> None:
    """The message named ``source=`` and a robot.yaml that there is not, and ``rp.show`` has no such argument."""
    plain = rp.load_robot("3rrr")
    robot = rp.robot_from_model(
        plain.model, closures=plain.closures, actuated=plain.actuated, carriers=plain.carriers,
        independent=plain.platform, reference=np.array(plain.q_reference),
    )  # fmt: skip
    plan = rp.plan_stepwise(rp.RneaDynamics(robot), rp.trajectory.reference.corner(radius=0.025), mesh=rp.Mesh(dt=0.1))
    with pytest.raises(PlanFileError, match=r"made in Python. .*show\(plan, robot=robot\)"):
        load_robot_of(plan)


def test_a_robot_in_the_plans_folder_goes_with_it(shipped_plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "work" / "plan.npz"
    robot = copy_of(tmp_path / "work" / "robots" / "mine")
    loaded = saved(shipped_plan, path, robot)
    assert stored_source(path) == "robots/mine/robot.yaml"
    assert load_robot_of(loaded).source == str(robot)
    (tmp_path / "work").rename(tmp_path / "moved")
    moved = load_plan(tmp_path / "moved" / "plan.npz")
    assert load_robot_of(moved).source == str(tmp_path / "moved" / "robots" / "mine" / "robot.yaml")


def test_a_folder_in_the_plans_folder_names_its_robot(shipped_plan: Plan, tmp_path: Path) -> None:
    robot = copy_of(tmp_path / "mine")
    assert load_robot_of(saved(shipped_plan, tmp_path / "plan.npz", "mine")).source == str(robot)


def test_a_robot_elsewhere_is_named_by_the_user(shipped_plan: Plan, tmp_path: Path) -> None:
    robot = copy_of(tmp_path / "robots")
    loaded = saved(shipped_plan, tmp_path / "plans" / "plan.npz", robot)
    assert stored_source(tmp_path / "plans" / "plan.npz") == str(robot)
    assert str(robot) in outside(loaded)
    assert load_robot_of(loaded, robot).name == "2rpr"


def test_a_plan_that_was_just_made_needs_no_file(shipped_plan: Plan, tmp_path: Path) -> None:
    robot = rp.load_robot(copy_of(tmp_path / "robots"))
    made = replace(shipped_plan, robot=replace(shipped_plan.robot, source=robot.source, folder=None))
    assert load_robot_of(made).source == robot.source


def test_a_plan_saved_again_elsewhere_still_tells_where_its_robot_was(shipped_plan: Plan, tmp_path: Path) -> None:
    robot = copy_of(tmp_path / "a" / "robot")
    loaded = saved(shipped_plan, tmp_path / "a" / "plan.npz", robot)
    (tmp_path / "b").mkdir()
    loaded.save(tmp_path / "b" / "plan.npz")
    assert str(robot) in outside(load_plan(tmp_path / "b" / "plan.npz"))
    loaded.save(tmp_path / "plan.npz")
    assert load_robot_of(load_plan(tmp_path / "plan.npz")).source == str(robot)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"source": ""}, "robot=robot"),
        ({"arguments": {"base_width": 0.5}}, "no argument 'base_width'"),
        ({"carriers": ("carrier_1", "load")}, r"carriers were .*'load'"),
        ({"bodies": 1e-6}, "mass properties differ by 1e-06"),
        ({"q_reference": 1e-3}, "reference configuration"),
    ],
)
def test_a_robot_that_has_changed_is_refused(change: dict[str, Any], says: str, shipped_plan: Plan) -> None:
    ((field, value),) = change.items()
    record = shipped_plan.robot
    if field == "bodies":
        heavier = tuple(number * (1.0 + value * (i == 0)) for i, number in enumerate(record.bodies[1]))
        value = (record.bodies[0], heavier, *record.bodies[2:])
    if field == "q_reference":
        value = tuple(q + value for q in record.q_reference)
    with pytest.raises(PlanFileError, match=says):
        load_robot_of(replace(shipped_plan, robot=replace(record, **{field: value})))


def test_old_plans_with_an_absolute_path_in_their_folder(shipped_plan: Plan, tmp_path: Path) -> None:
    robot = copy_of(tmp_path / "robot")
    (tmp_path / "other").mkdir()
    saved(shipped_plan, tmp_path / "other" / "plan.npz", robot)
    shutil.move(tmp_path / "other" / "plan.npz", tmp_path / "plan.npz")
    assert load_robot_of(load_plan(tmp_path / "plan.npz")).source == str(robot)


def test_the_name_of_a_shipped_robot_is_never_a_folder(
    shipped_plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "2rpr").mkdir()
    (tmp_path / "2rpr" / "robot.yaml").write_text("- no robot")
    monkeypatch.chdir(tmp_path)
    assert load_robot_of(saved(shipped_plan, tmp_path / "plan.npz", "2rpr")).source == "2rpr"


def _relative(folder: Path) -> str:
    copy_of(folder.parent / "robot")
    return "../robot/robot.yaml"


def _link(folder: Path) -> str:
    (folder / "robot.yaml").symlink_to(copy_of(folder.parent / "robot"))
    return "robot.yaml"


def _linked_folder(folder: Path) -> str:
    (folder / "robot").symlink_to(copy_of(folder.parent / "robot").parent)
    return "robot/robot.yaml"


def _linked_urdf(folder: Path) -> str:
    robot = copy_of(folder / "robot")
    urdf = folder / "robot" / "2rpr.urdf.xacro"
    urdf.rename(folder.parent / "away.xacro")
    urdf.symlink_to(folder.parent / "away.xacro")
    return str(robot)


def _urdf(name: str) -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        robot = copy_of(folder / "robot")
        data = yaml.safe_load(robot.read_text())
        shutil.copy(folder / "robot" / data["urdf"], folder.parent / "away.xacro")
        robot.write_text(yaml.safe_dump({**data, "urdf": name.format(folder=folder.parent)}))
        return "robot/robot.yaml"

    return make


def _folder(make: Callable[[Path], str], name: str) -> Callable[[Path], str]:
    """Return what names the folder of a robot, where ``make`` names its declaration."""

    def named(folder: Path) -> str:
        make(folder)
        return name

    return named


def _link_in_a_folder(folder: Path) -> str:
    (folder / "robot").mkdir()
    (folder / "robot" / "robot.yaml").symlink_to(copy_of(folder.parent / "robot"))
    return "robot"


@pytest.mark.parametrize(
    "make",
    [
        _folder(_urdf("../../away.xacro"), "robot"),
        _folder(_link, "."),
        _link_in_a_folder,
        _relative,
        _link,
        _linked_folder,
        _linked_urdf,
        _urdf("../../away.xacro"),
        _urdf("{folder}/away.xacro"),
        lambda folder: "/etc/passwd",
        lambda folder: "../" * 40 + "etc/passwd",
        lambda folder: "nul\x00",
    ],
)
def test_no_path_leads_out_of_the_folder(make: Callable[[Path], str], shipped_plan: Plan, tmp_path: Path) -> None:
    folder = tmp_path / "plans"
    folder.mkdir()
    outside(saved(shipped_plan, folder / "plan.npz", make(folder)))


@pytest.mark.parametrize("source", ["", "nowhere/robot.yaml", "plan.npz", ".", "x" * 300, "~/robot.yaml"])
def test_sources_that_are_no_robot(source: str, shipped_plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(PlanFileError, match="robot=robot"):
        load_robot_of(saved(shipped_plan, tmp_path / "plan.npz", source))


def test_a_pipe_beside_the_plan(shipped_plan: Plan, tmp_path: Path) -> None:

    os.mkfifo(tmp_path / "robot.yaml")
    with pytest.raises(PlanFileError, match="There is no file"):
        load_robot_of(saved(shipped_plan, tmp_path / "plan.npz", "robot.yaml"))


def test_show_takes_the_robot_of_a_stranger_only_where_it_is_named(shipped_plan: Plan, tmp_path: Path) -> None:
    robot = copy_of(tmp_path / "robots")
    path, page = tmp_path / "plans" / "plan.npz", tmp_path / "page.html"
    saved(shipped_plan, path, robot)
    assert "--robot" in refused("show", "--plan", path, "--html", page)
    assert not page.exists()
    call("show", "--plan", path, "--robot", robot, "--html", page)
    assert page.exists()


# ---------------------------------------------------------------------------------------- what a record may hold

WRONG: dict[str, list[Any]] = {
    "name": [None, ["x"]],
    "source": [3, {"$float": "nan"}],
    "arguments": ["carriers", {"carriers": [1]}, {"$mapping": [[3, 1.0]]}, {"trust": True}, {"source": "3rrr"}],
    "gravity": [9.81, {"$tuple": [0, 0]}, {"$tuple": [0, 0, {"$float": "nan"}]}],
    "working_mode": [1, {"$tuple": [2, 1]}, {"$tuple": [True]}],
    "actuated": ["slide_1", {"$tuple": [1]}],
    "carriers": [None, {"$tuple": [{}]}],
    "rotating": [True, {"$tuple": [[]]}],
    "carrier_limits": [1, {"$tuple": [{"lower": "x"}]}],
    "bodies": [
        {"$array": "tau"},
        {"$tuple": [{"$tuple": [1.0] * 9}]},
        {"$tuple": [{"$tuple": ["x"] * 10}]},
        {"$tuple": [{"$tuple": [{"$float": "inf"}] * 10}]},
    ],
    "q_reference": [0.0, {"$tuple": [[0.0]]}, {"$tuple": [10**200]}],
    "couplings": [1, {"$tuple": [{"name": "gears", "joint": "a", "of": "b", "polynomial": 1}]}],
    "ranges": ["x", {"$tuple": [{"$tuple": ["a", 1.0]}]}, {"$tuple": [{"$tuple": ["a", "b", 1.0]}]}],
}
_ALL_WRONG = [(field, value) for field, values in WRONG.items() for value in values]


@pytest.mark.parametrize(("field", "value"), _ALL_WRONG)
def test_records_of_the_wrong_form(field: str, value: Any, shipped_plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    shipped_plan.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    content = json.loads(str(arrays.pop("metadata")))
    content["record"]["robot"][field] = value
    np.savez(path, metadata=np.array(json.dumps(content)), **arrays)
    with pytest.raises(PlanFileError) as caught:
        load_robot_of(load_plan(path))
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", inspect.signature(rp.load_robot).parameters)
def test_no_argument_of_a_plan_is_one_of_load_robot(name: str, shipped_plan: Plan, tmp_path: Path) -> None:
    """What ``load_robot`` is told by its user alone (a source, gravity, a mode, trust) comes from no file."""
    robot = replace(shipped_plan.robot, arguments={**shipped_plan.robot.arguments, name: True})
    replace(shipped_plan, robot=robot).save(tmp_path / "plan.npz")
    with pytest.raises(PlanFileError, match=f"no argument '{name}'"):
        load_robot_of(load_plan(tmp_path / "plan.npz"))


def test_text_is_no_number(shipped_plan: Plan, tmp_path: Path) -> None:
    """Nothing is converted: a file that says "1.0" was not written by this package."""
    path = tmp_path / "plan.npz"
    shipped_plan.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    content = json.loads(str(arrays.pop("metadata")))
    gravity = content["record"]["robot"]["gravity"]
    content["record"]["robot"]["gravity"] = {key: [str(each) for each in values] for key, values in gravity.items()}
    np.savez(path, metadata=np.array(json.dumps(content)), **arrays)
    with pytest.raises(PlanFileError, match="gravity"):
        load_plan(path)
