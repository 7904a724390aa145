"""What the loads of a robot ask of the joints of its tree, for many samples at once.

Every load is a wrench w on a body (about the world origin, world axes), or acts in a joint alone. With J the joints'
spatial velocities at the world origin, the generalised forces beside rnea(q, v, a) are

    L = (friction, springs and reflected inertia of each joint) − Σ Jᵀ w.

A rotor of inertia I and ratio G spins at G v about the joint's axis z relative to the link that carries it, whose
angular velocity is ω. Beyond the motion with that link, which is the link's own, its angular momentum is I G v z:

    I (G² v̇ + G z·ω̇) in its joint,    and −I G (v̇ z + v ω × z) as a moment on the link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics.tree import TreeKinematics, TreePose, cross
from redundancy_pin.robot import JointForces, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint, find_joint_index, find_link
from redundancy_pin.robot.scales import velocity_unit
from redundancy_pin.robot.types import slides


@dataclass(frozen=True, eq=False)
class TreeState:
    """N samples of the tree.

    Attributes:
        q, v, a: (N, nq), (N, nv), (N, nv), carriers included.
        wrenches: (N, 6) the value of each of the robot's wrenches (``wrench_values``).
    """

    q: Array
    v: Array
    a: Array
    wrenches: tuple[Array, ...] = ()


class TreeLoads:
    """The loads of one robot on its tree.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        loads, model = robot.loads, robot.model
        self._wrenches, self._springs = of_kind(loads, Wrench), of_kind(loads, Spring)
        self._joints = [(load, find_joint(model, load.joint)) for load in of_kind(loads, JointForces)]
        self._rotors = [_Rotor(robot, load) for load, _ in self._joints if load.rotor_inertia and load.gear]
        frames = {wrench.frame for wrench in self._wrenches} | {rotor.frame for rotor in self._rotors}
        frames |= {frame for spring in self._springs for frame in (spring.frame_a, spring.frame_b)}
        self.has_rotors = bool(self._rotors)
        self._frames = sorted(frames)
        self._carried_by = {name: int(find_link(model, name).parentJoint) for name in self._frames}
        self.supports = [
            [
                column
                for joint in model.supports[index]
                if joint > 0
                for column in range(model.joints[joint].idx_v, model.joints[joint].idx_v + model.joints[joint].nv)
            ]
            for index in range(model.njoints)
        ]

    @cached_property
    def _tree(self) -> TreeKinematics:
        return TreeKinematics(self.robot.model, self._frames)

    def efforts(self, state: TreeState, *, joints: bool = True) -> Array:
        """Return L (nv, N), N or N·m; without friction and springs of joints where they are not wanted.

        A state without values of wrenches is one without wrenches.
        """
        effort = np.zeros((self.robot.model.nv, len(state.q)))
        if joints:
            for load, joint in self._joints:
                for column in range(joint.idx_v, joint.idx_v + joint.nv):
                    v = state.v[:, column]
                    effort[column] += load.resistance(state.q[:, joint.idx_q] if joint.nq == 1 else 0.0 * v, v)
        if self._frames:
            placed = self._placed(state)
            for index, wrench in self._bodies(state, placed).items():
                for column in self.supports[index]:
                    effort[column] -= np.einsum("in,in->n", placed.pose.jacobian[:, column], wrench)
            for rotor, spin in zip(self._rotors, placed.spins, strict=True):
                effort[rotor.column] += rotor.load.rotor_inertia * rotor.load.gear * spin.turn
        return effort

    def rotor_mass(self, state: TreeState) -> Array:
        """Return (nv, nv) what the rotors add to the mass matrix at one sample."""
        nv = self.robot.model.nv
        at_rest = TreeState(np.repeat(state.q, nv, axis=0), np.zeros((nv, nv)), np.eye(nv))
        mass, placed = np.zeros((nv, nv)), self._placed(at_rest)
        for rotor, spin in zip(self._rotors, placed.spins, strict=True):
            size = rotor.load.rotor_inertia * rotor.load.gear
            mass[rotor.column] += size * spin.turn
            for column in self.supports[rotor.parent]:
                mass[column] += size * np.einsum("in,in->n", placed.pose.jacobian[3:, column], spin.rate)
        return mass

    def external(self, state: TreeState) -> Array:
        """Return (nv, N) Σ Jᵀ w of the wrenches alone."""
        effort, pose = np.zeros((self.robot.model.nv, len(state.q))), self._tree.pose(state.q)
        for wrench, value in zip(self._wrenches, state.wrenches, strict=True):
            total = _external(wrench, value, _Placed(pose, {}, []))
            for column in self.supports[self._carried_by[wrench.frame]]:
                effort[column] += np.einsum("in,in->n", pose.jacobian[:, column], total)
        return effort

    def bodies(self, state: TreeState) -> dict[int, Array]:
        """Return by joint index the wrench (6, N) on the body it moves: about the world origin, world axes."""
        return self._bodies(state, self._placed(state)) if self._frames else {}

    def resultant(self, state: TreeState) -> Array:
        """Return (N, 6) what of the loads reaches the base: external wrenches less the rate of the rotors' momentum."""
        total = np.zeros((6, len(state.q)))
        if self._frames:
            placed = self._placed(state)
            for wrench, value in zip(self._wrenches, state.wrenches, strict=True):
                if self._carried_by[wrench.frame]:
                    total += _external(wrench, value, placed)
            for rotor, spin in zip(self._rotors, placed.spins, strict=True):
                total[3:] -= rotor.load.rotor_inertia * rotor.load.gear * spin.rate
        return np.ascontiguousarray(total.T)

    def energy(self, state: TreeState) -> Array:
        """Return (N,) kinetic energy of the rotors beyond that of their links, and energy of the springs, J."""
        total = np.zeros(len(state.q))
        for load, joint in self._joints:
            if load.stiffness:
                total += 0.5 * load.stiffness * (state.q[:, joint.idx_q] - load.rest) ** 2
        if self._frames:
            placed = self._placed(state)
            for rotor, spin in zip(self._rotors, placed.spins, strict=True):
                size = rotor.load.rotor_inertia * rotor.load.gear
                v = state.v[:, rotor.column]
                total += size * v * (0.5 * rotor.load.gear * v + spin.link)
            for spring in self._springs:
                line = placed.point(spring.frame_b, spring.point_b) - placed.point(spring.frame_a, spring.point_a)
                total += 0.5 * spring.stiffness * (np.linalg.norm(line, axis=0) - spring.length) ** 2
        return total

    def carrier_derivatives(self, state: TreeState) -> tuple[Array, Array, Array]:
        """Return the derivatives (N, nv, k) of L by s, ṡ, s̈ of carriers that slide or turn.

        L is quadratic in the rates of carriers and affine in s of one that slides, so differences are exact there up to
        rounding; for what turns with s, and springs, they are of order eight and reach rounding too.
        """
        robot = self.robot
        samples, nv = state.v.shape
        derivatives = [np.zeros((samples, nv, robot.k)) for _ in range(3)]
        unit = velocity_unit(robot)
        reach = _STEP * np.clip(self._shortest(state) / robot.characteristic_length, 1e-4, 1.0)
        rates = [np.abs(rate / unit).max(axis=1, initial=0.0) for rate in (state.v, state.a)]
        sizes = reach, *(np.where(rate > 0.0, rate, 1.0) for rate in rates)
        places = (robot.carrier_position, robot.carrier_velocity, robot.carrier_velocity)
        for i, column in enumerate(robot.carrier_velocity.tolist()):
            for order, (name, derivative) in enumerate(zip("qva", derivatives, strict=True)):
                weights, step = _EIGHTH if order == 0 else {1: 0.5}, sizes[order] * unit[column]
                for distance, weight in weights.items():
                    for sign in (1.0, -1.0):
                        moved = np.array(getattr(state, name))
                        moved[:, places[order][i]] += sign * distance * step
                        parts = {"q": state.q, "v": state.v, "a": state.a, name: moved}
                        shifted = TreeState(**parts, wrenches=state.wrenches)
                        derivative[:, :, i] += sign * weight * (self.efforts(shifted, joints=False) / step).T
            for load, joint in self._joints:
                if joint.idx_v == column:
                    derivatives[0][:, column, i] += load.stiffness
                    derivatives[1][:, column, i] += load.resistance_rate(state.v[:, column])
        return derivatives[0], derivatives[1], derivatives[2]

    def _shortest(self, state: TreeState) -> Array:
        """Return (N,) the length of the shortest spring, m: how fast forces bend with places."""
        shortest = np.full(len(state.q), np.inf)
        if not self._springs:
            return shortest
        placed = self._placed(state)
        for spring in self._springs:
            line = placed.point(spring.frame_b, spring.point_b) - placed.point(spring.frame_a, spring.point_a)
            shortest = np.minimum(shortest, np.linalg.norm(line, axis=0))
        return shortest

    def _placed(self, state: TreeState) -> _Placed:
        pose = self._tree.pose(state.q)
        motions = self._tree.motions(pose, state.v) if self._springs or self._rotors else {}
        placed = _Placed(pose, motions, [])
        return replace(placed, spins=[rotor.spin(placed, state, self.supports) for rotor in self._rotors])

    def _bodies(self, state: TreeState, placed: _Placed) -> dict[int, Array]:
        total: dict[int, Array] = {}

        def add(joint: int, wrench: Array) -> None:
            total[joint] = total.get(joint, 0.0) + wrench

        for wrench, value in zip(self._wrenches, state.wrenches, strict=False):  # none are given, or all
            add(self._carried_by[wrench.frame], _external(wrench, value, placed))
        for spring in self._springs:
            on_b = _spring_wrench(spring, placed)
            add(self._carried_by[spring.frame_b], on_b)
            add(self._carried_by[spring.frame_a], -on_b)
        for rotor, spin in zip(self._rotors, placed.spins, strict=True):
            moment = -rotor.load.rotor_inertia * rotor.load.gear * spin.rate
            add(rotor.parent, np.concatenate([np.zeros_like(moment), moment]))
        return total


_EIGHTH = {1: 4.0 / 5.0, 2: -1.0 / 5.0, 3: 4.0 / 105.0, 4: -1.0 / 280.0}
"""Weights of central differences of order eight, by distance in steps (Fornberg 1988)."""

_STEP = 0.02
"""Of those differences, in lengths of the shortest spring, at most characteristic lengths or rad."""


@dataclass(frozen=True, eq=False)
class _Spin:
    """Of a rotor, by unit of I G: what its joint feels (N,), the rate of its momentum (3, N), and z·ω of its link."""

    turn: Array
    rate: Array
    link: Array


@dataclass(frozen=True, eq=False)
class _Placed:
    pose: TreePose
    motions: dict[str, tuple[Array, Array]]
    spins: list[_Spin]  # of each rotor: a joint may have several

    def point(self, frame: str, point: Array) -> Array:
        """Return (3, N) a point of a frame in the world, m."""
        place: Array = self.pose.frame_origin[frame] + np.einsum("ijn,j->in", self.pose.frame_rotation[frame], point)
        return place

    def velocity(self, frame: str, place: Array) -> Array:
        """Return (3, N) the velocity of the body's point that is at ``place``, m/s."""
        twist = self.motions[frame][0]
        velocity: Array = twist[:3] + cross(twist[3:], place)
        return velocity


class _Rotor:
    """A rotor, carried by the link before its joint and followed by a link behind it."""

    def __init__(self, robot: Robot, load: JointForces) -> None:
        model = robot.model
        index = find_joint_index(model, load.joint)
        joint = model.joints[index]
        self.load, self.column, self.joint = load, int(joint.idx_v), index
        self.parent = int(model.parents[index])
        self.turning = not slides(joint)
        links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint == index]
        if not links:
            raise UnsupportedRobotError(
                f"No link is named behind the joint {load.joint!r}, whose rotor therefore cannot be followed.",
                remedy="Add a frame of type BODY to the model there.",
                joint=load.joint,
            )
        self.frame = str(links[0].name)

    def spin(self, placed: _Placed, state: TreeState, supports: Sequence[Sequence[int]]) -> _Spin:
        """Return how it moves at N samples."""
        jacobian, column = placed.pose.jacobian, self.column
        axis = jacobian[3:, column] if self.turning else jacobian[:3, column]
        velocity, acceleration = placed.motions[self.frame]
        v, a = state.v[:, column], state.a[:, column]
        omega, turn = velocity[3:], np.array(acceleration[3:])
        for each in supports[self.joint]:
            turn += jacobian[3:, each] * state.a[:, each]
        if self.turning:  # back from the link behind the joint to the one before it
            omega, turn = omega - axis * v, turn - axis * a  # but for what is across the axis, and has no share in drag
        drag = np.einsum("in,in->n", axis, turn)
        return _Spin(self.load.gear * a + drag, axis * a + cross(omega, axis) * v, np.einsum("in,in->n", axis, omega))


def _external(wrench: Wrench, value: Array, placed: _Placed) -> Array:
    """Return (6, N) a wrench about the world origin, world axes."""
    force, moment = np.split(np.ascontiguousarray(value.T), 2)
    if wrench.reference == "local":
        rotation = placed.pose.frame_rotation[wrench.frame]
        force, moment = (np.einsum("ijn,jn->in", rotation, part) for part in (force, moment))
    return np.concatenate([force, moment + cross(placed.point(wrench.frame, wrench.point), force)])


def _spring_wrench(spring: Spring, placed: _Placed) -> Array:
    """Return (6, N) the wrench of a spring on its frame b, about the world origin."""
    a, b = placed.point(spring.frame_a, spring.point_a), placed.point(spring.frame_b, spring.point_b)
    line = b - a
    length = np.linalg.norm(line, axis=0)
    unit = np.divide(line, length, out=np.zeros_like(line), where=length > 0.0)
    rate = np.einsum("in,in->n", unit, placed.velocity(spring.frame_b, b) - placed.velocity(spring.frame_a, a))
    force = -(spring.stiffness * (length - spring.length) + spring.damping * rate) * unit
    return np.concatenate([force, cross(b, force)])


@lru_cache(maxsize=16)
def tree_loads(robot: Robot) -> TreeLoads | None:
    """Return the loads of a robot on its tree; None where payloads, which its bodies have, are all there is."""
    return TreeLoads(robot) if any(not isinstance(load, Payload) for load in robot.loads) else None


def tree_equations(robot: Robot, data: pin.Data, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return (nv,) generalised forces of the tree at one state, wrenches left out, and its mass matrix.

    Of the mass matrix (nv, nv) the upper triangle counts.
    """
    model, loads = robot.model, tree_loads(robot)
    effort, mass = np.array(pin.rnea(model, data, q, v, a)), pin.crba(model, data, q)
    if loads is not None:
        state = TreeState(q[None], v[None], a[None])
        effort += loads.efforts(state)[:, 0]
        mass = mass + loads.rotor_mass(state) if loads.has_rotors else mass
    return effort, mass


def tree_energy(model: pin.Model, data: pin.Data, q: Array, v: Array) -> float:
    """Return kinetic plus potential energy, J, at q (nq,), v (nv,); armature in it.

    The former is ½ vᵀ M v: ``computeKineticEnergy`` leaves out the armature of joints about skew axes (Pinocchio 4.1).
    """
    mass = pin.crba(model, data, q)
    kinetic = v @ (np.triu(mass) @ v) - 0.5 * np.diagonal(mass) @ v**2
    return float(kinetic + pin.computePotentialEnergy(model, data, q))
