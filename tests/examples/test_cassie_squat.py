"""The squat of Cassie against Newton and Euler for the whole machine, rnea projected by hand, and MuJoCo.

MuJoCo's model is made of the SDF by a reader of the tests' own: reading, kinematics, dynamics and forces are judged.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import cassie
import numpy as np
import pinocchio as pin
import pytest
from doc_blocks import example_script
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.robot import Robot

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "cassie_squat.py"
ROUNDING = 1e-6
"""N and N·m, of forces of 500 N: the heels and toes are 0.16 m apart, the cranks 0.05 m long."""


example = example_script(SCRIPT)
try:
    files("example-robot-data")
except PackageNotFoundError:
    pytest.skip("example-robot-data is not installed: pip install 'redundancy_pin[examples]'", allow_module_level=True)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return example.load()


def test_edges_of_the_feet_carry_the_machine_within_their_cones(robot: Robot) -> None:
    motion = example.squat(robot, 9)
    tree = rp.inverse_kinematics(robot, motion)
    model, data = robot.model, robot.model.createData()
    assert (robot.n, robot.m, len(robot.constraint_names)) == (6, 10, 2 * (4 + 2) + 10 + 4)
    free, _ = example.efforts(robot, motion, 5.0)
    damping = np.zeros(model.nv)
    for load in robot.loads:  # springs are held where they are relaxed
        damping[model.joints[model.getJointId(load.joint)].idx_v] += load.damping
    ids = {name: model.getFrameId(f"{name} tip", pin.FrameType.BODY) for name in example.CONTACTS}
    rods = robot.closures[:4]
    pairs = [((model.getFrameId(each.frame_a), model.getFrameId(each.frame_b)), each.axes) for each in rods]
    for friction, bites in ((0.6, False), (0.02, True)):
        efforts, feet = example.efforts(robot, motion, friction)
        assert set(efforts.status_labels.tolist()) == {"ok"}
        assert (np.linalg.norm(efforts.tau) > (1.0 + 1e-6) * np.linalg.norm(free.tau)) == bites
        closure_force = feet.at(efforts.tau)
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
            names = example.legs(example.SPRINGS)
            held = [np.eye(model.nv)[model.joints[model.getJointId(name)].idx_v] for name in names]
            for ends, axes in pairs:
                Ja, Jb = (pin.getFrameJacobian(model, data, end, pin.LOCAL_WORLD_ALIGNED) for end in ends)
                arm = data.oMf[ends[1]].translation - data.oMf[ends[0]].translation
                apart = Jb[:3] - Ja[:3] + pin.skew(arm) @ Ja[3:]
                held += list(data.oMf[ends[0]].rotation.T[: 3 if "z" in axes else 2] @ apart)
                if "rz" in axes:  # a rod between two balls does not spin: one end's y stays normal to the other's x
                    about = np.cross(data.oMf[ends[0]].rotation[:, 1], data.oMf[ends[1]].rotation[:, 0])
                    held.append(about @ (Jb[3:] - Ja[3:]))
            moving = null_space(np.array(held))
            assert moving.shape[1] == 16
            effort = pin.rnea(model, data, q, v, a) + damping * v
            for name, at in ids.items():
                effort -= pin.computeFrameJacobian(model, data, q, at, pin.LOCAL_WORLD_ALIGNED)[:3].T @ force[name]
            effort[robot.actuated_velocity] -= efforts.tau[k]
            assert np.abs(moving.T @ effort).max() < ROUNDING


def test_mujoco_agrees(robot: Robot, tmp_path: Path) -> None:
    """Contact forces by MuJoCo's equation of motion; accelerations too by its solver, in the limit of rigid."""
    mujoco = pytest.importorskip("mujoco")
    motion, data = example.squat(robot, 5), robot.model.createData()
    tree = rp.inverse_kinematics(robot, motion)
    efforts, feet = example.efforts(robot, motion, 0.6)
    tips: dict[str, tuple[str, Any, Any]] = {}
    for name, way in zip(example.CONTACTS, (1.0, -1.0) * 2, strict=True):
        place = robot.model.frames[robot.model.getFrameId(f"ground {name}")].placement.translation
        tips[name] = (f"{name.split()[0]}-foot", example.CENTRE + way * example.HALF * example.ALONG, place)
    mj = cassie.in_mujoco(example.cassie_sdf(tmp_path), tips, example.legs(example.SPRINGS))
    state = mujoco.MjData(mj)
    for k in range(3):  # down; up is the same backward
        by_name = dict(zip(feet.names, feet.at(efforts.tau)[k], strict=True))
        pin.forwardKinematics(robot.model, data, *(np.array(part[k]) for part in (tree.q, tree.v, tree.a)))
        pin.updateFramePlacements(robot.model, data)
        wanted = _set(mj, state, robot, data, (tree.q[k], tree.v[k], tree.a[k]), efforts.tau[k])
        mujoco.mj_forward(mj, state)
        assert np.abs(state.efc_pos).max() < 1e-7  # the loops are closed as the file says
        assert np.abs(state.efc_vel).max() < 1e-7
        inertia, J = np.zeros(mj.nv), state.efc_J.reshape(-1, mj.nv)
        mujoco.mj_mulM(mj, state, inertia, wanted)
        spin = np.array([_spin(mj, state, data, robot, side) for side in example.SIDES])
        left = inertia + state.qfrc_bias - state.qfrc_passive - state.qfrc_applied
        force = np.linalg.lstsq(np.vstack([J, spin]).T, left, rcond=1e-9)[
            0
        ]  # rows of MuJoCo's that are redundant share
        assert np.abs(np.vstack([J, spin]).T @ force - left).max() < ROUNDING
        _compare(mj, state, force, by_name, SAME)
        state.qfrc_applied += spin.T @ force[-2:]
        softness, accelerations, forces = [], [], []
        for impedance in (0.9999, 0.9998, 0.9997, 0.9996):
            mj.eq_solimp[:, :2] = impedance
            mujoco.mj_forward(mj, state)
            softness.append((1.0 - impedance) / impedance)
            accelerations.append(state.qacc.copy())
            forces.append(state.efc_force.copy())
        rigid = np.linalg.inv(np.vander(softness, increasing=True))[0]
        assert np.abs(rigid @ accelerations - wanted).max() < SOLVER
        _compare(mj, state, rigid @ forces, by_name, SOLVER)


SAME = 2e-5
"""N: the loops close to 3e-8 m by either reading, forces are 500 N at arms of centimetres."""
SOLVER = 0.02
"""rad/s² or m/s² of 10⁴ without constraints, and N of 100: what is left when four soft solutions are extrapolated."""


def _set(mj: Any, state: Any, robot: Robot, data: pin.Data, of: tuple[Any, Any, Any], tau: np.ndarray) -> np.ndarray:
    """Bring MuJoCo to a state of ours and let the motors act; return our accelerations in its order."""
    model, accelerations = robot.model, np.zeros(mj.nv)
    state.qfrc_applied[:] = 0.0
    for joint in range(mj.njnt):
        name, at, dof, body = mj.joint(joint).name, mj.jnt_qposadr[joint], mj.jnt_dofadr[joint], mj.jnt_bodyid[joint]
        if mj.jnt_type[joint] == 3:  # a hinge
            ours = model.joints[model.getJointId(name)]
            state.qpos[at], state.qvel[dof], accelerations[dof] = (
                of[0][ours.idx_q],
                of[1][ours.idx_v],
                of[2][ours.idx_v],
            )
            if name in robot.actuated:
                state.qfrc_applied[dof] = tau[robot.actuated.index(name)]
            continue
        frame, parent = (
            model.getFrameId(mj.body(each).name, pin.FrameType.BODY) for each in (body, mj.body_parentid[body])
        )
        free = mj.body_parentid[body] == 0
        place, carrier = data.oMf[frame], np.eye(3) if free else data.oMf[parent].rotation
        v, a = _moving(model, data, frame)
        v0, a0 = (np.zeros(6), np.zeros(6)) if free else _moving(model, data, parent)
        turn = v[3:] - v0[3:]
        R = place.rotation
        start = np.eye(3) if free else Rotation.from_quat(mj.body_quat[body], scalar_first=True).as_matrix()
        quaternion = Rotation.from_matrix(start.T @ carrier.T @ R).as_quat(scalar_first=True)
        rate = R.T @ (a[3:] - a0[3:] - np.cross(v0[3:], turn))
        if free:
            state.qpos[at : at + 3], state.qvel[dof : dof + 3] = place.translation, v[:3]
            accelerations[dof : dof + 3] = a[:3]
            at, dof = at + 3, dof + 3
        state.qpos[at : at + 4], state.qvel[dof : dof + 3] = quaternion, R.T @ turn
        accelerations[dof : dof + 3] = rate
    return accelerations


def _moving(model: pin.Model, data: pin.Data, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Return velocity and acceleration (6,) of a frame in the world's axes."""
    velocity = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    return velocity.vector, pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).vector


def _spin(mj: Any, state: Any, data: pin.Data, robot: Robot, side: str) -> np.ndarray:
    """Return the row (nv,) that holds a rod's spin, which MuJoCo leaves free: our frames' axes, its Jacobians."""
    import mujoco

    closure = next(each for each in robot.closures if each.name == f"{side}-pitch-rod-joint")
    ends = [data.oMf[robot.model.getFrameId(name)].rotation for name in (closure.frame_a, closure.frame_b)]
    rows = []
    for name in (f"{side}-achilles-rod", f"{side}-hip-pitch"):
        jacobian = np.zeros((3, mj.nv))
        mujoco.mj_jacBody(mj, state, None, jacobian, mj.body(name).id)
        rows.append(np.cross(ends[0][:, 1], ends[1][:, 0]) @ jacobian)
    return rows[0] - rows[1]


def _compare(mj: Any, state: Any, force: np.ndarray, ours: dict[str, float], tolerance: float) -> None:
    """Hold MuJoCo's forces at heels and toes against ours, on the feet; along the edge, which is free, their sum."""
    theirs: dict[str, list[float]] = {}
    for row in range(state.nefc):
        theirs.setdefault(mj.eq(state.efc_id[row]).name, []).append(force[row])
    for side in example.SIDES:
        for axis in (1, 2):
            for name in (f"{side} heel", f"{side} toe"):
                assert abs(theirs[name][axis] - ours[f"{'xyz'[axis]} of {name}"]) < tolerance
        along = theirs[f"{side} heel"][0] + theirs[f"{side} toe"][0]
        assert abs(along - ours[f"x of {side} heel"]) < tolerance


@pytest.mark.long
def test_the_squat_looks_like_one(robot: Robot) -> None:
    """Ten centimetres down and up, the edges where they were."""
    motion = example.squat(robot, 3)
    tree = rp.inverse_kinematics(robot, motion)
    data = robot.model.createData()
    ends = {name: robot.model.getFrameId(f"{name} tip", pin.FrameType.BODY) for name in example.CONTACTS}
    pelvis = robot.model.getFrameId("pelvis", pin.FrameType.BODY)
    heights = []
    for q in tree.q:
        pin.framesForwardKinematics(robot.model, data, np.array(q))
        heights.append(data.oMf[pelvis].translation[2])
        for name, at in ends.items():
            wanted = [0.08 if name.endswith("toe") else -0.08, None, 0.0]
            assert data.oMf[at].translation[[0, 2]] == pytest.approx([wanted[0], wanted[2]], abs=1e-3)
    assert heights[0] - heights[1] == pytest.approx(example.DEPTH, abs=1e-9)
    assert not tree.out_of_range.any()
