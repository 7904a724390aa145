"""Closures and platform rows at one state, fast: what a simulation evaluates tens of thousands of times.

The rows are those of ``kinematics.closure``. That module's batched evaluator walks the tree in numpy; at one
configuration Pinocchio's joint Jacobian and its rate are there already, which is an order of magnitude faster.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.closure import PlacedRows, constraint_system
from redundancy_pin.kinematics.coordinates import joint_position, platform_coordinates
from redundancy_pin.robot import Robot


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
        closures: the closure rows, placed at the last state.
        J, dJ: (6, nv) joint Jacobian about the world origin and its rate, at the last state.
    """

    closures: PlacedRows

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = model = robot.model
        self.data = data = model.createData()
        self.system = system = constraint_system(robot)
        self.pose_columns, self.rows = system.pose_columns, len(system.rows)
        names = list(system.tree.support)
        pin.framesForwardKinematics(model, data, np.array(robot.q_reference))
        axes = np.zeros((3, len(names) + 1, 4))
        axes[:, -1, :3] = np.eye(3)
        self._vectors = axes.reshape(3, -1)
        # views into Pinocchio's memory and into ours, taken once: looking them up costs as much as the arithmetic
        placements = [data.oMf[model.getFrameId(name, pin.FrameType.BODY)] for name in names]
        self._frames = [(axes[:, i, :3], axes[:, i, 3], M.rotation, M.translation) for i, M in enumerate(placements)]
        self._of_platform = names.index(robot.platform.frame) if robot.platform is not None else -1
        self.J, self.dJ = data.J, data.dJ

    def __reduce__(self) -> tuple[type[ClosedChain], tuple[Robot]]:
        """Make another one where this is copied or sent to: views into Pinocchio's memory would not be views there."""
        return ClosedChain, (self.robot,)

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        pin.computeJointJacobiansTimeVariation(self.model, self.data, q, v)
        pin.updateFramePlacements(self.model, self.data)
        for axes, origin, rotation, translation in self._frames:
            axes[:] = rotation
            origin[:] = translation
        self.q, self.v = q, v
        self.closures = self.system.closures.place(self._vectors)
        self._platform: PlacedRows | None = None  # closures alone are what most calls need

    def residual(self) -> Array:
        """Return (r,) the closure residuals Φ, m; for rotation rows the sine of the angle that is off."""
        return self.system.closures.residual(self.closures)

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        return self.system.closures.times(self.closures.wrench, self.J)

    def bias(self) -> Array:
        """Return J̇_c v (r,)."""
        rows, J, v = self.system.closures, self.J, self.v
        between = (rows.mask * v).T
        return self.closures.bias(rows.twists(J, v), J.dot(between), self.dJ.dot(between))

    def jacobian_rate(self) -> Array:
        """Return J̇_c (r, nv)."""
        return self.closures.jacobian_rate(self.J, self.dJ, self.v)

    def platform_position(self) -> Array:
        """Return the independent coordinates: (n,), or a pose (4, 4). A single rotation lies in (−π, π]."""
        robot = self.robot
        if robot.platform is None:
            return np.array([joint_position(robot, name, self.q[None])[0] for name in robot.independent_joints])
        rotation, origin, _, _ = self._frames[self._of_platform]
        position: Array = platform_coordinates(robot, rotation[:, :, None], origin[:, None])[0]
        return position

    def platform_rows(self) -> PlacedRows:
        """Return the rows of the platform's twist, at the state."""
        if self._platform is None:
            self._platform = self.system.platform.place(self._vectors)
        return self._platform

    def platform_jacobian(self) -> Array:
        """Return J_x (n, nv): rows of the platform twist, world-aligned at its origin, or unit rows of joints."""
        if self._of_platform < 0:
            return self.system.independent
        return self.system.platform.times(self.platform_rows().wrench, self.J)

    def platform_jacobian_rate(self) -> Array:
        """Return J̇_x (n, nv)."""
        if self._of_platform < 0:
            return np.zeros_like(self.system.independent)
        return self.platform_rows().jacobian_rate(self.J, self.dJ, self.v)
