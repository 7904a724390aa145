"""The loads of a robot in casadi's symbols, body by body, as Newton and Euler take them.

A force on a body is taken from what the body asks of its joint, in the body's frame and about its joint's origin; what
acts in a joint is added to the joint's effort. Written for this backend alone, like the chain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.robot import JointForces, Load, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint_index, find_link

if TYPE_CHECKING:
    from redundancy_pin.dynamics.compiled.symbols import SymbolicChain

SX: TypeAlias = Any


@dataclass(frozen=True, eq=False)
class LoadSymbols:
    """Loads over the expressions of a chain.

    Attributes:
        chain: the chain.
        ca: casadi.
        external: (6 w) force and moment of each of the robot's wrenches, in its own axes.
    """

    chain: SymbolicChain
    ca: Any
    external: SX

    @property
    def _loads(self) -> tuple[Load, ...]:
        return self.chain.robot.loads

    def on_bodies(self, add: Callable[[int, SX, SX, SX], None]) -> None:
        """Hand over all forces on bodies: joint index, place, force and moment, world axes.

        The reaction of a spring on the base is among them, so that what holds the base is without it.
        """
        for k, wrench in enumerate(of_kind(self._loads, Wrench)):
            force, moment = self.external[6 * k : 6 * k + 3], self.external[6 * k + 3 : 6 * k + 6]
            rotation, place = self._point(wrench.frame, wrench.point)[:2]
            if wrench.reference == "local":
                force, moment = rotation @ force, rotation @ moment
            if self._body(wrench.frame):
                add(self._body(wrench.frame), place, force, moment)
        for spring in of_kind(self._loads, Spring):
            (_, a, speed_a), (_, b, speed_b) = (
                self._point(spring.frame_a, spring.point_a),
                self._point(spring.frame_b, spring.point_b),
            )
            length, unit = self._line(b - a)
            rate = self.ca.dot(unit, speed_b - speed_a)
            force = (spring.stiffness * (length - spring.length) + spring.damping * rate) * unit
            add(self._body(spring.frame_a), a, force, self.ca.SX.zeros(3))
            add(self._body(spring.frame_b), b, -force, self.ca.SX.zeros(3))

    def in_joint(self, index: int, own: tuple[SX, SX, SX], axis: SX, spin: SX, turn: SX) -> tuple[SX, SX]:
        """Return the effort that a joint takes, and the moment (3) that its rotors take from the link before it.

        Args:
            index: the joint.
            own: its position, rate and acceleration, (3) each of the latter two of a ball.
            axis: (3) its axis, in the frame of the link before it, as are the others.
            spin: (3) angular velocity of that link.
            turn: (3) its rate.
        """
        (q, v, a), moment = own, self.ca.SX.zeros(3)
        effort = 0.0 * v
        for load in of_kind(self._loads, JointForces):
            if find_joint_index(self.chain.model, load.joint) == index:
                effort += load.damping * v + load.friction * self.ca.tanh(v / load.friction_speed)
                if load.stiffness:
                    effort += load.stiffness * (q - load.rest)
                if size := load.rotor_inertia * load.gear:
                    effort += size * (load.gear * a + self.ca.dot(axis, turn))
                    moment += size * (axis * a + self.ca.cross(spin, axis) * v)
        return effort, moment

    def energy(self, joint: Callable[[int], tuple[SX, SX, SX, SX]]) -> SX:
        """Return what rotors and springs add to the energy, J; ``joint`` gives q, v, axis and spin, world axes."""
        total = self.ca.SX(0.0)
        for load in (each for each in of_kind(self._loads, JointForces) if each.stiffness or each.rotor_inertia):
            q, v, axis, spin = joint(find_joint_index(self.chain.model, load.joint))
            if load.stiffness:
                total += 0.5 * load.stiffness * (q - load.rest) ** 2
            total += load.rotor_inertia * load.gear * v * (0.5 * load.gear * v + self.ca.dot(axis, spin))
        for spring in of_kind(self._loads, Spring):
            a, b = self._point(spring.frame_a, spring.point_a)[1], self._point(spring.frame_b, spring.point_b)[1]
            total += 0.5 * spring.stiffness * (self._line(b - a)[0] - spring.length) ** 2
        return total

    def _line(self, line: SX) -> tuple[SX, SX]:
        """Return length and direction; none at length zero, as in C a quotient of zeros is no number."""
        length = self.ca.sqrt(self.ca.dot(line, line))
        return length, line / (length + (length == 0.0))

    def _body(self, name: str) -> int:
        model = self.chain.model
        return int(find_link(model, name).parentJoint)

    def _point(self, name: str, point: Array) -> tuple[SX, SX, SX]:
        """Return rotation of a link, a point of it and its velocity, in the world."""
        rotation, origin, spin, speed = self.chain.frame(name)
        arm = rotation @ self.ca.SX(np.array(point))
        return rotation, origin + arm, speed + self.ca.cross(spin, arm)


def shape_of(robot: Robot) -> str:
    """Return what of a robot's loads is compiled: all but the values of wrenches."""
    wrenches = [(load.frame, load.reference, load.point.tolist()) for load in of_kind(robot.loads, Wrench)]
    return repr((wrenches, [load for load in robot.loads if not isinstance(load, Wrench)]))


def constant_wrenches(robot: Robot) -> Array:
    """Return (6 w,) the wrenches of a robot as numbers.

    Raises:
        UnsupportedRobotError: one is no constant.
    """
    values = []
    for load in of_kind(robot.loads, Wrench):
        if not isinstance(load.value, np.ndarray) or load.value.ndim != 1:
            raise UnsupportedRobotError(
                f"{load!r} is no constant, which is all that these expressions can hold.",
                remedy="Pass six numbers, or the robot without that wrench, and take its share by its Jacobian.",
                frame=load.frame,
            )
        values.append(load.value)
    return np.concatenate(values) if values else np.zeros(0)
