"""Models of MuJoCo, judged by MuJoCo's own masses, placements, forces and constraints."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import mjcf_models
import numpy as np
import pinocchio as pin
import pytest
from mjcf_models import FOUR_BAR, FREE, RSSR, SPATIAL, Engine, write
from zoo import home_of, places_of

import redundancy_pin as rp
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.robot.formats.mjcf import read_mjcf
from redundancy_pin.robot.loads import JointForces

mujoco = pytest.importorskip("mujoco")

FILES = Path(__file__).parent / "files" / "mjcf"
WELD = mjcf_models.WELD
CLOSED = {
    **{name: getattr(mjcf_models, name.upper()) for name in ("four_bar", "geared", "spatial", "rssr")},
    "weld": WELD.format(weld=""),
    "weld_anchor": WELD.format(weld='anchor="-0.05 0 0.02"'),
    "weld_relpose": WELD.format(weld='anchor="0.01 0 0.02" relpose="0.3 0 0.05 0.9689 0 -0.2474 0"'),
}
GOOD = {**CLOSED, **{file.stem: file.read_text() for file in sorted((FILES / "good").glob("*.xml"))}}

STAND_INS = {
    'file="none.stl"': 'vertex="0 0 0  1 0 0  0 1 0  0 0 1"',
    'file="none.png"': 'builtin="flat" width="4" height="4"',
}
"""What MuJoCo gets in place of files that are not there."""


def engine_of(path: Path) -> Engine:
    text = path.read_text()
    for file, stand_in in STAND_INS.items():
        text = text.replace(file, stand_in)
    path.write_text(text)
    return Engine(path)


@pytest.mark.parametrize("name", GOOD)
def test_tree_masses_and_tendons_are_those_of_mujoco(name, tmp_path):
    """Frames, mass matrix, bias and lengths of tendons at the start and at random states."""
    path = write(tmp_path, GOOD[name])
    shutil.copytree(FILES / "good" / "parts", tmp_path / "parts")
    mechanism = read_mjcf(path)
    model, engine = mechanism.model, engine_of(path)
    np.testing.assert_allclose(model.gravity.linear, engine.model.opt.gravity)
    lengths = {each.joint: each for each in mechanism.couplings if each.name.startswith("length of")}
    armature = [float(engine.model.tendon_armature[engine.model.tendon(each).id]) for each in lengths]
    assert [model.armature[model.joints[model.getJointId(each)].idx_v] for each in lengths] == armature
    rng, data = np.random.default_rng(3), model.createData()
    q, seen = mechanism.start, 0
    for step in range(5):
        v = rng.normal(size=model.nv) * (step > 0)
        engine.set(mechanism, q, v, without=lengths)
        pin.framesForwardKinematics(model, data, q)
        for kind, count in (("body", engine.model.nbody), ("site", engine.model.nsite)):
            for number in range(count):
                own = getattr(engine.data, kind)(number)
                if not own.name:
                    continue
                link = next(each for each in (f"{kind}:{own.name}", own.name) if model.existFrame(each, pin.BODY))
                place = data.oMf[model.getFrameId(link, pin.BODY)]
                np.testing.assert_allclose(place.translation, own.xpos, atol=1e-12)
                np.testing.assert_allclose(place.rotation, own.xmat.reshape(3, 3), atol=1e-12)
                seen += 1
        columns, kept = engine.columns(mechanism, without=lengths)
        mass = engine.mass()
        for each, inertia in zip(lengths.values(), armature, strict=True):
            row = np.zeros(engine.model.nv)
            for joint, factor in ((each.of, each.polynomial[1]), *each.also):
                row[engine.model.joint(joint).dofadr[0]] = factor
            mass -= inertia * np.outer(row, row)
            length = sum(
                q[model.joints[model.getJointId(j)].idx_q] * f for j, f in ((each.of, each.polynomial[1]), *each.also)
            )
            assert engine.data.tendon(each.joint).length[0] == pytest.approx(length, abs=1e-12)
        crba = pin.crba(model, data, q)[np.ix_(kept, kept)]
        crba = np.triu(crba) + np.triu(crba, 1).T
        np.testing.assert_allclose(crba, mass[np.ix_(columns, columns)], atol=1e-12)
        np.testing.assert_allclose(pin.nle(model, data, q, v)[kept], engine.data.qfrc_bias[columns], atol=1e-10)
        q = pin.integrate(model, mechanism.start, rng.normal(size=model.nv))
    assert seen >= 10


@pytest.mark.parametrize("name", CLOSED)
def test_efforts_of_the_closed_chain_are_those_of_mujoco(name, tmp_path):
    path = write(tmp_path, CLOSED[name])
    robot = rp.load_robot(path)
    engine = Engine(path)
    rng = np.random.default_rng(5)
    x = home_of(robot) + rng.uniform(-0.05, 0.05, (4, robot.n))
    motion = rp.PlatformMotion(np.arange(4.0), x, rng.normal(size=x.shape), rng.normal(size=x.shape), check_rates=False)
    followed = rp.inverse_kinematics(robot, motion)
    efforts = rp.distribute(rp.RneaDynamics(robot).reduce(motion))
    assert robot.loads
    assert robot.n == robot.m
    # a rod between two balls: its spin is held here and nowhere in the file
    own = ["ball" in robot.model.names and row.startswith("rz") for row in robot.constraint_names]
    assert sum(own) == (name in ("spatial", "rssr"))
    if any(own):  # at the ball that is damped
        spin, ball = robot.closures[-1], robot.model.getJointId("ball")
        frames = [robot.model.frames[robot.model.getFrameId(end)] for end in (spin.frame_a, spin.frame_b)]
        assert {frame.parentJoint for frame in frames} == {ball, robot.model.parents[ball]}
    rows = rp.kinematics.closure.ConstraintSystem(robot).evaluate(followed.q).Jc[:, own]
    for i in range(4):
        engine.set(robot, followed.q[i], followed.v[i])
        equality = engine.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert equality.sum() == (6 if "weld" in name or name == "rssr" else 3) + len(robot.couplings)
        np.testing.assert_allclose(engine.data.efc_pos[equality], 0.0, atol=1e-9)
        J = engine.data.efc_J.reshape(-1, engine.model.nv)[equality][:, engine.columns(robot)[0]]
        np.testing.assert_allclose(J @ followed.v[i], 0.0, atol=1e-9)
        expected = engine.torque(robot, followed.a[i], rows[i])
        np.testing.assert_allclose(efforts.tau[i], expected, rtol=1e-7, atol=1e-9)


def test_equalities_of_tendons_and_rods_are_where_mujoco_has_no_error(tmp_path):
    mechanism = read_mjcf(FILES / "good" / "gripper.xml")
    model, engine = mechanism.model, Engine(FILES / "good" / "gripper.xml")
    train = next(each for each in mechanism.couplings if each.name == "train")
    q = np.array(pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq)))
    at = {str(name): joint.idx_q for name, joint in zip(model.names, model.joints, strict=True)}
    followed = q[at[train.of]]
    q[at[train.joint]] = np.polyval(train.polynomial[::-1], followed) + sum(f * q[at[name]] for name, f in train.also)
    engine.set(mechanism, q, without=["split"])
    equality = engine.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    error = dict(zip(engine.data.efc_id[equality], engine.data.efc_pos[equality], strict=True))
    assert error[engine.model.equality("train").id] == pytest.approx(0.0, abs=1e-12)
    (rod,) = read_mjcf(FILES / "good" / "rod.xml").loop_joints
    engine = Engine(FILES / "good" / "rod.xml")
    engine.data.qpos[:] = [0.3, -0.2]
    mujoco.mj_forward(engine.model, engine.data)
    assert (rod.kind, rod.links) == ("rod", ("tip", "pin"))
    away = np.linalg.norm(engine.data.site("tip").xpos - engine.data.site("pin").xpos)
    assert away - rod.length == pytest.approx(engine.data.efc_pos[0], abs=1e-12)


def test_a_tendon_that_drives_is_a_joint_without_mass():
    mechanism = read_mjcf(FILES / "good" / "gripper.xml")
    model = mechanism.model
    column = model.joints[model.getJointId("split")].idx_v
    assert mechanism.actuated == ("split",)
    assert not any("range of" in note for note in mechanism.notes)
    assert (model.lowerEffortLimit[column], model.upperEffortLimit[column]) == (-10.0, 20.0)
    assert (model.lowerPositionLimit[column], model.upperPositionLimit[column]) == (-1.0, 2.0)
    assert JointForces("split", 0.3, 0.2, stiffness=2.0, rest=0.1) in mechanism.forces
    assert mechanism.start[model.joints[model.getJointId("split")].idx_q] == pytest.approx(-0.7 * 0.3)
    length = next(each for each in mechanism.couplings if each.joint == "split")
    assert (length.of, length.polynomial, length.also) == ("left", (0.0, 0.5), (("right", -0.7),))


IS_RECENT = int(mujoco.__version__.partition(".")[0]) >= 4
"""Springs that yield, and what is behind an actuator, came with MuJoCo 4."""


# --- free bodies, starts ----------------------------------------------------------------------------------------------

SLIDES = "".join(f'<joint type="slide" axis="{axis}" ref="0.4"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))


@pytest.mark.parametrize(
    ("root", "key"),
    [
        ('<freejoint name="root"/>', "1 2 3 0.9 0.1 -0.2 0.3"),
        ('<freejoint name="root"/>', "1 2 3 0 0 0 0"),
        ('<freejoint name="root"/>', "1 2 3 1e-16 0 1e-16 0"),
        ('<freejoint name="root"/>', "1 2 3 0 1e-14 1e-14 0"),
        (
            '<freejoint name="root"/>',
            "1 2 3 0.7062230818381384 0.035340609509629355 0.706223081836083 -0.035340609509104566",
        ),  # a pitch of 90 degrees less 3e-12
        (SLIDES + '<joint type="ball" pos="0.1 0 0.2"/>', "0.1 0.2 0.3 2 0.2 0 1"),
    ],
)
def test_free_bodies_start_where_mujoco_has_them_and_may_be_held_there(root, key, tmp_path):
    """Bodies are where MuJoCo has them, and the torque of the hip is its own."""
    path = write(tmp_path, FREE.format(root=root, key=key))
    engine = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(engine)
    mujoco.mj_resetDataKeyframe(engine, data, 0)
    mujoco.mj_forward(engine, data)
    for base, n in (("free", 7), ("fixed", 1)):
        robot = rp.load_robot(path, base=base, keyframe="lying")
        (place,) = places_of(robot.model, robot.q_reference, "upper")
        np.testing.assert_allclose(place.translation, data.body("upper").xpos, atol=1e-12)
        np.testing.assert_allclose(place.rotation, data.body("upper").xmat.reshape(3, 3), atol=1e-12)
        weight = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), np.array(robot.q_reference))
        assert weight[-1] == pytest.approx(data.qfrc_bias[-1], abs=1e-10)
        assert (robot.n, robot.actuated) == (n, ("hip",))
        if base == "free" and "freejoint" in root:
            six = [f"root_{axis}" for axis in ("x", "y", "z", "rz", "ry", "rx")]
            assert list(robot.model.names)[1:] == [*six, "hip"]
            np.testing.assert_allclose(weight[:3], data.qfrc_bias[:3], atol=1e-10)
    with pytest.raises(RedundancyPinError, match=r"no keyframe 'lyin'.*'lying'"):
        rp.load_robot(path, keyframe="lyin")


def test_a_rod_off_its_line_is_noted(tmp_path):
    """Mass off the line between its balls would swing: the note says how far off it is."""
    robot = rp.load_robot(path := write(tmp_path, SPATIAL))
    data = mujoco.MjData(engine := mujoco.MjModel.from_xml_path(str(path)))
    mujoco.mj_kinematics(engine, data)
    mujoco.mj_comPos(engine, data)
    start, end = data.joint("ball").xanchor, data.site("far").xpos
    away = np.linalg.norm(np.cross(data.body("rod").subtree_com - start, end - start)) / np.linalg.norm(end - start)
    assert sum(f"off that line: ball by {away:.2g} m" in note for note in robot.notes) == 1
    assert not any("off that line" in note for note in rp.load_robot(write(tmp_path, RSSR)).notes)


# --- forces, limits, flags --------------------------------------------------------------------------------------------


def hinge(joint="", motor="<motor joint='j'/>", before=""):
    return (
        f'<mujoco><compiler angle="radian"/>{before}<worldbody><body name="a"><joint name="j" axis="0 1 0" {joint}/>'
        f'<geom size="0.1" pos="0.3 0 0"/></body></worldbody><actuator>{motor}</actuator></mujoco>'
    )


FORCES = 'stiffness="10" springref="0.5" damping="3" frictionloss="2"'


@pytest.mark.parametrize("joint", [FORCES, FORCES + ' springdamper="0.1 1"', 'class="soft"'])
@pytest.mark.parametrize("flags", [[], ["spring"], ["damper"], ["frictionloss"], ["spring", "damper", "gravity"]])
def test_forces_of_joints_are_those_of_mujoco(joint, flags, tmp_path):
    flag = "".join(f'{each}="disable" ' for each in flags)
    before = f'<option><flag {flag}/></option><default><default class="soft"><joint stiffness="7"/></default></default>'
    text = hinge(joint, before=before)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = 0.7, -1.1
    mujoco.mj_forward(model, data)
    mechanism = read_mjcf(write(tmp_path, text))
    ours = sum(load.stiffness * (load.rest - 0.7) + load.damping * 1.1 for load in mechanism.forces)
    friction = data.efc_frictionloss[data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF].sum()
    assert ours == pytest.approx(data.qfrc_passive[0])
    assert sum(load.friction for load in mechanism.forces) == pytest.approx(friction)
    own = mechanism.model
    weight = pin.computeGeneralizedGravity(own, own.createData(), np.array([0.7]))
    np.testing.assert_allclose(weight, data.qfrc_bias, atol=1e-12)
    assert any("Disabled by flags" in note for note in mechanism.notes) == bool(flags)


@pytest.mark.parametrize(
    ("motors", "driven"),
    [
        (['<motor joint="j" gear="-2" ctrlrange="-1 3"/>'], ""),
        (['<motor joint="j" gear="2" ctrlrange="-5 5" forcerange="-3 1"/>'], ""),
        (['<motor joint="j" gear="2" ctrlrange="-5 5"/>'], "-4 3"),
        (['<motor joint="j" gear="2" ctrlrange="-3 3" forcerange="1 2"/>'], ""),
        (['<motor joint="j" gear="-2" ctrlrange="-3 3" forcerange="1 2"/>'], ""),
        (['<motor joint="j" gear="2" ctrlrange="0 3"/>', '<motor joint="j" gear="-2" ctrlrange="0 3"/>'], ""),
        (['<general joint="j" gear="-2" gainprm="3" biasprm="0.5" biastype="affine" ctrlrange="-1 2"/>'], ""),
        (['<general joint="j" gainprm="-3" biasprm="0.5 -7 -8" ctrlrange="-1 2"/>'], ""),  # biastype none: no bias
        (['<general joint="j" gainprm="3" dyntype="filter" dynprm="0.01" ctrlrange="-1 2"/>'], ""),
        (['<general joint="j" gainprm="3" dyntype="filterexact" dynprm=".01" actrange="-1 4" forcerange="-9 4"/>'], ""),
        (['<general joint="j" gainprm="3" dyntype="integrator" ctrlrange="-99 99" actrange="-0.2 0.3"/>'], ""),
        (['<general joint="j" gainprm="0" biasprm="2" biastype="affine"/>'], ""),
    ],
)  # fmt: skip
def test_limits_of_efforts_are_what_mujoco_reaches(motors, driven, tmp_path):
    """At the end of forty time constants of the activation; and they are the same after ``write_mjcf``."""
    joint = f'actuatorfrcrange="{driven}"' if driven else ""
    text = hinge(joint, "".join(motors), '<option timestep="0.01"/>')
    engine, reached = mujoco.MjModel.from_xml_string(text), []
    for control in ((-9.0, 9.0), (9.0, -9.0)):
        data = mujoco.MjData(engine)
        data.ctrl[:] = control[: engine.nu]
        for _ in range(40):
            mujoco.mj_step(engine, data)
        mujoco.mj_forward(engine, data)
        reached.append(data.qfrc_actuator[0])
    robot = rp.load_robot(write(tmp_path, text))
    assert robot.effort_limits[:, 0].tolist() == sorted(reached)
    assert sum(note.startswith("Efforts of j") for note in robot.notes) == (sum(reached) != 0.0)
    again = rp.load_robot(rp.write_mjcf(robot, tmp_path / "again.xml"))
    if reached[0] != reached[1]:
        assert again.effort_limits[:, 0].tolist() == sorted(reached)


@pytest.mark.skipif(not IS_RECENT, reason="of MuJoCo 4")
def test_what_is_behind_an_actuator(tmp_path):
    motor = '<motor joint="j" gear="3" armature="0.1" damping="0.7"/>'
    robot = rp.load_robot(write(tmp_path, hinge('armature="0.2" damping="0.1"', motor)))
    assert robot.model.armature[0] == pytest.approx(0.2 + 9.0 * 0.1)
    assert robot.loads == (JointForces("j", 0.1 + 9.0 * 0.7),)


# --- files as data ----------------------------------------------------------------------------------------------------


def test_files_elsewhere_are_read_where_they_are_trusted(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "part.xml").write_text('<mujoco><body name="part" pos="1 0 0"><geom size="0.1"/></body></mujoco>')
    path = write(tmp_path / "in", hinge().replace("<worldbody>", '<worldbody><include file="../part.xml"/>'))
    with pytest.raises(RedundancyPinError, match="outside of the model's folder"):
        read_mjcf(path)
    assert read_mjcf(path, trust=True).model.existFrame("part", pin.BODY)


def test_a_model_of_a_stranger_is_compiled_by_a_child_with_limits(tmp_path, monkeypatch):
    """The same mechanism, the same refusals; a child that takes longer than it may is ended."""
    from redundancy_pin.io import limited

    for name in ("spatial", "gripper", "meshes"):
        own, other = (read_mjcf(write(tmp_path, GOOD[name]), untrusted=each) for each in (False, True))
        assert own.model == other.model
        assert (own.start == other.start).all()
        for key in ("couplings", "forces", "notes", "shapes"):
            assert getattr(own, key) == getattr(other, key)
        assert [each.closure() for each in own.loop_joints] == [each.closure() for each in other.loop_joints]
    with pytest.raises(RedundancyPinError, match=r"MuJoCo refuses it.*'axes'") as caught:
        read_mjcf(FILES / "bad" / "attribute.xml", untrusted=True)
    assert caught.value.remedy.startswith("Correct it there")
    path = write(tmp_path, FOUR_BAR)
    assert rp.load_robot(path, untrusted=True).notes == rp.load_robot(path).notes
    with pytest.raises(RedundancyPinError, match="trust and untrusted are both true"):
        rp.load_robot(path, trust=True, untrusted=True)
    monkeypatch.setattr(limited, "SECONDS", 0.01)
    with pytest.raises(RedundancyPinError, match=r"takes more than 0\.01 s"):
        rp.load_robot(write(tmp_path, hinge()), untrusted=True)


def test_without_mujoco_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(RedundancyPinError, match=r"redundancy_pin\[mjcf\]"):
        rp.load_robot(write(tmp_path, hinge()))


def test_shapes_are_drawn(tmp_path):
    shapes = read_mjcf(write(tmp_path, GOOD["meshes"])).shapes
    assert 'filename="nowhere/none.stl" scale="0.001 0.001 0.001"' in shapes
    assert rp.load_robot(tmp_path / "model.xml").urdf == shapes
    # a mesh of a group that is hidden, and one that counts, which MuJoCo moves to its centre, are not drawn
    assert shapes.count("<mesh") == 3


def test_a_weld_that_holds_no_rotation_is_a_ball(tmp_path):
    """``torquescale="0"``: its ends part as MuJoCo's rows of position say."""
    (free,) = re.findall("<connect.*?/>", FOUR_BAR)
    for anchor in ("0 0 0", "0.05 0.1 -0.02"):
        weld = f'<weld body1="coupler" body2="rocker" anchor="{anchor}" torquescale="0"/>'
        path = write(tmp_path, FOUR_BAR.replace(free, weld))
        mechanism, engine = read_mjcf(path), Engine(path)
        model, q = mechanism.model, np.array(mechanism.start) + 0.3
        (joint,) = mechanism.loop_joints
        engine.set(mechanism, q)
        ends = zip(places_of(model, q, *joint.links), joint.placements, strict=True)
        one, other = (link * pin.SE3(place) for link, place in ends)
        rows = engine.data.efc_pos[engine.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
        assert joint.kind == "ball"
        np.testing.assert_allclose(rows[3:6], 0.0, atol=1e-15)
        np.testing.assert_allclose(np.abs(one.translation - other.translation), np.abs(rows[:3]), atol=1e-12)
