"""Closure rows between the bodies of any tree, and independent coordinates: against Pinocchio and differences."""

from __future__ import annotations

import dataclasses
import itertools
from types import MappingProxyType

import numpy as np
import pinocchio as pin
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from spatial_chains import CHAINS, chain_of

from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics.assembly import integrate
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import (
    all_working_modes,
    coordinates,
    difference,
    in_working_mode,
    mode_indicator,
    mode_name,
    moved,
    reference_coordinates,
    working_modes,
)
from redundancy_pin.robot import AXES, Closure, Platform, Robot

MASKS = tuple(mask for size in range(1, 7) for mask in itertools.combinations(AXES, size))
ROD, LENGTH = ("distance",), 0.7
PLACEMENT_A = pin.SE3(Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), np.array([0.1, 0.3, -0.2]))
PLACEMENT_B = pin.SE3(Rotation.from_rotvec([-0.4, 0.1, 0.7]).as_matrix(), np.array([-0.3, 0.2, 0.1]))

STEP = 1e-5
# Central differences with STEP on functions of order one: truncation STEP², rounding 1e-16 / STEP.
DIFFERENCES = 2e-9
BENDS = 50 * DIFFERENCES  # the same of Jacobians along a velocity of order one
ONE_OF_MANY = 1e-13  # sums of a dozen products of order one, in another order


def two_free_bodies(axes: tuple[str, ...]) -> Robot:
    """Return two floating bodies joined by one closure, frames off both origins: every mask can be judged on it."""
    model = pin.Model()
    for name, placement in (("a", PLACEMENT_A), ("b", PLACEMENT_B)):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"{name}_joint")
        model.addBodyFrame(name, joint, placement, 0)
    return Robot(
        name="pair",
        parameters=MappingProxyType({}),
        urdf="",
        model=model,
        closures=(Closure("pair", "a", "b", axes, LENGTH if axes == ROD else 0.0),),
        platform=None,
        independent_joints=(),
        actuated=(),
        carriers=(),
        carrier_limits=(),
        q_reference=pin.neutral(model),
        working_modes=None,
        working_mode=(),
        characteristic_length=1.0,
        closed_form=None,
    )


def configuration(model: pin.Model, pose_a: pin.SE3, relative: pin.SE3) -> np.ndarray:
    """Return q (1, nq) with frame a at ``pose_a`` and frame b at ``relative`` seen from it."""
    body_a = pose_a * PLACEMENT_A.inverse()
    body_b = pose_a * relative * PLACEMENT_B.inverse()
    return np.concatenate([pin.SE3ToXYZQUAT(body_a), pin.SE3ToXYZQUAT(body_b)])[None]


def closed_relative(axes: tuple[str, ...], rng: np.random.Generator) -> pin.SE3:
    """Return a random relative placement that the mask allows."""
    if axes == ROD:
        return pin.SE3(Rotation.random(random_state=rng).as_matrix(), LENGTH * random_pose(rng).rotation[:, 0])
    translation = np.where([axis in axes for axis in AXES[:3]], 0.0, rng.uniform(-1.0, 1.0, 3))
    rows = [k for k in range(3) if AXES[3 + k] in axes]
    free = [k for k in range(3) if k not in rows]
    if len(rows) == 3:
        turn = Rotation.identity()
    elif len(rows) == 2:  # a hinge, at any angle
        turn = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi) * np.eye(3)[free[0]])
    elif len(rows) == 1:  # a universal joint: about the second free axis of A, then the first free axis of B
        i, j = (rows[0] + 1) % 3, (rows[0] + 2) % 3
        outer, inner = rng.uniform(-np.pi, np.pi, 2)
        turn = Rotation.from_rotvec(outer * np.eye(3)[j]) * Rotation.from_rotvec(inner * np.eye(3)[i])
    else:
        turn = Rotation.random(random_state=rng)
    return pin.SE3(turn.as_matrix(), translation)


def random_pose(rng: np.random.Generator) -> pin.SE3:
    return pin.SE3(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1.0, 1.0, 3))


@pytest.mark.parametrize("axes", [*MASKS, ROD], ids="".join)
def test_every_mask_closes_where_its_joint_allows_and_has_no_redundant_row(axes: tuple[str, ...]) -> None:
    robot = two_free_bodies(axes)
    system = ConstraintSystem(robot)
    rng = np.random.default_rng(len(axes))
    for _ in range(5):
        q = configuration(robot.model, random_pose(rng), closed_relative(axes, rng))
        state = system.evaluate(q)
        # products of a few rotations with entries of order one
        np.testing.assert_allclose(state.phi, 0.0, atol=1e-14)
        # rows have unit size by construction, so a well-conditioned set stays far from zero at every hinge angle
        assert np.linalg.svd(state.Jc[0], compute_uv=False).min() > 0.1


@pytest.mark.parametrize("free", range(3))
def test_hinge_rows_stay_independent_all_around(free: int) -> None:
    """Rows that paired fixed axes of both frames would fall together at a quarter turn."""
    robot = two_free_bodies((*AXES[:3], *(axis for axis in AXES[3:] if axis != AXES[3 + free])))
    system, pose = ConstraintSystem(robot), random_pose(np.random.default_rng(free))
    for angle in np.linspace(0.0, 2 * np.pi, 25):
        turn = pin.SE3(Rotation.from_rotvec(angle * np.eye(3)[free]).as_matrix(), np.zeros(3))
        jacobian = system.evaluate(configuration(robot.model, pose, turn)).Jc[0]
        assert np.linalg.svd(jacobian, compute_uv=False).min() > 0.5


@pytest.mark.parametrize("axes", [*MASKS, ROD], ids="".join)
def test_jacobian_and_bias_are_derivatives_on_and_off_the_manifold(axes: tuple[str, ...]) -> None:
    robot = two_free_bodies(axes)
    system = ConstraintSystem(robot)
    rng = np.random.default_rng(7)
    on = configuration(robot.model, random_pose(rng), closed_relative(axes, rng))
    off = configuration(robot.model, random_pose(rng), random_pose(rng))
    assert_derivatives(system, np.concatenate([on, off]), rng)


def assert_derivatives(system: ConstraintSystem, q: np.ndarray, rng: np.random.Generator) -> None:
    model = system.robot.model
    state = system.evaluate(q)
    for column in range(model.nv):
        step = np.tile(STEP * np.eye(model.nv)[column], (len(q), 1))
        after = system.evaluate(integrate(model, q, step)).phi
        before = system.evaluate(integrate(model, q, -step)).phi
        np.testing.assert_allclose(state.Jc[:, :, column], (after - before) / (2 * STEP), atol=DIFFERENCES)
    v = rng.uniform(-1.0, 1.0, (len(q), model.nv))
    after, before = (system.evaluate(integrate(model, q, sign * STEP * v)) for sign in (1.0, -1.0))
    chain = ClosedChain(system.robot)
    for k in range(len(q)):
        chain.update(q[k], v[k])
        for one, many in ((chain.relative_residual() * chain.closure_unit, state.phi), (chain.jacobian(), state.Jc)):
            np.testing.assert_allclose(one, many[k], atol=ONE_OF_MANY)
        np.testing.assert_allclose(chain.bias(), (after.Jc[k] - before.Jc[k]) @ v[k] / (2 * STEP), atol=BENDS)
        np.testing.assert_allclose(
            chain.full_rate()[: chain.rows], (after.Jc[k] - before.Jc[k]) / (2 * STEP), atol=BENDS
        )
        np.testing.assert_allclose(chain.platform_jacobian(), state.Jx[k], atol=ONE_OF_MANY)
        np.testing.assert_allclose(
            chain.full_rate()[chain.rows :], (after.Jx[k] - before.Jx[k]) / (2 * STEP), atol=BENDS
        )


@pytest.mark.parametrize("name", [*zoo.SHIPPED, "3rps", *CHAINS])
def test_derivatives_on_robots_closed_and_open(name: str) -> None:
    robot = chain_of(name) if name in CHAINS else zoo.robot_of(name)
    q, v = zoo.random_tree(robot, 4, 3)
    if name in zoo.SHIPPED:
        q = np.concatenate([q, zoo.random_closed(robot, 4, 3)])
    system, chain = zoo.system_of(robot), ClosedChain(robot)
    assert_derivatives(system, q, np.random.default_rng(5))
    places = coordinates(robot, system.evaluate(q))
    for each, place in zip(q, places, strict=True):
        chain.update(each, v[0])
        np.testing.assert_allclose(coordinates(robot, chain), place, atol=ONE_OF_MANY)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("axes", [AXES, AXES[:3] + AXES[3:5], AXES[1:3] + AXES[4:], ("x", "y", "z", "rx")])
def test_a_row_measures_the_displacement_it_is_named_after(axis: str, axes: tuple[str, ...]) -> None:
    """Frame b displaced along or turned about one axis of frame a: that row reads it, the others read nothing."""
    robot = two_free_bodies(axes)
    amount = 0.2
    k = AXES.index(axis)
    unit = np.eye(3)[k % 3]
    relative = (
        pin.SE3(np.eye(3), amount * unit)
        if k < 3
        else pin.SE3(Rotation.from_rotvec(amount * unit).as_matrix(), np.zeros(3))
    )
    q = configuration(robot.model, random_pose(np.random.default_rng(k)), relative)
    phi = ConstraintSystem(robot).evaluate(q).phi[0]
    expected = [(amount if k < 3 else np.sin(amount)) if name == axis else 0.0 for name in axes]
    np.testing.assert_allclose(phi, expected, atol=1e-14)


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar", "gough", "pair", "hinge"])
def test_platform_rows_are_the_frames_world_aligned_jacobian(name: str) -> None:
    """Whatever closures are beside them: some rows of a hinge have the other sign."""
    if name in ("pair", "hinge"):
        axes = AXES if name == "pair" else ("x", "y", "z", "rx", "ry")
        robot = dataclasses.replace(two_free_bodies(axes), platform=Platform("a", AXES))
    else:
        robot = zoo.robot_of(name)
    q, _ = zoo.random_tree(robot, 2, 3)
    assert robot.platform is not None
    rows, frame = [AXES.index(axis) for axis in robot.platform.axes], robot.model.getFrameId(robot.platform.frame)
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for each, jx in zip(q, ConstraintSystem(robot).evaluate(q).Jx, strict=True):
        expected = pin.computeFrameJacobian(robot.model, robot.model.createData(), each, frame, world)
        np.testing.assert_allclose(jx, expected[rows], atol=1e-12)


OTHER_ORDER = 2e-12
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


def robot_of(joints: list[pin.JointModel], seed: int, closed: tuple[str, str], axes: tuple[str, ...] = AXES) -> Robot:
    """Return a tree of joints on random earlier ones, each with a skew frame, and one closure between two frames."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    for index, joint in enumerate(joints):
        number = model.addJoint(int(rng.integers(0, index + 1)), joint, random_pose(rng), f"joint_{index}")
        model.addBodyFrame(f"body_{index}", number, random_pose(rng), 0)
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
        np.testing.assert_allclose(state.phi[k, :3], relative.translation, atol=OTHER_ORDER)
        np.testing.assert_allclose(state.phi[k, 3], relative.rotation[2, 1], atol=OTHER_ORDER)  # e_z of a · e_y of b
    assert_derivatives(system, q, rng)


@pytest.mark.parametrize("kind", UNSUPPORTED)
def test_an_unsupported_joint_is_named_where_a_closure_needs_it(kind: str) -> None:
    joints = [pin.JointModelRX(), UNSUPPORTED[kind], pin.JointModelRY()]
    with pytest.raises(UnsupportedRobotError, match=r"'joint_1'.*JointModel") as caught:
        ConstraintSystem(robot_of(joints, 0, ("body_0", "body_1")))
    assert caught.value.details["joint"] == "joint_1"
    assert "revolute" in caught.value.remedy
    ConstraintSystem(robot_of(joints, 0, ("body_0", "body_0")))  # beside the frames in use it does not matter


def test_a_link_and_a_joint_of_the_same_name_are_not_confused() -> None:
    robot = robot_of([pin.JointModelRX(), pin.JointModelRX()], 0, ("arm", "body_0"))
    model, place = robot.model, pin.SE3(np.eye(3), np.array([0.0, 0.0, 2.0]))
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "arm")
    model.addJointFrame(joint, 0)
    model.addBodyFrame("arm", joint, place, 0)
    state = ConstraintSystem(dataclasses.replace(robot, platform=Platform("arm", AXES))).evaluate(np.zeros((1, 3)))
    np.testing.assert_allclose(state.placement("arm")[1][:, 0], [0.0, 0.0, 2.0])


# --- independent coordinates and working modes


ROUNDING = 1e-13


@examples(25)
@given(name=st.sampled_from(zoo.SHIPPED), seed=st.integers(0, 2**16))
def test_moved_and_difference_are_inverse(name: str, seed: int) -> None:
    robot = zoo.robot_of(name)
    rng = np.random.default_rng(seed)
    start = np.repeat(zoo.home_of(robot)[None], 5, axis=0)
    increment = rng.uniform(-1.5, 1.5, (5, robot.n))
    np.testing.assert_allclose(difference(robot, moved(robot, start, increment), start), increment, atol=ROUNDING)


def test_differences_are_taken_with_the_jacobian_of_the_platform(shipped: Robot) -> None:
    """To first order the increment of a step in q is J_x times the step: both speak of the same twist."""
    system = zoo.system_of(shipped)
    q = zoo.random_closed(shipped, 3, 4)
    step = 1e-6 * np.random.default_rng(3).uniform(-1.0, 1.0, (4, shipped.model.nv))
    state = system.evaluate(q)
    after = coordinates(shipped, system.evaluate(integrate(shipped.model, q, step)))
    before = coordinates(shipped, system.evaluate(integrate(shipped.model, q, -step)))
    expected = np.einsum("niv,nv->ni", state.Jx, 2 * step)
    np.testing.assert_allclose(difference(shipped, after, before), expected, atol=1e-14)


def test_angles_go_the_short_way_round_and_lengths_do_not() -> None:
    robot, turn = zoo.robot_of("3rrr"), 2.0 * np.pi
    for target, start, expected in ((3.0, -3.0, 6.0 - turn), (0.5, 0.2, 0.3), (7.0, 0.7, 6.3 - turn)):
        found = difference(robot, np.array([[9.0, -7.0, target]]), np.array([[1.0, 1.0, start]]))
        np.testing.assert_allclose(found, [[8.0, -8.0, expected]], atol=ROUNDING)


def test_angles_of_platforms_and_of_continuous_joints_are_read_from_configurations() -> None:
    for robot, name, axis in ((zoo.robot_of("3rrr"), "wrist_1", 2), (chain_of("continuous"), "crank", 0)):
        step = np.eye(robot.model.nv)[None, robot.model.joints[robot.model.getJointId(name)].idx_v] * 1.5
        turned = integrate(robot.model, robot.q_reference[None], step)
        read = coordinates(robot, zoo.system_of(robot).evaluate(turned))[0]
        assert read[axis] - zoo.home_of(robot)[axis] == pytest.approx(1.5)


def test_reference_numbers_are_coordinates_or_the_urdfs_fixed_axis_angles() -> None:
    pose = reference_coordinates(zoo.robot_of("gough"), (0.1, 0.2, 0.3, 0.4, 0.5, 0.6))[0]
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_euler("xyz", (0.4, 0.5, 0.6)).as_matrix(), atol=ROUNDING)
    np.testing.assert_allclose(pose[:, 3], [0.1, 0.2, 0.3, 1.0])
    np.testing.assert_array_equal(reference_coordinates(zoo.robot_of("3rrr"), (0.1, 0.2, 0.3)), [[0.1, 0.2, 0.3]])


def test_modes_are_signs_of_sines_and_of_positions() -> None:
    """In the 3-RRR, whose mode +1 has a negative elbow, in the 2-RPR and of a joint without end."""
    three, two, endless = zoo.robot_of("3rrr"), zoo.robot_of("2rpr"), chain_of("continuous")
    q = np.repeat(three.q_reference[None], 3, axis=0)
    q[:, zoo.index(three, "elbow_2")] = [0.3, -0.3 + 2 * np.pi, 0.0]
    np.testing.assert_allclose(mode_indicator(three, q)[:, 1], [-np.sin(0.3), np.sin(0.3), 0.0], atol=1e-15)
    np.testing.assert_array_equal(working_modes(three, q)[:, 1], [-1, 1, 0])
    np.testing.assert_array_equal(in_working_mode(three, q), [False, True, False])
    q = np.repeat(two.q_reference[None], 2, axis=0)
    q[:, zoo.index(two, "slide_2")] = [0.4, -0.2]
    np.testing.assert_allclose(mode_indicator(two, q)[:, 1] * two.characteristic_length, [0.4, -0.2])
    q, at = endless.q_reference[None].copy(), zoo.index(endless, "coupler")
    q[0, at : at + 2] = [np.cos(0.7), np.sin(0.7)]
    assert mode_indicator(endless, q)[0, 0] == pytest.approx(np.sin(0.7))


def test_all_modes_are_listed_once_the_positive_first() -> None:
    for name, legs in (("four_bar", 1), ("five_bar", 2), ("3rrr", 3)):
        modes = all_working_modes(zoo.robot_of(name))
        assert len(set(modes)) == len(modes) == 2**legs
        assert modes[0] == (1,) * legs
        assert {sign for mode in modes for sign in mode} == {1, -1}
    free = chain_of("universal")
    assert in_working_mode(free, free.q_reference[None]).all()
    assert all_working_modes(free) == ((),)
    assert [mode_name(mode) for mode in ((1, -1, 1), ())] == ["+-+", ""]


@examples(20)
@given(seed=st.integers(0, 2**16))
def test_pin_rows_are_those_of_pinocchios_point_constraint(seed: int) -> None:
    robot = zoo.robot_of("3rrr")
    q = zoo.random_closed(robot, seed, 1)
    ours = zoo.system_of(robot).evaluate(q).Jc[0].reshape(2, 2, -1)
    assert np.linalg.matrix_rank(ours.reshape(4, -1)) == 4  # their third rows are redundant
    for rows, closure in zip(ours, robot.closures, strict=True):
        theirs = point_constraint_jacobian(robot, closure, q[0])[:2]
        # Pinocchio differences the other way round
        np.testing.assert_allclose(rows, -theirs, atol=1e-12)


def point_constraint_jacobian(robot: Robot, closure: Closure, q: np.ndarray) -> np.ndarray:
    """Return Pinocchio's Jacobian of the 3D point constraint, in the axes of frame a."""
    model = robot.model
    a, b = (model.frames[model.getFrameId(name)] for name in (closure.frame_a, closure.frame_b))
    constraint = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_3D,
        model,
        a.parentJoint,
        a.placement,
        b.parentJoint,
        b.placement,
        pin.ReferenceFrame.LOCAL,
    )
    data, constraint_data = model.createData(), constraint.createData()
    pin.computeJointJacobians(model, data, q)
    constraint.calc(model, data, constraint_data)
    return np.array(pin.getConstraintJacobian(model, data, constraint, constraint_data))
