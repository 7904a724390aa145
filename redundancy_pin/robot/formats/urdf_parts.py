"""Elements of a URDF: which there are, and which of those that programs have added may change the mechanics."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.errors import shortened
from redundancy_pin.robot.formats.mechanism import MOST_LINKS
from redundancy_pin.robot.formats.xml_files import DRAKE, Part
from redundancy_pin.robot.loop_joints import placed

_POSE = ("xyz", "rpy")

_PARTS: Mapping[str, tuple[str, ...]] = {
    "robot": ("link", "joint", "material", "transmission", "gazebo"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic", "dynamics", "calibration", "safety_controller"),
    "inertial": ("origin", "mass", "inertia"),
}
_WITHOUT_MECHANICS = ("self_collision_checking", "contact", "contact_coefficients", "sensor", "hardwareInterface")
"""Elements in links and joints that programs have added, and that change nothing in the mechanics."""

FRICTION = ("damping", "friction")

_ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "axis": ("xyz",),
    "parent": ("link",),
    "child": ("link",),
    "dynamics": FRICTION,
    "limit": ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"),
    "mimic": ("joint", "multiplier", "offset"),
    "joint": ("name", "type", "independent"),
}


@dataclass(frozen=True)
class UrdfPart(Part):
    """An element of a URDF, whose numbers and names are its attributes."""

    remedy: ClassVar[str] = "Correct the URDF, or the xacro arguments it is made from."
    attributes_of: ClassVar[Mapping[str, tuple[str, ...]]] = _ATTRIBUTES

    def named(self, kind: str) -> dict[str, UrdfPart]:
        """Return the links or joints of the robot by their names, which are checked."""
        parts: dict[str, UrdfPart] = {}
        for element in (*self.children(kind), *self.children(DRAKE + kind)):
            name = element.get("name", "")
            part = UrdfPart(element, self.path, f"The {kind} {name!r} of {self.path.name}", {kind: name})
            unnamed = UrdfPart(element, self.path, f"A {kind}")
            unnamed.name()
            if kind == "joint" and name == "universe":
                unnamed.refuse("A joint has the name 'universe', which Pinocchio gives to the world", name=name)
            if name in parts:
                first = parts[name].element.line
                unnamed.refuse(f"There are two {kind}s {name!r}, the first in line {first}", name=name)
            parts[name] = part
        if kind == "link" and len(parts) > MOST_LINKS:
            self.refuse(f"The robot has {len(parts)} links, more than the {MOST_LINKS} that a model may have")
        return parts

    def unknown_parts(self) -> list[UrdfPart]:
        """Return the elements in the element that the specification does not know, and that may change the mechanics.

        Raises:
            ModelFileError: an element that is nearly, but not quite, one that counts.
        """
        known, unknown = _PARTS[self.tag.removeprefix(DRAKE)], []
        for part in self.parts():
            if part.tag in known or part.tag in _WITHOUT_MECHANICS:
                continue
            # names of extensions are far from all
            if near := difflib.get_close_matches(part.tag.lower(), known, n=1, cutoff=0.8):
                replace(part, details=self.details).refuse(
                    f"{self.owner} has an element <{shortened(part.tag)}>", f"Did you mean {near[0]!r}?"
                )
            unknown.append(part)
        return unknown

    def unknown_attributes(self) -> list[tuple[str, str, int]]:
        """Return the attributes of the element and of those in it that are not understood: name, element, and line."""
        return [
            (shortened(key), each.tag, each.element.line)
            for each in (self, *self.parts())
            for key in each.attributes
            if ":" not in key and key not in _ATTRIBUTES.get(each.tag.removeprefix(DRAKE), (key,))
        ]

    def placement(self) -> Array:
        """Return the (4, 4) placement that the origin of the element gives."""
        origin = self.one("origin")
        return np.eye(4) if origin is None else replace(origin, owner=self.owner).pose()

    def pose(self) -> Array:
        """Return the (4, 4) placement of the attributes xyz and rpy."""
        if "quat_xyzw" in self.attributes:
            self.refuse(f"{self.owner} has an origin with quat_xyzw", "Write the rotation as rpy.")
        given = [self.triple(key, f"an origin with {key}") if key in self.attributes else np.zeros(3) for key in _POSE]
        return placed(pin.rpy.rpyToMatrix(given[1]), given[0])
