"""Working modes read off configurations."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zoo
from spatial_chains import chain_of

from redundancy_pin.kinematics.assembly import integrate
from redundancy_pin.kinematics.coordinates import (
    all_working_modes,
    in_working_mode,
    mode_indicator,
    mode_name,
    working_modes,
)
from redundancy_pin.robot import Robot


def test_the_reference_is_in_the_robots_own_mode(shipped: Robot) -> None:
    q = shipped.q_reference[None]
    assert in_working_mode(shipped, q)[0]
    assert tuple(working_modes(shipped, q)[0]) == shipped.working_mode


def test_revolute_indicator_is_the_signed_sine() -> None:
    robot = zoo.robot_of("3rrr")
    q = np.repeat(robot.q_reference[None], 3, axis=0)
    elbow = zoo.index(robot, "elbow_2")
    q[:, elbow] = [0.3, -0.3 + 2 * np.pi, 0.0]
    np.testing.assert_allclose(mode_indicator(robot, q)[:, 1], [-np.sin(0.3), np.sin(0.3), 0.0], atol=1e-15)
    np.testing.assert_array_equal(working_modes(robot, q)[:, 1], [-1, 1, 0])
    np.testing.assert_array_equal(in_working_mode(robot, q), [False, True, False])


def test_prismatic_indicator_is_the_position() -> None:
    robot = zoo.robot_of("2rpr")
    q = np.repeat(robot.q_reference[None], 2, axis=0)
    slide = zoo.index(robot, "slide_2")
    q[:, slide] = [0.4, -0.2]
    np.testing.assert_allclose(mode_indicator(robot, q)[:, 1] * robot.characteristic_length, [0.4, -0.2])


def test_continuous_indicator_is_its_sine_coordinate() -> None:
    robot = chain_of("continuous")
    coupler = robot.model.joints[robot.model.getJointId("coupler")]
    turn = np.zeros((1, robot.model.nv))
    turn[0, coupler.idx_v] = 0.7
    q = robot.q_reference[None].copy()
    q[0, coupler.idx_q : coupler.idx_q + 2] = [1.0, 0.0]
    assert mode_indicator(robot, integrate(robot.model, q, turn))[0, 0] == pytest.approx(np.sin(0.7))


def test_a_robot_without_modes_is_always_in_its_mode() -> None:
    robot = chain_of("universal")
    q = np.repeat(robot.q_reference[None], 3, axis=0)
    assert mode_indicator(robot, q).shape == (3, 0)
    assert working_modes(robot, q).shape == (3, 0)
    assert in_working_mode(robot, q).all()
    assert all_working_modes(robot) == ((),)


@pytest.mark.parametrize("legs", [1, 2, 3])
def test_all_modes_are_listed_once_the_positive_first(legs: int) -> None:
    robot: Any = SimpleNamespace(working_modes=SimpleNamespace(joints=tuple("abc"[:legs])))
    modes = all_working_modes(robot)
    assert len(set(modes)) == len(modes) == 2**legs
    assert modes[0] == (1,) * legs
    assert {sign for mode in modes for sign in mode} == {1, -1}


def test_mode_names() -> None:
    assert mode_name((1, -1, 1)) == "+-+"
    assert mode_name(()) == ""
