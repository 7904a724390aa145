"""The singular locus over the workspace: curves of type I and type II singularities in one working mode.

A grid of platform positions is solved on one branch. Type II curves run where the signed margin changes sign between
neighbouring nodes, type I curves where reachable nodes meet unreachable ones (the working mode ends there). Every point
that is returned is refined to an exact singular configuration on its grid edge; curves join them.

Marching squares: where a yes/no function on a grid changes, and how the places of change join into curves.

An edge joins two neighbouring nodes; it is given by its two node numbers. Only the topology is computed here: where on
its edge a change lies is for root finding to say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import Array, BoolArray, IntArray, frozen, read_only
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.kinematics.lift import find_on_branch
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.classify import SingularityKind, locked_matrix, serial_matrix
from redundancy_pin.singularities.followed_path import margins_of
from redundancy_pin.singularities.workspace import (
    SINGULAR,
    RefinedPoints,
    WorkspaceGrid,
    approach_border,
    bisect_margin,
    refine,
    solve_grid,
)

_REACH = 4.0
"""Half width of the search for the workspace, in characteristic lengths."""

_COARSE = 61
_BORDER = 0.03
"""Room left around the workspace, as a fraction of its size."""


@dataclass(frozen=True, eq=False)
class Slice:
    """Where a locus is drawn.

    Attributes:
        names: names of the coordinates that vary.
        units: of each, "m" or "rad".
        free: their columns in x.
        fixed: by name, the values of the coordinates that are held, rad.
        x: (n,) a point of the slice: the reference position, turned to the orientation of the slice.
        q: (nq,) the configuration there.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    free: tuple[int, ...]
    fixed: dict[str, float]
    x: Array
    q: Array


def slice_of(system: ConstraintSystem, orientation: float | None) -> Slice:
    """Return the slice of a robot through its reference position.

    Raises:
        UnsupportedRobotError: not planar.
        InputError: an orientation for a robot that has none, or one that is not finite.
        UnreachablePoseError, WorkingModeError: the reference position cannot be reached at this orientation.
    """
    robot = system.robot
    names, free = _free(robot)
    unit = "rad" if _turns(robot) else "m"
    held = tuple(column for column in range(robot.n) if column not in free)
    reference = np.array(robot.q_reference)
    x = np.array(coordinates(robot, system.evaluate(reference[None]))[0])
    if orientation is not None:
        if not held or not np.isfinite(orientation):
            raise InputError(
                f"orientation is {orientation}, and the coordinates of {robot.name} are {', '.join(_names(robot))}.",
                remedy="Leave it out for a robot without orientation; pass a finite angle in rad otherwise.",
            )
        x[held[0]] = orientation
        reference = find_on_branch(system, x)
    return Slice(
        names, (unit,) * len(free), free, {_names(robot)[column]: float(x[column]) for column in held}, x, reference
    )


def default_axes(system: ConstraintSystem, place: Slice, resolution: int) -> tuple[Array, ...]:
    """Return the grid that covers the workspace around a slice's start.

    A coarse grid finds how far the workspace goes; where it is not at an end after ``_REACH`` characteristic
    lengths it is cut there. A joint that turns is taken once round.
    """
    robot = system.robot
    if robot.platform is None:
        half = np.pi if _turns(robot) else _REACH * robot.characteristic_length
        return (np.linspace(place.x[0] - half, place.x[0] + half, resolution),)
    half = _REACH * robot.characteristic_length
    rough = tuple(np.linspace(place.x[c] - half, place.x[c] + half, _COARSE) for c in place.free)
    grid = solve_grid(system, place.free, rough, place.x, place.q)
    axes = []
    for column, axis in zip(place.free, rough, strict=True):
        reached = grid.x[grid.reachable, column]
        cell = axis[1] - axis[0]
        low, high = float(reached.min()) - cell, float(reached.max()) + cell
        room = _BORDER * (high - low)
        axes.append(np.linspace(max(low - room, axis[0]), min(high + room, axis[-1]), resolution))
    return tuple(axes)


def _turns(robot: Robot) -> bool:
    """Whether the first free coordinate is the angle of a joint."""
    if robot.platform is not None:
        return False
    joint = robot.model.joints[robot.model.getJointId(robot.independent_joints[0])]
    return not str(joint.shortname()).startswith("JointModelP")


def _names(robot: Robot) -> tuple[str, ...]:
    return robot.platform.axes if robot.platform else robot.independent_joints


def _free(robot: Robot) -> tuple[tuple[str, ...], tuple[int, ...]]:
    names = _names(robot)
    if robot.platform is None and robot.n == 1:
        return names, (0,)
    free = tuple(k for k, name in enumerate(names) if not name.startswith("r"))
    if robot.platform is None or len(free) != 2 or len(names) - len(free) > 1:
        raise UnsupportedRobotError(
            f"The singular locus of {robot.name} cannot be drawn: its coordinates are {', '.join(names)}.",
            remedy="A locus is for two translations with at most one rotation, or a single joint; of other robots "
            "look at the singular instants of a motion, with find_crossings.",
        )
    return tuple(names[k] for k in free), free


@dataclass(frozen=True, eq=False)
class Contour:
    """Edges over which a function changes, and the chains they form.

    Attributes:
        edges: (E, 2) node numbers of each edge.
        chains: edge numbers of each curve, in order along it; a closed curve ends with the edge it starts with.
    """

    edges: IntArray
    chains: tuple[IntArray, ...]


def contour(flags: BoolArray, usable: BoolArray) -> Contour:
    """Return the edges between true and false nodes and the curves through them.

    Args:
        flags: (A,) or (A, B) the function at the nodes.
        usable: same shape; edges with a node that is not usable are left out.
    """
    numbers = np.arange(flags.size).reshape(flags.shape)
    found = []
    for axis in range(flags.ndim):
        one, other = (np.take(numbers, range(s, flags.shape[axis] - 1 + s), axis=axis).ravel() for s in (0, 1))
        change = (flags.flat[one] != flags.flat[other]) & usable.flat[one] & usable.flat[other]
        found.append(np.stack([one[change], other[change]], axis=1))
    edges = np.concatenate(found)
    if flags.ndim == 1:
        return Contour(edges, tuple(np.array([k]) for k in range(len(edges))))
    return Contour(edges, _chains(edges, _links(edges, flags.shape, numbers), len(edges)))


def split(contour: Contour, keep: BoolArray) -> tuple[IntArray, ...]:
    """Return the chains without the edges that are not kept, cut where one is missing."""
    pieces: list[IntArray] = []
    for chain in contour.chains:
        good = keep[chain]
        bounds = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.intp), [0]])))
        pieces += [chain[start:stop] for start, stop in zip(bounds[::2], bounds[1::2], strict=True)]
    return tuple(pieces)


def _links(edges: IntArray, shape: tuple[int, ...], numbers: IntArray) -> IntArray:
    """Return (L, 2) pairs of edges that a curve joins inside a cell."""
    key = {(int(a), int(b)): k for k, (a, b) in enumerate(edges)}
    corners = _touched_cells(edges, shape)
    pairs = []
    for i, j in corners:
        ring = [numbers[i, j], numbers[i + 1, j], numbers[i + 1, j + 1], numbers[i, j + 1]]
        sides = [(ring[0], ring[1]), (ring[1], ring[2]), (ring[3], ring[2]), (ring[0], ring[3])]
        here = [key[side] for side in ((int(a), int(b)) for a, b in sides) if side in key]
        if len(here) == 4:
            # a saddle: cut off the corners 0 and 2 (the other choice is as good)
            pairs += [(here[0], here[3]), (here[1], here[2])]
        elif len(here) == 2:
            pairs.append((here[0], here[1]))
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def _touched_cells(edges: IntArray, shape: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the lower corners of the cells on either side of the edges."""
    row, column = np.unravel_index(edges[:, 0], shape)
    along_rows = edges[:, 1] - edges[:, 0] == shape[1]  # the edge goes to the next row
    cells = {(int(i), int(j)) for i, j in zip(row, column, strict=True)}
    cells |= {(int(i), int(j) - 1) for i, j in zip(row[along_rows], column[along_rows], strict=True)}
    cells |= {(int(i) - 1, int(j)) for i, j in zip(row[~along_rows], column[~along_rows], strict=True)}
    return sorted((i, j) for i, j in cells if 0 <= i < shape[0] - 1 and 0 <= j < shape[1] - 1)


def _chains(edges: IntArray, links: IntArray, count: int) -> tuple[IntArray, ...]:
    """Join pairs of edges into chains: open ones first from their ends, then the closed ones."""
    neighbours: list[list[int]] = [[] for _ in range(count)]
    for a, b in links.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    seen = np.zeros(count, dtype=bool)
    chains: list[IntArray] = []
    ends = [k for k in range(count) if len(neighbours[k]) < 2]
    for start in ends + list(range(count)):
        if seen[start]:
            continue
        chain, at = [start], start
        seen[start] = True
        while True:
            onward = [k for k in neighbours[at] if not seen[k]]
            if not onward:
                break
            at = onward[0]
            seen[at] = True
            chain.append(at)
        if len(chain) > 2 and start in neighbours[at]:
            chain.append(start)
        chains.append(np.array(chain, dtype=np.intp))
    return tuple(chains)


def edge_points(nodes: Array, edges: IntArray, fraction: Array) -> Array:
    """Return (E, n) the points that divide edges between nodes (G, n) at fractions (E,)."""
    start, end = nodes[edges[:, 0]], nodes[edges[:, 1]]
    result: Array = start + fraction[:, None] * (end - start)
    return result


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
