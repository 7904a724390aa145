"""Batched tree kinematics against Pinocchio, joint type by joint type."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics.assembly import integrate
from redundancy_pin.kinematics.tree import TreeKinematics, cross
from redundancy_pin.robot import Robot

# Both sides do the same few dozen multiplications on numbers of order ten: a thousand roundings of slack.
ROUNDING = 2e-12

SKEW_AXIS = np.array([0.36, -0.48, 0.8])


def skew_continuous() -> pin.JointModel:
    """Return a continuous joint about a skew axis, which only the URDF reader can make."""
    text = f"""<robot name="skew"><link name="a"/><link name="b"/>
    <joint name="j" type="continuous"><parent link="a"/><child link="b"/>
    <axis xyz="{" ".join(map(str, SKEW_AXIS))}"/></joint></robot>"""
    return pin.buildModelFromXML(text).joints[1]


def two_in_one() -> pin.JointModel:
    joint = pin.JointModelComposite(2)
    joint.addJoint(pin.JointModelRX(), pin.SE3.Identity())
    joint.addJoint(pin.JointModelRY(), pin.SE3.Identity())
    return joint


JOINTS = {
    "revolute x": pin.JointModelRX(),
    "revolute y": pin.JointModelRY(),
    "revolute z": pin.JointModelRZ(),
    "revolute skew": pin.JointModelRevoluteUnaligned(SKEW_AXIS),
    "revolute against z": pin.JointModelRevoluteUnaligned(np.array([0.0, 0.0, -1.0])),
    "continuous x": pin.JointModelRUBX(),
    "continuous y": pin.JointModelRUBY(),
    "continuous z": pin.JointModelRUBZ(),
    "continuous skew": skew_continuous(),
    "prismatic x": pin.JointModelPX(),
    "prismatic y": pin.JointModelPY(),
    "prismatic z": pin.JointModelPZ(),
    "prismatic skew": pin.JointModelPrismaticUnaligned(SKEW_AXIS),
    "prismatic against y": pin.JointModelPrismaticUnaligned(np.array([0.0, -1.0, 0.0])),
    "planar": pin.JointModelPlanar(),
    "spherical": pin.JointModelSpherical(),
    "translation": pin.JointModelTranslation(),
    "floating": pin.JointModelFreeFlyer(),
}

UNSUPPORTED = {
    "helical": pin.JointModelHZ(0.1),
    "spherical by three angles": pin.JointModelSphericalZYX(),
    "composite": two_in_one(),
}


def chain(joints: list[pin.JointModel], seed: int = 0, parents: list[int] | None = None) -> pin.Model:
    """Return an open chain of the joints, with skew placements, and a frame off the last body's origin.

    With ``parents`` a tree: each joint is on the body of that number, or on the world for −1; some placements are the
    identity, and some bodies have a second frame.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    for index, joint in enumerate(joints):
        parent = index - 1 if parents is None else parents[index]
        straight = parents is not None and rng.random() < 0.3
        placement = pin.SE3.Identity() if straight else random_placement(rng)
        number = model.addJoint(parent + 1, joint, placement, f"joint_{index}")
        model.addBodyFrame(f"body_{index}", number, pin.SE3.Identity() if straight else random_placement(rng), 0)
        if parents is not None and rng.random() < 0.3:
            model.addBodyFrame(f"second_{index}", number, random_placement(rng), 0)
    return model


def random_placement(rng: np.random.Generator) -> pin.SE3:
    quaternion = rng.normal(size=4)
    return pin.SE3(pin.Quaternion(quaternion / np.linalg.norm(quaternion)).matrix(), rng.uniform(-1.0, 1.0, 3))


def random_states(model: pin.Model, seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    neutral = np.repeat(pin.neutral(model)[None], count, axis=0)
    q = np.array(
        [pin.integrate(model, a, b) for a, b in zip(neutral, rng.uniform(-3, 3, (count, model.nv)), strict=True)]
    )
    return q, rng.uniform(-2.0, 2.0, (count, model.nv))


def assert_agrees_with_pinocchio(model: pin.Model, names: list[str], seed: int, count: int = 5) -> None:
    q, v = random_states(model, seed, count)
    tree = TreeKinematics(model, names)
    pose = tree.pose(q)
    motions = tree.motions(pose, v)
    data = model.createData()
    world = pin.ReferenceFrame.WORLD
    for i in range(count):
        pin.computeJointJacobians(model, data, q[i])
        pin.forwardKinematics(model, data, q[i], v[i], np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        for name in names:
            frame = model.getFrameId(name)
            placement = data.oMf[frame]
            np.testing.assert_allclose(pose.frame_rotation[name][:, :, i], placement.rotation, atol=ROUNDING)
            np.testing.assert_allclose(pose.frame_origin[name][:, i], placement.translation, atol=ROUNDING)
            jacobian = np.zeros((6, model.nv))
            columns = list(tree.support[name])
            jacobian[:, columns] = pose.jacobian[:, columns, i]
            expected = np.reshape(pin.getFrameJacobian(model, data, frame, world), (6, model.nv))
            np.testing.assert_allclose(jacobian, expected, atol=ROUNDING)
            velocity, acceleration = motions[name]
            expected = pin.getFrameVelocity(model, data, frame, world)
            np.testing.assert_allclose(velocity[:, i], expected.vector, atol=10 * ROUNDING)
            expected = pin.getFrameAcceleration(model, data, frame, world)
            np.testing.assert_allclose(acceleration[:, i], expected.vector, atol=100 * ROUNDING)


@pytest.mark.parametrize("kind", JOINTS)
def test_each_joint_type_between_two_hinges(kind: str) -> None:
    """A hinge before it and one behind it: the joint's own motion, what carries it and what it carries."""
    model = chain([pin.JointModelRevoluteUnaligned(SKEW_AXIS), JOINTS[kind], pin.JointModelRX()])
    assert_agrees_with_pinocchio(model, ["body_0", "body_1", "body_2"], seed=1)


@examples(15)
@given(kinds=st.lists(st.sampled_from(sorted(JOINTS)), min_size=1, max_size=5), seed=st.integers(0, 2**16))
def test_any_chain_of_joints(kinds: list[str], seed: int) -> None:
    model = chain([JOINTS[kind] for kind in kinds], seed)
    assert_agrees_with_pinocchio(model, [f"body_{len(kinds) - 1}"], seed, count=3)


@pytest.mark.parametrize("seed", range(20))
def test_any_tree_with_many_joints_of_a_kind(seed: int) -> None:
    """Joints of one kind at one depth are placed together, whatever kinds their parents have."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice(rng.choice(sorted(JOINTS), 3, replace=False), 10).tolist()
    model = chain([JOINTS[kind] for kind in kinds], seed, [int(rng.integers(-1, min(k, 5))) for k in range(10)])
    bodies = [str(frame.name) for frame in model.frames if frame.type == pin.FrameType.BODY]
    assert_agrees_with_pinocchio(model, rng.permutation(bodies)[: len(bodies) - seed % 4].tolist(), seed, count=2)


def test_shipped_robots_on_open_chains(shipped: Robot) -> None:
    frames = [name for closure in shipped.closures for name in (closure.frame_a, closure.frame_b)]
    assert_agrees_with_pinocchio(shipped.model, list(dict.fromkeys(frames)), seed=3)


@pytest.mark.parametrize("kind", UNSUPPORTED)
def test_an_unsupported_joint_is_named(kind: str) -> None:
    model = chain([pin.JointModelRX(), UNSUPPORTED[kind]])
    with pytest.raises(UnsupportedRobotError, match=r"'joint_1'.*JointModel") as caught:
        TreeKinematics(model, ["body_1"])
    assert caught.value.details["joint"] == "joint_1"
    assert "revolute" in caught.value.remedy


def test_a_joint_beside_the_followed_frames_may_have_any_type() -> None:
    model = chain([pin.JointModelRX(), UNSUPPORTED["helical"]])
    assert_agrees_with_pinocchio(model, ["body_0"], seed=5)


def test_support_lists_the_velocities_a_frame_depends_on() -> None:
    robot = zoo.robot_of("3rrr")
    tree = TreeKinematics(robot.model, ["tip_2", "platform", "base"])
    index = {name: robot.model.joints[robot.model.getJointId(name)].idx_v for name in robot.model.names[1:]}
    assert set(tree.support["tip_2"]) == {index["base_2"], index["elbow_2"]}
    assert set(tree.support["platform"]) == {index["base_1"], index["elbow_1"], index["wrist_1"]}
    assert tree.support["base"] == ()


def test_a_link_and_a_joint_of_the_same_name_are_not_confused() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "arm")
    model.addJointFrame(joint, 0)
    model.addBodyFrame("arm", joint, pin.SE3(np.eye(3), np.array([0.0, 0.0, 2.0])), 0)
    origin = TreeKinematics(model, ["arm"]).pose(np.zeros((1, 1))).frame_origin["arm"]
    np.testing.assert_allclose(origin[:, 0], [0.0, 0.0, 2.0])


def test_pose_of_many_samples_equals_pose_of_each() -> None:
    model = chain([JOINTS["floating"], JOINTS["continuous skew"], JOINTS["prismatic skew"]])
    q, v = random_states(model, 8, 7)
    tree = TreeKinematics(model, ["body_2"])
    _, total = tree.motions(tree.pose(q), v)["body_2"]
    for i in range(len(q)):
        _, alone = tree.motions(tree.pose(q[i : i + 1]), v[i : i + 1])["body_2"]
        np.testing.assert_array_equal(total[:, i], alone[:, 0])


def test_bias_is_the_derivative_of_velocity_at_constant_rates() -> None:
    """Independent of Pinocchio: integrate the joints at constant v and difference the frame's spatial velocity."""
    model = chain([JOINTS["planar"], JOINTS["revolute skew"], JOINTS["prismatic skew"], JOINTS["spherical"]])
    q, v = random_states(model, 9, 4)
    tree = TreeKinematics(model, ["body_3"])
    step = 1e-5

    def velocity(time: float) -> np.ndarray:
        moved = integrate(model, q, v * time)
        return tree.motions(tree.pose(moved), v)["body_3"][0]

    expected = (velocity(step) - velocity(-step)) / (2 * step)
    # central differences: truncation step² times third derivatives (~1e2), rounding 1e-15/step
    np.testing.assert_allclose(tree.motions(tree.pose(q), v)["body_3"][1], expected, atol=1e-7)


def test_cross_is_numpys() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 3, 6))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b, axis=0), atol=1e-15)
