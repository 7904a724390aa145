"""Dynamics of any declared robot: Pinocchio's recursive Newton–Euler on the tree, projected on the closed chains.

With v = Γ ẋ + C ṡ and J_c Γ = 0 the constraint forces drop out of the equation of motion of the tree, and

    W τ = f,   W = Γᵀ Sᵀ,   f = Γᵀ rnea(q, v, a),   carrier force = Cᵀ rnea(q, v, a).

Γ depends on the platform motion alone, so it is computed once a motion.
"""

from __future__ import annotations

import os
from functools import cached_property

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, frozen, read_only
from redundancy_pin.dynamics.base import (
    CarrierDerivatives,
    Dynamics,
    OnUnreachable,
    ReducedDynamics,
    require_choice,
    require_matching_carriers,
)
from redundancy_pin.kinematics.coordinates import column_scale, row_scale
from redundancy_pin.kinematics.lift import TreeMotion, lift
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot

_SAMPLES_PER_THREAD = 500
"""Below this a second thread costs more than it brings."""


class RneaDynamics(Dynamics):
    """Closed-chain dynamics through Pinocchio's RNEA and constraint Jacobians, for any declared robot.

    ``reduce`` is inherited: it is ``along(motion).reduce(carriers)`` after a check of the tracks (``Dynamics.reduce``).

    Args:
        robot: the robot.
        threads: threads of the batched RNEA; as many as there are processors when left out.
    """

    def __init__(self, robot: Robot, *, threads: int | None = None) -> None:
        self._robot = robot
        self._threads = threads or os.cpu_count() or 1

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._robot

    def along(self, motion: PlatformMotion, *, unreachable: OnUnreachable = "raise") -> RneaAlongMotion:
        """Solve the kinematics of a platform motion once; raises as ``kinematics.lift.lift``."""
        require_choice(unreachable)
        return RneaAlongMotion(lift(self._robot, motion, mark_unreachable=unreachable == "mark"), self._threads)


class RneaAlongMotion:
    """RNEA dynamics along a lifted platform motion.

    Args:
        tree: the lifted motion.
        threads: threads of the batched RNEA.
    """

    def __init__(self, tree: TreeMotion, threads: int = 1) -> None:
        self.tree = tree
        self._threads = max(1, min(threads, len(tree.motion) // _SAMPLES_PER_THREAD))
        self._rows = frozen(row_scale(tree.robot))
        self._columns = frozen(column_scale(tree.robot))
        # (n, nv, N): the projection then runs over contiguous samples
        self._gamma = np.ascontiguousarray(tree.gamma.transpose(2, 1, 0))

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.tree.robot

    @property
    def motion(self) -> PlatformMotion:
        """The platform motion."""
        return self.tree.motion

    def reduce(self, carriers: CarrierMotion | None = None) -> ReducedDynamics:
        """Return f, W and carrier forces; carriers parked at s = 0 when left out."""
        effort = self.tree_effort(carriers)
        f = np.stack([np.einsum("vn,vn->n", block, effort) for block in self._gamma], axis=1)
        return ReducedDynamics(
            t=self.motion.t,
            f=read_only(f),
            W=self.tree.W,
            carrier_force=read_only(np.ascontiguousarray(effort[self.robot.carrier_velocity].T)),
            reachable=self.tree.reachable,
            gap=self.tree.gap,
            row_scale=self._rows,
            column_scale=self._columns,
        )

    def tree_motion(self, carriers: CarrierMotion | None = None) -> tuple[Array, Array, Array]:
        """Return q (nq, N), v (nv, N), a (nv, N) of the tree, carriers included, samples in columns."""
        robot = self.robot
        carriers = require_matching_carriers(robot, carriers, len(self.motion))
        q, v, a = (np.array(part.T, order="F") for part in (self.tree.q, self.tree.v, self.tree.a))
        q[robot.carrier_position] = carriers.s.T
        v[robot.carrier_velocity] = carriers.sd.T
        a[robot.carrier_velocity] = carriers.sdd.T
        return q, v, a

    def tree_effort(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (nv, N) generalised forces of the open tree, rnea(q, v, a)."""
        q, v, a = self.tree_motion(carriers)
        return _batched_rnea(self._pool, self._threads, q, v, a)

    def carrier_derivatives(self, carriers: CarrierMotion | None = None) -> CarrierDerivatives:
        """Return the exact derivatives of f and carrier forces by s, ṡ, s̈ (Pinocchio's RNEA derivatives, projected)."""
        robot, model = self.robot, self.robot.model
        data = model.createData()
        q, v, a = self.tree_motion(carriers)
        columns = robot.carrier_velocity
        samples = len(self.motion)
        by_q, by_v, by_a = (np.empty((samples, model.nv, robot.k)) for _ in range(3))
        for i in range(samples):
            dq, dv, da = pin.computeRNEADerivatives(model, data, q[:, i], v[:, i], a[:, i])
            by_q[i], by_v[i] = dq[:, columns], dv[:, columns]
            # Pinocchio fills the upper triangle of the mass matrix only
            by_a[i] = (np.triu(da) + np.triu(da, 1).T)[:, columns]
        gamma = self.tree.gamma
        projected = [np.einsum("nvi,nvk->nik", gamma, part) for part in (by_q, by_v, by_a)]
        own = [part[:, columns] for part in (by_q, by_v, by_a)]
        return CarrierDerivatives(*(read_only(part) for part in (*projected, *own)))

    def base_wrench(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N, 6) force and moment of the robot on its base, about the world origin, world axes, N and N·m.

        The root of the tree is given six freedoms and no motion: the generalised force there is what holds the base.
        Closure and actuator forces are internal and do not show.
        """
        q, v, a = self.tree_motion(carriers)
        samples = q.shape[1]
        root = np.zeros((7, samples))
        root[6] = 1.0  # w of the quaternion: no rotation, so the root's axes are the world's
        still = np.zeros((6, samples))
        effort = _batched_rnea(
            self._floating_pool,
            self._threads,
            np.asfortranarray(np.concatenate([root, q])),
            np.asfortranarray(np.concatenate([still, v])),
            np.asfortranarray(np.concatenate([still, a])),
        )
        # the effort at the root is what the ground exerts on the robot; the wrench on the base is its reaction
        wrench: Array = read_only(np.ascontiguousarray(-effort[:6].T))
        return wrench

    def energy(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N,) kinetic plus potential energy, J (zero height at the world origin)."""
        model = self.robot.model
        data = model.createData()
        q, v, _ = self.tree_motion(carriers)
        total = [
            pin.computeKineticEnergy(model, data, q[:, i], v[:, i]) + pin.computePotentialEnergy(model, data, q[:, i])
            for i in range(q.shape[1])
        ]
        return frozen(total)

    @cached_property
    def _pool(self) -> pin.ModelPool:
        return pin.ModelPool(self.robot.model, self._threads)

    @cached_property
    def _floating_pool(self) -> pin.ModelPool:
        model = pin.buildModelFromXML(self.robot.urdf, pin.JointModelFreeFlyer())
        model.gravity = self.robot.model.gravity
        # links fixed to the base stand on the ground: their weight is not the mechanism's
        model.inertias[1] = pin.Inertia.Zero()
        return pin.ModelPool(model, self._threads)


def _batched_rnea(pool: pin.ModelPool, threads: int, q: Array, v: Array, a: Array) -> Array:
    # for a single column the binding returns a vector
    result: Array = np.reshape(pin.rneaInParallel(threads, pool, q, v, a), v.shape)
    return result
