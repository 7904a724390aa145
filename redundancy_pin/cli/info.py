"""``redundancy-pin info``: what a robot is, or which robots there are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import click
import numpy as np

from redundancy_pin.cli.options import RobotOptions, json_option, robot_options, untrusted_option
from redundancy_pin.cli.output import TextTable, report, row
from redundancy_pin.errors import InputError, ModelFileError
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.robot.shipped import declaration_path, shipped_robots

_ROUNDING = 1e-12
"""Part of the largest of some numbers that is rounding."""


@click.command()
@robot_options(required=False)
@untrusted_option
@json_option
def info(robot: RobotOptions, as_json: bool) -> None:
    r"""Show a robot, or which there are.

    Masses of the moving bodies, joints and their roles, closures, degrees of freedom, parameters, limits, the efforts
    that hold the reference configuration, and how far that is from singularities. Without --robot: the shipped robots.

    \b
    Example:
      redundancy-pin info --robot 3rrr --set carrier_mass=2.0
    """
    if robot.source:
        facts = _facts(robot)
        report(as_json, facts, _general(facts), *_tables(facts), *facts["notes"])
        return
    if not robot.is_robot_only:
        raise InputError("--set, --working-mode and --gravity need a robot.", remedy="Add --robot.")
    robots = [
        (name, str(read_yaml(declaration_path(name), ModelFileError, "").data.get("description", "")))
        for name in shipped_robots()
    ]
    listed = {"robots": [{"name": name, "description": text} for name, text in robots]}
    report(as_json, listed, TextTable("shipped robots", robots, ("robot", "description")))


def _facts(robot: RobotOptions) -> dict[str, Any]:
    """Return what there is to know about a robot, with the defaults of its parameters, which only its files have."""
    from redundancy_pin.dynamics.description import describe
    from redundancy_pin.robot.declaration import read_declaration
    from redundancy_pin.robot.model_files import is_model_file, open_model

    loaded, declaration = robot.load(), declaration_path(robot.source)
    data = {} if is_model_file(declaration) else read_declaration(declaration).data
    file = declaration.parent / data["urdf"] if data else declaration
    defaults, _ = open_model(file, {}, trust=robot.trust, untrusted=robot.untrusted)
    values = {name: {"value": value, "default": defaults.get(name)} for name, value in loaded.parameters.items()}
    return {**describe(loaded), "description": str(data.get("description", "")), "parameters": values}


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
    """Give the tables of bodies, joints and motors, and those of what only some robots have."""
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
        bodies,
        ("body", "mass [kg]", "centre in its frame [m]", "principal moments [kg·m²]"),
        numbers=True,
    )
    texts = _texts([each["effort"] for each in holding["efforts"]])
    efforts = [(each["joint"], f"{text} {each['unit']}") for each, text in zip(holding["efforts"], texts, strict=True)]
    rows: list[Sequence[str]] = [*efforts, ("status", holding["status"])]
    yield TextTable("efforts that hold the reference", rows, ("joint", "effort at rest"), numbers=True)
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
    rows = [(name, _text(entry["value"]), _text(entry["default"])) for name, entry in facts["parameters"].items()]
    headings = ("parameter", "value", "default")
    yield from [TextTable("parameters (--set NAME=VALUE)", rows, headings, numbers=True)] if rows else []
    rows = [
        (name, row(own["position"], " … "), *(f"{own[key]:g}" for key in ("speed", "acceleration", "force")))
        for name, own in facts["carrier_limits"].items()
    ]
    headings = ("carrier", "position [m]", "speed [m/s]", "acceleration [m/s²]", "force [N]")
    yield from [TextTable("carrier limits", rows, headings, numbers=True)] if rows else []
    rows = [(name, row(own["effort"], " … "), f"{own['speed']:g}") for name, own in facts["motor_limits"].items()]
    headings = ("motor", "effort [N] or [N·m]", "speed [m/s] or [rad/s]")
    yield TextTable("limits of motors, which plans keep", rows, headings, numbers=True)
    rows = [_load(load) for load in facts["loads"]]
    yield from [TextTable("active loads (SI units)", rows, ("kind", "where", "what"))] if rows else []


def _load(load: Mapping[str, Any]) -> tuple[str, str, str]:
    places = ("joint", "frame", "frame_a", "frame_b")
    values = {name.replace("_", " "): value for name, value in load.items() if name not in ("kind", *places)}
    what = (f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in values.items())
    return load["kind"], ", ".join(str(load[name]) for name in places if name in load), ", ".join(what)


def _range(joint: Mapping[str, Any]) -> tuple[str, str]:
    """Return the limits of a joint, and where it is at the reference configuration, marked where that is outside."""
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
    """Return numbers with six digits, in any unit; what is rounding of the largest is zero."""
    size = float(np.abs(values).max(initial=0.0))
    return [f"{0.0 if abs(value) < _ROUNDING * size else value:.6g}" for value in values]


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)
