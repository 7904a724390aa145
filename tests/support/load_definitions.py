"""Energy and efforts of loads by their own definitions, an oracle: places, turns and Jacobians are Pinocchio's."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import JointForces, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.robot.lookup import find_joint_index, find_link_index


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
        index = find_joint_index(model, load.joint)
        joint = model.joints[index]
        if load.stiffness:
            energy += 0.5 * load.stiffness * (q[joint.idx_q] - load.rest) ** 2
        for k in range(q.shape[1] if load.rotor_inertia else 0):
            pin.forwardKinematics(model, data, q[:, k], v[:, k])
            parent = model.parents[index]
            carried = _axis(robot, data, index, q[:, k]) @ data.oMi[parent].rotation @ data.v[parent].angular
            spin = carried + load.gear * v[joint.idx_v, k]
            energy[k] += 0.5 * load.rotor_inertia * (spin**2 - carried**2)
    return energy


def load_efforts(robot: Robot, motion: PlatformMotion, q: Array, v: Array, a: Array) -> Array:
    """Return (nv, N) what the loads ask of the joints, N or N·m, at states (nq, N), (nv, N), (nv, N) of N samples.

    Forces act through the Jacobians of their points. A rotor has, beyond what turns with the link that carries it, the
    angular momentum I gear v z along the axis z of its joint: its rate acts on that link, and its share along z, with
    that of the turning axis, on the joint.
    """
    model, efforts = robot.model, np.zeros(v.shape)
    data = model.createData()
    joints = [(load, find_joint_index(model, load.joint)) for load in of_kind(robot.loads, JointForces)]
    for load, index in joints:
        joint = model.joints[index]
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        drag = load.damping * v[columns] + load.friction * np.tanh(v[columns] / load.friction_speed)
        efforts[columns] += drag + load.stiffness * (q[joint.idx_q] - load.rest)
    wrenches = of_kind(robot.loads, Wrench)
    values = wrench_values(robot.loads, motion.t, motion.x, motion.xd)

    def at_point(frame: str, point: Array) -> tuple[Array, Array, Array, Array]:
        """Return place (3,), axes (3, 3), and Jacobians (3, nv) of a point and of the turn of its link."""
        identifier = find_link_index(model, frame)
        placed = pin.updateFramePlacement(model, data, identifier)
        jacobian = pin.getFrameJacobian(model, data, identifier, pin.LOCAL_WORLD_ALIGNED)
        arm = placed.rotation @ point
        return placed.translation + arm, placed.rotation, jacobian[:3] - pin.skew(arm) @ jacobian[3:], jacobian[3:]

    for k in range(q.shape[1]):
        pin.forwardKinematics(model, data, q[:, k], v[:, k], a[:, k])
        pin.computeJointJacobians(model, data)
        for wrench, value in zip(wrenches, values, strict=True):
            _, axes, moves, turns = at_point(wrench.frame, wrench.point)
            axes = axes if wrench.reference == "local" else np.eye(3)
            efforts[:, k] -= moves.T @ axes @ value[k, :3] + turns.T @ axes @ value[k, 3:]
        for spring in of_kind(robot.loads, Spring):
            (start, _, first, _), (end, _, second, _) = (
                at_point(*one) for one in ((spring.frame_a, spring.point_a), (spring.frame_b, spring.point_b))
            )
            length = float(np.linalg.norm(end - start))
            rates = (end - start) @ (second - first) / (length or 1.0)  # (nv,) of the length by the joints
            pull = spring.stiffness * (length - spring.length) + spring.damping * (rates @ v[:, k])
            efforts[:, k] += pull * rates
        for load, index in joints:
            if load.rotor_inertia:
                parent, column = model.parents[index], model.joints[index].idx_v
                z, carrier, size = _axis(robot, data, index, q[:, k]), data.oMi[parent].rotation, load.rotor_inertia
                omega, alpha = (carrier @ part[parent].angular for part in (data.v, data.a))
                rate = load.gear * size * (a[column, k] * z + v[column, k] * np.cross(omega, z))
                if parent:
                    turns = pin.getJointJacobian(model, data, parent, pin.LOCAL_WORLD_ALIGNED)[3:]
                    efforts[:, k] += turns.T @ rate
                efforts[column, k] += load.gear * (size * (z @ alpha) + z @ rate)
    return efforts


def _axis(robot: Robot, data: pin.Data, index: int, q: Array) -> Array:
    """Return (3,) the axis about which a joint turns, or along which it slides, in the world."""
    joint = robot.model.joints[index]
    relative = joint.createData()
    joint.calc(relative, q)
    subspace = np.asarray(relative.S).reshape(6)
    axis: Array = data.oMi[index].rotation @ (subspace[3:] if subspace[3:].any() else subspace[:3])
    return axis


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
    data, index = model.createData(), find_link_index(model, frame)
    rotation, origin = np.empty((q.shape[1], 3, 3)), np.empty((q.shape[1], 3))
    for k in range(q.shape[1]):
        pin.framesForwardKinematics(model, data, q[:, k])
        rotation[k], origin[k] = data.oMf[index].rotation, data.oMf[index].translation
    return rotation, origin
