"""Singular curves followed in the joint coordinates: from where a grid leaves them to where the working mode ends.

The unknowns are all p displacements of the joints. The closure rows, the platform coordinates that are held and σ = 0
of T are p − 1 equations, whose null space is the tangent of the curve; they stay regular where it runs along the border
of the workspace or turns back there. It ends where σ of K vanishes too: that makes p equations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.assembly import configuration_difference, integrate
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, mode_indicator
from redundancy_pin.robot.scales import coordinate_unit, turning_velocities, velocity_unit
from redundancy_pin.singularities.classify import locked_matrix, serial_matrix
from redundancy_pin.singularities.workspace import Slice

MatrixOf = Callable[[ConstraintSystem, ConstraintState], Array]

_DIFFERENCE = 1e-6
"""Step of the central differences of M, rad or characteristic lengths: the relative error, 1e-10, only slows Newton."""

_LONGEST, _SHORTEST = 0.15, 1e-6
"""Steps along a curve, rad (of slides: characteristic lengths)."""

_TURN = 0.95
"""Least cosine between the tangents at the ends of a step: 18°."""

_ALIGNED = 0.8
"""The same, of chords between points of a grid's edges with tangents there."""

MODE_ROUNDING = 1e-9
"""A hair beyond the border of the working mode is rounding, more is another branch."""

_MOST_STEPS = 20_000
_ITERATIONS = 12
_SOLVED = 1e-10
_SAME = 1e-3
"""Ends of curves that are nearer are the same, rad."""
_BESIDE = 0.1
"""Parts of a chord: what is nearer to it is on its curve, which bends by 18° at most between its ends."""


def singular_block(
    system: ConstraintSystem, matrix: MatrixOf, state: ConstraintState, size: int
) -> tuple[Array, Array]:
    """Return Uᵀ M V (E, size²) of the smallest singular values and its derivatives (E, size², p) by displacements.

    It is zero where so many singular values vanish; with U and V held its derivative is Uᵀ ∂M V.
    """
    u, values, vt = np.linalg.svd(matrix(system, state), full_matrices=False)
    samples, columns, model = len(state.q), system.pose_columns, system.robot.model
    steps = _DIFFERENCE * velocity_unit(system.robot)[:, None] * np.eye(model.nv)
    steps = steps[columns]
    steps = np.concatenate([steps, -steps])
    moved = integrate(model, np.repeat(state.q, len(steps), axis=0), np.tile(steps, (samples, 1)))
    shifted = matrix(system, system.evaluate(moved))
    shifted = shifted.reshape(samples, 2, len(columns), *shifted.shape[1:])
    slope = (shifted[:, 0] - shifted[:, 1]) / (2.0 * _DIFFERENCE * system.step_unit[:, None, None])
    block = values[:, -size:, None] * np.eye(size)
    slopes = np.einsum("nia,ncij,nbj->nabc", u[:, :, -size:], slope, vt[:, -size:])
    return block.reshape(samples, size**2), slopes.reshape(samples, size**2, len(columns))


def singular_value(system: ConstraintSystem, matrix: MatrixOf, state: ConstraintState) -> tuple[Array, Array]:
    """Return the smallest singular value (E,) and its derivatives (E, p) by the joint displacements."""
    block, slopes = singular_block(system, matrix, state, 1)
    return block[:, 0], slopes[:, 0]


@dataclass(frozen=True, eq=False)
class Tracer:
    """Follows type II curves in a slice over two coordinates.

    Attributes:
        system: closures and platform rows of the robot, which has as many motors as freedoms.
        place: the slice.
        bounds: (2, 2) lower and upper end of each free coordinate, m.
        cell: longest step of the platform, m.
    """

    system: ConstraintSystem
    place: Slice
    bounds: Array
    cell: float

    def joined(self, parts: Sequence[Array], borders: Sequence[Array]) -> list[Array]:
        """Return whole curves, (P, nq) each; a closed one ends with the point it starts with.

        Args:
            parts: (P, nq) parts of type II curves, in order.
            borders: (P, nq) parts of type I curves; where T changes its sign along one a type II curve ends.
        """
        pool, curves = [piece for part in parts for piece in self._smooth(part)], list[Array]()
        while pool:
            part = pool.pop(0)
            if not self._lies_on(part, curves):  # beside another curve Newton's method may have gone over to it
                curves.append(self._extended(part, pool, curves))
        for end in self._ends_on(borders):
            known = np.concatenate([self.place.q[None], *(each[[0, -1]] for each in curves)])[1:]
            if (np.abs(self._apart(end, known)).max(axis=1) > _SAME).all():
                curves.append(self._extended(end, pool, curves))
        return [curve for curve in curves if len(curve) > 1]

    def corner(self, q: Array) -> Array | None:
        """Return the point (1, nq) where a type I curve goes over from one leg to another, from a guess (1, nq).

        Two singular values of K vanish there. None where there is no such point, or in another working mode.
        """
        corner = self._newton(q, None, (serial_matrix, 2))
        if corner is None:
            return None
        side = mode_indicator(self.system.robot, corner) * np.array(self.system.robot.working_mode)
        return corner if (side > -MODE_ROUNDING).all() else None

    def _lies_on(self, part: Array, curves: Sequence[Array]) -> bool:
        """Return whether all points of a part (P, nq) lie between neighbours of one of the curves."""
        for curve in curves:
            chord = self._apart(curve[:-1], curve[1:])
            size = np.linalg.norm(chord, axis=1).clip(1e-30)
            to = np.array([self._apart(curve[:-1], np.broadcast_to(q, curve[:-1].shape)) for q in part])  # (P, C, p)
            share = (to * chord).sum(axis=2) / size**2
            off = np.linalg.norm(to - share[:, :, None] * chord, axis=2)
            if ((share > -_BESIDE) & (share < 1.0 + _BESIDE) & (off < _BESIDE * size)).any(axis=1).all():
                return True
        return False

    def _smooth(self, part: Array) -> list[Array]:
        """Return the runs of points whose chords are along the curve: beside another one a grid may change over."""
        along = self._tangents(part)
        chord = self._apart(part[:-1], part[1:])
        share = (along[:-1] * chord).sum(axis=1) * (along[1:] * chord).sum(axis=1) / (chord**2).sum(axis=1).clip(1e-30)
        aligned = np.abs(share) > _ALIGNED**2
        aligned &= np.sign(share) == np.sign((along[:-1] * along[1:]).sum(axis=1))
        return np.split(part, np.flatnonzero(~aligned) + 1)

    def _extended(self, curve: Array, pool: list[Array], known: list[Array]) -> Array:
        """Return a curve with what follows at its ends; pieces of the pool that are part of it are taken out.

        It ends where it comes upon one that is ``known``.
        """
        for sign in (1.0, -1.0):
            while True:
                curve, met = self._run(curve, sign, pool, known)
                if met is None:
                    break
                if met < 0:
                    return np.concatenate([curve, curve[:1]])
                piece, ahead = pool.pop(met), self._apart(curve[-2:-1], curve[-1:])[0]
                k = int(np.abs(self._apart(curve[-1:], piece)).max(axis=1).argmin())
                onward = len(piece) < 2 or ahead @ np.sum(self._apart(piece[:-1], piece[1:]), axis=0) > 0.0
                curve = np.concatenate([curve, piece[k + 1 :] if onward else piece[:k][::-1]])
            curve = curve[::-1]
        return curve

    def _run(self, curve: Array, sign: float, pool: list[Array], known: list[Array]) -> tuple[Array, int | None]:
        """Follow a curve from its last point.

        Returns:
            The curve with the points that follow, and which piece of the pool it has reached, with its last point on
            it; −1 for its own start, None at an end.
        """
        q, points, step = curve[-1:], [curve], _LONGEST
        tangent = sign * self._tangents(q)[0]
        if len(curve) > 1:
            tangent *= np.sign(self._apart(curve[-2:-1], q)[0] @ tangent)
        own = curve[: -2 if len(curve) > 2 else 0]
        others = np.concatenate([*pool, own, *known])
        owner = np.repeat(np.arange(len(pool) + 1), [*map(len, pool), len(others) - sum(map(len, pool))])
        start = int(np.searchsorted(owner, len(pool))) if len(own) else -1
        for _ in range(_MOST_STEPS):
            step = min(step, _LONGEST, self.cell / max(self._speed(q, tangent), np.finfo(float).tiny))
            new = self._solved(self._moved(q, step * tangent), tangent)
            ahead = tangent if new is None else self._tangents(new)[0]
            inside = new is not None and self._in_mode(new)
            last = None if new is None or inside else self._end(q, new, step)
            if new is None or abs(ahead @ tangent) < _TURN or (last is None and not inside):
                step *= 0.5
                if step < _SHORTEST:
                    break
                continue
            there = self._apart(q, others)
            along = there @ tangent
            off = np.linalg.norm(there - along[:, None] * tangent, axis=1)
            passed = (along > 0.0) & (along <= (self._apart(q, new)[0] @ tangent)) & (off < 0.25 * step)
            if passed.any():
                k = int(np.flatnonzero(passed)[along[passed].argmin()])
                if owner[k] == len(pool):
                    return np.concatenate(points), -1 if k == start else None
                return np.concatenate([*points, others[k : k + 1]]), int(owner[k])
            if last is not None:
                points.append(last)
                break
            if not self._in_bounds(new):
                break
            points.append(new)
            q, tangent, step = new, ahead * np.sign(ahead @ tangent), 1.5 * step
        return np.concatenate(points), None

    def _end(self, q: Array, outside: Array, step: float) -> Array | None:
        """Return the end of the working mode within a step from q; None where there is none, or q is there."""
        for guess in (outside, q):
            end = self._solved(guess, None)
            if end is not None and _SHORTEST < np.linalg.norm(self._apart(q, end)) < 2.0 * step:
                return end
        return None

    def _ends_on(self, borders: Sequence[Array]) -> Iterator[Array]:
        """Give the points (1, nq) where type II curves meet type I curves."""
        for q in borders:
            signs = np.sign(np.linalg.det(locked_matrix(self.system, self.system.evaluate(q))))
            for k in np.flatnonzero(signs[1:] != signs[:-1]):
                end = self._solved(q[k : k + 1], None)
                size = np.linalg.norm(self._apart(q[k : k + 1], q[k + 1 : k + 2]))
                if end is not None and np.linalg.norm(self._apart(q[k : k + 1], end)) < 2.0 * size:
                    yield end

    # --- one point ----------------------------------------------------------------------------------------------------

    @cached_property
    def _scale(self) -> Array:
        """(p,) what makes displacements of slides comparable to angles."""
        scale: Array = 1.0 / self.system.step_unit
        return scale

    @cached_property
    def _side(self) -> float:
        """Sign of K's determinant throughout the part of the slice that is searched."""
        return self._serial_sign(self.place.q[None])

    def _serial_sign(self, q: Array) -> float:
        return float(np.sign(np.linalg.det(serial_matrix(self.system, self.system.evaluate(q)))[0]))

    def _moved(self, q: Array, step: Array) -> Array:
        full = np.zeros((1, self.system.robot.model.nv))
        full[0, self.system.pose_columns] = step / self._scale
        return integrate(self.system.robot.model, q, full)

    def _apart(self, q: Array, other: Array) -> Array:
        """Return (N, p) the scaled steps from one or N configurations to N others, angles within half a turn."""
        columns = self.system.pose_columns
        q = np.broadcast_to(q, other.shape)
        step = configuration_difference(self.system.robot.model, q, other)[:, columns]
        turning = turning_velocities(self.system.robot)[columns]
        apart: Array = np.where(turning, np.remainder(step + np.pi, 2.0 * np.pi) - np.pi, step) * self._scale
        return apart

    def _equations(self, q: Array, *singular: tuple[MatrixOf, int]) -> tuple[Array, Array]:
        """Return closures, held coordinates and smallest singular values (N, r) at q (N, nq), and derivatives.

        ``singular``: matrices, and how many singular values of each are to vanish.
        """
        state, place, columns = self.system.evaluate(q), self.place, self.system.pose_columns
        fixed = [k for k in range(self.system.robot.n) if k not in place.free]
        target = np.broadcast_to(place.x, (len(q), len(place.x)))
        off = difference(self.system.robot, coordinates(self.system.robot, state), target)[:, fixed]
        vanishing = [singular_block(self.system, matrix, state, size) for matrix, size in singular]
        units = self.system.closure_unit, coordinate_unit(self.system.robot)[fixed]
        values = [state.phi / units[0], off / units[1], *(block for block, _ in vanishing)]
        closures, held = state.Jc[:, :, columns], state.Jx[:, fixed][:, :, columns]
        rows = [closures / units[0][:, None], held / units[1][:, None], *(slopes for _, slopes in vanishing)]
        return np.concatenate(values, axis=1), np.concatenate(rows, axis=1) / self._scale

    def _tangents(self, q: Array) -> Array:
        """Return (N, p) unit tangents, of any sign."""
        tangents: Array = np.linalg.svd(self._equations(q, (locked_matrix, 1))[1])[2][:, -1]
        return tangents

    def _speed(self, q: Array, tangent: Array) -> float:
        """Return how far the platform moves for a unit step."""
        rows = self.system.evaluate(q).Jx[0][list(self.place.free)][:, self.system.pose_columns]
        return float(np.linalg.norm(rows @ (tangent / self._scale)))

    def _solved(self, q: Array, tangent: Array | None) -> Array | None:
        """Return the point of the curve at a right angle to its tangent; without one, its end in the working mode."""
        return self._newton(q, tangent, (locked_matrix, 1), *([(serial_matrix, 1)] if tangent is None else []))

    def _newton(self, q: Array, tangent: Array | None, *singular: tuple[MatrixOf, int]) -> Array | None:
        for _ in range(_ITERATIONS):
            values, rows = (part[0] for part in self._equations(q, *singular))
            if tangent is not None:
                values, rows = np.append(values, 0.0), np.concatenate([rows, tangent[None]])
            step = np.linalg.lstsq(rows, -values, rcond=1e-12)[0]
            if not np.abs(step).max() < 1.0:
                return None
            q = self._moved(q, step)
            if np.abs(step).max() < 1e-10:
                break
        return q if np.abs(values).max() < _SOLVED else None

    def _in_mode(self, q: Array) -> bool:
        wanted = np.array(self.system.robot.working_mode)
        in_mode = (mode_indicator(self.system.robot, q) * wanted > 0.0).all()
        return bool(in_mode) and self._serial_sign(q) == self._side

    def _in_bounds(self, q: Array) -> bool:
        x = coordinates(self.system.robot, self.system.evaluate(q))[0, list(self.place.free)]
        return bool(((x >= self.bounds[:, 0]) & (x <= self.bounds[:, 1])).all())
