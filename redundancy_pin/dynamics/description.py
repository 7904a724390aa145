"""What a robot is, as plain data: bodies, joints and their roles, closures, limits, and the efforts that hold it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.io.json_data import json_data
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.coordinates import all_working_modes, gravity_acts, mode_name
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Load, Robot
from redundancy_pin.robot.checks import too_few_motors
from redundancy_pin.robot.joint_ranges import all_ranges
from redundancy_pin.robot.scales import is_revolute

_ONLY_WITH = {"friction_speed": "friction", "gear": "rotor_inertia", "rest": "stiffness"}
"""Parameters of loads that say nothing where another one is zero."""

_UNLIMITED = 1e300
"""Limits of positions from here on stand for none."""


def describe(robot: Robot) -> dict[str, Any]:
    """Return what there is to know about a robot as plain data, by name; SI units.

    Example:
        >>> describe(rp.load_robot("3rrr"))["counts"]["carriers k"]
        3
    """
    platform = robot.platform
    return {
        "name": robot.name,
        "counts": {
            "independent velocities n": robot.n,
            "main actuators m": robot.m,
            "carriers k": robot.k,
            "nq": robot.model.nq,
            "nv": robot.model.nv,
        },
        "independent": {
            "platform": platform.frame if platform else None,
            "axes": platform.axes if platform else None,
            "joints": robot.independent_joints,
        },
        "bodies": [vars(body) for body in robot.bodies],
        "moving_mass": robot.moving_mass,
        "moving_weight": robot.moving_mass * float(np.linalg.norm(robot.gravity)),
        "joints": [_joint(robot, index) for index in range(1, robot.model.njoints)],
        "closures": [
            {"frame_a": one.frame_a, "frame_b": one.frame_b, "axes": one.axes, "length": one.length or None}
            for one in robot.closures
        ],
        "couplings": [
            {"joint": each.joint, "of": each.of or None, "polynomial": each.polynomial, "also": each.also}
            for each in robot.couplings
        ],
        "carrier_limits": {
            name: {"position": [own.lower, own.upper], "speed": own.speed, "acceleration": own.acceleration,
                   "force": own.force}
            for name, own in zip(robot.carriers, robot.carrier_limits, strict=True)
        },
        "motor_limits": {
            name: {"effort": [float(least), float(most)], "speed": float(speed)}
            for name, least, most, speed in zip(robot.actuated, *robot.effort_limits, robot.speed_limits, strict=True)
        },
        **{name: getattr(robot, name) for name in ("gravity", "characteristic_length", "closed_form")},
        "notes": [*robot.notes, *filter(None, [too_few_motors(robot)])],
        "gravity_acts": gravity_acts(robot),
        "working_mode": mode_name(robot.working_mode),
        "working_modes": [mode_name(mode) for mode in all_working_modes(robot) if mode],
        "reference": _reference(robot),
        "loads": [_load(load) for load in robot.loads],
    }  # fmt: skip


def _load(load: Load) -> Mapping[str, Any]:
    """Return a load as plain data: its kind, where it acts, and what of it is not zero."""
    values = {field.name: json_data(getattr(load, field.name)) for field in fields(load)}
    hidden = {name for name, of in _ONLY_WITH.items() if not values.get(of)}
    own = {name: value for name, value in values.items() if np.asarray(value, dtype=object).any()}
    return {"kind": type(load).__name__, **{name: value for name, value in own.items() if name not in hidden}}


def _reference(robot: Robot) -> dict[str, Any]:
    """Return the reference coordinates, how far they are from singularities, and the efforts that hold the robot."""
    x = follower(robot).home.x[None]
    still = np.zeros((1, robot.n))
    motion = PlatformMotion([0.0], x, still, still)
    reduced = RneaDynamics(robot).reduce(motion)
    distribution = distribute(reduced)
    efforts = zip((*robot.actuated, *robot.carriers), (*distribution.tau[0], *reduced.carrier_force[0]), strict=True)
    return {
        "coordinates": x[0].tolist(),
        "type_i_margin": inverse_kinematics(robot, motion).serial_margin_bound[0],
        "type_ii_margin": distribution.margin[0],
        "condition": distribution.condition[0],
        "holding": {
            "status": distribution.status_labels[0],
            "efforts": [
                {"joint": name, "effort": effort, "unit": "N·m" if is_revolute(robot, name) else "N"}
                for name, effort in efforts
            ],
        },
    }


def _joint(robot: Robot, index: int) -> dict[str, Any]:
    """Return name, type, role, limits and reference position of a joint; m or rad."""
    joint, model = robot.model.joints[index], robot.model
    name, kind = str(model.names[index]), str(joint.shortname())
    # Pinocchio has a class for each axis: JointModelRX, JointModelPZ, JointModelRevoluteUnaligned, ...
    known = {"JointModelP": "prismatic", "JointModelR": "revolute"}
    limits = None
    if joint.nq == 1:  # continuous ones have none, and others several degrees of freedom
        ends = (float(limit[joint.idx_q]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
        limits = [end if np.isfinite(end) and abs(end) < _UNLIMITED else None for end in ends]
    return {
        "name": name,
        "type": known.get(kind[: len("JointModelP")], kind),
        "role": "actuated" if name in robot.actuated else "carrier" if name in robot.carriers else "passive",
        "limits": limits,
        "reference": float(robot.joint_positions(robot.q_reference, [name])[0]) if joint.nv == 1 else None,
        "outside": any(
            not own.holds(float(robot.q_reference[own.at])) for own in all_ranges(robot) if own.name == name
        ),
    }
