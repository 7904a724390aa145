"""Robots written as MJCF: MuJoCo has this package's efforts, runs the planned motion, and files give the same again."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from mjcf_models import GEARED, RSSR, SPATIAL, Engine, write
from spatial_chains import chain_of
from zoo import home_of, robot_of, shipped_robots

import redundancy_pin as rp
from redundancy_pin.errors import InputError, OutputError, UnsupportedRobotError
from redundancy_pin.robot import Coupling, Robot
from redundancy_pin.robot.formats.mjcf import read_mjcf
from redundancy_pin.robot.loads import JointForces, Spring

mujoco = pytest.importorskip("mujoco")

MOTION_TOLERANCE = 1e-5
"""m and rad: what is asked of outside engines, without control over the whole motion."""

STEP, DURATION = 5e-4, 0.2
MASSES = {"2rpr": {"cylinder_mass": 0.3, "piston_mass": 0.2, "end_effector_mass": 0.5}}
"""Arguments of robots that move links without mass otherwise."""


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
    model = mujoco.MjModel.from_xml_path(str(rp.write_mjcf(robot, path, step=STEP)))
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
        rp.write_mjcf(loaded.loaded(JointForces(elbow_of(robot), rotor_inertia=1e-3)), tmp_path / "robot.xml")


@pytest.mark.engines
@pytest.mark.parametrize("name", ["four_bar", "2rpr", "geared"])
def test_mujoco_makes_the_planned_motion_of_others(name: str, tmp_path: Path) -> None:
    """With damping, armature and couplings, too."""
    assert run(written(name, tmp_path), tmp_path / "robot.xml") < MOTION_TOLERANCE


def written(name: str, folder: Path) -> Robot:
    """Return a shipped robot, or one of a model of MuJoCo."""
    texts = {
        "geared": GEARED,
        "spatial": SPATIAL,
        "rssr": RSSR,
        "undamped": SPATIAL.replace(' armature="0.02" damping="0.3"', ""),
    }
    if name == "rod":
        return chain_of("rod")
    return rp.load_robot(write(folder, texts[name])) if name in texts else robot_of(name, **MASSES.get(name, {}))


@pytest.mark.parametrize("name", [*shipped_robots(), "geared", "spatial", "rssr", "undamped", "rod"])
def test_efforts_of_a_written_robot_are_mujocos_and_those_of_the_robot_that_is_read_again(
    name: str, tmp_path: Path
) -> None:
    """At random accelerations and rates: M a + h of MuJoCo less what its equalities can do, and this package's RNEA."""
    robot = written(name, tmp_path)
    path = rp.write_mjcf(robot, tmp_path / "again.xml")
    rng = np.random.default_rng(1)
    x, rates = home_of(robot)[None], rng.normal(size=(2, 1, robot.n))
    motion = rp.PlatformMotion([0.0], x, *rates)
    reduced, followed = rp.RneaDynamics(robot).reduce(motion), rp.inverse_kinematics(robot, motion)
    ours = np.concatenate([rp.distribute(reduced).tau, reduced.carrier_force], axis=1)[0]
    q, v, a = followed.q[0], followed.v[0], followed.a[0]
    # of two arms on one object the motion tells only what their efforts do together
    together = np.eye(robot.m + robot.k)
    if robot.m > robot.n:
        together = reduced.W[0]
    size = float(np.abs(ours).max())
    engine = Engine(path)
    engine.set(robot, q, v)
    spins = [row.startswith("rz") and "ball" in robot.model.names for row in robot.constraint_names]
    held = rp.kinematics.closure.ConstraintSystem(robot).evaluate(q[None]).Jc[0, spins]
    expected = engine.torque(robot, a, held)
    np.testing.assert_allclose(together @ expected, together @ ours, rtol=1e-9, atol=1e-9 * size)

    again = rp.load_robot(path, keyframe="reference")
    np.testing.assert_allclose(again.q_reference, robot.q_reference, atol=1e-9)
    assert again.loads == robot.loads
    assert [each.axes for each in again.closures] == [each.axes for each in robot.closures]
    lengths = [[each.length for each in one.closures] for one in (again, robot)]
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-12)
    assert [each.polynomial for each in again.couplings] == [each.polynomial for each in robot.couplings]
    joints = [(robot.model.joints[robot.model.getJointId(name)]) for name in again.independent_joints]
    at = [joint.idx_q for joint in joints], [joint.idx_v for joint in joints]
    same = rp.PlatformMotion([0.0], q[None, at[0]], v[None, at[1]], a[None, at[1]])
    np.testing.assert_allclose(rp.inverse_kinematics(again, same).v[0], v, rtol=1e-9, atol=1e-9 * np.abs(v).max())
    theirs = dict(zip(again.actuated, rp.distribute(rp.RneaDynamics(again).reduce(same)).tau[0], strict=True))
    read = np.array([theirs[name] for name in (*robot.actuated, *robot.carriers)])
    np.testing.assert_allclose(together @ read, together @ ours, rtol=1e-9, atol=1e-9 * size)


def test_couplings_of_several_joints_are_tendons(tmp_path: Path) -> None:
    """Where they are met, MuJoCo's errors are zero; they are read again as they were."""
    robot = written("geared", tmp_path)
    also = Coupling("train", "rotor", "rocker", (0.2, -12.0, 0.3), (("cam", 4.0), ("crank", 0.7)))
    lever = Coupling("lever", "cam", "crank", (0.1, 0.5), (("rocker", -0.2),))
    robot = dataclasses.replace(robot, closures=(), couplings=(also, lever))
    path = rp.write_mjcf(robot, tmp_path / "again.xml")
    engine = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(engine)
    place = {name: float(data.joint(name).qpos[0]) for name in ("crank", "elbow", "rocker")}
    place["crank"], place["rocker"] = 0.3, -0.4
    place["cam"] = 0.1 + 0.5 * place["crank"] - 0.2 * place["rocker"]
    turned = place["rocker"]
    place["rotor"] = 0.2 - 12.0 * turned + 0.3 * turned**2 + 4.0 * place["cam"] + 0.7 * place["crank"]
    for name, value in place.items():
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(engine, data)
    errors = {engine.equality(int(number)).name: error for number, error in zip(data.efc_id, data.efc_pos, strict=True)}
    assert errors["train"] == pytest.approx(0.0, abs=1e-12)
    assert errors["lever"] == pytest.approx(0.0, abs=1e-12)
    again = next(each for each in read_mjcf(path).couplings if each.name == "lever")
    assert (again.joint, again.of, again.polynomial, again.also) == ("cam", "rocker", (0.1, -0.2), (("crank", 0.5),))


def test_the_keyframe_turns_balls_as_the_reference_does(tmp_path: Path) -> None:
    """The quaternion is w, x, y, z there; their armature and damping are those of the model."""
    robot = dataclasses.replace(rp.load_robot(write(tmp_path, SPATIAL), keyframe="bent"), closures=())
    model = mujoco.MjModel.from_xml_path(str(rp.write_mjcf(robot, tmp_path / "open.xml")))
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


def test_what_mjcf_does_not_say_is_refused_by_name(tmp_path: Path) -> None:
    robot, path = robot_of("five_bar"), tmp_path / "robot.xml"
    with pytest.raises(UnsupportedRobotError, match="Spring"):
        rp.write_mjcf(robot.loaded(Spring(robot.closures[0].frame_a, "base", 10.0)), path)
    with pytest.raises(UnsupportedRobotError, match="carried by a link that turns about its axis"):
        rp.write_mjcf(robot.loaded(JointForces(elbow_of(robot), rotor_inertia=0.1)), path)
    with pytest.raises(UnsupportedRobotError, match="moves \\(nearly\\) no mass"):
        rp.write_mjcf(robot_of("2rpr", end_effector_mass=0.5), path)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "speck")
    model.appendBodyToJoint(joint, pin.Inertia(1e-10, np.zeros(3), 1e-10 * np.eye(3)), pin.SE3.Identity())
    with pytest.raises(UnsupportedRobotError, match="MuJoCo takes nothing below"):
        rp.write_mjcf(rp.robot_from_model(model, actuated=["speck"]), path)
    ball = pin.Model()
    joint = ball.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    ball.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    ball.armature = np.array([0.1, 0.1, 0.2])
    with pytest.raises(UnsupportedRobotError, match="MuJoCo has one a joint"):
        rp.write_mjcf(dataclasses.replace(robot, model=ball, loads=(), q_reference=pin.neutral(ball)), path)
    steep = Coupling("steep", robot.actuated[0], robot.actuated[1], (0.0,) * 5 + (1.0,))
    with pytest.raises(UnsupportedRobotError, match="'steep' has a polynomial of degree 5"):
        rp.write_mjcf(dataclasses.replace(robot, couplings=(steep,)), path)
    for step in (0.0, "x", None, [1.0], np.nan):
        with pytest.raises(InputError, match="step is"):
            rp.write_mjcf(robot, path, step=step)
    for name in ("two\nlines", "bell\x07", "half\ud800"):
        with pytest.raises(InputError, match="control characters"):
            rp.write_mjcf(dataclasses.replace(robot, name=name), path)
    for wrong in (None, 3.0, [], tmp_path / "no" / "robot.xml"):
        with pytest.raises(OutputError):
            rp.write_mjcf(robot, wrong)
    assert list(tmp_path.iterdir()) == []


def test_limits_of_effort_are_said_in_mjcf_and_cut_nothing_off(tmp_path: Path) -> None:
    """As here: a plan that breaks them is one that says so, and MuJoCo's motion is its motion still."""
    model, limits = robot_of("five_bar").model.copy(), np.array([[-3.0, 1.0], [3.0, np.inf]])
    robot = dataclasses.replace(robot_of("five_bar"), model=model)
    for name, values in zip(("lowerEffortLimit", "upperEffortLimit"), limits, strict=True):  # of them a side has none
        array = np.array(getattr(model, name))
        array[robot.actuated_velocity] = values
        setattr(model, name, array)
    path = rp.write_mjcf(robot, tmp_path / "robot.xml")
    again = rp.load_robot(path, keyframe="reference").effort_limits
    np.testing.assert_array_equal(again[:, 0], limits[:, 0])
    assert (again[0, 1], again[1, 1] > 1e9) == (1.0, True)
    written = mujoco.MjModel.from_xml_path(str(path))
    carriers = [[-each.force, each.force] for each in robot.carrier_limits]
    assert written.actuator_ctrllimited[robot.m :].astype(bool).tolist() == np.isfinite(carriers).all(axis=1).tolist()
    data = mujoco.MjData(written)
    data.ctrl[0] = 50.0
    mujoco.mj_forward(written, data)
    assert data.actuator_force[0] == 50.0


def test_joints_without_limits_have_none_in_mjcf(tmp_path: Path) -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "arm")  # its limits are the largest doubles
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.1, 0.0, 0.0]), 0.1 * np.eye(3)), pin.SE3.Identity())
    path = rp.write_mjcf(rp.robot_from_model(model, actuated=["arm"]), tmp_path / "arm.xml")
    assert "range" not in path.read_text()
    limits = rp.load_robot(path).model
    assert (np.abs([limits.lowerPositionLimit, limits.upperPositionLimit]) > 1e300).all()
    # a limit to one side is kept
    model.lowerPositionLimit[0], model.upperPositionLimit[0] = -np.inf, 1.25
    limits = rp.load_robot(rp.write_mjcf(rp.robot_from_model(model, actuated=["arm"]), tmp_path / "arm.xml")).model
    assert limits.upperPositionLimit[0] == 1.25
    assert limits.lowerPositionLimit[0] < -1e9
