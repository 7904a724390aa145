"""``redundancy-pin info``: what a robot is, or which robots there are."""

from __future__ import annotations

import click

from redundancy_pin.cli.options import RobotOptions, json_option, robot_options, untrusted_option
from redundancy_pin.cli.output import report
from redundancy_pin.errors import InputError, ModelFileError
from redundancy_pin.io.summary import Summary, TextTable
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.robot.shipped import declaration_path, shipped_robots


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
        report(as_json, facts, *facts["notes"])
        return
    if not robot.is_robot_only:
        raise InputError("--set, --working-mode and --gravity need a robot.", remedy="Add --robot.")
    robots = [
        (name, str(read_yaml(declaration_path(name), ModelFileError, "").data.get("description", "")))
        for name in shipped_robots()
    ]
    listed = {"robots": [{"name": name, "description": text} for name, text in robots]}
    report(as_json, Summary(listed, TextTable("shipped robots", robots, ("robot", "description"))))


def _facts(robot: RobotOptions) -> Summary:
    """Return what there is to know about a robot, with the defaults of its parameters, which only its files have."""
    from redundancy_pin.dynamics.description import describe
    from redundancy_pin.robot.declaration import read_declaration
    from redundancy_pin.robot.model_files import is_model_file, open_model

    loaded, declaration = robot.load(), declaration_path(robot.source)
    data = {} if is_model_file(declaration) else read_declaration(declaration).data
    file = declaration.parent / data["urdf"] if data else declaration
    defaults, _ = open_model(file, {}, trust=robot.trust, untrusted=robot.untrusted)
    return describe(loaded, str(data.get("description", "")), defaults)
