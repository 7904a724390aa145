"""Rates of closures and of the platform by their definitions, from Pinocchio's frames: nothing of ``kinematics``.

A closure row keeps the product of two vectors constant: an axis u of frame A and r, from the origin of A to the origin
of B; two axes u, w that stay normal; or r and r of a rod. Joint rates that keep the loop closed make both

    (u·w)˙ = u̇·w + u·ẇ   and   (u·w)¨ = ü·w + 2 u̇·ẇ + u·ẅ

vanish. Every vector comes with its two derivatives, as rows of (3, 3).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import AXES, Closure, Platform, Robot
from redundancy_pin.robot.lookup import find_joint, find_link_index

_WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class _Frame:
    """A frame in motion.

    Attributes:
        origin: (3, 3) position, velocity and acceleration of its origin as rows, m and s.
        spin: (2, 3) angular velocity and acceleration as rows, rad and s.
        axes: (3, 3, 3) rotation matrix and its two derivatives; the columns are the axes.
    """

    def __init__(self, robot: Robot, data: pin.Data, name: str) -> None:
        index = find_link_index(robot.model, name)
        place = pin.updateFramePlacement(robot.model, data, index)
        speed = pin.getFrameVelocity(robot.model, data, index, _WORLD)
        rate = pin.getFrameClassicalAcceleration(robot.model, data, index, _WORLD)
        turn, R = pin.skew(speed.angular), place.rotation
        self.origin = np.array([place.translation, speed.linear, rate.linear])
        self.spin = np.array([speed.angular, rate.angular])
        self.axes = np.array([R, turn @ R, (pin.skew(rate.angular) + turn @ turn) @ R])

    def sizes(self, length: float) -> Array:
        """Return (2,) sizes of velocity and acceleration, 1/s and 1/s²."""
        linear, angular = np.linalg.norm(self.origin[1:], axis=1) / length, np.linalg.norm(self.spin, axis=1)
        return np.asarray(linear + angular + [0.0, angular[0] ** 2])


def largest_miss(robot: Robot, q: Array, v: Array, a: Array, xd: Array, xdd: Array) -> float:
    """Return by how much v and a (nv,) at q (nq,) miss closures, ẋ and ẍ (n,), relative to the size of their terms."""
    model, data, length = robot.model, robot.model.createData(), robot.characteristic_length
    pin.forwardKinematics(model, data, q, v, a)
    misses = [np.zeros(2)]
    for closure in robot.closures:
        first, second = _Frame(robot, data, closure.frame_a), _Frame(robot, data, closure.frame_b)
        size = np.maximum(first.sizes(length) + second.sizes(length), 1e-3)
        misses += [rates / size for rates in _closure_rates(closure, first, second, length)]
    for coupling in robot.couplings:
        p, terms = np.polynomial.Polynomial(coupling.polynomial), [_joint(robot, coupling.joint, q, v, a)[1:]]
        if coupling.of:
            position, rate, second_rate = _joint(robot, coupling.of, q, v, a)
            slope = p.deriv()(position)
            terms.append(np.array([-slope * rate, -slope * second_rate - p.deriv(2)(position) * rate**2]))
        terms += [-factor * _joint(robot, name, q, v, a)[1:] for name, factor in coupling.also]
        misses.append(np.sum(terms, axis=0) / np.maximum(np.abs(terms).sum(axis=0), 1e-3))
    if robot.platform is None:
        moved = np.array([_joint(robot, name, q, v, a)[1:] for name in robot.independent_joints])
        size = np.full_like(moved, 1e-3)
    else:
        frame, units = _Frame(robot, data, robot.platform.frame), np.repeat([length, 1.0], 3)[:, None]
        angles = frame.spin.T if robot.platform.is_pose else _angles(frame.axes, robot.platform)
        rows = [AXES.index(axis) for axis in robot.platform.axes]
        moved = np.concatenate([frame.origin[1:].T, angles])[rows]
        size = np.maximum(frame.sizes(length), 1e-3) * units[rows]
    misses.append((moved - np.stack([xd, xdd], axis=1)) / np.maximum(size, np.abs(moved)))
    return float(np.abs(np.concatenate([np.atleast_2d(miss) for miss in misses])).max())


def _joint(robot: Robot, name: str, q: Array, v: Array, a: Array) -> Array:
    """Return (3,) position, rate and second rate of a joint of one degree of freedom."""
    joint = find_joint(robot.model, name)
    return np.array([q[joint.idx_q], v[joint.idx_v], a[joint.idx_v]])


def _closure_rates(closure: Closure, first: _Frame, second: _Frame, length: float) -> list[Array]:
    """Return (2,) rate and second rate of each row of a closure, translations in units of ``length``."""
    r = (second.origin - first.origin) / length
    if closure.is_rod:
        return [_product(r, r) / (2.0 * closure.length / length)]
    rates, held = [], [AXES.index(axis) - 3 for axis in closure.axes if axis in AXES[3:]]
    for axis in closure.axes:
        k = AXES.index(axis) % 3
        if axis in AXES[:3]:
            rates.append(_product(first.axes[:, :, k], r))
        elif len(held) == 2:  # a hinge: both axes of A stay normal to the axis of B about which it turns
            rates.append(_product(first.axes[:, :, k], second.axes[:, :, 3 - sum(held)]))
        else:
            rates.append(_product(first.axes[:, :, (k + 2) % 3], second.axes[:, :, (k + 1) % 3]))
    return rates


def _product(u: Array, w: Array) -> Array:
    """Return (2,) rate and second rate of the product of two vectors."""
    return np.array([u[1] @ w[0] + u[0] @ w[1], u[2] @ w[0] + 2.0 * u[1] @ w[1] + u[0] @ w[2]])


def _angles(axes: Array, platform: Platform) -> Array:
    """Return (3, 2) rates and second rates of the angles about the base axes, as ``Platform`` defines them."""
    if len(platform.rotations) < 2:
        pointer = axes[:, :, platform.pointer]
        return np.array([_polar(pointer[:, (k + 1) % 3], pointer[:, (k + 2) % 3]) for k in range(3)])
    down, cosine = -axes[:, 2, 0], np.hypot(axes[0, 0, 0], axes[0, 1, 0])  # sine and cosine of the pitch
    rate = down[1] / cosine
    pitch = rate, (down[2] + down[0] * rate**2) / cosine
    return np.array([_polar(axes[:, 2, 2], axes[:, 2, 1]), pitch, _polar(axes[:, 0, 0], axes[:, 1, 0])])


def _polar(x: Array, y: Array) -> tuple[float, float]:
    """Return rate and second rate of atan2(y, x) from x and y, each (3,) with its two derivatives."""
    square = float(x[0] ** 2 + y[0] ** 2) or np.nan
    rate = float(x[0] * y[1] - y[0] * x[1]) / square
    return rate, float(x[0] * y[2] - y[0] * x[2] - 2.0 * rate * (x[0] * x[1] + y[0] * y[1])) / square
