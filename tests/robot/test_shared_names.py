"""A joint and a link may share a name: every shipped robot, each moving link called as the joint that carries it."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from command_line import call
from plan_cases import LINE
from zoo import robot_of

import redundancy_pin as rp
from redundancy_pin.dynamics.reactions import joint_reactions
from redundancy_pin.robot import JointForces, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.lookup import find_link, link_names
from redundancy_pin.robot.urdf import declaration_path, shipped_robots
from redundancy_pin.visualisation.viewer.scene import Scene

ROUNDING = 1e-8
"""Relative: both robots are one machine, but Pinocchio orders joints by the names of links, and Newton's method ends
within 1e-11 of the closed configuration."""

VARIANTS = {
    "2rpr": {"cylinder_mass": 0.4, "piston_mass": 0.3, "end_effector_mass": 0.2},
    **{name: {"carriers": True} for name in ("five_bar", "gough", "delta")},
}
"""Arguments of robots that are tried with others than their own: with carriers, and masses that MuJoCo needs."""


def renamed(robot: Robot, folder: Path) -> tuple[Robot, dict[str, str]]:
    """Return the robot from files in which each moving link has the name of its joint, and the new names."""
    root = ElementTree.fromstring(robot.urdf)
    joints = [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]
    new = {joint.find("child").get("link"): joint.get("name") for joint in joints}
    # a link of another joint may have that name already, as the excavator's `link` of the joint `link` ...
    taken = {link.get("name") for link in root.findall("link")} & set(new.values()) - set(new)
    new |= {name: f"{name}_other" for name in taken}
    for link in root.findall("link"):
        link.set("name", new.get(link.get("name"), link.get("name")))
    for joint in root.findall("joint"):
        for end in (joint.find("parent"), joint.find("child")):
            end.set("link", new.get(end.get("link"), end.get("link")))
    folder.mkdir()
    (folder / "robot.urdf").write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    data = yaml.safe_load(declaration_path(robot.source).read_text(encoding="utf-8"))
    for key in ("requires", "closed_form", "reference", "characteristic_length", "carriers"):
        data.pop(key, None)
    data["urdf"] = "robot.urdf"
    data["characteristic_length"] = robot.characteristic_length
    for closure in data["closures"]:
        closure["frames"] = [new.get(name, name) for name in closure["frames"]]
    if "platform" in data["independent"]:
        platform = data["independent"]["platform"]
        data["independent"]["platform"] = new.get(platform, platform)
    limits = zip(robot.carriers, robot.carrier_limits, strict=True)
    data["carriers"] = [{"joint": name, "acceleration": own.acceleration} for name, own in limits]
    data["reference"] = reference_of(robot)
    (folder / "robot.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    return rp.load_robot(folder), new


def reference_of(robot: Robot) -> dict[str, object]:
    """Return the reference of a declaration that gives the reference configuration of a robot."""
    at = {str(robot.model.names[k]): robot.model.joints[k].idx_q for k in range(1, robot.model.njoints)}
    q = {name: float(robot.q_reference[column]) for name, column in at.items()}
    guess = {name: value for name, value in q.items() if name not in robot.carriers}
    if robot.platform is None:
        return {"joints": {name: q[name] for name in robot.independent_joints}, "guess": guess}
    home = platform_of(robot)
    if robot.platform.is_pose:
        rpy = pin.rpy.matrixToRpy(home[:3, :3]).tolist()
        return {"platform": {"xyz": home[:3, 3].tolist(), "rpy": rpy}, "guess": guess}
    rows = [*home[:3, 3], *pin.rpy.matrixToRpy(home[:3, :3])]
    axes = ("x", "y", "z", "rx", "ry", "rz")
    return {"platform": [float(rows[axes.index(axis)]) for axis in robot.platform.axes], "guess": guess}


def platform_of(robot: Robot) -> np.ndarray:
    """Return (4, 4) the pose of the platform at the reference."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.array(robot.q_reference))
    return data.oMf[robot.model.getFrameId(robot.platform.frame, pin.FrameType.BODY)].homogeneous


def swing(robot: Robot) -> tuple[rp.PlatformMotion, rp.CarrierMotion | None]:
    """Return a small motion about the reference, and one of the carriers."""
    t = np.linspace(0.0, 0.6, 13)
    size = 0.03 * robot.characteristic_length
    bump, rate, second = 1.0 - np.cos(5.0 * t), 5.0 * np.sin(5.0 * t), 25.0 * np.cos(5.0 * t)
    ways = size / np.arange(1, robot.n + 1)
    if robot.platform is not None and robot.platform.is_pose:
        ways = np.where(np.arange(6) < 3, ways, 0.0)
        x = np.repeat(platform_of(robot)[None], len(t), axis=0)
        x[:, :3, 3] += np.outer(bump, ways[:3])
    else:
        x = np.array(reference_rows(robot)) + np.outer(bump, ways)
    motion = rp.PlatformMotion(t, x, np.outer(rate, ways), np.outer(second, ways))
    if not robot.k:
        return motion, None
    waves = 0.1 * size * np.ones(robot.k)
    carriers = (np.outer(each, waves) for each in (bump, rate, second))
    return motion, rp.CarrierMotion(*carriers)


def reference_rows(robot: Robot) -> list[float]:
    reference = reference_of(robot)
    return list(reference["joints"].values()) if "joints" in reference else reference["platform"]


def close(one: np.ndarray, other: np.ndarray) -> None:
    np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=ROUNDING * np.abs(other).max(initial=0.0))


def with_loads(robot: Robot, link: str, end: str) -> Robot:
    """Return the robot with a load of each kind, on the link that has the name of a joint in one of the two."""
    joint = robot.actuated[0]
    return robot.loaded(
        Payload(link, 0.7, (0.02, 0.01, 0.0)),
        Wrench(link, (1.0, 2.0, 3.0, 0.1, 0.2, 0.3), "local"),
        Spring(link, end, stiffness=20.0, damping=1.0, length=0.1),
        JointForces(joint, damping=0.4, rotor_inertia=1e-3, gear=5.0),
    )


@pytest.mark.parametrize("name", shipped_robots())
def test_dynamics_pictures_and_files_stay(name: str, tmp_path: Path) -> None:
    plain = robot_of(name, **VARIANTS.get(name, {}))
    robot, new = renamed(plain, tmp_path / name)
    joint_of = {joint: link for link, joint in new.items()}
    shared = plain.actuated[-1]
    assert {shared} <= set(robot.model.names) & set(link_names(robot.model))
    ends = [closure.frame_b for closure in plain.closures]
    loaded = with_loads(plain, joint_of[shared], ends[0]), with_loads(robot, shared, new.get(ends[0], ends[0]))
    motion, carriers = swing(plain)
    same_dynamics(plain, robot, motion, carriers)
    same_dynamics(*loaded, motion, carriers)

    pictures = [rp.show(each, motion, carriers).scene for each in loaded]
    assert drawn(pictures[1]) == drawn(pictures[0])
    for one, other in zip(pictures[0].arrows, pictures[1].arrows, strict=True):
        assert one.name == other.name
        close(other.length, one.length)

    files = tmp_path / "files"
    files.mkdir()
    mjcf = [
        ElementTree.parse(rp.write_mjcf(each, files / f"{k}.xml")).getroot() for k, each in enumerate((plain, robot))
    ]
    assert numbers_of(mjcf[1]) == numbers_of(mjcf[0])


def drawn(scene: Scene) -> list[tuple[object, ...]]:
    """Return the solids of a scene in an order that no name of a link changes, rounded."""
    rounded = [
        (
            scene.names[s.body],
            s.shape,
            s.role,
            *np.round(s.size, 9).tolist(),
            *np.round(s.placement, 9).ravel().tolist(),
        )
        for s in scene.solids
    ]
    return sorted(rounded)


def numbers_of(root: ElementTree.Element) -> Counter[tuple[str, str, str]]:
    """Return the attributes of all elements that are numbers, rounded, and how often there are such."""
    counted: Counter[tuple[str, str, str]] = Counter()
    for element in root.iter():
        for key, text in element.attrib.items():
            try:
                values = [f"{round(float(part), 12) + 0.0:.6g}" for part in text.split()]  # 1e-32 is zero
            except ValueError:
                continue
            counted[element.tag, key, " ".join(values) if element.tag != "key" else " ".join(sorted(values))] += 1
    return counted


def same_dynamics(one: Robot, other: Robot, motion: rp.PlatformMotion, carriers: rp.CarrierMotion | None) -> None:
    """Check that two robots have the same efforts, wrench on the base, energy and forces in joints."""
    along = [rp.RneaDynamics(each).along(motion) for each in (one, other)]
    reduced = [each.reduce(carriers) for each in along]
    close(reduced[1].W, reduced[0].W)
    close(reduced[1].f, reduced[0].f)
    close(reduced[1].carrier_force, reduced[0].carrier_force)
    close(along[1].base_wrench(carriers), along[0].base_wrench(carriers))
    close(along[1].energy(carriers), along[0].energy(carriers))
    tau = rp.distribute(reduced[0]).tau
    close(rp.distribute(reduced[1]).tau, tau)
    reactions = [joint_reactions(each, tau, carriers) for each in along]
    order = [reactions[1].joints.index(joint) for joint in reactions[0].joints]
    close(reactions[1].joint_wrench[:, order], reactions[0].joint_wrench)


def test_the_command_line_takes_such_a_robot(tmp_path: Path) -> None:
    """Plans, saved files, generated code and the compiled backend; the plan was written, then a traceback followed."""
    plain = robot_of("2rpr")
    robot, _ = renamed(plain, tmp_path / "renamed")
    move = (*LINE[:2], *LINE[4:], "--backend", "rnea", "--json")
    facts = []
    for each in (plain, robot):
        out = tmp_path / f"{len(facts)}.npz"
        facts.append(json.loads(call(*move, "--robot", each.source, "--out", out).stdout))
        call("show", "--plan", out, "--html", out.with_suffix(".html"))
        assert out.with_suffix(".html").exists()
    for key in ("peak_base_force", "peak_base_moment"):
        assert facts[0][key] > 0.01
        assert facts[1][key] == pytest.approx(facts[0][key], rel=ROUNDING)
    code = tmp_path / "code"
    assert call("codegen", "--robot", robot.source, "--prefix", "same", "--out", code).exit_code == 0
    motion, carriers = swing(plain)
    along = rp.CompiledDynamics(robot).along(motion), rp.RneaDynamics(plain).along(motion)
    close(along[0].base_wrench(carriers), along[1].base_wrench(carriers))
    close(along[0].reduce(carriers).f, along[1].reduce(carriers).f)


def test_points_of_a_pinocchio_model_may_be_called_as_joints() -> None:
    """A point of the model that has the name of a joint is the point, as a link of that name would be."""
    plain = robot_of("four_bar")
    model = plain.model
    crank, tip = find_link(model, "crank_tip"), find_link(model, "coupler_tip")
    bare = pin.Model()
    bare.gravity = model.gravity
    for index in range(1, model.njoints):
        place, name = model.jointPlacements[index], model.names[index]
        bare.addJoint(int(model.parents[index]), model.joints[index], place, name)
        bare.addJointFrame(index)
        bare.inertias[index] = model.inertias[index]
    bare.addFrame(pin.Frame("coupler", crank.parentJoint, crank.placement, pin.FrameType.OP_FRAME))
    bare.addFrame(pin.Frame("rocker", tip.parentJoint, tip.placement, pin.FrameType.SENSOR))
    robot = rp.robot_from_model(
        bare,
        actuated=["crank"],
        closures=[("coupler", "rocker", ["x", "y"])],
        independent=["crank"],
        reference=plain.q_reference,
    )
    motion, _ = swing(plain)
    same_dynamics(plain, robot, motion, None)


def test_only_one_module_searches_a_model_by_name() -> None:
    """Elsewhere a search may forget to say whether a joint or a link is meant: whoever needs another adds it there."""
    searches = re.compile(
        r"\.(getFrameId|getBodyId|getJointId|existFrame|existBodyName|existJointName)\(|appendModel\("
    )
    package = Path(rp.__file__).parent
    found = {path.name for path in package.rglob("*.py") if searches.search(path.read_text(encoding="utf-8"))}
    assert found == {"lookup.py"}
