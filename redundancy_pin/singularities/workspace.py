"""Exact singular configurations on grid edges: Newton on closure, the coordinates that are fixed, and a singular value.

In the joint coordinates a singularity is a simple root even where the platform coordinates meet a square root (at the
border of the workspace). The unknowns are all p joint displacements; the equations are the r closure rows, the n − 1
platform coordinates that are constant along an edge, and σ = 0, the smallest singular value of the scaled K (type I)
or T (type II). With σ = uᵀ M v its derivative is uᵀ (∂M/∂q) v.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, IntArray, read_only
from redundancy_pin.kinematics.assembly import Assembly, assemble, configuration_difference, integrate, project
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference
from redundancy_pin.kinematics.modes import in_working_mode, mode_indicator
from redundancy_pin.singularities.classify import actuation_matrix, serial_matrix, signed_margin

_NEWTON = 10
_SHORTEST_STEP = 2.0**-3
"""Where Newton needs shorter steps than this the pose is left to a nearer neighbour."""

_LONGEST_STEP = 2.0
"""Largest change of q (rad, m) between neighbours: a leg near its base hinge turns by up to π/2, one that Newton threw
to another turn by more."""


@dataclass(frozen=True, eq=False)
class WorkspaceGrid:
    """Configurations over a rectangular grid of one or two platform coordinates, the others fixed.

    Attributes:
        free: columns of the platform coordinates that vary, in the order of the grid's axes.
        axes: the grid's coordinates along each of them, increasing, m or rad.
        x: (G, n) platform coordinates of all nodes, the last axis running fastest.
        q: (G, nq) configurations, NaN where not reachable.
        reachable: (G,) whether a closed configuration in the working mode was found.
    """

    free: tuple[int, ...]
    axes: tuple[Array, ...]
    x: Array
    q: Array
    reachable: BoolArray

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of nodes along each axis."""
        return tuple(len(axis) for axis in self.axes)


def solve_grid(
    system: ConstraintSystem, free: tuple[int, ...], axes: tuple[Array, ...], x: Array, q: Array
) -> WorkspaceGrid:
    """Flood a grid from one configuration: every solved node is where its neighbours start from.

    Only the part of the workspace that is connected to the start (in the slice of the grid) is found.

    Args:
        system: closures and platform rows.
        free: columns of the platform coordinates that vary.
        axes: the grid's coordinates along each of them.
        x: (n,) platform coordinates of the start; those that are not free hold over the grid.
        q: (nq,) a closed configuration there.
    """
    mesh = np.meshgrid(*axes, indexing="ij")
    nodes = np.repeat(x[None], mesh[0].size, axis=0)
    for column, values in zip(free, mesh, strict=True):
        nodes[:, column] = values.ravel()
    flood = _Flood(system, nodes, tuple(len(axis) for axis in axes))
    flood.run(x, q)
    return WorkspaceGrid(
        free,
        tuple(read_only(np.array(axis)) for axis in axes),
        read_only(nodes),
        read_only(flood.q),
        read_only(flood.solved),
    )


class _Flood:
    """State of the flooding; used up by one run."""

    def __init__(self, system: ConstraintSystem, nodes: Array, shape: tuple[int, ...]) -> None:
        self.system = system
        self.nodes = nodes
        self.shape = shape
        self.q = np.full((len(nodes), system.robot.model.nq), np.nan)
        self.gamma = np.zeros((len(nodes), system.robot.model.nv, system.robot.n))
        self.solved = np.zeros(len(nodes), dtype=bool)

    def run(self, x: Array, q: Array) -> None:
        """Solve the nodes nearest to the start, then outward in waves until no new node closes."""
        gamma = project(self.system, self.system.evaluate(q[None])).gamma
        distance = np.abs(difference(self.system.robot, self.nodes, np.repeat(x[None], len(self.nodes), axis=0)))
        nearest = np.argsort(distance.max(axis=1), kind="stable")[: 4 ** len(self.shape)]
        count = len(nearest)
        front = self._reach(nearest, x[None].repeat(count, 0), q[None].repeat(count, 0), gamma.repeat(count, 0))
        while len(front):
            targets, sources = self._neighbours(front)
            front = self._reach(targets, self.nodes[sources], self.q[sources], self.gamma[sources])

    def _neighbours(self, front: IntArray) -> tuple[IntArray, IntArray]:
        """Return the unsolved neighbours of nodes, each once, and the node each is reached from."""
        targets, sources = [], []
        index = np.stack(np.unravel_index(front, self.shape))
        for axis in range(len(self.shape)):
            for step in (-1, 1):
                moved = index.copy()
                moved[axis] += step
                inside = (moved[axis] >= 0) & (moved[axis] < self.shape[axis])
                targets.append(np.ravel_multi_index(tuple(moved[:, inside]), self.shape))
                sources.append(front[inside])
        target, source = np.concatenate(targets), np.concatenate(sources)
        open_ones = ~self.solved[target]
        unique, first = np.unique(target[open_ones], return_index=True)
        return unique, source[open_ones][first]

    def _reach(self, targets: IntArray, x: Array, q: Array, gamma: Array) -> IntArray:
        """Solve nodes from configurations nearby, with a predicted step and, where that fails, without."""
        if len(targets) == 0:
            return targets
        increment = difference(self.system.robot, self.nodes[targets], x)
        step = np.einsum("nvi,ni->nv", gamma, increment)
        size = np.abs(step).max(axis=1, initial=0.0)
        step *= np.minimum(1.0, 0.5 * _LONGEST_STEP / np.maximum(size, np.finfo(float).tiny))[:, None]
        done = self._attempt(targets, q, step, gamma, increment)
        again = np.flatnonzero(~done)
        if len(again):
            done[again] = self._attempt(
                targets[again], q[again], np.zeros_like(step[again]), gamma[again], increment[again]
            )
        return targets[done]

    def _attempt(self, targets: IntArray, q: Array, step: Array, gamma: Array, increment: Array) -> BoolArray:
        robot, model = self.system.robot, self.system.robot.model
        solution: Assembly = assemble(
            self.system,
            integrate(model, q, step),
            self.nodes[targets],
            max_iterations=_NEWTON,
            shortest_step=_SHORTEST_STEP,
        )
        here = project(self.system, solution.state).gamma
        change = configuration_difference(model, q, solution.q)
        if robot.working_modes is None:
            # nothing but continuity tells the branches apart
            predicted = 0.5 * np.einsum("nvi,ni->nv", gamma + here, increment)
            same = np.abs(change - predicted).max(axis=1) <= _CONTINUITY * np.abs(predicted).max(axis=1) + _ROUNDING
        else:
            same = in_working_mode(robot, solution.q) & (np.abs(change).max(axis=1) < _LONGEST_STEP)
        good: BoolArray = solution.closed & same & np.isfinite(here).all(axis=(1, 2))
        chosen = targets[good]
        self.q[chosen], self.gamma[chosen], self.solved[chosen] = solution.q[good], here[good], True
        return good


_CONTINUITY = 0.25
"""Part of a step that its trapezoidal prediction may miss before it counts as a jump to another branch."""

_ROUNDING = 1e-7
"""Changes of q below this (rad, m) are rounding."""


SINGULAR = 1e-9
"""Scaled singular value below which a refined point counts as singular; Newton leaves 1e-15."""

MatrixOf = Callable[[ConstraintSystem, ConstraintState], Array]

_ITERATIONS = 20
_DIFFERENCE = 1e-6
"""Step of the central differences of M, rad or m: their relative error, 1e-10, only slows Newton's last step."""

_LONGEST_NEWTON_STEP = 0.3
_MARGIN_BISECTIONS = 25
_BISECTIONS = 5
"""They bring the leg within a thirtieth of a grid cell of the border; from there Newton converges."""


@dataclass(frozen=True, eq=False)
class RefinedPoints:
    """Singular configurations, one for each edge.

    Attributes:
        x: (E, n) platform coordinates.
        q: (E, nq) configurations.
        residual: (E,) smallest singular value of the matrix whose zero was sought.
        found: (E,) closed, singular, and on its edge.
    """

    x: Array
    q: Array
    residual: Array
    found: BoolArray

    def replaced(self, where: IntArray, other: RefinedPoints) -> RefinedPoints:
        """Return the points with some of them replaced by others."""
        parts = {name: values.copy() for name, values in vars(self).items()}
        for name, values in parts.items():
            values[where] = getattr(other, name)
        return RefinedPoints(**parts)


def refine(
    system: ConstraintSystem, matrix: MatrixOf, guess: Array, start: Array, end: Array, free: IntArray
) -> RefinedPoints:
    """Find the singular configuration on each edge.

    Args:
        system: closures and platform rows.
        matrix: ``serial_matrix`` for type I, ``locked_matrix`` for type II.
        guess: (E, nq) configurations near it.
        start: (E, n) platform coordinates of one end of each edge.
        end: (E, n) those of the other.
        free: (E,) the column in which they differ.
    """
    robot, p = system.robot, system.pose_columns
    everyone = np.arange(len(guess))
    held = np.arange(robot.n)[None, :] != free[:, None]
    others = np.broadcast_to(np.arange(robot.n), held.shape)[held].reshape(len(guess), robot.n - 1)
    q = guess.copy()
    for _ in range(_ITERATIONS):
        state = system.evaluate(q)
        sigma, gradient = _singular_value(system, matrix, state)
        miss = difference(robot, start, coordinates(robot, state))[everyone[:, None], others]
        rows = np.concatenate(
            [state.Jc[:, :, p], state.Jx[:, :, p][everyone[:, None], others], gradient[:, None]], axis=1
        )
        rhs = np.concatenate([-state.phi, miss, -sigma[:, None]], axis=1)
        # minimum norm: where two branches of a singular curve meet the equations depend on each other
        step = (np.linalg.pinv(rows, rcond=1e-12) @ rhs[:, :, None])[:, :, 0]
        size = np.abs(step).max(axis=1, keepdims=True)
        full = np.zeros((len(q), robot.model.nv))
        full[:, p] = step * np.minimum(1.0, _LONGEST_NEWTON_STEP / np.maximum(size, _LONGEST_NEWTON_STEP))
        q = integrate(robot.model, q, full)
        if size.max(initial=0.0) < 1e-14:
            break
    state = system.evaluate(q)
    x = coordinates(robot, state)
    sigma = np.asarray(np.linalg.svd(matrix(system, state), compute_uv=False)[:, -1], dtype=np.float64)
    away = difference(robot, x, start)
    edge = difference(robot, end, start)
    fraction = away[everyone, free] / edge[everyone, free]
    off = np.abs(np.where(held, away, 0.0)).max(axis=1)
    gap = np.maximum(np.abs(state.phi).max(axis=1, initial=0.0), off)
    on_edge = (fraction > -_EDGE_ROUNDING) & (fraction < 1.0 + _EDGE_ROUNDING)
    # a hair beyond the border of the working mode is rounding, more is another branch
    in_mode = (mode_indicator(robot, q) * np.array(robot.working_mode) > -_MODE_ROUNDING).all(axis=1)
    return RefinedPoints(x, q, sigma, (gap < CLOSURE_TOLERANCE) & (sigma < SINGULAR) & on_edge & in_mode)


def approach_border(system: ConstraintSystem, q: Array, start: Array, end: Array) -> Array:
    """Return (E, nq) configurations near the border of the workspace, by bisection along edges that cross it.

    Args:
        system: closures and platform rows.
        q: (E, nq) configurations at ``start``.
        start: (E, n) reachable platform coordinates.
        end: (E, n) unreachable ones.
    """
    inside, outside = np.zeros(len(q)), np.ones(len(q))
    best = q.copy()
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inside + outside)
        target = start + middle[:, None] * (end - start)
        solution = assemble(system, best, target, max_iterations=10, shortest_step=0.125)
        good = solution.closed & in_working_mode(system.robot, solution.q)
        best[good] = solution.q[good]
        inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
    return best


def bisect_margin(system: ConstraintSystem, q: Array, start: Array, end: Array, margin: Array) -> Array:
    """Return (E, nq) configurations at the sign change of the signed margin, by bisection: slow, and hard to mislead.

    Args:
        system: closures and platform rows.
        q: (E, nq) configurations at ``start``.
        start: (E, n) platform coordinates of one end of each edge.
        end: (E, n) those of the other.
        margin: (E,) signed margin at ``start``; it has the other sign at ``end``.
    """
    low, high = np.zeros(len(q)), np.ones(len(q))
    best = q.copy()
    for _ in range(_MARGIN_BISECTIONS):
        middle = 0.5 * (low + high)
        solution = assemble(system, best, start + middle[:, None] * (end - start))
        W = actuation_matrix(system, serial_matrix(system, solution.state))
        same = np.sign(signed_margin(W)) == np.sign(margin)
        usable = solution.closed & in_working_mode(system.robot, solution.q)
        best[usable] = solution.q[usable]
        low, high = np.where(usable & same, middle, low), np.where(usable & same, high, middle)
    return best


def _singular_value(system: ConstraintSystem, matrix: MatrixOf, state: ConstraintState) -> tuple[Array, Array]:
    """Return the smallest singular value (E,) and its derivatives (E, p) by the joint displacements."""
    u, values, vt = np.linalg.svd(matrix(system, state), full_matrices=False)
    samples, columns, model = len(state.q), system.pose_columns, system.robot.model
    steps = np.zeros((2 * len(columns), model.nv))
    steps[np.arange(len(columns)), columns] = _DIFFERENCE
    steps[len(columns) + np.arange(len(columns)), columns] = -_DIFFERENCE
    moved = integrate(model, np.repeat(state.q, len(steps), axis=0), np.tile(steps, (samples, 1)))
    shifted = matrix(system, system.evaluate(moved))
    shifted = shifted.reshape(samples, 2, len(columns), *shifted.shape[1:])
    slope = (shifted[:, 0] - shifted[:, 1]) / (2.0 * _DIFFERENCE)
    return values[:, -1], np.einsum("ni,ncij,nj->nc", u[:, :, -1], slope, vt[:, -1])


_MODE_ROUNDING = 1e-9
_EDGE_ROUNDING = 1e-9
"""A root this far beyond the end of its edge (fraction of its length) is at the end."""
