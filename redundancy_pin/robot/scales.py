"""Sizes that tolerances are relative to: of a robot, and of the forces of its samples.

No tolerance in kinematics, singularities, dynamics and generated C has a unit. A length is compared with the robot's
characteristic length, an angle with one radian, a force with ``ForceTerms.force``: the same machine, written in other
units, gets the same statuses.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, read_only
from redundancy_pin.robot.loads import JointForces, Spring
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.types import Robot, slides

_Size = TypeVar("_Size", float, Array)


@dataclass(frozen=True)
class ForceTerms:
    """Sizes that the forces of a robot are compared with; generated code takes these numbers at run time.

    Attributes:
        length: characteristic length, m.
        mass: sum of the moving masses, and of moments of inertia over length², kg.
        gravity: size of gravity, m/s².
        viscous: sum of the dampings, N·s.
        static: sum of friction, and of a thousandth of springs moved by the characteristic length or 1 rad, N.
    """

    length: float
    mass: float
    gravity: float
    viscous: float
    static: float

    def force(self, rate: _Size, acceleration: _Size) -> _Size:
        """Return the size that the terms of f have before they cancel, N, of one sample or (N,).

        force = mass (gravity + length (rate² + acceleration)) + viscous rate + static

        Args:
            rate: max |ẋ|/unit, carriers included, 1/s.
            acceleration: max |ẍ|/unit, 1/s².
        """
        inertial = self.mass * (self.gravity + self.length * (rate**2 + acceleration))
        return inertial + self.viscous * rate + self.static

    def time(self, rate: float) -> float:
        """Return the length over the speed that gravity and a rate give a mass, s; infinite at rest without gravity."""
        inverse_square = self.gravity / self.length + rate**2
        return 1.0 / math.sqrt(inverse_square) if inverse_square else math.inf


_OF_SPRINGS = 1e-3
"""Share of the force of a spring, moved by the characteristic length or 1 rad, that counts: stiff stops would otherwise
hide all other forces."""


@lru_cache(maxsize=64)
def force_terms(robot: Robot) -> ForceTerms:
    """Return what the forces of a robot are compared with."""
    model, length = robot.model, robot.characteristic_length
    mass = 0.0
    for body in itertools.islice(model.inertias, 1, None):
        mass += float(body.mass) + float(body.inertia.trace()) / length**2
    if model.armature.any():
        mass += float((model.armature / np.where(turning_velocities(robot), length**2, 1.0)).sum())
    viscous = static = 0.0
    for load in robot.loads:
        if isinstance(load, JointForces):
            # a force of a slide, or the torque of a turning joint over the length; per m, or per rad
            sliding = slides(find_joint(model, load.joint))
            arm, step = (1.0, length) if sliding else (length, 1.0)
            mass += load.rotor_inertia * load.gear**2 * step / (arm * length)
            viscous += load.damping * step / arm
            static += (load.friction + _OF_SPRINGS * load.stiffness * (step + abs(load.rest))) / arm
        elif isinstance(load, Spring):
            viscous += load.damping * length
            static += _OF_SPRINGS * load.stiffness * (length + load.length)
    return ForceTerms(length, mass, float(np.linalg.norm(robot.gravity)), viscous, static)


def wrench_size(robot: Robot, wrenches: tuple[Array, ...]) -> Array | float:
    """Return (N,) the size of wrenches (N, 6), N: forces, and moments over the characteristic length."""
    unit = np.repeat([1.0, robot.characteristic_length], 3)
    return sum((np.abs(wrench / unit).max(axis=1) for wrench in wrenches), 0.0)


def force_sizes(robot: Robot, xd: Array, xdd: Array, sd: Array, sdd: Array, wrenches: tuple[Array, ...] = ()) -> Array:
    """Return (N,) the sizes of the forces of samples before they cancel, N: ``ForceTerms.force`` and wrenches.

    Args:
        robot: the robot.
        xd: (N, n) rates of the independent coordinates, m/s and rad/s.
        xdd: (N, n) their accelerations.
        sd: (N, k) rates of the carriers.
        sdd: (N, k) their accelerations.
        wrenches: (N, 6) each, loads that act at the samples, N and N·m.
    """
    units = coordinate_unit(robot), velocity_unit(robot)[robot.carrier_velocity]
    rate, acceleration = np.zeros((2, len(xd)))
    for size, parts in ((rate, (xd, sd)), (acceleration, (xdd, sdd))):
        for part, unit in zip(parts, units, strict=True):
            for column, one in zip(part.T, unit.tolist(), strict=True):
                np.maximum(size, np.abs(column) / one, out=size)
    return read_only(force_terms(robot).force(rate, acceleration) + wrench_size(robot, wrenches))


def closure_tolerance(robot: Robot) -> float:
    """Return the largest closure residual, m, of a configuration that counts as closed; of angles times the length."""
    return CLOSURE_TOLERANCE * robot.characteristic_length


# --- lengths and angles made comparable -----------------------------------------------------------------------------


def is_revolute(robot: Robot, name: str) -> bool:
    """Return whether a joint of one freedom turns."""
    return not slides(find_joint(robot.model, name))


def effort_unit(turning: Iterable[bool]) -> str:
    """Return the unit of efforts of joints that turn or slide: N·m, N, or both where there are both."""
    turns = set(turning)
    return "N or N·m" if len(turns) == 2 else "N·m" if turns == {True} else "N"


def turning_coordinates(robot: Robot) -> list[bool]:
    """Return which of the n independent coordinates are rotations."""
    if robot.platform is not None:
        return [axis.startswith("r") for axis in robot.platform.axes]
    return [is_revolute(robot, name) for name in robot.independent_joints]


@lru_cache(maxsize=64)
def turning_velocities(robot: Robot) -> BoolArray:
    """Return (nv,) which tree velocities are rotations."""
    data = robot.model.createData()
    pin.computeJointJacobians(robot.model, data, pin.neutral(robot.model))
    angular = np.reshape(data.J, (6, -1))[3:]  # Pinocchio drops the axis of one column
    return read_only(np.abs(angular).max(axis=0) > 0.0)


@lru_cache(maxsize=64)
def row_scale(robot: Robot) -> Array:
    """Return (n,) the characteristic length for rotations and 1 for translations among the independent coordinates."""
    return read_only(np.where(turning_coordinates(robot), robot.characteristic_length, 1.0))


@lru_cache(maxsize=64)
def column_scale(robot: Robot) -> Array:
    """Return (m,) the characteristic length for revolute main actuators and 1 for prismatic ones."""
    turning = [is_revolute(robot, name) for name in robot.actuated]
    return read_only(np.where(turning, robot.characteristic_length, 1.0))


@lru_cache(maxsize=64)
def velocity_scale(robot: Robot) -> Array:
    """Return (nv,) the length that turns each tree velocity into m/s: the characteristic length for rotations."""
    return read_only(np.where(turning_velocities(robot), robot.characteristic_length, 1.0))


@lru_cache(maxsize=64)
def coordinate_unit(robot: Robot) -> Array:
    """Return (n,) the characteristic length, m, for translations and 1 rad for rotations among the coordinates."""
    return read_only(robot.characteristic_length / row_scale(robot))


@lru_cache(maxsize=64)
def position_unit(robot: Robot) -> Array:
    """Return (nq,) the characteristic length, m, for translations and 1 for all other numbers of a configuration.

    Joints that translate and turn have their translations first, in q as in v.
    """
    unit, turning = np.ones(robot.model.nq), turning_velocities(robot)
    for joint in robot.model.joints[1:]:
        translations = int((~turning[joint.idx_v : joint.idx_v + joint.nv]).sum())
        unit[joint.idx_q : joint.idx_q + translations] = robot.characteristic_length
    return read_only(unit)


@lru_cache(maxsize=64)
def velocity_unit(robot: Robot) -> Array:
    """Return (nv,) the characteristic length, m, for slides and 1 rad for turns among the tree velocities."""
    return read_only(robot.characteristic_length / velocity_scale(robot))
