"""Closure rows and platform rows at a single state, for simulation and control loops."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import FILE_TOLERANCE, Array
from redundancy_pin.kinematics.closure import RESTORED, PlacedRows, constraint_system, row_basis
from redundancy_pin.kinematics.tree import TreePlacement, frame_placement
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_link_index

_RANK_KEPT = 1e3
"""Ratio of the smallest singular values of all rows and of those in use, no unit, at a rank loss of the latter alone.
Where all rows lose rank the two are alike; a place where those in use alone lose it is known to 1e-6 and better."""


class ClosedChain(TreePlacement):
    """Closure rows and platform rows of a robot at one state.

    An evaluator with a workspace: ``place`` sets the configuration, ``update`` the state, the other methods answer for
    it. ``coordinates.coordinates`` reads the independent coordinates off it.

    Args:
        robot: the robot.
        basis: combine all closure rows by it, see ``use_basis``.

    Attributes:
        system: the rows.
        rows: number r of closure rows.
        pose_columns: velocity indices that move the pose.
        basis: (R, r) U, orthonormal: the closure rows in use are Uᵀ times all R rows without units. None: they are the
            independent ones of the robot.
        equation_unit: (r + n,) units of the rows in use, see ``ConstraintSystem``; 1 for combined closure rows.

    Example:
        >>> chain = ClosedChain(robot)
        >>> chain.place(np.array(robot.q_reference))
        >>> K, residual = chain.matrix(), chain.relative_residual()
    """

    def __init__(self, robot: Robot, basis: Array | None = None) -> None:
        super().__init__(robot.model)
        self.robot = robot
        self.system = system = constraint_system(robot)
        self.pose_columns, self.rows = system.pose_columns, len(system.rows)
        # without a platform, unit rows of joints stand in the place of those of its twist
        self._unit_rows = system.independent if robot.platform is None else None
        self._placements: dict[str, tuple[Array, Array]] = {}  # views
        self._placed: PlacedRows | None = None
        self._jacobian: Array | None = None
        self._combine_by(basis)

    def __reduce__(self) -> tuple[type[ClosedChain], tuple[Robot, Array | None]]:
        """Make another one where this is copied or sent to: views into Pinocchio's memory would not be views there."""
        return ClosedChain, (self.robot, self.basis)

    def use_basis(self, basis: Array | None) -> None:
        """Combine all closure rows by a basis (R, r) of ``row_basis``; None: use the independent rows again."""
        if basis is not self.basis:
            self._combine_by(basis)

    def _combine_by(self, basis: Array | None) -> None:
        system = self.system
        self.basis, self._used = basis, system if basis is None else system.every
        self.equation_unit, self._factor = system.equation_unit, system.relative_factor
        if basis is not None:
            self.equation_unit = np.concatenate([np.ones(self.rows), system.equation_unit[self.rows :]])
            self._factor = system.step_unit / self.equation_unit[:, None]
        self.closure_unit = self.equation_unit[: self.rows]
        self._placed = self._jacobian = None

    def dependent_rows_restore_rank(self) -> bool:
        """Return whether all closure rows keep the rank that the rows in use lose at the configuration.

        Which rows are independent changes along the motion of some mechanisms (Bennett's four hinges). The branch goes
        smoothly through such a configuration; it is not singular. Rows that contradict each other by the rounding of a
        file restore nothing.
        """
        return self._restoring_basis(_RANK_KEPT) is not None

    def renew_basis(self) -> bool:
        """Use the best basis where the rows in use come near a rank loss of theirs; return whether they do.

        It is oriented like the rows in use: between neighbouring poses det K then changes its sign where all closure
        rows together lose rank, and only there.
        """
        basis = self._restoring_basis(RESTORED)
        if basis is None:
            return False
        before = self.closure_rows()
        self.use_basis(basis)
        if np.linalg.det(before @ self.closure_rows().T) < 0.0:
            self.use_basis(basis * np.where(np.arange(self.rows) == 0, -1.0, 1.0))
        return True

    def _restoring_basis(self, ratio: float) -> Array | None:
        """Return U (R, r) of all closure rows at the configuration, ``row_basis``; None if the rank stays.

        ``ratio``: least ratio of the smallest singular values of all rows and of those in use, no unit.
        """
        if not (self.rows and self.system.has_dependent_rows):  # without independent rows none are lost
            return None
        own = float(np.linalg.svd(self.closure_rows(), compute_uv=False)[-1])
        basis, least = row_basis(self.every_row()[0], self.rows)
        return basis if least > max(ratio * own, FILE_TOLERANCE) else None

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        self.place_moving(q, v)
        self.v = v

    def _update_frames(self) -> None:
        super()._update_frames()
        self._placed = self._jacobian = None

    # --- closure rows over the rows of the independent velocities ----------------------------------------------------

    @property
    def placed(self) -> PlacedRows:
        """The closure rows, then the rows of the platform's twist, at the configuration."""
        if self._placed is None:
            self._placed = self._used.all_rows.place(self.vectors, self.q)
        return self._placed

    def _combined(self, rows: Array) -> Array:
        """Return the rows in use (r + n, nv), above the rows of the independent velocities, from all placed rows."""
        if self.basis is not None:
            unit = self._used.closure_unit[:, None]
            rows = np.concatenate([self.basis.T.dot(rows[: len(unit)] / unit), rows[len(unit) :]])
        return rows

    def full_jacobian(self) -> Array:
        """Return (r + n, nv) J_c over J_x."""
        if self._jacobian is None:
            rows = self._combined(self.placed.jacobian(self.J))
            self._jacobian = rows if self._unit_rows is None else np.concatenate([rows, self._unit_rows])
        return self._jacobian

    def full_bias(self) -> Array:
        """Return (r + n,) J̇_c v over J̇_x v."""
        bias: Array = self.full_rate().dot(self.v)
        return bias

    def full_rate(self) -> Array:
        """Return (r + n, nv) J̇_c over J̇_x."""
        rate = self._combined(self.placed.jacobian_rate(self.J, self.dJ, self.v))
        return rate if self._unit_rows is None else np.concatenate([rate, np.zeros_like(self._unit_rows)])

    def matrix(self) -> Array:
        """Return K (r + n, p): both Jacobians without units and without the carrier columns."""
        K: Array = self.full_jacobian().take(self.pose_columns, 1)
        K *= self._factor
        return K

    def matrix_rate(self) -> Array:
        """Return (r + n, p) the rate of K, without units."""
        rate: Array = self.full_rate().take(self.pose_columns, 1) * self._factor
        return rate

    # --- closures ----------------------------------------------------------------------------------------------------

    def relative_residual(self) -> Array:
        """Return (r,) the closure residuals without units: angles, and lengths over the characteristic length."""
        unit = self._used.closure_unit
        relative: Array = self.placed.residual()[: len(unit)] / unit
        return relative if self.basis is None else relative.dot(self.basis)

    def largest_residual(self) -> float:
        """Return the largest closure residual, m; angles count times the characteristic length."""
        return self.robot.characteristic_length * float(np.abs(self.relative_residual()).max(initial=0.0))

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        return self.full_jacobian()[: self.rows]

    def closure_rows(self) -> Array:
        """Return J_c (r, p) without units and without the carrier columns."""
        return self.matrix()[: self.rows]

    def every_row(self) -> tuple[Array, Array]:
        """Return the Jacobian (R, p) and residuals (R,) of all closure rows, without units, whatever the basis."""
        every = self.system.every
        placed, count = every.all_rows.place(self.vectors, self.q), len(every.rows)
        rows = every.relative(placed.jacobian(self.J)[:count, self.pose_columns])
        return rows, placed.residual()[:count] / every.closure_unit

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
