"""One state, or one pose after another, fast: what a simulation and a controller ask for tens of thousands of times.

The rows are those of ``kinematics.closure``, whose batched evaluator walks the tree in numpy; at one configuration
Pinocchio's joint Jacobian and its rate are there already, an order of magnitude faster (``ClosedChain``).

``continuation`` and ``inverse_kinematics`` follow many poses at once, in numpy; for a single pose the calls cost a
hundred times the arithmetic. ``Tracker`` does predictor, Newton and their checks in tens of microseconds, and takes
only what is regular beyond doubt: Newton converges without a line search, the step is what Γ at both ends says, the
working mode stays, and no rank loss is near, nor could be within the step. Of everything else it returns None, and
leaves it to ``inverse_kinematics``.
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
from redundancy_pin.kinematics.assembly import SETTLED_STEP, TURNED_OVER, project
from redundancy_pin.kinematics.closure import PlacedRows, constraint_system
from redundancy_pin.kinematics.continuation import (
    ANCHOR_SPACING,
    CONTINUITY,
    NEAR_RANK_LOSS,
    ROUNDING,
    Point,
    near_rank_loss,
)
from redundancy_pin.kinematics.coordinates import angle_columns, mode_indicators, pose_rows, readings
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint, find_link_index
from redundancy_pin.robot.named import is_pose
from redundancy_pin.robot.scales import coordinate_unit, velocity_unit

_MOST_ITERATIONS = 10
_MOST_PIECES = 100
"""Longer ways are left to the batches of ``continuation``."""
_REACHED, _ROUNDED = 1e-13, 1e-14
"""A Newton step or a residual this small (rad, or characteristic lengths) is rounding."""


class ClosedChain:
    """Closure rows and platform rows of a robot at one state.

    An evaluator with a workspace: ``update`` sets the state, the other methods answer for it. It holds Pinocchio data,
    so each thread or process makes its own.

    Args:
        robot: the robot.

    Attributes:
        system: the batched evaluator of the same rows.
        rows: number r of closure rows.
        pose_columns: velocity indices that move the pose.
        closures: the closure rows, placed at the last state.
        vectors: (12 F,) axes and origin of each of Pinocchio's F frames, world axes, at the last state.
        J, dJ: (6, nv) joint Jacobian about the world origin and its rate, at the last state.
    """

    closures: PlacedRows

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = model = robot.model
        self.data = data = model.createData()
        self.system = system = constraint_system(robot)
        self.pose_columns, self.rows = system.pose_columns, len(system.rows)
        pin.framesForwardKinematics(model, data, np.array(robot.q_reference))
        self.vectors, self._copied = _frame_memory(model, data)
        platform = None
        if robot.platform is not None:
            platform = data.oMf[find_link_index(model, robot.platform.frame)]
        self._platform_pose = None if platform is None else (platform.rotation, platform.translation)
        self._is_pose = is_pose(robot)
        self._readings = readings(robot)
        joints = (find_joint(model, name) for name in robot.independent_joints)
        self._joints = [(int(joint.idx_q), joint.nq == 2) for joint in joints]
        self.J, self.dJ = (part.reshape(6, -1) for part in (data.J, data.dJ))  # Pinocchio drops the axis of one column

    def __reduce__(self) -> tuple[type[ClosedChain], tuple[Robot]]:
        """Make another one where this is copied or sent to: views into Pinocchio's memory would not be views there."""
        return ClosedChain, (self.robot,)

    def place(self, q: Array) -> None:
        """Set ``vectors`` and ``J`` at q (nq,), and nothing else: for those who place rows of their own."""
        pin.computeJointJacobians(self.model, self.data, q)
        self._update_frames()

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        pin.computeJointJacobiansTimeVariation(self.model, self.data, q, v)
        self._update_frames()
        self.q, self.v = q, v
        self.closures = self.system.closures.place(self.vectors, q)
        self._platform: PlacedRows | None = None  # closures alone are what most calls need

    def _update_frames(self) -> None:
        pin.updateFramePlacements(self.model, self.data)
        for target, source in self._copied:
            target[:] = source

    def residual(self) -> Array:
        """Return (r,) the closure residuals Φ, m; for rotation rows the sine of the angle that is off."""
        return self.closures.residual()

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        return self.closures.jacobian(self.J)

    def bias(self) -> Array:
        """Return J̇_c v (r,)."""
        return self.system.closures.bias_at(self.closures, self.J, self.dJ, self.v)

    def jacobian_rate(self) -> Array:
        """Return J̇_c (r, nv)."""
        return self.closures.jacobian_rate(self.J, self.dJ, self.v)

    def platform_position(self) -> Array:
        """Return the independent coordinates: (n,), or a pose (4, 4); see ``Platform``."""
        return self.coordinates(self.q)

    def coordinates(self, q: Array) -> Array:
        """Return the independent coordinates at the configuration (nq,) that was placed last."""
        if self._platform_pose is None:
            return np.array([math.atan2(q[i + 1], q[i]) if circle else q[i] for i, circle in self._joints])
        rotation, origin = self._platform_pose
        if self._is_pose:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, origin
            return pose
        values = []
        for sine, cosine in self._readings:
            if cosine is None:
                values.append(origin[sine[0]])
            elif cosine == sine:
                values.append(math.atan2(-rotation[sine], math.hypot(rotation[0, 0], rotation[1, 0])))
            else:
                values.append(math.atan2(rotation[sine], rotation[cosine]))
        return np.array(values)

    def platform_rows(self) -> PlacedRows:
        """Return the rows of the platform's twist, at the state."""
        if self._platform is None:
            self._platform = self.system.platform.place(self.vectors, self.q)
        return self._platform

    def platform_jacobian(self) -> Array:
        """Return J_x (n, nv): rows of the platform twist, world-aligned at its origin, or unit rows of joints."""
        if self._platform_pose is None:
            return self.system.independent
        return self.platform_rows().jacobian(self.J)

    def platform_jacobian_rate(self) -> Array:
        """Return J̇_x (n, nv)."""
        if self._platform_pose is None:
            return np.zeros_like(self.system.independent)
        return self.platform_rows().jacobian_rate(self.J, self.dJ, self.v)


def _frame_memory(model: pin.Model, data: pin.Data) -> tuple[Array, list[tuple[Array, Array]]]:
    """Return (12 F,) axes and origin of each frame, and what is to be copied into them after each update.

    Pinocchio keeps a placement as three axes and an origin, and one placement behind the other: its memory is the array
    itself. To copy it out frame by frame takes longer than all the arithmetic with it. Where the layout is another one
    (that of an alignment beyond eight bytes), it is copied all the same.
    """
    parts = [(data.oMf[i].rotation, data.oMf[i].translation) for i in range(model.nframes)]
    first = parts[0][0]
    start = _address(first)
    for i, (rotation, translation) in enumerate(parts):
        places = _address(rotation) - start, _address(translation) - start
        if places != (96 * i, 96 * i + 72) or rotation.strides != (8, 24) or translation.strides != (8,):
            break
    else:
        return np.lib.stride_tricks.as_strided(first, (12 * len(parts),), (8,), writeable=False), []
    vectors = np.zeros((len(parts), 4, 3))
    copied = [pair for v, (R, p) in zip(vectors, parts, strict=True) for pair in ((v[:3].T, R), (v[3], p))]
    return vectors.reshape(-1), copied


def _address(array: Array) -> int:
    address: int = array.__array_interface__["data"][0]  # ``array.ctypes.data`` takes ten times as long
    return address


# --- one pose after another ---------------------------------------------------------------------------------------


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
        self._scale = np.outer(chain.system.step_unit**-2.0, chain.system.equation_unit**2).ravel()
        self._unit, self._radians = 1.0 / coordinate_unit(robot), 1.0 / velocity_unit(robot)
        self._over_units, self._step_unit = 1.0 / chain.system.equation_unit, chain.system.step_unit
        self._fixed = chain.system.independent[:, self._columns] if robot.platform is None else None
        self._is_pose, self._turns = is_pose(robot), angle_columns(robot)
        self._pose_rows = pose_rows(robot)
        self._legs = list(zip(*(part.tolist() for part in mode_indicators(robot)[:2]), strict=True))
        ids = {name: 12 * find_link_index(robot.model, name) for name in chain.system.tree.support}
        self._aligned = [(ids[a] + 3 * k, ids[b] + 3 * k) for a, b, k in chain.system.aligned]
        reference = np.array(robot.q_reference)
        chain.place(reference)
        gamma = project(chain.system, chain.system.evaluate(reference[None])).gamma[0]
        self.home = Point(chain.coordinates(reference), reference, gamma)
        """The reference configuration; its Γ is NaN where that is singular."""

    def towards(self, start: Point, x: Array) -> Tracked | None:
        """Return the pose at x, (n,) or (4, 4), on the branch of a point, by steps along the straight line to it."""
        increment = self._difference(x, start.x)
        length = float(np.linalg.norm(increment * self._unit)) / ANCHOR_SPACING
        pieces = max(math.ceil(length), 1) if length < _MOST_PIECES else 0
        reached = None
        for piece in range(1, pieces + 1):
            target = x if piece == pieces else self._moved(start.x, increment * (piece / pieces))
            reached = self.step(start if reached is None else reached.point, target)
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

    def step(self, here: Point, x: Array) -> Tracked | None:
        """Return the point at a pose nearby by Newton's method, or None where it is not plainly on the branch."""
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
            relative = rest * self._over_units
            before, size = size, math.sqrt(relative.dot(relative))
            solved = self._solver(K, rest)
            if solved is None:
                return None
            change, inverted = solved
            longest = _largest(change / self._step_unit)
            if not longest < 1.0 or (size >= before and size > CLOSURE_TOLERANCE):
                return None
            step[columns] = change
            q = self._integrate(q, step)
            if size < _ROUNDED or longest < _REACHED or (size >= before and longest < SETTLED_STEP):
                return self._checked(here, Point(x, q, step), increment, placed, inverted(), _largest(relative))
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
        moved = q - here.q if self._flat else pin.difference(self._model, here.q, q)
        allowed = CONTINUITY * _largest(predicted * self._radians) + ROUNDING
        if (
            not gap < CLOSURE_TOLERANCE
            or not (size < 1.0 / NEAR_RANK_LOSS or size < 1.0 / near_rank_loss(self.chain.system))
            or not _largest((moved - predicted) * self._radians) <= allowed
            # a rank loss within the step leaves a margin, in scaled units, of about the way from it in radians: what is
            # on its other side is for ``continuation`` to tell
            or not size * _largest(moved * self._radians) < 1.0
        ):
            return None
        for column, turns in self._legs:  # every leg is, and was, on the same side
            new_side, old_side = float(q[column]), float(here.q[column])
            if not (math.sin(new_side) * math.sin(old_side) if turns else new_side * old_side) > 0.0:
                return None
        axes = self.chain.vectors  # those that must coincide do, and are not turned over
        if not all(float(axes[a : a + 3].dot(axes[b : b + 3])) > math.cos(TURNED_OVER) for a, b in self._aligned):
            return None
        for array in (q, gamma):
            array.setflags(write=False)
        return Tracked(new._replace(gamma=gamma), rows, inverse, gap * self.robot.characteristic_length, 1.0 / size)

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


Solver = Callable[[Array, Array], tuple[Array, Callable[[], Array]] | None]
"""From K and a residual to the step, and to K⁻¹ for those who need it; None where K is singular."""


def _by_numpy(K: Array, rest: Array) -> tuple[Array, Callable[[], Array]] | None:
    try:
        inverse = np.asarray(np.linalg.inv(K), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return inverse.dot(rest), lambda: inverse


def _by_lapack() -> Solver:
    """Return a solver that takes a quarter of the time, once scipy is imported."""
    from scipy.linalg import lapack

    def solve(K: Array, rest: Array) -> tuple[Array, Callable[[], Array]] | None:
        decomposed, pivots, step, failed = lapack.dgesv(K, rest)
        return None if failed else (step, lambda: lapack.dgetri(decomposed, pivots)[0])

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
