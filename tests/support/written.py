"""Robots that tests write themselves: a URDF from a list of joints, a declaration from a mapping, a changed file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import yaml


@dataclass(frozen=True)
class J:
    """A URDF joint; its child link has a mass of 1 kg and a round inertia unless it is a fixed frame."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Sequence[float] = (0.0, 0.0, 0.0)
    rpy: Sequence[float] = (0.0, 0.0, 0.0)
    axis: Sequence[float] = (0.0, 0.0, 1.0)


FOUR_BAR = (
    J("crank", "revolute", "base", "crank"),
    J("knee", "revolute", "crank", "coupler", (0.1, 0, 0)),
    J("rocker", "revolute", "base", "rocker", (0.3, 0, 0)),
    J("coupler_end", "fixed", "coupler", "coupler_tip", (0.3, 0, 0)),
    J("rocker_end", "fixed", "rocker", "rocker_tip", (0.2, 0, 0)),
)
"""Joints of a four-bar whose loop ``coupler_tip`` and ``rocker_tip`` close."""


def urdf_of(joints: Sequence[J], mass: float = 1.0) -> str:
    """Return the URDF of a tree that hangs on the link ``base``."""
    parts = ['<robot name="written">', '<link name="base"/>']
    for joint in joints:
        inertial = (
            ""
            if joint.kind == "fixed"
            else f'<inertial><origin xyz="0.1 0.02 0.03"/><mass value="{mass}"/>'
            '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial>'
        )
        limits = (
            '<limit lower="-100" upper="100" velocity="10" effort="10"/>'
            if joint.kind in ("revolute", "prismatic")
            else ""
        )
        parts.append(f'<link name="{joint.child}">{inertial}</link>')
        parts.append(
            f'<joint name={quoteattr(joint.name)} type="{joint.kind}">'
            f'<parent link="{joint.parent}"/><child link="{joint.child}"/>'
            f'<origin xyz="{_text(joint.xyz)}" rpy="{_text(joint.rpy)}"/>'
            f'<axis xyz="{_text(joint.axis)}"/>{limits}</joint>'
        )
    return "\n".join([*parts, "</robot>"])


def write_robot(folder: Path, urdf: str, declaration: Mapping[str, Any]) -> Path:
    """Write ``robot.urdf`` and ``robot.yaml`` and return the path of the declaration."""
    (folder / "robot.urdf").write_text(urdf, encoding="utf-8")
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump({"urdf": "robot.urdf", **declaration}), encoding="utf-8")
    return path


def write_changed(folder: Path, path: Path, *changes: tuple[str, str]) -> Path:
    """Write a file of a model into a folder, with parts of its text replaced once each, and return its path there."""
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    folder.mkdir(exist_ok=True)
    (folder / path.name).write_text(text, encoding="utf-8")
    return folder / path.name


def _text(numbers: Sequence[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
