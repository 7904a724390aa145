"""A joint and a link may share a name: every shipped robot, each moving link called as the joint that carries it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from zoo import carriers_at, robot_of, smooth_motion

import redundancy_pin as rp
from redundancy_pin.dynamics.reactions import joint_reactions
from redundancy_pin.robot import JointForces, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.lookup import find_link, link_names
from redundancy_pin.robot.shipped import declaration_path, shipped_robots

ROUNDING = 1e-8
"""Relative: both robots are one machine, but Pinocchio orders joints by the names of links, and Newton's method ends
within 1e-11 of the closed configuration."""

XACRO = "http://www.ros.org/wiki/xacro"
TIMES = np.linspace(0.1, 0.7, 7)


def renamed(robot: Robot, folder: Path) -> tuple[Robot, dict[str, str]]:
    """Return the robot from files in which each moving link has the name of its joint, and the new names."""
    ElementTree.register_namespace("xacro", XACRO)
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
    for name, value in robot.parameters.items():  # of which the declaration's expressions are
        ElementTree.SubElement(root, f"{{{XACRO}}}arg", {"name": name, "default": str(value)})
    (folder / "robot.urdf.xacro").write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    data = yaml.safe_load(declaration_path(robot.source).read_text(encoding="utf-8"))
    data.pop("closed_form", None)
    data["urdf"] = "robot.urdf.xacro"
    for closure in data["closures"]:
        closure["frames"] = [new.get(name, name) for name in closure["frames"]]
    if "platform" in data["independent"]:
        data["independent"]["platform"] = new.get(data["independent"]["platform"], data["independent"]["platform"])
    (folder / "robot.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    return rp.load_robot(folder), new


def with_loads(robot: Robot, link: str, end: str) -> Robot:
    """Return the robot with a load of each kind, on the link that has the name of a joint in one of the two."""
    return robot.loaded(
        Payload(link, 0.7, (0.02, 0.01, 0.0)),
        Wrench(link, (1.0, 2.0, 3.0, 0.1, 0.2, 0.3), "local"),
        Spring(link, end, stiffness=20.0, damping=1.0, length=0.1),
        JointForces(robot.actuated[0], damping=0.4, rotor_inertia=1e-3, gear=5.0),
    )


def same_dynamics(one: Robot, other: Robot) -> None:
    """Check that two robots have the same efforts, wrench on the base, energy and forces in joints."""
    motion, carriers = smooth_motion(one, 13, scale=0.3).at(TIMES), carriers_at(one, TIMES)
    found = []
    for dynamics in (rp.RneaDynamics(robot).along(motion) for robot in (one, other)):
        reduced = dynamics.reduce(carriers)
        reactions = joint_reactions(dynamics, rp.distribute(reduced).tau, carriers)
        order = [reactions.joints.index(joint) for joint in sorted(reactions.joints)]
        values = [reduced.W, reduced.f, reduced.carrier_force, dynamics.base_wrench(carriers)]
        found.append([*values, dynamics.energy(carriers), reactions.joint_wrench[:, order]])
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=ROUNDING, atol=ROUNDING * np.abs(theirs).max(initial=0.0))


@pytest.mark.long_for("gough", "two_arms", "ankle", "walking_leg")
@pytest.mark.parametrize("name", shipped_robots())
def test_dynamics_stay(name: str, tmp_path: Path) -> None:
    plain = robot_of(name)
    robot, new = renamed(plain, tmp_path)
    shared = plain.actuated[-1]
    assert {shared} <= set(robot.model.names) & set(link_names(robot.model))
    link = next(link for link, joint in new.items() if joint == shared)
    end = plain.closures[0].frame_b
    same_dynamics(with_loads(plain, link, end), with_loads(robot, shared, new.get(end, end)))
    if name == "2rpr":  # names reach generated code as well
        along = [
            dynamics.along(smooth_motion(plain, 13).at(TIMES))
            for dynamics in (rp.CompiledDynamics(robot), rp.RneaDynamics(plain))
        ]
        np.testing.assert_allclose(along[0].reduce().f, along[1].reduce().f, rtol=ROUNDING)


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
    loop = ("coupler", "rocker", ["x", "y"])
    given = {"actuated": ["crank"], "closures": [loop], "independent": ["crank"], "reference": plain.q_reference}
    same_dynamics(plain, rp.robot_from_model(bare, **given))


def test_only_one_module_searches_a_model_by_name() -> None:
    """Elsewhere a search may forget to say whether a joint or a link is meant: whoever needs another adds it there."""
    searches = re.compile(
        r"\.(getFrameId|getBodyId|getJointId|existFrame|existBodyName|existJointName)\(|appendModel\("
    )
    package = Path(rp.__file__).parent
    found = {path.name for path in package.rglob("*.py") if searches.search(path.read_text(encoding="utf-8"))}
    assert found == {"lookup.py"}
