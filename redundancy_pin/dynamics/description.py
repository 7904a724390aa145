"""What a robot is: bodies, joints and their roles, closures, limits, and the efforts that hold it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.io.json_data import json_data
from redundancy_pin.io.summary import Summary, TextTable, row
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.coordinates import all_working_modes, gravity_acts, mode_name
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Load, Robot
from redundancy_pin.robot.checks import too_few_motors
from redundancy_pin.robot.joint_ranges import all_ranges
from redundancy_pin.robot.scales import effort_unit, is_revolute

_ONLY_WITH = {"friction_speed": "friction", "gear": "rotor_inertia", "rest": "stiffness"}
"""Parameters of loads that have no effect if another one is zero."""

_ROUNDING = 1e-12
"""Part of the largest of some numbers that is rounding."""

_UNLIMITED = 1e300
"""Limits of positions from here on stand for none."""


def describe(robot: Robot, description: str = "", defaults: Mapping[str, object] | None = None) -> Summary:
    """Return a description of a robot, SI units: a mapping, whose ``print`` shows tables.

    Args:
        robot: the robot.
        description: a sentence on it.
        defaults: of its parameters, by name: only its files have them; left out where there are none.

    Example:
        >>> describe(rp.load_robot("3rrr"))["counts"]["carriers k"]
        3
    """
    platform = robot.platform
    known = {name: {"default": value} for name, value in (defaults or {}).items()}
    facts: dict[str, Any] = {
        "name": robot.name,
        "description": description,
        "parameters": {name: {"value": value, **known.get(name, {})} for name, value in robot.parameters.items()},
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
    return Summary(facts, _general(facts), *_tables(facts))


def _load(load: Load) -> Mapping[str, Any]:
    """Return a load as plain data: its kind, its point of action, and its nonzero numbers."""
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
                {"joint": name, "effort": effort, "unit": effort_unit([is_revolute(robot, name)])}
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


# --- tables -----------------------------------------------------------------------------------------------------------


def _general(facts: Mapping[str, Any]) -> TextTable:
    independent, reference, modes = facts["independent"], facts["reference"], facts["working_modes"]
    axes, joints = independent["axes"] or (), independent["joints"] or ()
    turning = {joint["type"] == "revolute" for joint in facts["joints"] if joint["name"] in joints}
    turning = turning or {axis in ("rx", "ry", "rz") for axis in axes}
    unit = ", ".join([*(["m"] if False in turning else []), *(["rad"] if True in turning else [])])
    idle = any(facts["gravity"]) and not facts["gravity_acts"]
    gravity = f"{row(facts['gravity'])}{': normal to the plane of motion, no effect on efforts' if idle else ''}"
    rows = [
        *((name, str(count)) for name, count in facts["counts"].items()),
        ("independent", f"{', '.join(axes)} of {independent['platform']}" if axes else ", ".join(joints)),
        ("gravity [m/s²]", gravity),
        *([("working mode", f"{facts['working_mode']} of {', '.join(modes)}")] if modes else []),
        ("characteristic length [m]", f"{facts['characteristic_length']:.6g}"),
        ("closed form (virtual work)", facts["closed_form"] or "none"),
        (f"reference [{unit}]", _coordinates(reference["coordinates"])),
        ("type I margin there (lower bound)", f"{reference['type_i_margin']:.4g}"),
        ("type II margin there", f"{reference['type_ii_margin']:.4g}"),
        ("condition number there", f"{reference['condition']:.4g}"),
    ]
    return TextTable(": ".join(filter(None, (facts["name"], facts["description"]))), rows)


def _tables(facts: Mapping[str, Any]) -> Iterator[TextTable]:
    """Give the tables of bodies, joints and motors, and the tables that only some robots have."""
    platform, holding = facts["independent"]["platform"], facts["reference"]["holding"]
    bodies = [
        (
            f"{body['name']} with {platform}" if platform in body["links"][1:] else body["name"],
            f"{body['mass']:.6g}",
            ", ".join(_texts(body["centre"])),
            ", ".join(_texts(body["principal_moments"])),
        )
        for body in facts["bodies"]
    ]
    total = f"{facts['moving_mass']:.6g} kg, {facts['moving_weight']:.6g} N"
    yield TextTable(
        f"moving bodies, with all links fixed to them: {total}",
        [*bodies],
        ("body", "mass [kg]", "centre in its frame [m]", "principal moments [kg·m²]"),
        left=1,
    )
    texts = _texts([each["effort"] for each in holding["efforts"]])
    efforts = [(each["joint"], f"{text} {each['unit']}") for each, text in zip(holding["efforts"], texts, strict=True)]
    rows: list[Sequence[str]] = [*efforts, ("status", holding["status"])]
    yield TextTable("efforts that hold the reference", rows, ("joint", "effort at rest"), left=1)
    rows = [(joint["name"], joint["type"], joint["role"], *_range(joint)) for joint in facts["joints"]]
    yield TextTable("joints of the tree", rows, ("joint", "type", "role", "limits", "reference"))
    rows = [
        (one["frame_a"], one["frame_b"], f"distance {one['length']:.6g} m" if one["length"] else ", ".join(one["axes"]))
        for one in facts["closures"]
    ]
    yield TextTable("closures", rows, ("frame a", "frame b", "axes"))
    rows = [
        (
            one["joint"],
            one["of"] or "held",
            row(one["polynomial"], " "),
            " ".join(f"{c:+g} {n}" for n, c in one["also"]),
        )
        for one in facts["couplings"]
    ]
    headings: tuple[str, ...] = ("joint q", "of p", "polynomial", "further terms")
    yield from [TextTable("couplings, q = c0 + c1 p + ...", rows, headings)] if rows else []
    parameters: Mapping[str, Mapping[str, object]] = facts["parameters"]
    columns = ["value", *(["default"] if any("default" in entry for entry in parameters.values()) else [])]
    rows = [(name, *(_text(entry.get(key, "")) for key in columns)) for name, entry in parameters.items()]
    headings = ("parameter", *columns)
    yield from [TextTable("parameters (--set NAME=VALUE)", rows, headings, left=1)] if rows else []
    rows = [
        (name, row(own["position"], " … "), *(f"{own[key]:g}" for key in ("speed", "acceleration", "force")))
        for name, own in facts["carrier_limits"].items()
    ]
    headings = ("carrier", "position [m]", "speed [m/s]", "acceleration [m/s²]", "force [N]")
    yield from [TextTable("carrier limits", rows, headings, left=1)] if rows else []
    rows = [(name, row(own["effort"], " … "), f"{own['speed']:g}") for name, own in facts["motor_limits"].items()]
    headings = ("motor", "effort [N] or [N·m]", "speed [m/s] or [rad/s]")
    yield TextTable("limits of motors, which plans keep", rows, headings, left=1)
    rows = [_load_row(load) for load in facts["loads"]]
    yield from [TextTable("active loads (SI units)", rows, ("kind", "where", "what"))] if rows else []


def _load_row(load: Mapping[str, Any]) -> tuple[str, str, str]:
    places = ("joint", "frame", "frame_a", "frame_b")
    values = {name.replace("_", " "): value for name, value in load.items() if name not in ("kind", *places)}
    what = (f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in values.items())
    return load["kind"], ", ".join(str(load[name]) for name in places if name in load), ", ".join(what)


def _range(joint: Mapping[str, Any]) -> tuple[str, str]:
    """Return the limits of a joint and its reference position, marked if outside the limits."""
    if joint["reference"] is None:
        return "", ""
    shown = f"{round(joint['reference'], 9) + 0.0:.4g}{' (outside)' if joint['outside'] else ''}"
    ends = joint["limits"] or (None, None)
    if ends[0] is None and ends[1] is None:
        return "", shown
    unit = "m" if joint["type"] == "prismatic" else "rad"
    return f"{' … '.join('none' if end is None else f'{end:g}' for end in ends)} {unit}", shown


def _coordinates(values: Sequence[Any]) -> str:
    """Return coordinates side by side; of a pose position and roll, pitch, yaw, as a declaration has them."""
    at = np.asarray(values, dtype=float)
    if at.ndim == 1:
        return row(np.round(at, 9) + 0.0)
    from scipy.spatial.transform import Rotation

    rpy = Rotation.from_matrix(at[:3, :3]).as_euler("xyz")
    return f"xyz {row(np.round(at[:3, 3], 9) + 0.0)}; rpy {row(np.round(rpy, 9) + 0.0)}"


def _texts(values: Any) -> list[str]:
    """Return numbers with six digits, in any unit; numbers at the rounding error of the largest are zero."""
    size = float(np.abs(values).max(initial=0.0))
    return [f"{0.0 if abs(value) < _ROUNDING * size else value:.6g}" for value in values]


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)
