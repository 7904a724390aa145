"""Analytic derivatives of closed-chain dynamics in minimal coordinates: platform and carriers.

With ζ = (ẋ, ṡ), v = N ζ and a = N ζ̇ + a₀, the equation of motion is Nᵀ e = 0, e = rnea(q, v, a) − u. Its variation over
states on the closures is

    Nᵀ [(∂rnea/∂q − H) δq + ∂rnea/∂v δv + M δa − δu] = 0,    H = ∂(Kᵀμ)/∂q,  μ = K⁻ᵀ e,

where H is what the change of N does (δN = −K⁻¹ δK N), and from the rows K v = (0, ẋ)

    δq = N δy,   δv = N δζ − K⁻¹ (Kv)_q δq,   δa = N δζ̇ − K⁻¹ [(Ka + K̇v)_q δq + (Ka + K̇v)_v δv].

Pinocchio gives the derivatives of rnea. Nothing here is singular at a type II pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import RANK_TOLERANCE, Array, read_only
from redundancy_pin.errors import SingularPoseError, UnsupportedRobotError
from redundancy_pin.kinematics.coordinates import row_scale, velocity_scale
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.chain import ClosedChain
from redundancy_pin.simulation.row_rates import row_rates


@dataclass(frozen=True, eq=False)
class DynamicsDerivatives:
    """Derivatives in minimal coordinates y = (x, s), ζ = (ẋ, ṡ); d = n + k.

    For a platform with all three rotations δx is a translation of its origin and a world-aligned rotation vector.

    Attributes:
        basis: (nv, d) N, tree velocity per unit of ζ.
        mass: (d, d) Nᵀ M N, the derivative of the generalised force by ζ̇.
        force: (d,) Nᵀ (rnea − u): zero where the motion obeys the equations.
        force_y, force_z: (d, d) its derivatives by y and ζ, u and ζ̇ held.
        input: (d, m + k) Nᵀ (Sᵀ, Cᵀ): generalised force per unit of main efforts and carrier forces.
        rate_y: (d, d) derivative of ẏ by y, ζ held: zero but for the rotations of a pose, where it is ω ×.
    """

    basis: Array
    mass: Array
    force: Array
    force_y: Array
    force_z: Array
    input: Array
    rate_y: Array


def inverse_derivatives(
    robot: Robot, q: Array, v: Array, a: Array, tau: Array | None = None, carrier_force: Array | None = None
) -> DynamicsDerivatives:
    """Return the derivatives of inverse dynamics at a state in motion.

    Without efforts, ``force`` is the generalised force (f, F) that the motion takes; with the efforts that act, it is
    what they miss, and its derivatives are those of forward dynamics up to −``mass``⁻¹.

    Args:
        robot: the robot.
        q: (nq,) closed configuration.
        v: (nv,) velocity that the closures allow.
        a: (nv,) acceleration that goes with it.
        tau: (m,) main efforts, N or N·m; none when left out.
        carrier_force: (k,) carrier forces, N.

    Raises:
        UnsupportedRobotError: a joint has more than one freedom.
        SingularPoseError: a type I pose, where (x, s) are no coordinates.
    """
    _require_single(robot)
    return _derivatives(ClosedChain(robot), q, v, a, tau, carrier_force)


def _derivatives(
    chain: ClosedChain, q: Array, v: Array, a: Array, tau: Array | None, carrier_force: Array | None
) -> DynamicsDerivatives:
    robot, model, data = chain.robot, chain.model, chain.data
    rows = row_rates(chain, q, v, a)
    inverse = _inverse(robot, chain, rows.K)
    basis = np.zeros((model.nv, robot.n + robot.k))
    basis[:, : robot.n] = inverse[:, chain.rows :]
    basis[robot.carrier_velocity, robot.n + np.arange(robot.k)] = 1.0
    by_q, by_v, mass = (np.array(part) for part in pin.computeRNEADerivatives(model, data, q, v, a))
    mass = np.triu(mass) + np.triu(mass, 1).T
    missing = np.array(pin.rnea(model, data, q, v, a))
    selection = np.zeros((model.nv, robot.m + robot.k))
    selection[robot.actuated_velocity, np.arange(robot.m)] = 1.0
    selection[robot.carrier_velocity, robot.m + np.arange(robot.k)] = 1.0
    if tau is not None:
        missing -= selection[:, : robot.m] @ tau
    if carrier_force is not None:
        missing -= selection[:, robot.m :] @ carrier_force
    turned = _row_force_derivative(chain, q, inverse.T @ missing)
    q_y = basis
    v_y = -inverse @ (rows.by_q @ q_y)
    a_y = -inverse @ (rows.rate_by_q @ q_y + rows.rate_by_v @ v_y)
    a_z = -inverse @ (rows.rate_by_v @ basis)
    return DynamicsDerivatives(
        basis=read_only(basis),
        mass=read_only(basis.T @ mass @ basis),
        force=read_only(basis.T @ missing),
        force_y=read_only(basis.T @ ((by_q - turned) @ q_y + by_v @ v_y + mass @ a_y)),
        force_z=read_only(basis.T @ (by_v @ basis + mass @ a_z)),
        input=read_only(basis.T @ selection),
        rate_y=read_only(_turning(robot, rows.K[chain.rows :] @ v)),
    )


def _inverse(robot: Robot, chain: ClosedChain, K: Array) -> Array:
    """Return (nv, r + n) the inverse of K, carrier rows zero.

    Raises:
        SingularPoseError: a type I pose.
    """
    columns = chain.pose_columns
    scale = velocity_scale(robot)[columns]
    rows = np.concatenate([np.ones(chain.rows), row_scale(robot)])
    scaled = K[:, columns] / scale * rows[:, None]
    values = np.linalg.svd(scaled, compute_uv=False)
    if values[-1] <= RANK_TOLERANCE * values[0]:
        raise SingularPoseError(
            f"{robot.name} is at a type I pose (margin {values[-1]:.3g}): platform and carriers do not describe its "
            "motion there.",
            remedy="Linearise at another pose.",
            margin=float(values[-1]),
        )
    inverse = np.zeros((robot.model.nv, len(K)))
    inverse[columns] = np.linalg.inv(K[:, columns])
    return inverse


def _row_force_derivative(chain: ClosedChain, q: Array, multiplier: Array) -> Array:
    """Return (nv, nv) the derivative of Kᵀμ by q, μ held: K̇ is linear in v, so unit velocities give its parts."""
    model = chain.model
    result = np.empty((model.nv, model.nv))
    closures, platform = multiplier[: chain.rows], multiplier[chain.rows :]
    for j in range(model.nv):
        unit = np.zeros(model.nv)
        unit[j] = 1.0
        chain.update(q, unit)
        result[:, j] = closures @ chain.jacobian_rate() + platform @ chain.platform_jacobian_rate()
    return result


def _turning(robot: Robot, rate: Array) -> Array:
    """Return (d, d) the derivative of ẏ by y: for rotation vectors d(δθ)/dt = δω + ω × δθ."""
    result = np.zeros((robot.n + robot.k, robot.n + robot.k))
    if robot.platform is not None and robot.platform.is_pose:
        at = [robot.platform.axes.index(axis) for axis in ("rx", "ry", "rz")]
        x, y, z = rate[at]
        result[np.ix_(at, at)] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    return result


def _require_single(robot: Robot) -> None:
    model = robot.model
    for j in range(1, model.njoints):
        if model.joints[j].nv != 1:
            raise UnsupportedRobotError(
                f"Joint {str(model.names[j])!r} has {model.joints[j].nv} freedoms; derivatives cover joints of one.",
                remedy="Build it from joints of one freedom each.",
                joint=str(model.names[j]),
            )
