"""Closures and tree dynamics at one state, fast: what a simulation evaluates tens of thousands of times.

A closure row is a wrench (force along a, moment about the world origin) that acts on the tree with opposite signs
through the joints below frame B and below frame A:

- translation along a:  w = (a, p_B × a),  rotation:  w = (0, b × a),   J_c = mask ∘ (w J),

with J the joint Jacobian in world coordinates and mask +1 where a joint moves B only, −1 where it moves A only. This is
the same row as in ``kinematics.closure`` (with Δ = p_B − p_A, the lever of A's rotation falls out). The time derivative
is J̇_c = mask ∘ (ẇ J + w J̇). ``kinematics.closure`` works on many configurations at once; this module on one, for
which it is an order of magnitude faster.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.robot import AXES, Robot

_LEFT = np.array([1, 2, 2, 0, 0, 1])
_RIGHT = np.array([2, 1, 0, 2, 1, 0])
_SUM = np.array([[1.0, -1.0, 0, 0, 0, 0], [0, 0, 1.0, -1.0, 0, 0], [0, 0, 0, 0, 1.0, -1.0]]).T.copy()
_ONES = np.ones(6)


def cross(x: Array, y: Array) -> Array:
    """Return the cross products of (..., 3) vectors; numpy's own takes ten times as long on a few of them."""
    product: Array = (x.take(_LEFT, -1) * y.take(_RIGHT, -1)).dot(_SUM)
    return product


class ClosedChain:
    """Closure rows and platform rows of a robot at one state.

    An evaluator with a workspace: ``update`` sets the state, the other methods answer for it. It holds Pinocchio data,
    so each thread or process makes its own.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = model = robot.model
        self.data = data = model.createData()
        self.system = ConstraintSystem(robot)
        """The batched evaluator of the same rows."""
        self.rows = len(self.system.rows)
        self.pose_columns = self.system.pose_columns
        names = list(self.system.tree.support)
        ids = [model.getFrameId(name, pin.FrameType.BODY) for name in names]
        pin.framesForwardKinematics(model, data, np.array(robot.q_reference))
        self._axes = np.zeros((len(ids), 4, 3))
        self._flat = self._axes.reshape(-1, 3)
        # views into Pinocchio's memory and into ours, taken once: looking them up costs as much as the arithmetic
        self._frames = [
            (self._axes[i, :3].T, self._axes[i, 3], data.oMf[frame].rotation, data.oMf[frame].translation)
            for i, frame in enumerate(ids)
        ]
        self.J = data.J
        self.dJ = data.dJ
        self.support = np.zeros((len(ids), model.nv))
        for i, name in enumerate(names):
            self.support[i, list(self.system.tree.support[name])] = 1.0
        at = {name: i for i, name in enumerate(names)}
        row_of_axis, row_of_partner, first, second = [], [], [], []
        for closure, row in self.system.rows:
            a, b = at[closure.frame_a], at[closure.frame_b]
            row_of_axis.append(4 * a + row.axis_a)
            row_of_partner.append(4 * b + (row.axis_b if row.rotation else 3))
            first.append(a)
            second.append(b)
        # directions a of all rows, then their partners c: the point p_B, or the axis b of a rotation row
        self._vectors = np.array(row_of_axis + row_of_partner, dtype=np.intp)
        self.first, self.second = np.array(first, dtype=np.intp), np.array(second, dtype=np.intp)
        self._carried = self.support[np.concatenate([self.first, self.second])]
        self._swapped = np.roll(np.arange(2 * self.rows), self.rows)
        signs = [row.sign for _, row in self.system.rows]
        self._signs = np.array(signs + [1.0] * self.rows)[:, None]
        self.slides = np.array([0.0 if row.rotation else 1.0 for _, row in self.system.rows])[:, None]
        self._moving = np.concatenate([0.0 * self.slides, self.slides])
        self.mask = self.support[self.second] - self.support[self.first]
        self._wrench = np.zeros((self.rows, 6))
        self._wrench_rate = np.zeros((self.rows, 6))
        self.platform_index = at[robot.platform.frame] if robot.platform is not None else -1

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        pin.computeJointJacobiansTimeVariation(self.model, self.data, q, v)
        self._place()
        self.v = v
        self.q = q
        self._pairs = pairs = self._flat.take(self._vectors, 0) * self._signs
        self.direction, self.point = pairs[: self.rows], pairs[self.rows :]
        self._wrench[:, :3] = self.direction * self.slides
        self._wrench[:, 3:] = cross(self.point, self.direction)

    def _place(self) -> None:
        """Take the frames from the joints."""
        pin.updateFramePlacements(self.model, self.data)
        for axes, origin, rotation, translation in self._frames:
            axes[:] = rotation
            origin[:] = translation

    def residual(self) -> Array:
        """Return (r,) the closure residuals Φ, m; for rotation rows the sine of the angle that is off."""
        origin = self._axes[self.first, 3] * self.slides
        phi: Array = (self.direction * (self.point - origin)).sum(axis=1)
        return phi

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        rows: Array = self.mask * self._wrench.dot(self.J)
        return rows

    def jacobians(self, q: Array) -> Array:
        """Return J_c (N, r, nv) at (N, nq) configurations, the state being that of none of them afterwards."""
        places, joints = np.empty((len(q), *self._flat.shape)), np.empty((len(q), 6, self.model.nv))
        for i, one in enumerate(q):
            pin.computeJointJacobians(self.model, self.data, one)
            self._place()
            places[i], joints[i] = self._flat, self.J
        pairs = places.take(self._vectors, 1) * self._signs
        direction, point = pairs[:, : self.rows], pairs[:, self.rows :]
        wrenches = np.concatenate([direction * self.slides, cross(point, direction)], axis=2)
        rows: Array = self.mask * (wrenches @ joints)
        return rows

    def bias(self) -> Array:
        """Return J̇_c v (r,)."""
        twist, relative = self._wrench_rates(self.v)
        carried: Array = (self.mask * self._wrench.dot(self.dJ)).dot(self.v)
        carried += (twist * relative).dot(_ONES)
        return carried

    def jacobian_rate(self) -> Array:
        """Return J̇_c (r, nv)."""
        twist, _ = self._wrench_rates(self.v)
        rows: Array = self.mask * (twist.dot(self.J) + self._wrench.dot(self.dJ))
        return rows

    def _wrench_rates(self, v: Array) -> tuple[Array, Array]:
        """Return ẇ (r, 6) and the velocity of B's body relative to A's at the world origin (r, 6)."""
        twists = (self._carried * v).dot(self.J.T)
        pairs, rows = self._pairs, self.rows
        rates = cross(twists[:, 3:], pairs) + twists[:, :3] * self._moving
        # ċ × a + c × ȧ = ċ × a − ȧ × c: one call for both
        parts = cross(rates.take(self._swapped, 0), pairs)
        rate = self._wrench_rate
        rate[:, :3] = rates[:rows] * self.slides
        rate[:, 3:] = parts[:rows] - parts[rows:]
        return rate, twists[rows:] - twists[:rows]

    def frame_origin(self, index: int) -> Array:
        """Return (3,) the origin of one of the followed frames, world axes, m."""
        origin: Array = self._axes[index, 3]
        return origin

    def platform_position(self) -> Array:
        """Return the independent coordinates: (n,), or a pose (4, 4). A single rotation lies in (−π, π]."""
        robot = self.robot
        if robot.platform is None:
            return _joint_positions(robot, robot.independent_joints, self.q)
        rotation, origin = self._axes[self.platform_index, :3].T, self._axes[self.platform_index, 3]
        if robot.platform.is_pose:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, origin
            return pose
        return np.array([_along(rotation, origin, axis) for axis in robot.platform.axes])

    def platform_jacobian(self) -> Array:
        """Return J_x (n, nv): rows of the platform twist, world-aligned at its origin, or unit rows of joints."""
        robot = self.robot
        if robot.platform is None:
            return _unit_rows(robot)
        origin = self._axes[self.platform_index, 3]
        rows: Array = platform_wrenches(robot, origin).dot(self.J) * self.support[self.platform_index]
        return rows

    def platform_jacobian_rate(self) -> Array:
        """Return J̇_x (n, nv)."""
        robot = self.robot
        if robot.platform is None:
            return np.zeros((robot.n, self.model.nv))
        support, origin = self.support[self.platform_index], self._axes[self.platform_index, 3]
        twist = self.J.dot(support * self.v)
        lever = platform_wrenches(robot, twist[:3] + cross(twist[3:], origin))
        lever[:, :3] = 0.0
        lever[[axis.startswith("r") for axis in robot.platform.axes], 3:] = 0.0
        rows: Array = (lever.dot(self.J) + platform_wrenches(robot, origin).dot(self.dJ)) * support
        return rows


def platform_wrenches(robot: Robot, origin: Array) -> Array:
    """Return (n, 6) the wrench about the world origin that belongs to each platform row, the platform at ``origin``."""
    axes = robot.platform.axes if robot.platform is not None else ()
    wrenches = np.zeros((len(axes), 6))
    for i, axis in enumerate(axes):
        rotation, k = divmod(AXES.index(axis), 3)
        unit = np.eye(3)[k]
        if rotation:
            wrenches[i, 3:] = unit
        else:
            wrenches[i, :3] = unit
            wrenches[i, 3:] = cross(origin, unit)
    return wrenches


def _unit_rows(robot: Robot) -> Array:
    rows = np.zeros((robot.n, robot.model.nv))
    for i, name in enumerate(robot.independent_joints):
        rows[i, robot.model.joints[robot.model.getJointId(name)].idx_v] = 1.0
    return rows


def _joint_positions(robot: Robot, names: tuple[str, ...], q: Array) -> Array:
    values = []
    for name in names:
        joint = robot.model.joints[robot.model.getJointId(name)]
        turning = joint.nq == 2
        values.append(np.arctan2(q[joint.idx_q + 1], q[joint.idx_q]) if turning else q[joint.idx_q])
    return np.array(values, dtype=np.float64)


def _along(rotation: Array, origin: Array, axis: str) -> float:
    """Return the coordinate of a platform along one axis, read as ``kinematics.coordinates`` reads it."""
    is_rotation, k = divmod(AXES.index(axis), 3)
    if not is_rotation:
        return float(origin[k])
    i, j = (k + 1) % 3, (k + 2) % 3
    column = next((c for c in (i, j) if np.hypot(rotation[i, c], rotation[j, c]) > 0.5), k)
    return float(np.arctan2(rotation[j, column], rotation[i, column]))
