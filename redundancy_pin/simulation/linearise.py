"""Linearised forward dynamics along the closures, for controllers: finite at type II poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.kinematics.coordinates import difference
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.derivatives import inverse_derivatives
from redundancy_pin.simulation.forward import ForwardDynamics
from redundancy_pin.simulation.state import State


@dataclass(frozen=True, eq=False)
class Linearisation:
    """d(δz)/dt = A δz + B δu about a state, δz = (δx, δs, δẋ, δṡ), δu = (δτ, δF); d = n + k.

    For a platform with all three rotations δx is a translation of its origin and a world-aligned rotation vector; see
    ``state_error``.

    Attributes:
        A: (2d, 2d).
        B: (2d, m + k).
        acceleration: (d,) (ẍ, s̈) at the state, m/s² and rad/s².
        a: (nv,) tree acceleration there.
    """

    A: Array
    B: Array
    acceleration: Array
    a: Array


def linearise(robot: Robot, state: State, tau: Array, carrier_force: Array | None = None) -> Linearisation:
    """Linearise forward dynamics in platform and carrier coordinates, analytically.

    Args:
        robot: the robot.
        state: a closed state.
        tau: (m,) main efforts there, N or N·m.
        carrier_force: (k,) carrier forces, N; none when left out.

    Raises:
        SingularPoseError: a type I pose, where platform and carriers are no coordinates.
        IllPosedModelError: a free motion has no inertia.
        UnsupportedRobotError: a joint has more than one freedom.
    """
    force = np.zeros(robot.model.nv)
    force[robot.actuated_velocity] = tau
    loads = np.zeros(robot.k) if carrier_force is None else np.asarray(carrier_force, dtype=float)
    force[robot.carrier_velocity] = loads
    dynamics = ForwardDynamics(robot)
    dynamics.adapt(state.q)
    a = dynamics.acceleration(state.q, state.v, force)
    found = inverse_derivatives(robot, state.q, state.v, a, np.asarray(tau, dtype=float), loads)
    d = robot.n + robot.k
    solved = np.linalg.solve(found.mass, np.concatenate([-found.force_y, -found.force_z, found.input], axis=1))
    A = np.zeros((2 * d, 2 * d))
    A[:d, :d], A[:d, d:] = found.rate_y, np.eye(d)
    A[d:] = solved[:, : 2 * d]
    B = np.zeros((2 * d, robot.m + robot.k))
    B[d:] = solved[:, 2 * d :]
    dynamics.chain.update(state.q, state.v)
    chain = dynamics.chain
    platform = chain.platform_jacobian() @ a + chain.platform_jacobian_rate() @ state.v
    return Linearisation(
        read_only(A), read_only(B), read_only(np.concatenate([platform, a[robot.carrier_velocity]])), read_only(a)
    )


def state_error(robot: Robot, state: State, x: Array, xd: Array, s: Array, sd: Array) -> Array:
    """Return δz (2d,), the state less a reference, in the coordinates of ``Linearisation``.

    Args:
        robot: the robot.
        state: where the machine is.
        x: (n,) reference coordinates, or a pose (4, 4).
        xd: (n,) their rate.
        s: (k,) reference positions of the carriers, m.
        sd: (k,) their speeds, m/s.
    """
    away = difference(robot, np.array(state.x)[None], np.array(x)[None])[0]
    return np.concatenate([away, state.s - s, state.xd - xd, state.sd - sd])
