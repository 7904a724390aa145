"""The slice of the workspace in which a locus is drawn, and the configurations over a grid of it, on one branch."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, read_only
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, integrate, project
from redundancy_pin.kinematics.branch import follows
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference
from redundancy_pin.kinematics.inverse_kinematics import point_on_branch
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import out_of_range
from redundancy_pin.robot.scales import is_revolute, turning_velocities, velocity_unit

_REACH = 4.0
"""Half width of the search for the workspace, in characteristic lengths."""

_FARTHEST = 8.0
"""The same, where the workspace goes on beyond it."""

_COARSE, _COARSE_IN_SPACE = 61, 15
_BORDER = 0.03
"""Room left around the workspace, as a fraction of its size."""

_NEWTON = 10
_SHORTEST_STEP = 2.0**-3
"""Where Newton needs shorter steps than this the pose is left to a nearer neighbour."""

_LONGEST_STEP = 2.0
"""Largest change of q (rad, characteristic lengths) between neighbours: a leg near its base hinge turns by up to π/2,
a leg that Newton threw to another turn by more."""


_TRIED, _STARTS, _SEED = 60, 6, 20141
"""Nodes at which islands are looked for, random starts at each, and any fixed number."""

_SLIDE = 0.6
"""Change of a sliding joint at random starts, characteristic lengths."""


@dataclass(frozen=True, eq=False)
class Slice:
    """Where a locus is drawn.

    Attributes:
        names: names of the coordinates that vary.
        units: of each, "m" or "rad".
        free: their columns in x.
        fixed: by name, the values of the other coordinates, rad.
        x: (n,) a point of the slice: the reference position, turned to the orientation of the slice.
        q: (nq,) the configuration there.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    free: tuple[int, ...]
    fixed: dict[str, float]
    x: Array
    q: Array


@dataclass(frozen=True, eq=False)
class WorkspaceGrid:
    """Configurations over a rectangular grid of one or two platform coordinates, the others fixed.

    Attributes:
        axes: the grid's coordinates along each of them, increasing, m or rad.
        x: (G, n) platform coordinates of all nodes, the last axis running fastest.
        q: (G, nq) configurations, NaN where not reachable.
        part: (G,) 0 where the start reaches a closed configuration in the working mode, 1, 2, ... in parts that it does
            not reach without leaving the grid, −1 where none was found.
    """

    axes: tuple[Array, ...]
    x: Array
    q: Array
    part: IntArray

    @property
    def reachable(self) -> BoolArray:
        """(G,) whether a closed configuration in the working mode was found."""
        return read_only(self.part >= 0)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of nodes along each axis."""
        return tuple(len(axis) for axis in self.axes)


def slice_of(system: ConstraintSystem, orientation: float | None) -> Slice:
    """Return the slice of a robot through its reference position.

    Raises:
        UnsupportedRobotError: not planar.
        InputError: an orientation for a robot that has none, or one that is not finite.
        UnreachablePoseError, WorkingModeError: the reference position cannot be reached at this orientation.
    """
    robot = system.robot
    names = robot.platform.axes if robot.platform else robot.independent_joints
    free = _free(robot, names)
    fixed = [column for column in range(robot.n) if column not in free]
    q = np.array(robot.q_reference)
    x = np.array(coordinates(robot, system.evaluate(q[None]))[0])
    if orientation is not None:
        if not fixed or not np.isfinite(orientation):
            raise InputError(
                f"orientation is {orientation}, and the coordinates of {robot.name} are {', '.join(names)}.",
                remedy="Leave it out for a robot without orientation; pass a finite angle in rad otherwise.",
            )
        x[fixed[0]] = orientation
        q = point_on_branch(system, x).q
    units = ("rad" if _turns(robot) else "m",) * len(free)
    return Slice(tuple(names[k] for k in free), units, free, {names[k]: float(x[k]) for k in fixed}, x, q)


def default_axes(
    system: ConstraintSystem, place: Slice, resolution: int, *, within_ranges: bool = False
) -> tuple[Array, ...]:
    """Return the grid that covers the workspace around a slice's start, or its part within the ranges of all joints.

    A coarse grid finds how far the workspace goes, however far that is up to ``_FARTHEST`` characteristic lengths;
    where it is not at an end there it is cut after ``_REACH``. A joint that turns is taken once round. With
    ``within_ranges`` islands count as well.
    """
    robot, middle = system.robot, positions(place.x[None], place.free)[0]
    half = _REACH * robot.characteristic_length
    if robot.platform is None:
        far = [np.pi if unit == "rad" else half for unit in place.units]
        return tuple(np.linspace(at - each, at + each, resolution) for at, each in zip(middle, far, strict=True))
    coarse = _COARSE if len(place.free) < 3 else _COARSE_IN_SPACE

    def around(far: float) -> WorkspaceGrid:
        axes = tuple(np.linspace(at - far, at + far, coarse) for at in middle)
        return solve_grid(system, place, axes, islands=within_ranges)

    def wanted(grid: WorkspaceGrid) -> BoolArray:
        kept = grid.reachable & ~out_of_range(robot, grid.q, motion=False)
        return kept if within_ranges and kept.any() else grid.reachable

    grid = around(half)
    if _at_an_end(wanted(grid).reshape(grid.shape)):
        wider = around(half * _FARTHEST / _REACH)
        grid = grid if _at_an_end(wanted(wider).reshape(wider.shape)) else wider
    outer, grids = grid.axes, [grid]
    if within_ranges and len(outer) == 2:  # a horn that is narrower than a cell goes on beyond the last node in it
        closer = []
        for k, axis in enumerate(outer):
            reached, room = positions(grid.x[wanted(grid)], place.free)[:, k], 3.0 * (axis[1] - axis[0])
            ends = max(reached.min() - room, axis[0]), min(reached.max() + room, axis[-1])
            closer.append(np.linspace(*ends, coarse))
        grids.append(solve_grid(system, place, tuple(closer), islands=True))
    axes = []
    for k, axis in enumerate(outer):
        found = [(positions(one.x[wanted(one)], place.free)[:, k], one.axes[k][1] - one.axes[k][0]) for one in grids]
        low = min(float(reached.min() - cell) for reached, cell in found)
        high = max(float(reached.max() + cell) for reached, cell in found)
        room = _BORDER * (high - low)
        axes.append(np.linspace(max(low - room, axis[0]), min(high + room, axis[-1]), resolution))
    return tuple(axes)


def _at_an_end(nodes: BoolArray) -> bool:
    """Return whether nodes (A, B, …) of a grid lie at its border: the workspace may go on."""
    return any(nodes.take((0, -1), axis).any() for axis in range(nodes.ndim))


def positions(x: Array, free: tuple[int, ...]) -> Array:
    """Return (N, f) the free coordinates of (N, n) coordinates, or translations of (N, 4, 4) poses."""
    return x[:, list(free), 3] if x.ndim == 3 else x[:, list(free)]


def _turns(robot: Robot) -> bool:
    """Whether the only coordinate is the angle of a joint."""
    return robot.platform is None and is_revolute(robot, robot.independent_joints[0])


def _free(robot: Robot, names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the columns of x that vary."""
    if robot.platform is None and robot.n == 1:
        return (0,)
    free = tuple(k for k, name in enumerate(names) if not name.startswith("r"))
    if robot.platform is None or len(free) != 2 or len(names) - len(free) > 1:
        raise UnsupportedRobotError(
            f"The singular locus of {robot.name} cannot be drawn: its coordinates are {', '.join(names)}.",
            remedy="A locus is for two translations with at most one rotation, or a single joint; of other robots "
            "look at the singular instants of a motion, with find_crossings, or at margins, with rp.workspace.",
        )
    return free


def solve_grid(
    system: ConstraintSystem, place: Slice, axes: tuple[Array, ...], *, islands: bool = False
) -> WorkspaceGrid:
    """Flood a grid from one configuration: every solved node is where its neighbours start from.

    Only the part of the workspace that is connected to the start (in the slice of the grid) is found; with ``islands``
    also what hangs on by the corner of a cell, and parts that random starts meet. Where no working modes tell branches
    apart, a part that touches another one is another branch there, and left out.
    """
    mesh = np.meshgrid(*axes, indexing="ij")
    nodes = np.repeat(place.x[None], mesh[0].size, axis=0)
    for column, values in zip(place.free, mesh, strict=True):
        nodes[(slice(None), column, 3) if nodes.ndim == 3 else (slice(None), column)] = values.ravel()
    flood = _Flood(system, nodes, mesh[0].shape, across_corners=islands and len(axes) > 1)
    flood.run(place.x, place.q)
    if islands:
        flood.look_for_islands(place, axes)
    grid_axes = tuple(read_only(np.array(axis)) for axis in axes)
    return WorkspaceGrid(grid_axes, *(read_only(part) for part in (nodes, flood.q, flood.part)))


class _Flood:
    """State of the flooding; used up by one run."""

    def __init__(self, system: ConstraintSystem, nodes: Array, shape: tuple[int, ...], *, across_corners: bool) -> None:
        self.system = system
        self.across_corners = across_corners
        self.nodes = nodes
        self.shape = shape
        self.q = np.full((len(nodes), system.robot.model.nq), np.nan)
        self.gamma = np.zeros((len(nodes), system.robot.model.nv, system.robot.n))
        self.solved = np.zeros(len(nodes), dtype=bool)
        self.part = np.full(len(nodes), -1)

    def run(self, x: Array, q: Array) -> None:
        """Solve the nodes nearest to the start, then outward in waves until no new node closes."""
        gamma = project(self.system, self.system.evaluate(q[None])).gamma
        distance = np.abs(difference(self.system.robot, self.nodes, np.repeat(x[None], len(self.nodes), axis=0)))
        nearest = np.argsort(distance.max(axis=1), kind="stable")[: 4 ** len(self.shape)]
        count = len(nearest)
        self._spread(self._reach(nearest, x[None].repeat(count, 0), q[None].repeat(count, 0), gamma.repeat(count, 0)))
        self.part[self.solved] = 0

    def look_for_islands(self, place: Slice, axes: tuple[Array, ...]) -> None:
        """Try random starts about the start of a slice at some nodes not reached, and spread from what closes."""
        robot, columns = self.system.robot, self.system.pose_columns
        unsolved = np.flatnonzero(~self.solved)
        targets = np.repeat(unsolved[:: max(1, len(unsolved) // _TRIED)], _STARTS)
        spread = np.where(turning_velocities(robot)[columns], np.pi, _SLIDE) * self.system.step_unit
        steps = np.zeros((len(targets), robot.model.nv))
        steps[:, columns] = np.random.default_rng(_SEED).uniform(-1.0, 1.0, (len(targets), len(columns))) * spread
        guess = integrate(robot.model, np.repeat(place.q[None], len(targets), axis=0), steps)
        # an island may be small in the grid: closed at random, chains are in it more often than a node is
        closed = assemble(self.system, guess)
        x = positions(coordinates(robot, closed.state), place.free)
        near = [np.rint((at - axis[0]) / (axis[1] - axis[0])) for at, axis in zip(x.T, axes, strict=True)]
        inside = np.all([(k >= 0) & (k < n) for k, n in zip(near, self.shape, strict=True)], axis=0) & closed.closed
        hit = np.ravel_multi_index(tuple(k[inside].astype(int) for k in near), self.shape)
        targets, guess = np.append(targets, hit), np.concatenate([guess, closed.q[inside]])
        targets, guess = targets[~self.solved[targets]], guess[~self.solved[targets]]
        assembled = assemble(self.system, guess, self.nodes[targets], shortest_step=_SHORTEST_STEP)
        for k in np.flatnonzero(assembled.usable):
            if not self.solved[targets[k]]:
                self.q[targets[k]], self.gamma[targets[k]] = assembled.q[k], assembled.gamma[k]
                earlier = self.solved.copy()
                self.solved[targets[k]] = True
                self._spread(targets[k : k + 1])
                self._name(np.flatnonzero(self.solved & ~earlier))
        self.part = np.unique(np.append(self.part, [-1, 0]), return_inverse=True)[1][:-2] - 1  # without gaps
        self.q[self.part < 0] = np.nan

    def _name(self, new: IntArray) -> None:
        """Number a part that was found; one that touches another is of it, or another branch, where no modes tell.

        Of two branches the larger counts: a start beside a stretched leg may lead to a node or two, and no further.
        """
        beside = self.part[self._beside(new, corners=True)[0]]
        touched = beside[beside >= 0]
        if not len(touched):
            self.part[new] = self.part.max() + 1
        elif self.system.robot.working_modes is not None:
            self.part[new] = touched.min()
            for other in np.unique(touched):
                self.part[self.part == other] = touched.min()
        elif touched.min() > 0 and len(new) > (fewer := np.isin(self.part, touched)).sum():
            self.part[new] = self.part.max() + 1
            self.part[fewer] = -1

    def _spread(self, front: IntArray) -> None:
        """Solve the neighbours of solved nodes, outward in waves until no new node closes.

        Where none along the axes does any more those at corners are tried, if at all: a strip is narrower than a cell.
        """
        fresh = [front]
        while len(front):
            front = self._wave(front, corners=False)
            fresh.append(front)
            if not len(front) and self.across_corners:
                front = self._wave(np.concatenate(fresh), corners=True)
                fresh = [front]

    def _wave(self, front: IntArray, *, corners: bool) -> IntArray:
        targets, sources = self._neighbours(front, corners=corners)
        return self._reach(targets, self.nodes[sources], self.q[sources], self.gamma[sources])

    def _neighbours(self, front: IntArray, *, corners: bool) -> tuple[IntArray, IntArray]:
        """Return the unsolved neighbours of nodes, each once, and the node each is reached from."""
        target, source = self._beside(front, corners=corners)
        unsolved = ~self.solved[target]
        unique, first = np.unique(target[unsolved], return_index=True)
        return unique, source[unsolved][first]

    def _beside(self, front: IntArray, *, corners: bool = False) -> tuple[IntArray, IntArray]:
        """Return the neighbours of nodes along each axis, or at corners too, and the node each is a neighbour of."""
        targets, sources = [], []
        index = np.stack(np.unravel_index(front, self.shape))
        for step in product((-1, 0, 1), repeat=len(self.shape)):
            if any(step) and (corners or sum(map(abs, step)) == 1):
                moved = index + np.array(step)[:, None]
                inside = ((moved >= 0) & (moved < np.array(self.shape)[:, None])).all(axis=0)
                targets.append(np.ravel_multi_index(tuple(moved[:, inside]), self.shape))
                sources.append(front[inside])
        return np.concatenate(targets), np.concatenate(sources)

    def _reach(self, targets: IntArray, x: Array, q: Array, gamma: Array) -> IntArray:
        """Solve nodes from configurations nearby, with a predicted step and, where that fails, without."""
        if len(targets) == 0:
            return targets
        increment = difference(self.system.robot, self.nodes[targets], x)
        step = np.einsum("nvi,ni->nv", gamma, increment)
        size = np.abs(step / velocity_unit(self.system.robot)).max(axis=1, initial=0.0)
        step *= np.minimum(1.0, 0.5 * _LONGEST_STEP / np.maximum(size, np.finfo(float).tiny))[:, None]
        done = self._attempt(targets, q, step, gamma, increment)
        again = np.flatnonzero(~done)
        if len(again):
            still = np.zeros_like(step[again])
            done[again] = self._attempt(targets[again], q[again], still, gamma[again], increment[again])
        return targets[done]

    def _attempt(self, targets: IntArray, q: Array, step: Array, gamma: Array, increment: Array) -> BoolArray:
        robot, model = self.system.robot, self.system.robot.model
        guess = integrate(model, q, step)
        solution = assemble(
            self.system, guess, self.nodes[targets], max_iterations=_NEWTON, shortest_step=_SHORTEST_STEP
        )
        change = configuration_difference(model, q, solution.q)
        if robot.working_modes is None:
            # nothing but continuity tells the branches apart
            same = follows(self.system, change, gamma, solution.gamma, increment)
        else:
            same = solution.in_mode & (np.abs(change / velocity_unit(robot)).max(axis=1) < _LONGEST_STEP)
        good: BoolArray = solution.regular & same
        chosen = targets[good]
        self.q[chosen], self.gamma[chosen], self.solved[chosen] = solution.q[good], solution.gamma[good], True
        return good
