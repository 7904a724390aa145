"""Forces on a robot other than gravity and inertia: wrenches, payloads, friction, rotors, springs.

They belong to the robot (``robot.loaded(...)``), so that inverse dynamics, planners and the simulation have the same
ones. With L(q, v, a) the generalised forces that they ask of the joints, the equations of motion of the tree are

    rnea(q, v, a) + L(q, v, a) = efforts + closure forces.

Each backend computes L by itself; this module defines its terms.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, TypeAlias, TypeVar, cast, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, Frozen, assign, checked
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.robot.lookup import find_joint, find_link

Axes: TypeAlias = Literal["world", "local"]
"""Axes of a wrench: those of the world, or those of its frame."""

WrenchLaw: TypeAlias = Callable[[Array, Array, Array], ArrayLike]
"""From t (N,), x (N, n) or poses (N, 4, 4), and ẋ (N, n) to wrenches (N, 6)."""

_T = TypeVar("_T")


def _vector(values: ArrayLike, name: str) -> Array:
    return checked(values, name, (3,))


def _number(value: float, name: str, *, least: float) -> float:
    number = float(checked(value, name, ()))
    if number < least:
        raise InputError(f"{name} is {number:g}.", remedy=f"It is at least {least:g}.", name=name)
    return number


class _Listed:
    """Shows all that it is, arrays as lists."""

    def __repr__(self) -> str:
        """Return the call that makes it."""
        values = (getattr(self, field.name) for field in fields(cast(Any, self)))
        listed = (repr(value.tolist() if isinstance(value, np.ndarray) else value) for value in values)
        return f"{type(self).__name__}({', '.join(listed)})"


@dataclass(frozen=True, init=False, eq=False)
class Wrench(Frozen):
    """Force and moment that act on a link from outside, as a process or a hand does.

    Attributes:
        frame: name of the link.
        value: (6,) force, N, and moment, N·m, that act on the frame; (N, 6) at the samples of one motion; or a function
            of t (N,), x (N, n) or (N, 4, 4) and ẋ (N, n) that returns (N, 6): a process force by time, pose and speed.
        reference: axes of force and moment, "world" or "local" (the frame's).
        point: (3,) where the force acts, in the frame, m; its origin when left out.

    Raises:
        InputError: shapes, or values that are not finite.

    Example:
        >>> push = rp.Wrench("end_effector", [0.0, -5.0, 0.0, 0.0, 0.0, 0.0])
        >>> rp.load_robot("five_bar").loaded(push).loads[0].frame
        'end_effector'
    """

    frame: str
    value: Array | WrenchLaw
    reference: Axes
    point: Array

    def __init__(
        self, frame: str, value: ArrayLike | WrenchLaw, reference: Axes = "world", point: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        if reference not in get_args(Axes):
            raise InputError(f"reference is {reference!r}.", remedy='Pass "world" or "local".', reference=reference)
        given: Array | WrenchLaw
        if callable(value):
            given = value
        else:
            rows = np.ndim(np.asarray(value, dtype=object)) == 1
            given = checked(value, f"The wrench on {frame}", (6,) if rows else ("N", 6))
        assign(self, frame=frame, value=given, reference=reference, point=_vector(point, "point"))

    def __repr__(self) -> str:
        """Return all that it is: of samples a hash, of a function its name."""
        if not isinstance(self.value, np.ndarray):
            value = getattr(self.value, "__qualname__", type(self.value).__name__)
        elif self.value.ndim == 1:
            value = str(self.value.tolist())
        else:
            value = f"{len(self.value)} samples {hashlib.sha256(self.value.tobytes()).hexdigest()[:12]}"
        at = f", point={self.point.tolist()}" if self.point.any() else ""
        return f"Wrench({self.frame!r}, {value}, {self.reference!r}{at})"

    def at(self, t: Array, x: Array, xd: Array) -> Array:
        """Return (N, 6) the wrench at N samples, in its own axes.

        Args:
            t: (N,) time, s.
            x: (N, n) platform coordinates, or (N, 4, 4) poses.
            xd: (N, n) their rate.

        Raises:
            InputError: samples of another motion, or a function that does not return (N, 6).
        """
        if not isinstance(self.value, np.ndarray):
            return checked(
                self.value(t, x, xd), f"What the function of the wrench on {self.frame!r} returns", (len(t), 6)
            )
        if self.value.ndim == 2 and len(self.value) != len(t):
            raise InputError(
                f"The wrench on {self.frame!r} has {len(self.value)} samples, the motion {len(t)}.",
                remedy="Pass one row for each sample to reduce(..., external=...); planners and simulate ask for other "
                "instants, and take six numbers or a function of t, x and xd.",
                frame=self.frame,
            )
        return np.broadcast_to(self.value, (len(t), 6))


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Payload(_Listed, Frozen):
    """A mass that a link carries, rigidly.

    Attributes:
        frame: name of the link.
        mass: kg.
        centre: (3,) its centre of mass in the frame, m.
        inertia: (3, 3) about its centre of mass, axes of the frame, kg·m²; a number for a ball; zero for a point.

    Raises:
        InputError: a negative mass, an inertia that no body has.

    Example:
        >>> rp.load_robot("five_bar").loaded(rp.Payload("end_effector", 0.5)).loads[0].mass
        0.5
    """

    frame: str
    mass: float
    centre: Array
    inertia: Array

    def __init__(self, frame: str, mass: float, centre: ArrayLike = (0.0, 0.0, 0.0), inertia: ArrayLike = 0.0) -> None:
        ball = np.ndim(np.asarray(inertia, dtype=object)) == 0
        given = checked(inertia, "inertia", () if ball else (3, 3))
        matrix = checked(given * np.eye(3), "inertia", (3, 3)) if ball else given
        moments = np.linalg.eigvalsh(matrix)
        allowed = 1e-9 * float(np.abs(moments).max())
        if (
            np.abs(matrix - matrix.T).max() > allowed
            or moments[0] < -allowed
            or moments[2] > moments[:2].sum() + allowed
        ):
            raise InputError(
                f"The inertia of the payload on {frame!r} has principal moments {moments.tolist()}, which no body has.",
                remedy="Pass a symmetric matrix about the centre of mass, kg·m².",
                frame=frame,
            )
        assign(
            self, frame=frame, mass=_number(mass, "mass", least=0.0), centre=_vector(centre, "centre"), inertia=matrix
        )


@dataclass(frozen=True)
class JointForces:
    """Forces in a joint, actuated or passive, other than its actuator's.

    With q and v its position and speed, the joint resists with

        damping · v + friction · tanh(v / friction_speed) + stiffness · (q − rest),

    and a rotor in the link that carries it, about the joint's axis, at the speed gear · v relative to that link, adds
    its inertia: rotor_inertia · gear² to the joint, and what its spin does to a link that turns (with the sign of
    ``gear``). The rotor's mass belongs to the link.

    Attributes:
        joint: name of a joint of one freedom, or of a ball, which has damping alone: against its angular velocity.
        damping: viscous friction, N·s/m or N·m·s.
        friction: Coulomb friction, N or N·m.
        friction_speed: speed, m/s or rad/s, at which Coulomb friction is at 76 % of it: with a jump at zero forces
            would not determine the motion.
        stiffness: of a spring, N/m or N·m/rad.
        rest: position at which the spring is relaxed, m or rad.
        rotor_inertia: of rotor and shaft about their axis, kg·m².
        gear: turns of the rotor per turn of the joint (rad/m of a prismatic one); negative if it turns the other way.

    Raises:
        InputError: a number out of its domain.

    Example:
        >>> robot = rp.load_robot("four_bar").loaded(rp.JointForces("crank", damping=0.2, friction=0.1))
        >>> robot.loads[0].damping
        0.2
    """

    joint: str
    damping: float = 0.0
    friction: float = 0.0
    friction_speed: float = 0.01
    stiffness: float = 0.0
    rest: float = 0.0
    rotor_inertia: float = 0.0
    gear: float = 1.0

    def __post_init__(self) -> None:
        for name in ("damping", "friction", "friction_speed", "stiffness", "rest", "rotor_inertia", "gear"):
            least = -np.inf if name in ("rest", "gear") else 1e-100 if name == "friction_speed" else 0.0
            assign(self, **{name: _number(getattr(self, name), f"{name} of {self.joint!r}", least=least)})

    def resistance(self, q: Array, v: Array) -> Array:
        """Return (N,) what friction and spring ask of the actuator at positions and speeds (N,), N or N·m."""
        slow = self.friction * np.tanh(v / self.friction_speed)
        result: Array = self.damping * v + slow + self.stiffness * (q - self.rest)
        return result

    def resistance_rate(self, v: Array) -> Array:
        """Return (N,) the derivative of ``resistance`` by speed, N·s/m or N·m·s."""
        slow = np.tanh(v / self.friction_speed)  # 1 / cosh² of it would overflow at 710 friction speeds
        result: Array = self.damping + self.friction / self.friction_speed * (1.0 - slow**2)
        return result


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Spring(_Listed, Frozen):
    """A spring and a damper between points of two links, along the line between them.

    Attributes:
        frame_a, frame_b: names of the links.
        stiffness: N/m.
        damping: N·s/m.
        length: of the relaxed spring, m.
        point_a, point_b: (3,) its ends in the frames, m.

    Raises:
        InputError: a number out of its domain.

    Example:
        >>> len(rp.load_robot("four_bar").loaded(rp.Spring("base", "coupler_link", 200.0, length=0.1)).loads)
        1
    """

    frame_a: str
    frame_b: str
    stiffness: float
    damping: float
    length: float
    point_a: Array
    point_b: Array

    def __init__(
        self,
        frame_a: str,
        frame_b: str,
        stiffness: float = 0.0,
        damping: float = 0.0,
        length: float = 0.0,
        point_a: ArrayLike = (0.0, 0.0, 0.0),
        point_b: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        numbers = {"stiffness": stiffness, "damping": damping, "length": length}
        assign(self, frame_a=frame_a, frame_b=frame_b)
        assign(self, **{name: _number(value, f"{name} of the spring", least=0.0) for name, value in numbers.items()})
        assign(self, point_a=_vector(point_a, "point_a"), point_b=_vector(point_b, "point_b"))


Load: TypeAlias = Wrench | Payload | JointForces | Spring


def of_kind(loads: Iterable[Load], kind: type[_T]) -> tuple[_T, ...]:
    """Return the loads of one kind."""
    return tuple(load for load in loads if isinstance(load, kind))


def checked_loads(model: pin.Model, loads: Sequence[Load]) -> tuple[Load, ...]:
    """Return loads whose links and joints the model has.

    Raises:
        InputError: no load, an unknown link or joint.
        UnsupportedRobotError: a joint of several freedoms, a spring in a continuous joint.
    """
    for load in loads:
        if not isinstance(load, get_args(Load)):
            raise InputError(f"A load is {type(load).__name__}.", remedy="Pass Wrench, Payload, JointForces or Spring.")
        if isinstance(load, JointForces):
            joint = find_joint(model, load.joint)
            others = load.friction or load.stiffness or load.rotor_inertia
            if str(joint.shortname()) == "JointModelSpherical" and not others:
                continue
            if joint.nv != 1 or (joint.nq != 1 and load.stiffness):
                what = f"{joint.nv} freedoms" if joint.nv != 1 else "no position that counts its turns"
                raise UnsupportedRobotError(
                    f"Joint {load.joint!r} has {what}.",
                    remedy="Forces in joints need one freedom, springs a revolute or prismatic joint (not continuous); "
                    "a ball can have damping.",
                    joint=load.joint,
                )
        else:
            for frame in (load.frame_a, load.frame_b) if isinstance(load, Spring) else (load.frame,):
                find_link(model, frame)
    return tuple(loads)


def carrying(model: pin.Model, payloads: Iterable[Payload]) -> pin.Model:
    """Return a model whose links have the payloads too."""
    heavier = model.copy()
    for load in payloads:
        frame = find_link(model, load.frame)
        body = pin.Inertia(load.mass, np.array(load.centre), np.array(load.inertia))
        heavier.appendBodyToJoint(int(frame.parentJoint), body, frame.placement)
    return cast(pin.Model, heavier)


def wrench_values(loads: Iterable[Load], t: Array, x: Array, xd: Array) -> tuple[Array, ...]:
    """Return (N, 6) the value of each wrench among some loads; arguments and errors as of ``Wrench.at``."""
    return tuple(load.at(t, x, xd) for load in of_kind(loads, Wrench))
