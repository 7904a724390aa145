"""Rate of the energy of a robot and power of its loads, from energies and lengths alone: no generalised force."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.tree_loads import tree_energy
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import JointForces, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.robot.lookup import find_joint, find_link_index

_STENCIL = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
"""Sixth-order central differences, of values a step apart."""

_TURN = 0.01
"""Step of the differences, as the sum of the angles by which all joints turn in it, rad: of the sine of twice that
angle the quotient leaves out 5e-13, and rounding is 1e-14."""


def energy_rate(robot: Robot, motion: PlatformMotion, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return (N,) the rate of the energy, W, and the power that loads take out of the robot, W, at N states.

    Differences are along q ⊕ v u, v + a u, so that q (N, nq), v (N, nv) and a (N, nv) decide alone.
    """
    model, data = robot.model, robot.model.createData()
    values = wrench_values(robot.loads, motion.t, motion.x, motion.xd)
    rates, lost = np.empty(len(q)), np.empty(len(q))
    for k in range(len(q)):
        step = _TURN / max(np.abs(v[k]).sum(), 1.0)
        wide = [(pin.integrate(model, q[k], u * v[k]), v[k] + u * a[k]) for u in step * np.arange(-3, 4)]
        rates[k] = _STENCIL @ [tree_energy(robot, data, *state) for state in wide] / step
        lost[k] = _joint_losses(robot, v[k])
        for spring in of_kind(robot.loads, Spring):
            lengths = [_length(robot, data, spring, position) for position, _ in wide]
            lost[k] += spring.damping * (_STENCIL @ lengths / step) ** 2
        pin.framesForwardKinematics(model, data, q[k])
        pin.forwardKinematics(model, data, q[k], v[k])
        for wrench, value in zip(of_kind(robot.loads, Wrench), values, strict=True):
            lost[k] -= _wrench_power(robot, data, wrench, value[k])
    return rates, lost


def _joint_losses(robot: Robot, v: Array) -> float:
    """Return the power lost to friction and damping of joints, W."""
    total = 0.0
    for load in of_kind(robot.loads, JointForces):
        joint = find_joint(robot.model, load.joint)
        speed = v[joint.idx_v : joint.idx_v + joint.nv]
        total += float((load.damping * speed + load.friction * np.tanh(speed / load.friction_speed)) @ speed)
    return total


def _wrench_power(robot: Robot, data: pin.Data, wrench: Wrench, value: Array) -> float:
    """Return the power of a wrench (6,) at its point, W."""
    index = find_link_index(robot.model, wrench.frame)
    twist = pin.getFrameVelocity(robot.model, data, index, pin.ReferenceFrame.LOCAL)
    rotation = np.eye(3) if wrench.reference == "local" else data.oMf[index].rotation
    velocity = twist.linear + np.cross(twist.angular, wrench.point)
    return float(value[:3] @ rotation @ velocity + value[3:] @ rotation @ twist.angular)


def _length(robot: Robot, data: pin.Data, spring: Spring, q: Array) -> float:
    """Return the length of a spring, m."""
    pin.framesForwardKinematics(robot.model, data, q)
    ends = (spring.frame_a, spring.point_a), (spring.frame_b, spring.point_b)
    first, second = (data.oMf[find_link_index(robot.model, frame)].act(np.array(point)) for frame, point in ends)
    return float(np.linalg.norm(second - first))
