"""One pose after another, at one state: predictor, Newton and the checks of ``continuation`` in tens of microseconds.

``continuation`` and ``lift`` work on many poses at once, in numpy; for a single pose the calls cost a hundred times the
arithmetic. Here rows and Jacobians come from Pinocchio (``kinematics.chain``), and only what is plainly regular is
taken: Newton converges without a line search, the step is what Γ at both ends says, the sign of det K and the working
mode stay, and no rank loss is near. Everything else is None, and for those who have time.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.kinematics.assembly import SETTLED_STEP, TURNED_OVER, project, projection_scale
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.closure import PlacedRows
from redundancy_pin.kinematics.continuation import (
    ANCHOR_SPACING,
    CONTINUITY,
    NEAR_RANK_LOSS,
    ROUNDING,
    Point,
    near_rank_loss,
)
from redundancy_pin.kinematics.coordinates import angle_columns, mode_indicators, pose_rows, row_scale
from redundancy_pin.robot import Robot
from redundancy_pin.robot.named import is_pose

_MOST_ITERATIONS = 10
_MOST_PIECES = 100
"""Longer ways are left to the batches of ``continuation``."""
_REACHED, _ROUNDED = 1e-13, 1e-14
"""A Newton step (rad, m) or a residual (m, rad) this small is rounding."""


class Tracked(NamedTuple):
    """A pose reached on a branch: the point, the rows there, K⁻¹ (p, r + n), residual (m or rad), scaled margin."""

    point: Point
    rows: PlacedRows
    inverse: Array
    gap: float
    margin: float


class Tracker:
    """Follows a branch from pose to pose; holds Pinocchio data, see ``tracker``.

    Args:
        robot: the robot.
        solver: what solves K step = residual.
    """

    def __init__(self, robot: Robot, solver: Solver) -> None:
        self._solver = solver
        self.chain = chain = ClosedChain(robot)
        self.robot, self._model, self._rows = robot, robot.model, chain.system.all_rows
        self._columns, self._closures, nv = chain.pose_columns, chain.rows, robot.model.nv
        self._flat = robot.model.nq == nv
        self._scale = projection_scale(chain.system).ravel()
        self._unit = row_scale(robot)
        self._longest = ANCHOR_SPACING * robot.characteristic_length
        self._fixed = chain.system.independent[:, self._columns] if robot.platform is None else None
        self._is_pose, self._turns = is_pose(robot), angle_columns(robot)
        self._pose_rows = pose_rows(robot)
        self._legs = list(zip(*(part.tolist() for part in mode_indicators(robot)[:2]), strict=True))
        ids = {name: 12 * robot.model.getFrameId(name, pin.FrameType.BODY) for name in chain.system.tree.support}
        self._aligned = [(ids[a] + 3 * k, ids[b] + 3 * k) for a, b, k in chain.system.aligned]
        reference = np.array(robot.q_reference)
        chain.place(reference)
        gamma = project(chain.system, chain.system.evaluate(reference[None])).gamma[0]
        self.home = Point(chain.coordinates(reference), reference, gamma, self.side(reference))
        """The reference configuration; its Γ is NaN where that is singular."""

    def side(self, q: Array) -> float:
        """Return the sign of det K at a configuration (nq,)."""
        return float(np.linalg.slogdet(self.chain.system.evaluate(q[None]).K[0])[0])

    def towards(self, start: Point, x: Array) -> Tracked | None:
        """Return the pose at x, (n,) or (4, 4), on the branch of a point, by steps along the straight line to it."""
        increment = self._difference(x, start.x)
        length = float(np.linalg.norm(increment * self._unit)) / self._longest
        pieces = max(math.ceil(length), 1) if length < _MOST_PIECES else 0
        reached = None
        for piece in range(1, pieces + 1):
            target = x if piece == pieces else self._moved(start.x, increment * (piece / pieces))
            reached = self._step(start if reached is None else reached.point, target)
            if reached is None:
                return None
        return reached

    def rates(self, tracked: Tracked, xd: Array, xdd: Array) -> tuple[Array, Array]:
        """Return v and a (nv,) at a pose, for rates (n,) of the independent coordinates."""
        chain, v = self.chain, tracked.point.gamma.dot(xd)
        pin.computeJointJacobiansTimeVariation(self._model, chain.data, tracked.point.q, v)
        rest = np.zeros(len(self._columns))
        rest[self._closures :] = xdd
        rest[: self._rows.size] -= self._rows.bias_at(tracked.rows, chain.J, chain.dJ, v)
        a = np.zeros(len(v))
        a[self._columns] = tracked.inverse.dot(rest)
        return v, a

    def _step(self, here: Point, x: Array) -> Tracked | None:
        chain, columns, r = self.chain, self._columns, self._closures
        increment = self._difference(x, here.x)
        q = self._integrate(here.q, here.gamma.dot(increment))
        step, rest, size = np.zeros(self._model.nv), np.zeros(len(columns)), math.inf
        for _ in range(_MOST_ITERATIONS):
            chain.place(q)
            placed = self._rows.place(chain.vectors, q)
            K = placed.jacobian(chain.J).take(columns, 1)
            if self._fixed is not None:
                K = np.concatenate([K, self._fixed])
            rest[:r] = placed.residual()[:r]
            rest[:r] *= -1.0
            rest[r:] = self._difference(x, chain.coordinates(q))
            before, size = size, math.sqrt(rest.dot(rest))
            solved = self._solver(K, rest)
            if solved is None:
                return None
            change, inverted = solved
            longest = _largest(change)
            if not longest < 1.0 or (size >= before and size > CLOSURE_TOLERANCE):
                return None
            step[columns] = change
            q = self._integrate(q, step)
            if size < _ROUNDED or longest < _REACHED or (size >= before and longest < SETTLED_STEP):
                inverse, side = inverted()
                return self._checked(here, Point(x, q, step, side), increment, placed, inverse, _largest(rest))
        return None

    def _checked(
        self, here: Point, new: Point, increment: Array, rows: PlacedRows, inverse: Array, gap: float
    ) -> Tracked | None:
        """Return the new point with its Γ, if it is plainly on the branch."""
        q = new.q
        size = math.sqrt((inverse * inverse).ravel().dot(self._scale))
        gamma = np.zeros((self._model.nv, self.robot.n))
        gamma[self._columns] = inverse[:, self._closures :]
        predicted = (0.5 * (here.gamma + gamma)).dot(increment)
        missed = (q - here.q if self._flat else pin.difference(self._model, here.q, q)) - predicted
        allowed = CONTINUITY * _largest(predicted) + ROUNDING
        if (
            not gap < CLOSURE_TOLERANCE
            or not (size < 1.0 / NEAR_RANK_LOSS or size < 1.0 / near_rank_loss(self.chain.system))
            or not _largest(missed) <= allowed
            or new.side * here.side < 0.0
            or not self._in_mode(q, here.q)
            or not self._upright()
        ):
            return None
        for array in (q, gamma):
            array.setflags(write=False)
        return Tracked(new._replace(gamma=gamma), rows, inverse, gap, 1.0 / size)

    def _in_mode(self, q: Array, before: Array) -> bool:
        """Return whether every leg is, and was, on the same side."""
        for column, turns in self._legs:
            new, old = float(q[column]), float(before[column])
            if not (math.sin(new) * math.sin(old) if turns else new * old) > 0.0:
                return False
        return True

    def _upright(self) -> bool:
        """Return whether axes that must coincide do, and are not turned over."""
        axes = self.chain.vectors
        return all(float(axes[a : a + 3].dot(axes[b : b + 3])) > math.cos(TURNED_OVER) for a, b in self._aligned)

    def _integrate(self, q: Array, step: Array) -> Array:
        result: Array = q + step if self._flat else pin.integrate(self._model, q, step)
        return result

    def _difference(self, target: Array, start: Array) -> Array:
        """Return ``coordinates.difference`` of one pose."""
        if self._is_pose:
            turn = pin.log3(target[:3, :3].dot(start[:3, :3].T))
            return np.concatenate([target[:3, 3] - start[:3, 3], turn])[self._pose_rows]
        delta = target - start
        for k in self._turns:
            delta[k] = (delta[k] + math.pi) % (2.0 * math.pi) - math.pi
        return delta

    def _moved(self, start: Array, increment: Array) -> Array:
        if not self._is_pose:
            result: Array = start + increment
            return result
        full, pose = np.zeros(6), start.copy()
        full[self._pose_rows] = increment
        pose[:3, 3] += full[:3]
        pose[:3, :3] = pin.exp3(full[3:]).dot(start[:3, :3])
        return pose


def _largest(values: Array) -> float:
    """Return the largest magnitude of a few values; numpy's way takes three times as long."""
    return max(map(abs, values.tolist()), default=0.0)


Solver = Callable[[Array, Array], tuple[Array, Callable[[], tuple[Array, float]]] | None]
"""From K and a residual to the step, and to K⁻¹ and the sign of det K for those who need them; None where K is
singular."""


def _by_numpy(K: Array, rest: Array) -> tuple[Array, Callable[[], tuple[Array, float]]] | None:
    try:
        inverse = np.asarray(np.linalg.inv(K), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return inverse.dot(rest), lambda: (inverse, float(np.linalg.slogdet(K)[0]))


def _by_lapack() -> Solver:
    """Return a solver that takes a quarter of the time, once scipy is imported."""
    from scipy.linalg import lapack

    def solve(K: Array, rest: Array) -> tuple[Array, Callable[[], tuple[Array, float]]] | None:
        decomposed, pivots, step, failed = lapack.dgesv(K, rest)

        def inverted() -> tuple[Array, float]:
            # each row that the decomposition swaps turns the sign of the determinant over
            turned = (pivots != np.arange(len(pivots))) ^ (decomposed.diagonal() < 0.0)
            return lapack.dgetri(decomposed, pivots)[0], -1.0 if np.count_nonzero(turned) % 2 else 1.0

        return None if failed else (step, inverted)

    return solve


@lru_cache(maxsize=32)
def _tracker(robot: Robot, many: bool, thread: int) -> Tracker:
    return Tracker(robot, _by_lapack() if many else _by_numpy)


def tracker(robot: Robot, *, many: bool = False) -> Tracker:
    """Return the tracker of a robot in this thread, made once: it is a workspace, and no two threads share one.

    Args:
        robot: the robot.
        many: for those who ask so often that it pays to import scipy.
    """
    return _tracker(robot, many, threading.get_ident())
