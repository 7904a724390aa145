"""One pose on the robot's branch: the straight way from the reference, or the search in the working mode."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin import load_robot
from redundancy_pin.arrays import CLOSURE_TOLERANCE
from redundancy_pin.errors import UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, in_working_mode, moved, working_modes
from redundancy_pin.kinematics.inverse_kinematics import point_on_branch
from redundancy_pin.kinematics.multistart import mixed_legs, multistart
from redundancy_pin.robot import Robot


@examples(20)
@given(name=st.sampled_from(zoo.SHIPPED), seed=st.integers(0, 2**16))
def test_the_pose_is_met_in_the_working_mode(name: str, seed: int) -> None:
    robot = zoo.robot_of(name)
    system = zoo.system_of(robot)
    increment = np.random.default_rng(seed).uniform(-1.0, 1.0, (1, robot.n)) * zoo.reach_of(robot)
    x = moved(robot, zoo.home_of(robot)[None], increment)
    state = system.evaluate(point_on_branch(system, x[0]).q[None])
    assert np.abs(state.phi).max() < CLOSURE_TOLERANCE
    np.testing.assert_allclose(difference(robot, x, coordinates(robot, state)), 0.0, atol=CLOSURE_TOLERANCE)
    assert in_working_mode(robot, state.q)[0]


@pytest.mark.long
def test_behind_an_obstacle_the_search_takes_over() -> None:
    """The straight way of the 2-RPR from home runs through the base hinge of leg 1, where the branch ends."""
    robot = zoo.robot_of("2rpr")
    system = zoo.system_of(robot)
    behind = -0.5 * zoo.home_of(robot)
    q = point_on_branch(system, behind).q
    assert in_working_mode(robot, q[None])[0]
    slides = [zoo.index(robot, f"slide_{leg}") for leg in (1, 2)]
    np.testing.assert_allclose(q[slides], [np.hypot(*behind), np.hypot(*(behind - [0.5, 0.0]))], atol=1e-10)


def test_out_of_reach_names_pose_gap_and_remedy() -> None:
    robot = zoo.robot_of("3rrr")
    with pytest.raises(UnreachablePoseError, match=r"sample 4, x = \[9.0, 9.0, 0.0\].*open by") as caught:
        point_on_branch(zoo.system_of(robot), np.array([9.0, 9.0, 0.0]), sample=4)
    assert caught.value.details["gap"] > 1.0
    assert "workspace" in caught.value.remedy


def test_each_mode_has_its_own_configuration_of_a_pose() -> None:
    pose = np.array([1.0])
    robots = [load_robot("four_bar", working_mode=mode) for mode in ((1,), (-1,))]
    q = np.stack([point_on_branch(ConstraintSystem(robot), pose).q for robot in robots])
    assert working_modes(robots[0], q).tolist() == [[1], [-1]]


def test_only_other_modes_close_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fault injected: the search finds closed configurations, but none that counts as the right mode."""
    from redundancy_pin.kinematics import inverse_kinematics as branch
    from redundancy_pin.kinematics import multistart as search_module

    robot = zoo.robot_of("five_bar")
    nowhere = lambda robot, q: np.zeros(len(q), dtype=bool)  # noqa: E731
    monkeypatch.setattr(branch, "in_working_mode", nowhere)
    monkeypatch.setattr(search_module, "in_working_mode", nowhere)
    with pytest.raises(WorkingModeError, match=r"closes only in other working modes than \+- of five_bar") as caught:
        point_on_branch(zoo.system_of(robot), zoo.home_of(robot), sample=2)
    assert caught.value.details["sample"] == 2
    assert "working_mode" in caught.value.remedy


def test_search_prefers_the_solution_nearest_to_the_guess(shipped: Robot) -> None:
    system = zoo.system_of(shipped)
    q, gap, closed = multistart(system, np.array(shipped.q_reference), zoo.home_of(shipped))
    assert closed
    assert gap < CLOSURE_TOLERANCE
    np.testing.assert_allclose(q, shipped.q_reference, atol=1e-9)


def test_search_finds_the_mode_from_a_guess_in_another() -> None:
    robot = zoo.robot_of("3rrr", working_mode=(1, -1, 1))
    other = zoo.robot_of("3rrr", working_mode=(-1, 1, -1))
    q, _, closed = multistart(zoo.system_of(robot), np.array(other.q_reference), zoo.home_of(robot))
    assert closed
    np.testing.assert_array_equal(working_modes(robot, q[None])[0], [1, -1, 1])


def test_search_is_the_same_every_time() -> None:
    robot = zoo.robot_of("3rrr", working_mode=(1, -1, 1))
    guess = np.array(zoo.robot_of("3rrr").q_reference)
    first, second = (multistart(zoo.system_of(robot), guess, zoo.home_of(robot))[0] for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_search_returns_angles_within_a_turn() -> None:
    robot = zoo.robot_of("3rrr")
    wound = np.array(robot.q_reference)
    wound[robot.actuated_velocity] += 2 * np.pi
    q, _, closed = multistart(zoo.system_of(robot), wound, zoo.home_of(robot))
    assert closed
    assert np.abs(q).max() <= np.pi


def test_search_turns_joints_all_around_whatever_the_characteristic_length() -> None:
    """A characteristic length of exactly 1 m must not make angles look like lengths."""
    from dataclasses import replace

    robot = replace(zoo.robot_of("3rrr"), characteristic_length=1.0, working_mode=(-1, -1, -1))
    q, _, closed = multistart(ConstraintSystem(robot), np.array(robot.q_reference), zoo.home_of(zoo.robot_of("3rrr")))
    assert closed
    np.testing.assert_array_equal(working_modes(robot, q[None])[0], [-1, -1, -1])


@pytest.mark.long_for("mode0", "mode1")
@pytest.mark.parametrize("mode", [(-1, -1, -1, -1, -1, -1), (1, -1, 1, 1, -1, -1), (-1, 1, 1, -1, 1, 1)])
def test_every_mode_of_six_legs_is_found_for_other_lengths(mode: tuple[int, ...]) -> None:
    """One random start in 64 falls to a given mode of six legs: they are put together leg by leg."""
    robot = load_robot("gough", base_radius=0.7, platform_radius=0.27, height=0.52, working_mode=mode)
    assembled = zoo.system_of(robot).evaluate(np.array(robot.q_reference)[None])
    assert np.abs(assembled.phi).max() < CLOSURE_TOLERANCE
    np.testing.assert_array_equal(working_modes(robot, np.array(robot.q_reference)[None])[0], mode)
    lengths = [robot.q_reference[zoo.index(robot, f"slide_{leg}")] for leg in range(1, 7)]
    np.testing.assert_array_equal(np.sign(lengths), mode)


def test_legs_are_not_mixed_where_one_is_right_in_none() -> None:
    robot = zoo.robot_of("3rrr", working_mode=(1, 1, 1))
    other = zoo.robot_of("3rrr", working_mode=(-1, 1, 1))
    guess, q = np.array(robot.q_reference), np.array(other.q_reference)
    assert mixed_legs(robot, q[None], guess) is None
    assert mixed_legs(robot, q[None][:0], guess) is None
    third = np.array(zoo.robot_of("3rrr", working_mode=(1, -1, 1)).q_reference)
    mixed = mixed_legs(robot, np.array([q, third]), guess)
    np.testing.assert_array_equal(working_modes(robot, mixed[None])[0], [1, 1, 1])
    assert np.abs(zoo.system_of(robot).evaluate(mixed[None]).phi).max() < CLOSURE_TOLERANCE
