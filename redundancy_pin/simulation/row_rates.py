"""Closure rows and platform rows with their first and second time derivatives, for derivatives of the dynamics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.simulation.chain import ClosedChain, cross, platform_wrenches


@dataclass(frozen=True, eq=False)
class RowRates:
    """K, the closure rows over the platform rows, along a motion (q, v, a).

    Attributes:
        K: (r + n, nv) rows, K v = (0, ẋ).
        Kd: (r + n, nv) time derivative.
        by_q: (r + n, nv) derivative of K v by q, v held.
        rate_by_q: (r + n, nv) derivative of the row accelerations K a + K̇ v by q, v and a held.
        rate_by_v: (r + n, nv) the same by v.
    """

    K: Array
    Kd: Array
    by_q: Array
    rate_by_q: Array
    rate_by_v: Array


def row_rates(chain: ClosedChain, q: Array, v: Array, a: Array) -> RowRates:
    """Evaluate the rows and what is needed of their derivatives.

    For a row that is the differential of a function φ of q, and joints of one freedom each, variations and time
    derivatives commute: δφ̇ = J̇ δq + J δv and δφ̈ = J̈ δq + 2 J̇ δv + J δa. World-aligned rotation rows of the platform are
    no differentials: with δθ = J δq, δω = d(δθ)/dt + δθ × ω.

    Args:
        chain: evaluator of the robot, whose joints have one freedom each.
        q: (nq,) configuration.
        v: (nv,) velocity.
        a: (nv,) acceleration.
    """
    first, second, third = _world_columns(chain, q, v, a)
    wrench, wrench_rate, wrench_second = _closure_wrenches(chain, v, a, first, second)
    mask = chain.mask
    K = mask * (wrench @ first)
    Kd = mask * (wrench_rate @ first + wrench @ second)
    Kdd = mask * (wrench_second @ first + 2.0 * wrench_rate @ second + wrench @ third)
    parts = [(K, Kd, Kd, Kdd, 2.0 * Kd), _platform_rows(chain, v, a, first, second, third)]
    return RowRates(*(np.concatenate([top, bottom]) for top, bottom in zip(*parts, strict=True)))


def _world_columns(chain: ClosedChain, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
    """Return (6, nv) the joint Jacobian at the world origin, and its first and second time derivative.

    A column is fixed in the body that its joint moves: X' = V × X and X'' = A × X + V × X', spatial cross products with
    the velocity V and acceleration A of that body.
    """
    model, data = chain.model, chain.data
    pin.forwardKinematics(model, data, q, v, a)
    chain.update(q, v)
    J, dJ = chain.J.copy(), chain.dJ.copy()
    twists, rates = np.empty((6, model.nv)), np.empty((6, model.nv))
    for j in range(1, model.njoints):
        joint = model.joints[j]
        above = np.zeros(model.nv)
        for parent in model.supports[j]:
            if parent > 0:
                above[model.joints[parent].idx_v] = 1.0
        twists[:, joint.idx_v] = J @ (above * v)
        rates[:, joint.idx_v] = J @ (above * a) + dJ @ (above * v)
    return J, dJ, _spatial_cross(rates, J) + _spatial_cross(twists, dJ)


def _spatial_cross(motion: Array, columns: Array) -> Array:
    """Return the motion cross products of (6, c) columns, linear parts first."""
    linear, angular = motion[:3].T, motion[3:].T
    moved = cross(angular, columns[:3].T) + cross(linear, columns[3:].T)
    return np.concatenate([moved.T, cross(angular, columns[3:].T).T])


def _closure_wrenches(chain: ClosedChain, v: Array, a: Array, J: Array, dJ: Array) -> tuple[Array, Array, Array]:
    """Return the wrenches (r, 6) of the closure rows and their first and second time derivative."""
    twists = (chain.support * v) @ J.T
    rates = (chain.support * a) @ J.T + (chain.support * v) @ dJ.T
    of_a, of_b, rate_a, rate_b = twists[chain.first], twists[chain.second], rates[chain.first], rates[chain.second]
    slides, d, p = chain.slides, chain.direction, chain.point
    turn_a, turn_b = of_a[:, 3:], of_b[:, 3:]
    dd = cross(turn_a, d)
    ddd = cross(rate_a[:, 3:], d) + cross(turn_a, dd)
    pd = of_b[:, :3] * slides + cross(turn_b, p)
    # the spatial acceleration at the world origin is the rate of the velocity there
    pdd = rate_b[:, :3] * slides + cross(rate_b[:, 3:], p) + cross(turn_b, pd)
    return (
        np.concatenate([d * slides, cross(p, d)], axis=1),
        np.concatenate([dd * slides, cross(pd, d) + cross(p, dd)], axis=1),
        np.concatenate([ddd * slides, cross(pdd, d) + 2.0 * cross(pd, dd) + cross(p, ddd)], axis=1),
    )


def _platform_rows(
    chain: ClosedChain, v: Array, a: Array, J: Array, dJ: Array, ddJ: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return the platform rows' part of ``RowRates``."""
    robot, index = chain.robot, chain.platform_index
    rows = chain.platform_jacobian()
    if robot.platform is None:
        zero = np.zeros_like(rows)
        return rows, zero, zero, zero, zero
    support = chain.support[index]
    origin = chain.frame_origin(index)
    twist, rate = J @ (support * v), J @ (support * a) + dJ @ (support * v)
    velocity = twist[:3] + cross(twist[3:], origin)
    acceleration = rate[:3] + cross(rate[3:], origin) + cross(twist[3:], velocity)
    wrench = platform_wrenches(robot, origin)
    # only the lever of the translation rows changes with time
    lever = [
        platform_wrenches(robot, motion) - platform_wrenches(robot, 0.0 * motion) for motion in (velocity, acceleration)
    ]
    Kd = (lever[0] @ J + wrench @ dJ) * support
    Kdd = (lever[1] @ J + 2.0 * lever[0] @ dJ + wrench @ ddJ) * support
    by_q, rate_by_q, rate_by_v = Kd.copy(), Kdd.copy(), 2.0 * Kd
    if robot.platform.is_pose:
        turning = [i for i, axis in enumerate(robot.platform.axes) if axis.startswith("r")]
        axes = [("rx", "ry", "rz").index(robot.platform.axes[i]) for i in turning]
        spin, spin_rate = (_skew(part[3:])[np.ix_(axes, axes)] for part in (twist, rate))
        by_q[turning] -= spin @ rows[turning]
        rate_by_q[turning] -= spin @ Kd[turning] + spin_rate @ rows[turning]
        rate_by_v[turning] -= spin @ rows[turning]
    return rows, Kd, by_q, rate_by_q, rate_by_v


def _skew(w: Array) -> Array:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
