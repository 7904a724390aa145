"""Elements of a URDF, read strictly: what is no number, is there twice or is misspelt is an error with its line."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, NoReturn, TypeVar

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import LARGEST, Array
from redundancy_pin.errors import ModelFileError, did_you_mean
from redundancy_pin.robot.formats.mechanism import MOST_LINKS
from redundancy_pin.robot.formats.xml_files import Element
from redundancy_pin.robot.loop_joints import placed

_P = TypeVar("_P", bound="Part")

LONGEST_NAME = 255
"""Characters of a name of a link or joint."""

_POSE = ("xyz", "rpy")

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)

DRAKE = "{http://drake.mit.edu}"
"""Namespace of the elements that Drake adds."""

_PARTS: Mapping[str, tuple[str, ...]] = {
    "robot": ("link", "joint", "material", "transmission", "gazebo"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic", "dynamics", "calibration", "safety_controller"),
    "inertial": ("origin", "mass", "inertia"),
}
_WITHOUT_MECHANICS = ("self_collision_checking", "contact", "contact_coefficients", "sensor", "hardwareInterface")
"""Elements in links and joints that programs have added, and that change nothing in the mechanics."""

FRICTION = ("damping", "friction")

ZEROS = ("", "0", "0.0", "false")
"""Texts of elements and attributes that change nothing."""

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
class Part:
    """An element, the file that it is in, and the link or joint that it belongs to: for messages and their details."""

    element: Element
    path: Path
    owner: str
    details: Mapping[str, str] = field(default_factory=dict)
    remedy: ClassVar[str] = "Correct the URDF, or the xacro arguments it is made from."

    def refuse(self, message: str, remedy: str = "", **details: object) -> NoReturn:
        """Refuse the file, at the line of the element."""
        line = self.element.line
        place = f"line {line}" + (" of what xacro makes of it" if self.path.suffix == ".xacro" else "")
        raise ModelFileError(
            f"{message} ({place if self.path.name in message else f'{self.path.name}, {place}'}).",
            remedy=remedy or self.remedy,
            path=str(self.path),
            line=line,
            **self.details,
            **details,
        )

    def named(self, kind: str) -> dict[str, Part]:
        """Return the links or joints of the robot by their names, which are checked."""
        parts: dict[str, Part] = {}
        for element in (*self.children(kind), *self.children(DRAKE + kind)):
            name = element.get("name", "")
            part = Part(element, self.path, f"The {kind} {name!r} of {self.path.name}", {kind: name})
            unnamed = Part(element, self.path, f"A {kind}")
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

    @property
    def tag(self) -> str:
        """The name of the element, with the namespace in braces before it."""
        return str(self.element.tag)

    @property
    def place(self) -> str:
        """The element and its line, for messages."""
        return f"<{self.tag.rpartition('}')[2]}> in line {self.element.line}"

    @property
    def attributes(self) -> Mapping[str, str]:
        """The attributes of the element."""
        return self.element.attrib

    def children(self, tag: str) -> Iterator[Element]:
        """Give the elements of that name in the element."""
        return (part for part in self.element if part.tag == tag and isinstance(part, Element))

    def parts(self: _P, tag: str = "") -> list[_P]:
        """Return the elements in the element, those of one name or all, each named by itself in messages."""
        found = [each for each in self.element if isinstance(each, Element) and tag in ("", each.tag)]
        return [self._named_by_itself(each) for each in found]

    def deep(self: _P, tag: str) -> list[_P]:
        """Return the elements of that name in the element and in what is in it."""
        return [self._named_by_itself(each) for each in self.element.iter(tag) if isinstance(each, Element)]

    def _named_by_itself(self: _P, element: Element) -> _P:
        label = str(element.tag).rpartition("}")[2]
        name = f" {element.get('name', '')!r}" if element.get("name") else ""
        return replace(self, element=element, owner=f"The <{label}>{name} of {self.path.name}", details={})

    def name(self) -> str:
        """Return the name of the element.

        Raises:
            ModelFileError: none, one that is blank, or one that is too long.
        """
        name = self.element.get("name", "")
        if not name or not name.isprintable() or name != name.strip():
            self.refuse(f"{self.owner} has the name {short(repr(self.element.get('name')))}", "Give it one.")
        if len(name) > LONGEST_NAME:
            self.refuse(f"{self.owner} has a name of {len(name)} characters", f"There may be {LONGEST_NAME}.")
        return name

    def text_of(self, key: str) -> str:
        """Return an attribute, empty where it is left out."""
        return self.element.get(key, "").strip()

    def content(self) -> str:
        """Return the text in the element."""
        return (self.element.text or "").strip()

    def one(self: _P, tag: str) -> _P | None:
        """Return a part of which there is at most one.

        Raises:
            ModelFileError: more of them, or an attribute that is nearly, but not quite, one that is left out.
        """
        parts = [replace(self, element=element) for element in self.children(tag)]
        if len(parts) > 1:
            parts[1].refuse(f"{self.owner} has <{tag}> {len(parts)} times")
        known = _ATTRIBUTES.get(tag, ())
        for key in parts[0].element.attrib if parts and known else ():
            left_out = [each for each in known if each not in parts[0].element.attrib]
            if key not in known and (hint := did_you_mean(key.lower(), left_out)):
                parts[0].refuse(f"{self.owner} has <{tag}> with the attribute {short(key)!r}", hint.strip())
        return parts[0] if parts else None

    def required(self: _P, tag: str) -> _P:
        """Return a part that has to be there."""
        return self.one(tag) or self.refuse(f"{self.owner} has no {tag}")

    def unknown_parts(self) -> list[Part]:
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
                    f"{self.owner} has an element <{short(part.tag)}>", f"Did you mean {near[0]!r}?"
                )
            unknown.append(part)
        return unknown

    def unknown_attributes(self) -> list[tuple[str, str, int]]:
        """Return the attributes of the element and of those in it that are not understood: name, element, and line."""
        return [
            (short(key), each.tag, each.element.line)
            for each in (self, *self.parts())
            for key in each.attributes
            if "}" not in key and key not in _ATTRIBUTES.get(each.tag.removeprefix(DRAKE), (key,))
        ]

    def number(self, key: str, what: str = "", most: float = LARGEST) -> float:
        """Return the number of an attribute."""
        text = self.element.get(key)
        number = _as_number((text or "").strip(), most)
        if number is None:
            shown = text if text is None else short(text)
            self.refuse(f"{self.owner} has the {what or key} {shown!r}, which is not a finite number")
        return number

    def numbers(self, text: str, count: int, what: str) -> Array:
        """Return the (count,) numbers of a text."""
        numbers = [_as_number(part, LARGEST) for part in text.split()]
        if len(numbers) != count or None in numbers:
            wanted = {1: "one finite number", 3: "three finite numbers"}.get(count, f"{count} finite numbers")
            remedy = "Write numbers with blanks between them."
            self.refuse(f"{self.owner} has {what} {short(text)!r}, which is not {wanted}", remedy)
        return np.array(numbers, dtype=float)

    def triple(self, key: str, what: str) -> Array:
        """Return the (3,) numbers of an attribute."""
        return self.numbers(self.element.get(key, ""), 3, what)

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


def _as_number(text: str, most: float) -> float | None:
    number = float(text) if _NUMBER.fullmatch(text) else math.nan
    return number if abs(number) <= most else None


def short(text: str) -> str:
    """Return a text, or its beginning where it is long."""
    return text if len(text) <= 80 else f"{text[:77]}..."
