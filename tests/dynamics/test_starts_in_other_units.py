"""Starts for poses that the straight way does not reach: found or not alike, whatever the size of the machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import zoo
from scipy.spatial.transform import Rotation
from tilting_platforms import actuators, robot_called

import redundancy_pin as rp
from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.status import SampleStatus

SIZES = (0.001, 0.01, 100.0)
"""Of machines whose platforms have radii of 0.3 mm to 30 m."""
LENGTHS = (
    "base_radius",
    "platform_radius",
    "cylinder_length",
    "cylinder_radius",
    "piston_length",
    "piston_radius",
    "height",
)
POSES = 60
SHORT = 0.12
"""Length of the links, as a part of that of the machine: little more than spans from the base to a level platform."""


def gough(size: float) -> Robot:
    plain = zoo.robot_of("gough")
    return rp.load_robot("gough", **{name: float(plain.parameters[name]) * size for name in LENGTHS})


def far_poses(size: float) -> Array:
    """Return poses anywhere within 1.5 m, turned by up to half a turn about each axis."""
    rng = np.random.default_rng(3)
    x = np.repeat(np.eye(4)[None], POSES, axis=0)
    x[:, :3, 3] = rng.uniform(-1.5, 1.5, (POSES, 3)) * size
    x[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-2.6, 2.6, (POSES, 3))).as_matrix()
    return x


def found(dynamics: Dynamics, x: Array) -> BoolArray:
    """Return which coordinates have a configuration, each looked for by itself."""
    rest = np.zeros((1, dynamics.robot.n))
    one_by_one = [rp.PlatformMotion([0.0], each[None], rest, rest) for each in x]
    return np.array([dynamics.along(one, unreachable="mark").reduce().reachable[0] for one in one_by_one])


@pytest.mark.long
@pytest.mark.parametrize("size", SIZES)
def test_a_gough_platform_finds_its_legs(size: float) -> None:
    """Each leg is the vector between its joints: there is always one, as slides have no ends here."""
    assert found(CompiledDynamics(gough(size)), far_poses(size)).all()


@pytest.mark.parametrize("size", [0.01, 100.0])
def test_poses_out_of_reach_are_told_from_others(size: float, tmp_path: Path) -> None:
    """Of a 3-PRS, those at which a link does not span from its slide to its ball joint."""
    x = np.array([0.6, 0.0, 0.0]) + np.random.default_rng(5).uniform(-1.0, 1.0, (40, 3)) * [1.5, 0.7, 0.7]
    expected = np.isfinite(actuators("3prs", x, link=SHORT)).all(axis=1)
    assert 5 < expected.sum() < 35
    dynamics = CompiledDynamics(robot_called("3prs", tmp_path, size, link=SHORT))
    np.testing.assert_array_equal(found(dynamics, x * [size, 1.0, 1.0]), expected)


@pytest.mark.parametrize("size", SIZES[1:])
def test_noise_of_a_start_counts_in_lengths_of_the_machine(size: float) -> None:
    """A hundredth of a margin of 0.1 is noise for every size, and a tenth of the machine is none."""
    robot, random = gough(size), np.random.default_rng(5)
    backends = CompiledDynamics(robot), rp.RneaDynamics(robot)
    x, zero, unit = follower(robot).home.x, np.zeros(6), velocity_unit(robot)
    for noise, status in ((1e-4, SampleStatus.OK), (0.3, SampleStatus.BRANCH_LOST)):
        for _ in range(5):
            start = pin.integrate(robot.model, robot.q_reference, noise * random.normal(size=len(unit)) * unit)
            assert [one.torque(x, zero, zero, start=start).status for one in backends] == [status, status]
