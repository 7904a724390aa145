"""Configurations over a grid of platform coordinates, on one solution branch: the basis of loci and workspaces.

The grid is flooded from one closed configuration: every solved node is the initial guess of its neighbours.
Closing uses the method of ``assemble``, which solves all nodes of a wave at once, and the acceptance test of the
follower (``LoopSolver.is_continuous``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import label

from redundancy_pin.arrays import RANK_TOLERANCE, Array, BoolArray, IntArray, blocks, checked, frozen, read_only, whole
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, evaluated
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, moved
from redundancy_pin.kinematics.inverse_kinematics import point_on_branch
from redundancy_pin.kinematics.multistart import draw_starts
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.joint_ranges import out_of_range
from redundancy_pin.robot.scales import coordinate_unit, is_revolute
from redundancy_pin.singularities.classify import Margins, margins_of

_MOST_NODES = 200_000
"""Nodes of a grid at most: about a minute."""

_REACH = 4.0
"""Half width of the search for the workspace, characteristic lengths; doubled if the workspace extends beyond it."""

_COARSE = {1: 61, 2: 61, 3: 15}
"""Nodes along each axis of the search grid, by the number of axes: horns of a twentieth of the workspace are met."""

_BORDER = 0.03
"""Space left around the workspace, as a fraction of its size."""

_SHORTEST_STEP = 2.0**-3
"""Fraction of a Newton step below which a node is left to a nearer neighbour: most nodes that need less are out of
reach, and without this bound maps take two to five times as long."""

_TRUSTED_STEP = 0.1
"""Longest step, characteristic lengths or rad, at which continuity alone determines the branch. Without this bound one
node in eleven of a delta is on another branch; with it, or with 0.15, none."""

_STARTS = 360
"""Random configurations from which islands are searched, with a fixed seed. They meet all islands of fifteen random
five-bars whose workspace is in two parts."""


@dataclass(frozen=True, eq=False)
class Slice:
    """The part of a workspace that a grid covers: some coordinates vary, the others are fixed.

    Attributes:
        system: closures and platform rows of the robot, in the working mode of the slice.
        names: names of the coordinates that vary.
        units: of each, "m" or "rad".
        free: columns of x that vary; of a pose the rows of its translation.
        x: (n,) coordinates or a pose (4, 4) of the start, base frame, m and rad.
        q: (nq,) the configuration there.
    """

    system: ConstraintSystem
    names: tuple[str, ...]
    units: tuple[str, ...]
    free: tuple[int, ...]
    x: Array
    q: Array

    def positions(self, x: Array) -> Array:
        """Return (N, f) the free coordinates of (N, n) coordinates, or translations of (N, 4, 4) poses."""
        return x[:, list(self.free), 3] if x.ndim == 3 else x[:, list(self.free)]


@dataclass(frozen=True, eq=False)
class WorkspaceGrid:
    """Configurations over a rectangular grid of one to three platform coordinates, the others fixed.

    Attributes:
        place: the slice that it covers.
        axes: the grid's coordinates along each of them, increasing, m or rad.
        x: (G, n) platform coordinates of all nodes, the last axis running fastest.
        q: (G, nq) configurations, NaN where not reachable.
        part: (G,) 0 for nodes connected to the start; 1, 2, ... for islands, which are not connected to it within the
            slice; −1 for nodes without a closed configuration in the working mode.
    """

    place: Slice
    axes: tuple[Array, ...]
    x: Array
    q: Array
    part: IntArray

    @property
    def reachable(self) -> BoolArray:
        """(G,) whether a closed configuration in the working mode was found."""
        return read_only(self.part >= 0)

    @cached_property
    def in_range(self) -> BoolArray:
        """(G,) reachable with all joints within their ranges."""
        return read_only(self.reachable & ~out_of_range(self.place.system.robot, self.q, motion=False))

    @cached_property
    def margins(self) -> Margins:
        """Singularity margins (G,), NaN where not reachable."""
        system, values = self.place.system, np.full((2, len(self.q)), np.nan)
        reached = np.flatnonzero(self.reachable)
        for part in blocks(len(reached)):
            values[:, reached[part]] = margins_of(system, system.evaluate(self.q[reached[part]]))
        return Margins(*values)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of nodes along each axis."""
        return tuple(len(axis) for axis in self.axes)


def slice_through(robot: Robot, names: tuple[str, ...], x: Array | None = None) -> Slice:
    """Return the slice through a position; through the reference configuration when left out.

    Args:
        robot: the robot.
        names: the coordinates that vary, translations of the platform or independent joints.
        x: (n,) coordinates or a pose (4, 4), base frame, m and rad.

    Raises:
        UnreachablePoseError, SingularPoseError, WorkingModeError: the robot cannot be there.
    """
    known = robot.platform.axes if robot.platform else robot.independent_joints
    columns = tuple("xyz".index(name) if is_pose(robot) else known.index(name) for name in names)
    turning = [robot.platform is None and is_revolute(robot, name) for name in names]
    system, q = ConstraintSystem(robot), np.array(robot.q_reference)
    if x is None:
        x = follower(robot).home.x
    else:
        q = point_on_branch(system, x).q
    return Slice(system, names, tuple("rad" if turns else "m" for turns in turning), columns, frozen(x), frozen(q))


def require_resolution(resolution: int, axes: int) -> int:
    """Return the number of nodes along each of some axes after checking that there are neither too few nor too many.

    Raises:
        InputError: not a whole number from 3 to what ``_MOST_NODES`` allows.
    """
    return whole(resolution, "resolution", 3, int(_MOST_NODES ** (1.0 / axes)))


def bounded_axes(robot: Robot, names: tuple[str, ...], bounds: ArrayLike, resolution: int) -> tuple[Array, ...]:
    """Return the axes of a grid between bounds (f, 2), m and rad.

    Raises:
        InputError: not one increasing pair per coordinate, or bounds so far away that the robot is rounding there.
    """
    ends, farthest = checked(bounds, "bounds", (len(names), 2)), robot.characteristic_length / RANK_TOLERANCE
    if not ((ends[:, 0] < ends[:, 1]).all() and np.abs(ends).max() < farthest):
        raise InputError(
            f"bounds are {bounds!r}; the grid runs over {', '.join(names)}.",
            remedy=f"Pass one (lower, upper) pair for each of them, within ±{farthest:g}.",
        )
    return axes_between(ends, resolution)


def axes_between(ends: Array, resolution: int) -> tuple[Array, ...]:
    """Return axes with evenly spaced nodes between ends (f, 2)."""
    return tuple(np.linspace(low, high, resolution) for low, high in ends.tolist())


def default_axes(place: Slice, resolution: int, *, within_ranges: bool = False) -> tuple[Array, ...]:
    """Return the axes of a grid that covers the workspace around the start of a slice.

    A coarse grid over four characteristic lengths to each side finds how far the workspace extends; over eight, if it
    extends beyond four and ends within eight. A joint that turns is taken once round.

    Args:
        place: the slice.
        resolution: nodes along each axis.
        within_ranges: cover only nodes with all joints within their ranges, islands included.
    """
    robot, middle = place.system.robot, place.positions(place.x[None])[0][:, None]
    half, sides = _REACH * robot.characteristic_length, np.array([-1.0, 1.0])
    if robot.platform is None:
        return axes_between(middle + np.where(np.array(place.units) == "rad", np.pi, half)[:, None] * sides, resolution)
    coarse = _COARSE[len(place.free)]

    def extent(ends: Array) -> tuple[Array, bool]:
        """Return (f, 2) the range of reached nodes within ``ends`` (f, 2), a cell wider; whether it ends there."""
        grid = solve_grid(place, axes_between(ends, coarse), islands=within_ranges)
        counted = grid.in_range if within_ranges and grid.in_range.any() else grid.reachable
        reached, cell = place.positions(grid.x[counted]), np.ptp(ends, axis=1, keepdims=True) / (coarse - 1)
        limits = np.stack([reached.min(axis=0), reached.max(axis=0)], axis=1)
        return limits + cell * sides, bool((np.abs(limits - ends) > 0.5 * cell).all())

    outer = middle + half * sides
    found, ends_inside = extent(outer)
    if not ends_inside:
        wider, ends_inside = extent(middle + 2.0 * half * sides)
        outer, found = (middle + 2.0 * half * sides, wider) if ends_inside else (outer, found)
    if within_ranges and len(place.free) == 2:
        # a horn that is narrower than a cell extends beyond the last node in it
        cell = np.ptp(outer, axis=1, keepdims=True) / (coarse - 1)
        closer, _ = extent(_clip(found + 2.0 * cell * sides, outer))
        found = np.stack([np.minimum(found, closer)[:, 0], np.maximum(found, closer)[:, 1]], axis=1)
    return axes_between(_clip(found + _BORDER * np.ptp(found, axis=1, keepdims=True) * sides, outer), resolution)


def describe(names: tuple[str, ...], units: tuple[str, ...], axes: tuple[Array, ...]) -> str:
    """Return one line about a grid: the range of each coordinate and the number of nodes."""
    free = zip(names, axes, units, strict=True)
    ranges = [f"{name}={axis[0]:.4g}..{axis[-1]:.4g} {unit}" for name, axis, unit in free]
    return f"{', '.join(ranges)}; {' x '.join(str(len(axis)) for axis in axes)} nodes"


def _clip(ends: Array, outer: Array) -> Array:
    """Return ends (f, 2) clipped to another range (f, 2)."""
    clipped: Array = np.clip(ends, outer[:, :1], outer[:, 1:])
    return clipped


def solve_grid(place: Slice, axes: tuple[Array, ...], *, islands: bool = False) -> WorkspaceGrid:
    """Return the configurations over a grid, flooded from the start of a slice.

    Only the part of the workspace that is connected to the start within the slice is found, by sides or corners of
    cells; with ``islands`` also parts that random starts meet.
    """
    mesh = np.meshgrid(*axes, indexing="ij")
    nodes = np.repeat(place.x[None], mesh[0].size, axis=0)
    for column, values in zip(place.free, mesh, strict=True):
        nodes[(slice(None), column, 3) if nodes.ndim == 3 else (slice(None), column)] = values.ravel()
    flood = _Flood(place, nodes, mesh[0].shape)
    if islands:
        flood.find_islands(axes)
    grid_axes = tuple(read_only(np.array(axis)) for axis in axes)
    return WorkspaceGrid(place, grid_axes, read_only(nodes), read_only(flood.q), read_only(flood.parts()))


class _Flood:
    """The nodes solved so far; at first those that are connected to the start of the slice."""

    def __init__(self, place: Slice, nodes: Array, shape: tuple[int, ...]) -> None:
        self.place, self.system, self.robot = place, place.system, place.system.robot
        self._own, self.nodes, self.shape = follower(self.robot), nodes, shape
        self.q = np.full((len(nodes), self.robot.model.nq), np.nan)
        self.gamma = np.zeros((len(nodes), self.robot.model.nv, self.robot.n))
        self.solved = np.zeros(len(nodes), dtype=bool)
        x, q = place.x[None], place.q[None]
        away = np.abs(difference(self.robot, nodes, np.repeat(x, len(nodes), axis=0))).max(axis=1)
        nearest = np.argsort(away, kind="stable")[: 4 ** len(shape)]
        gamma = evaluated(self.system, q).gamma
        self._spread(self._step(nearest, *(part.repeat(len(nearest), axis=0) for part in (x, q, gamma))))
        self.start = int(nearest[self.solved[nearest].argmax()])

    def _spread(self, front: IntArray) -> None:
        """Solve the neighbours of solved nodes, at sides and corners, outward in waves until no new node closes."""
        steps = [step for step in product((-1, 0, 1), repeat=len(self.shape)) if any(step)]
        sides_first = np.array(sorted(steps, key=lambda step: sum(map(abs, step)))).T[:, :, None]
        limits = np.array(self.shape)[:, None, None]
        while len(front):
            around = np.stack(np.unravel_index(front, self.shape))[:, None, :] + sides_first
            inside = ((around >= 0) & (around < limits)).all(axis=0)
            targets = np.ravel_multi_index(tuple(around[:, inside]), self.shape)
            targets, first = np.unique(targets, return_index=True)
            unsolved = ~self.solved[targets]
            sources = np.broadcast_to(front, inside.shape)[inside][first][unsolved]
            front = self._step(targets[unsolved], self.nodes[sources], self.q[sources], self.gamma[sources])

    def _step(self, targets: IntArray, x: Array, q: Array, gamma: Array) -> IntArray:
        """Solve nodes from states nearby, and return those that are on the branch of their state.

        The first step of Newton's method is the prediction by Γ. A working mode determines the branch; otherwise only
        continuity does, in steps short enough along the straight line to the node.
        """
        has_modes, goals = self.robot.working_modes is not None, self.nodes[targets]
        whole = difference(self.robot, goals, x)
        longest = float(np.linalg.norm(whole / coordinate_unit(self.robot), axis=1).max(initial=0.0))
        count = 1 if has_modes else max(math.ceil(longest / _TRUSTED_STEP), 1)
        for k in range(1, count + 1):
            part = goals if k == count else moved(self.robot, x, whole * (k / count))
            solution = assemble(self.system, q, part, shortest_step=_SHORTEST_STEP)
            if has_modes:
                good = solution.usable
            else:
                change = configuration_difference(self.robot.model, q, solution.q)
                steps = zip(change, gamma, solution.gamma, whole / count, strict=True)
                good = solution.regular & np.array([self._own.is_continuous(*step) for step in steps], dtype=bool)
            q, gamma = solution.q[good], solution.gamma[good]
            targets, goals, x, whole = targets[good], goals[good], x[good], whole[good]
        self.q[targets], self.gamma[targets], self.solved[targets] = q, gamma, True
        return targets

    def find_islands(self, axes: tuple[Array, ...]) -> None:
        """Search parts that are not connected to the start: from random configurations, closed at a node nearby.

        A random configuration is closed by itself first: it meets a small island more often than a node of the grid
        does. Without working modes a part that touches another is another branch of it. The larger one stays: a
        configuration near a stretched leg may lead to a node or two of the other branch, and no further.
        """
        guess = draw_starts(self.system, self.place.q, _STARTS, np.random.default_rng(0))
        closed = assemble(self.system, guess)
        origin, second = np.array([axis[:2] for axis in axes]).T
        near = (self.place.positions(coordinates(self.robot, closed.state)) - origin) / (second - origin)
        near = np.rint(near).astype(int)
        usable = closed.closed & ((near >= 0) & (near < self.shape)).all(axis=1)
        targets = np.ravel_multi_index(tuple(near[usable].T), self.shape)
        unsolved = ~self.solved[targets]
        targets, guess = targets[unsolved], closed.q[usable][unsolved]
        found = assemble(self.system, guess, self.nodes[targets], shortest_step=_SHORTEST_STEP)
        kept = self.solved.copy()
        for k in np.flatnonzero(found.usable):
            node = targets[k]
            if self.solved[node]:
                continue
            before = self.solved.copy()
            self.q[node], self.gamma[node], self.solved[node] = found.q[k], found.gamma[k], True
            self._spread(targets[k : k + 1])
            new = self.solved & ~before
            if self.robot.working_modes is None:
                numbers = self._numbered(kept | new)
                touched = kept & (numbers == numbers[node])
                if touched[self.start] or new.sum() <= touched.sum():
                    continue
                kept &= ~touched
            kept |= new
        self.solved = kept
        self.q[~kept] = np.nan

    def _numbered(self, flags: BoolArray) -> IntArray:
        """Return (G,) the number, from 1, of the connected set that each node belongs to; 0 for none."""
        corners_too: Array = np.ones((3,) * len(self.shape))
        numbers: IntArray = label(flags.reshape(self.shape), corners_too)[0].ravel()
        return numbers

    def parts(self) -> IntArray:
        """Return (G,) the part of each node, as in ``WorkspaceGrid``."""
        numbers = self._numbered(self.solved)
        own = numbers[self.start]
        result: IntArray = np.where(numbers > own, numbers - 1, numbers)
        result[numbers == own] = 0
        result[numbers == 0] = -1
        return result
