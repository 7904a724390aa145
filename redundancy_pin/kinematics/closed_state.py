"""Close the loops at one pose: a closed configuration with Γ, by Newton's method from a configuration nearby.

K stacks the closure rows over the rows of the independent velocities, without the carrier columns: K v = (0, ẋ). Its
inverse gives Γ, the velocity of the tree per unit of each independent velocity.

Where closure rows depend on one another, the r that are independent at the reference serve everywhere except where they
lose rank and all rows together keep it: there r combinations of all rows serve (``ClosedChain.use_basis``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import (
    CLOSURE_TOLERANCE,
    SINGULAR_MARGIN,
    Array,
    Frozen,
    IntArray,
    checked,
    lapack,
    read_only,
)
from redundancy_pin.errors import SingularPoseError
from redundancy_pin.kinematics.assembly import (
    ROUNDED_RESIDUAL,
    SETTLED_STEP,
    TURNED_OVER,
    Assembly,
    evaluated,
    inverses,
)
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.closing import closed_neighbours
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import coordinates, difference
from redundancy_pin.kinematics.multistart import SEED, draw_starts
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.scales import coordinate_unit, velocity_unit

NEAR_RANK_LOSS = 3e-3
"""Singularity margin below which rounding shows: velocities lose 1e-16 / margin², accelerations 1e-16 / margin³."""

_AROUND = 16, 0.4
"""Number of configurations around the reference that determine the typical margin, and how far from it the joint is
that moves farthest, before closing, rad or characteristic lengths."""

CONTINUITY = 0.25
"""Acceptance threshold: relative error of the trapezoidal prediction (Γ₀ + Γ₁) Δx / 2. Halving a step reduces the error
of a smooth branch eightfold, that of a jump between branches not at all."""

ROUNDING = 1e4 * CLOSURE_TOLERANCE
"""Rounding of a closed configuration, rad or characteristic lengths: the root of the closure tolerance, 1e-11, times
the largest inverse margin, 1e4, that is not treated as a rank loss."""

_NEWTON_STEPS = 10
"""Most steps of Newton's method, which doubles the correct digits: from 0.1 to rounding it takes five."""

_LARGEST_BEND = 0.1
"""Part of second order of a prediction, relative to the first, above which it is left out: the step is too long."""

_COS_TURNED_OVER = math.cos(TURNED_OVER)


@dataclass(frozen=True, eq=False)
class ClosedState(Frozen):
    """A configuration on a solution branch, closed to the closure tolerance, with the inverse of K.

    Attributes:
        robot: the robot.
        x: (n,) independent coordinates, m and rad, or a pose (4, 4), base frame.
        q: (nq,) configuration, carriers at zero.
        gamma: (nv, n) Γ: velocity of the tree per unit of each independent velocity; J_c Γ = 0.
        inverse: (p, r + n) K⁻¹ without units (``ConstraintSystem.relative``); empty for an interpolated state.
        residual: closure residual, m; angles count times the characteristic length.
        margin: lower bound of the smallest singular value of K without units, within √p of it; 0 below
            ``SINGULAR_MARGIN``.
        blocks: rows and columns of the diagonal blocks of K, see ``margins.loop_blocks``.
        basis: (R, r) U, orthonormal, where all closure rows take the place of independent ones; otherwise None.

    Example:
        >>> import redundancy_pin as rp
        >>> from redundancy_pin.kinematics.branch import follower
        >>> branch = follower(rp.load_robot("five_bar"))
        >>> state = branch.advance(branch.home, branch.home.x + 0.01)
        >>> state.W.shape
        (2, 2)
    """

    robot: Robot
    x: Array
    q: Array
    gamma: Array
    inverse: Array
    residual: float
    margin: float
    blocks: Sequence[tuple[IntArray, IntArray]]
    basis: Array | None = None

    @property
    def W(self) -> Array:
        """(n, m) actuation matrix Γᵀ Sᵀ: W τ are the forces along the independent coordinates, N and N·m."""
        return self.gamma[self.robot.actuated_velocity].T

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


class LoopSolver:
    """Closes the loops of a robot at one pose; a workspace that holds Pinocchio data, so each thread has its own.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self._model = robot, robot.model
        self.system = constraint_system(robot)
        self.chain = chain = ClosedChain(robot)
        self.rank = len(self.system.rows)
        self._columns, self._nv = chain.pose_columns, robot.model.nv
        self._flat = robot.model.nq == robot.model.nv
        self._shape = (4, 4) if is_pose(robot) else (robot.n,)
        self._step_unit = self.system.step_unit
        self.unit, self._radians = coordinate_unit(robot), 1.0 / velocity_unit(robot)
        self._gamma_unit = self._step_unit[:, None] / self.unit
        self._aligned = self.system.aligned

    @cached_property
    def blocks(self) -> Sequence[tuple[IntArray, IntArray]]:
        """The blocks of K, see ``margins.loop_blocks``."""
        return loop_blocks(self.system)

    def blocks_of(self, basis: Array | None) -> Sequence[tuple[IntArray, IntArray]]:
        """Return the blocks of K with a basis: combined rows belong to all loops."""
        if basis is None:
            return self.blocks
        everything = np.arange(len(self._columns))
        return ((everything, everything),)

    @cached_property
    def near(self) -> float:
        """The singularity margin below which a state is near a rank loss: smaller for robots of small margins.

        Short levers, gears and many joints make margins of 1e-3 and less everywhere (Cassie's leg), where no rank is
        lost.
        """
        return min(NEAR_RANK_LOSS, 0.1 * typical_margin(self.system))

    @cached_property
    def _ample(self) -> float:
        """The singularity margin above which the independent rows are kept: at 1e-3 accelerations lose eight digits."""
        return min(0.1, 0.3 * typical_margin(self.system))

    # --- the rows at a configuration ---------------------------------------------------------------------------------

    def matrix(self, q: Array, basis: Array | None = None) -> tuple[Array, Array]:
        """Return K (p, p) and the closure residuals (r,) at q (nq,), without units; ``basis`` as in ``ClosedState``."""
        self.chain.use_basis(basis)
        self.chain.place(q)
        return self.chain.matrix(), self.chain.relative_residual()

    def _independent(self, q: Array, basis: Array | None, inverse: Array) -> tuple[Array | None, Array]:
        """Return the basis that serves at a closed configuration, and K⁻¹ with it.

        Independent rows serve while their margin is ample: rows of rounded numbers contradict each other, and singular
        values of the contradiction may exceed those of short levers.
        """
        plain = inverse if basis is None else inverses(self.matrix(q)[0][None])[0]
        size = float(np.nan_to_num(np.linalg.norm(plain), nan=np.inf))  # NaN where K is exactly singular
        if size * self._ample < 1.0:
            return None, plain
        self.chain.use_basis(None)
        self.chain.place(q)
        if not self.chain.renew_basis():
            return None, plain
        return self.chain.basis, inverses(self.chain.matrix()[None])[0]

    def closure_margin(self, q: Array, basis: Array | None = None, block: int | None = None) -> float:
        """Return the smallest singular value of the closure rows at q (nq,), of all or of one block of K.

        It has no unit, and is infinite without rows.
        """
        rows = self.matrix(q, basis)[0][: self.rank]
        if block is not None:
            own, columns = self.blocks[block]
            rows = rows[own[own < self.rank][:, None], columns]
        if not len(rows) or not np.isfinite(rows).all():
            return math.inf
        return float(np.linalg.svd(rows, compute_uv=False)[-1])

    def closures_lose_rank(self, q: Array, basis: Array | None = None) -> bool:
        """Return whether the closure rows are near a loss of rank at q (nq,); at a stretched leg they are not."""
        return self.closure_margin(q, basis) < 10.0 * self.near

    # --- a closed state ----------------------------------------------------------------------------------------------

    def close(self, guess: Array, x: Array, basis: Array | None = None) -> ClosedState | None:
        """Return the closed state at coordinates by Newton's method from a guess nearby; None where that fails.

        The method is undamped; ``assembly.newton`` is the damped one, and explains why both exist.

        Args:
            guess: (nq,) configuration.
            x: (n,) coordinates, or a pose (4, 4).
            basis: of a state nearby.

        Raises:
            InputError: configuration or coordinates of another shape.
        """
        self.require_shapes(guess, x)
        q, size, step = guess, math.inf, np.zeros(self._nv)
        rest = np.zeros(len(self._columns))
        for _ in range(_NEWTON_STEPS):
            K, phi = self.matrix(q, basis)
            rest[: self.rank] = -phi
            rest[self.rank :] = difference(self.robot, x, coordinates(self.robot, self.chain)) / self.unit
            before, size = size, math.sqrt(rest.dot(rest))
            factored, pivots, change, failed = lapack().dgesv(K, rest)
            if failed:
                return None
            longest = largest(change)
            if not longest < 1.0 or (size >= before and size > CLOSURE_TOLERANCE):
                return None
            step[self._columns] = change * self._step_unit
            q = self.integrate(q, step)
            settled = size < ROUNDED_RESIDUAL or longest < 10.0 * ROUNDED_RESIDUAL
            if settled or (size >= before and longest < SETTLED_STEP):
                inverse = lapack().dgetri(factored, pivots)[0]
                open_row = 0.0
                if self.system.has_dependent_rows:
                    basis, inverse = self._independent(q, basis, inverse)
                    open_row = largest(self.chain.every_row()[1])
                return self._closed(x, q, inverse, largest(rest), open_row, basis)
        return None

    def _closed(
        self, x: Array, q: Array, inverse: Array, residual: float, open_row: float, basis: Array | None
    ) -> ClosedState | None:
        vectors = self.chain.vectors  # axes that must coincide do, and are not turned over
        if not all(float(vectors[a : a + 3].dot(vectors[b : b + 3])) > _COS_TURNED_OVER for a, b in self._aligned):
            return None
        if not (residual < CLOSURE_TOLERANCE and open_row < self.system.dependent_tolerance):
            return None
        size = math.sqrt(inverse.ravel().dot(inverse.ravel()))
        gamma = np.zeros((self._nv, self.robot.n))
        gamma[self._columns] = inverse[:, self.rank :] * self._gamma_unit
        for array in (q, gamma, inverse):
            array.setflags(write=False)
        margin = 1.0 / size if size < 1.0 / SINGULAR_MARGIN else 0.0
        residual *= self.robot.characteristic_length
        blocks = self.blocks_of(basis)
        return ClosedState(self.robot, _kept(x), q, gamma, inverse, residual, margin, blocks, basis)

    def require_shapes(self, q: Array, x: Array) -> None:
        """Raise InputError where a configuration is not (nq,), or coordinates are not (n,), or a pose (4, 4)."""
        for given, name, shape in ((q, "q", (self._model.nq,)), (x, "x", self._shape)):
            if given.shape != shape:
                checked(given, name, shape)  # which raises

    def singular_state(
        self, x: Array, q: Array, gamma: Array, residual: float = 0.0, basis: Array | None = None
    ) -> ClosedState:
        """Return a closed configuration where K has no inverse, with Γ (nv, n) of the branch it is on."""
        arrays = _kept(x), _kept(q), _kept(gamma)
        return ClosedState(self.robot, *arrays, read_only(np.zeros((0, 0))), residual, 0.0, self.blocks, basis)

    def extrapolate(self, here: ClosedState, x: Array, bend: Array | None = None) -> ClosedState | None:
        """Return the state at coordinates x nearby by one step: predicted by Γ, corrected by Newton's method.

        None where Newton's method fails, where K is singular, or where the trapezoidal rule over Γ contradicts the
        step (``CONTINUITY``).

        Args:
            here: a state of the branch.
            x: (n,) coordinates, or a pose (4, 4).
            bend: (nv,) second-order term of the prediction, added to Γ Δx; zero where it is not small.
        """
        increment = difference(self.robot, x, here.x)
        predicted = here.gamma.dot(increment)
        if bend is not None and largest(bend) < _LARGEST_BEND * largest(predicted):
            predicted += bend
        new = self.close(self.integrate(here.q, predicted), x, here.basis)
        if new is None or not new.margin > 0.0:
            return None
        step = self.tangent(here.q, new.q)
        return new if self.is_continuous(step, here.gamma, new.gamma, increment) else None

    def is_continuous(
        self, step: Array, gamma0: Array, gamma1: Array, increment: Array, tolerance: float = CONTINUITY
    ) -> bool:
        """Return whether a tree displacement is what the trapezoidal rule over Γ predicts, or rounding.

        Args:
            step: (nv,) the displacement.
            gamma0: (nv, n) Γ at its start.
            gamma1: (nv, n) Γ at its end.
            increment: (n,) of the coordinates.
            tolerance: largest error relative to the prediction.
        """
        predicted = (0.5 * (gamma0 + gamma1)).dot(increment)
        return self.length(step - predicted) <= tolerance * self.length(predicted) + ROUNDING

    def rates(self, state: ClosedState, xd: Array, xdd: Array) -> Rates:
        """Return v = Γ ẋ and a (nv,): K a = (−J̇_c v, ẍ − J̇_x v).

        Args:
            state: a state where K has an inverse.
            xd: (n,) rates of the independent coordinates, or the twist of the platform.
            xdd: (n,) their second rates.

        Raises:
            InputError: rates of another shape, or not finite.
            SingularPoseError: K is singular there, so that it does not determine a; ``pass_through`` interpolates it.
        """
        for name, given in (("xd", xd), ("xdd", xdd)):
            if np.shape(given) != (self.robot.n,) or not math.isfinite(sum(given)):
                checked(given, name, (self.robot.n,))  # which raises
        if state.interpolated:
            raise SingularPoseError(
                f"K is singular at x = {np.array2string(state.x, precision=4)} and does not determine accelerations.",
                remedy="At a rank loss of the closures pass_through interpolates them along the branch.",
                margin=state.margin,
            )
        chain, v = self.chain, state.gamma.dot(xd)
        chain.use_basis(state.basis)
        chain.update(state.q, v)
        rest = -chain.full_bias() / chain.equation_unit
        rest[self.rank :] += xdd / self.unit
        a = np.zeros(self._nv)
        a[self._columns] = state.inverse.dot(rest) * self._step_unit
        return Rates(state, v, a)

    def identity_error(self, q: Array, x: Array, gamma: Array, basis: Array | None) -> tuple[float, float]:
        """Return how far q (nq,) and Γ (nv, n) are from closed at x: the residual, and K Γ − (0, 1) relative to Γ.

        Both without units. It judges states that were not closed by Newton's method.
        """
        K, phi = self.matrix(q, basis)
        off = np.append(phi, difference(self.robot, x, coordinates(self.robot, self.chain)) / self.unit)
        relative = gamma[self._columns] * (self.unit / self._step_unit[:, None])
        product = K.dot(relative)
        product[self.rank :] -= np.eye(self.robot.n)
        return largest(off), largest(product) / (1.0 + largest(relative))

    # --- configurations ----------------------------------------------------------------------------------------------

    def coordinates_at(self, q: Array) -> Array:
        """Return the independent coordinates (n,), or the pose (4, 4), of a configuration (nq,), closed or not."""
        self.chain.place(q)
        return read_only(coordinates(self.robot, self.chain))

    def length(self, step: Array) -> float:
        """Return the largest entry of a tree displacement (nv,), rad or characteristic lengths."""
        return largest(step * self._radians)

    def integrate(self, q: Array, step: Array) -> Array:
        """Return the configuration (nq,) that a tree displacement (nv,) leads to."""
        result: Array = q + step if self._flat else pin.integrate(self._model, q, step)
        return result

    def tangent(self, start: Array, end: Array) -> Array:
        """Return the tree displacement (nv,) between configurations (nq,)."""
        result: Array = end - start if self._flat else pin.difference(self._model, start, end)
        return result


def _kept(array: Array) -> Array:
    """Return a read-only array that no other code changes: itself if it is read-only, otherwise a copy."""
    return read_only(array.copy()) if array.flags.writeable else array


def largest(values: Array) -> float:
    """Return the largest magnitude of a few values, NaN where one is; numpy's own way takes four times as long."""
    numbers = values.ravel().tolist()
    return math.nan if math.isnan(sum(numbers)) else max(map(abs, numbers), default=0.0)


@lru_cache(maxsize=64)
def closed_around(system: ConstraintSystem) -> Assembly:
    """Return the reference configuration and those of some neighbours on its branch that close."""
    return evaluated(system, closed_neighbours(system, np.array(system.robot.q_reference), *_AROUND))


@lru_cache(maxsize=64)
def typical_margin(system: ConstraintSystem) -> float:
    """Return the largest singularity margin at the reference and some configurations around it; 1 where all are 0."""
    around = closed_around(system)
    return float(around.margin.max(where=around.closed, initial=0.0)) or 1.0


@lru_cache(maxsize=64)
def loop_blocks(system: ConstraintSystem) -> tuple[tuple[IntArray, IntArray], ...]:
    """Return rows and columns of the B diagonal blocks to which K can be permuted, one per loop or leg.

    det K is the product of theirs up to a sign, and they lose rank each by itself: two that change sign in one step
    leave that of det K. Columns j and k belong to one block if K⁻¹ K, the identity, comes about by entries that lead
    from j to k and back. Entries below 1e-9 of the largest, with open chains, are zero by the structure of the robot.
    """
    q, rng = np.array(system.robot.q_reference), np.random.default_rng(SEED)
    rows = system.relative(system.evaluate(draw_starts(system, q, 2, rng, spread=_AROUND[1])).K)
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
        everything = read_only(np.arange(size))
        return ((everything, everything),)
    return tuple((read_only(own), read_only(columns)) for own, columns in blocks)
