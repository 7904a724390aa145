"""Analytic derivatives of closed-chain dynamics in minimal coordinates: platform and carriers.

With ζ = (ẋ, ṡ), v = N ζ and a = N ζ̇ + a₀, the equation of motion is Nᵀ e = 0, e = rnea(q, v, a) − u. Its variation over
states on the closures is

    Nᵀ [(∂rnea/∂q − H) δq + ∂rnea/∂v δv + M δa − δu] = 0,    H = ∂(Kᵀμ)/∂q,  μ = K⁻ᵀ e,

where H is what the change of N does (δN = −K⁻¹ δK N), and from the rows K v = (0, ẋ)

    δq = N δy,   δv = N δζ − K⁻¹ (Kv)_q δq,   δa = N δζ̇ − K⁻¹ [(Ka + K̇v)_q δq + (Ka + K̇v)_v δv].

Pinocchio gives the derivatives of rnea. Nothing here is singular at a type II pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import RANK_TOLERANCE, Array, Frozen, read_only
from redundancy_pin.dynamics.forward import ForwardKernel, LinearParts
from redundancy_pin.errors import SingularPoseError, UnsupportedRobotError
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import difference
from redundancy_pin.robot import Payload, Robot
from redundancy_pin.robot.scales import row_scale, velocity_scale
from redundancy_pin.simulation.forward import ForwardDynamics
from redundancy_pin.simulation.state import State


class RowDerivatives(NamedTuple):
    """K (r + n, nv), the closure rows over the platform rows, and derivatives along a motion (q, v, a), K-shaped.

    ``by_q``: derivative of K v by q at fixed v; ``rate_by_q`` and ``rate_by_v``: of K a + K̇ v, all else fixed.
    """

    K: Array
    by_q: Array
    rate_by_q: Array
    rate_by_v: Array


def row_derivatives(chain: ClosedChain, q: Array, v: Array, a: Array) -> RowDerivatives:
    """Evaluate K and its derivatives.

    For a row that is the differential of a function φ of q, and joints of one freedom each, variations and time
    derivatives commute: δφ̇ = J̇ δq + J δv and δφ̈ = J̈ δq + 2 J̇ δv + J δa. World-aligned rotation rows of the platform are
    no differentials: with δθ = J δq, δω = d(δθ)/dt + δθ × ω.
    """
    J, dJ, ddJ = _world_columns(chain, q, v, a)
    K, Kd, Kdd = chain.placed.time_derivatives(J, dJ, ddJ, v, a)
    robot, r = chain.robot, chain.rows
    if robot.platform is None:  # unit rows
        still = np.zeros((robot.n, robot.model.nv))
        K, Kd, Kdd = map(np.concatenate, ((K, chain.system.independent), (Kd, still), (Kdd, still)))
    by_q, rate_by_q, rate_by_v = Kd.copy(), Kdd.copy(), 2.0 * Kd
    if robot.platform is not None and robot.platform.is_pose:
        turning = [r + robot.platform.axes.index(axis) for axis in ("rx", "ry", "rz")]
        spin, spin_rate = (pin.skew(rows[turning] @ motion) for rows, motion in ((K, v), (K, a)))
        spin_rate += pin.skew(Kd[turning] @ v)
        by_q[turning] -= spin @ K[turning]
        rate_by_q[turning] -= spin @ Kd[turning] + spin_rate @ K[turning]
        rate_by_v[turning] -= spin @ K[turning]
    return RowDerivatives(K, by_q, rate_by_q, rate_by_v)


def _world_columns(chain: ClosedChain, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
    """Return (6, nv) the joint Jacobian at the world origin, and its first and second time derivative.

    A column is fixed in the body that its joint moves: X' = V × X and X'' = A × X + V × X', spatial cross products with
    the velocity V and acceleration A of that body.
    """
    model, data = chain.model, chain.data
    chain.update(q, v)
    pin.computeForwardKinematicsDerivatives(model, data, q, v, a)
    J, dJ = chain.J.copy(), chain.dJ.copy()
    ddJ = np.empty_like(J)
    for joint in list(model.joints)[1:]:
        column, velocity = pin.Motion(J[:, joint.idx_v]), data.ov[joint.id]
        ddJ[:, joint.idx_v] = (data.oa[joint.id].cross(column) + velocity.cross(velocity.cross(column))).vector
    return J, dJ, ddJ


@dataclass(frozen=True, eq=False)
class DynamicsDerivatives(Frozen):
    """Derivatives in minimal coordinates y = (x, s), ζ = (ẋ, ṡ); d = n + k.

    For a platform with all three rotations δx is a translation of its origin and a world-aligned rotation vector.

    Attributes:
        basis: (nv, d) N, tree velocity per unit of ζ.
        mass: (d, d) Nᵀ M N, the derivative of the generalised force by ζ̇.
        force: (d,) Nᵀ (rnea − u): zero where the motion obeys the equations.
        force_y, force_z: (d, d) its derivatives by y and ζ, at fixed u and ζ̇.
        input: (d, m + k) Nᵀ (Sᵀ, Cᵀ): generalised force per unit of main efforts and carrier forces.
        rate_y: (d, d) derivative of ẏ by y at fixed ζ: zero except for the rotations of a pose, where it is ω ×.
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

    Without efforts, ``force`` is the generalised force (f, F) that produces the motion; with given efforts it is
    the residual, and its derivatives are the derivatives of forward dynamics up to −``mass``⁻¹.

    Args:
        robot: the robot.
        q: (nq,) closed configuration.
        v: (nv,) velocity that the closures allow.
        a: (nv,) acceleration that goes with it.
        tau: (m,) main efforts, N or N·m; none when left out.
        carrier_force: (k,) carrier forces, N.

    Raises:
        UnsupportedRobotError: a joint has more than one degree of freedom; loads except payloads, whose derivatives
            ``CompiledDynamics`` has.
        SingularPoseError: a type I pose, where (x, s) are no coordinates.

    Example:
        >>> from redundancy_pin.simulation import closed_state, inverse_derivatives
        >>> robot = rp.load_robot("2rpr", end_effector_mass=0.5)
        >>> state = closed_state(robot)
        >>> inverse_derivatives(robot, state.q, state.v, 0.0 * state.v).mass.shape
        (4, 4)
    """
    loads = [load for load in robot.loads if not isinstance(load, Payload)]
    if loads:
        raise UnsupportedRobotError(
            f"Derivatives of {loads[0]!r} are not known here.",
            remedy="Pass dynamics=robot, or linearise without loads; wrenches have none at all.",
        )
    chain = ClosedChain(robot)
    model, data = chain.model, chain.data
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if joint.nv != 1:
            raise UnsupportedRobotError(
                f"Joint {str(name)!r} has {joint.nv} freedoms; derivatives cover joints of one.",
                remedy="Build it from joints of one freedom each.",
                joint=str(name),
            )
    rows = row_derivatives(chain, q, v, a)
    inverse = _inverse(robot, chain, rows.K)
    basis = np.zeros((model.nv, robot.n + robot.k))
    basis[:, : robot.n] = inverse[:, chain.rows :]
    basis[robot.carrier_velocity, robot.n + np.arange(robot.k)] = 1.0
    by_q, by_v, mass = (np.array(part) for part in pin.computeRNEADerivatives(model, data, q, v, a))
    mass = np.triu(mass) + np.triu(mass, 1).T
    missing = np.array(pin.rnea(model, data, q, v, a))
    driven = np.concatenate([robot.actuated_velocity, robot.carrier_velocity])
    missing[driven[: robot.m]] -= 0.0 if tau is None else tau
    missing[driven[robot.m :]] -= 0.0 if carrier_force is None else carrier_force
    turned = _row_force_derivative(chain, q, inverse.T @ missing)
    v_y = -inverse @ (rows.by_q @ basis)
    a_y = -inverse @ (rows.rate_by_q @ basis + rows.rate_by_v @ v_y)
    a_z = -inverse @ (rows.rate_by_v @ basis)
    return DynamicsDerivatives(
        basis=read_only(basis),
        mass=read_only(basis.T @ mass @ basis),
        force=read_only(basis.T @ missing),
        force_y=read_only(basis.T @ ((by_q - turned) @ basis + by_v @ v_y + mass @ a_y)),
        force_z=read_only(basis.T @ (by_v @ basis + mass @ a_z)),
        input=read_only(basis[driven].T.copy()),
        rate_y=read_only(_rotation_rate(robot, rows.K[chain.rows :] @ v)),
    )


def _inverse(robot: Robot, chain: ClosedChain, K: Array) -> Array:
    """Return (nv, r + n) the inverse of K, carrier rows zero; it does not exist at a type I pose."""
    columns = chain.pose_columns
    margin = _margin(robot, K[:, columns])
    if margin <= RANK_TOLERANCE:
        raise SingularPoseError(
            f"{robot.name} is at a type I pose (margin {margin:.3g}): platform and carriers do not describe its "
            "motion there.",
            remedy="Linearise at another pose.",
            margin=margin,
        )
    inverse = np.zeros((robot.model.nv, len(K)))
    inverse[columns] = np.linalg.inv(K[:, columns])
    return inverse


def _margin(robot: Robot, K: Array) -> float:
    """Return the smallest over the largest singular value of K (p, p), with the columns of the pose scaled."""
    scale = np.delete(velocity_scale(robot), robot.carrier_velocity)
    rows = np.concatenate([np.ones(len(K) - robot.n), row_scale(robot)])
    values = np.linalg.svd(K / scale * rows[:, None], compute_uv=False)
    return float(values[-1] / max(values[0], np.finfo(float).tiny))


def _row_force_derivative(chain: ClosedChain, q: Array, multiplier: Array) -> Array:
    """Return (nv, nv) the derivative of Kᵀμ by q at fixed μ: K̇ is linear in v, so unit velocities give its parts."""
    model = chain.model
    result = np.empty((model.nv, model.nv))
    for j in range(model.nv):
        unit = np.zeros(model.nv)
        unit[j] = 1.0
        chain.update(q, unit)
        result[:, j] = multiplier @ chain.full_rate()
    return result


def _rotation_rate(robot: Robot, rate: Array) -> Array:
    """Return (d, d) the derivative of ẏ by y: for rotation vectors d(δθ)/dt = δω + ω × δθ."""
    result = np.zeros((robot.n + robot.k, robot.n + robot.k))
    if robot.platform is not None and robot.platform.is_pose:
        at = [robot.platform.axes.index(axis) for axis in ("rx", "ry", "rz")]
        result[np.ix_(at, at)] = pin.skew(rate[at])
    return result


@dataclass(frozen=True, eq=False)
class Linearisation(Frozen):
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
        UnsupportedRobotError: a joint has more than one degree of freedom.

    Example:
        >>> from redundancy_pin.simulation import closed_state, linearise
        >>> robot = rp.load_robot("2rpr", end_effector_mass=0.5)
        >>> model = linearise(robot, closed_state(robot), np.zeros(2), np.zeros(2))
        >>> model.A.shape, model.B.shape
        ((8, 8), (8, 4))
    """
    loads = np.zeros(robot.k) if carrier_force is None else np.asarray(carrier_force, dtype=float)
    dynamics = ForwardDynamics(robot)
    dynamics.adapt(state.q)
    a = dynamics.acceleration(state.q, state.v, _forces(robot, tau, loads))
    inverse = inverse_derivatives(robot, state.q, state.v, a, np.asarray(tau, dtype=float), loads)
    chain = dynamics.chain
    chain.update(state.q, state.v)
    platform = chain.platform_jacobian() @ a + chain.full_bias()[chain.rows :]
    parts = LinearParts(inverse.mass, inverse.force_y, inverse.force_z, inverse.input)
    return _linearisation(robot, parts, inverse.rate_y, platform, a)


def linearise_along(
    robot: Robot, states: Sequence[State], tau: Array, carrier_force: Array, kernel: ForwardKernel | None = None
) -> list[Linearisation]:
    """Linearise at N states, under efforts (N, m) and carrier forces (N, k); raises like ``linearise``.

    With machine code its derivatives, of the same symbols, are taken for all states at once.
    """
    loads = list(zip(states, tau, carrier_force, strict=True))
    accelerations = None if kernel is None else [_code_acceleration(robot, kernel, *one) for one in loads]
    if kernel is None or accelerations is None or any(a is None for a in accelerations):
        return [linearise(robot, *one) for one in loads]  # it raises the cause, if something is wrong
    q, v, a = np.array([s.q for s in states]), np.array([s.v for s in states]), np.array(accelerations)
    parts = kernel.linear(q, v, a, np.asarray(tau, dtype=float))
    result = []
    for i, state in enumerate(states):
        equations, pose = kernel.equations(state.q, state.v), np.delete(np.arange(len(v[i])), robot.carrier_velocity)
        rates = (equations.K @ a[i][pose] + equations.bias)[-robot.n :]
        rotation = _rotation_rate(robot, (equations.K @ v[i][pose])[-robot.n :])
        result.append(_linearisation(robot, LinearParts(*(part[i] for part in parts)), rotation, rates, a[i]))
    return result


def _code_acceleration(robot: Robot, kernel: ForwardKernel, state: State, tau: Array, loads: Array) -> Array | None:
    """Return the acceleration of the tree; None at type I poses too, where there are no derivatives."""
    K = kernel.equations(state.q, state.v).K
    if not np.isfinite(K).all() or _margin(robot, K) <= RANK_TOLERANCE:
        return None
    solved = kernel.accelerations(state.q, state.v, _forces(robot, tau, loads))
    return None if solved is None else solved.a


def _forces(robot: Robot, tau: Array, loads: Array) -> Array:
    force = np.zeros(robot.model.nv)
    force[robot.actuated_velocity], force[robot.carrier_velocity] = tau, loads
    return force


def _linearisation(robot: Robot, parts: LinearParts, rate_y: Array, platform: Array, a: Array) -> Linearisation:
    """Return d(δz)/dt from the derivatives at one state; ``platform`` (n,) is ẍ there."""
    d = robot.n + robot.k
    right = np.concatenate([-parts.force_y, -parts.force_z, parts.input], axis=1)
    solved = np.linalg.solve(parts.mass, right)
    A = np.block([[rate_y, np.eye(d)], [solved[:, : 2 * d]]])
    B = np.concatenate([np.zeros((d, robot.m + robot.k)), solved[:, 2 * d :]])
    acceleration = np.concatenate([platform, a[robot.carrier_velocity]])
    return Linearisation(read_only(A), read_only(B), read_only(acceleration), read_only(a))


def state_error(robot: Robot, state: State, x: Array, xd: Array, s: Array, sd: Array) -> Array:
    """Return δz (2d,), the state less a reference, in the coordinates of ``Linearisation``.

    Args:
        robot: the robot.
        state: where the machine is.
        x: (n,) reference coordinates, or a pose (4, 4).
        xd: (n,) their rate.
        s: (k,) reference positions of the carriers, m.
        sd: (k,) their speeds, m/s.

    Example:
        >>> from redundancy_pin.simulation import closed_state, state_error
        >>> robot = rp.load_robot("2rpr")
        >>> state = closed_state(robot)
        >>> state_error(robot, state, state.x + 0.001, state.xd, state.s, state.sd).shape
        (8,)
    """
    here = state.x
    away = difference(robot, here, x)
    return np.concatenate([away, state.s - s, state.xd - xd, state.sd - sd])
