"""Follow a solution branch: from one closed configuration to the next, continuously.

K stacks the closure rows over the rows of the independent velocities, without the carrier columns: K v = (0, ẋ). Its
inverse gives Γ, the velocity of the tree per unit of each independent velocity. ``Follower.advance`` goes from a closed
state to other coordinates: a prediction by Γ, Newton's method, one acceptance test, and shorter steps where that fails.

Where the closure rows lose rank (a flat four-bar whose sides add up in pairs, a stretched parallelogram) branches
cross. K is singular there, but q and Γ are smooth along each branch, and the branch continues with the tangent it came
with: ``Follower.pass_through`` interpolates along it between regular states on both sides.

Where closure rows depend on one another, r of them are independent at the reference configuration (``robot.closures``)
and serve everywhere but where they lose rank and all rows together (``robot.all_closures``) keep it: there Uᵀ, of the
singular vectors that belong to the r largest singular values of J_c, makes r independent rows of all.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, Frozen, IntArray, lapack, read_only
from redundancy_pin.errors import SingularPoseError
from redundancy_pin.kinematics.assembly import (
    SETTLED_STEP,
    SINGULAR_MARGIN,
    TURNED_OVER,
    Assembly,
    assemble,
    configuration_difference,
    integrate,
    inverses,
)
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.closure import OPEN, ConstraintSystem, constraint_system, with_all_rows
from redundancy_pin.kinematics.coordinates import angle_columns, difference, mode_indicators, pose_rows
from redundancy_pin.robot import Robot
from redundancy_pin.robot.named import is_pose
from redundancy_pin.robot.scales import coordinate_unit, velocity_unit

__all__ = ["ClosedState", "Follower", "Rates", "follower", "known_state"]

LONGEST_STEP = 0.04
"""Longest step along a path, in characteristic lengths or rad: Newton converges from the prediction by Γ."""

CONTINUITY = 0.25
"""Acceptance threshold: relative error of the trapezoidal prediction (Γ₀ + Γ₁) Δx / 2. Halving a step reduces the error
of a smooth branch eightfold, that of a jump between branches not at all."""

SAME_TANGENT = 0.05
"""The same for a step across a rank loss, and the change of Γ beyond which a step is halved where K might become
singular within it. Branches whose tangents differ by less would not be told apart."""

ROUNDING = 1e-7
"""Rounding of a closed configuration, rad or characteristic lengths: the root of the closure tolerance, 1e-11, times
the largest inverse margin, 1e4, that is not treated as a rank loss."""

NEAR_RANK_LOSS = 3e-3
"""Singularity margin below which rounding shows: velocities lose 1e-16 / margin², accelerations 1e-16 / margin³."""

_HALVINGS = 22
"""Halvings of a step before the branch counts as lost: towards a stretched leg each step covers a part of the rest, and
this many come within 1e-9 characteristic lengths."""

_MOST_STEPS = 20_000
"""Steps along one straight path: eight hundred characteristic lengths."""

_SLOPE_STEP = 1e-4
"""Fraction of a step over which the slope of a determinant is taken: the root of the rounding of its logarithm."""

SAME_CONFIGURATION = 1e-6
"""Closed configurations of one pose nearer than this (rad, characteristic lengths) are the same, computed twice."""

_HELPED = 3.0
"""Ratio of margins beyond which dependent rows take the place of independent ones that lose rank."""

_NEWTON_STEPS = 10
_CONVERGED = 1e-13
"""A Newton step, or ten times a residual, this small (rad or characteristic lengths) is rounding."""

_NODES = np.array([-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0])
_NODE_SPACINGS = (1e-2, 2.5e-3)
"""Distances of the nodes of an interpolation, in characteristic lengths: wide ones keep away from the rank loss, narrow
ones serve branches that turn fast. The interpolation error is O(h⁸)."""

_PASSED = 1e-8
"""Largest relative error of K Γ = (0, 1) at an interpolated state. At a fold, where Γ is infinite, the error is 1."""

_SAMPLES, _SPREAD = 8, 0.2
"""Random configurations around the reference that determine the typical margin, and their spread (rad, lengths)."""


@dataclass(frozen=True, eq=False)
class ClosedState(Frozen):
    """A configuration on a solution branch, closed to the closure tolerance, with the inverse of K.

    Attributes:
        x: (n,) independent coordinates, m and rad, or a pose (4, 4), base frame.
        q: (nq,) configuration, carriers at zero.
        gamma: (nv, n) Γ: velocity of the tree per unit of each independent velocity; J_c Γ = 0.
        inverse: (p, r + n) K⁻¹ without units (``ConstraintSystem.relative``); empty for an interpolated state.
        residual: closure residual, m; angles count times the characteristic length.
        margin: lower bound of the smallest singular value of K without units, within √p of it; 0 below
            ``SINGULAR_MARGIN``.
        blocks: rows and columns of the diagonal blocks of K, see ``loop_blocks``.
        basis: (R, r) U, orthonormal, where all closure rows take the place of independent ones; otherwise None.

    Example:
        >>> branch = follower(robot)
        >>> state = branch.advance(branch.home, x)  # None where the branch is lost
        >>> W = state.gamma[robot.actuated_velocity].T  # (n, m)
    """

    x: Array
    q: Array
    gamma: Array
    inverse: Array
    residual: float
    margin: float
    blocks: Sequence[tuple[IntArray, IntArray]]
    basis: Array | None = None

    @cached_property
    def determinants(self) -> tuple[Array, Array]:
        """Signs and logarithms (B,) of the determinants of the blocks of K."""
        values = [np.linalg.slogdet(self.inverse[columns[:, None], rows]) for rows, columns in self.blocks]
        return np.array([sign for sign, _ in values]), -np.array([log for _, log in values])

    @property
    def interpolated(self) -> bool:
        """Whether the state lies at a rank loss of the closures, where K has no inverse."""
        return not self.inverse.size


class Rates(NamedTuple):
    """A state on a branch with v = Γ ẋ and a (nv,) of the tree there."""

    state: ClosedState
    v: Array
    a: Array


class Follower:
    """Follows branches of a robot; a workspace that holds Pinocchio data, see ``follower``.

    docs/guide/own_simulator.md has a simulator that is made of it.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self._model = robot, robot.model
        self.system = constraint_system(robot)
        self.chain = chain = ClosedChain(robot)
        self._rows, self._rank = self.system.all_rows, len(self.system.rows)
        self._redundant = bool(robot.all_closures)
        every = constraint_system(with_all_rows(robot))
        self._every, self._count, self._every_unit = every.all_rows, len(every.rows), every.equation_unit
        self._columns, self._nv = chain.pose_columns, robot.model.nv
        self._flat = robot.model.nq == robot.model.nv
        self._row_unit, self._step_unit = self.system.equation_unit, self.system.step_unit
        self._scale = self._step_unit / self._row_unit[:, None]
        self._unit, self._radians = coordinate_unit(robot), 1.0 / velocity_unit(robot)
        self._fixed = chain.system.independent[:, self._columns] if robot.platform is None else None
        self._is_pose, self._angles, self._pose_rows = is_pose(robot), angle_columns(robot), pose_rows(robot)
        self._legs = list(zip(*(part.tolist() for part in mode_indicators(robot)[:2]), strict=True))
        self._aligned = self.system.aligned

    @cached_property
    def blocks(self) -> Sequence[tuple[IntArray, IntArray]]:
        """The blocks of K, see ``loop_blocks``."""
        return loop_blocks(self.system)

    @cached_property
    def near(self) -> float:
        """The singularity margin below which a state counts as near a rank loss."""
        return near_rank_loss(self.system)

    @cached_property
    def _ample(self) -> float:
        """The singularity margin above which the independent rows are kept: at 1e-3 accelerations lose eight digits."""
        return min(0.1, 0.3 * typical_margin(self.system))

    @cached_property
    def home(self) -> ClosedState:
        """The reference configuration, whose Γ is NaN where it is singular."""
        q = np.array(self.robot.q_reference)
        self.chain.place(q)
        x = self.chain.coordinates(q)
        closed = self.close(q, x)
        if closed is not None and closed.margin > 0.0:
            return replace(closed, x=read_only(x), q=read_only(q))
        gamma = np.full((self._nv, self.robot.n), np.nan)
        return ClosedState(x, q, gamma, np.zeros((0, 0)), 0.0, 0.0, self.blocks)

    # --- one state ---------------------------------------------------------------------------------------------------

    def _matrix(self, q: Array, basis: Array | None) -> tuple[Array, Array]:
        """Return K (p, p) and the closure residuals (r,) at q, without units."""
        chain = self.chain
        chain.place(q)
        placed = self._rows.place(chain.vectors, q)
        K = placed.jacobian(chain.J).take(self._columns, 1)
        if self._fixed is not None:
            K = np.concatenate([K, self._fixed])
        K *= self._scale
        if basis is None:
            return K, placed.residual()[: self._rank] / self._row_unit[: self._rank]
        rows, phi = self._every_row(q)
        K[: self._rank] = basis.T @ rows
        return K, phi.dot(basis)

    def _every_row(self, q: Array) -> tuple[Array, Array]:
        """Return the Jacobian (R, p) and residuals (R,) of all closure rows, without units, where q is placed."""
        placed = self._every.place(self.chain.vectors, q)
        unit = self._every_unit[: self._count]
        rows = placed.jacobian(self.chain.J).take(self._columns, 1)[: self._count]
        return rows * (self._step_unit / unit[:, None]), placed.residual()[: self._count] / unit

    def _independent(self, q: Array, basis: Array | None, inverse: Array) -> tuple[Array | None, Array]:
        """Return the basis that serves at a closed configuration, and K⁻¹ with it.

        Independent rows serve while their margin is ample: rows of rounded numbers contradict each other, and singular
        values of the contradiction may exceed those of short levers.
        """
        plain = inverse if basis is None else inverses(self._matrix(q, None)[0][None])[0]
        size = float(np.nan_to_num(np.linalg.norm(plain), nan=np.inf))  # NaN where K is exactly singular
        if size * self._ample < 1.0:
            return None, plain
        self.chain.place(q)
        own = np.linalg.svd(self._every_row(q)[0], full_matrices=False)[0][:, : self._rank]
        other = inverses(self._matrix(q, own)[0][None])[0]
        if not float(np.linalg.norm(other)) < size / _HELPED:
            return None, plain
        return own, other

    def close(self, guess: Array, x: Array, basis: Array | None = None) -> ClosedState | None:
        """Return the closed state at coordinates by Newton's method from a guess nearby; None where that fails.

        Args:
            guess: (nq,) configuration.
            x: (n,) coordinates, or a pose (4, 4).
            basis: of a state nearby.
        """
        q, size, step = guess, math.inf, np.zeros(self._nv)
        rest = np.zeros(len(self._columns))
        for _ in range(_NEWTON_STEPS):
            K, phi = self._matrix(q, basis)
            rest[: self._rank] = -phi
            rest[self._rank :] = self.difference(x, self.chain.coordinates(q)) / self._unit
            before, size = size, math.sqrt(rest.dot(rest))
            factored, pivots, change, failed = lapack().dgesv(K, rest)
            if failed:
                return None
            longest = _largest(change)
            if not longest < 1.0 or (size >= before and size > CLOSURE_TOLERANCE):
                return None
            step[self._columns] = change * self._step_unit
            q = self._integrate(q, step)
            settled = size < 0.1 * _CONVERGED or longest < _CONVERGED
            if settled or (size >= before and longest < SETTLED_STEP):
                inverse = lapack().dgetri(factored, pivots)[0]
                open_row = 0.0
                if self._redundant:
                    basis, inverse = self._independent(q, basis, inverse)
                    open_row = _largest(self._every_row(q)[1])
                return self._closed(x, q, inverse, _largest(rest), open_row, basis)
        return None

    def _closed(
        self, x: Array, q: Array, inverse: Array, residual: float, open_row: float, basis: Array | None
    ) -> ClosedState | None:
        vectors = self.chain.vectors  # axes that must coincide do, and are not turned over
        if not all(float(vectors[a : a + 3].dot(vectors[b : b + 3])) > _COS_TURNED_OVER for a, b in self._aligned):
            return None
        if not (residual < CLOSURE_TOLERANCE and open_row < OPEN):
            return None
        size = math.sqrt(inverse.ravel().dot(inverse.ravel()))
        gamma = np.zeros((self._nv, self.robot.n))
        gamma[self._columns] = inverse[:, self._rank :] * (self._step_unit[:, None] / self._unit)
        for array in (q, gamma, inverse):
            array.setflags(write=False)
        margin = 1.0 / size if 0.0 < size < 1.0 / SINGULAR_MARGIN else 0.0
        residual *= self.robot.characteristic_length
        everything = np.arange(len(self._columns))  # combined rows belong to all loops
        blocks = self.blocks if basis is None else ((everything, everything),)
        return ClosedState(x, q, gamma, inverse, residual, margin if size else math.inf, blocks, basis)

    def rates(self, state: ClosedState, xd: Array, xdd: Array) -> Rates:
        """Return v = Γ ẋ and a (nv,): K a = (−J̇_c v, ẍ − J̇_x v).

        Args:
            state: a state where K has an inverse.
            xd: (n,) rates of the independent coordinates, or the twist of the platform.
            xdd: (n,) their second rates.

        Raises:
            SingularPoseError: K is singular there, so that it does not determine a; ``pass_through`` interpolates it.
        """
        if state.interpolated:
            raise SingularPoseError(
                f"K is singular at x = {np.array2string(state.x, precision=4)} and does not determine accelerations.",
                remedy="At a rank loss of the closures pass_through interpolates them along the branch.",
                margin=state.margin,
            )
        chain, v = self.chain, state.gamma.dot(xd)
        chain.place_moving(state.q, v)
        placed = self._rows.place(chain.vectors, state.q)
        bias = np.zeros(len(self._row_unit))
        bias[: self._rows.size] = self._rows.bias_at(placed, chain.J, chain.dJ, v)
        bias /= self._row_unit
        if state.basis is not None:
            every = self._every.bias_at(self._every.place(chain.vectors, state.q), chain.J, chain.dJ, v)
            bias[: self._rank] = (every[: self._count] / self._every_unit[: self._count]).dot(state.basis)
        rest = -bias
        rest[self._rank :] += xdd / self._unit
        a = np.zeros(self._nv)
        a[self._columns] = state.inverse.dot(rest) * self._step_unit
        return Rates(state, v, a)

    # --- along a branch ----------------------------------------------------------------------------------------------

    def advance(self, here: ClosedState, x: Array) -> ClosedState | None:
        """Return the state at coordinates x on the branch of ``here``, along the straight line; None where it is lost.

        Steps are halved until each is accepted. A rank loss of the closures that the branch goes smoothly through is
        passed. What ended a branch is for ``inverse_kinematics`` to say.
        """
        x = read_only(np.array(x))
        start, whole = here.x, self.difference(x, here.x)
        length = float(np.linalg.norm(whole / self._unit)) / LONGEST_STEP
        if not (math.isfinite(length) and np.isfinite(here.gamma).all()):
            return None
        pieces = min(max(math.ceil(length), 1), _MOST_STEPS)
        longest = size = 1.0 / pieces
        done, checked = 0.0, False
        while done < 1.0:
            target = x if done + size >= 1.0 - 1e-12 else self.displace(start, whole * (done + size))
            reached = self.step(here, target)
            if reached is None:
                reached = self._at_rank_loss(here, target)
            if reached is not None:
                here, done, size = reached, done + size if target is not x else 1.0, min(2.0 * size, longest)
                continue
            if not checked and not self._reaches(here, x):
                return None  # shorter steps would only creep up to the border of the workspace
            checked, size = True, 0.5 * size
            if size < longest * 2.0**-_HALVINGS:
                return None
        return here

    def _reaches(self, here: ClosedState, x: Array) -> bool:
        return bool(assemble(self.system, here.q[None], x[None]).closed[0])

    def step(self, here: ClosedState, x: Array, *, guarded: bool = True) -> ClosedState | None:
        """Return the state at coordinates x nearby in one step, or None where it is not plainly on the branch.

        Args:
            here: a state of the branch.
            x: (n,) coordinates, or a pose (4, 4).
            guarded: refuse a step within which K may become singular.
        """
        increment = self.difference(x, here.x)
        new = self.close(self._integrate(here.q, here.gamma.dot(increment)), x, here.basis)
        if new is None or not new.margin > 0.0:
            return None
        moved, predicted = self._tangent(here.q, new.q), (0.5 * (here.gamma + new.gamma)).dot(increment)
        error, length = _largest((moved - predicted) * self._radians), _largest(predicted * self._radians)
        if not error <= CONTINUITY * length + ROUNDING:
            return None
        if not guarded:
            return new
        same_side = self._same_sides(here.q, new.q)
        if _largest(moved * self._radians) < 0.5 * min(here.margin, new.margin):  # K stays regular within the step
            return new if same_side else None
        if self._changes_sign(here, new):
            return new if self.crosses(here, new) else None
        bend = _largest((new.gamma - here.gamma).dot(increment) * self._radians)
        if same_side and (here.interpolated or bend <= SAME_TANGENT * length):
            return new
        return new if same_side and not self._vanishes(here, new, increment) else None

    def _vanishes(self, before: ClosedState, after: ClosedState, increment: Array) -> bool:
        """Return whether a determinant comes to zero within a step without a change of sign, by its slopes.

        A determinant that is linear on both sides of its zero loses all of its value and more within the step, from
        either end.
        """
        lost = []
        for state, part in ((before, _SLOPE_STEP), (after, -_SLOPE_STEP)):
            K = self._matrix(self._integrate(state.q, state.gamma.dot(part * increment)), state.basis)[0]
            inside = np.array([np.linalg.slogdet(K[rows[:, None], columns])[1] for rows, columns in self.blocks])
            lost.append(-np.expm1(inside - state.determinants[1]) > 0.9 * _SLOPE_STEP)
        return bool((lost[0] & lost[1]).any())

    def _changes_sign(self, before: ClosedState, after: ClosedState) -> bool:
        """Return whether a determinant changes its sign from one state to the next, of the same rows."""
        known = not before.interpolated and before.basis is None and after.basis is None
        return known and bool((before.determinants[0] * after.determinants[0] < 0.0).any())

    def _same_sides(self, before: Array, after: Array) -> bool:
        """Return whether every leg is, and was, on the same side of the change of its working mode."""
        for column, turns in self._legs:
            old, new = float(before[column]), float(after[column])
            if not (math.sin(new) * math.sin(old) if turns else new * old) > 0.0:
                return False
        return True

    # --- through a rank loss of the closures -------------------------------------------------------------------------

    def crosses(self, before: ClosedState, after: ClosedState) -> bool:
        """Return whether a rank loss that the branch goes smoothly through lies between two neighbouring states.

        The determinant of a loop changes its sign there, and so may the indicator of a working mode. Where several
        loops do so, the branch has to go smoothly through the rank loss of each.
        """
        (sign0, log0), (sign1, log1) = before.determinants, after.determinants
        largest = np.maximum(log0, log1)
        size0, size1 = np.exp(log0 - largest), np.exp(log1 - largest)
        lost = np.flatnonzero((sign0 * sign1 <= 0.0) | (np.minimum(size0, size1) <= ROUNDING))
        if not len(lost) or not np.isfinite(largest[lost]).all():
            return False
        chord, still = self.difference(after.x, before.x), np.zeros(self.robot.n)
        for loop in lost.tolist():
            root = self.displace(before.x, chord * (size0[loop] / (size0[loop] + size1[loop])))
            beyond = self.pass_through(before, root, still, still, chord)
            if beyond is None:
                return False
            # nearly linear on a branch that goes through zero; on one that keeps its side nothing vanishes there
            K = self._matrix(beyond.state.q, before.basis)[0]
            rows, columns = self.blocks[loop]
            if not np.linalg.slogdet(K[rows[:, None], columns])[1] - largest[loop] < math.log(CONTINUITY):
                return False
        return True

    def _at_rank_loss(self, here: ClosedState, x: Array) -> ClosedState | None:
        """Return the state at coordinates where the closures lose rank, None where they do not or no branch goes on."""
        guess = self._integrate(here.q, here.gamma.dot(self.difference(x, here.x)))
        if self._margin(guess, here.basis) > 10.0 * self.near or not self.closures_lose_rank(guess, here.basis):
            return None
        closed = self.close(guess, x, here.basis)
        if closed is not None and closed.margin > self.near:
            return None
        changed = closed is not None and closed.margin > 0.0 and self._changes_sign(here, closed)
        if closed is not None and changed and not self.crosses(here, closed):
            return None  # the branch on the other side is another one
        still = np.zeros(self.robot.n)
        result = self.pass_through(here, x, still, still)
        return None if result is None else result.state

    def closures_lose_rank(self, q: Array, basis: Array | None = None) -> bool:
        """Return whether the closure rows are near a loss of rank at q (nq,); at a stretched leg they are not."""
        rows = self._matrix(q, basis)[0][: self._rank]
        if not len(rows) or not np.isfinite(rows).all():
            return False
        return bool(np.linalg.svd(rows, compute_uv=False)[-1] < 10.0 * self.near)

    def _margin(self, q: Array, basis: Array | None) -> float:
        inverse = inverses(self._matrix(q, basis)[0][None])[0]
        size = float(np.sqrt((inverse * inverse).sum()))
        return 1.0 / size if size > 0.0 and math.isfinite(size) else 0.0

    def pass_through(
        self, here: ClosedState, x: Array, xd: Array, xdd: Array, along: Array | None = None
    ) -> Rates | None:
        """Return the state at or near a rank loss of the closures on the branch of ``here``, by interpolation.

        q, Γ and the rates are interpolated between eight nodes on a line through x, four on each side. A node is a
        regular state; the branch is followed to the first, and across the rank loss by continuity of the tangent. The
        answer is verified: it is closed, and K Γ = (0, 1).

        Args:
            here: a state of the branch.
            x: (n,) coordinates, or a pose (4, 4).
            xd: (n,) their rates.
            xdd: (n,) their second rates.
            along: (n,) direction of the line; otherwise that from ``here`` to x or, where that goes along a rank loss,
                one coordinate's, or that of all.

        Returns:
            None where the branch does not go on smoothly (a leg at full stretch: a fold).
        """
        chord = self.difference(x, here.x)
        directions = (chord, *np.eye(self.robot.n), self._unit) if along is None else (along,)
        for direction in directions:
            size = float(np.linalg.norm(direction / self._unit))
            for spacing in _NODE_SPACINGS if size > 0.0 else ():
                line = self._line(here, x, direction / size * spacing)
                result = None if line is None else self._interpolate(*line, x, xd, xdd)
                if result is not None:
                    return result
        return None

    def _line(
        self, here: ClosedState, centre: Array, step: Array, *, recentre: bool = True
    ) -> tuple[Array, Array, list[ClosedState]] | None:
        """Return centre, step and states of nodes on both sides of a pose, on the branch of ``here``; None without."""
        first = self.step(here, self.displace(centre, _NODES[0] * step), guarded=False)
        if first is None:
            return None
        whole = (_NODES[-1] - _NODES[0]) * step
        end = self.displace(centre, _NODES[-1] * step)
        across = self.close(self._integrate(first.q, first.gamma.dot(whole)), end, first.basis)
        if across is None or not across.margin > 0.0:
            return None
        span = self._tangent(first.q, across.q)
        predicted = (0.5 * (first.gamma + across.gamma)).dot(whole)
        allowed = SAME_TANGENT * _largest(predicted * self._radians) + ROUNDING
        if not _largest((span - predicted) * self._radians) <= allowed:
            return None
        (sign0, log0), (sign1, log1) = first.determinants, across.determinants
        lost = sign0 * sign1 < 0.0
        if recentre and lost.any():
            # where the determinants, nearly linear between the two, vanish: the nodes keep away from there
            root = _NODES[0] + (_NODES[-1] - _NODES[0]) / (1.0 + np.exp(np.minimum(log1[lost] - log0[lost], 100.0)))
            shifts = np.append(root[np.abs(root) < 1.2], np.linspace(-1.2, 1.2, 25))
            away = np.abs(_NODES[:, None] - (root - shifts[:, None])[:, None]).min(axis=(1, 2))
            shifted = self.displace(centre, shifts[int(away.argmax())] * step)
            return self._line(first, shifted, step, recentre=False)
        nodes, slopes = [first], (first.gamma.dot(whole), across.gamma.dot(whole))
        for node in _NODES[1:-1]:
            u = (node - _NODES[0]) / (_NODES[-1] - _NODES[0])
            guess = u * u * (3 - 2 * u) * span + u * (1 - u) ** 2 * slopes[0] - u * u * (1 - u) * slopes[1]
            inner = self.close(self._integrate(first.q, guess), self.displace(centre, node * step), first.basis)
            if inner is None or not inner.margin > 0.0:
                return None
            missed = _largest((self._tangent(first.q, inner.q) - guess) * self._radians)
            if missed > SAME_TANGENT * _largest(span * self._radians) / len(_NODES):
                return None
            nodes.append(inner)
        return centre, step, [*nodes, across]

    def _interpolate(
        self, centre: Array, step: Array, nodes: list[ClosedState], x: Array, xd: Array, xdd: Array
    ) -> Rates | None:
        away, weight = self.difference(x, centre), self._unit**-2.0
        u = float((away * step * weight).sum() / (step * step * weight).sum())
        if abs(u) > _NODES[-1] / 2.0:
            return None
        aside = away - u * step  # the line, moved sideways through the pose
        rated = []
        for node in nodes:
            guess = self._integrate(node.q, node.gamma.dot(aside))
            closed = self.close(guess, self.displace(node.x, aside), node.basis)
            if closed is None or not closed.margin > 0.1 * self.near:
                return None
            rated.append(self.rates(closed, xd, xdd))
        others = _NODES[None, :] - _NODES[:, None] + np.eye(len(_NODES))
        weights = np.where(np.eye(len(_NODES), dtype=bool), 1.0, (u - _NODES) / -others).prod(axis=1)  # Lagrange's
        base = rated[len(rated) // 2].state
        tangent = sum(w * self._tangent(base.q, each.state.q) for w, each in zip(weights, rated, strict=True))
        q = self._integrate(base.q, tangent)
        gamma = sum(w * each.state.gamma for w, each in zip(weights, rated, strict=True))
        v = sum(w * each.v for w, each in zip(weights, rated, strict=True))
        a = sum(w * each.a for w, each in zip(weights, rated, strict=True))
        K, phi = self._matrix(q, base.basis)
        off = np.append(phi, self.difference(x, self.chain.coordinates(q)) / self._unit)
        relative = gamma[self._columns] * (self._unit / self._step_unit[:, None])
        product = K.dot(relative)
        product[self._rank :] -= np.eye(self.robot.n)
        residual = _largest(off)
        if residual > CLOSURE_TOLERANCE or np.abs(product).max() > _PASSED * (1.0 + np.abs(relative).max()):
            return None
        residual *= self.robot.characteristic_length
        return Rates(ClosedState(x, q, gamma, np.zeros((0, 0)), residual, 0.0, self.blocks, base.basis), v, a)

    # --- coordinates and configurations ------------------------------------------------------------------------------

    def difference(self, target: Array, start: Array) -> Array:
        """Return the increment (n,) from coordinates to others, as ``coordinates.difference``."""
        if self._is_pose:
            turn = pin.log3(target[:3, :3].dot(start[:3, :3].T))
            return np.concatenate([target[:3, 3] - start[:3, 3], turn])[self._pose_rows]
        delta: Array = target - start
        for k in self._angles:
            delta[k] = (delta[k] + math.pi) % (2.0 * math.pi) - math.pi
        return delta

    def displace(self, start: Array, increment: Array) -> Array:
        """Return the coordinates reached from others by an increment (n,)."""
        if not self._is_pose:
            return read_only(start + increment)
        full, pose = np.zeros(6), start.copy()
        full[self._pose_rows] = increment
        pose[:3, 3] += full[:3]
        pose[:3, :3] = pin.exp3(full[3:]).dot(start[:3, :3])
        return read_only(pose)

    def _integrate(self, q: Array, step: Array) -> Array:
        result: Array = q + step if self._flat else pin.integrate(self._model, q, step)
        return result

    def _tangent(self, start: Array, end: Array) -> Array:
        result: Array = end - start if self._flat else pin.difference(self._model, start, end)
        return result


_COS_TURNED_OVER = math.cos(TURNED_OVER)


def _largest(values: Array) -> float:
    """Return the largest magnitude of a few values; numpy's own way takes three times as long."""
    return max(map(abs, values.ravel().tolist()), default=0.0)


def known_state(robot: Robot, x: Array, q: Array, gamma: Array) -> ClosedState:
    """Return a state of a branch from a sample of a ``JointTrajectory``: x, q and Γ, carriers at any place.

    Example:
        >>> state = known_state(robot, motion.x[0], tree.q[0], tree.gamma[0])
    """
    own, configuration = follower(robot), np.array(q)
    configuration[robot.carrier_position] = np.array(robot.q_reference)[robot.carrier_position]
    closed = own.close(configuration, x)
    if closed is not None and closed.margin > own.near:
        return closed
    return ClosedState(x, configuration, gamma, np.zeros((0, 0)), 0.0, 0.0, own.blocks)


@lru_cache(maxsize=32)
def _follower(robot: Robot, thread: int) -> Follower:
    return Follower(robot)


def follower(robot: Robot) -> Follower:
    """Return the follower of a robot in this thread, made once: it is a workspace, which no two threads share."""
    return _follower(robot, threading.get_ident())


def continuous(system: ConstraintSystem, q: Array, gamma: Array, x: Array) -> BoolArray:
    """Return (N − 1,) whether each of N configurations continues the branch of the one before it.

    The change of q is compared with the trapezoidal rule over Γ and the change of x: ``CONTINUITY``.
    """
    step = configuration_difference(system.robot.model, q[:-1], q[1:])
    return follows(system, step, gamma[:-1], gamma[1:], difference(system.robot, x[1:], x[:-1]))


def follows(system: ConstraintSystem, step: Array, gamma0: Array, gamma1: Array, increment: Array) -> BoolArray:
    """Return (N,) whether steps (N, nv) of q are what Γ at both ends (N, nv, n) says of increments (N, n) of x."""
    unit = velocity_unit(system.robot)
    predicted = np.einsum("nvi,ni->nv", 0.5 * (gamma0 + gamma1), increment) / unit
    allowed = CONTINUITY * np.abs(predicted).max(axis=1, initial=0.0) + ROUNDING
    result: BoolArray = np.abs(step / unit - predicted).max(axis=1, initial=0.0) <= allowed
    return result


# --- what is typical of a robot ---------------------------------------------------------------------------------------


@lru_cache(maxsize=64)
def closed_around(system: ConstraintSystem) -> Assembly:
    """Return the reference configuration and some around it, the chains closed again where Newton's method can.

    Half of them are displaced in any direction, half along the branch: near a pose where several loops are flat,
    Newton's method closes the former to flat poses again.
    """
    model, q, rng = system.robot.model, np.array(system.robot.q_reference), np.random.default_rng(0)
    unit = velocity_unit(system.robot)
    steps = rng.normal(0.0, _SPREAD, (1 + _SAMPLES, model.nv)) * unit
    steps[0] = 0.0
    home = assemble(system, q[None], max_iterations=0)
    if home.closed[0] and home.projection.margin[0] > 0.0:
        along = (rng.normal(size=(_SAMPLES, system.robot.n)) * coordinate_unit(system.robot)) @ home.gamma[0].T
        farthest = np.abs(along / unit).max(axis=1, keepdims=True)
        steps = np.concatenate([steps, 2.0 * _SPREAD * along / np.where(farthest > 0.0, farthest, 1.0)])
    return assemble(system, integrate(model, np.repeat(q[None], len(steps), axis=0), steps))


@lru_cache(maxsize=64)
def typical_margin(system: ConstraintSystem) -> float:
    """Return the largest singularity margin at the reference and some configurations around it; 1 where all are 0."""
    around = closed_around(system)
    return float(around.projection.margin.max(where=around.closed, initial=0.0)) or 1.0


def near_rank_loss(system: ConstraintSystem) -> float:
    """Return the singularity margin below which a state is near a rank loss: smaller for robots of small margins.

    Short levers, gears and many joints make margins of 1e-3 and less everywhere (Cassie's leg), where no rank is lost.
    """
    return min(NEAR_RANK_LOSS, 0.1 * typical_margin(system))


@lru_cache(maxsize=64)
def loop_blocks(system: ConstraintSystem) -> tuple[tuple[IntArray, IntArray], ...]:
    """Return rows and columns of the B diagonal blocks to which K can be permuted, each that of a loop or a leg.

    det K is the product of theirs up to a sign, and they lose rank each by itself: two that change sign in one step
    leave that of det K. Columns j and k are of one block where K⁻¹ K, the identity, comes about by entries that lead
    from j to k and back. Entries below 1e-9 of the largest, with open chains, are zero by the structure of the robot.
    """
    model, rng = system.robot.model, np.random.default_rng(0)
    steps = rng.normal(0.0, _SPREAD, (2, model.nv)) * velocity_unit(system.robot)
    start = np.repeat(np.array(system.robot.q_reference)[None], 2, axis=0)
    rows = system.relative(system.evaluate(integrate(model, start, steps)).K)
    solves, has = (
        (np.abs(part) > 1e-9 * np.abs(part).max(axis=(1, 2), keepdims=True)).any(axis=0)
        for part in (inverses(rows), rows)
    )
    leads = solves.astype(np.float64) @ has > 0.0
    together = (leads & leads.T) | np.eye(len(leads), dtype=bool)
    blocks, size = [], len(system.pose_columns)
    for k in range(size):
        columns = np.flatnonzero(together[k])
        if columns[0] == k:
            blocks.append((np.flatnonzero((solves[columns] & has[:, columns].T).any(axis=0)), columns))
    if any(len(own) != len(columns) for own, columns in blocks):
        return ((np.arange(size), np.arange(size)),)
    return tuple(blocks)
