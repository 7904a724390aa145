"""Loads that files state: friction of a URDF, and what a robot.yaml declares."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.robot import JointForces, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.shipped import declaration_path

DECLARED = """
joint_forces:
  - {joint: crank, damping: 0.2, friction: 0.1, friction_speed: 0.05, rotor_inertia: "1.0e-4 * 2", gear: -20}
springs:
  - {frames: [base, coupler_link], stiffness: 200, damping: 5, length: 0.1, points: [[0.1, 0, 0], [0, 0, 0]]}
payloads:
  - {frame: coupler_link, mass: 0.5, centre: [0.1, 0, 0], inertia: [0, 0.001, 0.001]}
wrenches:
  - {frame: coupler_link, force: [0, -5, 0], moment: [0, 0, 1], reference: local, point: [0.1, 0, 0]}
"""


def four_bar(folder: Path, dynamics: str = "", declared: str = "") -> Path:
    """Write the shipped four-bar with ``<dynamics>`` in its three joints, and more in its robot.yaml."""
    source = declaration_path("four_bar")
    text = (source.parent / "four_bar.urdf.xacro").read_text(encoding="utf-8")
    start = text.index('<joint name="${name}" type="revolute">')
    end = text.index("</joint>", start)
    text = text[:end] + dynamics + text[end:]
    (folder / "four_bar.urdf.xacro").write_text(text, encoding="utf-8")
    path = folder / "robot.yaml"
    path.write_text(source.read_text(encoding="utf-8") + declared, encoding="utf-8")
    return path


def torque(robot: Robot) -> np.ndarray:
    motion = zoo.smooth_motion(zoo.robot_of("four_bar"), 13).at(np.linspace(0.1, 1.0, 8))
    return rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau


def test_friction_of_a_urdf_is_in_force(tmp_path: Path) -> None:
    """The power of the motor grows by what friction takes, from rates of the tree."""
    robot = rp.load_robot(four_bar(tmp_path, '<dynamics damping="0.3" friction="0.2"/>'))
    assert set(robot.loads) == {JointForces(joint, 0.3, 0.2) for joint in ("crank", "rocker", "coupler")}
    frictionless = zoo.robot_of("four_bar")
    motion = zoo.smooth_motion(frictionless, 13).at(np.linspace(0.1, 1.0, 8))
    tree = rp.inverse_kinematics(frictionless, motion)
    columns = [
        frictionless.model.joints[frictionless.model.getJointId(name)].idx_v for name in ("crank", "rocker", "coupler")
    ]
    v = tree.v[:, columns]
    taken = (v * (0.3 * v + 0.2 * np.tanh(v / 0.01))).sum(axis=1)
    rate = v[:, 0]
    np.testing.assert_allclose((torque(robot) - torque(frictionless))[:, 0] * rate, taken, rtol=1e-10)


def test_a_declaration_leaves_friction_of_the_urdf_out_or_replaces_it(tmp_path: Path) -> None:
    tag = '<dynamics damping="0.3"/>'
    off = rp.load_robot(four_bar(tmp_path, tag, "\nurdf_dynamics: false\n"))
    assert off.loads == ()
    assert "not in force" in off.notes[0]
    own = rp.load_robot(four_bar(tmp_path, tag, "\njoint_forces: [{joint: crank, damping: 0.1}]\n"))
    assert set(own.loads) == {JointForces("crank", 0.1), JointForces("rocker", 0.3), JointForces("coupler", 0.3)}


def test_declared_loads_are_those_of_python(tmp_path: Path) -> None:
    robot = rp.load_robot(four_bar(tmp_path, declared=DECLARED))
    same = zoo.robot_of("four_bar").loaded(
        JointForces("crank", 0.2, 0.1, 0.05, rotor_inertia=2e-4, gear=-20.0),
        Spring("base", "coupler_link", 200.0, 5.0, 0.1, (0.1, 0.0, 0.0)),
        Payload("coupler_link", 0.5, (0.1, 0.0, 0.0), np.diag([0.0, 0.001, 0.001])),
        Wrench("coupler_link", (0.0, -5.0, 0.0, 0.0, 0.0, 1.0), "local", (0.1, 0.0, 0.0)),
    )
    assert list(map(repr, robot.loads)) == list(map(repr, same.loads))
    np.testing.assert_allclose(torque(robot), torque(same), rtol=1e-12)
    assert np.abs(torque(same) - torque(zoo.robot_of("four_bar"))).min() > 1e-3


def test_friction_that_follows_a_parameter_is_differentiated_unless_the_robot_was_given_other_loads(
    tmp_path: Path,
) -> None:
    path = four_bar(tmp_path, declared="\njoint_forces: [{joint: crank, damping: crank_length}]\n")
    robot, t = rp.load_robot(path), np.linspace(0.0, 1.0, 5)
    length = float(robot.parameters["crank_length"])
    motion = rp.PlatformMotion(t, robot.q_reference[0] + 0.1 * t[:, None], np.full((5, 1), 0.1), np.zeros((5, 1)))

    def force(change: float) -> np.ndarray:
        return rp.RneaDynamics(rp.load_robot(path, crank_length=length + change)).reduce(motion).f

    got = rp.CompiledDynamics(robot).along(motion).derivatives(parameters=["crank_length"]).f.parameters[:, :, 0]
    np.testing.assert_allclose(got, (force(1e-6) - force(-1e-6)) / 2e-6, rtol=1e-7, atol=1e-7)
    loaded = robot.loaded(rp.JointForces("rocker", damping=1.0))
    with pytest.raises(UnsupportedRobotError, match="other loads"):
        rp.CompiledDynamics(loaded).along(motion).derivatives(parameters=["crank_length"])
