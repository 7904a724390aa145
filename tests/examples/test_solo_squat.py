"""The squat of Solo against Newton and Euler for the whole machine (centroidal dynamics), and plain rnea by joints."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from doc_blocks import example_script

import redundancy_pin as rp

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "solo_squat.py"
ROUNDING = 1e-8  # N and N·m


example = example_script(SCRIPT)
try:
    example.solo_urdf()
except (PackageNotFoundError, IndexError):
    pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'", allow_module_level=True)


def test_feet_carry_the_machine_within_their_cones() -> None:
    robot, motion = example.load(), example.squat(15)
    tree = rp.inverse_kinematics(robot, motion)
    model, data = robot.model, robot.model.createData()
    free, _ = example.efforts(robot, motion, 5.0)
    for friction, bites in ((0.6, False), (0.2, True)):
        efforts, feet = example.efforts(robot, motion, friction)
        assert efforts.solved.all()
        force = feet.at(efforts.tau).reshape(len(motion), 4, 3)
        slip = np.linalg.norm(force[:, :, :2], axis=2) / force[:, :, 2]
        assert (force[:, :, 2] > 0.5 - 1e-6).all()
        assert slip.max() <= friction * (1.0 + 1e-6)
        assert (np.linalg.norm(efforts.tau) > (1.0 + 1e-6) * np.linalg.norm(free.tau)) == bites
        for k in range(len(motion)):
            q, v, a = (np.array(part[k]) for part in (tree.q, tree.v, tree.a))
            pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
            rate = data.dhg
            pin.framesForwardKinematics(model, data, q)
            places = np.array([data.oMf[model.getFrameId(f"{leg}_FOOT")].translation for leg in example.LEGS])
            weight = pin.computeTotalMass(model) * np.array(robot.gravity)
            assert np.abs(force[k].sum(axis=0) + weight - rate.linear).max() < ROUNDING
            moment = np.cross(places - data.com[0], force[k]).sum(axis=0)
            assert np.abs(moment - rate.angular).max() < ROUNDING
            # and joint by joint: the plain open tree with these forces at its feet
            pin.computeJointJacobians(model, data, q)
            effort = pin.rnea(model, data, q, v, a)
            for leg, one in zip(example.LEGS, force[k], strict=True):
                J = pin.computeFrameJacobian(model, data, q, model.getFrameId(f"{leg}_FOOT"), pin.LOCAL_WORLD_ALIGNED)
                effort = effort - J[:3].T @ one
            assert np.abs(effort[:6]).max() < ROUNDING  # nothing drives the trunk
            assert np.abs(effort[robot.actuated_velocity] - efforts.tau[k]).max() < ROUNDING
