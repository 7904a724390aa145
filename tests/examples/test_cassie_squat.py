"""The squat of Cassie against Newton and Euler for the whole machine, and rnea projected by hand on what may move."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from doc_blocks import example_script
from scipy.linalg import null_space

import redundancy_pin as rp

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "cassie_squat.py"
ROUNDING = 1e-6
"""N and N·m, of forces of 500 N: the heels and toes are 0.16 m apart, the cranks 0.05 m long."""


example = example_script(SCRIPT)
try:
    example.cassie_sdf()
except (PackageNotFoundError, IndexError):
    pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'", allow_module_level=True)


def test_edges_of_the_feet_carry_the_machine_within_their_cones() -> None:
    robot = example.load()
    motion = example.squat(robot, 9)
    tree = rp.lift(robot, motion)
    model, data = robot.model, robot.model.createData()
    assert (robot.n, robot.m, len(robot.constraint_names)) == (6, 10, 8 + 10 + 4)
    free, _ = example.efforts(robot, motion, 5.0)
    damping = np.zeros(model.nv)
    for load in robot.loads:  # springs are held where they are relaxed
        damping[model.joints[model.getJointId(load.joint)].idx_v] += load.damping
    ids = {name: model.getFrameId(f"{name} tip", pin.FrameType.BODY) for name in example.CONTACTS}
    pairs = [(model.getFrameId(each.frame_a), model.getFrameId(each.frame_b)) for each in robot.closures[:4]]
    for friction, bites in ((0.6, False), (0.02, True)):
        found, feet = example.efforts(robot, motion, friction)
        assert set(found.status_labels.tolist()) == {"regular"}
        assert (np.linalg.norm(found.tau) > (1.0 + 1e-6) * np.linalg.norm(free.tau)) == bites
        closure_force = feet.at(found.tau)
        for k in range(len(motion)):
            q, v, a = (np.array(part[k]) for part in (tree.q, tree.v, tree.a))
            by_name = dict(zip(feet.names, closure_force[k], strict=True))
            force = {name: np.array([by_name.get(f"{axis} of {name}", 0.0) for axis in "xyz"]) for name in ids}
            for one in force.values():
                assert one[2] > 2.0 - 1e-5
                assert np.linalg.norm(one[:2]) <= friction * one[2] * (1.0 + 1e-6)
            pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
            rate = data.dhg
            pin.framesForwardKinematics(model, data, q)
            places = {name: data.oMf[at].translation.copy() for name, at in ids.items()}
            weight = pin.computeTotalMass(model) * np.array(robot.gravity)
            assert np.abs(sum(force.values()) + weight - rate.linear).max() < ROUNDING
            moment = sum(np.cross(places[name] - data.com[0], force[name]) for name in ids)
            assert np.abs(moment - rate.angular).max() < ROUNDING
            # on all that the rods, the held springs and nothing else let move: no force of a loop is in it
            pin.computeJointJacobians(model, data, q)
            held = [np.eye(model.nv)[model.joints[model.getJointId(name)].idx_v] for name in example.SPRINGS]
            for ends in pairs:
                Ja, Jb = (pin.getFrameJacobian(model, data, end, pin.LOCAL_WORLD_ALIGNED) for end in ends)
                arm = data.oMf[ends[1]].translation - data.oMf[ends[0]].translation
                apart = Jb[:3] - Ja[:3] + pin.skew(arm) @ Ja[3:]
                held += list(data.oMf[ends[0]].rotation.T[:2] @ apart)
            moving = null_space(np.array(held))
            assert moving.shape[1] == 16
            effort = pin.rnea(model, data, q, v, a) + damping * v
            for name, at in ids.items():
                effort -= pin.computeFrameJacobian(model, data, q, at, pin.LOCAL_WORLD_ALIGNED)[:3].T @ force[name]
            effort[robot.actuated_velocity] -= found.tau[k]
            assert np.abs(moving.T @ effort).max() < ROUNDING


def test_the_squat_looks_like_one() -> None:
    """Ten centimetres down and up, the edges where they were, the rods off sideways by no more than is said."""
    robot = example.load()
    motion = example.squat(robot, 3)
    tree = rp.lift(robot, motion)
    data = robot.model.createData()
    ends = {name: robot.model.getFrameId(f"{name} tip", pin.FrameType.BODY) for name in example.CONTACTS}
    pelvis = robot.model.getFrameId("pelvis", pin.FrameType.BODY)
    heights, aside = [], []
    for q in tree.q:
        pin.framesForwardKinematics(robot.model, data, np.array(q))
        heights.append(data.oMf[pelvis].translation[2])
        for name, at in ends.items():
            wanted = [0.08 if name.endswith("toe") else -0.08, None, 0.0]
            assert data.oMf[at].translation[[0, 2]] == pytest.approx([wanted[0], wanted[2]], abs=1e-3)
        for each in robot.closures[:2]:
            a, b = (data.oMf[robot.model.getFrameId(name)] for name in (each.frame_a, each.frame_b))
            aside.append(abs(a.actInv(b.translation)[2]))
    assert heights[0] - heights[1] == pytest.approx(example.DEPTH, abs=1e-9)
    assert 0.005 < max(aside) < 0.0075
    assert not tree.out_of_range.any()
