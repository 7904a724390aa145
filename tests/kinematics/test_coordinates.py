"""Independent coordinates: reading, differences, moves, scales, and working modes read off configurations."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from spatial_chains import chain_of

from redundancy_pin.kinematics.assembly import integrate
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
from redundancy_pin.robot import Robot

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
