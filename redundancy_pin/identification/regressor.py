"""The regressor of a closed chain: generalised forces are linear in its dynamic parameters.

With Γ the velocities of the tree per rate of the platform, C the carriers, and Y the regressor of the open tree
(``pin.computeJointTorqueRegressor`` for bodies, one column for each term of a joint),

    W τ = f = Γᵀ Y(q, v, a) π,    carrier force = Cᵀ Y(q, v, a) π.

Constraint forces do no work in Γ and drop out; nothing is divided by W, so that rows are finite at type II
singularities too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.identification.parameters import INERTIAL, Parameter, parameters_of, unit_load
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import JointForces, Robot


def chain_regressor(
    along: RneaAlongMotion, parameters: Sequence[Parameter] | None = None, carriers: CarrierMotion | None = None
) -> Array:
    """Return (N, n + k, p) the regressor of a closed chain along a motion: of f (n), then of carrier forces (k).

    Units are N or N·m per unit of each parameter.

    Args:
        along: a platform motion whose kinematics are solved, ``RneaDynamics(robot).along(motion)``.
        parameters: p parameters; default ``parameters_of(robot)``.
        carriers: N samples of the carriers; parked at zero when left out.

    Example:
        >>> from redundancy_pin.identification import chain_regressor
        >>> line = rp.trajectory.from_points([[0.2, 0.6], [0.3, 0.7]], [0.0, 1.0], ends="rest")
        >>> chain_regressor(rp.RneaDynamics("five_bar").along(line.sample(0.05))).shape[:2]
        (21, 2)
    """
    robot, model = along.robot, along.robot.model
    chosen = parameters_of(robot) if parameters is None else parameters
    q, v, a = along.tree_motion(carriers)
    projection = chain_projection(robot, along.gamma)
    rows = np.zeros((len(q), projection.shape[2], len(chosen)))
    bodies = np.array([k for k, p in enumerate(chosen) if p.kind in INERTIAL], dtype=np.intp)
    if len(bodies):
        sources = [10 * (chosen[k].joint - 1) + INERTIAL.index(chosen[k].kind) for k in bodies]
        data = model.createData()
        for i in range(len(q)):
            tree = pin.computeJointTorqueRegressor(model, data, q[i], v[i], a[i])
            rows[i, :, bodies] = (projection[i].T @ tree[:, sources]).T
    for k, parameter in enumerate(chosen):
        if parameter.kind in INERTIAL:
            continue
        joint = model.joints[parameter.joint]
        if parameter.kind == "rotor inertia":  # a rotor acts on the link that carries it too
            unit = (unit_load(robot, parameter, parameter.size),)
            loaded, bare = (_of_loads(along, loads, carriers) for loads in (unit, ()))
            rows[:, :, k] = (loaded - bare) / parameter.size
        elif parameter.kind == "preload":
            rows[:, :, k] = projection[:, joint.idx_v]
        else:
            load = unit_load(robot, parameter)
            # no spring acts in a joint with more coordinates than one
            position = q[:, joint.idx_q] if joint.nq == 1 else np.zeros(len(q))
            rows[:, :, k] = projection[:, joint.idx_v] * load.resistance(position, v[:, joint.idx_v])[:, None]
    return read_only(rows)


def chain_projection(robot: Robot, gamma: Array) -> Array:
    """Return (N, nv, n + k) velocities of the tree per rate of the platform, (N, nv, n), and of each carrier."""
    carriers = np.zeros((len(gamma), robot.model.nv, robot.k))
    carriers[:, robot.carrier_velocity, np.arange(robot.k)] = 1.0
    return np.concatenate([gamma, carriers], axis=2)


def gravity_effort(model: pin.Model, q: Array, gravity: Array) -> Array:
    """Return (N, nv) the efforts that hold a tree at q (N, nq) against an acceleration of gravity (3,), N and N·m."""
    other = model.copy()
    other.gravity.linear = gravity
    data = other.createData()
    return np.array([pin.computeGeneralizedGravity(other, data, one) for one in q])


def _of_loads(along: RneaAlongMotion, loads: tuple[JointForces, ...], carriers: CarrierMotion | None) -> Array:
    """Return (N, n + k) f and carrier forces of the robot with other loads."""
    other = RneaAlongMotion(replace(along.tree, robot=replace(along.robot, loads=loads)))
    return np.concatenate(other.forces(carriers), axis=1)
