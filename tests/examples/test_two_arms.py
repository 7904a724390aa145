"""Two UR5 and a bar against plain open chains: each arm of the maker's URDF by itself, with the force at its tool."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from doc_blocks import example_script

import redundancy_pin as rp

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "two_arms.py"
ROUNDING = 1e-8  # N·m
SQUEEZE, BAR, APART = 20.0, 2.0, 0.9  # N, kg, m


example = example_script(SCRIPT)
try:
    [URDF] = [str(file.locate()) for file in files("example-robot-data") or () if file.name == "ur5_robot.urdf"]
except (PackageNotFoundError, ValueError):
    pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'", allow_module_level=True)


def test_each_arm_carries_its_share_and_the_bar_is_squeezed() -> None:
    robot = example.load()
    motion = example.lift(robot, 5)
    efforts, wrench = example.torques(robot, motion, SQUEEZE)
    assert (robot.n, robot.m) == (6, 12)
    assert efforts.solved.all()
    tree = rp.inverse_kinematics(robot, motion)
    arm = pin.buildModelFromUrdf(URDF)
    data, tool = arm.createData(), arm.getFrameId("tool0")
    for k in range(len(motion)):
        R, middle = motion.x[k][:3, :3], motion.x[k][:3, 3]
        (v, omega), (dv, alpha) = (np.split(part[k], 2) for part in (motion.xd, motion.xdd))
        ends = [middle + y * APART * R[:, 1] for y in (0.5, -0.5)]
        torque, J = [], []
        for side, base in enumerate((0.5, -0.5)):
            q, rate, rise = (np.array(part[k][6 * side : 6 * side + 6]) for part in (tree.q, tree.v, tree.a))
            torque.append(pin.rnea(arm, data, q, rate, rise).copy())
            pin.computeJointJacobians(arm, data, q)
            pin.updateFramePlacements(arm, data)
            at_end = np.array(pin.getFrameJacobian(arm, data, tool, pin.LOCAL_WORLD_ALIGNED))
            # the open arm is where the bar wants its tool, and moves as the bar does
            assert np.abs(data.oMf[tool].translation + np.array([0.0, base * APART, 0.0]) - ends[side]).max() < 1e-9
            assert np.abs(at_end @ rate - np.append(v + np.cross(omega, ends[side] - middle), omega)).max() < 1e-8
            J.append(at_end)
        # Newton and Euler for the bar: what the left tool exerts at its end, given what the right one does
        spread = R @ (BAR / 12.0 * APART**2 * np.diag([1.0, 0.0, 1.0])) @ R.T
        right = -np.append(R @ wrench[k, :3], R @ wrench[k, 3:])  # on the bar
        force = BAR * (dv + np.array([0.0, 0.0, 9.81])) - right[:3]
        moment = spread @ alpha + np.cross(omega, spread @ omega) - right[3:]
        moment -= np.cross(ends[0] - middle, force) + np.cross(ends[1] - middle, right[:3])
        tau = efforts.tau[k].reshape(2, 6)
        np.testing.assert_allclose(tau[0], torque[0] + J[0].T @ np.append(force, moment), atol=ROUNDING)
        np.testing.assert_allclose(tau[1], torque[1] + J[1].T @ right, atol=ROUNDING)
        assert abs(R[:, 1] @ right[:3] - SQUEEZE) < 1e-6  # inward: the right tool is at the bar's −y end
        # least: no other force between the tools that leaves the squeeze would shorten Σ τ²
        lever = np.cross(ends[1] - ends[0], np.eye(3)).T
        from_left = J[0] @ tau[0]
        slope = J[1] @ tau[1] - from_left - np.append(lever.T @ from_left[3:], np.zeros(3))
        slope = np.concatenate([R.T @ slope[:3], slope[3:]])
        assert np.abs(np.delete(slope, 1)).max() < 1e-6 * np.abs(tau).max()
        assert abs(slope[1]) > 1e-3
    free, _ = example.torques(robot, motion, 0.0)
    assert np.abs(free.tau - efforts.tau).max() > 0.5
