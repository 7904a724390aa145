"""A robot with identified parameters as files that load again: its declaration, and its model with other inertias."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pinocchio as pin
import yaml

from redundancy_pin.arrays import Array
from redundancy_pin.errors import OutputError
from redundancy_pin.identification.physical import least_eigenvalue
from redundancy_pin.io.files import write_text
from redundancy_pin.robot import JointForces, Robot
from redundancy_pin.robot.declaration import read_declaration
from redundancy_pin.robot.formats.xml_files import parsed_text
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.model_files import is_model_file
from redundancy_pin.robot.shipped import declaration_path

_ROUNDING = 1e-12
"""Least eigenvalue of a pseudo-inertia, relative to the largest, that is zero."""


def write_robot(robot: Robot, path: str | Path) -> tuple[Path, Path]:
    """Write a robot's declaration with its joint forces, and its model with its inertias in the same folder.

    The model is ``NAME.urdf.xacro`` without expressions; arguments of the robot keep their values as defaults, because
    the declaration may use them. They no longer change lengths or masses.

    Args:
        robot: a robot that a declaration with a URDF was loaded for, such as ``fit.robot``.
        path: of the declaration, ``NAME.yaml``.

    Returns:
        The paths of declaration and model.

    Raises:
        OutputError: a robot of another source, or a file that cannot be written.

    Example:
        >>> from redundancy_pin.identification import write_robot
        >>> [path.name for path in write_robot(rp.load_robot("five_bar"), "own.yaml")]
        ['own.yaml', 'own.urdf.xacro']
    """
    path = Path(path)
    source = declaration_path(robot.source) if robot.source else None
    if source is None or is_model_file(source) or not robot.urdf:
        raise OutputError(
            f"{robot.name} was not loaded from a declaration with a URDF, and cannot be written as one.",
            remedy="Use fit.robot in Python, or declare the robot with `redundancy-pin new`.",
            path=str(path),
        )
    bodies = zip(robot.bodies, robot.model.inertias[1:], strict=True)
    unreal = [body.name for body, inertia in bodies if least_eigenvalue(inertia) < -_ROUNDING]
    if unreal:
        raise OutputError(
            f"No body can have the inertia of {', '.join(unreal)}, and no file with it loads.",
            remedy="Identify with physical=True.",
            path=str(path),
        )
    model = path.with_name(f"{path.stem}.urdf.xacro")
    data: dict[str, Any] = {**read_declaration(source).data, "urdf": model.name, "gravity": robot.gravity.tolist()}
    data.pop("closed_form", None)
    data["characteristic_length"] = float(robot.characteristic_length)
    data["urdf_dynamics"] = False  # those of the model are among the joint forces
    data["joint_forces"] = [asdict(load) for load in of_kind(robot.loads, JointForces)]
    if robot.working_mode:
        data["working_modes"] = {**data["working_modes"], "default": list(robot.working_mode)}
    write_text(model, _model_text(robot))
    write_text(path, yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
    return path, model


def _model_text(robot: Robot) -> str:
    """Return the URDF with the inertia of each joint's body in the link that the joint moves."""
    root, model = parsed_text(robot.urdf, "The URDF"), robot.model
    links = {str(link.get("name")): link for link in root.findall("link")}
    written: set[int] = set()
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY or frame.name not in links or not frame.parentJoint:
            continue
        link = links[frame.name]
        for old in link.findall("inertial"):
            link.remove(old)
        first = frame.parentJoint not in written  # of several links in one body the first has all
        written.add(frame.parentJoint)
        link.append(
            _inertial(frame.placement.actInv(model.inertias[frame.parentJoint]) if first else pin.Inertia.Zero())
        )
    for mesh in root.iter("mesh"):
        if "://" not in (name := str(mesh.get("filename"))):
            mesh.set("filename", os.path.join(robot.urdf_folder, name))
    root.set("xmlns:xacro", "http://www.ros.org/wiki/xacro")
    for k, (name, value) in enumerate(robot.parameters.items()):
        text = str(value).lower() if isinstance(value, bool) else str(value)
        root.insert(k, ElementTree.Element("xacro:arg", {"name": name, "default": text}))
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _inertial(inertia: pin.Inertia) -> ElementTree.Element:
    element, about_centre = ElementTree.Element("inertial"), inertia.inertia
    ElementTree.SubElement(element, "origin", {"xyz": _numbers(inertia.lever), "rpy": "0 0 0"})
    ElementTree.SubElement(element, "mass", {"value": repr(float(inertia.mass))})
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = {name: repr(float(about_centre[entry])) for name, entry in entries.items()}
    ElementTree.SubElement(element, "inertia", values)
    return element


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
