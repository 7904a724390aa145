"""Dynamic parameters of a robot: their names, units and values, and the robot with other values.

A body has ten: its mass m, the first moments m c, and the inertia about the origin of its joint, all in the frame of
the joint. A joint of one freedom has a few that act in it alone (``JointForces``). The generalised forces of the tree
are linear in all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.errors import InputError, UnsupportedRobotError, one_of
from redundancy_pin.robot import JointForces, Robot
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint_index
from redundancy_pin.robot.types import slides

INERTIAL = (
    "mass",
    "moment x",
    "moment y",
    "moment z",
    "inertia xx",
    "inertia xy",
    "inertia yy",
    "inertia xz",
    "inertia yz",
    "inertia zz",
)
"""The ten of a body, in the order of ``pin.Inertia.toDynamicParameters``."""

_INERTIAL_POWERS = (0, 1, 1, 1, 2, 2, 2, 2, 2, 2)
IN_JOINT = ("damping", "friction", "stiffness", "preload", "rotor inertia")
"""Those of a joint; the preload of a spring is its effort at position zero, −stiffness · rest."""


@dataclass(frozen=True)
class Parameter:
    """A dynamic parameter.

    Attributes:
        kind: one of ``INERTIAL`` or ``IN_JOINT``.
        of: name of the body, or of the joint.
        joint: index of the joint in the Pinocchio model.
        unit: its unit.
        value: its value in the robot.
        size: what it is compared with: M Lᵖ of an inertial one, M the moving mass and L the characteristic length; 1
            of the others.
    """

    kind: str
    of: str
    joint: int
    unit: str
    value: float
    size: float

    @property
    def name(self) -> str:
        """Its name, such as ``"mass of upper_1"``."""
        return f"{self.kind} of {self.of}"


def parameters_of(robot: Robot, patterns: Sequence[str] | None = None) -> tuple[Parameter, ...]:
    """Return the parameters of a robot that match any of some patterns.

    Args:
        robot: the robot.
        patterns: names, or patterns as of ``fnmatch``, such as ``"mass of *"``. When left out: the ten of each body
            that has a mass, damping and friction of motors and carriers, and what else the robot declares of its joints
            (``JointForces``).

    Raises:
        InputError: a pattern that matches no parameter.
        UnsupportedRobotError: a joint with more than one ``JointForces``.

    Example:
        >>> [p.name for p in parameters_of(load_robot("five_bar"), ["mass of *"])]
    """
    everything = [*_of_bodies(robot), *_of_joints(robot)]
    if patterns is None:
        driven = {*robot.actuated, *robot.carriers}
        heavy = {body.joint for body in robot.bodies if body.mass > 0.0}
        return tuple(
            p
            for p in everything
            if (p.kind in INERTIAL and str(robot.model.names[p.joint]) in heavy)
            or (p.kind in IN_JOINT and (p.value != 0.0 or (p.of in driven and p.kind in ("damping", "friction"))))
        )
    for pattern in patterns:
        if not any(fnmatchcase(p.name, pattern) for p in everything):
            raise InputError(
                f"No parameter of {robot.name} is named {pattern!r}.",
                remedy=one_of(pattern, [p.name for p in everything]),
                pattern=pattern,
            )
    return tuple(p for p in everything if any(fnmatchcase(p.name, pattern) for pattern in patterns))


def _of_bodies(robot: Robot) -> list[Parameter]:
    length, mass = robot.characteristic_length, robot.moving_mass or 1.0
    units = ("kg", "kg·m", "kg·m²")
    return [
        Parameter(kind, body.name, index, units[power], float(value), mass * length**power)
        for index, body in enumerate(robot.bodies, start=1)
        for kind, power, value in zip(
            INERTIAL, _INERTIAL_POWERS, robot.model.inertias[index].toDynamicParameters(), strict=True
        )
    ]


def _of_joints(robot: Robot) -> list[Parameter]:
    listed = []
    for index in range(1, robot.model.njoints):
        if robot.model.joints[index].nv != 1:
            continue
        name = str(robot.model.names[index])
        load, turns = joint_forces(robot, name), not slides(robot.model.joints[index])
        effort = "N·m" if turns else "N"
        units = (f"{effort}·s" if turns else "N·s/m", effort, "N·m/rad" if turns else "N/m", effort, "kg·m²")
        values = (load.damping, load.friction, load.stiffness, -load.stiffness * load.rest, load.rotor_inertia)
        springs = robot.model.joints[index].nq == 1
        listed += [
            Parameter(kind, name, index, unit, value, 1.0)
            for kind, unit, value in zip(IN_JOINT, units, values, strict=True)
            if springs or kind not in ("stiffness", "preload")
        ]
    return listed


def joint_forces(robot: Robot, joint: str) -> JointForces:
    """Return what a joint is declared to resist with; zeros where nothing is.

    Raises:
        UnsupportedRobotError: more than one ``JointForces`` of the joint.
    """
    declared = [load for load in of_kind(robot.loads, JointForces) if load.joint == joint]
    if len(declared) > 1:
        raise UnsupportedRobotError(
            f"Joint {joint!r} of {robot.name} has {len(declared)} JointForces: which of them is to change is unknown.",
            remedy="Declare one with the sum of their numbers.",
            joint=joint,
        )
    return declared[0] if declared else JointForces(joint)


def with_values(robot: Robot, parameters: Sequence[Parameter], values: Array) -> Robot:
    """Return a robot whose parameters have other values (p,); the others stay.

    Raises:
        InputError: a negative damping, friction, stiffness or rotor inertia; a preload without stiffness.
    """
    model, rest, of_joints = robot.model.copy(), list(robot.loads), dict[str, dict[str, float]]()
    inertias = {p.joint: model.inertias[p.joint].toDynamicParameters() for p in parameters if p.kind in INERTIAL}
    for parameter, value in zip(parameters, values.tolist(), strict=True):
        if parameter.kind in INERTIAL:
            inertias[parameter.joint][INERTIAL.index(parameter.kind)] = value
        else:
            of_joints.setdefault(parameter.of, {})[parameter.kind] = value
    for index, ten in inertias.items():
        # FromDynamicParameters divides by the mass: massless bodies with moments have no centre
        model.inertias[index] = pin.Inertia.FromDynamicParameters(ten) if ten[0] else pin.Inertia.Zero()
    for name, changes in of_joints.items():
        load = joint_forces(robot, name)
        stiffness = changes.get("stiffness", load.stiffness)
        preload = changes.pop("preload", -load.stiffness * load.rest)
        if preload and not stiffness:
            raise InputError(
                f"The spring in {name!r} has a preload of {preload:g} and no stiffness.",
                remedy="Identify its stiffness too, or declare it.",
                joint=name,
            )
        rest = [other for other in rest if other is not load]
        rest.append(replace(_changed(load, changes), rest=-preload / stiffness if stiffness else 0.0))
    return replace(robot, model=model, loads=tuple(rest), closed_form=None)


def unit_forces(robot: Robot, parameter: Parameter) -> JointForces:
    """Return the forces of a joint whose parameter is 1, and all its others 0; of damping, friction and rotors."""
    load = joint_forces(robot, parameter.of)
    bare = JointForces(parameter.of, friction_speed=load.friction_speed, gear=load.gear)
    return _changed(bare, {parameter.kind: 1.0})


def _changed(load: JointForces, values: Mapping[str, float]) -> JointForces:
    """Return forces of a joint with other values of some kinds, preload excepted."""
    changes: dict[str, Any] = {kind.replace(" ", "_"): value for kind, value in values.items()}
    return replace(load, **changes)


def massless(robot: Robot) -> Robot:
    """Return the robot without masses, armature and loads: only what is added to it takes effort."""
    model = robot.model.copy()
    for index in range(1, model.njoints):
        model.inertias[index] = pin.Inertia.Zero()
    model.armature = np.zeros(model.nv)
    return replace(robot, model=model, loads=(), closed_form=None)


def standard_values(parameters: Sequence[Parameter]) -> Array:
    """Return (p,) their values in the robot."""
    return read_only(np.array([p.value for p in parameters]))


def index_of(robot: Robot, joint: str) -> int:
    """Return the velocity index of a joint of one freedom."""
    return int(robot.model.joints[find_joint_index(robot.model, joint)].idx_v)
