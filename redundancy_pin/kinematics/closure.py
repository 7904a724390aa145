"""Loop closures and platform rows at position, velocity and acceleration level, at one state or at many.

A closure row pairs an axis a of frame A with a partner c carried by frame B: the origin p_B of frame B (a translation
along a, σ = 1), or an axis b of frame B that is normal to a when closed (a rotation, σ = 0):

    Φ = a · (c − σ p_A).

It acts as a wrench w on frame B, and as −w on frame A, about the world origin. With V_A, V_B the spatial velocities of
the two bodies and A_A, A_B their accelerations at v̇ = 0 (see ``kinematics.tree``), J the joint Jacobian, and a mask of
+1 where a joint moves B only, −1 where it moves A only,

    w = (σ a, c × a),          Φ̇ = w · (V_B − V_A),           J_c = mask ∘ (w · J),
    ẇ = (σ ȧ, ċ × a + c × ȧ),  J̇_c v = ẇ · (V_B − V_A) + w · (A_B − A_A),   ȧ = ω_A × a,  ċ = ω_B × c + σ v_B,
    ẅ = (σ ä, c̈ × a + 2 ċ × ȧ + c × ä),   J̇_c = mask ∘ (ẇ J + w J̇),   J̈_c = mask ∘ (ẅ J + 2 ẇ J̇ + w J̈).

Rows of a platform's twist are such rows too. Their axis is one of the world; the partner of a translation is the
platform's origin, that of a rotation about a third axis of the world. The row of an angle whose rate is no component of
the twist has an axis of the platform, and w = (0, g) in place of c × a, with the rates of g (``kinematics.angles``).

Which axes a rotation row pairs depends on what else is constrained: with one rotation left free (a hinge) both rows
use the free axis of B, so that they stay independent at every hinge angle. Every row is exact at every configuration,
closed or not, and no row is redundant where the mask has none too many. Two or three rotation rows have false zeros too
(a hinge turned over), which ``ConstraintSystem.misalignment`` tells apart; a single one fixes its angle up to half a
turn.

Couplings of joints are rows too (``kinematics.coupling``), behind those of the closures: among the rows between frames
an empty one, which nothing moves, stands in the place of each.

Arrays of rows are component-major: vectors (3, R) at one state, (3, R, N) at N of them. ``kinematics.chain`` has the
joint Jacobian at one state from Pinocchio, ``ConstraintSystem`` at many from ``kinematics.tree``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.kinematics import angles
from redundancy_pin.kinematics.coupling import CouplingRows
from redundancy_pin.kinematics.tree import AFTER, NEXT, TreeKinematics, TreePose, cross
from redundancy_pin.robot import AXES, Closure, Robot
from redundancy_pin.robot.lookup import find_joint, find_link_index
from redundancy_pin.robot.scales import coordinate_unit, velocity_unit

OPEN = 1e-4
"""Largest residual of rows that were left out, in characteristic lengths or rad. Files are rounded to 2e-5; on a branch
that does not belong to the machine the residual is 1e-3 and more."""

_FULL = 1e3
"""Ratio of the smallest singular values of all rows and of those that count: at a loss of both they are alike, and the
place of one of the latter alone is known to 1e-6 and better."""

_ORIGIN = 3
"""Column of a frame's origin, behind its three axes."""


_PAIRED = np.array([0, 1, 1, 0])
"""Of axis and partner, what ȧ, ċ, Δω × c and a × Δω are made with."""


class Row(NamedTuple):
    """One row: its axis and partner as (frame, column), and the frames between which it acts.

    ``angle`` is the kind and the base axis of one that is the rate of an angle.
    """

    axis: tuple[int, int]
    partner: tuple[int, int]
    first: int
    second: int
    sign: float
    angle: tuple[str, int] | None = None

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
        couplings: what stands in the place of the empty rows among them.
    """

    def __init__(
        self, rows: Sequence[Row], support: Array, ids: IntArray, couplings: CouplingRows | None = None
    ) -> None:
        self.size = size = len(rows)
        self.couplings = couplings
        self.angles = [row.angle for row in rows]
        """Which rows are rates of angles: kind and base axis, or None."""
        self._at_angles = [i for i, angle in enumerate(self.angles) if angle]
        self._kinds = [angle for angle in self.angles if angle]
        # axes of all rows, then their partners
        pairs = np.array([[row.axis for row in rows], [row.partner for row in rows]], dtype=np.intp).reshape(2, size, 2)
        frames, columns = pairs[:, :, 0], pairs[:, :, 1]
        self._vectors = 4 * frames + columns
        self._carried = support[frames.ravel()]
        signs, moving = np.array([row.sign for row in rows]), (columns == _ORIGIN).astype(float)
        self.sliding = bool(moving[1].all())
        """Whether all rows are translations."""
        self._signs, self._moving = signs if (signs < 0.0).any() else None, moving
        # at one state: both vectors, the factors of c × a (c's, then a's), and p_A, by one look-up
        axis, partner, origin = (
            12 * ids[frame] + 3 * column + np.arange(3)[:, None]
            for frame, column in (*zip(frames, columns, strict=True), (frames[0], _ORIGIN))
        )
        both = np.stack([axis, partner], axis=1).reshape(6, size)
        self._taken = np.concatenate([both, partner[NEXT], axis[AFTER], origin])
        self._taken_signs = np.where(np.isin(np.arange(21), [0, 2, 4, *range(12, 18)])[:, None], signs, 1.0)
        first, second = np.array([row[2:4] for row in rows], dtype=np.intp).reshape(size, 2).T
        self.mask = support[second] - support[first]
        self._moved = np.concatenate([self._carried, self.mask, -self.mask])
        self._slides = np.stack([*moving, moving[1], np.zeros(size)])
        self.groups = [
            (part, frames[:, part.start], first[part.start], second[part.start])
            for part in _runs(np.stack([*frames, first, second], axis=1))
        ]
        """Rows between the same bodies: frames of axis and partner, first and second frame."""
        self._blocks = [
            (part, column, float(self.mask[part.start, column]))
            for part in _runs(self.mask)
            for column in np.flatnonzero(self.mask[part.start]).tolist()
        ]

    def place(self, vectors: Array, q: Array) -> PlacedRows:
        """Return the rows at one configuration.

        Args:
            vectors: (12 F',) three axes and the origin of each of Pinocchio's frames, world axes.
            q: (nq,) the configuration.
        """
        taken = vectors.take(self._taken)
        if self._signs is not None:
            taken *= self._taken_signs
        pairs = taken[:6].reshape(3, 2, self.size)
        products = taken[6:12] * taken[12:18]
        wrench = np.empty((6, self.size))
        np.multiply(pairs[:, 0], self._moving[1], out=wrench[:3])
        np.subtract(products[:3], products[3:], out=wrench[3:])
        self.set_angles(wrench, 0, pairs[:, 0])
        return PlacedRows(self, pairs, taken[18:], self._moving, wrench, q)

    def place_many(self, vectors: list[Array], q: Array) -> PlacedRows:
        """Return the rows at N configurations q (nq, N), from 4 F vectors (3, N).

        ``origins`` are left out: they take memory.
        """
        shape = (3, 2, self.size, vectors[0].shape[-1])
        pairs, wrench = np.empty(shape), np.empty((6, *shape[2:]))
        for side, which in enumerate(self._vectors.tolist()):
            for row, index in enumerate(which):
                pairs[:, side, row] = vectors[index]
        if self._signs is not None:
            pairs[:, 0] *= self._signs[:, None]
        axis, partner = pairs[:, 0], pairs[:, 1]
        np.multiply(axis, self._moving[1, :, None], out=wrench[:3])
        cross(partner, axis, wrench[3:])
        self.set_angles(wrench, 0, axis)
        return PlacedRows(self, pairs, vectors[0][:, :0], self._moving[:, :, None], wrench, q)

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

    def residuals(self, placed: PlacedRows, vectors: list[Array]) -> Array:
        """Return (R, N) Φ at N configurations; the rows are the first of the placed ones."""
        phi = np.empty((self.size, placed.pairs.shape[-1]))
        for part, _, first, _ in self.groups:
            axis, offset, moving = placed.pairs[:, 0, part], placed.pairs[:, 1, part], self._moving[1, part, None]
            if moving.any():
                origin = vectors[4 * first + _ORIGIN][:, None]
                offset = offset - (origin if moving.all() else origin * moving)
            np.einsum("krn,krn->rn", axis, offset, out=phi[part])
        if self.couplings is not None:
            phi[self.couplings.at] = self.couplings.residual(placed.q)
        return phi

    def times(self, wrench: Array, J: Array, out: Array | None = None) -> Array:
        """Return mask ∘ (w · J), (R, nv) or (R, nv, N), for joint columns J (6, nv) or (6, nv, N); no couplings."""
        if J.ndim == 2:
            rows: Array = self.mask * wrench.T.dot(J)
            return rows
        result = np.zeros((self.size, *J.shape[1:])) if out is None else out
        for block, column, sign in self._blocks:  # one einsum over all columns takes ten times as long on many samples
            np.einsum("krn,kn->rn", wrench[:, block], J[:, column], out=result[block, column])
            if sign < 0.0:
                # not np.negative(x, out=x): numpy 2.4.6 with AVX-512 loses entries at a stride of 64 bytes
                # (x = np.ones(16)[::8]; np.negative(x, out=x) makes -1 and -0), as with nv = 8 and one sample
                result[block, column] *= -1.0
        return result

    def bias_at(self, placed: PlacedRows, J: Array, dJ: Array, v: Array) -> Array:
        """Return J̇ v (R,) at one state.

        With Δ = V_B − V_A,  ẇ · Δ = ȧ · (σ Δv + Δω × c) + ċ · (a × Δω): four cross products, all at once.
        """
        moved = (self._moved * v).T
        twists = J.dot(moved).reshape(6, 4, self.size)
        parts = cross(twists[3:], placed.pairs.take(_PAIRED, 1)) + twists[:3] * self._slides
        products = (parts[:, :2] * parts[:, 2:]).reshape(6, self.size)
        if self._at_angles:
            products[:, self._at_angles] = 0.0
            self.set_angles(products, 1, placed.pairs[:, 0], parts[:, 0])
            products[3:, self._at_angles] *= twists[3:, 2, self._at_angles]
        rest = placed.wrench * dJ.dot(moved[:, 2 * self.size : 3 * self.size])
        bias: Array = np.add.reduce(products + rest)
        if self.couplings is not None:
            bias[self.couplings.at] = self.couplings.bias(placed.q, v)
        return bias

    def twists(self, J: Array, v: Array) -> Array:
        """Return (6, 2, R) the sums of J v over the joints that carry each axis, and each partner."""
        twists: Array = J.dot((self._carried * v).T).reshape(6, 2, self.size)
        return twists


def _runs(values: NDArray[Any]) -> list[slice]:
    """Return the runs of equal rows."""
    starts = [i for i in range(len(values)) if i == 0 or (values[i] != values[i - 1]).any()]
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(values)], strict=False)]


class PlacedRows(NamedTuple):
    """Rows at a configuration, or at N; made by ``RowSet.place`` and ``RowSet.place_many``.

    Attributes:
        rows: the rows.
        pairs: (3, 2, R) or (3, 2, R, N) each axis, and each partner.
        origins: (3, R) p_A, at one configuration.
        moving: (2, R) or (2, R, 1) 1 for an origin, 0 for an axis; of the partners it is σ.
        wrench: (6, R) or (6, R, N) w.
        q: (nq,) or (nq, N) the configurations.
    """

    rows: RowSet
    pairs: Array
    origins: Array
    moving: Array
    wrench: Array
    q: Array

    def jacobian(self, J: Array, out: Array | None = None) -> Array:
        """Return the rows, (R, nv) or (R, nv, N), for joint columns J (6, nv) or (6, nv, N)."""
        rows = self.rows.times(self.wrench, J, out)
        couplings = self.rows.couplings
        if couplings is not None:
            rows[couplings.at] = couplings.jacobian(self.q)
        return rows

    def residual(self) -> Array:
        """Return (R,) Φ at one configuration, m; for rotation rows the sine of the angle that is off."""
        axis, partner = self.pairs[:, 0], self.pairs[:, 1]
        origins = self.origins if self.rows.sliding else self.origins * self.moving[1]
        phi: Array = np.add.reduce(axis * (partner - origins))
        couplings = self.rows.couplings
        if couplings is not None:
            phi[couplings.at] = couplings.residual(self.q)
        return phi

    def rates(self, twists: Array) -> tuple[Array, Array]:
        """Return ȧ and ċ, and ẇ, for the twists (6, 2, R) of the bodies that carry a and c."""
        first = cross(twists[3:], self.pairs) + twists[:3] * self.moving
        # ċ × a + c × ȧ = ċ × a − ȧ × c: one call for both
        parts = cross(first[:, ::-1], self.pairs)
        rate = np.empty(self.wrench.shape)
        np.multiply(first[:, 0], self.moving[1], out=rate[:3])
        np.subtract(parts[:, 0], parts[:, 1], out=rate[3:])
        self.rows.set_angles(rate, 1, self.pairs[:, 0], first[:, 0])
        return first, rate

    def jacobian_rate(self, J: Array, dJ: Array, v: Array) -> Array:
        """Return (R, nv) the rate of the rows at one state."""
        rows = self.rows
        rate: Array = rows.mask * (self.rates(rows.twists(J, v))[1].T.dot(J) + self.wrench.T.dot(dJ))
        if rows.couplings is not None:
            rate[rows.couplings.at] = rows.couplings.jacobian_rate(self.q, v)
        return rate

    def time_derivatives(self, J: Array, dJ: Array, ddJ: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return (R, nv) the rows and their first and second time derivative along a motion v, a (nv,)."""
        rows = self.rows
        twists, second_twists = rows.twists(J, v), rows.twists(J, a) + rows.twists(dJ, v)
        first, rate = self.rates(twists)
        # the spatial acceleration at the world origin is the rate of the velocity there
        second = cross(second_twists[3:], self.pairs) + cross(twists[3:], first) + second_twists[:3] * self.moving
        (axis, partner), (da, dc), (dda, ddc) = (np.swapaxes(part, 0, 1) for part in (self.pairs, first, second))
        curve = cross(ddc, axis) + 2.0 * cross(dc, da) + cross(partner, dda)
        bend = np.concatenate((dda * self.moving[1], curve))
        rows.set_angles(bend, 2, axis, da, dda)
        first_rate = rows.times(rate, J) + rows.times(self.wrench, dJ)
        second_rate = rows.times(bend, J) + 2.0 * rows.times(rate, dJ) + rows.times(self.wrench, ddJ)
        if rows.couplings is not None:
            first_rate[rows.couplings.at] = rows.couplings.jacobian_rate(self.q, v)
            second_rate[rows.couplings.at] = rows.couplings.jacobian_second_rate(self.q, v, a)
        return self.jacobian(J), first_rate, second_rate


@dataclass(frozen=True, eq=False)
class ConstraintState:
    """Closures and platform at N configurations; made by ``ConstraintSystem.evaluate``.

    Attributes:
        q: (N, nq) configurations.
        pose: the tree's placements.
        rows: closure rows, then platform rows, placed.
        phi: (N, r) closure residuals Φ, m (rotation rows: sine of the angle that is off).
        J: (r + n, nv, N) constraint Jacobian dΦ/dv over that of the independent velocities.
        columns: (p,) the velocities without the carriers'.
    """

    q: Array
    pose: TreePose
    rows: PlacedRows
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

    Attributes:
        rows: the r rows of the constraints: of the closures, then an empty one for each coupling.
        couplings: what the empty rows stand for, if there are any.
        closures, platform, all_rows: closure rows; rows of the platform's twist (none where the independent velocities
            are those of joints); both.
        aligned: pairs of frames and the number of an axis that points the same way in both when closed.
        pose_columns: velocity indices that move the pose: all but the carriers.
        selection: (m, nv) S, the main actuators among the velocities.
        independent: (n, nv) unit rows of the independent joints; zero where there is a platform.
        closure_scale: (r,) length that turns each closure row into m.
        equation_unit: (r + n,) the characteristic length, m, for rows of translation and 1 for rows of rotation, of the
            closures and the independent coordinates: residuals over these have no unit.
        step_unit: (p,) the characteristic length, m, for slides and 1 rad for turns, of the pose columns.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, nv = robot, robot.model.nv
        frames = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
        if robot.platform is not None:
            frames.append(robot.platform.frame)
        self.tree = TreeKinematics(robot.model, tuple(dict.fromkeys(frames)))
        at = {name: i for i, name in enumerate(self.tree.support)}
        # the world is one more frame, which nothing moves: Pinocchio's first
        support, ids = np.zeros((len(at) + 1, nv)), np.zeros(len(at) + 1, dtype=np.intp)
        for name, columns in self.tree.support.items():
            support[at[name], list(columns)] = 1.0
            ids[at[name]] = find_link_index(robot.model, name)
        closures = [_row(closure, axis, at) for closure in robot.closures for axis in closure.axes]
        world = len(at)
        empty = Row((world, 0), (world, 1), world, world, 1.0)
        self.couplings = CouplingRows(robot, len(closures)) if robot.couplings else None
        self.rows = (*closures, *(empty for _ in robot.couplings))
        platform = _platform_rows(robot, at)
        self.closures = RowSet(self.rows, support, ids, self.couplings)
        self.platform = RowSet(platform, support, ids)
        self.all_rows = RowSet((*self.rows, *platform), support, ids, self.couplings)
        self.aligned = [(c.frame_a, c.frame_b, k) for c in robot.closures for k in _aligned(c)]
        self.pose_columns = np.setdiff1d(np.arange(nv), robot.carrier_velocity, assume_unique=True)
        self.selection = np.zeros((robot.m, nv))
        self.selection[np.arange(robot.m), robot.actuated_velocity] = 1.0
        self.independent = np.zeros((robot.n, nv))
        if robot.platform is None:
            self.independent[np.arange(robot.n), independent_velocity(robot)] = 1.0
        turning = [row.rotation for row in closures] + ([] if self.couplings is None else self.couplings.turning)
        self.closure_scale = np.where(turning, robot.characteristic_length, 1.0)
        self.equation_unit = np.concatenate([robot.characteristic_length / self.closure_scale, coordinate_unit(robot)])
        self.step_unit = velocity_unit(robot)[self.pose_columns]

    @property
    def closure_unit(self) -> Array:
        """(r,) the part of ``equation_unit`` that belongs to the closures."""
        return self.equation_unit[: len(self.rows)]

    def gap(self, residual: Array, unit: Array | None = None) -> Array:
        """Return (N,) the largest residual, m; angles count times the characteristic length.

        Args:
            residual: (N, r) of the closures, or (N, r + n) with the coordinates, or (N, e) of other equations.
            unit: (e,) of other equations, as ``equation_unit``.
        """
        unit = self.equation_unit[: residual.shape[1]] if unit is None else unit
        largest: Array = self.robot.characteristic_length * np.abs(residual / unit).max(axis=1, initial=0.0)
        return largest

    def relative(self, K: Array) -> Array:
        """Return K (N, r + n, p) without units: rows over ``equation_unit``, columns times ``step_unit``."""
        result: Array = K * (self.step_unit / self.equation_unit[:, None])
        return result

    def evaluate(self, q: Array) -> ConstraintState:
        """Evaluate residuals and Jacobians at (N, nq) configurations, closed or not."""
        pose, r, world = self.tree.pose(q), len(self.rows), np.broadcast_to(np.eye(3)[:, :, None], (3, 3, len(q)))
        vectors = []
        for name, origin in (*pose.frame_origin.items(), ("", world[:, 0])):  # the world's origin is not needed
            axes = pose.frame_rotation.get(name, world)
            vectors += [axes[:, 0], axes[:, 1], axes[:, 2], origin]
        rows = self.all_rows.place_many(vectors, q.T)
        jacobian = np.zeros((r + self.robot.n, self.robot.model.nv, pose.samples))
        rows.jacobian(pose.jacobian, jacobian)
        if self.robot.platform is None:
            jacobian[r:] = self.independent[:, :, None]
        return ConstraintState(q, pose, rows, self.closures.residuals(rows, vectors).T, jacobian, self.pose_columns)

    def bias(self, state: ConstraintState, v: Array) -> tuple[Array, Array]:
        """Return J̇_c v (N, r) and J̇_x v (N, n) at velocities v (N, nv)."""
        still, r = np.zeros((6, state.pose.samples)), len(self.rows)
        motions = [*self.tree.motions(state.pose, v).values(), (still, still)]
        result = np.zeros((r + self.robot.n, state.pose.samples))
        for rows, carriers, first, second in self.all_rows.groups:
            pairs, moving = state.rows.pairs[:, :, rows], state.rows.moving[:, rows]
            relative, rest = (
                two[:, None] - one[:, None] for one, two in zip(motions[first], motions[second], strict=True)
            )
            total = np.add.reduce(state.rows.wrench[:, rows] * rest)
            kinds = [kind for kind in self.all_rows.angles[rows] if kind]
            if kinds:
                axis = pairs[:, 0]
                turned = angles.direction(kinds, 1, [axis, cross(relative[3:], axis)])
                total += np.add.reduce(turned * relative[3:])
            for k, body in enumerate(carriers):  # the formula of ``RowSet.bias_at``; the world stands still
                if kinds or body == len(motions) - 1:
                    continue
                rate = cross(motions[body][0][3:, None], pairs[:, k])
                if k == 0:
                    lever = cross(relative[3:], pairs[:, 1]) + relative[:3] * moving[1]
                else:
                    rate += motions[body][0][:3, None] * moving[1]
                    lever = cross(pairs[:, 0], relative[3:])
                rate *= lever
                total += np.add.reduce(rate)
            result[rows] = total
        if self.couplings is not None:
            result[self.couplings.at] = self.couplings.bias(state.q.T, v.T)
        return result[:r].T, result[r:].T

    def misalignment(self, state: ConstraintState) -> Array:
        """Return (N,) the largest angle, rad, between two axes of a closure that must point the same way.

        The rotation rows of a hinge vanish for opposite axes too, those of a weld also for axes that changed places:
        where all rows vanish this is 0 for a true closure and at least π/2 for a false one. Closures with less than
        two rotation rows have no such axes.
        """
        angle = np.zeros(state.pose.samples)
        for frame_a, frame_b, k in self.aligned:
            a, b = (state.pose.frame_rotation[frame][:, k] for frame in (frame_a, frame_b))
            cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
            angle = np.maximum(angle, np.arccos(np.clip(cosine, -1.0, 1.0)))
        return angle


def independent_velocity(robot: Robot) -> list[int]:
    """Return the velocity index of each independent joint of a robot without a platform."""
    model = robot.model
    return [int(find_joint(model, name).idx_v) for name in robot.independent_joints]


def _aligned(closure: Closure) -> list[int]:
    """Return the axes that coincide when closed: the free axis of a hinge, all three of a weld."""
    free = [k for k in range(3) if AXES[3 + k] not in closure.axes]
    return {0: [0, 1, 2], 1: free}.get(len(free), [])


def _row(closure: Closure, axis: str, at: dict[str, int]) -> Row:
    rotation, k = divmod(AXES.index(axis), 3)
    a, b = at[closure.frame_a], at[closure.frame_b]
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


@lru_cache(maxsize=32)
def with_all_rows(robot: Robot) -> Robot:
    """Return a robot with the closure rows that were left out because they depend on the others; itself without any."""
    return replace(robot, closures=robot.all_closures, all_closures=()) if robot.all_closures else robot


def left_open(robot: Robot, q: Array) -> Array:
    """Return (N,) the closure residual of rows that were left out at (N, nq), m; zero for rounding of a file."""
    if not robot.all_closures:
        return np.zeros(len(q))
    system = constraint_system(with_all_rows(robot))
    gap = system.gap(system.evaluate(q).phi)
    return np.where(gap > OPEN * robot.characteristic_length, gap, 0.0)


def made_up(robot: Robot, q: Array) -> bool:
    """Return whether rows that were left out make up for those that count, which lose rank at q (nq,).

    Which rows say all changes along the motion of some mechanisms (Bennett's four hinges). The branch goes smoothly
    through such a place, and it is no singularity.
    """
    if not robot.all_closures:
        return False
    rank, values = len(constraint_system(robot).rows), []
    for system in (constraint_system(robot), constraint_system(with_all_rows(robot))):
        rows = system.evaluate(q[None]).Jc[0][:, system.pose_columns] * system.step_unit / system.closure_unit[:, None]
        values.append(np.linalg.svd(rows, compute_uv=False)[rank - 1])
    return bool(values[1] > _FULL * values[0])
