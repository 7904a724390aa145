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

    An evaluator with a workspace: ``place`` sets the configuration, ``update`` the state, the other methods answer for
    it. ``coordinates.coordinates`` reads the independent coordinates off it.

    Args:
        robot: the robot.

    Attributes:
        system: the rows.
        rows: number r of closure rows.
        pose_columns: velocity indices that move the pose.

    Example:
        >>> chain = ClosedChain(robot)
        >>> chain.place(np.array(robot.q_reference))
        >>> K, residual = chain.matrix(), chain.relative_residual()
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot.model)
        self.robot = robot
        self.system = system = constraint_system(robot)
        self.pose_columns, self.rows = system.pose_columns, len(system.rows)
        self._closure_unit = system.closure_unit
        # without a platform, unit rows of joints stand in the place of those of its twist
        self._unit_rows = system.independent if robot.platform is None else None
        self._placements: dict[str, tuple[Array, Array]] = {}  # views

    def __reduce__(self) -> tuple[type[ClosedChain], tuple[Robot]]:
        """Make another one where this is copied or sent to: views into Pinocchio's memory would not be views there."""
        return ClosedChain, (self.robot,)

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        self.place_moving(q, v)
        self.v = v

    def _update_frames(self) -> None:
        super()._update_frames()
        self._placed: PlacedRows | None = None
        self._jacobian: Array | None = None

    # --- closure rows over the rows of the independent velocities ----------------------------------------------------

    @property
    def placed(self) -> PlacedRows:
        """The closure rows, and behind them those of the platform's twist, at the configuration."""
        if self._placed is None:
            self._placed = self.system.all_rows.place(self.vectors, self.q)
        return self._placed

    def full_jacobian(self) -> Array:
        """Return (r + n, nv) J_c over J_x."""
        if self._jacobian is None:
            rows = self.placed.jacobian(self.J)
            self._jacobian = rows if self._unit_rows is None else np.concatenate([rows, self._unit_rows])
        return self._jacobian

    def full_bias(self) -> Array:
        """Return (r + n,) J̇_c v over J̇_x v."""
        bias: Array = self.full_rate().dot(self.v)
        return bias

    def full_rate(self) -> Array:
        """Return (r + n, nv) J̇_c over J̇_x."""
        rate = self.placed.jacobian_rate(self.J, self.dJ, self.v)
        return rate if self._unit_rows is None else np.concatenate([rate, np.zeros_like(self._unit_rows)])

    def matrix(self) -> Array:
        """Return K (r + n, p): both Jacobians without units and without the carrier columns."""
        K: Array = self.full_jacobian().take(self.pose_columns, 1)
        K *= self.system.relative_factor
        return K

    def matrix_rate(self) -> Array:
        """Return (r + n, p) the rate of K, without units."""
        return self.system.relative(self.full_rate().take(self.pose_columns, 1))

    # --- closures ----------------------------------------------------------------------------------------------------

    def residual(self) -> Array:
        """Return (r,) the closure residuals Φ, m; for rotation rows the sine of the angle that is off."""
        return self.placed.residual()[: self.rows]

    def relative_residual(self) -> Array:
        """Return (r,) the closure residuals without units: angles, and lengths over the characteristic length."""
        relative: Array = self.placed.residual()[: self.rows] / self._closure_unit
        return relative

    def largest_residual(self) -> float:
        """Return the largest closure residual, m; angles count times the characteristic length."""
        return self.robot.characteristic_length * float(np.abs(self.relative_residual()).max(initial=0.0))

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        return self.full_jacobian()[: self.rows]

    def closure_rows(self) -> Array:
        """Return J_c (r, p) without units and without the carrier columns."""
        return self.system.relative(self.jacobian().take(self.pose_columns, 1))

    def bias(self) -> Array:
        """Return J̇_c v (r,)."""
        return self.full_bias()[: self.rows]

    # --- platform ----------------------------------------------------------------------------------------------------

    def platform_jacobian(self) -> Array:
        """Return J_x (n, nv): rows of the platform twist, world-aligned at its origin, or unit rows of joints."""
        return self.full_jacobian()[self.rows :]

    def placement(self, frame: str) -> tuple[Array, Array]:
        """Return rotation (3, 3) and origin (3,), m, of a link by its name: views, which change with the state."""
        known = self._placements.get(frame)
        if known is None:
            known = self._placements[frame] = frame_placement(self.vectors, find_link_index(self.model, frame))
        return known
