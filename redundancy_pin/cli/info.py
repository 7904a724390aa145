"""``redundancy-pin info``: what a robot is, or which robots there are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

import click
import numpy as np

from redundancy_pin.cli.options import RobotOptions, json_option, robot_options, untrusted_option
from redundancy_pin.cli.output import TextTable, report, row
from redundancy_pin.errors import InputError, ModelFileError
from redundancy_pin.io.json_data import json_data
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.robot import Load, Robot
from redundancy_pin.robot.shipped import declaration_path, shipped_robots

_LIMITS = ("speed", "acceleration", "force")


@click.command()
@robot_options(required=False)
@untrusted_option
@json_option
def info(robot: RobotOptions, untrusted: bool, as_json: bool) -> None:
    r"""Show a robot, or which there are.

    Masses of the moving bodies, joints and their roles, closures, freedoms, parameters, limits, the efforts that hold
    the reference configuration, and how far that is from singularities. Without --robot: the shipped robots.

    \b
    Example:
      redundancy-pin info --robot 3rrr --set carrier_mass=2.0
    """
    if not robot.source:
        if not robot.is_robot_only:
            raise InputError("--set, --mode and --gravity need a robot.", remedy="Add --robot.")
        _list_robots(as_json)
        return
    robot = replace(robot, untrusted=untrusted)
    facts = describe(robot.load(), declaration_path(robot.source), trust=robot.trust, untrusted=untrusted)
    report(as_json, facts, _general(facts), *_tables(facts), *facts["notes"])


def describe(robot: Robot, declaration: Any, *, trust: bool = False, untrusted: bool = False) -> dict[str, Any]:
    """Return what there is to know about a robot as plain data."""
    from redundancy_pin.kinematics.coordinates import all_working_modes, gravity_acts, mode_name
    from redundancy_pin.robot.checks import too_few_motors
    from redundancy_pin.robot.declaration import read_declaration
    from redundancy_pin.robot.model_files import is_model_file, open_model

    # once more from the files: a robot knows its parameters' values, but not which of them are defaults
    data = {} if is_model_file(declaration) else read_declaration(declaration).data
    file = declaration.parent / data["urdf"] if data else declaration
    defaults, _ = open_model(file, {}, trust=trust, untrusted=untrusted)
    platform, limits = robot.platform, zip(robot.carriers, robot.carrier_limits, strict=True)
    counts = {"independent velocities n": robot.n, "main actuators m": robot.m, "carriers k": robot.k}
    return {
        "name": robot.name,
        "description": str(data.get("description", "")),
        "counts": {**counts, "nq": robot.model.nq, "nv": robot.model.nv},
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
        "parameters": {
            name: {"value": value, "default": defaults.get(name)} for name, value in robot.parameters.items()
        },
        "carrier_limits": {
            name: {"position": [own.lower, own.upper], **{key: getattr(own, key) for key in _LIMITS}}
            for name, own in limits
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
    }


def _load(load: Load) -> dict[str, Any]:
    """Return a load as plain data: its kind, where it acts, and what of it is not zero."""
    values = {field.name: json_data(getattr(load, field.name)) for field in fields(load)}
    only_with = {"friction_speed": "friction", "gear": "rotor_inertia", "rest": "stiffness"}
    hidden = {name for name, of in only_with.items() if not values.get(of)}
    own = {name: value for name, value in values.items() if np.asarray(value, dtype=object).any()}
    return {"kind": type(load).__name__, **{name: value for name, value in own.items() if name not in hidden}}


def _reference(robot: Robot) -> dict[str, Any]:
    """Return the reference coordinates, how far they are from singularities, and the efforts that hold the robot."""
    from redundancy_pin.dynamics.distribution import distribute
    from redundancy_pin.dynamics.rnea import RneaDynamics
    from redundancy_pin.kinematics.branch import follower
    from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
    from redundancy_pin.motion import PlatformMotion
    from redundancy_pin.robot.scales import is_revolute

    x = follower(robot).home.x[None]
    still = np.zeros((1, robot.n))
    motion = PlatformMotion([0.0], x, still, still)
    reduced = RneaDynamics(robot).reduce(motion)
    distribution = distribute(reduced)
    serial, parallel = inverse_kinematics(robot, motion).serial_margin_bound[0], distribution.margin[0]
    margins = {"type_i_margin": serial, "type_ii_margin": parallel, "condition": distribution.condition[0]}
    efforts = zip((*robot.actuated, *robot.carriers), (*distribution.tau[0], *reduced.carrier_force[0]), strict=True)
    holding = {
        "status": distribution.status_labels[0],
        "efforts": [
            {"joint": name, "effort": effort, "unit": "N·m" if is_revolute(robot, name) else "N"}
            for name, effort in efforts
        ],
    }
    return {"coordinates": x[0].tolist(), **margins, "holding": holding}


def _joint(robot: Robot, index: int) -> dict[str, Any]:
    from redundancy_pin.robot.joint_ranges import all_ranges

    name, kind = str(robot.model.names[index]), str(robot.model.joints[index].shortname())
    # Pinocchio has a class for each axis: JointModelRX, JointModelPZ, JointModelRevoluteUnaligned, ...
    known = {"JointModelP": "prismatic", "JointModelR": "revolute"}
    role = "actuated" if name in robot.actuated else "carrier" if name in robot.carriers else "passive"
    joint, model, limits = robot.model.joints[index], robot.model, None
    if joint.nq == 1:  # continuous ones have none, and others several freedoms
        ends = (float(limit[joint.idx_q]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
        limits = [end if np.isfinite(end) and abs(end) < 1e300 else None for end in ends]
    at = float(robot.joint_positions(robot.q_reference, [name])[0]) if joint.nv == 1 else None
    kind = known.get(kind[: len("JointModelP")], kind)
    outside = any(not own.holds(float(robot.q_reference[own.at])) for own in all_ranges(robot) if own.name == name)
    return {"name": name, "type": kind, "role": role, "limits": limits, "reference": at, "outside": outside}


def _list_robots(as_json: bool) -> None:
    robots = [
        (name, str(read_yaml(declaration_path(name), ModelFileError, "").data.get("description", "")))
        for name in shipped_robots()
    ]
    facts = {"robots": [{"name": name, "description": text} for name, text in robots]}
    report(as_json, facts, TextTable("shipped robots", ("robot", "description"), robots))


def _general(facts: dict[str, Any]) -> TextTable:
    independent, reference = facts["independent"], facts["reference"]
    axes, modes = independent["axes"], facts["working_modes"]
    rows = [
        *((name, str(count)) for name, count in facts["counts"].items()),
        (
            "independent",
            f"{', '.join(axes)} of {independent['platform']}" if axes else ", ".join(independent["joints"]),
        ),
        ("gravity [m/s²]", _gravity(facts)),
        *([("working mode", f"{facts['working_mode']} of {', '.join(modes)}")] if modes else []),
        ("characteristic length [m]", f"{facts['characteristic_length']:.6g}"),
        ("closed form (virtual work)", facts["closed_form"] or "none"),
        (f"reference [{_unit(facts)}]", _coordinates(reference["coordinates"])),
        ("type I margin there (lower bound)", f"{reference['type_i_margin']:.4g}"),
        ("type II margin there", f"{reference['type_ii_margin']:.4g}"),
        ("condition number there", f"{reference['condition']:.4g}"),
    ]
    return TextTable(": ".join(part for part in (facts["name"], facts["description"]) if part), (), rows)


def _tables(facts: dict[str, Any]) -> Iterator[TextTable]:
    """Give the tables of bodies, joints and closures, and of parameters and limits where there are any."""
    bodies = [
        (
            _body_name(body, facts),
            f"{body['mass']:.6g}",
            ", ".join(_texts(body["centre"])),
            ", ".join(_texts(body["principal_moments"])),
        )
        for body in facts["bodies"]
    ]
    headings: tuple[str, ...] = ("body", "mass [kg]", "centre in its frame [m]", "principal moments [kg·m²]")
    total = f"{facts['moving_mass']:.6g} kg, {facts['moving_weight']:.6g} N"
    yield TextTable(f"moving bodies, with all links fixed to them: {total}", headings, bodies, numbers=True)
    holding = facts["reference"]["holding"]
    texts = _texts([each["effort"] for each in holding["efforts"]])
    efforts = [(each["joint"], f"{text} {each['unit']}") for each, text in zip(holding["efforts"], texts, strict=True)]
    rows = [*efforts, ("status", holding["status"])]
    yield TextTable("efforts that hold the reference", ("joint", "effort at rest"), rows, numbers=True)
    joints = [(joint["name"], joint["type"], joint["role"], *_range(joint)) for joint in facts["joints"]]
    yield TextTable("joints of the tree", ("joint", "type", "role", "limits", "reference"), joints)
    closures = [(each["frame_a"], each["frame_b"], _held(each)) for each in facts["closures"]]
    yield TextTable("closures", ("frame a", "frame b", "axes"), closures)
    couplings = [
        (
            each["joint"],
            each["of"] or "held",
            " ".join(f"{c:g}" for c in each["polynomial"]),
            " ".join(f"{factor:+g} {name}" for name, factor in each["also"]),
        )
        for each in facts["couplings"]
    ]
    if couplings:
        headings = ("joint q", "of p", "polynomial", "further terms")
        yield TextTable("couplings, q = c0 + c1 p + ...", headings, couplings)
    values = [(name, _text(entry["value"]), _text(entry["default"])) for name, entry in facts["parameters"].items()]
    if values:
        headings = ("parameter", "value", "default")
        yield TextTable("parameters (--set NAME=VALUE)", headings, values, numbers=True)
    limits = [
        (name, " … ".join(f"{end:g}" for end in entry["position"]), *(f"{entry[key]:g}" for key in _LIMITS))
        for name, entry in facts["carrier_limits"].items()
    ]
    if limits:
        headings = ("carrier", "position [m]", "speed [m/s]", "acceleration [m/s²]", "force [N]")
        yield TextTable("carrier limits", headings, limits, numbers=True)
    motors = [
        (name, " … ".join(f"{end:g}" for end in entry["effort"]), f"{entry['speed']:g}")
        for name, entry in facts["motor_limits"].items()
    ]
    headings = ("motor", "effort [N] or [N·m]", "speed [m/s] or [rad/s]")
    yield TextTable("limits of motors, which plans keep", headings, motors, numbers=True)
    if facts["loads"]:
        yield _loads_table(facts)


def _body_name(body: dict[str, Any], facts: dict[str, Any]) -> str:
    """Return the name of a body, with that of the platform where it is fixed to the body."""
    platform = facts["independent"]["platform"]
    return f"{body['name']} with {platform}" if platform in body["links"][1:] else str(body["name"])


def _texts(values: Any) -> list[str]:
    """Return numbers with six digits, in any unit; what is rounding of the largest is zero."""
    size = float(np.abs(values).max(initial=0.0))
    return [f"{0.0 if abs(value) < _NOTHING * size else value:.6g}" for value in values]


_NOTHING = 1e-12
"""Part of the largest of some numbers that is rounding."""


def _range(joint: dict[str, Any]) -> tuple[str, str]:
    """Return the limits of a joint, and where it is at the reference configuration, marked where that is outside."""
    at = joint["reference"]
    if at is None:
        return "", ""
    lower, upper = joint["limits"] or (None, None)
    shown = f"{round(at, 9) + 0.0:.4g}{' (outside)' if joint['outside'] else ''}"
    if lower is None and upper is None:
        return "", shown
    ends = " … ".join("none" if end is None else f"{end:g}" for end in (lower, upper))
    return f"{ends} {'m' if joint['type'] == 'prismatic' else 'rad'}", shown


def _loads_table(facts: dict[str, Any]) -> TextTable:
    rows = []
    for load in facts["loads"]:
        places = ("joint", "frame", "frame_a", "frame_b")
        where = ", ".join(str(load[name]) for name in places if name in load)
        values = {name.replace("_", " "): value for name, value in load.items() if name not in ("kind", *places)}
        what = [
            f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in values.items()
        ]
        rows.append((load["kind"], where, ", ".join(what)))
    return TextTable("loads in force (SI units)", ("kind", "where", "what"), rows)


def _unit(facts: dict[str, Any]) -> str:
    """Return the unit of the reference coordinates."""
    axes, names = facts["independent"]["axes"], facts["independent"]["joints"] or ()
    turning = [joint["type"] == "revolute" for joint in facts["joints"] if joint["name"] in names]
    turning = turning or [axis in ("rx", "ry", "rz") for axis in axes]
    if not any(turning):
        return "m"
    return "rad" if all(turning) else "m, rad"


def _gravity(facts: dict[str, Any]) -> str:
    shown = ", ".join(f"{value:g}" for value in facts["gravity"])
    idle = any(facts["gravity"]) and not facts["gravity_acts"]
    return f"{shown}: normal to the plane of motion, no effect on efforts" if idle else shown


def _coordinates(values: list[Any]) -> str:
    """Return coordinates side by side; of a pose position and roll, pitch, yaw, as a declaration has them."""
    if values and isinstance(values[0], list):
        from scipy.spatial.transform import Rotation

        pose = np.array(values)
        xyz, rpy = _rounded(pose[:3, 3]), _rounded(Rotation.from_matrix(pose[:3, :3]).as_euler("xyz"))
        return f"xyz {row(xyz)}; rpy {row(rpy)}"
    return row(_rounded(values))


def _rounded(values: Any) -> Any:
    """Return numbers without the rounding of a closure: nine digits behind the point."""
    return np.round(np.asarray(values, dtype=float), 9) + 0.0


def _held(closure: Mapping[str, Any]) -> str:
    """Return what a closure constrains."""
    return f"distance {closure['length']:.6g} m" if closure["length"] else ", ".join(closure["axes"])


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)
