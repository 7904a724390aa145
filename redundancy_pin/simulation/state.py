"""The state of a machine in motion, and closed states to start from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from redundancy_pin.arrays import Array, Frozen, checked, each, read_only
from redundancy_pin.dynamics.forward import ForwardKernel
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot

PROJECTION_TOLERANCE = 1e-13
"""Closure residual, rad or characteristic lengths, at which the projection is done: rounding is 1e-16 a row."""

LARGEST_RESIDUAL = 1e-9
"""Closure residual, rad or characteristic lengths, above which a projected step of a simulation fails."""

_MOST_STEPS = 8
"""From the end of an integration step, 1e-9 off, two Newton steps reach rounding."""


class Manifold:
    """Projection of states onto closures and their rates, one state at a time.

    The steps are the shortest ones in scaled coordinates (rotations times the characteristic length), and leave the
    carriers alone, and joints that are ``held`` (tree velocities at zero).

    Attributes:
        tolerance: closure residual, m, at which the projection is done.
        largest_residual: closure residual, m, above which a projected step of a simulation fails.
    """

    def __init__(self, chain: ClosedChain, held: Sequence[int] = ()) -> None:
        self.chain, self._held = chain, np.array(held, dtype=np.intp)
        self._moving = ~np.isin(chain.pose_columns, self._held)
        self._columns = chain.pose_columns[self._moving]
        self._unit = chain.system.step_unit[self._moving]
        self.tolerance = PROJECTION_TOLERANCE * chain.robot.characteristic_length
        self.largest_residual = LARGEST_RESIDUAL * chain.robot.characteristic_length
        self._turning_numbers = chain.model.nq != chain.model.nv

    def project(self, q: Array, v: Array) -> tuple[Array, Array, float, float]:
        """Return a closed configuration (nq,), a velocity (nv,) it allows, the closure residual before and after, m."""
        chain = self.chain
        q = pin.normalize(chain.model, q) if self._turning_numbers else q.copy()
        v = v.copy()
        v[self._held] = 0.0
        largest, before = 0.0, -1.0
        for _ in range(_MOST_STEPS):
            chain.update(q, v)
            largest = chain.largest_residual()
            before = largest if before < 0.0 else before
            if largest <= self.tolerance:
                break
            step = np.zeros(len(v))
            step[self._columns] = -self._shortest(chain.closure_rows()[:, self._moving], chain.relative_residual())
            q = pin.integrate(chain.model, q, step)
        # velocities last: the closures allow velocities at the projected configuration
        jacobian = chain.closure_rows()[:, self._moving]
        v[self._columns] -= self._shortest(jacobian, jacobian.dot(v[self._columns] / self._unit))
        return q, v, before, largest

    def _shortest(self, jacobian: Array, rate: Array) -> Array:
        """Return (p,) the shortest velocity of the pose with J_c v = rate, by J_c (r, p) and rate without units."""
        if not len(rate):
            return np.zeros(len(self._columns))
        _, multiplier, failed = lapack.dposv(jacobian.dot(jacobian.T), rate)
        if failed:  # the closures have lost rank: the partition raises it
            return np.zeros(len(self._columns))
        step: Array = self._unit * jacobian.T.dot(multiplier)
        return step


@dataclass(frozen=True, eq=False)
class State(Frozen):
    """Configuration and velocity of the tree at one instant, and what a controller reads off them.

    Attributes:
        chain: evaluator of the robot; one for all states of a simulation.
        t: time, s.
        q: (nq,) configuration.
        v: (nv,) velocity.
        kernel: machine code for the platform's coordinates and rates; None where ``chain`` computes them.
    """

    chain: ClosedChain
    t: float
    q: Array
    v: Array
    kernel: ForwardKernel | None = None

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.chain.robot

    @property
    def s(self) -> Array:
        """(k,) carrier positions, m."""
        return self.q[self.robot.carrier_position]

    @property
    def sd(self) -> Array:
        """(k,) carrier speeds, m/s."""
        return self.v[self.robot.carrier_velocity]

    @property
    def actuated_rate(self) -> Array:
        """(m,) rates of the main actuators, m/s or rad/s."""
        return self.v[self.robot.actuated_velocity]

    @property
    def x(self) -> Array:
        """(n,) platform coordinates, base frame, m and rad, or a pose (4, 4)."""
        return self._platform[0]

    @property
    def xd(self) -> Array:
        """(n,) their rate, m/s and rad/s; the twist (linear, angular), world-aligned, for a pose."""
        return self._platform[1]

    @cached_property
    def _platform(self) -> tuple[Array, Array]:
        if self.kernel is not None:
            return self.kernel.platform(self.q, self.v)
        self.chain.update(self.q, self.v)
        return coordinates(self.chain.robot, self.chain), self.chain.platform_jacobian().dot(self.v)


def closed_state(
    robot: Robot,
    x: ArrayLike | None = None,
    xd: ArrayLike | None = None,
    s: ArrayLike = 0.0,
    sd: ArrayLike = 0.0,
    *,
    t: float = 0.0,
) -> State:
    """Return a closed state in the working mode of the robot.

    Args:
        robot: the robot.
        x: (n,) platform coordinates, m and rad, base frame, or a pose (4, 4); at the reference configuration when
            left out.
        xd: (n,) their rate, m/s and rad/s (the twist for a pose); at rest when left out.
        s: scalar or (k,) carrier positions, m.
        sd: scalar or (k,) carrier speeds, m/s.
        t: time, s.

    Raises:
        InputError: wrong shapes.
        UnreachablePoseError, SingularPoseError, WorkingModeError: see ``inverse_kinematics``.

    Example:
        >>> from redundancy_pin.simulation import closed_state
        >>> closed_state(rp.load_robot("2rpr"), xd=[0.1, 0.0]).xd.round(3)
        array([0.1, 0. ])
    """
    chain = ClosedChain(robot)
    if x is None:
        x = follower(robot).home.x
    rate = np.zeros(robot.n) if xd is None else checked(xd, "xd", (robot.n,))
    motion = PlatformMotion([t], np.asarray(x, dtype=float)[None], rate[None], np.zeros((1, robot.n)))
    tree = inverse_kinematics(robot, motion)
    q, v = np.array(tree.q[0]), np.array(tree.v[0])
    q[robot.carrier_position] = each(s, "s", (robot.k,))
    v[robot.carrier_velocity] = each(sd, "sd", (robot.k,))
    return State(chain, float(t), read_only(q), read_only(v))


def tree_state(robot: Robot, q: ArrayLike, v: ArrayLike, *, t: float = 0.0) -> State:
    """Return a state from q (nq,) and v (nv,) of the tree at time t, s; ``simulate`` checks that it is closed.

    Raises:
        InputError: wrong shapes or values that are not finite.

    Example:
        >>> from redundancy_pin.simulation import tree_state
        >>> robot = rp.load_robot("four_bar")
        >>> tree_state(robot, robot.q_reference, np.zeros(3)).x.shape
        (1,)
    """
    model = robot.model
    return State(ClosedChain(robot), float(t), checked(q, "q", (model.nq,)), checked(v, "v", (model.nv,)))
