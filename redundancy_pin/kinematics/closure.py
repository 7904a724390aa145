"""Loop closures and platform rows at position, velocity and acceleration level, for many samples at once.

A closure row pairs an axis a of frame A with a partner c carried by frame B: the origin p_B of frame B (a translation
along a, σ = 1), or an axis b of frame B that is normal to a when closed (a rotation, σ = 0):

    Φ = a · (c − σ p_A).

It acts as a wrench w on frame B, and as −w on frame A, about the world origin. With V_A, V_B the spatial velocities of
the two bodies and A_A, A_B their accelerations at v̇ = 0 (see ``kinematics.tree``)

    w = (σ a, c × a),          Φ̇ = w · (V_B − V_A),           J_c = ± w · J on the joints that move only one of them,
    ẇ = (σ ȧ, ċ × a + c × ȧ),  J̇_c v = ẇ · (V_B − V_A) + w · (A_B − A_A),   ȧ = ω_A × a,  ċ = ω_B × c + σ v_B.

Which axes a rotation row pairs depends on what else is constrained: with one rotation left free (a hinge) both rows
use the free axis of B, so that they stay independent at every hinge angle. Every row is exact at every configuration,
closed or not, and no row is redundant where the mask has none too many. Two or three rotation rows have false zeros too
(a hinge turned over), which ``ConstraintSystem.misalignment`` tells apart; a single one fixes its angle up to half a
turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.kinematics.tree import TreeKinematics, TreePose, cross
from redundancy_pin.robot import AXES, Closure, Robot


@dataclass(frozen=True, eq=False)
class ConstraintState:
    """Closures and platform at N configurations; made by ``ConstraintSystem.evaluate``.

    Attributes:
        q: (N, nq) configurations.
        pose: the tree's placements.
        axis, partner: (3, r, N) the pair a, c of each row, world axes.
        phi: (N, r) closure residuals Φ, m (rotation rows: sine of the angle that is off).
        J: (r + n, nv, N) constraint Jacobian dΦ/dv over that of the independent velocities.
        columns: (p,) the velocities without the carriers'.
    """

    q: Array
    pose: TreePose
    axis: Array
    partner: Array
    phi: Array
    J: Array
    columns: IntArray

    @property
    def Jc(self) -> Array:
        """(N, r, nv) constraint Jacobian dΦ/dv."""
        return self.J[: self.phi.shape[1]].transpose(2, 0, 1)

    @property
    def Jx(self) -> Array:
        """(N, n, nv) Jacobian of the independent velocities (world-aligned platform twist, or named joints)."""
        return self.J[self.phi.shape[1] :].transpose(2, 0, 1)

    @cached_property
    def K(self) -> Array:
        """(N, r + n, p) all rows without the carrier columns."""
        # sample by sample in memory, as LAPACK wants them
        return np.ascontiguousarray(self.J[:, self.columns].transpose(2, 0, 1))


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
        self.pose_columns = np.setdiff1d(np.arange(robot.model.nv), robot.carrier_velocity)
        """Velocity indices that move the pose: all but the carriers."""
        self.selection = np.zeros((robot.m, robot.model.nv))
        """S, (m, nv): the main actuators among the velocities."""
        self.selection[np.arange(robot.m), robot.actuated_velocity] = 1.0
        rotation = np.array([row.rotation for _, row in self.rows], dtype=bool)
        self.closure_scale = np.where(rotation, robot.characteristic_length, 1.0)
        """(r,) length that turns each closure row into m."""
        self._slides = np.where(rotation, 0.0, 1.0)[:, None]
        self._moving = self._moving_columns()

    def _moving_columns(self) -> list[tuple[slice, dict[int, float]]]:
        """Return for each closure its rows, and of the velocities that move one of its bodies +1 for B, −1 for A."""
        moving, first = [], 0
        for closure in self.robot.closures:
            of_a, of_b = (set(self.tree.support[frame]) for frame in (closure.frame_a, closure.frame_b))
            signs = {column: 1.0 if column in of_b else -1.0 for column in sorted(of_a ^ of_b)}
            moving.append((slice(first, first + len(closure.axes)), signs))
            first += len(closure.axes)
        return moving

    def evaluate(self, q: Array) -> ConstraintState:
        """Evaluate residuals and Jacobians at (N, nq) configurations, closed or not."""
        pose = self.tree.pose(q)
        shape = (3, len(self.rows), pose.samples)
        axis, partner, offset = np.empty(shape), np.empty(shape), np.empty(shape)
        for i, (closure, row) in enumerate(self.rows):
            axis[:, i] = pose.frame_rotation[closure.frame_a][:, row.axis_a]
            if row.rotation:
                partner[:, i] = pose.frame_rotation[closure.frame_b][:, row.axis_b] * row.sign
                offset[:, i] = partner[:, i]
            else:
                partner[:, i] = pose.frame_origin[closure.frame_b]
                offset[:, i] = partner[:, i] - pose.frame_origin[closure.frame_a]
        phi = _dot(axis, offset)
        wrench = np.concatenate([axis * self._slides, cross(partner, axis)])
        jacobian = np.zeros((len(self.rows) + self.robot.n, self.robot.model.nv, pose.samples))
        for rows, moving in self._moving:
            for column, sign in moving.items():  # one einsum over all columns takes ten times as long on many samples
                np.einsum("krn,kn->rn", wrench[:, rows], pose.jacobian[:, column], out=jacobian[rows, column])
                jacobian[rows, column] *= sign
        self._fill_platform_rows(jacobian[len(self.rows) :], pose)
        return ConstraintState(q, pose, axis, partner, phi.T, jacobian, self.pose_columns)

    def _fill_platform_rows(self, jacobian: Array, pose: TreePose) -> None:
        robot = self.robot
        if robot.platform is None:
            jacobian[np.arange(robot.n), independent_velocity(robot)] = 1.0
            return
        origin = pose.frame_origin[robot.platform.frame]
        for column in self.tree.support[robot.platform.frame]:
            linear, angular = pose.jacobian[:3, column], pose.jacobian[3:, column]
            for row, axis in enumerate(robot.platform.axes):
                rotation, k = divmod(AXES.index(axis), 3)
                i, j = (k + 1) % 3, (k + 2) % 3  # the velocity at the platform's origin p is v + ω × p
                at_origin = angular[k] if rotation else linear[k] + angular[i] * origin[j] - angular[j] * origin[i]
                jacobian[row, column] = at_origin

    def bias(self, state: ConstraintState, v: Array) -> tuple[Array, Array]:
        """Return J̇_c v (N, r) and J̇_x v (N, n) at velocities v (N, nv)."""
        motions = self.tree.motions(state.pose, v)
        of_rows = np.empty((len(self.rows), state.pose.samples))
        for closure, (rows, _) in zip(self.robot.closures, self._moving, strict=True):
            (velocity_a, rest_a), (velocity_b, rest_b) = (motions[f] for f in (closure.frame_a, closure.frame_b))
            a, c, slides = state.axis[:, rows], state.partner[:, rows], self._slides[rows]
            a_rate = cross(velocity_a[3:, None], a)
            c_rate = cross(velocity_b[3:, None], c) + slides * velocity_b[:3, None]
            velocity, rest = (velocity_b - velocity_a)[:, None], (rest_b - rest_a)[:, None]
            of_rows[rows] = (
                slides * (_dot(a_rate, velocity[:3]) + _dot(a, rest[:3]))
                + _dot(cross(c_rate, a) + cross(c, a_rate), velocity[3:])
                + _dot(cross(c, a), rest[3:])
            )
        of_platform = np.zeros((self.robot.n, state.pose.samples))
        if (platform := self.robot.platform) is not None:
            (velocity, rest), origin = motions[platform.frame], state.pose.frame_origin[platform.frame]
            # the acceleration of the platform's origin: that of a point, not the spatial one
            point = velocity[:3] + cross(velocity[3:], origin)
            linear = rest[:3] + cross(rest[3:], origin) + cross(velocity[3:], point)
            of_platform = np.concatenate([linear, rest[3:]])[[AXES.index(axis) for axis in platform.axes]]
        return of_rows.T, of_platform.T

    def misalignment(self, state: ConstraintState) -> Array:
        """Return (N,) the largest angle, rad, between two axes of a closure that must point the same way.

        The rotation rows of a hinge vanish for opposite axes too, those of a weld also for axes that changed places:
        where all rows vanish this is 0 for a true closure and at least π/2 for a false one. Closures with less than
        two rotation rows have no such axes.
        """
        angle = np.zeros(state.pose.samples)
        for closure in self.robot.closures:
            free = [k for k in range(3) if AXES[3 + k] not in closure.axes]
            # they coincide when closed: the free axis of a hinge, all three of a weld
            for k in {0: [0, 1, 2], 1: free}.get(len(free), []):
                cosine = _dot(*(state.pose.frame_rotation[frame][:, k] for frame in (closure.frame_a, closure.frame_b)))
                angle = np.maximum(angle, np.arccos(np.clip(cosine, -1.0, 1.0)))
        return angle


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


def _dot(a: Array, b: Array) -> Array:
    product: Array = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@lru_cache(maxsize=32)
def constraint_system(robot: Robot) -> ConstraintSystem:
    """Return the constraint system of a robot, built once: a single sample takes a third of its time again."""
    return ConstraintSystem(robot)
