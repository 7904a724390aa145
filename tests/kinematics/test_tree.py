"""Trees of any joints: which of them are covered, what moves a frame, and rows between frames against Pinocchio."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from test_closure import assert_derivatives, two_free_bodies

from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics import tree
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.robot import AXES, Closure, Platform, Robot

ROUNDING = 2e-12
"""Both sides do the same few dozen multiplications on numbers of order ten: a thousand roundings of slack."""

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
    "revolute": pin.JointModelRY(),
    "revolute skew": pin.JointModelRevoluteUnaligned(SKEW_AXIS),
    "continuous": pin.JointModelRUBZ(),
    "continuous skew": skew_continuous(),
    "prismatic": pin.JointModelPX(),
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


def random_placement(rng: np.random.Generator) -> pin.SE3:
    quaternion = rng.normal(size=4)
    return pin.SE3(pin.Quaternion(quaternion / np.linalg.norm(quaternion)).matrix(), rng.uniform(-1.0, 1.0, 3))


def robot_of(joints: list[pin.JointModel], seed: int, closed: tuple[str, str], axes: tuple[str, ...] = AXES) -> Robot:
    """Return a tree of joints on random earlier ones, each with a skew frame, and one closure between two frames."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    for index, joint in enumerate(joints):
        number = model.addJoint(int(rng.integers(0, index + 1)), joint, random_placement(rng), f"joint_{index}")
        model.addBodyFrame(f"body_{index}", number, random_placement(rng), 0)
    closure = Closure("tie", *closed, axes)
    return dataclasses.replace(two_free_bodies(AXES), model=model, closures=(closure,), q_reference=pin.neutral(model))


@examples(30)
@given(kinds=st.lists(st.sampled_from(sorted(JOINTS)), min_size=2, max_size=6), seed=st.integers(0, 2**16))
def test_rows_between_the_bodies_of_any_tree(kinds: list[str], seed: int) -> None:
    """Residuals from Pinocchio's placements; Jacobian, its rate and those of a platform from differences."""
    rng = np.random.default_rng(seed)
    first, second = rng.choice(len(kinds), 2, replace=False)
    frames = f"body_{first}", f"body_{second}"
    robot = robot_of([JOINTS[kind] for kind in kinds], seed, frames, ("x", "y", "z", "rx"))
    robot = dataclasses.replace(robot, platform=Platform(frames[1], AXES))
    q, _ = zoo.random_tree(robot, seed, 3)
    system, data = ConstraintSystem(robot), robot.model.createData()
    state = system.evaluate(q)
    for k, configuration in enumerate(q):
        pin.framesForwardKinematics(robot.model, data, configuration)
        a, b = (data.oMf[robot.model.getFrameId(name)] for name in frames)
        relative = a.actInv(b)
        np.testing.assert_allclose(state.phi[k, :3], relative.translation, atol=ROUNDING)
        np.testing.assert_allclose(state.phi[k, 3], relative.rotation[2, 1], atol=ROUNDING)  # e_z of a · e_y of b
    assert_derivatives(system, q, rng)


@pytest.mark.parametrize("kind", UNSUPPORTED)
def test_an_unsupported_joint_is_named_where_a_closure_needs_it(kind: str) -> None:
    joints = [pin.JointModelRX(), UNSUPPORTED[kind], pin.JointModelRY()]
    with pytest.raises(UnsupportedRobotError, match=r"'joint_1'.*JointModel") as caught:
        ConstraintSystem(robot_of(joints, 0, ("body_0", "body_1")))
    assert caught.value.details["joint"] == "joint_1"
    assert "revolute" in caught.value.remedy
    ConstraintSystem(robot_of(joints, 0, ("body_0", "body_0")))  # beside the frames in use it does not matter


def test_support_is_what_moves_a_frame() -> None:
    robot = zoo.robot_of("3rrr")
    support = ConstraintSystem(robot).support
    at = {name: robot.model.joints[robot.model.getJointId(name)].idx_v for name in robot.model.names[1:]}
    assert set(np.flatnonzero(support["tip_2"])) == {at["base_2"], at["elbow_2"]}
    assert set(np.flatnonzero(support["platform"])) == {at["base_1"], at["elbow_1"], at["wrist_1"]}


def test_a_link_and_a_joint_of_the_same_name_are_not_confused() -> None:
    robot = robot_of([pin.JointModelRX(), pin.JointModelRX()], 0, ("arm", "body_0"))
    model, place = robot.model, pin.SE3(np.eye(3), np.array([0.0, 0.0, 2.0]))
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "arm")
    model.addJointFrame(joint, 0)
    model.addBodyFrame("arm", joint, place, 0)
    state = ConstraintSystem(dataclasses.replace(robot, platform=Platform("arm", AXES))).evaluate(np.zeros((1, 3)))
    np.testing.assert_allclose(state.placement("arm")[1][:, 0], [0.0, 0.0, 2.0])


def test_another_layout_of_pinocchios_memory_is_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = zoo.robot_of("3rrr")
    q, v = zoo.random_tree(robot, 1, 1)
    expected = tree.TreePlacement(robot.model)
    expected.place_moving(q[0], v[0])
    monkeypatch.setattr(tree, "_address", lambda array: id(array))
    copied = tree.TreePlacement(robot.model)
    copied.place_moving(q[0], v[0])
    assert np.shares_memory(expected.vectors, np.asarray(expected.data.oMf[1].translation))
    np.testing.assert_array_equal(copied.vectors, expected.vectors)
    assert not np.shares_memory(copied.vectors, np.asarray(copied.data.oMf[1].translation))
