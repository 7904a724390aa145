"""Accelerations of a closed chain under given efforts: the equations of motion in independent coordinates.

With J_c N = 0 and J_c a₀ = −J̇_c v, accelerations are a = N z̈ + a₀ and closure forces drop out of

    (Nᵀ M N) z̈ = Nᵀ (u − rnea(q, v, a₀)),

u the generalised forces of main actuators, carriers and whatever else acts. z are tree coordinates chosen by rank
(``partition``), so the equations are regular wherever J_c has full row rank and the free motions have inertia: at
singularities of type I and type II too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import blas, eigh, lapack

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import IllPosedModelError
from redundancy_pin.kinematics.coordinates import velocity_scale
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.chain import ClosedChain
from redundancy_pin.simulation.partition import Partition, choose

LEAST_INERTIA = 1e-8
"""Share of its inertia that a free motion may keep when all others yield, below which the model counts as massless in
some direction. Rounding leaves 1e-16, but accelerations grow without bound on the way there, and steps shrink to
nothing. A part of a thousandth of the mass of the others leaves 1e-3."""


@dataclass(frozen=True, eq=False)
class Acceleration:
    """What acts at one state.

    Attributes:
        a: (nv,) tree acceleration.
        closure_force: (r,) forces of the closure rows, N or N·m, on frame B along the axes of frame A.
        carrier_force: (k,) forces of the carriers' actuators, N.
    """

    a: Array
    closure_force: Array
    carrier_force: Array


class ForwardDynamics:
    """Forward dynamics in projected form, for one robot.

    Args:
        robot: the robot.
        prescribed: whether the carriers' motion is given in place of their forces.
    """

    def __init__(self, robot: Robot, *, prescribed: bool = False) -> None:
        self.robot = robot
        self.chain = ClosedChain(robot)
        self.prescribed = prescribed
        nothing = np.empty(0, dtype=np.intp)
        self._carriers = np.array(robot.carrier_velocity)
        self._free: IntArray = nothing if prescribed else self._carriers
        self._given: IntArray = self._carriers if prescribed else nothing
        self._scale = velocity_scale(robot)
        self._set(self.choose_partition(np.array(robot.q_reference)))

    def choose_partition(self, q: Array) -> Partition:
        """Return the partition that suits a configuration (nq,).

        Raises:
            SingularPoseError: the closures have lost rank there.
        """
        self.chain.update(q, np.zeros(self.robot.model.nv))
        return choose(self.chain.jacobian(), self._scale, self.chain.pose_columns, self._free, self._given)

    def adapt(self, q: Array) -> None:
        """Choose the independent velocities anew for a configuration (nq,).

        Raises:
            SingularPoseError: the closures have lost rank there.
        """
        self._set(self.choose_partition(q))

    def _set(self, partition: Partition) -> None:
        self.partition = partition
        self._basis = np.zeros((self.robot.model.nv, len(partition.independent)), order="F")
        self._basis[partition.independent, np.arange(len(partition.independent))] = 1.0
        self._particular = np.zeros(self.robot.model.nv)
        self._columns = np.concatenate([partition.dependent, partition.independent])

    def acceleration(self, q: Array, v: Array, force: Array, carrier_acceleration: Array | None = None) -> Array:
        """Return the tree acceleration (nv,).

        Args:
            q: (nq,) closed configuration.
            v: (nv,) velocity that the closures allow.
            force: (nv,) generalised forces: efforts, carrier forces, friction.
            carrier_acceleration: (k,) s̈ where the carriers' motion is prescribed, m/s².

        Raises:
            IllPosedModelError: a free motion has no inertia.
            SingularPoseError: the closures have lost rank.
        """
        model, data, chain = self.robot.model, self.chain.data, self.chain
        chain.update(q, v)
        particular, basis = self._particular, self._basis
        if carrier_acceleration is not None:
            particular[self._given] = carrier_acceleration
        if chain.rows:
            dependent = self.partition.dependent
            jacobian = chain.jacobian().take(self._columns, 1)
            rows = chain.rows
            system = np.empty((rows, jacobian.shape[1] - rows + 1), order="F")
            system[:, :-1] = jacobian[:, rows:]
            system[:, -1] = chain.bias()
            _, _, solved, singular = lapack.dgesv(jacobian[:, :rows], system, overwrite_b=1)
            if singular:
                self.adapt(q)  # raises where the closures themselves have lost rank
                return self.acceleration(q, v, force, carrier_acceleration)
            basis[dependent] = -solved[:, :-1]
            particular[dependent] = -solved[:, -1]
        effort = pin.rnea(model, data, q, v, particular)
        mass = pin.crba(model, data, q)
        # the binding leaves the lower triangle alone, and dsymm reads the upper one only
        reduced = blas.dgemm(1.0, basis, blas.dsymm(1.0, mass, basis), trans_a=1)
        factor, z, failed = lapack.dposv(reduced, basis.T.dot(force - effort))
        if failed or not _has_inertia(reduced, factor):
            raise self._ill_posed(reduced)
        result: Array = particular + basis.dot(z)
        return result

    def forces(self, q: Array, v: Array, force: Array, a: Array) -> Acceleration:
        """Return closure forces and carrier forces that go with an acceleration.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity.
            force: (nv,) generalised forces without those of carriers driven by motion.
            a: (nv,) from ``acceleration``.
        """
        chain, partition = self.chain, self.partition
        chain.update(q, v)
        missing = np.array(pin.rnea(self.robot.model, chain.data, q, v, a)) - force
        closure = np.zeros(chain.rows)
        if chain.rows:
            block = chain.jacobian()[:, partition.dependent]
            _, _, closure, _ = lapack.dgesv(block.T, missing[partition.dependent])
        carrier = missing[self._carriers] if self.prescribed else force[self._carriers]
        return Acceleration(a, np.asarray(closure), np.asarray(carrier))

    def reduced_mass(self, q: Array) -> Array:
        """Return Nᵀ M N at a configuration (nq,), in the present independent velocities."""
        self.acceleration_basis(q)
        mass = pin.crba(self.robot.model, self.chain.data, q)
        reduced: Array = blas.dgemm(1.0, self._basis, blas.dsymm(1.0, mass, self._basis), trans_a=1)
        return reduced

    def acceleration_basis(self, q: Array) -> Array:
        """Return N (nv, d): the tree velocities that the closures allow, per unit of each independent one."""
        self.chain.update(q, np.zeros(self.robot.model.nv))
        if self.chain.rows:
            jacobian = self.chain.jacobian()
            dependent, independent = self.partition.dependent, self.partition.independent
            self._basis[dependent] = -np.linalg.solve(jacobian[:, dependent], jacobian[:, independent])
        return self._basis

    def _ill_posed(self, reduced: Array) -> IllPosedModelError:
        """Return the error that names the motion without inertia."""
        robot = self.robot
        values, vectors = eigh(reduced)
        condition = float(values[-1] / max(abs(values[0]), np.finfo(float).tiny))
        direction = self._basis @ vectors[:, 0]
        share = np.abs(direction * self._scale)
        moved = [
            str(robot.model.names[j])
            for j in range(1, robot.model.njoints)
            if share[_columns(robot, j)].max() > 0.1 * share.max()
        ]
        masses = [name for name, value in robot.parameters.items() if name.endswith("_mass") and value == 0.0]
        hint = f"Give it mass, for example load_robot({robot.name!r}, {masses[0]}=0.1). " if masses else ""
        hint = (
            f"Give it mass, for example load_robot({robot.name!r}, end_effector_mass=0.1). "
            if "end_effector_mass" in masses
            else hint
        )
        drive = (
            "" if self.prescribed or not robot.k else 'Carriers driven by motion (carriers="motion") need less of it.'
        )
        return IllPosedModelError(
            f"A motion that the closures of {robot.name} leave free has no inertia: the mass matrix in independent "
            f"coordinates has condition number {condition:.3g}, so forces do not determine the acceleration of "
            f"{', '.join(moved)}.",
            remedy=(hint or "Give every part that moves freely a mass. ") + drive,
            condition=condition,
            direction=direction.tolist(),
            joints=tuple(moved),
        )


def _columns(robot: Robot, joint: int) -> slice:
    found = robot.model.joints[joint]
    return slice(found.idx_v, found.idx_v + found.nv)


def _has_inertia(matrix: Array, factor: Array) -> bool:
    """Return whether every pivot of the Cholesky factor keeps a share of its diagonal entry."""
    pivots = factor.diagonal()
    return bool((pivots * pivots > LEAST_INERTIA * matrix.diagonal()).all())
