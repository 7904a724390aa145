"""Rates at a state by differences of positions: of closures, platform coordinates, energy and springs.

The path q(u) = q ⊕ (v u + a u²/2) leaves q (nq,) with the velocity v and the acceleration a (nv,). What is differenced
along it is a function of positions, or an energy: no Jacobian, no bias term and no generalised force of the package
enters, so that these are judged.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.tree_loads import tree_energy
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import coordinates, difference
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import JointForces, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.robot.lookup import find_joint, find_link_index
from redundancy_pin.robot.scales import coordinate_unit, velocity_unit

_PLACES = np.arange(-4.0, 5.0)
_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
"""Eighth-order central differences of values a step apart (Fornberg 1988, table 1)."""

_TURN = 0.04
"""Step, as the sum of what all joints move in it, rad or characteristic lengths. Rounding of a second difference is
1e-12 of the square of that sum over the square of the time. If all joints turned in one sine of twice the angle, first
differences would leave out 5e-12, second ones 2e-12."""

_STILL = 1e-3
"""Rates, rad/s or characteristic lengths per s, and second rates, that smaller ones are compared with."""


def closure_misses(robot: Robot, q: Array, v: Array, a: Array, xd: Array, xdd: Array) -> Array:
    """Return (N,) by how much v and a (N, nv) at q (N, nq) miss closures, ẋ and ẍ (N, n).

    Along the path the closure residual keeps Φ̇ = Φ̈ = 0, and the coordinates x have the rates ẋ and ẍ. Misses of rates
    are relative to the size s of the joint rates, s² = (Σ|v|)² + Σ|a|, those of second rates to s².
    """
    system, unit = constraint_system(robot), coordinate_unit(robot)
    misses = np.empty(len(q))
    for k, (step, size, path) in enumerate(_paths(robot, q, v, a)):
        tree = system.evaluate(np.array(path))
        x = coordinates(robot, tree)
        start = np.broadcast_to(x[len(_PLACES) // 2], x.shape)
        moved = np.hstack([tree.phi / system.closure_unit, difference(robot, x, start) / unit])
        wanted = np.hstack([np.zeros((2, tree.phi.shape[1])), np.array([xd[k], xdd[k]]) / unit])
        found = np.array([_FIRST @ moved / step, _SECOND @ moved / step**2])
        misses[k] = np.abs((found - wanted) / np.maximum([[size], [size**2]], _STILL)).max(initial=0.0)
    return misses


def energy_rate(robot: Robot, motion: PlatformMotion, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return (N,) the rate of the energy, W, and the power that loads take out of the robot, W, at N states."""
    model, data = robot.model, robot.model.createData()
    values = wrench_values(robot.loads, motion.t, motion.x, motion.xd)
    rates, lost = np.empty(len(q)), np.empty(len(q))
    for k, (step, _, path) in enumerate(_paths(robot, q, v, a)):
        speeds = [v[k] + u * step * a[k] for u in _PLACES]
        rates[k] = _FIRST @ [tree_energy(robot, data, *state) for state in zip(path, speeds, strict=True)] / step
        lost[k] = _joint_losses(robot, v[k])
        for spring in of_kind(robot.loads, Spring):
            lost[k] += spring.damping * (_FIRST @ [_length(robot, data, spring, place) for place in path] / step) ** 2
        pin.framesForwardKinematics(model, data, q[k])
        pin.forwardKinematics(model, data, q[k], v[k])
        for wrench, value in zip(of_kind(robot.loads, Wrench), values, strict=True):
            lost[k] -= _wrench_power(robot, data, wrench, value[k])
    return rates, lost


def _paths(robot: Robot, q: Array, v: Array, a: Array) -> Iterator[tuple[float, float, list[Array]]]:
    """Yield of each state the step, s, a size of the joint rates, 1/s, and the configurations a step apart."""
    unit = velocity_unit(robot)
    for here, speed, rate in zip(q, v, a, strict=True):
        size = float(np.hypot(np.abs(speed / unit).sum(), np.sqrt(np.abs(rate / unit).sum())))
        step = _TURN / max(size, 1.0)
        yield step, size, [pin.integrate(robot.model, here, u * speed + 0.5 * u**2 * rate) for u in step * _PLACES]


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
