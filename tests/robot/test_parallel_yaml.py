"""Robots in the format of example-parallel-robots: read directly, judged by Pinocchio's constrained dynamics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from constrained import accelerations
from written import J, urdf_of, write_robot
from zoo import home_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import DeclarationError, InputError, ModelFileError

PLANAR = [
    J("motor_1", "revolute", "base", "crank_1", (0, 0, 0.1), (0, 0, 1.3)),
    J("motor_2", "revolute", "base", "crank_2", (0.4, 0, 0.1), (0, 0, 0.9)),
    J("elbow_1", "revolute", "crank_1", "rod_1", (0.3, 0, 0), (0, 0, -0.6)),
    J("elbow_2", "revolute", "crank_2", "rod_2", (0.3, 0, 0), (0, 0, 0.8)),
    J("loop_A", "revolute", "rod_1", "pin", (0.35, 0, 0)),
    J("end_B", "fixed", "rod_2", "loop_B", (0.35, 0, 0)),
]
PLANAR_YAML = {"closed_loop": [["loop_A", "loop_B"]], "type": ["6d"], "name_mot": ["motor_2", "motor_1"]}
# a foot on a universal joint and a rod with a ball at one end and a universal joint at the other, as of an ankle
ANKLE = [
    J("cross", "revolute", "base", "foot", (0, 0, -0.4), (0.1, -0.2, 0.3)),
    J("motor", "revolute", "base", "crank", (0.1, 0.05, 0), (2.2, 0, 0.4), axis=(0, 1, 0)),
    J("rod_ball", "revolute", "crank", "rod", (0.12, 0, 0), (0, 2.0, 0)),
    J("rod_A", "fixed", "rod", "rod_end", (0.4, 0, 0)),
    J("foot_cross", "revolute", "foot", "pivot", (0.1, 0.05, 0.02), (-2.4, 0.5, 0)),
    J("held", "revolute", "foot", "toe", (0.2, 0, 0)),
]
ANKLE_YAML = {
    "closed_loop": [["rod_A", "pivot"]],
    "type": ["6D"],
    "name_mot": ["motor"],
    "joint_name": ["cross", "rod_ball", "foot_cross", "held"],
    "joint_type": ["UJOINT_XY", "SPHERICAL", "UJOINT_ZY", "FIXED"],
}


def written(folder: Path, joints: list[J], content: dict) -> Path:
    # as the collection writes limits: none of position, which urdfdom reads as 0 and 0
    text = urdf_of(joints).replace('lower="-100" upper="100" ', "")
    (folder / "robot.urdf").write_text(text)
    (folder / "robot.yaml").write_text(yaml.safe_dump(content))
    return folder


def model_by_hand(urdf: str, content: dict) -> pin.Model:
    """Build the model joint by joint out of Pinocchio's own of the URDF."""
    tree, model = pin.buildModelFromXML(urdf), pin.Model()
    kinds = dict(zip(content.get("joint_name", ()), content.get("joint_type", ()), strict=True))
    hinges = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}
    places = {0: (0, pin.SE3.Identity())}
    for index in range(1, tree.njoints):
        name, kind = str(tree.names[index]), kinds.get(str(tree.names[index]), "")
        carrier, place = places[int(tree.parents[index])]
        place = place * tree.jointPlacements[index]
        if kind == "FIXED":
            places[index] = carrier, place
        elif kind.startswith("UJOINT"):
            first = model.addJoint(carrier, hinges[kind[-2]](), place, f"{name}_r{kind[-2].lower()}")
            second = model.addJoint(first, hinges[kind[-1]](), pin.SE3.Identity(), f"{name}_r{kind[-1].lower()}")
            places[index] = second, pin.SE3.Identity()
        else:
            joint = pin.JointModelSpherical() if kind else tree.joints[index]
            places[index] = model.addJoint(carrier, joint, place, name), pin.SE3.Identity()
        model.appendBodyToJoint(places[index][0], tree.inertias[index], places[index][1])
    for frame in tree.frames:
        carrier, place = places[int(frame.parentJoint)]
        model.addFrame(pin.Frame(frame.name, carrier, place * frame.placement, pin.FrameType.OP_FRAME))
    return model


def in_order(robot: rp.Robot, model: pin.Model, vector: Array, attribute: str) -> Array:
    """Return a configuration or velocity of the robot in the order of the model."""
    at, count = f"idx_{attribute}", f"n{attribute}"
    result = np.zeros(getattr(model, count))
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        own = robot.model.joints[robot.model.getJointId(name)]
        start, size = getattr(own, at), getattr(own, count)
        result[getattr(joint, at) : getattr(joint, at) + size] = vector[start : start + size]
    return result


@pytest.mark.parametrize(("joints", "content"), [(PLANAR, PLANAR_YAML), (ANKLE, ANKLE_YAML)], ids=["planar", "ankle"])
def test_accelerations_are_those_of_pinocchio(joints: list[J], content: dict, tmp_path: Path) -> None:
    robot = rp.load_robot(written(tmp_path, joints, content))
    assert robot.name == tmp_path.name
    assert robot.actuated == tuple(content["name_mot"])
    assert (robot.model.lowerPositionLimit < -1.0).all()
    assert (robot.model.upperPositionLimit > 1.0).all()
    model = model_by_hand((tmp_path / "robot.urdf").read_text(), content)
    assert (model.nq, model.nv) == (robot.model.nq, robot.model.nv)
    ((one, other),) = content["closed_loop"]
    ends, data = tuple(model.frames[model.getFrameId(name)] for name in (one, other)), model.createData()
    rng = np.random.default_rng(2)
    x, xd = home_of(robot)[None] + 0.05, rng.normal(size=(1, robot.n))
    lifted = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], x, xd, 0.0 * xd))
    tau = rng.normal(size=robot.m)
    force = np.zeros(robot.model.nv)
    force[robot.actuated_velocity] = tau
    q, v, u = (
        in_order(robot, model, vector, kind) for vector, kind in ((lifted.q[0], "q"), (lifted.v[0], "v"), (force, "v"))
    )
    pin.framesForwardKinematics(model, data, q)
    gap = data.oMf[model.getFrameId(one)].inverse() * data.oMf[model.getFrameId(other)]
    assert np.abs(pin.log6(gap).vector).max() < 1e-9
    a = accelerations(model, [ends], pin.ContactType.CONTACT_6D, q, v, u)
    rates = [model.joints[model.getJointId(name)].idx_v for name in robot.independent_joints]
    motion = rp.PlatformMotion([0.0], x, xd, a[rates][None])
    np.testing.assert_allclose(
        in_order(robot, model, rp.inverse_kinematics(robot, motion).a[0], "v"), a, rtol=1e-8, atol=1e-8
    )
    reduced = rp.RneaDynamics(robot).reduce(motion)
    np.testing.assert_allclose(reduced.f[0], reduced.W[0] @ tau, rtol=1e-7, atol=1e-7 * np.abs(reduced.f).max())


def test_a_declaration_of_ones_own_has_balls_and_universal_joints(tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir()
    theirs = rp.load_robot(written(tmp_path / "theirs", ANKLE, ANKLE_YAML))
    kinds = {"cross": "universal_xy", "rod_ball": "ball", "foot_cross": "universal_zy", "held": "fixed"}
    positions = {
        str(name): float(theirs.q_reference[joint.idx_q])
        for name, joint in zip(list(theirs.model.names)[1:], list(theirs.model.joints)[1:], strict=True)
        if joint.nq == 1
    }
    declaration = {
        "gravity": [0, 0, -9.81],
        "joint_types": kinds,
        "closures": [{"frames": [c.frame_a, c.frame_b], "axes": list(c.axes)} for c in theirs.closures],
        "actuated": ["motor"],
        "independent": {"joints": list(theirs.independent_joints)},
        "reference": {
            "joints": {name: positions[name] for name in theirs.independent_joints},
            "guess": {name: at for name, at in positions.items() if name not in theirs.independent_joints},
        },
    }
    urdf = (tmp_path / "theirs" / "robot.urdf").read_text()
    robot = rp.load_robot(write_robot(tmp_path, urdf, declaration))
    apart = pin.difference(robot.model, np.array(robot.q_reference), np.array(theirs.q_reference))
    np.testing.assert_allclose(apart, 0.0, atol=1e-7)
    x = home_of(theirs)[None]
    motion = rp.PlatformMotion([0.0], x, np.ones_like(x), -np.ones_like(x))
    ours, expected = (rp.RneaDynamics(each).reduce(motion) for each in (robot, theirs))
    np.testing.assert_allclose(ours.f, expected.f, rtol=1e-7, atol=1e-7)
    for change, message in (({"cross": "universal"}, "joint_types"), ({"crosses": "ball"}, "no joint 'crosses'")):
        with pytest.raises(DeclarationError, match=message):
            rp.load_robot(write_robot(tmp_path, urdf, {**declaration, "joint_types": change}))


def test_a_base_that_moves_and_a_declaration_of_ones_own(tmp_path: Path) -> None:
    free = rp.load_robot(written(tmp_path, PLANAR, PLANAR_YAML), base="free")
    six = {f"base_{axis}" for axis in ("x", "y", "z", "rz", "ry", "rx")}
    assert six < set(free.independent_joints)
    assert free.independent_joints[:2] == ("motor_2", "motor_1")
    own = tmp_path / "own"
    own.mkdir()
    content = {"urdf": "../robot.yaml", "reference": {"guess": {"motor_1": 0.1}}, "actuated": ["motor_1"]}
    (own / "robot.yaml").write_text(yaml.safe_dump(content))
    assert rp.load_robot(own).actuated == ("motor_1",)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"closed_loop": [["loop_A", "loop_C"]]}, "no frame 'loop_C'"),
        ({"type": ["5d"]}, r"type\[0\]"),
        ({"type": ["6d", "6d"]}, "a list of 1"),
        ({"joint_name": ["elbow_1"], "joint_type": ["UJOINT_XX"]}, "UJOINT_XX"),
        ({"name_mot": ["motor_3"]}, "no moving joint 'motor_3'"),
        ({"joint_nam": ["elbow_1"]}, "joint_nam"),
        ({"closed_loop": [["loop_A", "loop_B"]] * 121, "type": ["6d"] * 121}, "121 closures, more than the 120"),
    ],
)
def test_mistakes_are_named(change: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(DeclarationError, match=message):
        rp.load_robot(written(tmp_path, PLANAR, PLANAR_YAML | change))


def test_files_beside_it_and_names_that_are_not_there(tmp_path: Path) -> None:
    content = PLANAR_YAML | {"joint_name": ["elbow_9"], "joint_type": ["SPHERICAL"], "type": []}  # all are welds
    robot = rp.load_robot(written(tmp_path, PLANAR, content))
    assert any("Passed over" in note and "elbow_9" in note for note in robot.notes)
    (tmp_path / "robot.urdf").rename(tmp_path / "one.urdf")
    assert rp.load_robot(tmp_path).n == robot.n
    (tmp_path / "two.urdf").write_text("<robot/>")
    with pytest.raises(ModelFileError, match="holds 2"):
        rp.load_robot(tmp_path)
    with pytest.raises(InputError, match="no argument 'bases'"):
        rp.load_robot(written(tmp_path, PLANAR, PLANAR_YAML), bases="free")
