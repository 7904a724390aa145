"""The loads of a robot in casadi's symbols, body by body, as Newton and Euler take them.

A force on a body is taken from what the body asks of its joint, in the body's frame and about its joint's origin; what
acts in a joint is added to the joint's effort. Written for this backend alone, like the chain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled.parameters import JOINT_NUMBERS, SPRING_NUMBERS
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.robot import JointForces, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint_index, find_link

if TYPE_CHECKING:
    from redundancy_pin.dynamics.compiled.symbols import SymbolicChain

SX: TypeAlias = Any

L = TypeVar("L", JointForces, Spring, Wrench)


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

    def _loads_of(self, kind: type[L]) -> list[tuple[int, L]]:
        """Return the loads of a kind, each with its index among all loads of the robot."""
        return [(i, load) for i, load in enumerate(self.chain.robot.loads) if isinstance(load, kind)]

    def _numbers(self, load: int, names: tuple[str, ...]) -> list[SX]:
        return [self.chain.number("load", load, name) for name in names]

    def on_bodies(self, add: Callable[[int, SX, SX, SX], None]) -> None:
        """Hand over all forces on bodies: joint index, place, force and moment, world axes.

        The reaction of a spring on the base is among them, so that what holds the base is without it.
        """
        for k, (i, wrench) in enumerate(self._loads_of(Wrench)):
            force, moment = self.external[6 * k : 6 * k + 3], self.external[6 * k + 3 : 6 * k + 6]
            rotation, place = self._point(wrench.frame, i, "point")[:2]
            if wrench.reference == "local":
                force, moment = rotation @ force, rotation @ moment
            if self._body(wrench.frame):
                add(self._body(wrench.frame), place, force, moment)
        for i, spring in self._loads_of(Spring):
            _, a, speed_a = self._point(spring.frame_a, i, "point_a")
            _, b, speed_b = self._point(spring.frame_b, i, "point_b")
            length, unit = self._line(b - a)
            rate = self.ca.dot(unit, speed_b - speed_a)
            stiffness, damping, relaxed = self._numbers(i, SPRING_NUMBERS)
            force = (stiffness * (length - relaxed) + damping * rate) * unit
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
        for i, load in self._loads_of(JointForces):
            if find_joint_index(self.chain.model, load.joint) != index:
                continue
            damping, friction, friction_speed, stiffness, rest, inertia, gear = self._numbers(i, JOINT_NUMBERS)
            effort += damping * v + friction * self.ca.tanh(v / friction_speed) + stiffness * (q - rest)
            size = inertia * gear
            if not size.is_zero():
                effort += size * (gear * a + self.ca.dot(axis, turn))
                moment += size * (axis * a + self.ca.cross(spin, axis) * v)
        return effort, moment

    def energy(self, joint: Callable[[int], tuple[SX, SX, SX, SX]]) -> SX:
        """Return the energy of rotors and springs, J; ``joint`` gives q, v, axis and spin, world axes."""
        total = self.ca.SX(0.0)
        for i, load in self._loads_of(JointForces):
            _, _, _, stiffness, rest, inertia, gear = self._numbers(i, JOINT_NUMBERS)
            if stiffness.is_zero() and inertia.is_zero():
                continue  # a ball has neither
            q, v, axis, spin = joint(find_joint_index(self.chain.model, load.joint))
            total += 0.5 * stiffness * (q - rest) ** 2
            total += inertia * gear * v * (0.5 * gear * v + self.ca.dot(axis, spin))
        for i, spring in self._loads_of(Spring):
            a, b = self._point(spring.frame_a, i, "point_a")[1], self._point(spring.frame_b, i, "point_b")[1]
            stiffness, _, relaxed = self._numbers(i, SPRING_NUMBERS)
            total += 0.5 * stiffness * (self._line(b - a)[0] - relaxed) ** 2
        return total

    def _line(self, line: SX) -> tuple[SX, SX]:
        """Return length and direction; the direction is zero at length zero, to avoid 0/0."""
        length = self.ca.sqrt(self.ca.dot(line, line))
        return length, line / (length + (length == 0.0))

    def _body(self, name: str) -> int:
        model = self.chain.model
        return int(find_link(model, name).parentJoint)

    def _point(self, name: str, load: int, point: str) -> tuple[SX, SX, SX]:
        """Return rotation of a link, a point of it that a load names, and its velocity, in the world."""
        rotation, origin, spin, speed = self.chain.frame(name)
        arm = rotation @ self.chain.number("load", load, point)
        return rotation, origin + arm, speed + self.ca.cross(spin, arm)


def constant_wrenches(robot: Robot) -> Array:
    """Return (6 w,) the wrenches of a robot as numbers.

    Raises:
        UnsupportedRobotError: a wrench is not constant.
    """
    values = []
    for load in of_kind(robot.loads, Wrench):
        if not isinstance(load.value, np.ndarray) or load.value.ndim != 1:
            raise UnsupportedRobotError(
                f"{load!r} is not constant; these expressions allow constant wrenches only.",
                remedy="Pass six numbers, or the robot without that wrench, and take its share by its Jacobian.",
                frame=load.frame,
            )
        values.append(load.value)
    return np.concatenate(values) if values else np.zeros(0)
