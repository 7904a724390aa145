"""Models of MuJoCo, judged by MuJoCo: masses, placements, and the efforts of closed chains."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from mjcf_models import FOUR_BAR, FREE, GEARED, RSSR, SPATIAL, WELD, Engine, write
from zoo import home_of

import redundancy_pin as rp
from redundancy_pin.errors import InputError, ModelFileError, RedundancyPinError
from redundancy_pin.robot.formats.mechanism import NOT_IN_FORCE
from redundancy_pin.robot.formats.mjcf import read_mjcf
from redundancy_pin.robot.loads import JointForces

mujoco = pytest.importorskip("mujoco")

MODELS = {
    "four_bar": FOUR_BAR,
    "geared": GEARED,
    "spatial": SPATIAL,
    "rssr": RSSR,
    "weld": WELD.format(weld=""),
    "weld_anchor": WELD.format(weld='anchor="-0.05 0 0.02"'),
    "weld_relpose": WELD.format(weld='anchor="0.01 0 0.02" relpose="0.3 0 0.05 0.9689 0 -0.2474 0"'),
}

BODIES = ["slider", "rod", "lump", "arm", "fore", "crank", "coupler", "rocker", "left", "top", "right", "stub"]
SITES = ["tip", "end", "far", "near", "drawn"]


@pytest.mark.parametrize("name", MODELS)
def test_tree_and_masses_are_those_of_mujoco(name, tmp_path):
    path = write(tmp_path, MODELS[name])
    mechanism = read_mjcf(path)
    model = mechanism.model(str(path))
    engine = Engine(path)
    np.testing.assert_allclose(model.gravity.linear, engine.model.opt.gravity)

    class Tree:  # what the engine asks of a robot
        pass

    Tree.model = model
    rng, data = np.random.default_rng(3), model.createData()
    steps = rng.normal(size=(5, model.nv))
    starts = [mechanism.configuration(model), *(pin.integrate(model, pin.neutral(model), step) for step in steps)]
    for start in starts:
        v = rng.normal(size=model.nv)
        engine.set(Tree, start, v)
        pin.framesForwardKinematics(model, data, start)
        for link in mechanism.links:
            frame = data.oMf[model.getFrameId(link, pin.FrameType.BODY)]
            if link in (
                "slider",
                "rod",
                "arm",
                "fore",
                "crank",
                "coupler",
                "rocker",
                "left",
                "top",
                "right",
                "stub",
                "lump",
            ):
                own = engine.data.body(link)
            elif link in SITES:
                own = engine.data.site(link)
            else:
                continue
            np.testing.assert_allclose(frame.translation, own.xpos, atol=1e-12)
            np.testing.assert_allclose(frame.rotation, own.xmat.reshape(3, 3), atol=1e-12)
        mass = np.zeros((engine.model.nv,) * 2)
        mujoco.mj_fullM(engine.model, engine.data, mass)
        columns = engine.columns(Tree)
        crba = pin.crba(model, data, start)
        crba = np.triu(crba) + np.triu(crba, 1).T
        np.testing.assert_allclose(crba, mass[np.ix_(columns, columns)], atol=1e-12)
        np.testing.assert_allclose(pin.nle(model, data, start, v), engine.data.qfrc_bias[columns], atol=1e-10)
    np.testing.assert_allclose(mechanism.configuration(model)[:1], engine.model.qpos0[:1])


@pytest.mark.parametrize("name", MODELS)
def test_efforts_of_the_closed_chain_are_those_of_mujoco(name, tmp_path):
    path = write(tmp_path, MODELS[name])
    robot = rp.load_robot(path)
    engine = Engine(path)
    rng = np.random.default_rng(5)
    x = home_of(robot) + rng.uniform(-0.05, 0.05, (4, robot.n))
    motion = rp.PlatformMotion(np.arange(4.0), x, rng.normal(size=x.shape), rng.normal(size=x.shape), check_rates=False)
    lifted = rp.inverse_kinematics(robot, motion)
    efforts = rp.distribute(rp.RneaDynamics(robot).reduce(motion))
    assert robot.loads
    assert robot.n == robot.m
    system = rp.kinematics.closure.ConstraintSystem(robot)
    # a rod between two balls: its spin is held here and nowhere in the file
    own = ["ball" in robot.model.names and row.startswith("rz") for row in robot.constraint_names]
    assert sum(own) == (name in ("spatial", "rssr"))
    if any(own):  # the first ball is damped
        spin = robot.closures[-1]
        carriers = {robot.model.frames[robot.model.getFrameId(end)].parentJoint for end in (spin.frame_a, spin.frame_b)}
        ball = robot.model.getJointId("ball")
        assert carriers == {ball, robot.model.parents[ball]}
    rows = system.evaluate(lifted.q).Jc[:, own]
    for i in range(4):
        engine.set(robot, lifted.q[i], lifted.v[i])
        equality = engine.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert equality.sum() == (6 if "weld" in name or name == "rssr" else 3) + len(robot.couplings)
        np.testing.assert_allclose(engine.data.efc_pos[equality], 0.0, atol=1e-9)
        J = engine.data.efc_J.reshape(-1, engine.model.nv)[equality][:, engine.columns(robot)]
        np.testing.assert_allclose(J @ lifted.v[i], 0.0, atol=1e-9)
        expected = engine.torque(robot, lifted.a[i], rows[i])
        np.testing.assert_allclose(efforts.tau[i], expected, rtol=1e-7, atol=1e-9)


def test_a_free_body_is_six_joints(tmp_path):
    path = write(tmp_path, FREE.format(root='<freejoint name="root"/>', key="1 2 3 0.9 0.1 -0.2 0.3"))
    robot = rp.load_robot(path)
    six = [f"root_{axis}" for axis in ("x", "y", "z", "rz", "ry", "rx")]
    assert list(robot.model.names)[1:] == [*six, "hip"]
    assert (robot.n, robot.m) == (7, 1)
    engine = mujoco.MjModel.from_xml_path(str(path))
    for key in (-1, 0):
        data = mujoco.MjData(engine)
        if key == 0:
            mujoco.mj_resetDataKeyframe(engine, data, 0)
            robot = rp.load_robot(path, keyframe="lying")
        mujoco.mj_forward(engine, data)
        own = robot.model.createData()
        pin.framesForwardKinematics(robot.model, own, np.array(robot.q_reference))
        place = own.oMf[robot.model.getFrameId("upper", pin.FrameType.BODY)]
        np.testing.assert_allclose(place.translation, data.body("upper").xpos, atol=1e-12)
        np.testing.assert_allclose(place.rotation, data.body("upper").xmat.reshape(3, 3), atol=1e-12)
        # the effort of the hip and the wrench that would hold the trunk, at rest: weight and its moment
        pin.computeGeneralizedGravity(robot.model, own, np.array(robot.q_reference))
        np.testing.assert_allclose(own.g[:3], data.qfrc_bias[:3], atol=1e-10)
        np.testing.assert_allclose(own.g[6], data.qfrc_bias[6], atol=1e-10)
    assert any("root_x" in note for note in robot.notes)


SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))


@pytest.mark.parametrize(
    ("root", "key"),
    [
        ("<freejoint/>", "1 2 3 0.9 0.1 -0.2 0.3"),
        (SLIDES + '<joint type="ball"/>', "0 0 0 1 0 0 0"),
    ],
)
def test_a_base_that_is_held(root, key, tmp_path):
    path = write(tmp_path, FREE.format(root=root, key=key))
    robot = rp.load_robot(path, base="fixed", keyframe="lying")
    assert (list(robot.model.names)[1:], robot.n) == (["hip"], 1)
    np.testing.assert_allclose(robot.q_reference, [0.3])
    loose = rp.load_robot(path)
    assert loose.n == 7


def test_what_a_held_spin_and_a_ball_leave_out_is_said(tmp_path):
    """A rod whose mass is off the line between its balls would swing; ranges of balls stop nothing here."""
    text = SPATIAL.replace('type="ball"', 'type="ball" range="0 60"')
    robot = rp.load_robot(path := write(tmp_path, text))
    engine = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(engine)
    mujoco.mj_kinematics(engine, data)
    mujoco.mj_comPos(engine, data)
    start, end = data.joint("ball").xanchor, data.site("far").xpos
    centre = data.body("rod").subtree_com - start
    away = np.linalg.norm(np.cross(centre, end - start)) / np.linalg.norm(end - start)
    assert away > 0.01
    assert sum(f"off that line: ball by {away:.2g} m" in note for note in robot.notes) == 1
    assert f"{NOT_IN_FORCE} range of ball." in robot.notes
    plain = rp.load_robot(write(tmp_path, RSSR)).notes
    assert not any("off that line" in note or "range" in note for note in plain)
    assert any("The spin of ball" in note for note in plain)


def test_a_ball_that_carries_a_hinge_is_no_rod(tmp_path):
    """It moves freely, as three hinges, whose damping is no longer that of a ball."""
    text = """<mujoco><worldbody><body name="arm"><joint name="ball" type="ball" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/><body name="hand" pos="0.3 0 0">
      <joint name="hinge" axis="0 1 0" damping="0.2"/><geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/>
      </body></body></worldbody><actuator><motor joint="hinge"/></actuator></mujoco>"""
    robot = rp.load_robot(write(tmp_path, text))
    assert robot.independent_joints == ("hinge", "ball_rz", "ball_ry", "ball_rx")
    assert not robot.closures
    assert robot.loads == (JointForces("hinge", 0.2),)
    assert f"{NOT_IN_FORCE} damping of ball." in robot.notes
    assert read_mjcf(write(tmp_path, text)).start["ball"].tolist() == [0.0, 0.0, 0.0, 1.0]
    # three hinges have no armature that turns as a ball's does; that of the hinge is another
    same = text.replace('damping="0.2"', 'damping="0.2" armature="0.3"')
    assert rp.load_robot(write(tmp_path, same)).model.armature.tolist() == [0.0, 0.0, 0.0, 0.3]
    assert rp.load_robot(write(tmp_path, same.replace('damping="0.1"', 'armature="0"'))).n == 4
    with pytest.raises(ModelFileError, match=r"ball joint of .* that moves freely has an armature"):
        rp.load_robot(write(tmp_path, text.replace('damping="0.1"', 'armature="0.01"')))


def test_start_limits_gear_armature_and_notes(tmp_path):
    robot = rp.load_robot(write(tmp_path, FOUR_BAR))
    model = robot.model
    crank, elbow = (model.joints[model.getJointId(name)] for name in ("crank", "elbow"))
    assert robot.effort_limits[:, 0].tolist() == [-40.0, 60.0]  # −2 … 3 times a gear of 20
    assert (model.lowerPositionLimit[crank.idx_q], model.upperPositionLimit[crank.idx_q]) == (-3.0, 3.0)
    assert (model.armature[crank.idx_v], model.armature[elbow.idx_v]) == (0.01, 0.0)
    assert np.isinf(model.upperPositionLimit[elbow.idx_q])
    notes = "\n".join(robot.notes)
    assert "In force: damping, friction and springs of crank, elbow, rocker" in notes
    assert robot.loads == tuple(JointForces(name, 0.1) for name in ("crank", "elbow", "rocker"))
    assert "In force: armature of crank" in notes
    assert "z of 'pin'" in notes
    assert "Contacts" in notes
    bent = read_mjcf(write(tmp_path, SPATIAL), keyframe="bent").start
    assert (bent["slide"], bent["turn"], bent["fore"]) == (0.1, 0.2, -0.2)
    quaternion = np.array([0.2, 0.4, 0.4, 0.8])
    np.testing.assert_allclose(bent["ball"], quaternion / np.linalg.norm(quaternion))
    assert robot.parameters["base"] == "free"


def test_a_declaration_may_name_a_model(tmp_path):
    write(tmp_path, FOUR_BAR)
    (tmp_path / "robot.yaml").write_text(
        "urdf: model.xml\nactuated: [rocker]\nindependent: {platform: tip, axes: [x]}\n"
        "reference: {platform: [0.4], guess: {crank: 0.5}}\n"
    )
    robot = rp.load_robot(tmp_path)
    assert robot.actuated == ("rocker",)
    assert home_of(robot)[0] == pytest.approx(0.4)
    assert robot.gravity[1] == -9.81
    assert robot.name == tmp_path.name
    own = (tmp_path / "robot.yaml").read_text()
    assert {load.joint for load in robot.loads} == {"crank", "elbow", "rocker"}
    (tmp_path / "robot.yaml").write_text(own + "urdf_dynamics: false\n")
    assert rp.load_robot(tmp_path).loads == ()
    (tmp_path / "robot.yaml").write_text(own + "joint_forces: [{joint: elbow, damping: 7.0}]\n")
    dampings = {load.joint: load.damping for load in rp.load_robot(tmp_path).loads}
    assert dampings == {"crank": 0.1, "elbow": 7.0, "rocker": 0.1}


REFUSED = {
    "unknown section": ("<actuator>", "<actuators/><actuator>", "<actuators> is not covered"),
    "unknown attribute": ('name="rocker"/>', 'name="rocker" axes="0 0 1"/>', "line 22: the joint 'rocker' .*'axes'"),
    "tendon equality": ("<connect", "<tendon", "another kind"),
    "coupled site": ("<connect", '<joint joint1="tip"/><connect', "joint1='tip', which is no joint of one freedom"),
    "tendon motor": ('joint="crank" gear', 'tendon="crank" gear', "tendon='crank'"),
    "mesh": ('fromto="0 0 0 0.45 0 0"', 'type="mesh" mesh="m"', "a mesh whose mass"),
    "composite": ("<light", "<composite", "<composite> is not covered"),
    "replicate": ('<light pos="0 0 3"/>', '<replicate count="3"/>', "<replicate> is not covered"),
    "mocap": ('<body name="rocker"', '<body name="rocker" mocap="true"', "mocap"),
    "number": ('pos="0.35 0 0"', 'pos="0.35 0 nan"', "not 3 finite"),
    "class": ('childclass="heavy"', 'childclass="heavi"', "no default class 'heavi'.*mean 'heavy'"),
    "site": ('site2="end"', 'site2="ende"', "site2='ende'"),
    "joint of motor": ('joint="crank" gear', 'joint="krank" gear', "'krank', which is no joint"),
    "twice": ('<joint name="rocker"/>', '<joint name="crank"/>', "two joints 'crank'"),
    "axis": ('<joint name="rocker"/>', '<joint name="rocker" axis="0 0 0"/>', "axis of length zero"),
    "muscle": ("<motor", "<muscle", "<muscle> is not covered"),
    "settotalmass": ('autolimits="true"', 'settotalmass="3"', "settotalmass"),
    "disabled": ('timestep="0.001"/>', '><flag equality="disable"/></option>', "equality=disable"),
    "include elsewhere": ("<light", '<include file="../other.xml"/><light', "is outside"),
    "include nothing": ("<light", '<include file="other.xml"/><light', "is not there"),
    "include itself": ('<light pos="0 0 3"/>', '<include file="model.xml"/>', "included twice, or by itself"),
    "no motor": ('<motor name="drive" joint="crank" gear="20" ctrlrange="-2 3"/>', "", "drives no joint"),
    "moments": ('fromto="0 0 0 0.45 0 0"', 'type="box" size="0.1 0.1"', "a box with the size"),
    "open": ('pos="0.35 0 0"', 'pos="3 0 0"', "do not close near the reference"),
    "entity": ("<mujoco model", "<!DOCTYPE mujoco><mujoco model", "DOCTYPE"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_covered_is_refused_by_name(case, tmp_path):
    old, new, message = REFUSED[case]
    (tmp_path / "in").mkdir()
    (tmp_path / "other.xml").write_text("<mujoco/>")
    assert old in FOUR_BAR
    with pytest.raises(RedundancyPinError, match=message):
        rp.load_robot(write(tmp_path / "in", FOUR_BAR.replace(old, new)))


def test_masses_that_no_body_has(tmp_path):
    text = SPATIAL.replace('diaginertia="0.02 0.03 0.04"', 'diaginertia="0.02 0.03 0.4"')
    with pytest.raises(ModelFileError, match="which no body has"):
        rp.load_robot(write(tmp_path, text))


@pytest.mark.parametrize("section", ["visual", "statistic", "asset", "sensor", "custom", "size"])
def test_what_moves_nothing_is_passed_over(section, tmp_path):
    text = FOUR_BAR.replace("<worldbody>", f'<{section}><thing odd="1"/></{section}><worldbody>')
    assert read_mjcf(write(tmp_path, text)).actuated == ("crank",)


def test_arguments(tmp_path):
    path = write(tmp_path, SPATIAL)
    with pytest.raises(InputError, match=r"no argument 'keyfram'.*mean 'keyframe'"):
        rp.load_robot(path, keyfram="bent")
    with pytest.raises(InputError, match="'base' is 'loose'"):
        rp.load_robot(path, base="loose")
    with pytest.raises(ModelFileError, match=r"no keyframe 'bend'\. Its keyframes: bent"):
        rp.load_robot(path, keyframe="bend")


def test_pictures_of_plain_shapes(tmp_path):
    from redundancy_pin.visualisation.viewer.scene import make_scene

    robot = rp.load_robot(write(tmp_path, FOUR_BAR))
    solids = make_scene(robot, np.zeros(1), np.array(robot.q_reference)[None], np.ones(1)).solids
    cylinders = [solid for solid in solids if solid.shape == "cylinder" and solid.role == "link"]
    assert {str(robot.model.names[solid.body]) for solid in cylinders} == {"crank", "elbow", "rocker"}
    (first,) = (solid for solid in cylinders if robot.model.names[solid.body] == "crank")
    np.testing.assert_allclose(first.placement[:3, 3], [0.1, 0.0, 0.0], atol=1e-12)
    assert first.size == (0.02, 0.2)


@pytest.mark.parametrize(
    ("geom", "shape", "size", "ends"),
    [
        ('type="box" size=".1 .2 .3"', "box", (0.2, 0.4, 0.6), []),
        ('type="sphere" size=".15"', "sphere", (0.15,), None),
        ('type="cylinder" size=".05 .25"', "cylinder", (0.05, 0.5), []),
        ('type="capsule" size=".06 .35"', "cylinder", (0.06, 0.7), [-0.35, 0.35]),
    ],
)
def test_pictures_have_the_sizes_of_solids(geom, shape, size, ends, tmp_path):
    """MuJoCo gives halves of edges and lengths; a capsule ends in balls."""
    from redundancy_pin.visualisation.viewer.scene import make_scene

    text = f"""<mujoco><worldbody><body><joint name="turn" axis="0 0 1"/><geom {geom} pos="4 0 0"/></body></worldbody>
        <actuator><motor joint="turn"/></actuator></mujoco>"""
    robot = rp.load_robot(write(tmp_path, text))
    scene = make_scene(robot, np.zeros(1), np.array(robot.q_reference)[None], np.ones(1))
    solids = [solid for solid in scene.solids if solid.role == "link" and solid.placement[0, 3] > 3.0]
    np.testing.assert_allclose([solid.size for solid in solids if solid.shape == shape], [size], rtol=1e-12)
    if ends is not None:
        assert sorted(solid.placement[2, 3] for solid in solids if solid.shape == "sphere") == pytest.approx(ends)


def test_a_file_is_what_its_top_element_says(tmp_path):
    """A URDF whose name ends in .xml is a URDF, beside a declaration as alone."""
    urdf = (
        '<robot name="arm"><link name="base"/><link name="arm"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    (tmp_path / "arm.xml").write_text(urdf)
    (tmp_path / "robot.yaml").write_text(
        "urdf: arm.xml\nactuated: [turn]\nindependent: {joints: [turn]}\nreference: {joints: {turn: 0.2}}\n"
    )
    assert rp.load_robot(tmp_path).actuated == ("turn",)
    with pytest.raises(RedundancyPinError, match="is a URDF"):
        rp.load_robot(tmp_path / "arm.xml")
    model = write(tmp_path, FOUR_BAR)
    model.rename(tmp_path / "bar.mjcf")
    assert rp.load_robot(tmp_path / "bar.mjcf").actuated == ("crank",)
