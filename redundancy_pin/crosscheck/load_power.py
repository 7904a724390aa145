"""Power and energy of loads by their own definitions: places, lengths and turns as Pinocchio has them, no Jacobian."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import JointForces, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind, wrench_values


def load_energy(robot: Robot, q: Array, v: Array) -> Array:
    """Return (N,) energy of springs, and of rotors beyond that of their links, J, at states (nq, N), (nv, N).

    A rotor turns about the axis z of its joint by ω·z with the link that carries it, and by gear · v relative to it:
    I ((ω·z + gear v)² − (ω·z)²) / 2.
    """
    model, energy = robot.model, np.zeros(q.shape[1])
    data = model.createData()
    for spring in of_kind(robot.loads, Spring):
        energy += 0.5 * spring.stiffness * (_length(robot, spring, q) - spring.length) ** 2
    for load in of_kind(robot.loads, JointForces):
        index = model.getJointId(load.joint)
        joint = model.joints[index]
        if load.stiffness:
            energy += 0.5 * load.stiffness * (q[joint.idx_q] - load.rest) ** 2
        for k in range(q.shape[1] if load.rotor_inertia else 0):
            pin.forwardKinematics(model, data, q[:, k], v[:, k])
            relative = joint.createData()
            joint.calc(relative, q[:, k])
            subspace = np.asarray(relative.S).reshape(6)
            axis = subspace[3:] if subspace[3:].any() else subspace[:3]
            carried = axis @ data.liMi[index].rotation.T @ data.v[model.parents[index]].angular
            spin = carried + load.gear * v[joint.idx_v, k]
            energy[k] += 0.5 * load.rotor_inertia * (spin**2 - carried**2)
    return energy


def load_power(robot: Robot, motion: PlatformMotion, q: Array, v: Array, wide: Array, rate: Array) -> Array:
    """Return (N,) what friction, dampers and wrenches take from the robot, W.

    Args:
        robot: the robot.
        motion: N samples.
        q: (nq, N) its configurations there.
        v: (nv, N) its rates there.
        wide: (nq, N p) configurations at p instants about each sample.
        rate: (p,) weights of the values there that give their derivative by time.
    """
    samples, power = q.shape[1], np.zeros(q.shape[1])
    for load in of_kind(robot.loads, JointForces):
        speed = v[robot.model.joints[robot.model.getJointId(load.joint)].idx_v]
        power += (load.damping * speed + load.friction * np.tanh(speed / load.friction_speed)) * speed
    for spring in of_kind(robot.loads, Spring):
        power += spring.damping * (_length(robot, spring, wide).reshape(samples, -1) @ rate) ** 2
    values = wrench_values(robot.loads, motion.t, motion.x, motion.xd)
    for wrench, value in zip(of_kind(robot.loads, Wrench), values, strict=True):
        rotation = _placements(robot, wrench.frame, q)[0]
        turned, origin = _placements(robot, wrench.frame, wide)
        place = (origin + turned @ wrench.point).reshape(samples, -1, 3)
        velocity = np.einsum("npi,p->ni", place, rate)
        turn = np.einsum("npij,p->nij", turned.reshape(samples, -1, 3, 3), rate) @ rotation.transpose(0, 2, 1)
        omega = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        axes = rotation if wrench.reference == "local" else np.eye(3)
        force, moment = ((axes @ part[:, :, None])[:, :, 0] for part in (value[:, :3], value[:, 3:]))
        power -= (force * velocity + moment * omega).sum(axis=1)
    return power


def _length(robot: Robot, spring: Spring, q: Array) -> Array:
    """Return (N,) the length of a spring, m."""
    ends = []
    for frame, point in ((spring.frame_a, spring.point_a), (spring.frame_b, spring.point_b)):
        rotation, origin = _placements(robot, frame, q)
        ends.append(origin + rotation @ point)
    length: Array = np.linalg.norm(ends[1] - ends[0], axis=1)
    return length


def _placements(robot: Robot, frame: str, q: Array) -> tuple[Array, Array]:
    """Return (N, 3, 3) and (N, 3): axes and origin of a link in the world."""
    model = robot.model
    data, index = model.createData(), model.getFrameId(frame, pin.FrameType.BODY)
    rotation, origin = np.empty((q.shape[1], 3, 3)), np.empty((q.shape[1], 3))
    for k in range(q.shape[1]):
        pin.framesForwardKinematics(model, data, q[:, k])
        rotation[k], origin[k] = data.oMf[index].rotation, data.oMf[index].translation
    return rotation, origin
