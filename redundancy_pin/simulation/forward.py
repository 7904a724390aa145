"""Accelerations of a closed chain under given efforts: the equations of motion in independent coordinates.

With J_c N = 0 and J_c a₀ = −J̇_c v, accelerations are a = N z̈ + a₀ and closure forces drop out of

    (Nᵀ M N) z̈ = Nᵀ (u − rnea(q, v, a₀)),

u the generalised forces of main actuators, carriers and other loads. Loads of the robot except wrenches belong
to M and to rnea here. z are tree coordinates chosen by rank
(``partition``), so the equations are regular wherever J_c has full row rank and the free motions have inertia: at
singularities of type I and type II too.

The independent tree velocities are chosen by rank, and chosen again as the machine moves.

Coordinate partitioning (Wehage and Haug 1982): r of the pose velocities depend on the others through J_c. The dependent
ones are the first r pivots of a QR factorisation with column exchange, so their block of J_c is as well conditioned as
the pose allows. That needs full row rank of J_c and nothing else: neither type I nor type II singularities matter, for
the choice looks at neither the platform nor the actuators.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, eigh, lapack

from redundancy_pin.arrays import RANK_TOLERANCE, Array, IntArray
from redundancy_pin.dynamics.forward import LEAST_INERTIA
from redundancy_pin.dynamics.tree_loads import tree_equations
from redundancy_pin.errors import IllPosedModelError, SingularPoseError
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import velocity_scale, velocity_unit
from redundancy_pin.simulation.rank_loss import LOST, Sheet, rank_ratio


@dataclass(frozen=True, eq=False)
class Partition:
    """Dependent and independent tree velocities; velocities of carriers driven by motion are neither.

    Attributes:
        dependent: (r,) velocity indices solved for from J_c v = 0.
        independent: (d,) the others that are free to move.
    """

    dependent: IntArray
    independent: IntArray


def choose(relative: Array, pose_columns: IntArray, free: IntArray, q: Array) -> Partition:
    """Choose the dependent ones of the velocities that move the pose, by J_c (r, p) without units.

    Carriers driven by force (``free``) are always independent; ``q`` (nq,) is for the error.

    Raises:
        SingularPoseError: J_c has lost row rank: the closures do not determine how the machine moves on.
    """
    rows = len(relative)
    if rows == 0:
        return Partition(np.empty(0, dtype=np.intp), np.concatenate([pose_columns, free]))
    triangle, order, *_ = lapack.dgeqp3(np.asfortranarray(relative))
    diagonal = np.abs(triangle.diagonal())
    if diagonal[-1] <= RANK_TOLERANCE * diagonal[0]:
        raise SingularPoseError(
            f"The {rows} closure rows have lost rank (smallest pivot {diagonal[-1]:.3g} of {diagonal[0]:.3g}; "
            f"q = {(np.round(q, 6) + 0.0).tolist()}): the machine can move on in more than one way.",
            remedy="Choose lengths or a motion that keep away from this pose, or come to it at speed.",
            pivots=diagonal.tolist(),
            q=np.asarray(q).tolist(),
        )
    order = pose_columns[order - 1]
    return Partition(order[:rows], np.concatenate([order[rows:], free]))


_POOR_CHOICE = 1e-2
"""Ratio of the pivots of the dependent block of J_c below which the independent velocities are chosen again."""


@dataclass(frozen=True, eq=False)
class Acceleration:
    """What acts at one state.

    Attributes:
        a: (nv,) tree acceleration.
        closure_force: (r,) forces of the closure rows, N or N·m, on frame B along the axes of frame A.
        carrier_force: (k,) generalised forces on the carriers' joints, N: all of them where forces drive the carriers,
            what must be added to those given where motion does.
        stop_force: (nv,) generalised forces of stops on the joints that they hold, N or N·m; zero elsewhere.
    """

    a: Array
    closure_force: Array
    carrier_force: Array
    stop_force: Array


class ForwardDynamics:
    """Forward dynamics in projected form, for one robot.

    Args:
        robot: the robot.
        prescribed: whether the carriers' motion is given in place of their forces.
        held: (h,) tree velocities that are zero, of joints at their stops.
        q: (nq,) configuration at which the independent velocities are chosen first; the reference when left out.
        basis: of the closure rows in use, see ``ClosedChain``.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        prescribed: bool = False,
        held: Sequence[int] = (),
        q: Array | None = None,
        basis: Array | None = None,
    ) -> None:
        self.robot = robot
        self.chain = ClosedChain(robot)
        self.chain.use_basis(basis)
        self.prescribed = prescribed
        nothing = np.empty(0, dtype=np.intp)
        self._carriers = np.array(robot.carrier_velocity)
        self.held: IntArray = np.array(held, dtype=np.intp)
        self._free: IntArray = nothing if prescribed else np.setdiff1d(self._carriers, self.held)
        self._moving = ~np.isin(self.chain.pose_columns, self.held)
        self._given: IntArray = self._carriers if prescribed else nothing
        self._scale, self._unit = velocity_scale(robot), velocity_unit(robot)
        self.least_inertia = 1.0
        """Smallest pivot of the mass matrix over the largest, in kg, at the last state."""
        self.adapt(np.array(robot.q_reference) if q is None else q)
        self._fresh = False

    def _choose(self, relative: Array, q: Array) -> Partition:
        columns = self.chain.pose_columns[self._moving]
        return choose(relative[:, self._moving], columns, self._free, q)

    def adapt(self, q: Array) -> None:
        """Choose the independent velocities again for a configuration (nq,).

        Raises:
            SingularPoseError: the closures have lost rank there.
        """
        self.chain.update(q, np.zeros(self.robot.model.nv))
        self.use(self._choose(self.chain.closure_rows(), q))
        self._fresh = True
        """Whether the independent velocities were chosen for the next configuration."""

    def use(self, partition: Partition) -> None:
        """Take over a partition of the velocities."""
        self.partition = partition
        self._basis = np.zeros((self.robot.model.nv, len(partition.independent)), order="F")
        self._basis[partition.independent, np.arange(len(partition.independent))] = 1.0
        self._particular = np.zeros(self.robot.model.nv)
        self._inverse_scale = 1.0 / self._scale[partition.independent]
        self._system = np.empty((self.chain.rows, len(partition.independent) + 1), order="F")
        self._columns = np.concatenate([partition.dependent, partition.independent])
        # dependent velocities are solved for without units: the pivots measure the quality of the choice
        dependent = self._unit[partition.dependent]
        self._row_scale = 1.0 / self.chain.closure_unit
        self._column_scale = self._row_scale[:, None] * self._unit[self._columns]
        self._solved_unit = -dependent[:, None] / np.append(self._unit[partition.independent], 1.0)

    def acceleration(
        self, q: Array, v: Array, force: Array, carrier_acceleration: Array | None = None, *, sheet: Sheet | None = None
    ) -> Array:
        """Return the tree acceleration (nv,).

        Args:
            q: (nq,) closed configuration.
            v: (nv,) velocity that the closures allow.
            force: (nv,) generalised forces: efforts, carrier forces, friction.
            carrier_acceleration: (k,) s̈ where the carriers' motion is prescribed, m/s².
            sheet: what the motion is on where the closures lose rank (``rank_loss``); NaN is returned off its line.

        Raises:
            IllPosedModelError: a free motion has no inertia.
            SingularPoseError: the closures have lost rank.
        """
        chain = self.chain
        if sheet is not None:
            return self._acceleration_on(sheet, q, v, force, carrier_acceleration)
        chain.update(q, v)
        particular, basis = self._particular, self._basis
        if carrier_acceleration is not None:
            particular[self._given] = carrier_acceleration
        if chain.rows:
            dependent = self.partition.dependent
            jacobian = chain.jacobian().take(self._columns, 1) * self._column_scale
            rows = chain.rows
            system = self._system
            system[:, :-1] = jacobian[:, rows:]
            system[:, -1] = chain.bias() * self._row_scale
            factor, _, solved, _ = lapack.dgesv(jacobian[:, :rows], system, overwrite_b=1)
            pivots = [abs(pivot) for pivot in factor.diagonal().tolist()]
            # a choice just made for this pose is the best there is: without the flag a poor pose would recurse for ever
            if not self._fresh and min(pivots) < _POOR_CHOICE * max(pivots):
                self.adapt(q)  # raises where the closures themselves have lost rank
                return self.acceleration(q, v, force, carrier_acceleration)
            self._fresh = False
            solved *= self._solved_unit
            basis[dependent] = solved[:, :-1]
            particular[dependent] = solved[:, -1]
        return self._solve(q, v, force, basis, particular, self._inverse_scale)

    def _acceleration_on(
        self, sheet: Sheet, q: Array, v: Array, force: Array, carrier_acceleration: Array | None
    ) -> Array:
        motion = sheet.at(q, v)
        if motion is None:
            return np.full(self.robot.model.nv, np.nan)
        free = np.zeros((len(v), len(self._free)), order="F")
        free[self._free, np.arange(len(self._free))] = 1.0
        basis = np.asfortranarray(np.concatenate([motion.basis, free], axis=1))
        if carrier_acceleration is not None:
            motion.particular[self._given] = carrier_acceleration
        inverse_scale = 1.0 / self._scale[np.concatenate([sheet.independent, self._free])]
        return self._solve(motion.q, motion.v, force, basis, motion.particular, inverse_scale)

    def _solve(self, q: Array, v: Array, force: Array, basis: Array, particular: Array, inverse_scale: Array) -> Array:
        if not basis.shape[1]:  # no motion is free
            self.least_inertia = 1.0
            return particular.copy()
        model, data = self.robot.model, self.chain.data
        effort, mass = tree_equations(self.robot, data, q, v, particular)
        # the binding leaves the lower triangle alone, and dsymm reads the upper one only
        reduced = blas.dgemm(1.0, basis, blas.dsymm(1.0, mass, basis), trans_a=1)
        factor, z, failed = lapack.dposv(reduced, basis.T.dot(force - effort))
        # squares of the Cholesky diagonal: the inertia that is left of each motion when those before it yield
        inertia = ((factor.diagonal() * inverse_scale) ** 2).tolist()
        self.least_inertia = 0.0 if failed else min(inertia) / max(max(inertia), 1e-300)
        if not self.least_inertia > LEAST_INERTIA:
            if not np.isfinite(reduced).all():  # a trial step of an integrator, far off
                return np.full(model.nv, np.nan)
            raise self._ill_posed(reduced, basis)
        result: Array = particular + basis.dot(z)
        return result

    def forces(self, q: Array, v: Array, force: Array, a: Array, *, sheet: Sheet | None = None) -> Acceleration:
        """Return closure forces and carrier forces that go with an acceleration a (nv,), from here or from elsewhere.

        ``force`` (nv,): the generalised forces without the carriers driven by motion. At a rank loss of the
        closures (``sheet``) they do not determine their forces, which are NaN there.

        Raises:
            SingularPoseError: the closures have lost rank.
        """
        chain = self.chain
        chain.update(q, v)
        missing = tree_equations(self.robot, chain.data, q, v, a)[0] - force
        # J_cᵀ λ = missing holds in all rows; the rows of the dependent velocities are square and well conditioned
        relative, closure = chain.closure_rows(), np.full(chain.rows, np.nan)
        dependent = self._choose(relative, q).dependent if sheet is None else sheet.dependent
        block = relative[:, np.searchsorted(chain.pose_columns, dependent)]
        if sheet is None or rank_ratio(block[None])[0] > LOST:
            unit = chain.closure_unit
            closure = np.linalg.solve(block.T, missing[dependent] * self._unit[dependent]) / unit
        stopped = np.zeros(len(v))
        stopped[self.held] = (missing - chain.jacobian().T.dot(closure))[self.held]
        carrier_force = missing[self._carriers] if self.prescribed else force[self._carriers]
        return Acceleration(a, closure, carrier_force, stopped)

    def velocity_basis(self, q: Array) -> Array:
        """Return N (nv, d) at a configuration (nq,): the tree velocities that the closures allow.

        Its columns belong to the independent velocities of the present partition; ``adapt`` chooses one that suits q.
        """
        self.chain.update(q, np.zeros(self.robot.model.nv))
        if self.chain.rows:
            jacobian = self.chain.jacobian()
            dependent, independent = self.partition.dependent, self.partition.independent
            self._basis[dependent] = -np.linalg.solve(jacobian[:, dependent], jacobian[:, independent])
        return self._basis.copy()

    def reduced_inertia(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return N (nv, d), see ``velocity_basis``, and Nᵀ M N (d, d) at a configuration (nq,) and velocity (nv,)."""
        self.adapt(q)
        basis = np.asfortranarray(self.velocity_basis(q))
        self.chain.update(q, v)
        mass = tree_equations(self.robot, self.chain.data, q, v, np.zeros(len(v)))[1]
        reduced: Array = blas.dgemm(1.0, basis, blas.dsymm(1.0, mass, basis), trans_a=1)
        return basis, reduced

    def _ill_posed(self, reduced: Array, basis: Array) -> IllPosedModelError:
        """Return the error that names the motion without inertia."""
        robot = self.robot
        values, vectors = eigh(reduced)
        condition = float(values[-1] / max(abs(values[0]), np.finfo(float).tiny))
        direction = basis @ vectors[:, 0]
        share = np.abs(direction * self._scale)
        joints = zip(list(robot.model.names)[1:], list(robot.model.joints)[1:], strict=True)
        moved = [str(name) for name, j in joints if share[j.idx_v : j.idx_v + j.nv].max() > 0.1 * share.max()]
        masses = [name for name, value in robot.parameters.items() if name.endswith("_mass") and value == 0.0]
        masses.sort(key=lambda name: name != "end_effector_mass")  # what such a machine lacks most often
        example = "in its URDF"
        if masses:
            example = f"for example load_robot({robot.name!r}, {masses[0]}=0.1), or --set {masses[0]}=0.1"
        return IllPosedModelError(
            f"A motion that the closures of {robot.name} leave free has no inertia: the mass matrix in independent "
            f"coordinates has condition number {condition:.3g}, so forces do not determine the acceleration of "
            f"{', '.join(moved)}.",
            remedy=f"Give it mass, {example}, and make plans and controllers anew for that robot.",
            condition=condition,
            direction=direction.tolist(),
            joints=tuple(moved),
        )
