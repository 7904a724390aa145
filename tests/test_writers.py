"""Robots written for other programs: MuJoCo runs its file with this package's efforts; URDFs give the same again."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from mjcf_models import FOUR_BAR, GEARED, RSSR, SPATIAL, write
from zoo import home_of, robot_of

import redundancy_pin as rp
from redundancy_pin.errors import InputError, OutputError, UnsupportedRobotError
from redundancy_pin.robot import Robot
from redundancy_pin.robot.loads import JointForces, Payload, Spring

MOTION_TOLERANCE = 1e-5
"""m and rad: what is asked of outside engines, without control over the whole motion."""

STEP, DURATION = 5e-4, 0.4


def efforts_of(robot: Robot, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the efforts (N, m + k) of a motion from rest, carriers parked, and its configurations (N, nq)."""
    home = home_of(robot)
    swing = 0.05 * robot.characteristic_length / np.arange(1, robot.n + 1)
    wave, rate, second = (
        1.0 - np.cos(8.0 * t), 8.0 * np.sin(8.0 * t), 64.0 * np.cos(8.0 * t)
    )  # fmt: skip
    motion = rp.PlatformMotion(t, home + np.outer(wave, swing), np.outer(rate, swing), np.outer(second, swing))
    reduced = rp.RneaDynamics(robot).reduce(motion)
    return np.concatenate([rp.distribute(reduced).tau, reduced.carrier_force], axis=1), rp.inverse_kinematics(
        robot, motion
    ).q


def elbow_of(robot: Robot) -> str:
    """Return a joint behind another one."""
    return next(str(name) for name in list(robot.model.names)[1:] if str(name) not in robot.actuated)


def run(robot: Robot, path: Path) -> float:
    """Return how far MuJoCo's motion is from the planned one at the end, under efforts held over each step."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(robot.to_mjcf(path, step=STEP)))
    data = mujoco.MjData(model)
    t = np.linspace(0.0, DURATION, int(DURATION / STEP) + 1)
    middle, _ = efforts_of(robot, t[:-1] + 0.5 * STEP)
    _, q = efforts_of(robot, t)
    at = [int(model.joint(str(name)).qposadr[0]) for name in list(robot.model.names)[1:]]
    mujoco.mj_resetDataKeyframe(model, data, 0)
    np.testing.assert_allclose(data.qpos[at], q[0], atol=1e-9)
    worst = 0.0
    for k, effort in enumerate(middle):
        data.ctrl[:] = effort
        mujoco.mj_step(model, data)
        worst = max(worst, float(np.abs(data.qpos[at] - q[k + 1]).max()))
    assert np.abs(q[-1] - q[0]).max() > 0.01
    return worst


@pytest.mark.parametrize("name", ["five_bar", "3rrr"])
def test_mujoco_makes_the_planned_motion(name: str, tmp_path: Path) -> None:
    assert run(robot_of(name), tmp_path / "robot.xml") < MOTION_TOLERANCE


def test_mujoco_has_the_rotors_and_the_springs_of_joints(tmp_path: Path) -> None:
    """Several loads on a joint add up; what gears reflect is armature where the motors stand still."""
    robot = robot_of("five_bar")
    first, second = robot.actuated
    loads = (
        JointForces(first, 0.1, rotor_inertia=2e-3, gear=-12.0),
        JointForces(first, 0.2, stiffness=3.0, rest=0.4),
        JointForces(first, stiffness=1.0, rest=-0.8),
        JointForces(second, rotor_inertia=1e-3, gear=30.0),
    )
    loaded = robot.loaded(*loads)
    assert run(loaded, tmp_path / "robot.xml") < MOTION_TOLERANCE
    with pytest.raises(UnsupportedRobotError, match="reflected=True"):
        loaded.loaded(JointForces(elbow_of(robot), rotor_inertia=1e-3)).to_mjcf(tmp_path / "robot.xml")


@pytest.mark.engines
@pytest.mark.parametrize("name", ["four_bar", "2rpr", "geared"])
def test_mujoco_makes_the_planned_motion_of_others(name: str, tmp_path: Path) -> None:
    """With damping, armature and couplings, too."""
    if name == "geared":
        robot = rp.load_robot(write(tmp_path, GEARED))
    else:
        masses = {"cylinder_mass": 0.3, "piston_mass": 0.2, "end_effector_mass": 0.5} if name == "2rpr" else {}
        robot = robot_of(name, **masses)
    assert run(robot, tmp_path / "robot.xml") < MOTION_TOLERANCE


def test_what_is_written_as_mjcf_is_read_as_the_same_robot(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    robot = rp.load_robot(write(tmp_path, GEARED))
    again = rp.load_robot(robot.to_mjcf(tmp_path / "again.xml"), keyframe="reference")
    np.testing.assert_allclose(again.q_reference, robot.q_reference, atol=1e-9)
    assert again.loads == robot.loads
    assert [each.polynomial for each in again.couplings] == [
        pytest.approx((*each.polynomial, *(0.0,) * (5 - len(each.polynomial)))[: len(each.polynomial)])
        for each in robot.couplings
    ]
    assert_same_forces(robot, again)


@pytest.mark.parametrize(
    "text",
    [SPATIAL, SPATIAL.replace(' armature="0.02" damping="0.3"', ""), RSSR],
    ids=["held at the first ball", "held at the second", "of the tree"],
)
def test_held_spins_and_rows_that_were_left_out_are_written(text: str, tmp_path: Path) -> None:
    """MuJoCo has no universal joint, which holds the spin of a rod here, but a spin moves nothing."""
    robot = rp.load_robot(write(tmp_path, text))
    again = rp.load_robot(robot.to_mjcf(tmp_path / "again.xml"), keyframe="reference")
    assert [each.axes for each in again.closures] == [each.axes for each in robot.closures]
    assert_same_forces(robot, again)


def assert_same_forces(robot: rp.Robot, again: rp.Robot) -> None:
    x = home_of(robot)[None]
    motion = rp.PlatformMotion([0.0], x, np.ones_like(x), -np.ones_like(x))
    ours, theirs = (rp.RneaDynamics(each).reduce(motion) for each in (robot, again))
    np.testing.assert_allclose(theirs.f, ours.f, rtol=1e-9, atol=1e-9)


def test_the_keyframe_turns_balls_as_the_reference_does(tmp_path: Path) -> None:
    """The quaternion is w, x, y, z there; their armature and damping are those of the model."""
    mujoco = pytest.importorskip("mujoco")
    robot = dataclasses.replace(rp.load_robot(write(tmp_path, SPATIAL), keyframe="bent"), closures=())
    model = mujoco.MjModel.from_xml_path(str(robot.to_mjcf(tmp_path / "open.xml")))
    dof = int(model.joint("ball").dofadr[0])
    assert model.dof_armature[dof : dof + 3].tolist() == [0.02] * 3
    assert model.dof_damping[dof : dof + 3].tolist() == [0.3] * 3
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    own = robot.model.createData()
    pin.forwardKinematics(robot.model, own, np.array(robot.q_reference))
    for name, place in zip(list(robot.model.names)[1:], list(own.oMi)[1:], strict=True):
        np.testing.assert_allclose(data.body(str(name)).xmat.reshape(3, 3), place.rotation, atol=1e-12)
        np.testing.assert_allclose(data.body(str(name)).xpos, place.translation, atol=1e-12)


@pytest.mark.parametrize("name", ["five_bar", "gough", "geared"])
def test_a_urdf_and_its_declaration_are_the_same_robot(name: str, tmp_path: Path) -> None:
    without_armature = GEARED.replace('<joint armature="0.01"/>', "").replace("-2 3", "-2 2")
    robot = rp.load_robot(write(tmp_path, without_armature)) if name == "geared" else robot_of(name)
    robot = robot.loaded(
        Payload(robot.closures[0].frame_a, 0.4, [0.1, 0.0, 0.2]),
        JointForces(robot.actuated[0], 0.2, rotor_inertia=0.01, gear=-5.0),
    )
    path = robot.to_urdf(tmp_path / "written.urdf")
    again = rp.load_robot(path.with_suffix(".yaml"))
    # Pinocchio numbers the joints of a URDF by their names
    places = [
        {
            str(name): each.q_reference[joint.idx_q]
            for name, joint in zip(each.model.names, each.model.joints, strict=True)
        }
        for each in (robot, again)
    ]
    places = [{name: at for name, at in place.items() if name != "universe"} for place in places]
    assert places[1] == pytest.approx(places[0], abs=1e-9)
    assert (again.actuated, again.carriers, again.working_mode) == (robot.actuated, robot.carriers, robot.working_mode)
    assert again.carrier_limits == robot.carrier_limits
    assert again.couplings == robot.couplings
    if "geared" not in name:
        assert np.isfinite(again.model.lowerPositionLimit).all()
    x = home_of(robot)[None]
    xd = np.random.default_rng(1).normal(size=(1, robot.n))
    motion = rp.PlatformMotion([0.0], x, xd, -2.0 * xd)
    ours, theirs = (rp.RneaDynamics(each).reduce(motion) for each in (robot, again))
    np.testing.assert_allclose(theirs.f, ours.f, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(theirs.W, ours.W, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(theirs.carrier_force, ours.carrier_force, rtol=1e-9, atol=1e-9)


def test_a_urdf_has_what_all_loads_of_a_joint_add_up_to(tmp_path: Path) -> None:
    robot = robot_of("five_bar")
    joint = robot.actuated[0]
    robot = robot.loaded(JointForces(joint, 0.2), JointForces(joint, 0.3, 0.5), JointForces(joint, rotor_inertia=0.01))
    path = robot.to_urdf(tmp_path / "written.urdf")
    dynamics = ElementTree.parse(path).find(f"joint[@name='{joint}']/dynamics")
    assert dynamics is not None
    assert {key: float(value) for key, value in dynamics.attrib.items()} == {"damping": 0.5, "friction": 0.5}
    assert rp.load_robot(path.with_suffix(".yaml")).loads == robot.loads


def test_what_files_do_not_say_is_refused_by_name(tmp_path: Path) -> None:
    robot = robot_of("five_bar")
    frames = robot.closures[0].frame_a, "base"
    springy = robot.loaded(Spring(*frames, 10.0))
    for writer in (springy.to_mjcf, springy.to_urdf):
        with pytest.raises(UnsupportedRobotError, match="Spring"):
            writer(tmp_path / "robot.xml")
    elbow = elbow_of(robot)
    with pytest.raises(UnsupportedRobotError, match="carried by a link that turns about its axis"):
        robot.loaded(JointForces(elbow, rotor_inertia=0.1)).to_mjcf(tmp_path / "robot.xml")
    with pytest.raises(UnsupportedRobotError, match="armature of crank"):
        rp.load_robot(write(tmp_path, GEARED)).to_urdf(tmp_path / "robot.urdf")
    with pytest.raises(InputError, match="step is 0 s"):
        robot.to_mjcf(tmp_path / "robot.xml", step=0.0)
    for step in ("x", None, [1.0], np.nan):
        with pytest.raises(InputError, match="step is"):
            robot.to_mjcf(tmp_path / "robot.xml", step=step)
    for path in (None, 3.0, []):
        for writer in (robot.to_mjcf, robot.to_urdf):
            with pytest.raises(OutputError):
                writer(path)
    with pytest.raises(OutputError):
        robot.to_mjcf(tmp_path / "no" / "robot.xml")
    with pytest.raises(UnsupportedRobotError, match="moves \\(nearly\\) no mass"):
        robot_of("2rpr", end_effector_mass=0.5).to_mjcf(tmp_path / "robot.xml")


@pytest.mark.parametrize("name", ["two\nlines", "bell\x07", "half\ud800"])
@pytest.mark.parametrize("write", [Robot.to_mjcf, Robot.to_urdf])
def test_names_that_no_reader_takes_are_refused(write: Any, name: str, tmp_path: Path) -> None:
    model = pin.Model()
    hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(hinge, pin.Inertia.Random(), pin.SE3.Identity())
    robot = dataclasses.replace(Robot.from_model(model, actuated=["hinge"]), name=name)
    with pytest.raises(InputError, match="control characters"):
        write(robot, tmp_path / "robot.xml")
    assert list(tmp_path.iterdir()) == []


def test_limits_of_effort_are_said_in_mjcf_and_cut_nothing_off(tmp_path: Path) -> None:
    """As here: a plan that breaks them is one that says so, and MuJoCo's motion is its motion still."""
    mujoco = pytest.importorskip("mujoco")
    robot = robot_of("five_bar")
    limits = np.array([[-3.0, 1.0], [3.0, np.inf]])
    columns = robot.actuated_velocity
    for name, values in zip(("lowerEffortLimit", "upperEffortLimit"), limits, strict=True):
        array = np.array(getattr(robot.model, name))
        array[columns] = values
        setattr(robot.model, name, array)
    path = robot.to_mjcf(tmp_path / "robot.xml")
    again = rp.load_robot(path).effort_limits
    np.testing.assert_array_equal(again[:, 0], limits[:, 0])
    assert (again[0, 1], again[1, 1] > 1e9) == (1.0, True)
    model = mujoco.MjModel.from_xml_path(str(path))
    carriers = [[-each.force, each.force] for each in robot.carrier_limits]
    limited = model.actuator_ctrllimited[robot.m :].astype(bool)
    assert limited.tolist() == np.isfinite(carriers).all(axis=1).tolist()
    data = mujoco.MjData(model)
    data.ctrl[0] = 50.0
    mujoco.mj_forward(model, data)
    assert data.actuator_force[0] == 50.0
    with pytest.raises(UnsupportedRobotError, match=r"the same both ways; those of joint .* are 1 to inf"):
        robot.to_urdf(tmp_path / "robot.urdf")


def test_a_closure_that_is_redundant_in_all_rows_is_in_the_urdf_too(tmp_path: Path) -> None:
    """Of two pins in one axis the second holds nothing; the declaration names its frames."""
    text = FOUR_BAR.replace('ctrlrange="-2 3"', "")
    for site in ("tip", "end"):
        place = text.split(f'<site name="{site}" pos="')[1].split('"')[0]
        x = place.split()[0]
        text = text.replace(f'<site name="{site}"', f'<site name="{site}_2" pos="{x} 0 0.1"/><site name="{site}"')
    text = text.replace("</equality>", '<connect name="again" site1="tip_2" site2="end_2"/></equality>')
    robot = rp.load_robot(write(tmp_path, text.replace('<joint armature="0.01"/>', "")))
    assert [each.name for each in robot.all_closures] == ["pin", "again"]
    assert [each.name for each in robot.closures] == ["pin"]
    again = rp.load_robot(robot.to_urdf(tmp_path / "robot.urdf").with_suffix(".yaml"))
    assert again.all_closures == robot.all_closures
    assert_same_forces(robot, again)


def test_joints_without_limits_have_none_in_mjcf(tmp_path: Path) -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "arm")  # its limits are the largest doubles
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.1, 0.0, 0.0]), 0.1 * np.eye(3)), pin.SE3.Identity())
    path = Robot.from_model(model, actuated=["arm"], closures=[]).to_mjcf(tmp_path / "arm.xml")
    assert "range" not in path.read_text()
    limits = rp.load_robot(path).model
    assert (np.abs([limits.lowerPositionLimit, limits.upperPositionLimit]) > 1e300).all()
    # a limit to one side is kept
    model.lowerPositionLimit[0], model.upperPositionLimit[0] = -np.inf, 1.25
    robot = Robot.from_model(model, actuated=["arm"], closures=[])
    robot.to_urdf(tmp_path / "arm.urdf")
    for path in (robot.to_mjcf(tmp_path / "arm.xml"), tmp_path / "arm.yaml"):
        limits = rp.load_robot(path).model
        assert limits.upperPositionLimit[0] == 1.25
        assert limits.lowerPositionLimit[0] < -1e9
