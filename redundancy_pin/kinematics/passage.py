"""Pass through a rank loss of the closures, by continuity of the tangent.

Where the closure rows lose rank (a flat four-bar whose sides add up in pairs, a stretched parallelogram) branches
cross. K is singular there, but q, Γ and accelerations are smooth along each branch. They are interpolated between
regular states on a line across the rank loss. The branch continues with the tangent it came with.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, read_only
from redundancy_pin.kinematics.closed_state import ClosedState, LoopSolver, Rates
from redundancy_pin.kinematics.coordinates import difference, moved

SAME_TANGENT = 0.05
"""Largest relative error of the trapezoidal prediction across a rank loss. Branches whose tangents differ by less would
not be told apart."""

_NODES = np.array([-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0])
"""Places of the nodes on the line, in spacings from its centre. The interpolation error is O(spacing⁸)."""

SPACINGS = (7.5e-2, 1e-2, 2.5e-3)
"""Distances of the nodes, rad or characteristic lengths. The first serves simulations, whose steps are long, the others
kinematics, which are exact to rounding with them. Narrow ones serve branches that turn fast."""

_SHIFTS = np.linspace(-1.2, 1.2, 25)
"""Shifts of the nodes, in spacings, that are tried where a node comes near a rank loss."""

PASSED = 1e-8
"""Largest relative error of K Γ = (0, 1) at an interpolated state. At a fold, where Γ is infinite, the error is 1."""


@dataclass(frozen=True, eq=False)
class Passage:
    """A smooth part of a branch across a rank loss, by eight regular states on a line in the independent coordinates.

    Attributes:
        solver: what closes the nodes.
        centre: (n,) coordinates, or a pose (4, 4), between the fourth node and the fifth.
        step: (n,) increment of the coordinates per spacing of the nodes.
        nodes: the states, four on each side of the centre.
    """

    solver: LoopSolver
    centre: Array
    step: Array
    nodes: tuple[ClosedState, ...]

    @property
    def spacing(self) -> float:
        """Distance of the nodes, rad or characteristic lengths."""
        return float(np.linalg.norm(self.step / self.solver.unit))

    @property
    def half(self) -> float:
        """Half of the length of the line, rad or characteristic lengths."""
        return self.spacing * float(_NODES[-1])

    def position(self, x: Array) -> float:
        """Return where on the line coordinates are, in spacings from the centre."""
        weight = self.step / self.solver.unit**2
        return float(difference(self.solver.robot, x, self.centre).dot(weight) / self.step.dot(weight))

    def at(self, x: Array, xd: Array, xdd: Array) -> Rates | None:
        """Return state and rates at coordinates x near the line; None where they fail the test.

        The line is moved sideways through x. The answer is verified: it is closed, and K Γ = (0, 1).

        Args:
            x: (n,) coordinates, or a pose (4, 4).
            xd: (n,) their rates.
            xdd: (n,) their second rates.
        """
        solver, robot, u = self.solver, self.solver.robot, self.position(x)
        if robot.n == 1:  # nothing is beside the line, and J̇_c v goes with the square of the rate
            points, square = self._own_points, float(xd[0]) ** 2
        else:
            points, square = self._points(difference(robot, x, self.centre) - u * self.step, xd), 1.0
        if points is None:
            return None
        others = _NODES[None, :] - _NODES[:, None] + np.eye(len(_NODES))
        weights = np.where(np.eye(len(_NODES), dtype=bool), 1.0, (u - _NODES) / -others).prod(axis=1)  # Lagrange's
        q = solver.integrate(points.base.q, weights.dot(points.tangent))
        gamma = np.tensordot(weights, points.gamma, 1)
        residual, slip = solver.identity_error(q, x, gamma, points.base.basis)
        if not (residual <= CLOSURE_TOLERANCE and slip <= PASSED):
            return None
        residual *= robot.characteristic_length
        state = solver.singular_state(x, read_only(q), read_only(gamma), residual, points.base.basis)
        return Rates(state, gamma.dot(xd), square * weights.dot(points.bias) + gamma.dot(xdd))

    @cached_property
    def _own_points(self) -> _Points | None:
        """The nodes where they are, at unit rate."""
        return self._points(np.zeros(self.solver.robot.n), np.ones(self.solver.robot.n))

    def _points(self, aside: Array, xd: Array) -> _Points | None:
        """Return the nodes moved by an increment (n,) of the coordinates, at rates (n,); None where one is singular."""
        solver, robot, still = self.solver, self.solver.robot, np.zeros(self.solver.robot.n)
        rated = []
        for node in self.nodes:
            guess = solver.integrate(node.q, node.gamma.dot(aside))
            closed = solver.close(guess, moved(robot, node.x, aside), node.basis)
            if closed is None or not closed.margin > 0.1 * solver.near:
                return None
            rated.append(solver.rates(closed, xd, still))
        base = rated[len(rated) // 2].state
        tangent = np.array([solver.tangent(base.q, each.state.q) for each in rated])
        gamma = np.array([each.state.gamma for each in rated])
        return _Points(base, tangent, gamma, np.array([each.a for each in rated]))


class _Points(NamedTuple):
    """Nodes on a line: the fifth, displacements (8, nv) from there, Γ (8, nv, n), and a (8, nv) where ẍ = 0."""

    base: ClosedState
    tangent: Array
    gamma: Array
    bias: Array


def find_passage(
    solver: LoopSolver, here: ClosedState, centre: Array, step: Array, *, recentre: bool = True
) -> Passage | None:
    """Return the passage of the branch of a state through a line of nodes; None where the branch is not smooth there.

    The branch is followed to the first node in one step, and across the rank loss by its tangent. Nodes between keep to
    the cubic that joins both ends.

    Args:
        solver: closes the nodes.
        here: a state of the branch, near the first node.
        centre: (n,) coordinates, or a pose (4, 4), in the middle of the line.
        step: (n,) increment of the coordinates per spacing of the nodes.
        recentre: move the nodes along the line, away from rank losses.
    """
    robot = solver.robot

    def place(node: float) -> Array:
        return read_only(moved(robot, centre, node * step))

    first = solver.extrapolate(here, place(_NODES[0]))
    if first is None:
        return None
    whole = (_NODES[-1] - _NODES[0]) * step
    last = solver.close(solver.integrate(first.q, first.gamma.dot(whole)), place(_NODES[-1]), first.basis)
    if last is None or not last.margin > 0.0:
        return None
    span = solver.tangent(first.q, last.q)
    if not solver.is_continuous(span, first.gamma, last.gamma, whole, SAME_TANGENT):
        return None
    lost = first.determinants[0] * last.determinants[0] < 0.0
    if recentre and lost.any():
        # where the determinants, nearly linear between the two, vanish: the nodes keep away from there
        ratio = np.exp(np.minimum((last.determinants[1] - first.determinants[1])[lost], 100.0))
        roots = _NODES[0] + (_NODES[-1] - _NODES[0]) / (1.0 + ratio)
        shifts = np.append(roots[np.abs(roots) < _SHIFTS[-1]], _SHIFTS)
        away = np.abs(_NODES[:, None] - (roots - shifts[:, None])[:, None]).min(axis=(1, 2))
        return find_passage(solver, first, place(float(shifts[int(away.argmax())])), step, recentre=False)
    nodes, slopes = [first], (first.gamma.dot(whole), last.gamma.dot(whole))
    for node in _NODES[1:-1]:
        u = (node - _NODES[0]) / (_NODES[-1] - _NODES[0])
        guess = u * u * (3 - 2 * u) * span + u * (1 - u) ** 2 * slopes[0] - u * u * (1 - u) * slopes[1]
        inner = solver.close(solver.integrate(first.q, guess), place(node), first.basis)
        if inner is None or not inner.margin > 0.0:
            return None
        missed = solver.length(solver.tangent(first.q, inner.q) - guess)
        if not missed <= SAME_TANGENT * solver.length(span) / len(_NODES):
            return None
        nodes.append(inner)
    return Passage(solver, centre, step, (*nodes, last))
