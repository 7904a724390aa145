"""The singular locus over the workspace: curves of type I and type II singularities in one working mode.

A grid of platform positions is solved on one branch. Type II curves run where the signed margin changes sign between
neighbouring nodes, type I curves where reachable nodes meet unreachable ones (the working mode ends there). Every point
that is returned is refined to an exact singular configuration on its grid edge; curves join them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import Array, BoolArray, IntArray, frozen, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.followed_path import margins_of
from redundancy_pin.kinematics.locus_slice import Slice, default_axes, slice_of
from redundancy_pin.kinematics.marching import contour, edge_points, split
from redundancy_pin.kinematics.singular_matrices import locked_matrix, serial_matrix
from redundancy_pin.kinematics.singular_refine import SINGULAR, RefinedPoints, approach_border, bisect_margin, refine
from redundancy_pin.kinematics.singularity import SingularityKind
from redundancy_pin.kinematics.workspace_grid import WorkspaceGrid, solve_grid
from redundancy_pin.robot import Robot

RESOLUTION = 200
"""Nodes along each axis of the grid."""


@dataclass(frozen=True, eq=False)
class LocusCurve:
    """One singular curve.

    Attributes:
        kind: type I, type II, or combined where every point of the curve is both (a four-bar at the end of its crank's
            range).
        points: (P, n) platform coordinates along it, base frame, m and rad; the last equals the first where it is
            closed. A robot with one coordinate has curves of one point.
        q: (P, nq) configurations there, carriers at zero.
        residual: (P,) scaled smallest singular value left: of K (type I) or T (type II).
    """

    kind: SingularityKind
    points: Array
    q: Array
    residual: Array


@dataclass(frozen=True, eq=False)
class SingularLocus:
    """Singular curves of a robot over its workspace, and the margins they were found in.

    Attributes:
        robot: the robot; its working mode is that of the locus.
        names: names of the one or two coordinates that vary.
        units: of each, "m" or "rad".
        free: their columns in x.
        fixed: by name, the coordinates that are held, rad.
        reference: (n,) the position that the search started from: that of the reference configuration, at the
            orientation of the slice.
        q_reference: (nq,) the configuration there.
        axes: the grid along each free coordinate, m or rad.
        margin: (A,) or (A, B) signed scaled margin to type II (see ``singular_matrices.signed_margin``), first
            index along the first coordinate; NaN where not reachable.
        serial_margin: same shape, scaled margin to type I; NaN where not reachable.
        curves: the curves.
        unresolved: number of grid edges on which a singularity was announced and no exact one found; the curves are
            cut there. A finer grid leaves fewer.
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

    @property
    def reachable(self) -> BoolArray:
        """Same shape as ``margin``: whether each node of the grid is reachable in the working mode."""
        return read_only(np.isfinite(self.serial_margin))

    @property
    def points(self) -> Array:
        """(P, n) all points of all curves, base frame, m and rad."""
        empty = np.zeros((0, self.robot.n))
        return read_only(np.concatenate([empty, *(curve.points for curve in self.curves)]))

    @property
    def kind(self) -> NDArray[np.int8]:
        """(P,) ``SingularityKind`` of each point."""
        each = [np.full(len(curve.points), curve.kind, dtype=np.int8) for curve in self.curves]
        return read_only(np.concatenate([np.zeros(0, dtype=np.int8), *each]))

    @property
    def residual(self) -> Array:
        """(P,) scaled smallest singular value left at each point."""
        return read_only(np.concatenate([np.zeros(0), *(curve.residual for curve in self.curves)]))

    def of_kind(self, kind: SingularityKind) -> tuple[LocusCurve, ...]:
        """Return the curves of one kind."""
        return tuple(curve for curve in self.curves if curve.kind == kind)


def singular_locus(
    robot: Robot,
    *,
    orientation: float | None = None,
    bounds: Sequence[tuple[float, float]] | None = None,
    resolution: int = RESOLUTION,
) -> SingularLocus:
    """Return the singular curves of a planar robot over its workspace, or the singular positions of one coordinate.

    Covered are platforms with two translations and at most one rotation (which is held), and robots whose only
    independent coordinate is a joint. Only the part of the workspace that is connected to the reference configuration
    within the slice is searched, and features smaller than a grid cell can be missed. Isolated type I points (a leg of
    zero length, or folded onto its base hinge) are no curves and are not listed. Where m ≠ n type II singularities fill
    no curves: only type I is given.

    Args:
        robot: the robot, in the working mode wanted.
        orientation: angle of the platform, rad; that of the reference when left out.
        bounds: (lower, upper) for each free coordinate, m or rad; the whole workspace when left out, or four
            characteristic lengths around the reference where it has no end.
        resolution: nodes along each axis.

    Raises:
        UnsupportedRobotError: a spatial platform, or more coordinates than can be drawn.
        InputError: an orientation for a robot without one, bounds that do not fit, a resolution below 3.
        UnreachablePoseError, WorkingModeError: the reference position cannot be reached at this orientation.
    """
    if resolution < 3:
        raise InputError(f"resolution is {resolution}.", remedy="Pass at least 3, for example 200.")
    system = ConstraintSystem(robot)
    place = slice_of(system, orientation)
    axes = _axes(system, place, bounds, resolution)
    grid = solve_grid(system, place.free, axes, place.x, place.q)
    parallel, serial = np.full(len(grid.x), np.nan), np.full(len(grid.x), np.nan)
    margins = margins_of(system, system.evaluate(grid.q[grid.reachable]))
    parallel[grid.reachable], serial[grid.reachable] = margins.parallel, margins.serial
    border, border_missing = _border(system, grid)
    inner, inner_missing = _zero_margin(system, grid, parallel) if robot.n == robot.m else ((), 0)
    return SingularLocus(
        robot=robot,
        names=place.names,
        units=place.units,
        free=place.free,
        fixed=MappingProxyType(place.fixed),
        reference=frozen(place.x),
        q_reference=frozen(place.q),
        axes=grid.axes,
        margin=read_only(parallel.reshape(grid.shape)),
        serial_margin=read_only(serial.reshape(grid.shape)),
        curves=border + inner,
        unresolved=border_missing + inner_missing,
    )


def _axes(
    system: ConstraintSystem, place: Slice, bounds: Sequence[tuple[float, float]] | None, resolution: int
) -> tuple[Array, ...]:
    if bounds is None:
        return default_axes(system, place, resolution)
    if len(bounds) != len(place.free) or not all(low < high and np.isfinite([low, high]).all() for low, high in bounds):
        raise InputError(
            f"bounds is {bounds!r}; the locus of {system.robot.name} runs over {', '.join(place.names)}.",
            remedy="Pass one (lower, upper) pair for each of them.",
        )
    return tuple(np.linspace(low, high, resolution) for low, high in bounds)


def _border(system: ConstraintSystem, grid: WorkspaceGrid) -> tuple[tuple[LocusCurve, ...], int]:
    """Return the type I curves: the border of the reachable nodes."""
    shaped = grid.reachable.reshape(grid.shape)
    found = contour(shaped, np.ones_like(shaped))
    edges = np.where(grid.reachable[found.edges[:, :1]], found.edges, found.edges[:, ::-1])
    start, end = grid.x[edges[:, 0]], grid.x[edges[:, 1]]
    near = approach_border(system, grid.q[edges[:, 0]], start, end)
    points = refine(system, serial_matrix, near, start, end, _free_column(grid, edges))
    return _curves(system, SingularityKind.TYPE_I, points, split(found, points.found)), int((~points.found).sum())


def _zero_margin(system: ConstraintSystem, grid: WorkspaceGrid, margin: Array) -> tuple[tuple[LocusCurve, ...], int]:
    """Return the type II curves: the zeros of the signed margin."""
    # rounding must not decide the sign of nodes that lie on the curve
    positive = margin > -_ON_CURVE
    found = contour(positive.reshape(grid.shape), grid.reachable.reshape(grid.shape))
    edges = found.edges
    start, end = grid.x[edges[:, 0]], grid.x[edges[:, 1]]
    left, right = margin[edges[:, 0]], margin[edges[:, 1]]
    fraction = np.clip(left / (left - right), 0.0, 1.0)
    nearer = np.where(fraction < 0.5, edges[:, 0], edges[:, 1])
    solution = assemble(system, grid.q[nearer], edge_points(grid.x, edges, fraction))
    near = np.where(solution.closed[:, None], solution.q, grid.q[nearer])
    points = refine(system, locked_matrix, near, start, end, _free_column(grid, edges))
    again = np.flatnonzero(~points.found)
    if len(again):
        # next to the border of the workspace Newton may leave the working mode: bring it nearer first
        edges, start, end = edges[again], start[again], end[again]
        near = bisect_margin(system, grid.q[edges[:, 0]], start, end, left[again])
        points = points.replaced(again, refine(system, locked_matrix, near, start, end, _free_column(grid, edges)))
    return _curves(system, SingularityKind.TYPE_II, points, split(found, points.found)), int((~points.found).sum())


def _free_column(grid: WorkspaceGrid, edges: IntArray) -> IntArray:
    """Return (E,) the column of x in which the ends of each edge differ."""
    change = np.abs(grid.x[edges[:, 1]] - grid.x[edges[:, 0]])[:, list(grid.free)]
    columns: IntArray = np.array(grid.free, dtype=np.intp)[change.argmax(axis=1)]
    return columns


def _curves(
    system: ConstraintSystem, kind: SingularityKind, points: RefinedPoints, chains: tuple[IntArray, ...]
) -> tuple[LocusCurve, ...]:
    both = [matrix(system, system.evaluate(points.q)) for matrix in (serial_matrix, locked_matrix)]
    combined = np.all([np.linalg.svd(one, compute_uv=False)[:, -1] < SINGULAR for one in both], axis=0)
    return tuple(
        LocusCurve(
            SingularityKind.COMBINED if combined[chain].all() else kind,
            *(read_only(part[chain]) for part in (points.x, points.q, points.residual)),
        )
        for chain in chains
    )


_ON_CURVE = 1e-12
"""Signed margins above minus this count as positive: of a node on the curve rounding leaves a few 1e-16."""
