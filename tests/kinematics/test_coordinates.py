"""Independent coordinates: reading, differences, moves and scales."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from spatial_chains import chain_of

from redundancy_pin.kinematics.assembly import integrate
from redundancy_pin.kinematics.coordinates import coordinates, difference, moved, reference_coordinates
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import column_scale, row_scale, turning_velocities, velocity_scale

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


@pytest.mark.parametrize(
    ("target", "start", "expected"), [(3.0, -3.0, 6.0 - 2 * np.pi), (0.5, 0.2, 0.3), (7.0, 0.7, 6.3 - 2 * np.pi)]
)
def test_angles_go_the_short_way_round(target: float, start: float, expected: float) -> None:
    robot = zoo.robot_of("3rrr")
    difference_of = difference(robot, np.array([[9.0, -7.0, target]]), np.array([[1.0, 1.0, start]]))
    np.testing.assert_allclose(difference_of, [[8.0, -8.0, expected]], atol=ROUNDING)


def test_lengths_do_not_wrap() -> None:
    robot = zoo.robot_of("2rpr")
    np.testing.assert_allclose(difference(robot, np.array([[9.0, -9.0]]), np.zeros((1, 2))), [[9.0, -9.0]])


def test_coordinates_read_the_angle_of_the_platform() -> None:
    robot = zoo.robot_of("3rrr")
    q = robot.q_reference[None].copy()
    wrist = zoo.index(robot, "wrist_1")
    x = coordinates(robot, zoo.system_of(robot).evaluate(q))
    q[0, wrist] += 2.5
    turned = coordinates(robot, zoo.system_of(robot).evaluate(q))
    assert turned[0, 2] - x[0, 2] == pytest.approx(2.5)


def test_continuous_independent_joints_are_read_as_angles() -> None:
    robot = chain_of("continuous")
    q = integrate(
        robot.model,
        robot.q_reference[None],
        np.eye(robot.model.nv)[None, robot.model.joints[robot.model.getJointId("crank")].idx_v] * 1.5,
    )
    assert coordinates(robot, zoo.system_of(robot).evaluate(q))[0, 0] == pytest.approx(2.5)


def test_scales_follow_the_joint_types() -> None:
    two, three, gough, four = (zoo.robot_of(name) for name in ("2rpr", "3rrr", "gough", "four_bar"))
    length = three.characteristic_length
    np.testing.assert_array_equal(row_scale(three), [1.0, 1.0, length])
    np.testing.assert_array_equal(column_scale(three), [length] * 3)
    np.testing.assert_array_equal(row_scale(two), [1.0, 1.0])
    np.testing.assert_array_equal(column_scale(two), [1.0, 1.0])
    np.testing.assert_array_equal(row_scale(gough), [1.0] * 3 + [gough.characteristic_length] * 3)
    np.testing.assert_array_equal(row_scale(four), [four.characteristic_length])


def test_turning_velocities_are_those_of_revolute_joints(shipped: Robot) -> None:
    expected = [
        "Revolute" in shipped.model.joints[i].shortname() or "ModelR" in shipped.model.joints[i].shortname()
        for i in range(1, shipped.model.njoints)
    ]
    np.testing.assert_array_equal(turning_velocities(shipped), expected)
    np.testing.assert_array_equal(velocity_scale(shipped), np.where(expected, shipped.characteristic_length, 1.0))


def test_reference_pose_uses_the_urdfs_fixed_axis_angles() -> None:
    robot = zoo.robot_of("gough")
    pose = reference_coordinates(robot, (0.1, 0.2, 0.3, 0.4, 0.5, 0.6))[0]
    import pinocchio as pin

    np.testing.assert_allclose(pose[:3, :3], pin.rpy.rpyToMatrix(0.4, 0.5, 0.6), atol=ROUNDING)
    np.testing.assert_allclose(pose[:, 3], [0.1, 0.2, 0.3, 1.0])


def test_reference_numbers_of_a_planar_robot_are_its_coordinates() -> None:
    np.testing.assert_array_equal(reference_coordinates(zoo.robot_of("3rrr"), (0.1, 0.2, 0.3)), [[0.1, 0.2, 0.3]])
