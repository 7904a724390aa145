"""Loop closures and platform rows at position, velocity and acceleration level, for many samples at once.

A closure row is a scalar function of the tree configuration. With Δ = p_B − p_A and the axes i, j, k of the frames A
and B:

- translation along axis a of frame A:  Φ = a·Δ,  Φ̇ = a·(v_B − v_A) + (a×Δ)·ω_A;
- rotation:  Φ = ± a·b with a an axis of A and b an axis of B that are perpendicular when closed,
  Φ̇ = (ω_B − ω_A)·(b×a).

Which axes a rotation row pairs depends on what else is constrained: with one rotation left free (a hinge) both rows
use the free axis of B, so that they stay independent at every hinge angle. Every row is exact at every configuration,
closed or not, and no row is redundant where the mask has none too many. Two or three rotation rows have false zeros too
(a hinge turned over), which ``ConstraintSystem.misalignment`` tells apart; a single one fixes its angle up to half a
turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.tree import FrameAcceleration, TreeKinematics, TreePose, cross
from redundancy_pin.robot import AXES, Closure, Robot


@dataclass(frozen=True, eq=False)
class ConstraintState:
    """Closures and platform at N configurations; made by ``ConstraintSystem.evaluate``.

    Attributes:
        q: (N, nq) configurations.
        pose: the tree's placements.
        phi: (N, r) closure residuals Φ, m (rotation rows: sine of the angle that is off).
        Jc: (N, r, nv) constraint Jacobian dΦ/dv.
        Jx: (N, n, nv) Jacobian of the independent velocities (world-aligned platform twist, or named joints).
    """

    q: Array
    pose: TreePose
    phi: Array
    Jc: Array
    Jx: Array


class ConstraintSystem:
    """Closures and independent velocities of a robot, ready to be evaluated.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        frames = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
        if robot.platform is not None:
            frames.append(robot.platform.frame)
        self.tree = TreeKinematics(robot.model, tuple(dict.fromkeys(frames)))
        self.rows = tuple(
            (closure, row) for closure in robot.closures for row in (_row(closure, axis) for axis in closure.axes)
        )
        self._aligned = tuple((closure, k) for closure in robot.closures for k in _aligned_axes(closure))
        self.pose_columns = np.setdiff1d(np.arange(robot.model.nv), robot.carrier_velocity)
        """Velocity indices that move the pose: all but the carriers."""

    def evaluate(self, q: Array) -> ConstraintState:
        """Evaluate residuals and Jacobians.

        Args:
            q: (N, nq) configurations, closed or not.
        """
        pose = self.tree.pose(q)
        nv = self.robot.model.nv
        phi = np.empty((len(self.rows), pose.samples))
        jacobian = np.zeros((len(self.rows), nv, pose.samples))
        columns = {name: self.tree.frame_columns(pose, name) for name in self.tree.support}
        for index, (closure, row) in enumerate(self.rows):
            a = pose.frame_rotation[closure.frame_a][:, row.axis_a]
            if row.rotation:
                b = pose.frame_rotation[closure.frame_b][:, row.axis_b] * row.sign
                phi[index] = _dot(a, b)
                normal = cross(b, a)
                for frame, sign in ((closure.frame_b, 1.0), (closure.frame_a, -1.0)):
                    for column, (_, angular) in columns[frame].items():
                        if angular is not None:
                            jacobian[index, column] += sign * _dot(normal, angular)
            else:
                delta = pose.frame_origin[closure.frame_b] - pose.frame_origin[closure.frame_a]
                phi[index] = _dot(a, delta)
                lever = cross(a, delta)
                for column, (linear, _) in columns[closure.frame_b].items():
                    jacobian[index, column] += _dot(a, linear)
                for column, (linear, angular) in columns[closure.frame_a].items():
                    jacobian[index, column] -= _dot(a, linear)
                    if angular is not None:
                        jacobian[index, column] += _dot(lever, angular)
        return ConstraintState(q, pose, phi.T, jacobian.transpose(2, 0, 1), self._platform_jacobian(pose, columns))

    def misalignment(self, state: ConstraintState) -> Array:
        """Return (N,) the largest angle, rad, between two axes of a closure that must point the same way.

        The rotation rows of a hinge vanish for opposite axes too, those of a weld also for axes that changed places:
        where all rows vanish this is 0 for a true closure and at least π/2 for a false one. Closures with less than
        two rotation rows have no such axes.
        """
        angle = np.zeros(state.pose.samples)
        for closure, k in self._aligned:
            a = state.pose.frame_rotation[closure.frame_a][:, k]
            b = state.pose.frame_rotation[closure.frame_b][:, k]
            angle = np.maximum(angle, np.arccos(np.clip(_dot(a, b), -1.0, 1.0)))
        return angle

    def bias(self, state: ConstraintState, v: Array) -> tuple[Array, Array]:
        """Return J̇_c v (N, r) and J̇_x v (N, n) at velocities v (N, nv)."""
        accelerations = self.tree.accelerations(state.pose, v)
        phi_bias = np.empty((len(self.rows), state.pose.samples))
        for index, (closure, row) in enumerate(self.rows):
            frame_a, frame_b = accelerations[closure.frame_a], accelerations[closure.frame_b]
            a = state.pose.frame_rotation[closure.frame_a][:, row.axis_a]
            if row.rotation:
                b = state.pose.frame_rotation[closure.frame_b][:, row.axis_b] * row.sign
                phi_bias[index] = _rotation_bias(a, b, frame_a, frame_b)
            else:
                delta = state.pose.frame_origin[closure.frame_b] - state.pose.frame_origin[closure.frame_a]
                phi_bias[index] = _translation_bias(a, delta, frame_a, frame_b)
        return phi_bias.T, self._platform_bias(accelerations, len(v))

    def _platform_jacobian(self, pose: TreePose, columns: dict[str, dict[int, tuple[Array, Array | None]]]) -> Array:
        robot = self.robot
        jacobian: Array = np.zeros((robot.n, robot.model.nv, pose.samples))
        if robot.platform is None:
            for row, velocity in enumerate(independent_velocity(robot)):
                jacobian[row, velocity] = 1.0
        else:
            for row, axis in enumerate(robot.platform.axes):
                rotation, component = divmod(AXES.index(axis), 3)
                for column, parts in columns[robot.platform.frame].items():
                    part = parts[rotation]
                    if part is not None:
                        jacobian[row, column] = part[component]
        by_sample: Array = jacobian.transpose(2, 0, 1)
        return by_sample

    def _platform_bias(self, accelerations: dict[str, FrameAcceleration], samples: int) -> Array:
        robot = self.robot
        bias = np.zeros((robot.n, samples))
        if robot.platform is not None:
            frame = accelerations[robot.platform.frame]
            for row, axis in enumerate(robot.platform.axes):
                rotation, component = divmod(AXES.index(axis), 3)
                bias[row] = (frame.angular_bias if rotation else frame.bias)[component]
        by_sample: Array = bias.T
        return by_sample


def independent_velocity(robot: Robot) -> list[int]:
    """Return the velocity index of each independent joint of a robot without a platform."""
    model = robot.model
    return [int(model.joints[model.getJointId(name)].idx_v) for name in robot.independent_joints]


@dataclass(frozen=True)
class _Row:
    rotation: bool
    axis_a: int
    axis_b: int
    sign: float


def _row(closure: Closure, axis: str) -> _Row:
    rotation, k = divmod(AXES.index(axis), 3)
    if not rotation:
        return _Row(False, k, k, 1.0)
    i, j = (k + 1) % 3, (k + 2) % 3
    free = [c for c in range(3) if AXES[3 + c] not in closure.axes]
    if len(free) == 1:
        # a hinge: compare the free axis of B with the two axes of A that must stay normal to it
        other = i if free[0] == j else j
        return _Row(True, other, free[0], 1.0 if other == j else -1.0)
    return _Row(True, j, i, 1.0)


def _aligned_axes(closure: Closure) -> list[int]:
    """Return the axes of A and B that coincide when closed: the free one of a hinge, all three of a weld."""
    free = [k for k in range(3) if AXES[3 + k] not in closure.axes]
    return {0: [0, 1, 2], 1: free}.get(len(free), [])


def _dot(a: Array, b: Array) -> Array:
    product: Array = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def _translation_bias(a: Array, delta: Array, frame_a: FrameAcceleration, frame_b: FrameAcceleration) -> Array:
    omega = frame_a.angular_velocity
    turned = cross(omega, a)
    second = cross(frame_a.angular_bias, a) + cross(omega, turned)
    return (
        _dot(second, delta)
        + 2.0 * _dot(turned, frame_b.velocity - frame_a.velocity)
        + _dot(a, frame_b.bias - frame_a.bias)
    )


def _rotation_bias(a: Array, b: Array, frame_a: FrameAcceleration, frame_b: FrameAcceleration) -> Array:
    relative = frame_b.angular_velocity - frame_a.angular_velocity
    normal_rate = cross(cross(frame_b.angular_velocity, b), a) + cross(b, cross(frame_a.angular_velocity, a))
    return _dot(frame_b.angular_bias - frame_a.angular_bias, cross(b, a)) + _dot(relative, normal_rate)
