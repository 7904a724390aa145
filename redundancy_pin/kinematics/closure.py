"""Loop closures and platform rows at position, velocity and acceleration level, at one state or at many.

A closure row pairs an axis a of frame A with a partner c carried by frame B: the origin p_B of frame B (a translation
along a, σ = 1), or an axis b of frame B that is normal to a when closed (a rotation, σ = 0):

    Φ = a · (c − σ p_A).

It acts as a wrench w on frame B, and as −w on frame A, about the world origin. With V_A, V_B the spatial velocities of
the two bodies and A_A, A_B their accelerations at v̇ = 0, J the joint Jacobian (see ``kinematics.tree``), and a mask of
+1 where a joint moves B only, −1 where it moves A only,

    w = (σ a, c × a),          Φ̇ = w · (V_B − V_A),           J_c = mask ∘ (w · J),
    ẇ = (σ ȧ, ċ × a + c × ȧ),  J̇_c v = ẇ · (V_B − V_A) + w · (A_B − A_A),   ȧ = ω_A × a,  ċ = ω_B × c + σ v_B,
    ẅ = (σ ä, c̈ × a + 2 ċ × ȧ + c × ä),   J̇_c = mask ∘ (ẇ J + w J̇),   J̈_c = mask ∘ (ẅ J + 2 ẇ J̇ + w J̈).

A rod of constant length L between the origins of both frames is a translation along an axis that no frame carries:

    d = p_B − p_A,   a = d / L,   Φ = (d · a − L) / 2,   ȧ = ω_A × a + (Δω × p_B + Δv) / L,   Δ = V_B − V_A.

Φ̇ = d · ḋ / L = w · Δ with the w above, and so is all that follows from it.

Rows of a platform's twist are such rows too. Their axis is one of the world; the partner of a translation is the
platform's origin, that of a rotation about a third axis of the world. The row of an angle whose rate is no component of
the twist has an axis of the platform, and w = (0, g) in place of c × a, with the rates of g (``kinematics.angles``).

Which axes a rotation row pairs depends on what else is constrained: with one rotation left free (a hinge) both rows
use the free axis of B, so that they stay independent at every hinge angle. Every row is exact at every configuration,
closed or not, and no row is redundant where the mask has none too many. Two or three rotation rows have false zeros too
(a hinge turned over), which ``ConstraintSystem.misalignment`` distinguishes; a single one fixes its angle up to half a
turn.

Couplings of joints are rows too (``kinematics.coupling``), behind those of the closures: among the rows between frames
an empty one, which nothing moves, stands in the place of each.

Redundant rows. The ball of a planar loop has one row more than the loop needs. Of all R rows, r are independent at the
reference and all around it (``kinematics.selection``): a ``ConstraintSystem`` has these, and ``every`` is the system of
all. Where the r lose rank and all rows keep it, r combinations of all take their place, by ``row_basis``.

Vectors of rows are component-major: (3, R) at one configuration, (3, R, N) at N of them.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import FILE_TOLERANCE, RANK_TOLERANCE, Array, IntArray, blocks
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics import angles
from redundancy_pin.kinematics.coupling import CouplingRows
from redundancy_pin.kinematics.tree import TreePlacement, frame_placement, is_covered
from redundancy_pin.robot import AXES, Closure, Robot
from redundancy_pin.robot.lookup import find_joint, find_link_index
from redundancy_pin.robot.scales import coordinate_unit, velocity_unit

_WHOLE_TURN = 100.0
"""Residual of dependent rows along a whole turn over that within 0.1 rad of the reference. It is 20 for an axis that is
drawn where it belongs at the reference, sin(π / 2) / sin(0.1 / 2), and more where its joint moves less than others
there: up to 33 in the shipped planar machines, rounded."""

_NARROWEST, _WIDEST = 1e-4, 20.0 * FILE_TOLERANCE
"""Residual of dependent rows, rad or characteristic lengths: what a branch that is not the machine's exceeds tenfold
where placements are exact, and what no machine of rounded numbers comes to (``FILE_TOLERANCE`` times the 20 above)."""

RESTORED = 3.0
"""Ratio of the smallest singular values of all closure rows and of those in use, no unit, beyond which combinations of
all take the place of those in use near a loss of rank."""

_ORIGIN = 3
"""Column of a frame's origin, behind its three axes."""


_BLOCK = 128
"""Configurations evaluated at once: their rows stay in the cache."""

_NEXT, _AFTER = np.array([1, 2, 0, 2, 0, 1]), np.array([2, 0, 1, 1, 2, 0])
"""Components of both factors of the six products of a cross product."""


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of (3, ...) vectors; numpy's own takes ten times as long on a few."""
    products = a.take(_NEXT, 0) * b.take(_AFTER, 0)
    difference: Array = products[:3] - products[3:]
    return difference


class Row(NamedTuple):
    """One row: its axis and partner as (frame, column), and the frames between which it acts.

    ``angle`` is the kind and the base axis of one that is the rate of an angle. ``length``: of a rod, m, whose
    axis is the line between both origins in place of the one that is named.
    """

    axis: tuple[int, int]
    partner: tuple[int, int]
    first: int
    second: int
    sign: float
    angle: tuple[str, int] | None = None
    length: float = 0.0

    @property
    def rotation(self) -> bool:
        """Whether the row is one of rotation."""
        return self.partner[1] != _ORIGIN


class RowSet:
    """R rows between frames of a tree.

    Args:
        rows: the rows.
        support: (F, nv) 1 where a velocity moves a frame.
        ids: (F,) Pinocchio's index of each frame.
        couplings: that take the place of the empty rows among them.
    """

    def __init__(
        self, rows: Sequence[Row], support: Array, ids: IntArray, couplings: CouplingRows | None = None
    ) -> None:
        self.size = size = len(rows)
        self.couplings = couplings
        self._at_angles = [i for i, row in enumerate(rows) if row.angle]
        self._kinds = [row.angle for row in rows if row.angle]
        self.rods = [i for i, row in enumerate(rows) if row.length]
        """Which rows are rods."""
        self.lengths = np.array([row.length for row in rows if row.length])
        # axes of all rows, then their partners
        pairs = np.array([[row.axis for row in rows], [row.partner for row in rows]], dtype=np.intp).reshape(2, size, 2)
        frames, columns = pairs[:, :, 0], pairs[:, :, 1]
        self._carried = support[frames.ravel()]
        signs, moving = np.array([row.sign for row in rows]), (columns == _ORIGIN).astype(float)
        self.sliding = bool(moving[1].all())
        """Whether all rows are translations."""
        self._signs, self._moving = signs if (signs < 0.0).any() else None, moving
        # One look-up of 21 numbers a row: 0 to 5 a and c, component by component (a_x, c_x, a_y, ...); 6 to 11 the
        # components of c and 12 to 17 those of a whose products make c × a (see ``_NEXT``); 18 to 20 p_A.
        axis, partner, origin = (
            12 * ids[frame] + 3 * column + np.arange(3)[:, None]
            for frame, column in (*zip(frames, columns, strict=True), (frames[0], _ORIGIN))
        )
        both = np.stack([axis, partner], axis=1).reshape(6, size)
        self._taken = np.concatenate([both, partner[_NEXT], axis[_AFTER], origin])
        # a row of sign −1 has −a for its axis, wherever a stands
        self._taken_signs = np.where(np.isin(np.arange(21), [0, 2, 4, *range(12, 18)])[:, None], signs, 1.0)
        first, second = np.array([row[2:4] for row in rows], dtype=np.intp).reshape(size, 2).T
        self.mask = support[second] - support[first]

    def place(self, vectors: Array, q: Array, order: IntArray | None = None) -> PlacedRows:
        """Return the rows at one configuration, or at N.

        Args:
            vectors: (12 F',) or (12 F', N) axes and origin of each of Pinocchio's frames, world axes.
            q: (nq,) or (N, nq) configurations.
            order: (12 F',) where ``vectors`` has each of these numbers, if it holds some of the frames only.
        """
        taken, one = vectors.take(self._taken if order is None else order[self._taken], 0), vectors.ndim == 1
        if self._signs is not None:
            taken *= self._taken_signs if one else self._taken_signs[..., None]
        if self.rods:  # a = (p_B − p_A) / L in place of an axis that a frame carries
            along = self.per_length(taken[1:6:2, self.rods] - taken[18:, self.rods])
            taken[0:6:2, self.rods], taken[12:18, self.rods] = along, along[_AFTER]
        moving = self._moving if one else self._moving[..., None]
        pairs = taken[:6].reshape(3, 2, *taken.shape[1:])  # pairs[:, 0] are the axes a, pairs[:, 1] the partners c
        products = taken[6:12] * taken[12:18]
        wrench = np.empty((6, *taken.shape[1:]))  # w = (σ a, c × a)
        np.multiply(pairs[:, 0], moving[1], out=wrench[:3])
        np.subtract(products[:3], products[3:], out=wrench[3:])
        self.set_angles(wrench, 0, pairs[:, 0])
        return PlacedRows(self, pairs, taken[18:], moving, wrench, q)

    def per_length(self, vectors: Array) -> Array:
        """Return a vector of each rod, (3, rods) or (3, rods, N), over the rod's length."""
        result: Array = vectors / (self.lengths if vectors.ndim == 2 else self.lengths[:, None])
        return result

    def set_angles(self, moments: Array, order: int, *axis: Array) -> None:
        """Set the last three components (3, R) or (3, R, N) of rows of angles to g or a time derivative of it.

        Args:
            moments: components of all rows.
            order: 0, 1 or 2.
            axis: (3, R) or (3, R, N) the axis of each row and its derivatives, as many as the order.
        """
        if self._at_angles:
            moments[-3:, self._at_angles] = angles.direction(
                self._kinds, order, [part[:, self._at_angles] for part in axis]
            )

    def times(self, wrench: Array, J: Array) -> Array:
        """Return mask ∘ (w · J), (R, nv) or (N, R, nv), for joint columns J (6, nv) or (N, 6, nv); no couplings."""
        rows: Array = self.mask * (wrench.T @ J)
        return rows

    def twists(self, J: Array, v: Array) -> Array:
        """Return (6, 2, R) the sums of J v over the joints that carry each axis, and each partner."""
        twists: Array = J.dot((self._carried * v).T).reshape(6, 2, self.size)
        return twists


class PlacedRows(NamedTuple):
    """Rows at a configuration, or at N; made by ``RowSet.place``.

    Attributes:
        rows: the rows.
        pairs: (3, 2, R) or (3, 2, R, N) each axis, and each partner.
        origins: (3, R) or (3, R, N) p_A.
        moving: (2, R) or (2, R, 1) 1 for an origin, 0 for an axis; of the partners it is σ.
        wrench: (6, R) or (6, R, N) w.
        q: (nq,) or (N, nq) the configurations.
    """

    rows: RowSet
    pairs: Array
    origins: Array
    moving: Array
    wrench: Array
    q: Array

    def jacobian(self, J: Array) -> Array:
        """Return the rows, (R, nv) or (N, R, nv), for joint columns J (6, nv) or (N, 6, nv)."""
        rows = self.rows.times(self.wrench, J)
        couplings = self.rows.couplings
        if couplings is not None:
            rows[..., couplings.at, :] = couplings.jacobian(self.q)
        return rows

    def residual(self) -> Array:
        """Return (R,) or (R, N) Φ, m; for rotation rows the sine of the angle that is off."""
        axis, partner = self.pairs[:, 0], self.pairs[:, 1]
        origins = self.origins if self.rows.sliding else self.origins * self.moving[1]
        phi: Array = np.add.reduce(axis * (partner - origins))
        rods, couplings = self.rows.rods, self.rows.couplings
        if rods:
            phi[rods] = 0.5 * (phi[rods].T - self.rows.lengths).T
        if couplings is not None:
            phi[couplings.at] = couplings.residual(self.q).T
        return phi

    def rates(self, twists: Array) -> tuple[Array, Array]:
        """Return ȧ and ċ, and ẇ, for the twists (6, 2, R) of the bodies that carry a and c."""
        rods = self.rows.rods
        first = _cross(twists[3:], self.pairs) + twists[:3] * self.moving
        if rods:
            apart = twists[:, 1, rods] - twists[:, 0, rods]
            first[:, 0, rods] += self.rows.per_length(_cross(apart[3:], self.pairs[:, 1, rods]) + apart[:3])
        # ċ × a + c × ȧ = ċ × a − ȧ × c: one call for both
        parts = _cross(first[:, ::-1], self.pairs)
        rate = np.empty(self.wrench.shape)
        np.multiply(first[:, 0], self.moving[1], out=rate[:3])
        np.subtract(parts[:, 0], parts[:, 1], out=rate[3:])
        self.rows.set_angles(rate, 1, self.pairs[:, 0], first[:, 0])
        return first, rate

    def jacobian_rate(self, J: Array, dJ: Array, v: Array) -> Array:
        """Return (R, nv) the rate of the rows at one state; times v it is J̇_c v."""
        return self._rate_of(self.rates(self.rows.twists(J, v))[1], J, dJ, v)

    def _rate_of(self, wrench_rate: Array, J: Array, dJ: Array, v: Array) -> Array:
        rows = self.rows
        rate: Array = rows.mask * (wrench_rate.T.dot(J) + self.wrench.T.dot(dJ))
        if rows.couplings is not None:
            rate[rows.couplings.at] = rows.couplings.jacobian_rate(self.q, v)
        return rate

    def time_derivatives(self, J: Array, dJ: Array, ddJ: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return (R, nv) the rows and their first and second time derivative along a motion v, a (nv,)."""
        rows = self.rows
        twists, second_twists = rows.twists(J, v), rows.twists(J, a) + rows.twists(dJ, v)
        first, rate = self.rates(twists)
        # the spatial acceleration at the world origin is the rate of the velocity there
        second = _cross(second_twists[3:], self.pairs) + _cross(twists[3:], first) + second_twists[:3] * self.moving
        if rows.rods:
            apart, further = (each[:, 1, rows.rods] - each[:, 0, rows.rods] for each in (twists, second_twists))
            away = _cross(further[3:], self.pairs[:, 1, rows.rods]) + _cross(apart[3:], first[:, 1, rows.rods])
            second[:, 0, rows.rods] += rows.per_length(away + further[:3])
        (axis, partner), (da, dc), (dda, ddc) = (np.swapaxes(part, 0, 1) for part in (self.pairs, first, second))
        curve = _cross(ddc, axis) + 2.0 * _cross(dc, da) + _cross(partner, dda)
        bend = np.concatenate((dda * self.moving[1], curve))
        rows.set_angles(bend, 2, axis, da, dda)
        second_rate = rows.times(bend, J) + 2.0 * rows.times(rate, dJ) + rows.times(self.wrench, ddJ)
        if rows.couplings is not None:
            second_rate[rows.couplings.at] = rows.couplings.jacobian_second_rate(self.q, v, a)
        return self.jacobian(J), self._rate_of(rate, J, dJ, v), second_rate


@dataclass(frozen=True, eq=False)
class ConstraintState:
    """Closures and platform at N configurations; made by ``ConstraintSystem.evaluate``.

    Attributes:
        q: (N, nq) configurations.
        frames: numbers of the frames of closures and platform, by name.
        vectors: (12 F, N) axes and origin of each of these frames, see ``placement``.
        columns: (N, 6, nv) joint Jacobian about the world origin.
        phi: (N, r) closure residuals Φ, m (rotation rows: sine of the angle that is off).
        Jc: (N, r, nv) constraint Jacobian dΦ/dv.
        Jx: (N, n, nv) Jacobian of the independent velocities (world-aligned platform twist, or named joints).
        K: (N, r + n, p) both without the carrier columns.
    """

    q: Array
    frames: Mapping[str, int]
    vectors: Array
    columns: Array
    phi: Array
    Jc: Array
    Jx: Array
    K: Array

    def placement(self, frame: str) -> tuple[Array, Array]:
        """Return rotation (3, 3, N) and origin (3, N), m, of a frame of a closure or the platform, by its name."""
        return frame_placement(self.vectors, self.frames[frame])


class ConstraintSystem:
    """Closures and independent velocities of a robot, ready to be evaluated.

    Args:
        robot: the robot.

    Attributes:
        rows: the r rows of the constraints: of the closures, then an empty one for each coupling.
        couplings: what the empty rows stand for, if there are any.
        all_rows: closure rows, and behind them rows of the platform's twist; none of these where the independent
            velocities are those of joints.
        support: (nv,) by frame name, 1 where a velocity moves that frame.
        aligned: pairs of places in ``TreePlacement.vectors`` of axes that point the same way when closed.
        pose_columns: velocity indices that move the pose: all but the carriers.
        selection: (m, nv) S, the main actuators among the velocities.
        independent: (n, nv) unit rows of the independent joints; zero for a robot with a platform.
        equation_unit: (r + n,) the characteristic length, m, for rows of translation and 1 for rows of rotation, of the
            closures and the independent coordinates: residuals over these have no unit.
        step_unit: (p,) the characteristic length, m, for slides and 1 rad for turns, of the pose columns.
        relative_factor: (r + n, p) what K is multiplied by, entry by entry, to have no units: see ``relative``.

    Raises:
        UnsupportedRobotError: a joint between frames of closures has axes that are not constant.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, nv = robot, robot.model.nv
        frames = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
        if robot.platform is not None:
            frames.append(robot.platform.frame)
        at = {name: i for i, name in enumerate(dict.fromkeys(frames))}
        # the world is one more frame, which nothing moves: Pinocchio's first
        support, ids = np.zeros((len(at) + 1, nv)), np.zeros(len(at) + 1, dtype=np.intp)
        for name, i in at.items():
            ids[i] = frame = find_link_index(robot.model, name)
            support[i] = _moves(robot.model, int(robot.model.frames[frame].parentJoint))
        self.support, self._frames = {name: support[i] for name, i in at.items()}, at
        closures = [_row(closure, axis, at) for closure in robot.closures for axis in closure.axes]
        world = len(at)
        empty = Row((world, 0), (world, 1), world, world, 1.0)
        self.couplings = CouplingRows(robot, len(closures)) if robot.couplings else None
        self.rows = (*closures, *(empty for _ in robot.couplings))
        self.all_rows = RowSet((*self.rows, *_platform_rows(robot, at)), support, ids, self.couplings)
        # of many configurations only these frames are kept, one behind the other
        self._kept = (12 * ids[:, None] + np.arange(12)).ravel()
        self._order = np.zeros(12 * robot.model.nframes, dtype=np.intp)
        self._order[self._kept] = np.arange(len(self._kept))
        self.aligned = [
            (12 * int(ids[at[closure.frame_a]]) + 3 * k, 12 * int(ids[at[closure.frame_b]]) + 3 * k)
            for closure in robot.closures
            for k in _aligned(closure)
        ]
        self._aligned_places = np.array(self.aligned, dtype=np.intp).reshape(-1, 2).T
        self.pose_columns = np.setdiff1d(np.arange(nv), robot.carrier_velocity, assume_unique=True)
        self.selection = np.zeros((robot.m, nv))
        self.selection[np.arange(robot.m), robot.actuated_velocity] = 1.0
        self.independent = np.zeros((robot.n, nv))
        if robot.platform is None:
            self.independent[np.arange(robot.n), independent_velocity(robot)] = 1.0
        turning = [row.rotation for row in closures] + ([] if self.couplings is None else self.couplings.turning)
        closure_unit = np.where(turning, 1.0, robot.characteristic_length)
        self.equation_unit = np.concatenate([closure_unit, coordinate_unit(robot)])
        self.step_unit = velocity_unit(robot)[self.pose_columns]
        self.relative_factor = self.step_unit / self.equation_unit[:, None]

    @property
    def closure_unit(self) -> Array:
        """(r,) the part of ``equation_unit`` that belongs to the closures."""
        return self.equation_unit[: len(self.rows)]

    @property
    def has_dependent_rows(self) -> bool:
        """Whether there are closure rows that depend on the r independent ones."""
        return bool(self.robot.all_closures)

    @property
    def every(self) -> ConstraintSystem:
        """The system of all R closure rows, dependent ones too (``Robot.all_closures``); itself where there are none.

        Its other rows, and its columns, are the same.
        """
        return self._every if self.has_dependent_rows else self

    @cached_property
    def _every(self) -> ConstraintSystem:
        return ConstraintSystem(replace(self.robot, closures=self.robot.all_closures, all_closures=()))

    @property
    def dependent_tolerance(self) -> float:
        """Residual of dependent rows, rad or characteristic lengths, up to which a configuration is closed.

        On a branch that is not the machine's it is larger.
        """
        return min(max(_NARROWEST, _WHOLE_TURN * self.robot.dependent_residual), _WIDEST)

    def dependent_row_residual(self, q: Array) -> Array:
        """Return (N,) the closure residual of dependent rows at (N, nq), m; zero for rounding of a file."""
        return self.beyond_rounding(self.every.evaluate(q).phi) if self.has_dependent_rows else np.zeros(len(q))

    def beyond_rounding(self, phi: Array) -> Array:
        """Return (N,) the largest of residuals of all rows (N, R), m; zero for rounding of a file."""
        residual = self.every.largest_residual(phi)
        return np.where(residual > self.dependent_tolerance * self.robot.characteristic_length, residual, 0.0)

    def largest_residual(self, phi: Array) -> Array:
        """Return (N,) the largest of closure residuals (N, r), m; angles count times the characteristic length."""
        largest: Array = np.abs(phi / self.closure_unit).max(axis=1, initial=0.0)
        return self.robot.characteristic_length * largest

    def relative(self, rows: Array) -> Array:
        """Return K (..., r + n, p), or its first rows, without units: what ranks and margins are judged by.

        Rows are divided by ``equation_unit``, columns multiplied by ``step_unit``: with the characteristic length L as
        the unit of length, every rotation counts as the motion of a point at distance L from its axis.
        """
        result: Array = rows * self.relative_factor[: rows.shape[-2]]
        return result

    def closure_rows(self, q: Array) -> Array:
        """Return J_c (r, p) at one configuration q (nq,), without units and without the carrier columns."""
        return self.relative(self.evaluate(q[None]).K[0, : len(self.rows)])

    def combined_rows(self, whole: ConstraintState) -> tuple[Array, Array, Array]:
        """Return the r best combinations of all closure rows, and how far they are from dependent.

        Args:
            whole: what ``every`` evaluates at N configurations.

        Returns:
            Uᵀ J_c (N, r, p) without the carrier columns, Uᵀ Φ (N, r), both without units, and (N,) as of ``row_basis``.
        """
        rows = self.every.relative(whole.Jc[:, :, self.pose_columns])
        basis, least = row_basis(rows, len(self.rows))
        combine = basis.transpose(0, 2, 1)
        return combine @ rows, (combine @ (whole.phi / self.every.closure_unit)[:, :, None])[:, :, 0], least

    def evaluate(self, q: Array) -> ConstraintState:
        """Evaluate residuals and Jacobians at (N, nq) configurations, closed or not."""
        tree, r, n = _placement(self.robot, threading.get_ident()), len(self.rows), len(self.independent)
        vectors, columns = np.empty((len(q), len(self._kept))), np.empty((len(q), *tree.J.shape))
        phi, J = np.empty((len(q), r)), np.empty((len(q), r + n, self.robot.model.nv))
        J[:, r:] = self.independent
        for part in blocks(len(q), _BLOCK):
            for k in range(part.start, part.stop):
                tree.place(q[k])
                vectors[k], columns[k] = tree.vectors[self._kept], tree.J
            placed = self.all_rows.place(vectors[part].T, q[part], self._order)
            J[part, : self.all_rows.size], phi[part] = placed.jacobian(columns[part]), placed.residual()[:r].T
        K = J[:, :, self.pose_columns]
        return ConstraintState(q, self._frames, vectors.T, columns, phi, J[:, :r], J[:, r:], K)

    def rotation_rows(self, state: ConstraintState) -> tuple[Array, Array]:
        """Return residuals (N, r) and rows (N, r, nv) with angles in place of the sines of hinges and welds.

        They are components of the rotation vector from frame A to frame B, of a hinge that between its axes: unlike
        sines they lead to the right side from everywhere. Rows are the rates to first order in these angles.
        """
        phi, rows, first = state.phi.copy(), state.Jc.copy(), 0
        for closure in self.robot.closures:
            turning = [k for k in range(3) if AXES[3 + k] in closure.axes]
            if len(turning) > 1:
                a, b = closure.frame_a, closure.frame_b
                A, B = (state.placement(name)[0] for name in (a, b))
                relative = np.einsum("ijn,ikn->njk", A, B)
                rates = np.einsum("ijn,niv->njv", A, state.columns[:, 3:] * (self.support[b] - self.support[a]))
                at = [first + closure.axes.index(AXES[3 + k]) for k in turning]
                phi[:, at] = np.array([_rotation_vector(each, turning) for each in relative])[:, turning]
                rows[:, at] = rates[:, turning]
            first += len(closure.axes)
        return phi, rows

    def misalignment(self, state: ConstraintState) -> Array:
        """Return (N,) the largest angle, rad, between two axes of a closure that must point the same way.

        The rotation rows of a hinge vanish for opposite axes too, those of a weld also for axes that changed places:
        where all rows vanish this is 0 for a true closure and at least π/2 for a false one. Closures with less than
        two rotation rows have no such axes.
        """
        first, second = (state.vectors[self._order[part] + np.arange(3)[:, None]] for part in self._aligned_places)
        # an arc cosine would be off by 1e-8 rad where axes coincide
        turned = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(second - first, axis=0), 1.0))
        worst: Array = turned.max(axis=0, initial=0.0)
        return worst


def _rotation_vector(relative: Array, turning: list[int]) -> Array:
    """Return (3,) the rotation vector of a weld's rotation matrix (3, 3), of a hinge that between its axes."""
    if len(turning) == 3:
        vector: Array = pin.log3(relative)
        return vector
    free = 3 - sum(turning)
    after, last = (free + 1) % 3, (free + 2) % 3
    normal = np.zeros(3)  # the axis of frame A × that of frame B; np.cross takes twenty times as long
    normal[after], normal[last] = -relative[last, free], relative[after, free]
    sine, cosine = float(np.linalg.norm(normal)), float(relative[free, free])
    if sine < RANK_TOLERANCE:  # axes the same way, or opposite: either way round
        return normal if cosine > 0.0 else np.pi * np.eye(3)[turning[0]]
    return normal / sine * math.atan2(sine, cosine)


@lru_cache(maxsize=32)
def _placement(robot: Robot, thread: int) -> TreePlacement:
    """Return the workspace of a robot in a thread."""
    return TreePlacement(robot.model)


def _moves(model: pin.Model, joint: int) -> Array:
    """Return (nv,) 1 for each velocity that moves what a joint carries.

    Raises:
        UnsupportedRobotError: one of the joints on the way is not covered.
    """
    moves = np.zeros(model.nv)
    for index in model.supports[joint].tolist()[1:]:
        if not is_covered(model, index):
            raise UnsupportedRobotError(
                f"Joint {model.names[index]!r} has type {model.joints[index].shortname()}, which closed-chain "
                "kinematics does not cover.",
                remedy="Build it from revolute, continuous, prismatic, planar, ball or floating joints.",
                joint=model.names[index],
                type=str(model.joints[index].shortname()),
            )
        moves[model.joints[index].idx_v : model.joints[index].idx_v + model.joints[index].nv] = 1.0
    return moves


def independent_velocity(robot: Robot) -> list[int]:
    """Return the velocity index of each independent joint of a robot without a platform."""
    model = robot.model
    return [int(find_joint(model, name).idx_v) for name in robot.independent_joints]


def _aligned(closure: Closure) -> list[int]:
    """Return the axes that coincide when closed: the free axis of a hinge, all three of a weld."""
    free = [k for k in range(3) if AXES[3 + k] not in closure.axes]
    return {0: [0, 1, 2], 1: free}.get(len(free), [])


def _row(closure: Closure, axis: str, at: dict[str, int]) -> Row:
    a, b = at[closure.frame_a], at[closure.frame_b]
    if closure.is_rod:
        return Row((a, 0), (b, _ORIGIN), a, b, 1.0, length=closure.length)
    rotation, k = divmod(AXES.index(axis), 3)
    if not rotation:
        return Row((a, k), (b, _ORIGIN), a, b, 1.0)
    i, j = (k + 1) % 3, (k + 2) % 3
    free = [c for c in range(3) if AXES[3 + c] not in closure.axes]
    if len(free) == 1:
        # a hinge: compare the free axis of B with the two axes of A that must stay normal to it
        other = i if free[0] == j else j
        return Row((a, other), (b, free[0]), a, b, 1.0 if other == j else -1.0)
    return Row((a, j), (b, i), a, b, 1.0)


def _platform_rows(robot: Robot, at: dict[str, int]) -> list[Row]:
    if robot.platform is None:
        return []
    world, platform = len(at), at[robot.platform.frame]
    rows, rates = [], angles.angle_rows(robot)
    for rotation, k in (divmod(AXES.index(axis), 3) for axis in robot.platform.axes):
        if rotation and k in rates:
            pointer = angles.pointer(robot.platform)
            rows.append(Row((platform, pointer), (world, 0), world, platform, 1.0, rates[k]))
            continue
        axis = (k + 2) % 3 if rotation else k  # e_{k+1} × e_{k+2} = e_k
        partner = (world, (k + 1) % 3) if rotation else (platform, _ORIGIN)
        rows.append(Row((world, axis), partner, world, platform, 1.0))
    return rows


@lru_cache(maxsize=32)
def constraint_system(robot: Robot) -> ConstraintSystem:
    """Return the constraint system of a robot, built once: a single sample takes a third of its time again."""
    return ConstraintSystem(robot)


def row_basis(rows: Array, rank: int) -> tuple[Array, Array]:
    """Return r independent combinations of all closure rows, as a basis U, and how far they are from dependent.

    The left singular vectors of the r largest singular values are the best approximation of rank r (Golub and Van Loan,
    "Matrix Computations", 2013, theorem 2.4.8): Uᵀ J_c are r independent rows wherever all rows have rank r.

    Args:
        rows: (..., R, p) J_c of all rows, without units.
        rank: number r of independent rows.

    Returns:
        U (..., R, r), orthonormal, and the smallest of the r singular values (...), infinite without any.

    Example:
        >>> basis, least = row_basis(np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), 2)
        >>> least
        1.0
    """
    left, values, _ = np.linalg.svd(rows, full_matrices=False)
    return left[..., :rank], values[..., :rank].min(axis=-1, initial=np.inf)
