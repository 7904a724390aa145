"""Generalised forces that the loads of a robot require at the joints of its tree, at one state.

Every load is a wrench on a body, or acts in a single joint. With the wrenches w_b given to RNEA as external forces,

    effort = rnea(q, v, a, w) + joint terms,

where the joint terms are friction, springs and rotor inertia of each joint. Wrenches are expressed in the frame of the
joint that moves the body, force first, as Pinocchio's ``fext`` and Featherstone's f^x (RBDA 2008, table 5.1).

A rotor of inertia I and gear ratio G spins at G v about the joint's axis z relative to the parent link, whose angular
velocity is ω. Beyond the motion with that link its angular momentum is I G v z, so it requires

    I G (G v̇ + z·ω̇) in its joint,    and acts with −I G (v̇ z + v ω × z) as a moment on the parent link.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.robot import JointForces, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint, find_joint_index, find_link
from redundancy_pin.robot.types import slides

_LOCAL, _ALIGNED = pin.ReferenceFrame.LOCAL, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class TreeState(NamedTuple):
    """One state of the open tree, carriers included, m, rad and s.

    Attributes:
        q: (nq,) configuration.
        v, a: (nv,) velocity and acceleration.
        wrenches: (6,) value of each of the robot's wrenches in its own axes, N and N·m (``wrench_values``); none at
            all leaves them out.
    """

    q: Array
    v: Array
    a: Array
    wrenches: Sequence[Array] = ()


class _Point(NamedTuple):
    """A point of a body: the joint that moves it, rotation (3, 3) of its link and position (3,) in the joint frame."""

    joint: int
    rotation: Array
    position: Array


class _Rotor(NamedTuple):
    """A rotor: I G in kg·m², G, its velocity index, parent joint, and the axis z (3,) in the parent's joint frame."""

    size: float
    gear: float
    column: int
    parent: int
    axis: Array


class TreeLoads:
    """The loads of one robot on its tree, payloads excepted: these are in the bodies of the model.

    All methods work at one state and write into the Pinocchio data that they are given.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.model = model = robot.model

        def point_of(frame: str, point: Array) -> _Point:
            link = find_link(model, frame)
            return _Point(int(link.parentJoint), link.placement.rotation, link.placement.act(np.array(point)))

        loads = robot.loads
        self._wrenches = [(load, point_of(load.frame, load.point)) for load in of_kind(loads, Wrench)]
        self._springs = [
            (load, point_of(load.frame_a, load.point_a), point_of(load.frame_b, load.point_b))
            for load in of_kind(loads, Spring)
        ]
        self._joints = [(load, find_joint(model, load.joint)) for load in of_kind(loads, JointForces)]
        self._rotors = [_rotor(model, load) for load, _ in self._joints if load.rotor_inertia and load.gear]
        self._on_bodies = bool(self._wrenches or self._springs or self._rotors)

    def body_forces(self, data: pin.Data, state: TreeState) -> list[pin.Force]:
        """Return the wrench on each body, by joint index, in its joint frame: RNEA's external forces.

        Index 0 has the forces of springs and rotors on the base; wrenches on the base are left out.
        """
        total = [pin.Force.Zero() for _ in range(self.model.njoints)]
        if not self._on_bodies:
            return total
        pin.forwardKinematics(self.model, data, state.q, state.v, state.a)
        for (load, point), value in zip(self._wrenches, state.wrenches, strict=False):
            if point.joint:
                total[point.joint] += _at_point(*_in_joint_frame(load, point, value, data), point)
        for spring, end_a, end_b in self._springs:
            force = _spring(spring, *_span(data, end_a, end_b))[0]
            for end, sign in ((end_b, 1.0), (end_a, -1.0)):
                local = sign * data.oMi[end.joint].rotation.T @ force
                total[end.joint] += _at_point(local, np.zeros(3), end)
        for rotor in self._rotors:
            turning = np.cross(data.v[rotor.parent].angular, rotor.axis)
            moment = -rotor.size * (state.a[rotor.column] * rotor.axis + state.v[rotor.column] * turning)
            total[rotor.parent] += pin.Force(np.zeros(3), moment)
        return total

    def joint_terms(self, data: pin.Data, state: TreeState) -> Array:
        """Return (nv,) friction, springs and rotor inertia of the joints, N or N·m; call ``body_forces`` first."""
        effort = np.zeros(self.model.nv)
        for load, joint in self._joints:
            columns = slice(joint.idx_v, joint.idx_v + joint.nv)
            # a joint of several coordinates has no spring
            position = state.q[joint.idx_q] if joint.nq == 1 else np.zeros(())
            effort[columns] += load.resistance(position, state.v[columns])
        for rotor in self._rotors:
            turning = float(rotor.axis @ data.a[rotor.parent].angular)
            effort[rotor.column] += rotor.size * (rotor.gear * state.a[rotor.column] + turning)
        return effort

    def rotor_mass(self, data: pin.Data, q: Array) -> Array:
        """Return (nv, nv) the rotors' part of the mass matrix: T = ½ I G² v² + I G v z·ω."""
        model = self.model
        mass = np.zeros((model.nv, model.nv))
        if self._rotors:
            pin.computeJointJacobians(model, data, q)
        for rotor in self._rotors:
            column = rotor.column
            mass[column, column] += rotor.size * rotor.gear
            if rotor.parent:
                coupling = rotor.size * (rotor.axis @ pin.getJointJacobian(model, data, rotor.parent, _LOCAL)[3:])
                mass[column] += coupling
                mass[:, column] += coupling
        return mass

    def external(self, data: pin.Data, state: TreeState) -> Array:
        """Return (nv,) Σ Jᵀ w of the wrenches alone, N or N·m."""
        effort = np.zeros(self.model.nv)
        if self._wrenches:
            pin.computeJointJacobians(self.model, data, state.q)
        for (load, point), value in zip(self._wrenches, state.wrenches, strict=True):
            if point.joint:
                wrench = _at_point(*_in_joint_frame(load, point, value, data), point)
                effort += pin.getJointJacobian(self.model, data, point.joint, _LOCAL).T @ wrench.vector
        return effort

    def energy(self, data: pin.Data, q: Array, v: Array) -> float:
        """Return the kinetic energy of the rotors relative to their links, plus the energy of the springs, J."""
        total = 0.0
        for load, joint in self._joints:
            if load.stiffness:
                total += 0.5 * load.stiffness * (q[joint.idx_q] - load.rest) ** 2
        if self._rotors or self._springs:
            pin.forwardKinematics(self.model, data, q, v)
        for rotor in self._rotors:
            rate = v[rotor.column]
            total += rotor.size * rate * (0.5 * rotor.gear * rate + rotor.axis @ data.v[rotor.parent].angular)
        for spring, end_a, end_b in self._springs:
            stretch = float(np.linalg.norm(_span(data, end_a, end_b)[0])) - spring.length
            total += 0.5 * spring.stiffness * stretch**2
        return float(total)

    def carrier_derivatives(self, data: pin.Data, state: TreeState, columns: IntArray) -> Array:
        """Return (3, nv, k) exact derivatives of the efforts by s, ṡ, s̈, to be added to RNEA's.

        ``pin.computeRNEADerivatives`` takes external forces as constant in the joint frames. Here follows how they
        change in these frames, and the derivatives of the joint terms.

        Args:
            data: workspace.
            state: a state of the tree.
            columns: (k,) velocity indices of the carriers.
        """
        model, v = self.model, state.v
        changes = _Changes(model, data, state, columns)
        by_q, by_v, by_a = derivatives = np.zeros((3, model.nv, len(columns)))
        for (load, point), value in zip(self._wrenches, state.wrenches, strict=True):
            if point.joint and load.reference == "world":
                force, moment = _in_joint_frame(load, point, value, data)
                turn = changes.jacobian(point.joint)[3:, columns]
                by_q -= changes.effort(point, -_cross(turn, force), -_cross(turn, moment))
        for spring, end_a, end_b in self._springs:
            by_place, by_speed = changes.span(end_a, end_b)
            force, along, across = _spring(spring, *_span(data, end_a, end_b))
            for end, sign in ((end_b, 1.0), (end_a, -1.0)):
                if not end.joint:
                    continue
                rotation = data.oMi[end.joint].rotation.T
                turn = changes.jacobian(end.joint)[3:, columns]
                moved = rotation @ (along @ by_place + across @ by_speed) - _cross(turn, rotation @ force)
                by_q -= changes.effort(end, sign * moved)
                by_v -= changes.effort(end, sign * (rotation @ across @ by_place))
        for rotor in self._rotors:
            own = (columns == rotor.column).astype(float)
            spin, rate, rate_by_v, rate_by_a = changes.turning(rotor.parent)
            speed, omega = v[rotor.column], data.v[rotor.parent].angular
            by_spin = changes.jacobian(rotor.parent)[3:, columns]
            moments = (
                speed * np.cross(spin.T, rotor.axis).T,
                speed * np.cross(by_spin.T, rotor.axis).T + np.outer(np.cross(omega, rotor.axis), own),
                np.outer(rotor.axis, own),
            )
            in_joint = rate, rate_by_v, rate_by_a
            for derivative, moment, turning in zip(derivatives, moments, in_joint, strict=True):
                derivative += rotor.size * (changes.jacobian(rotor.parent)[3:].T @ moment)
                derivative[rotor.column] += rotor.size * (rotor.axis @ turning)
            by_a[rotor.column] += rotor.size * rotor.gear * own
        for forces, joint in self._joints:
            if joint.nv == 1:
                own = (columns == joint.idx_v).astype(float)
                by_q[joint.idx_v] += forces.stiffness * own
                by_v[joint.idx_v] += forces.resistance_rate(v[joint.idx_v]) * own
        return derivatives


class _Changes:
    """How bodies move with the carriers, at one state: Pinocchio's kinematic derivatives, columns of the carriers."""

    def __init__(self, model: pin.Model, data: pin.Data, state: TreeState, columns: IntArray) -> None:
        self.model, self.data, self.columns = model, data, columns
        pin.computeJointJacobians(model, data, state.q)
        pin.computeForwardKinematicsDerivatives(model, data, state.q, state.v, state.a)

    def jacobian(self, joint: int) -> Array:
        """Return (6, nv) the body Jacobian in the joint frame; zero for the base."""
        jacobian: Array = pin.getJointJacobian(self.model, self.data, joint, _LOCAL)
        return jacobian if joint else np.zeros_like(jacobian)

    def effort(self, point: _Point, force: Array, moment: Array | None = None) -> Array:
        """Return (nv, k) Jᵀ w for forces and moments (3, k) at a point, in the joint frame."""
        about_origin = np.cross(point.position, force.T).T + (0.0 if moment is None else moment)
        effort: Array = self.jacobian(point.joint).T @ np.concatenate([force, about_origin])
        return effort

    def span(self, end_a: _Point, end_b: _Point) -> tuple[Array, Array]:
        """Return (3, k) derivatives by s of d = p_b − p_a (equal to ∂ḋ/∂ṡ) and of ḋ; world axes."""
        (speed_a, place_a), (speed_b, place_b) = (
            pin.getPointVelocityDerivatives(
                self.model, self.data, end.joint, pin.SE3(np.eye(3), end.position), _ALIGNED
            )
            if end.joint
            else np.zeros((2, 3, self.model.nv))
            for end in (end_a, end_b)
        )
        return (place_b - place_a)[:, self.columns], (speed_b - speed_a)[:, self.columns]

    def turning(self, joint: int) -> tuple[Array, Array, Array, Array]:
        """Return (3, k) derivatives of ω by s, and of ω̇ by s, ṡ and s̈, in the joint frame."""
        if not joint:
            zero = np.zeros((3, len(self.columns)))
            return zero, zero, zero, zero
        by = pin.getJointAccelerationDerivatives(self.model, self.data, joint, _LOCAL)
        spin, rate, rate_by_v, rate_by_a = (part[3:, self.columns] for part in by)
        return spin, rate, rate_by_v, rate_by_a


def _rotor(model: pin.Model, load: JointForces) -> _Rotor:
    index = find_joint_index(model, load.joint)
    joint = model.joints[index]
    subspace = np.reshape(joint.createData().S, (6, 1))[:, 0]
    axis = model.jointPlacements[index].rotation @ (subspace[:3] if slides(joint) else subspace[3:])
    return _Rotor(load.rotor_inertia * load.gear, load.gear, int(joint.idx_v), int(model.parents[index]), axis)


def _in_joint_frame(load: Wrench, point: _Point, value: Array, data: pin.Data) -> tuple[Array, Array]:
    """Return force and moment (3,) of a wrench at its point, in the joint frame."""
    rotation = point.rotation if load.reference == "local" else data.oMi[point.joint].rotation.T
    return rotation @ value[:3], rotation @ value[3:]


def _at_point(force: Array, moment: Array, point: _Point) -> pin.Force:
    """Return the wrench at the joint's origin of a force and a moment at a point, in the joint frame."""
    return pin.Force(force, moment + np.cross(point.position, force))


def _span(data: pin.Data, end_a: _Point, end_b: _Point) -> tuple[Array, Array]:
    """Return d = p_b − p_a and ḋ (3,), world axes, m and m/s."""
    places, rates = [], []
    for end in (end_a, end_b):
        placement, twist = data.oMi[end.joint], data.v[end.joint]
        places.append(placement.act(end.position))
        rates.append(placement.rotation @ (twist.linear + np.cross(twist.angular, end.position)))
    return places[1] - places[0], rates[1] - rates[0]


def _spring(spring: Spring, d: Array, rate: Array) -> tuple[Array, Array, Array]:
    """Return the force (3,) on the end b, and its derivatives (3, 3) by d and by ḋ, world axes.

    F = −φ u with u = d / l and φ = k (l − l₀) + c u·ḋ; ∂u/∂d = P / l with P = 1 − u uᵀ. A spring without length has no
    direction, and no force.
    """
    length = float(np.linalg.norm(d))
    unit, inverse = (d / length, 1.0 / length) if length else (np.zeros(3), 0.0)
    size = spring.stiffness * (length - spring.length) + spring.damping * float(unit @ rate)
    across = inverse * (np.eye(3) - np.outer(unit, unit))
    by_place = -np.outer(unit, spring.stiffness * unit + spring.damping * (across @ rate)) - size * across
    return -size * unit, by_place, -spring.damping * np.outer(unit, unit)


def _cross(columns: Array, vector: Array) -> Array:
    """Return (3, k) the cross products of columns (3, k) with a vector (3,)."""
    product: Array = np.cross(columns.T, vector).T
    return product


@lru_cache(maxsize=16)
def tree_loads(robot: Robot) -> TreeLoads | None:
    """Return the loads of a robot on its tree; None without any but payloads, which the bodies of its model have."""
    return TreeLoads(robot) if any(not isinstance(load, Payload) for load in robot.loads) else None


def tree_effort(robot: Robot, data: pin.Data, state: TreeState) -> Array:
    """Return (nv,) generalised forces of the open tree at one state, loads included, N or N·m.

    ``data`` is a workspace of the robot's model.
    """
    loads, forces = tree_loads(robot), []
    if loads is not None:
        forces.append(loads.body_forces(data, state))
    effort: Array = pin.rnea(robot.model, data, state.q, state.v, state.a, *forces)
    return effort if loads is None else effort + loads.joint_terms(data, state)


def tree_equations(robot: Robot, data: pin.Data, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return (nv,) generalised forces of the tree at one state, wrenches left out, and its mass matrix.

    Only the upper triangle of the mass matrix (nv, nv) is filled.
    """
    loads, effort = tree_loads(robot), tree_effort(robot, data, TreeState(q, v, a))
    mass: Array = pin.crba(robot.model, data, q)
    return effort, mass if loads is None else mass + loads.rotor_mass(data, q)


def tree_energy(robot: Robot, data: pin.Data, q: Array, v: Array) -> float:
    """Return kinetic plus potential energy, J, at q (nq,), v (nv,), with armature, rotors and springs.

    The kinetic energy is ½ vᵀ M v: ``pin.computeKineticEnergy`` leaves out the armature of joints about skew axes
    (Pinocchio 4.1).
    """
    model, loads = robot.model, tree_loads(robot)
    mass = pin.crba(model, data, q)
    kinetic = v @ (np.triu(mass) @ v) - 0.5 * np.diagonal(mass) @ v**2
    energy = float(kinetic + pin.computePotentialEnergy(model, data, q))
    return energy if loads is None else energy + loads.energy(data, q, v)
