"""Closure rows and platform rows at a single state, for simulation and control loops."""

from __future__ import annotations

import math

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.closure import PlacedRows, constraint_system
from redundancy_pin.kinematics.coordinates import readings
from redundancy_pin.kinematics.tree import TreePlacement, frame_placement
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint, find_link_index
from redundancy_pin.robot.named import is_pose


class ClosedChain(TreePlacement):
    """Closure rows and platform rows of a robot at one state.

    An evaluator with a workspace: ``update`` sets the state, the other methods answer for it. ``place`` alone is for
    those who place rows of their own.

    Args:
        robot: the robot.

    Attributes:
        system: the rows.
        rows: number r of closure rows.
        pose_columns: velocity indices that move the pose.
        closures: the closure rows, placed at the last state.
    """

    closures: PlacedRows

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot.model)
        self.robot = robot
        self.system = system = constraint_system(robot)
        self.pose_columns, self.rows = system.pose_columns, len(system.rows)
        self._scale = system.step_unit / system.closure_unit[:, None]
        self._platform_pose: tuple[Array, Array] | None = None  # views
        if robot.platform is not None:
            self._platform_pose = frame_placement(self.vectors, find_link_index(self.model, robot.platform.frame))
        self._is_pose = is_pose(robot)
        self._readings = readings(robot)
        joints = (find_joint(self.model, name) for name in robot.independent_joints)
        self._joints = [(int(joint.idx_q), joint.nq == 2) for joint in joints]

    def __reduce__(self) -> tuple[type[ClosedChain], tuple[Robot]]:
        """Make another one where this is copied or sent to: views into Pinocchio's memory would not be views there."""
        return ClosedChain, (self.robot,)

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        self.place_moving(q, v)
        self.q, self.v = q, v
        self.closures = self.system.closures.place(self.vectors, q)
        self._platform: PlacedRows | None = None  # closures alone are what most calls need

    def residual(self) -> Array:
        """Return (r,) the closure residuals Φ, m; for rotation rows the sine of the angle that is off."""
        return self.closures.residual()

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        return self.closures.jacobian(self.J)

    def relative_jacobian(self) -> Array:
        """Return (r, p) J_c without units, of the pose columns: what ranks are judged by."""
        relative: Array = self.jacobian().take(self.pose_columns, 1) * self._scale
        return relative

    def relative_residual(self) -> Array:
        """Return (r,) the closure residuals without units: angles, and lengths over the characteristic length."""
        relative: Array = self.residual() / self.system.closure_unit
        return relative

    def largest_residual(self) -> float:
        """Return the largest closure residual, m; angles count times the characteristic length."""
        return self.robot.characteristic_length * float(np.abs(self.relative_residual()).max(initial=0.0))

    def bias(self) -> Array:
        """Return J̇_c v (r,)."""
        return self.system.closures.bias_at(self.closures, self.J, self.dJ, self.v)

    def jacobian_rate(self) -> Array:
        """Return J̇_c (r, nv)."""
        return self.closures.jacobian_rate(self.J, self.dJ, self.v)

    def platform_position(self) -> Array:
        """Return the independent coordinates: (n,), or a pose (4, 4); see ``Platform``."""
        return self.coordinates(self.q)

    def coordinates(self, q: Array) -> Array:
        """Return the independent coordinates at the configuration (nq,) that was placed last."""
        if self._platform_pose is None:
            return np.array([math.atan2(q[i + 1], q[i]) if circle else q[i] for i, circle in self._joints])
        rotation, origin = self._platform_pose
        if self._is_pose:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, origin
            return pose
        values = []
        for sine, cosine in self._readings:
            if cosine is None:
                values.append(origin[sine[0]])
            elif cosine == sine:
                values.append(math.atan2(-rotation[sine], math.hypot(rotation[0, 0], rotation[1, 0])))
            else:
                values.append(math.atan2(rotation[sine], rotation[cosine]))
        return np.array(values)

    def platform_rows(self) -> PlacedRows:
        """Return the rows of the platform's twist, at the state."""
        if self._platform is None:
            self._platform = self.system.platform.place(self.vectors, self.q)
        return self._platform

    def platform_jacobian(self) -> Array:
        """Return J_x (n, nv): rows of the platform twist, world-aligned at its origin, or unit rows of joints."""
        if self._platform_pose is None:
            return self.system.independent
        return self.platform_rows().jacobian(self.J)

    def platform_jacobian_rate(self) -> Array:
        """Return J̇_x (n, nv)."""
        if self._platform_pose is None:
            return np.zeros_like(self.system.independent)
        return self.platform_rows().jacobian_rate(self.J, self.dJ, self.v)
