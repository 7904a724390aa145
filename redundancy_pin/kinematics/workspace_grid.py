"""A grid over the workspace solved on one branch, by flooding from the reference configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, read_only
from redundancy_pin.kinematics.assembly import Assembly, assemble, configuration_difference, integrate
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import difference
from redundancy_pin.kinematics.modes import in_working_mode
from redundancy_pin.kinematics.projection import project

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
