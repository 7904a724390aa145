"""The singular locus over the workspace: curves of type I and type II singularities in one working mode.

The configurations over a grid of platform positions are solved on one branch. Type II curves are the zero contours of
the signed singularity margin. Type I curves are the border between reachable and unreachable nodes, where the working
mode ends. Each point of a contour lies on an edge of the grid and is moved onto the singularity by Newton's method.

Newton's method. In joint coordinates a singularity is a simple root, also where platform coordinates meet a square root
(at the border of the workspace). The unknowns are all p joint displacements. The equations are the closure rows, the
fixed platform coordinates and σ = 0, the smallest singular value of the scaled K (type I) or T (type II). With
σ = uᵀ M v and the symmetry of second derivatives, Ṁ(δ) v = Ṁ(v) δ, the gradient of σ is uᵀ Ṁ(v): one rate of a Jacobian
instead of p differences.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from contourpy import contour_generator

from redundancy_pin.arrays import (
    CLOSURE_TOLERANCE,
    RANK_TOLERANCE,
    Array,
    BoolArray,
    Frozen,
    IntArray,
    read_only,
    require_type,
)
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.io.summary import Summary, TextTable, number
from redundancy_pin.kinematics.assembly import configuration_difference, newton
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import coordinates, difference, mode_indicator
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import coordinate_unit, turning_velocities
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.grid import (
    Slice,
    WorkspaceGrid,
    bounded_axes,
    default_axes,
    describe,
    require_resolution,
    slice_through,
    solve_grid,
)

_LONGEST_TURN = 2.0
"""Largest change of a joint between neighbouring points of a curve, rad: on the two sides of a leg of zero length it is
π, along one curve it goes with the root of a cell, in lengths of a link."""

_LONGEST_CHORD = 3.0
"""Longest distance between neighbouring points of a curve, cells. At a corner of the border two singular values of K
vanish, and Newton's method for one of them fails."""

_SPACING = 0.05
"""Shortest distance between neighbouring points, cells. Contours that pass near a node cross two edges there."""


@dataclass(frozen=True, eq=False)
class LocusCurve(Frozen):
    """One singular curve.

    Attributes:
        kind: type I, type II, or combined where every point of the curve is both (a four-bar at the end of its crank's
            range).
        points: (P, n) platform coordinates along it, base frame, m and rad; the last equals the first if it is
            closed. A robot with one coordinate has curves of one point.
        q: (P, nq) configurations there, carriers at zero.
        residual: (P,) scaled smallest singular value left: of K (type I) or T (type II).
    """

    kind: SingularityKind
    points: Array
    q: Array
    residual: Array


@dataclass(frozen=True, eq=False, repr=False)
class SingularLocus(Frozen):
    """Singular curves of a robot over its workspace, and the margins they were found in.

    Attributes:
        robot: the robot; the locus is in its working mode.
        names: names of the one or two coordinates that vary.
        units: of each, "m" or "rad".
        free: their columns in x.
        fixed: by name, the coordinates that do not vary, rad.
        reference: (n,) the position that the search started from: at the reference configuration, with the
            orientation of the slice.
        q_reference: (nq,) the configuration there.
        axes: the grid along each free coordinate, m or rad.
        margin: (A,) or (A, B) signed scaled margin to type II (see ``classify.signed_margin``), first
            index along the first coordinate; NaN where not reachable.
        serial_margin: same shape, scaled margin to type I; NaN where not reachable.
        curves: the curves.
        unresolved: number of grid edges that cross a singularity and have no exact point on a curve within a cell. A
            finer grid leaves fewer.
    """

    robot: Robot
    names: tuple[str, ...]
    units: tuple[str, ...]
    free: tuple[int, ...]
    fixed: Mapping[str, float]
    reference: Array
    q_reference: Array
    axes: tuple[Array, ...]
    margin: Array
    serial_margin: Array
    curves: tuple[LocusCurve, ...]
    unresolved: int

    def __repr__(self) -> str:
        """Return what tells loci apart, not their arrays."""
        return (
            f"SingularLocus({self.robot.name!r}; {describe(self.names, self.units, self.axes)}, "
            f"{len(self.curves)} curve(s), {len(self.points)} points)"
        )

    def summary(self) -> Summary:
        """Return what is worth knowing of it: a mapping of bounds, nodes, and curves and points of each kind.

        Its ``print`` shows a table.

        Example:
            >>> print(singular_locus("five_bar").summary())
        """
        margin = np.abs(self.margin[np.isfinite(self.margin)])
        kinds = {kind.label: self.of_kind(kind) for kind in SingularityKind}
        facts: dict[str, Any] = {
            "robot": self.robot.name,
            "bounds": {name: [axis[0], axis[-1]] for name, axis in zip(self.names, self.axes, strict=True)},
            "fixed": dict(self.fixed),
            "nodes": int(self.margin.size),
            "reachable": int(self.reachable.sum()),
            "largest_margin": float(margin.max(initial=0.0)),
            "curves": {
                label: {"curves": len(curves), "points": sum(len(curve.points) for curve in curves)}
                for label, curves in kinds.items()
                if curves
            },
            "unresolved": self.unresolved,
        }
        rows = [
            *(
                (f"{name} [{unit}]", f"{low:.6g} to {high:.6g}")
                for (name, (low, high)), unit in zip(facts["bounds"].items(), self.units, strict=True)
            ),
            *((f"{name} [rad], fixed", number(value)) for name, value in self.fixed.items()),
            ("nodes", f"{facts['reachable']} of {facts['nodes']} reachable"),
            ("largest margin to type II", number(facts["largest_margin"])),
        ]
        for label, one in facts["curves"].items():
            rows.append((label.replace("_", " "), f"{one['curves']} curve(s), {one['points']} points"))
        if not self.curves:
            rows.append(("curves", "none"))
        missed = f"{self.unresolved} edge(s) of the grid cross a singularity of no curve; a finer grid leaves fewer."
        title = f"{self.robot.name}: singularities over {', '.join(self.names)}"
        return Summary(facts, TextTable(title, rows), warnings=[missed] * bool(self.unresolved))

    @property
    def reachable(self) -> BoolArray:
        """Same shape as ``margin``: whether each node of the grid is reachable in the working mode."""
        return read_only(np.isfinite(self.serial_margin))

    @property
    def points(self) -> Array:
        """(P, n) all points of all curves, base frame, m and rad."""
        empty = np.zeros((0, self.robot.n))
        return read_only(np.concatenate([empty, *(curve.points for curve in self.curves)]))

    def of_kind(self, kind: SingularityKind) -> tuple[LocusCurve, ...]:
        """Return the curves of one kind; InputError for anything but a ``SingularityKind``."""
        require_type(kind, SingularityKind, "A SingularityKind", "Pass SingularityKind.TYPE_I, say.")
        return tuple(curve for curve in self.curves if curve.kind == kind)


def singular_locus(
    robot: RobotLike,
    *,
    orientation: float | None = None,
    bounds: Sequence[tuple[float, float]] | None = None,
    resolution: int = 200,
) -> SingularLocus:
    """Return the singular curves of a planar robot over its workspace, or the singular positions of one coordinate.

    Covered are platforms with two translations and at most one rotation (which is fixed), and robots whose only
    independent coordinate is a joint. Only the part of the workspace that is connected to the reference configuration
    within the slice is searched.

    Every point is exact (see ``LocusCurve.residual``); what lies between points is known to a cell of the grid. Curves
    smaller than a cell can be missed, corners of the border are cut within a cell, and a type II curve is cut if it
    comes within a cell of the border. Isolated type I points (a leg of zero length, or folded onto its base hinge) are
    no curves and are not listed. Where m ≠ n type II singularities fill no curves: only type I is given.

    Args:
        robot: the robot, in the working mode wanted.
        orientation: angle of the platform, rad; the reference angle when left out.
        bounds: (lower, upper) for each free coordinate, m or rad; the whole workspace when left out, or four
            characteristic lengths around the reference if it is unbounded.
        resolution: nodes along each axis.

    Raises:
        UnsupportedRobotError: a spatial platform, or more coordinates than can be drawn.
        InputError: an orientation for a robot without one, bounds that do not fit, a resolution below 3.
        UnreachablePoseError, WorkingModeError: the reference position cannot be reached at this orientation.

    Example:
        >>> locus = rp.singular_locus("five_bar", resolution=20)
        >>> locus.curves[0].points.shape[1]
        2
    """
    robot = as_robot(robot)
    place, fixed = _slice(robot, orientation)
    resolution = require_resolution(resolution, len(place.free))
    given = default_axes(place, resolution) if bounds is None else bounded_axes(robot, place.names, bounds, resolution)
    grid = solve_grid(place, given)
    parallel, serial = grid.margins

    solver, edges, curves = _SingularPoints(place), list[Array](), list[LocusCurve]()
    reachable = np.where(grid.reachable, 1.0, -1.0)
    contours = [(SingularityKind.TYPE_I, one) for one in _contours(reachable, grid.shape)]
    if robot.n == robot.m:
        contours += [(SingularityKind.TYPE_II, one) for one in _contours(parallel + RANK_TOLERANCE, grid.shape)]
    for kind, contour in contours:
        found = [_point_on_edge(solver, grid, kind, *one) for one in contour]
        # an exact point may still be dropped, alone between two jumps; isolated type I points are no curves
        missed = [point is None or kind == SingularityKind.TYPE_II for point in found]
        edges += [grid.x[start] for (start, _, _), flag in zip(contour, missed, strict=True) if flag]
        curves += _curves(solver, grid, kind, found, len(contour) > 2 and contour[0] == contour[-1])
    points = np.concatenate([np.full((1, robot.n), np.inf), *(curve.points for curve in curves)])
    return SingularLocus(
        robot=robot,
        names=place.names,
        units=place.units,
        free=place.free,
        fixed=MappingProxyType(fixed),
        reference=place.x,
        q_reference=place.q,
        axes=grid.axes,
        margin=read_only(parallel.reshape(grid.shape)),
        serial_margin=read_only(serial.reshape(grid.shape)),
        curves=tuple(curves),
        unresolved=sum(bool((np.linalg.norm(points - x, axis=1) > _cell(grid)).all()) for x in edges),
    )


def _slice(robot: Robot, orientation: float | None) -> tuple[Slice, dict[str, float]]:
    """Return the slice of a locus, and by name the coordinates that do not vary.

    Raises:
        UnsupportedRobotError: not planar.
        InputError: an orientation for a robot without one, or one that is not finite.
    """
    names = robot.platform.axes if robot.platform else robot.independent_joints
    free = tuple(name for name in names if robot.platform is None or not name.startswith("r"))
    if len(free) != (1 if robot.platform is None else 2) or len(names) - len(free) > 1:
        raise UnsupportedRobotError(
            f"The singular locus of {robot.name} cannot be drawn: its coordinates are {', '.join(names)}.",
            remedy="A locus is for two translations with at most one rotation, or a single joint; of other robots "
            "look at the singular instants of a motion, with find_crossings, or at margins, with rp.workspace.",
        )
    place = slice_through(robot, free)
    fixed = [k for k, name in enumerate(names) if name not in free]
    if orientation is not None:
        if not fixed or not np.isfinite(orientation):
            raise InputError(
                f"orientation is {orientation}, and the coordinates of {robot.name} are {', '.join(names)}.",
                remedy="Leave it out for a robot without orientation; pass a finite angle in rad otherwise.",
            )
        place = slice_through(robot, free, np.where(np.arange(robot.n) == fixed[0], orientation, place.x))
    return place, {names[k]: float(place.x[k]) for k in fixed}


def _cell(grid: WorkspaceGrid) -> float:
    """Return the diagonal of a cell of the grid, m or rad."""
    return float(np.linalg.norm([axis[1] - axis[0] for axis in grid.axes]))


def _contours(values: Array, shape: tuple[int, ...]) -> list[list[tuple[int, int, float]]]:
    """Return the zero contours of values (G,) on the nodes of a grid: for each, the edges crossed, in order.

    An edge is the numbers of its two nodes, the positive one first, and the fraction of its length at which a linear
    function is zero. A closed contour ends with the edge it starts with. NaN nodes take no part.
    """
    z = np.ma.masked_invalid(values.reshape(shape))
    if z.ndim == 1:
        lines = [np.array([[k + 0.5]]) for k in np.flatnonzero(z[:-1] * z[1:] < 0.0)]
    else:
        lines = [np.asarray(line)[:, ::-1] for line in contour_generator(z=z, corner_mask=True).lines(0.0)]
    contours = []
    for line in lines:
        # next to a masked node a contour ends on the diagonal of a cell, which is not an edge of the grid
        line = line[(line == np.round(line)).sum(axis=1) >= z.ndim - 1]
        low, high = (np.ravel_multi_index(tuple(side(line).astype(np.intp).T), shape) for side in (np.floor, np.ceil))
        ends = np.where((values[low] > values[high])[:, None], np.stack([low, high], 1), np.stack([high, low], 1))
        # an edge of no length: the node itself
        height = np.abs(values[ends[:, 0]] - values[ends[:, 1]])
        fraction = np.abs(values[ends[:, 0]]) / np.where(height > 0.0, height, np.inf)
        contours.append(list(zip(*ends.T.tolist(), fraction.tolist(), strict=True)))
    return contours


class _Point(NamedTuple):
    """A singular configuration: x (n,), q (nq,), smallest singular values of K and T."""

    x: Array
    q: Array
    serial: float
    locked: float


class _SingularPoints:
    """Newton's method for singular configurations in a slice of the workspace of one robot."""

    def __init__(self, place: Slice) -> None:
        self.robot = robot = place.system.robot
        self.follower = follower(robot)
        self.chain = ClosedChain(robot)
        self.columns = columns = self.chain.pose_columns
        self.fixed = [k for k in range(robot.n) if k not in place.free]
        self.unit, self.step_unit = coordinate_unit(robot), self.chain.system.step_unit
        self.turning = columns[turning_velocities(robot)[columns]]
        self.selection = self.chain.system.selection[:, columns]

    def solve(self, q: Array, x: Array, fixed: Sequence[int], *singular: SingularityKind) -> _Point | None:
        """Return a closed configuration near q (nq,) at which matrices are singular.

        Args:
            q: the guess.
            x: (n,) coordinates; coordinates of the columns ``fixed`` are reached exactly.
            fixed: columns of x.
            singular: ``TYPE_I`` for a singular K, ``TYPE_II`` for a singular T, or both.

        Returns:
            The point; None where Newton's method does not converge, or ends in another working mode.
        """

        def linearise(q: Array, _: IntArray) -> tuple[Array, Array]:
            residual, rows = self._equations(q[0], x, fixed, singular)
            return -residual[None], rows[None]

        # steps are of least norm: the equations leave a curve free, and depend on one another where two curves meet
        q = newton(self.chain.system, linearise, q[None])[0]
        residual = self._equations(q, x, fixed, (SingularityKind.TYPE_I, SingularityKind.TYPE_II))[0]
        serial, locked = residual[-2:].tolist()
        least = {SingularityKind.TYPE_I: serial, SingularityKind.TYPE_II: locked}
        closed = np.abs(residual[:-2]).max() < CLOSURE_TOLERANCE
        in_mode = mode_indicator(self.robot, q[None])[0] * np.array(self.robot.working_mode) > -RANK_TOLERANCE
        exact = closed and in_mode.all() and all(least[kind] < RANK_TOLERANCE for kind in singular)
        return _Point(coordinates(self.robot, self.chain), q, serial, locked) if exact else None

    def turn(self, q: Array, other: Array) -> float:
        """Return the largest angle, rad, of a joint between two configurations; whole turns are left out."""
        change = configuration_difference(self.robot.model, q[None], other[None])[0, self.turning]
        return float(np.abs(np.remainder(change + np.pi, 2.0 * np.pi) - np.pi).max(initial=0.0))

    def _equations(
        self, q: Array, x: Array, fixed: Sequence[int], singular: Sequence[SingularityKind]
    ) -> tuple[Array, Array]:
        """Return residuals (e,), singular values last, and their derivatives (e, p) by displacements, without units."""
        chain, r, fixed, v = self.chain, self.chain.rows, list(fixed), np.zeros(self.robot.model.nv)
        chain.update(q, v)
        K, off = chain.matrix(), difference(self.robot, coordinates(self.robot, chain), x)[fixed]
        residual = [chain.relative_residual(), off / self.unit[fixed]]
        rows = [K[:r], K[r:][fixed]]
        for kind in singular:
            type_i = kind == SingularityKind.TYPE_I
            u, sigma, vt = np.linalg.svd(K if type_i else np.concatenate([K[:r], self.selection]), full_matrices=False)
            v[self.columns] = vt[-1] * self.step_unit
            chain.update(q, v)
            moving = len(K) if type_i else r  # the rows of S are constant
            residual.append(sigma[-1:])
            rows.append(u[:moving, -1] @ chain.matrix_rate()[:moving])
        return np.concatenate(residual), np.vstack(rows)


def _point_on_edge(
    solver: _SingularPoints, grid: WorkspaceGrid, kind: SingularityKind, start: int, end: int, fraction: float
) -> _Point | None:
    """Return the singular configuration on an edge of the grid; if none lies there, one within a cell."""
    along = int(np.abs(grid.x[end] - grid.x[start]).argmax())
    x, guess = grid.x[start], grid.q[start]
    if kind == SingularityKind.TYPE_II:
        x = x + fraction * (grid.x[end] - x)
        closed = solver.follower.close(guess, x)
        guess = guess if closed is None else closed.q
    for fixed in ([k for k in range(solver.robot.n) if k != along], solver.fixed):
        point = solver.solve(guess, x, fixed, kind)
        if point is not None and np.linalg.norm(point.x - x) < _cell(grid):
            return point
    return None


def _curves(
    solver: _SingularPoints, grid: WorkspaceGrid, kind: SingularityKind, found: Sequence[_Point | None], closed: bool
) -> list[LocusCurve]:
    """Return the curves through the points of a contour, cut where neighbours are far apart or a joint jumps."""
    cell, points, type_ii = _cell(grid), list[_Point](), kind == SingularityKind.TYPE_II
    for point in found[:-1] if closed else found:
        # at a corner the edges on both sides may lead to one point, with the tip between
        if point is not None and all(np.linalg.norm(point.x - one.x) >= _SPACING * cell for one in points[-2:]):
            points.append(point)
    closed = closed and len(points) > 2
    if closed:
        points.append(points[0])
    breaks = [
        k
        for k, (one, other) in enumerate(pairwise(points), start=1)
        if np.linalg.norm(one.x - other.x) > _LONGEST_CHORD * cell
        or (type_ii and solver.turn(one.q, other.q) > _LONGEST_TURN)
    ]
    pieces = [points[i:j] for i, j in pairwise([0, *breaks, len(points)])]
    if closed and breaks:  # a closed contour that is cut begins and ends in the middle of a curve
        pieces = [[*pieces[-1], *pieces[0][1:]], *pieces[1:-1]]
    curves = []
    for piece in pieces:
        if type_ii and len(grid.axes) == 2 and len(piece) > 1 and (breaks or not closed):
            piece = [*_end(solver, grid, piece[1::-1]), *piece, *_end(solver, grid, piece[-2:])]
        if len(piece) >= len(grid.axes):
            x, q, serial, locked = (read_only(np.array(part)) for part in zip(*piece, strict=True))
            combined = max(serial.max(), locked.max()) < RANK_TOLERANCE
            residual = locked if type_ii else serial
            curves.append(LocusCurve(SingularityKind.COMBINED if combined else kind, x, q, residual))
    return curves


def _end(solver: _SingularPoints, grid: WorkspaceGrid, last: Sequence[_Point]) -> list[_Point]:
    """Return the point, if any, at which a type II curve meets the border, beyond the last two of its points."""
    before, here = last
    point = solver.solve(here.q, here.x, solver.fixed, SingularityKind.TYPE_I, SingularityKind.TYPE_II)
    if point is None:
        return []
    step = point.x - here.x
    onward = float(step @ (here.x - before.x)) > 0.0 and _SPACING * _cell(grid) < np.linalg.norm(step)
    return [point] if onward and np.linalg.norm(step) < 2.0 * _cell(grid) else []
