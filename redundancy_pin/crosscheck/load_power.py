"""Energy, power and efforts of loads by their own definitions: places, turns and Jacobians as Pinocchio has them.

Nothing here comes from ``dynamics``, which it judges; power and energy need no Jacobian either.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import JointForces, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.robot.lookup import find_joint, find_joint_index, find_link_index


def energy_rate(
    robot: Robot, motion: PlatformMotion, q: Array, v: Array, a: Array, turn: float, stencil: Array
) -> tuple[Array, Array, Array]:
    """Return (N,) the rate of the energy, W, the energy, J, and the power that is lost, W, at N states.

    Args:
        robot: the robot.
        motion: N samples.
        q: (nq, N) its configurations there.
        v: (nv, N) its rates there.
        a: (nv, N) its accelerations there.
        turn: step of the differences, as the sum of the angles by which the joints turn, rad.
        stencil: (p,) weights of values that are a step apart, whose sum is a step of the derivative.
    """
    model, samples = robot.model, q.shape[1]
    massive, data = model.copy(), model.createData()
    massive.armature = np.zeros(model.nv)  # of joints about skew axes it is left out of Pinocchio's energy
    step = turn / np.maximum(np.abs(v).sum(axis=0), 1.0)
    places = np.arange(len(stencil)) - len(stencil) // 2
    wide, rates = np.empty((model.nq, samples, len(stencil))), np.empty((model.nv, samples, len(stencil)))
    energy = np.empty((samples, len(stencil)))
    for k in range(samples):
        for i, u in enumerate(step[k] * places):
            wide[:, k, i], rates[:, k, i] = pin.integrate(model, q[:, k], u * v[:, k]), v[:, k] + u * a[:, k]
            energy[k, i] = pin.computeKineticEnergy(massive, data, wide[:, k, i], rates[:, k, i])
            energy[k, i] += pin.computePotentialEnergy(massive, data, wide[:, k, i])
    energy += 0.5 * np.einsum("v,vki->ki", model.armature, rates**2)
    flat = wide.reshape(model.nq, -1)
    energy += load_energy(robot, flat, rates.reshape(model.nv, -1)).reshape(samples, -1)
    weights = stencil / step[:, None]
    return (energy * weights).sum(axis=1), energy[:, len(stencil) // 2], load_power(robot, motion, q, v, flat, weights)


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


def load_power(robot: Robot, motion: PlatformMotion, q: Array, v: Array, wide: Array, rate: Array) -> Array:
    """Return (N,) what friction, dampers and wrenches take from the robot, W.

    Args:
        robot: the robot.
        motion: N samples.
        q: (nq, N) its configurations there.
        v: (nv, N) its rates there.
        wide: (nq, N p) configurations at p instants about each sample.
        rate: (N, p) weights of the values there that give their derivative by time.
    """
    samples, power = q.shape[1], np.zeros(q.shape[1])
    for load in of_kind(robot.loads, JointForces):
        joint = find_joint(robot.model, load.joint)
        speed = v[joint.idx_v : joint.idx_v + joint.nv]
        power += ((load.damping * speed + load.friction * np.tanh(speed / load.friction_speed)) * speed).sum(axis=0)
    for spring in of_kind(robot.loads, Spring):
        power += spring.damping * (_length(robot, spring, wide).reshape(samples, -1) * rate).sum(axis=1) ** 2
    values = wrench_values(robot.loads, motion.t, motion.x, motion.xd)
    for wrench, value in zip(of_kind(robot.loads, Wrench), values, strict=True):
        rotation = _placements(robot, wrench.frame, q)[0]
        turned, origin = _placements(robot, wrench.frame, wide)
        place = (origin + turned @ wrench.point).reshape(samples, -1, 3)
        velocity = np.einsum("npi,np->ni", place, rate)
        turn = np.einsum("npij,np->nij", turned.reshape(samples, -1, 3, 3), rate) @ rotation.transpose(0, 2, 1)
        omega = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        axes = rotation if wrench.reference == "local" else np.eye(3)
        force, moment = ((axes @ part[:, :, None])[:, :, 0] for part in (value[:, :3], value[:, 3:]))
        power -= (force * velocity + moment * omega).sum(axis=1)
    return power


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
