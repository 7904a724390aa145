"""Dynamic parameters of a robot: their names, units and values, and the robot with other values.

A body has ten: its mass m, the first moments m c, and the inertia about the origin of its joint, all in the frame of
the joint. A joint of one freedom has a few that act in it alone (``JointForces``). The generalised forces of the tree
are linear in all of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, UnsupportedRobotError, one_of
from redundancy_pin.robot import JointForces, Robot
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.scales import force_terms
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

_LENGTHS = (0, 1, 1, 1, 2, 2, 2, 2, 2, 2)
"""Powers of a length in their units, kg mᵖ."""

IN_JOINT = ("damping", "friction", "stiffness", "preload", "rotor inertia")
"""Those of a joint; the preload of a spring is its effort at position zero, −stiffness · rest."""

TILTS = ("tilt x", "tilt y", "tilt z")
"""Rotation vector, world frame, from the declared gravity to that of a machine whose base is not level."""

NOT_NEGATIVE = ("mass", "damping", "friction", "stiffness", "rotor inertia")

_STANDARD_GRAVITY = 9.80665
"""m/s²: the time of a robot without gravity is that of its length at this acceleration."""

_LEAST_MASS = 1e-9
"""Mass of a body with moments and no mass, relative to the robot's: ``pin.Inertia`` divides by it."""


@dataclass(frozen=True)
class Parameter:
    """A dynamic parameter.

    Attributes:
        kind: one of ``INERTIAL``, ``IN_JOINT`` or ``TILTS``, ``factor`` or ``offset`` of a reading.
        of: name of the body, or of the joint; ``"gravity"``.
        joint: index of the joint in the Pinocchio model; 0 of gravity.
        unit: its unit.
        value: its value in the robot.
        size: the scale that its value and interval are compared with, from the mass M of the robot, its
            characteristic length L and T = √(L/g): M Lᵖ of a body; of a turning joint M L²/T (damping), M L²/T²
            (friction, spring), M L²/gear² (rotor); of a sliding one the same less a factor L² (friction: L).
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
        InputError: no pattern, one that matches no parameter, a preload in a joint without stiffness.
        UnsupportedRobotError: a joint with more than one ``JointForces``.

    Example:
        >>> from redundancy_pin.identification import parameters_of
        >>> [p.name for p in parameters_of(rp.load_robot("five_bar"), ["mass of p*"])]
        ['mass of proximal_1', 'mass of proximal_2']
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
    chosen = _matching(robot, everything, patterns)
    if not chosen:
        raise InputError("parameters is empty.", remedy='Name some, such as "mass of *", or leave it out.')
    stiff = {p.of for p in everything if p.kind == "stiffness" and (p.value or p in chosen)}
    for p in chosen:
        if p.kind == "preload" and p.of not in stiff:
            raise InputError(
                f"The {p.name} belongs to a spring without stiffness.",
                remedy=f'Add "stiffness of {p.of}" to the parameters, or declare it.',
                joint=p.of,
            )
    return chosen


def sensors_of(robot: Robot, patterns: Sequence[str], drives: Sequence[str]) -> tuple[Parameter, ...]:
    """Return the parameters of the measurement that match any of some patterns.

    Of each drive with reading u: its ``"factor of ..."`` and ``"offset of ..."``, N or N·m; its joint has the effort
    factor · u − offset. Of a current times a nominal torque constant the factor is the true constant over that one.
    Of the base: ``"tilt x of gravity"``, y and z, see ``TILTS``.

    Raises:
        InputError: a pattern that matches none.
    """
    frictions = [p for p in _of_joints(robot) if p.of in drives and p.kind == "friction"]
    factors = [replace(p, kind="factor", unit="1", value=1.0, size=1.0) for p in frictions]
    offsets = [replace(p, kind="offset", value=0.0) for p in frictions]
    tilts = [Parameter(kind, "gravity", 0, "rad", 0.0, 1.0) for kind in TILTS]
    return _matching(robot, [*factors, *offsets, *tilts], patterns)


def _matching(robot: Robot, everything: Sequence[Parameter], patterns: Sequence[str]) -> tuple[Parameter, ...]:
    listed = [patterns] if isinstance(patterns, str) else list(patterns)
    for pattern in listed:
        if not any(fnmatchcase(p.name, pattern) for p in everything):
            raise InputError(
                f"No parameter of {robot.name} is named {pattern!r}.",
                remedy=one_of(pattern, [p.name for p in everything]),
                pattern=pattern,
            )
    return tuple(p for p in everything if any(fnmatchcase(p.name, pattern) for pattern in listed))


def _of_bodies(robot: Robot) -> list[Parameter]:
    length, mass = robot.characteristic_length, _mass(robot)
    units = ("kg", "kg·m", "kg·m²")
    return [
        Parameter(kind, body.name, index, units[power], float(value), mass * length**power)
        for index, body in enumerate(robot.bodies, start=1)
        for kind, power, value in zip(
            INERTIAL, _LENGTHS, robot.model.inertias[index].toDynamicParameters(), strict=True
        )
    ]


def _of_joints(robot: Robot) -> list[Parameter]:
    listed, length, mass = [], robot.characteristic_length, _mass(robot)
    time = math.sqrt(length / (float(np.linalg.norm(robot.gravity)) or _STANDARD_GRAVITY))
    for index in range(1, robot.model.njoints):
        joint = robot.model.joints[index]
        if joint.nv != 1:
            continue
        name, turns = str(robot.model.names[index]), not slides(joint)
        load, effort = joint_forces(robot, name), "N·m" if turns else "N"
        units = (f"{effort}·s" if turns else "N·s/m", effort, "N·m/rad" if turns else "N/m", effort, "kg·m²")
        values = (load.damping, load.friction, load.stiffness, -load.stiffness * load.rest, load.rotor_inertia)
        # of the effort per acceleration, and of the position
        inertia, step = (mass * length**2, 1.0) if turns else (mass, length)
        force = inertia * step / time**2
        sizes = (inertia / time, force, inertia / time**2, force, inertia / (load.gear**2 or 1.0))
        listed += [
            Parameter(kind, name, index, unit, value, size)
            for kind, unit, value, size in zip(IN_JOINT, units, values, sizes, strict=True)
            if joint.nq == 1 or kind not in ("stiffness", "preload")
        ]
    return listed


def _mass(robot: Robot) -> float:
    """Return the mass of a robot; 1 kg of one without any inertia."""
    return force_terms(robot).mass or 1.0


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


def with_inertias(robot: Robot, parameters: Sequence[Parameter], values: Array) -> pin.Model:
    """Return the model of a robot whose bodies have other values (p,); they need not belong to real bodies."""
    model = robot.model.copy()
    tens = {p.joint: model.inertias[p.joint].toDynamicParameters() for p in parameters if p.kind in INERTIAL}
    for parameter, value in zip(parameters, values.tolist(), strict=True):
        if parameter.kind in INERTIAL:
            tens[parameter.joint][INERTIAL.index(parameter.kind)] = value
    for index, ten in tens.items():
        if ten.any():
            ten[0] = ten[0] or _LEAST_MASS * _mass(robot)
        model.inertias[index] = pin.Inertia.FromDynamicParameters(ten) if ten.any() else pin.Inertia.Zero()
    return model


def tilted(robot: Robot, tilt: Array) -> Robot:
    """Return a robot whose gravity is turned by a rotation vector (3,), rad, in the world frame."""
    if not tilt.any():
        return robot
    model = robot.model.copy()
    model.gravity.linear = pin.exp3(tilt) @ robot.gravity
    return replace(robot, model=model, closed_form=None)


def with_values(robot: Robot, parameters: Sequence[Parameter], values: Array) -> Robot:
    """Return a robot whose parameters have other values (p,); the others stay.

    Raises:
        InputError: a negative damping, friction, stiffness or rotor inertia; a preload without stiffness.
    """
    loads, of_joints, tilt = list(robot.loads), dict[str, dict[str, Any]](), np.zeros(3)
    for parameter, value in zip(parameters, values.tolist(), strict=True):
        if parameter.kind in IN_JOINT:
            of_joints.setdefault(parameter.of, {})[parameter.kind.replace(" ", "_")] = value
        elif parameter.kind in TILTS:
            tilt[TILTS.index(parameter.kind)] = value
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
        loads = [other for other in loads if other is not load]
        loads.append(replace(load, **changes, rest=-preload / stiffness if stiffness else 0.0))
    model = with_inertias(robot, parameters, values)
    return tilted(replace(robot, model=model, loads=tuple(loads), closed_form=None), tilt)


def unit_load(robot: Robot, parameter: Parameter, value: float = 1.0) -> JointForces:
    """Return the forces of a joint with a value of one parameter, not a preload, and zeros of the others."""
    load = joint_forces(robot, parameter.of)
    bare = JointForces(parameter.of, friction_speed=load.friction_speed, gear=load.gear)
    changes: dict[str, Any] = {parameter.kind.replace(" ", "_"): value}
    return replace(bare, **changes)
