"""Closure rows and platform rows at a single state, for simulation and control loops."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.closure import PlacedRows, constraint_system
from redundancy_pin.kinematics.tree import TreePlacement, frame_placement
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_link_index


class ClosedChain(TreePlacement):
    """Closure rows and platform rows of a robot at one state.

    An evaluator with a workspace: ``update`` sets the state, the other methods answer for it. ``place`` alone is for
    those who place rows of their own. ``coordinates.coordinates`` reads the independent coordinates off it.

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
        self._placements: dict[str, tuple[Array, Array]] = {}  # views

    def __reduce__(self) -> tuple[type[ClosedChain], tuple[Robot]]:
        """Make another one where this is copied or sent to: views into Pinocchio's memory would not be views there."""
        return ClosedChain, (self.robot,)

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        self.place_moving(q, v)
        self.v = v
        self.closures = self.system.closures.place(self.vectors, q)
        self._platform: PlacedRows | None = None  # closures alone are what most calls need

    def residual(self) -> Array:
        """Return (r,) the closure residuals Φ, m; for rotation rows the sine of the angle that is off."""
        return self.closures.residual()

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        return self.closures.jacobian(self.J)

    def closure_rows(self) -> Array:
        """Return J_c (r, p) without units and without the carrier columns."""
        return self.system.relative(self.jacobian().take(self.pose_columns, 1))

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

    def placement(self, frame: str) -> tuple[Array, Array]:
        """Return rotation (3, 3) and origin (3,), m, of a link by its name: views, which change with the state."""
        known = self._placements.get(frame)
        if known is None:
            known = self._placements[frame] = frame_placement(self.vectors, find_link_index(self.model, frame))
        return known

    def platform_rows(self) -> PlacedRows:
        """Return the rows of the platform's twist, at the state."""
        if self._platform is None:
            self._platform = self.system.platform.place(self.vectors, self.q)
        return self._platform

    def platform_jacobian(self) -> Array:
        """Return J_x (n, nv): rows of the platform twist, world-aligned at its origin, or unit rows of joints."""
        if self.robot.platform is None:
            return self.system.independent
        return self.platform_rows().jacobian(self.J)

    def matrix(self) -> Array:
        """Return K (r + n, p) without units: J_c over J_x, without the carrier columns."""
        return self._relative(self.jacobian(), self.platform_jacobian())

    def matrix_rate(self) -> Array:
        """Return the rate of K (r + n, p), without units."""
        return self._relative(self.jacobian_rate(), self.platform_jacobian_rate())

    def _relative(self, *rows: Array) -> Array:
        return self.system.relative(np.concatenate(rows).take(self.pose_columns, 1))

    def platform_jacobian_rate(self) -> Array:
        """Return J̇_x (n, nv)."""
        if self.robot.platform is None:
            return np.zeros_like(self.system.independent)
        return self.platform_rows().jacobian_rate(self.J, self.dJ, self.v)
