"""The singular locus over the workspace: curves of type I and type II singularities in one working mode.

A grid of platform positions is solved on one branch. Type II curves run where the signed margin changes sign between
neighbouring nodes, type I curves where reachable nodes meet unreachable ones (the working mode ends there). contourpy
joins the grid edges over which this happens into curves; where on its edge the singularity lies is found exactly. Type
II curves are then followed to their ends, from other points of the border too (``tracing``). Where a type I curve goes
over from one leg to another it has a corner: there two singular values of K vanish, and Uᵀ K V of both is zero.

Refinement. In the joint coordinates a singularity is a simple root even where the platform coordinates meet a square
root (at the border of the workspace). The unknowns are all p joint displacements; the equations are the r closure rows,
the n − 1 platform coordinates that are constant along an edge, and σ = 0, the smallest singular value of the scaled K
(type I) or T (type II). With σ = uᵀ M v its derivative is uᵀ (∂M/∂q) v.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from contourpy import contour_generator
from numpy.typing import NDArray

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, frozen, read_only, require_type
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.assembly import assemble, integrate
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, mode_indicator
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.scales import closure_tolerance, coordinate_unit
from redundancy_pin.singularities.classify import SingularityKind, locked_matrix, margins_of, serial_matrix
from redundancy_pin.singularities.tracing import MODE_ROUNDING, MatrixOf, Tracer, singular_value
from redundancy_pin.singularities.workspace import Slice, WorkspaceGrid, default_axes, slice_of, solve_grid

RESOLUTION = 200
"""Nodes along each axis of the grid."""

SINGULAR = 1e-9
"""Scaled singular value below which a refined point counts as singular; Newton leaves 1e-15."""

_ON_CURVE = 1e-12
"""Signed margins above minus this count as positive: of a node on the curve rounding leaves a few 1e-16."""

_ITERATIONS = 20
_LONGEST_NEWTON_STEP = 0.3
_BORDER_BISECTIONS = 5
"""They bring the leg within a thirtieth of a grid cell of the border; from there Newton converges."""

_OTHER_LEG = 0.5
"""Cosine between the motions that K leaves free at two points of a type I curve, below which there is a corner."""

_CORNER_AWAY = 5.0
"""Cells that a corner may be away from the points beside it: inside an acute one there are no nodes."""

_EDGE_ROUNDING = 1e-9
"""A root this far beyond the end of its edge (fraction of its length) is at the end."""


@dataclass(frozen=True, eq=False)
class LocusCurve(Frozen):
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
class SingularLocus(Frozen):
    """Singular curves of a robot over its workspace, and the margins they were found in.

    Attributes:
        robot: the robot; its working mode is that of the locus.
        names: names of the one or two coordinates that vary.
        units: of each, "m" or "rad".
        free: their columns in x.
        fixed: by name, the coordinates that do not vary, rad.
        reference: (n,) the position that the search started from: that of the reference configuration, at the
            orientation of the slice.
        q_reference: (nq,) the configuration there.
        axes: the grid along each free coordinate, m or rad.
        margin: (A,) or (A, B) signed scaled margin to type II (see ``classify.signed_margin``), first
            index along the first coordinate; NaN where not reachable.
        serial_margin: same shape, scaled margin to type I; NaN where not reachable.
        curves: the curves.
        unresolved: number of grid edges on which a singularity was announced and no exact one found: where a type I
            curve is cut, or no type II curve is within a cell. A finer grid leaves fewer.
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
        """Return the curves of one kind; InputError where it is none."""
        require_type(kind, SingularityKind, "A SingularityKind", "Pass SingularityKind.TYPE_I, say.")
        return tuple(curve for curve in self.curves if curve.kind == kind)


def singular_locus(
    robot: RobotLike,
    *,
    orientation: float | None = None,
    bounds: Sequence[tuple[float, float]] | None = None,
    resolution: int = RESOLUTION,
) -> SingularLocus:
    """Return the singular curves of a planar robot over its workspace, or the singular positions of one coordinate.

    Covered are platforms with two translations and at most one rotation (which is fixed), and robots whose only
    independent coordinate is a joint. Only the part of the workspace that is connected to the reference configuration
    within the slice is searched; closed curves smaller than a grid cell can be missed. Isolated type I points (a leg
    of zero length, or folded onto its base hinge) are no curves and are not listed. Where m ≠ n type II singularities
    fill no curves: only type I is given.

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
    robot = as_robot(robot)
    system = ConstraintSystem(robot)
    place = slice_of(system, orientation)
    grid = solve_grid(system, place, _axes(system, place, bounds, resolution))
    parallel, serial = np.full(len(grid.x), np.nan), np.full(len(grid.x), np.nan)
    margins = margins_of(system, system.evaluate(grid.q[grid.reachable]))
    parallel[grid.reachable], serial[grid.reachable] = margins.parallel, margins.serial
    tracer = None
    if len(place.free) == 2:
        ends = np.array([(axis[0], axis[-1]) for axis in grid.axes])
        tracer = Tracer(system, place, ends, max(float(axis[1] - axis[0]) for axis in grid.axes))
    border, cut, lone = _border(system, grid, tracer)
    inner, missing = _zero_margin(system, grid, parallel) if robot.n == robot.m else ((), np.zeros((0, robot.n)))
    if tracer is not None:
        border = tuple(_with_corners(system, tracer, grid, curve) for curve in border)
    if robot.n == robot.m and tracer is not None:
        inner = _followed(system, tracer, inner, border)
        lone, missing = (_not_beside(part, inner, grid) for part in (lone, missing))
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
        unresolved=cut + len(lone) + len(missing),
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


def crossed_edges(flags: BoolArray, usable: BoolArray) -> list[IntArray]:
    """Return the curves between true and false nodes of a grid, (A,) or (A, B), without the nodes that are not usable.

    A curve is the edges it crosses, (E, 2) node numbers in order; a closed one ends with the edge it starts with.
    """
    if flags.ndim == 1:
        change = (flags[1:] != flags[:-1]) & usable[1:] & usable[:-1]
        return [np.array([[k, k + 1]]) for k in np.flatnonzero(change)]
    z = np.ma.array(flags.astype(np.float64), mask=~usable)
    curves = []
    for line in contour_generator(z=z, corner_mask=True).lines(0.5):
        place = np.asarray(line)[:, ::-1]  # contourpy gives (column, row)
        # beside a masked corner a curve ends on the diagonal of a cell, between two half numbers: no edge of the grid
        on_edge = (place == np.round(place)).any(axis=1)
        ends = [np.ravel_multi_index(tuple(side(place).astype(np.intp).T), flags.shape) for side in (np.floor, np.ceil)]
        curves += _pieces(np.stack(ends, axis=1), on_edge)
    return curves


def _pieces(values: NDArray[np.intp], keep: BoolArray) -> list[IntArray]:
    """Return the runs of values that are kept."""
    bounds = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(np.intp), [0]])))
    return [values[start:stop] for start, stop in zip(bounds[::2], bounds[1::2], strict=True)]


def _border(
    system: ConstraintSystem, grid: WorkspaceGrid, tracer: Tracer | None
) -> tuple[tuple[LocusCurve, ...], int, Array]:
    """Return the type I curves, the border of the reachable nodes, and the edges without an exact one.

    These are the number of those where a curve is cut, and where those begin (E, n) that belong to none, as round a
    single node that was not reached. An edge that meets the border in a corner, where K lacks two, has that.
    """
    shaped = grid.reachable.reshape(grid.shape)
    curves = crossed_edges(shaped, np.ones_like(shaped))
    edges = np.concatenate([np.zeros((0, 2), dtype=np.intp), *curves])
    edges = np.where(grid.reachable[edges[:, :1]], edges, edges[:, ::-1])
    start, end = grid.x[edges[:, 0]], grid.x[edges[:, 1]]
    near = _bisected(system, grid.q[edges[:, 0]], start, end)
    points = _refined(system, serial_matrix, near, start, end, _free_column(grid, edges))
    for k in np.flatnonzero(~points.exact).tolist():
        corner = _corner(system, tracer, near[k : k + 1])
        if corner is not None and np.linalg.norm(corner[0] - start[k]) < _cell(grid):
            for part, value in zip(points, corner, strict=False):
                part[k : k + 1] = value
            points.exact[k] = True
    chains, missing = _curves(system, SingularityKind.TYPE_I, points, curves)
    contour = np.repeat(np.arange(len(curves)), [len(curve) for curve in curves])
    cuts = np.isin(contour[missing], np.delete(contour, missing))
    return chains, int(cuts.sum()), grid.x[edges[missing[~cuts], 0]]


def _with_corners(system: ConstraintSystem, tracer: Tracer, grid: WorkspaceGrid, curve: LocusCurve) -> LocusCurve:
    """Return a type I curve with the corners between its points where another leg is at its end from there on."""
    free = np.linalg.svd(serial_matrix(system, system.evaluate(curve.q)))[2][:, -1]
    points, parts = curve.points, [curve.points, curve.q, curve.residual]
    for k in np.flatnonzero(np.abs((free[1:] * free[:-1]).sum(axis=1)) < _OTHER_LEG)[::-1].tolist():
        corner = _corner(system, tracer, curve.q[k : k + 1]) or _corner(system, tracer, curve.q[k + 1 : k + 2])
        if corner and np.linalg.norm(corner[0] - points[k : k + 2], axis=1).max() < _CORNER_AWAY * _cell(grid):
            parts = [np.insert(part, k + 1, value, axis=0) for part, value in zip(parts, corner, strict=True)]
    return LocusCurve(curve.kind, *(read_only(part) for part in parts))


def _corner(system: ConstraintSystem, tracer: Tracer | None, q: Array) -> tuple[Array, Array, Array] | None:
    """Return x (1, n), q (1, nq) and singular value (1,) left of the corner of type I curves near q (1, nq), if any."""
    corner = None if tracer is None else tracer.corner(q)
    if corner is None:
        return None
    state = system.evaluate(corner)
    left = np.asarray(np.linalg.svd(serial_matrix(system, state), compute_uv=False)[:, -1], dtype=np.float64)
    exact = system.gap(state.phi)[0] < closure_tolerance(system.robot) and left[0] < SINGULAR
    return (coordinates(system.robot, state), corner, left) if exact else None


def _cell(grid: WorkspaceGrid) -> float:
    """Return the diagonal of a cell of the grid, m."""
    return float(np.sqrt(sum((axis[1] - axis[0]) ** 2 for axis in grid.axes)))


def _zero_margin(system: ConstraintSystem, grid: WorkspaceGrid, margin: Array) -> tuple[tuple[LocusCurve, ...], Array]:
    """Return the type II curves, the zeros of the signed margin, and where edges without an exact one begin (E, n)."""
    # rounding must not decide the sign of nodes that lie on the curve
    positive = margin > -_ON_CURVE
    curves = crossed_edges(positive.reshape(grid.shape), grid.reachable.reshape(grid.shape))
    edges = np.concatenate([np.zeros((0, 2), dtype=np.intp), *curves])
    start, end = grid.x[edges[:, 0]], grid.x[edges[:, 1]]
    left, right = margin[edges[:, 0]], margin[edges[:, 1]]
    fraction = np.clip(left / (left - right), 0.0, 1.0)
    nearer = np.where(fraction < 0.5, edges[:, 0], edges[:, 1])
    solution = assemble(system, grid.q[nearer], start + fraction[:, None] * (end - start))
    near = np.where(solution.closed[:, None], solution.q, grid.q[nearer])
    points = _refined(system, locked_matrix, near, start, end, _free_column(grid, edges))
    chains, missing = _curves(system, SingularityKind.TYPE_II, points, curves)
    return chains, grid.x[edges[missing, 0]]


def _followed(
    system: ConstraintSystem, tracer: Tracer, inner: tuple[LocusCurve, ...], border: tuple[LocusCurve, ...]
) -> tuple[LocusCurve, ...]:
    """Return the type II curves to their ends, also those that begin on the border between nodes."""
    curves = []
    for q in tracer.joined([each.q for each in inner], [each.q for each in border]):
        state = system.evaluate(q)
        sigma = np.linalg.svd(locked_matrix(system, state), compute_uv=False)[:, -1]
        serial = np.linalg.svd(serial_matrix(system, state), compute_uv=False)[:, -1]
        kind = SingularityKind.COMBINED if (serial < SINGULAR).all() else SingularityKind.TYPE_II
        parts = (coordinates(system.robot, state), q, sigma)
        curves.append(LocusCurve(kind, *(frozen(part) for part in parts)))
    return tuple(curves)


def _not_beside(x: Array, curves: tuple[LocusCurve, ...], grid: WorkspaceGrid) -> Array:
    """Return those of the nodes (E, n) that are no cell away from a curve."""
    cell = _cell(grid)
    points = np.concatenate([np.full((1, x.shape[1]), np.inf), *(curve.points for curve in curves)])
    return x[[bool((np.linalg.norm(points - one, axis=1) > cell).all()) for one in x]]


def _free_column(grid: WorkspaceGrid, edges: IntArray) -> IntArray:
    """Return (E,) the column of x in which the ends of each edge differ."""
    columns: IntArray = np.abs(grid.x[edges[:, 1]] - grid.x[edges[:, 0]]).argmax(axis=1)
    return columns


def _curves(
    system: ConstraintSystem, kind: SingularityKind, points: _Refined, curves: list[IntArray]
) -> tuple[tuple[LocusCurve, ...], IntArray]:
    """Return the curves through the exact points, cut where one is missing, and the edges without one."""
    both = [matrix(system, system.evaluate(points.q)) for matrix in (serial_matrix, locked_matrix)]
    combined = np.all([np.linalg.svd(one, compute_uv=False)[:, -1] < SINGULAR for one in both], axis=0)
    stops = np.cumsum([0, *(len(curve) for curve in curves)])
    chains = [
        piece for first, stop in pairwise(stops) for piece in _pieces(np.arange(first, stop), points.exact[first:stop])
    ]
    return tuple(
        LocusCurve(
            SingularityKind.COMBINED if combined[chain].all() else kind,
            *(read_only(part[chain]) for part in (points.x, points.q, points.residual)),
        )
        for chain in chains
    ), np.flatnonzero(~points.exact)


class _Refined(NamedTuple):
    """Of each edge x (n,), q (nq,), the singular value left; exact: closed, singular, in the mode and on the edge."""

    x: Array
    q: Array
    residual: Array
    exact: BoolArray


def _refined(
    system: ConstraintSystem, matrix: MatrixOf, guess: Array, start: Array, end: Array, free: IntArray
) -> _Refined:
    """Find the singular configuration on each edge by Newton, from guesses (E, nq) near it.

    The edges run from ``start`` to ``end`` (E, n) and differ in the columns ``free``; ``matrix`` is ``serial_matrix``
    for type I, ``locked_matrix`` for type II.
    """
    robot, p = system.robot, system.pose_columns
    everyone = np.arange(len(guess))
    fixed = np.arange(robot.n)[None, :] != free[:, None]
    others = np.broadcast_to(np.arange(robot.n), fixed.shape)[fixed].reshape(len(guess), robot.n - 1)
    q, closures = guess.copy(), np.broadcast_to(system.closure_unit, (len(guess), len(system.rows)))
    unit = np.concatenate([closures, coordinate_unit(robot)[others], np.ones((len(guess), 1))], axis=1)
    for _ in range(_ITERATIONS):
        state = system.evaluate(q)
        sigma, gradient = singular_value(system, matrix, state)
        miss = difference(robot, start, coordinates(robot, state))[everyone[:, None], others]
        platform_rows = state.Jx[:, :, p][everyone[:, None], others]
        rows = np.concatenate([state.Jc[:, :, p], platform_rows, gradient[:, None]], axis=1)
        rhs = np.concatenate([-state.phi, miss, -sigma[:, None]], axis=1) / unit
        # minimum norm: where two branches of a singular curve meet the equations depend on each other
        step = (np.linalg.pinv(rows * system.step_unit / unit[:, :, None], rcond=1e-12) @ rhs[:, :, None])[:, :, 0]
        size = np.abs(step).max(axis=1, keepdims=True)
        full = np.zeros((len(q), robot.model.nv))
        step *= np.minimum(1.0, _LONGEST_NEWTON_STEP / np.maximum(size, _LONGEST_NEWTON_STEP))
        full[:, p] = step * system.step_unit
        q = integrate(robot.model, q, full)
        if size.max(initial=0.0) < 1e-14:
            break
    state = system.evaluate(q)
    x = coordinates(robot, state)
    sigma = np.asarray(np.linalg.svd(matrix(system, state), compute_uv=False)[:, -1], dtype=np.float64)
    away = difference(robot, x, start)
    fraction = away[everyone, free] / difference(robot, end, start)[everyone, free]
    closed = system.gap(np.concatenate([state.phi, np.where(fixed, away, 0.0)], axis=1)) < closure_tolerance(robot)
    on_edge = (fraction > -_EDGE_ROUNDING) & (fraction < 1.0 + _EDGE_ROUNDING)
    in_mode = (mode_indicator(robot, q) * np.array(robot.working_mode) > -MODE_ROUNDING).all(axis=1)
    return _Refined(x, q, sigma, closed & (sigma < SINGULAR) & on_edge & in_mode)


def _bisected(system: ConstraintSystem, q: Array, start: Array, end: Array) -> Array:
    """Return (E, nq) configurations near the border, by bisection along edges from q (E, nq) at ``start`` (E, n)."""
    low, high = np.zeros(len(q)), np.ones(len(q))
    best = q.copy()
    for _ in range(_BORDER_BISECTIONS):
        middle = 0.5 * (low + high)
        target = start + middle[:, None] * (end - start)
        # every other target is out of reach: the next bisection is cheaper than a patient Newton
        solution = assemble(system, best, target, max_iterations=10, shortest_step=2.0**-3)
        usable = solution.closed & solution.in_mode
        best[usable] = solution.q[usable]
        low, high = np.where(usable, middle, low), np.where(usable, high, middle)
    return best
