"""Kinematics are the same whatever lengths and times are measured in: of a machine that is so much larger."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.kinematics.multistart import multistart
from redundancy_pin.robot.scales import turning_velocities

SAME = 1e-8
"""Chains are closed to 1e-11 m, whatever the size: relative to the smallest unit here."""

LENGTHS = {
    "2rpr": ("base_distance", "track_offset", "track_half_length", "cylinder_length", "piston_length"),
    "3rrr": ("base_radius", "platform_radius", "proximal_length", "distal_length", "tail_length"),
    "five_bar": ("base_distance", "proximal_length", "distal_length", "tail_length"),
    "four_bar": ("ground_length", "crank_length", "coupler_length", "rocker_length"),
}
UNITS = [(2.0**7, 1.0), (2.0**-5, 2.0**9)]
"""New units of length and time in an old one."""


@cache
def robot_in(name: str, length: float) -> rp.Robot:
    shipped = zoo.robot_of(name)
    return rp.load_robot(name, **{key: float(shipped.parameters[key]) * length for key in LENGTHS[name]})


def sizes(robot: rp.Robot, length: float) -> tuple[Array, Array]:
    """What coordinates and joint velocities are multiplied by."""
    axes = robot.platform.axes if robot.platform else ()
    own = [1.0 if axis.startswith("r") else length for axis in axes] or [1.0] * robot.n
    return np.array(own), np.where(turning_velocities(robot), 1.0, length)


def motion_in(name: str, length: float, time: float, speed: float = 2.0) -> rp.PlatformMotion:
    plain = zoo.smooth_motion(zoo.robot_of(name), 3, 1.0, speed).at(np.linspace(0.0, 1.0, 41))
    own, _ = sizes(zoo.robot_of(name), length)
    return rp.PlatformMotion(plain.t * time, plain.x * own, plain.xd * own / time, plain.xdd * own / time**2)


def close(found: Array, expected: Array) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=SAME * max(np.abs(expected).max(initial=0.0), 1e-3))


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", LENGTHS)
def test_joints_follow_the_platform_alike(name: str, unit: tuple[float, float]) -> None:
    (length, time), plain = unit, inverse_kinematics(robot_in(name, 1.0), motion_in(name, 1.0, 1.0))
    other = inverse_kinematics(robot_in(name, length), motion_in(name, length, time))
    own, joints = sizes(plain.robot, length)
    assert other.robot.characteristic_length == pytest.approx(length * plain.robot.characteristic_length, rel=1e-9)
    close(other.q / joints, plain.q)
    close(other.v / joints * time, plain.v)
    close(other.a / joints * time**2, plain.a)
    close(other.gamma / joints[:, None] * own, plain.gamma)
    close(other.serial_margin_bound, plain.serial_margin_bound)
    assert (other.residual < 1e-10 * max(length, 1.0)).all()


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar"])
def test_the_platform_follows_the_motors_alike(name: str, unit: tuple[float, float]) -> None:
    (length, time), found = unit, []
    for robot, (L, T) in ((robot_in(name, 1.0), (1.0, 1.0)), (robot_in(name, length), (length, time))):
        tree = inverse_kinematics(robot, motion_in(name, L, T))
        at = robot.actuated_velocity
        u, ud, udd = (np.array(part[:, at]) for part in (tree.q, tree.v, tree.a))
        found.append((robot, rp.forward_kinematics(robot, u, rates=ud, accelerations=udd, start=tree.q[0]), u[20]))
    (robot, plain, u), (larger, other, v) = found
    own, _ = sizes(robot, length)
    motors = np.array(sizes(robot, length)[1][robot.actuated_velocity])
    assert other.status.tolist() == plain.status.tolist()
    close(other.x / own, plain.x)
    close(other.xd / own * time, plain.xd)
    close(other.xdd / own * time**2, plain.xdd)
    close(other.jacobian / own[:, None] * motors, plain.jacobian)
    close(other.margin, plain.margin)
    modes = [rp.assembly_modes(one, at) for one, at in ((robot, u), (larger, v))]
    assert len(modes[0]) == len(modes[1])
    close(modes[1].x / own, modes[0].x)
    close(modes[1].margin, modes[0].margin)
    for each in modes:
        assert each.unseen == (each.hits == 1).sum() / each.hits.sum()


@pytest.mark.parametrize("length", [2.0**-5, 1.0, 2.0**7])
def test_the_nearest_configuration_is_the_same_in_all_units(length: float) -> None:
    """A slide turned round by 0.9 π is nearer with its other sign, however many metres it is long."""
    robot = replace(robot_in("2rpr", length), working_modes=None, working_mode=())
    model, closed = robot.model, np.array(robot.q_reference)
    slide, swivel = (model.joints[model.getJointId(name)].idx_q for name in ("slide_1", "swivel_1"))
    guess = closed.copy()
    guess[slide] = 0.1 * closed[slide]
    guess[swivel] = closed[swivel] + 0.9 * np.pi
    known = np.arange(len(guess))
    found = multistart(zoo.system_of(robot), guess, zoo.home_of(robot), known=known)
    assert found.in_mode
    assert found.q[slide] == pytest.approx(-closed[slide], rel=1e-9)
