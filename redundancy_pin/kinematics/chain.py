"""Closures and platform rows at one state, fast: what a simulation evaluates tens of thousands of times.

The rows, and their derivation, are those of ``kinematics.closure``: an axis a and its partner c give the wrench
w = (σ a, c × a), and J_c = ± w · J. That module works on many configurations at once, in numpy; at one configuration
Pinocchio's joint Jacobian J and its rate are there already, and the rows of all closures are one small array, which is
an order of magnitude faster. Here

    J_c = mask ∘ (w J),   J̇_c = mask ∘ (ẇ J + w J̇),   J̈_c = mask ∘ (ẅ J + 2 ẇ J̇ + w J̈),

with mask +1 where a joint moves the row's second body only, −1 where it moves the first only, and

    ẇ = (σ ȧ, ċ × a + c × ȧ),   ẅ = (σ ä, c̈ × a + 2 ċ × ȧ + c × ä),   ȧ = ω_A × a,   ċ = σ v_C + ω_C × c.

Rows of a platform's twist are such rows too. Their axis is one of the world; the partner of a translation is the
platform's origin, that of a rotation about a third axis of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.closure import constraint_system, independent_velocity
from redundancy_pin.kinematics.coordinates import joint_position, platform_coordinates
from redundancy_pin.robot import AXES, Robot

_LEFT = np.array([1, 2, 2, 0, 0, 1])
_RIGHT = np.array([2, 1, 0, 2, 1, 0])
_SUM = np.array([[1.0, -1.0, 0, 0, 0, 0], [0, 0, 1.0, -1.0, 0, 0], [0, 0, 0, 0, 1.0, -1.0]]).T.copy()
_ONES = np.ones(6)


def cross(x: Array, y: Array) -> Array:
    """Return the cross products of (..., 3) vectors; numpy's own takes ten times as long on a few of them."""
    product: Array = (x.take(_LEFT, -1) * y.take(_RIGHT, -1)).dot(_SUM)
    return product


class _Row(NamedTuple):
    """One row: its axis and partner as (frame, column), column 3 the origin, and the bodies between which it acts."""

    axis: tuple[int, int]
    partner: tuple[int, int]
    first: int
    second: int
    sign: float


class RowSet:
    """Rows at one state. ``place`` sets the configuration, the other methods answer for it.

    Args:
        rows: of R rows.
        support: (F, nv) 1 where a velocity moves a frame.
    """

    def __init__(self, rows: Sequence[_Row], support: Array) -> None:
        self.size = len(rows)
        # axes of all rows, then their partners
        pairs = np.array([row.axis for row in rows] + [row.partner for row in rows], dtype=np.intp).reshape(-1, 2)
        self._vectors = 4 * pairs[:, 0] + pairs[:, 1]
        self._carried = support[pairs[:, 0]]
        self._swapped = np.roll(np.arange(2 * self.size), self.size)
        signs = np.array([row.sign for row in rows] + [1.0] * self.size)[:, None]
        self._signs = signs if (signs < 0.0).any() else None
        self._moving = (pairs[:, 1:] == 3).astype(float)
        self.slides = self._moving[self.size :]
        self._origins = 4 * pairs[: self.size, 0] + 3
        self.mask = support[[row.second for row in rows]] - support[[row.first for row in rows]]
        self.wrench = np.zeros((self.size, 6))
        self._rate = np.zeros((self.size, 6))

    def place(self, vectors: Array) -> None:
        """Set the configuration: (4 F, 3) the axes and the origin of each frame, world axes."""
        self._placed = vectors
        self._pairs = pairs = vectors.take(self._vectors, 0)
        if self._signs is not None:
            pairs *= self._signs
        self._axis, self._partner = axis, partner = pairs[: self.size], pairs[self.size :]
        np.multiply(axis, self.slides, out=self.wrench[:, :3])
        self.wrench[:, 3:] = cross(partner, axis)

    def residual(self) -> Array:
        """Return (R,) Φ = a · (c − σ p_A), m; for rotation rows the sine of the angle that is off."""
        phi: Array = (self._axis * (self._partner - self._placed.take(self._origins, 0) * self.slides)).sum(axis=1)
        return phi

    def jacobian(self, J: Array) -> Array:
        """Return (R, nv) the rows, for joint columns J (6, nv) about the world origin."""
        rows: Array = self.mask * self.wrench.dot(J)
        return rows

    def jacobian_rate(self, J: Array, dJ: Array, v: Array) -> Array:
        """Return (R, nv) the rate of the rows."""
        rate, _ = self._wrench_rate(J, v)
        rows: Array = self.mask * (rate.dot(J) + self.wrench.dot(dJ))
        return rows

    def bias(self, J: Array, dJ: Array, v: Array) -> Array:
        """Return (R,) the rate of the rows times v."""
        rate, relative = self._wrench_rate(J, v)
        bias: Array = (self.mask * self.wrench.dot(dJ)).dot(v)
        bias += (rate * relative).dot(_ONES)
        return bias

    def _wrench_rate(self, J: Array, v: Array) -> tuple[Array, Array]:
        """Return ẇ (R, 6) and the velocity of the partner's body relative to the axis's at the world origin (R, 6)."""
        twists = (self._carried * v).dot(J.T)
        pairs, size = self._pairs, self.size
        rates = cross(twists[:, 3:], pairs) + twists[:, :3] * self._moving
        # ċ × a + c × ȧ = ċ × a − ȧ × c: one call for both
        parts = cross(rates.take(self._swapped, 0), pairs)
        rate = self._rate
        np.multiply(rates[:size], self.slides, out=rate[:, :3])
        np.subtract(parts[:size], parts[size:], out=rate[:, 3:])
        return rate, twists[size:] - twists[:size]

    def time_derivatives(self, J: Array, dJ: Array, ddJ: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return (R, nv) the rows and their first and second time derivative along a motion v, a (nv,)."""
        twists, rates = (self._carried * v) @ J.T, (self._carried * a) @ J.T + (self._carried * v) @ dJ.T
        spin, moving = twists[:, 3:], self._moving
        first = cross(spin, self._pairs) + twists[:, :3] * moving
        # the spatial acceleration at the world origin is the rate of the velocity there
        second = cross(rates[:, 3:], self._pairs) + cross(spin, first) + rates[:, :3] * moving
        (axis, partner), (da, dc), (dda, ddc) = (
            (part[: self.size], part[self.size :]) for part in (self._pairs, first, second)
        )
        wrench = self.wrench
        rate = np.concatenate([da * self.slides, cross(dc, axis) + cross(partner, da)], axis=1)
        curve = cross(ddc, axis) + 2.0 * cross(dc, da) + cross(partner, dda)
        bend = np.concatenate([dda * self.slides, curve], axis=1)
        return (
            self.mask * (wrench @ J),
            self.mask * (rate @ J + wrench @ dJ),
            self.mask * (bend @ J + 2.0 * rate @ dJ + wrench @ ddJ),
        )


class ClosedChain:
    """Closure rows and platform rows of a robot at one state.

    An evaluator with a workspace: ``update`` sets the state, the other methods answer for it. It holds Pinocchio data,
    so each thread or process makes its own.

    Args:
        robot: the robot.

    Attributes:
        system: the batched evaluator of the same rows.
        rows: number r of closure rows.
        pose_columns: velocity indices that move the pose.
        J, dJ: (6, nv) joint Jacobian about the world origin and its rate, at the last state.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = model = robot.model
        self.data = data = model.createData()
        self.system = constraint_system(robot)
        self.pose_columns = self.system.pose_columns
        names = list(self.system.tree.support)
        ids = [model.getFrameId(name, pin.FrameType.BODY) for name in names]
        pin.framesForwardKinematics(model, data, np.array(robot.q_reference))
        # the world is one more frame, which nothing moves
        self._axes = np.zeros((len(names) + 1, 4, 3))
        self._axes[-1, :3] = np.eye(3)
        self._vectors = self._axes.reshape(-1, 3)
        # views into Pinocchio's memory and into ours, taken once: looking them up costs as much as the arithmetic
        self._frames = [
            (self._axes[i, :3].T, self._axes[i, 3], data.oMf[frame].rotation, data.oMf[frame].translation)
            for i, frame in enumerate(ids)
        ]
        self.J, self.dJ = data.J, data.dJ
        support = np.zeros((len(names) + 1, model.nv))
        for i, name in enumerate(names):
            support[i, list(self.system.tree.support[name])] = 1.0
        at = {name: i for i, name in enumerate(names)}
        closures = []
        for closure, row in self.system.rows:
            a, b = at[closure.frame_a], at[closure.frame_b]
            closures.append(_Row((a, row.axis_a), (b, row.axis_b if row.rotation else 3), a, b, row.sign))
        self.closures = RowSet(closures, support)
        self.rows = self.closures.size
        self._platform = at[robot.platform.frame] if robot.platform is not None else -1
        self.platform = RowSet(self._platform_rows(len(names)), support)
        """Rows of the platform's twist; none where the independent velocities are those of joints."""
        self._independent = np.zeros((robot.n, model.nv))
        if robot.platform is None:
            self._independent[np.arange(robot.n), independent_velocity(robot)] = 1.0

    def _platform_rows(self, world: int) -> list[_Row]:
        axes = self.robot.platform.axes if self.robot.platform is not None else ()
        rows = []
        for rotation, k in (divmod(AXES.index(axis), 3) for axis in axes):
            axis = (k + 2) % 3 if rotation else k  # e_{k+1} × e_{k+2} = e_k
            partner = (world, (k + 1) % 3) if rotation else (self._platform, 3)
            rows.append(_Row((world, axis), partner, world, self._platform, 1.0))
        return rows

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        pin.computeJointJacobiansTimeVariation(self.model, self.data, q, v)
        pin.updateFramePlacements(self.model, self.data)
        for axes, origin, rotation, translation in self._frames:
            axes[:] = rotation
            origin[:] = translation
        self.q, self.v = q, v
        self.closures.place(self._vectors)
        self._platform_is_placed = False

    def residual(self) -> Array:
        """Return (r,) the closure residuals Φ, m; for rotation rows the sine of the angle that is off."""
        return self.closures.residual()

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        return self.closures.jacobian(self.J)

    def bias(self) -> Array:
        """Return J̇_c v (r,)."""
        return self.closures.bias(self.J, self.dJ, self.v)

    def jacobian_rate(self) -> Array:
        """Return J̇_c (r, nv)."""
        return self.closures.jacobian_rate(self.J, self.dJ, self.v)

    def platform_position(self) -> Array:
        """Return the independent coordinates: (n,), or a pose (4, 4). A single rotation lies in (−π, π]."""
        robot = self.robot
        if robot.platform is None:
            return np.array([joint_position(robot, name, self.q[None])[0] for name in robot.independent_joints])
        rotation, origin = self._axes[self._platform, :3].T, self._axes[self._platform, 3]
        position: Array = platform_coordinates(robot, rotation[:, :, None], origin[:, None])[0]
        return position

    def platform_rows(self) -> RowSet:
        """Return the rows of the platform's twist, at the state."""
        if not self._platform_is_placed:  # closures alone are what most calls need
            self.platform.place(self._vectors)
            self._platform_is_placed = True
        return self.platform

    def platform_jacobian(self) -> Array:
        """Return J_x (n, nv): rows of the platform twist, world-aligned at its origin, or unit rows of joints."""
        return self._independent if self._platform < 0 else self.platform_rows().jacobian(self.J)

    def platform_jacobian_rate(self) -> Array:
        """Return J̇_x (n, nv)."""
        if self._platform < 0:
            return np.zeros_like(self._independent)
        return self.platform_rows().jacobian_rate(self.J, self.dJ, self.v)
