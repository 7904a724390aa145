"""The state of a machine in motion, and closed states to start from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked, frozen, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.state import lift
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.chain import ClosedChain


@dataclass(frozen=True, eq=False)
class State:
    """Configuration and velocity of the tree at one instant, and what a controller reads off them.

    Attributes:
        chain: evaluator of the robot; one for all states of a simulation.
        t: time, s.
        q: (nq,) configuration.
        v: (nv,) velocity.
    """

    chain: ClosedChain
    t: float
    q: Array
    v: Array

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
        self.chain.update(self.q, self.v)
        return self.chain.platform_position(), self.chain.platform_jacobian().dot(self.v)


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
        x: (n,) platform coordinates, m and rad, base frame, or a pose (4, 4); those of the reference configuration when
            left out.
        xd: (n,) their rate, m/s and rad/s (the twist for a pose); at rest when left out.
        s: scalar or (k,) carrier positions, m.
        sd: scalar or (k,) carrier speeds, m/s.
        t: time, s.

    Raises:
        InputError: wrong shapes.
        UnreachablePoseError, SingularPoseError, WorkingModeError: see ``kinematics.state.lift``.
    """
    chain = ClosedChain(robot)
    if x is None:
        chain.update(np.array(robot.q_reference), np.zeros(robot.model.nv))
        x = chain.platform_position()
    rate = np.zeros(robot.n) if xd is None else checked(xd, "xd", (robot.n,))
    motion = PlatformMotion([t], np.asarray(x, dtype=float)[None], rate[None], np.zeros((1, robot.n)))
    tree = lift(robot, motion)
    q, v = np.array(tree.q[0]), np.array(tree.v[0])
    q[robot.carrier_position] = _for_carriers(robot, s, "s")
    v[robot.carrier_velocity] = _for_carriers(robot, sd, "sd")
    return State(chain, float(t), read_only(q), read_only(v))


def tree_state(robot: Robot, q: ArrayLike, v: ArrayLike, *, t: float = 0.0) -> State:
    """Return a state from tree configuration and velocity; ``simulate`` checks that it is closed.

    Args:
        robot: the robot.
        q: (nq,) configuration.
        v: (nv,) velocity.
        t: time, s.

    Raises:
        InputError: wrong shapes or values that are not finite.
    """
    model = robot.model
    return State(ClosedChain(robot), float(t), checked(q, "q", (model.nq,)), checked(v, "v", (model.nv,)))


def _for_carriers(robot: Robot, values: ArrayLike, name: str) -> Array:
    given = np.atleast_1d(np.asarray(values, dtype=float))
    if given.shape not in ((1,), (robot.k,)):
        raise InputError(
            f"{name} has shape {given.shape}; {robot.name} has {robot.k} carrier(s).",
            remedy="Pass one number, or one for each carrier.",
        )
    return frozen(np.broadcast_to(given, (robot.k,)))
