"""Inverse dynamics along a motion, batched: what a feed-forward needs, without a backend.

The simulation judges plans that a backend made, so it has its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.kinematics.coordinates import column_scale, row_scale
from redundancy_pin.kinematics.state import lift
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """The tree along a motion, and W τ = f.

    Attributes:
        q: (N, nq) configurations, carriers included.
        v, a: (N, nv) velocities and accelerations.
        reduced: f, W and carrier forces.
    """

    q: Array
    v: Array
    a: Array
    reduced: ReducedDynamics


def inverse_dynamics(robot: Robot, motion: PlatformMotion, carriers: CarrierMotion) -> InverseDynamics:
    """Return tree motion and reduced dynamics.

    Args:
        robot: the robot.
        motion: (N,) samples of the platform.
        carriers: (N, k) samples of the carriers.

    Raises:
        UnreachablePoseError, SingularPoseError, WorkingModeError: see ``kinematics.state.lift``.
    """
    tree = lift(robot, motion)
    q, v, a = np.array(tree.q), np.array(tree.v), np.array(tree.a)
    q[:, robot.carrier_position] = carriers.s
    v[:, robot.carrier_velocity] = carriers.sd
    a[:, robot.carrier_velocity] = carriers.sdd
    model, data = robot.model, robot.model.createData()
    effort = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)]).reshape(len(q), model.nv)
    reduced = ReducedDynamics(
        t=motion.t,
        f=read_only(np.einsum("nvi,nv->ni", tree.gamma, effort)),
        W=tree.W,
        carrier_force=read_only(effort[:, robot.carrier_velocity]),
        reachable=tree.reachable,
        gap=tree.gap,
        row_scale=row_scale(robot),
        column_scale=column_scale(robot),
    )
    return InverseDynamics(read_only(q), read_only(v), read_only(a), reduced)
