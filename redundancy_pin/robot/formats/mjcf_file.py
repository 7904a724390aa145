"""The syntax of MJCF: files that include others, classes of defaults, numbers and orientations of attributes.

What a file says and this reader does not know is refused, by name, file and line: a word that is passed over may be one
that moves a body.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import LARGEST, Array, decimal
from redundancy_pin.errors import ModelFileError, did_you_mean, shown
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot.formats.xacro_engine import is_within, own_folders
from redundancy_pin.robot.formats.xml_files import MOST_BYTES, Element, parsed

MOST_INCLUDED = 100

ORIENTATION = ("quat", "axisangle", "xyaxes", "zaxis", "euler")

ACTUATORS = (
    "motor",
    "position",
    "velocity",
    "intvelocity",
    "general",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
    "dcmotor",
)
"""Elements of one and the same default."""

_WITH_DEFAULTS = (
    *("mesh", "texture", "material", "joint", "geom", "site", "camera", "light", "pair", "equality", "tendon"),
    *("orientation", "pid", *ACTUATORS),
)
_OF_SECTIONS = ("actuator", "equality", "tendon")
"""Sections whose elements have one default, whatever their own tags."""


class Included:
    """The elements of a file and of those it includes, and the file of each.

    Args:
        path: the main file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._folders = own_folders(path)
        self._files: dict[int, Path] = {}
        self._seen: set[Path] = set()
        self._size = 0
        self.root = self._read(path)

    def file(self, element: Element) -> Path:
        """Return the file that an element is written in."""
        return self._files.get(id(element), self.path)

    def refuse(self, element: Element, what: str, remedy: str = "") -> NoReturn:
        """Refuse the file, at the line of an element."""
        path = self.file(element)
        raise ModelFileError(
            f"{path.name}, line {element.line}: {what}.",
            remedy=remedy or "Take it out, or write the model without it.",
            path=str(path),
            line=element.line,
        )

    def _read(self, path: Path) -> Element:
        root = parsed(path)
        self._seen.add(path.resolve())
        self._size += path.stat().st_size
        self._expand(root, path)
        return root

    def _expand(self, parent: Element, path: Path) -> None:
        children: list[Element] = []
        for child in list(parent):
            if not isinstance(child, Element):
                continue
            self._files[id(child)] = path
            if child.tag == "include":
                children += list(self._included(child))
            else:
                self._expand(child, path)
                children.append(child)
        parent[:] = children

    def _included(self, element: Element) -> Iterator[Element]:
        name = element.get("file", "")
        target = self.path.parent / name
        if set(element.attrib) - {"file"}:
            self.refuse(element, f"an include with {', '.join(sorted(set(element.attrib) - {'file'}))}")
        if not name or not is_file(target):
            self.refuse(
                element, f"the included file {shown(name)} is not there", "Correct its name, relative to the model."
            )
        if not is_within(target, self._folders):
            self.refuse(element, f"the included file {shown(name)} is outside the folder of the model")
        if target.resolve() in self._seen:
            self.refuse(element, f"{shown(name)} is included twice, or by itself")
        if len(self._seen) > MOST_INCLUDED or self._size + target.stat().st_size > 3 * MOST_BYTES:
            self.refuse(element, f"more than {MOST_INCLUDED} files, or {3 * MOST_BYTES} bytes of them")
        for child in self._read(target):
            if isinstance(child, Element):
                yield child


@dataclass(frozen=True)
class CompilerSettings:
    """What ``compiler`` says of how numbers are meant."""

    degrees: bool = True
    sequence: str = "xyz"
    autolimits: bool = True
    inertia_from_geom: str = "auto"
    inertia_groups: tuple[float, float] = (0.0, 5.0)


@dataclass(frozen=True)
class Part:
    """An element with its defaults: a reader takes attributes from it."""

    files: Included
    element: Element
    settings: CompilerSettings
    defaults: Mapping[str, str] = field(default_factory=dict)

    @property
    def tag(self) -> str:
        """The kind of element."""
        return str(self.element.tag)

    @property
    def name(self) -> str:
        """Its name, empty where it has none."""
        name = self.element.get("name", "")
        if name and (not name.isprintable() or name != name.strip() or len(name) > 255 or name == "universe"):
            self.refuse(f"a {self.tag} has the name {shown(name)}", "Choose another.")
        return name

    def __str__(self) -> str:
        """Return what to call it in a message."""
        return f"the {self.tag} {self.name!r}" if self.element.get("name") else f"a {self.tag}"

    def refuse(self, what: str, remedy: str = "") -> NoReturn:
        """Refuse the file, at the line of the element."""
        self.files.refuse(self.element, what, remedy)

    def require_known(self, known: Iterable[str], refused: Mapping[str, str] | None = None) -> None:
        """Refuse attributes that are not known, given here or by default."""
        for key in {**self.defaults, **self.element.attrib}:
            if key in (refused or {}):
                self.refuse(f"{self} has {key}={shown(self.text(key))}, which is not covered", (refused or {})[key])
            if key not in known and key not in ("name", "class"):
                self.refuse(
                    f"{self} has an attribute {shown(key)}, which is not known", did_you_mean(key, known).strip()
                )

    def text(self, key: str, default: str = "") -> str:
        """Return the text of an attribute, or its default."""
        return str(self.element.get(key, self.defaults.get(key, default))).strip()

    def has(self, key: str) -> bool:
        """Whether an attribute is given, here or by default."""
        return key in self.element.attrib or key in self.defaults

    def numbers(self, key: str, least: int, most: int | None = None, default: str = "") -> Array:
        """Return the numbers of an attribute."""
        text = self.text(key, default)
        try:
            values = [decimal(part) for part in text.split()]
        except ValueError:
            values = []
        count = len(values)
        if not least <= count <= (most or least) or not all(abs(value) < LARGEST for value in values):
            wanted = str(least) if most in (None, least) else f"{least} to {most}"
            self.refuse(f"{self} has {key}={shown(text)}, not {wanted} finite number(s)", "Correct it.")
        return np.array(values)

    def number(self, key: str, default: float) -> float:
        """Return the number of an attribute."""
        return float(self.numbers(key, 1, default=repr(default))[0])

    def choice(self, key: str, allowed: Iterable[str], default: str) -> str:
        """Return one of several words."""
        text = self.text(key, default)
        if text not in allowed:
            self.refuse(f"{self} has {key}={shown(text)}", f"It must be one of {', '.join(allowed)}.")
        return text

    def limited(self, key: str, of: str) -> bool:
        """Whether a range is in force: ``limited`` says so, or the range counts by itself, not being empty."""
        setting = self.choice(key, ("true", "false", "auto"), "auto")
        low, high = self.numbers(of, 2, default="0 0")
        if setting == "auto" and (low or high) and not self.settings.autolimits:
            self.refuse(f"{self} has {of} and no {key}, and the compiler's autolimits is false", f"Say {key}.")
        if setting == "true" and not low < high:
            self.refuse(f"{self} has {key} and the empty {of} {low:g} {high:g}", f"Correct {of}, or take {key} out.")
        return setting != "false" and bool(low < high)

    def placement(self) -> Array:
        """Return the (4, 4) placement of pos and orientation."""
        result: Array = np.eye(4)
        result[:3, 3] = self.numbers("pos", 3, default="0 0 0")
        result[:3, :3] = self.orientation()
        return result

    def orientation(self) -> Array:
        """Return the (3, 3) rotation that one of five attributes gives."""
        # one that is given here replaces a default of another kind
        own = [key for key in ORIENTATION if key in self.element.attrib]
        given = own or [key for key in ORIENTATION if key in self.defaults]
        if len(given) > 1:
            self.refuse(f"{self} has {' and '.join(given)}", "Give one orientation.")
        if not given:
            return np.eye(3)
        key = given[0]
        values = self.numbers(key, {"quat": 4, "axisangle": 4, "xyaxes": 6, "zaxis": 3, "euler": 3}[key])
        unit = math.pi / 180.0 if self.settings.degrees else 1.0
        if key == "quat":
            return from_quaternion(self._direction(values, key))
        if key == "axisangle":
            return about(self._direction(values[:3], key), unit * values[3])
        if key == "zaxis":
            return from_z(self._direction(values, key))
        if key == "xyaxes":
            x = self._direction(values[:3], key)
            y = self._direction(values[3:] - (values[3:] @ x) * x, key)
            return np.column_stack([x, y, np.cross(x, y)])
        turn = np.eye(3)
        for axis, angle in zip(self.settings.sequence, unit * values, strict=True):
            step = about(np.eye(3)["xyz".index(axis.lower())], angle)
            # lower case turns about the axes turned so far, upper case about the fixed ones
            turn = turn @ step if axis.islower() else step @ turn
        return turn

    def _direction(self, vector: Array, key: str) -> Array:
        length = float(np.linalg.norm(vector))
        if not length > 1e-12:
            self.refuse(f"{self} has a {key} of length zero", "Correct it.")
        return vector / length


class Defaults:
    """The classes of defaults of a model, each with what it takes over from the class around it.

    Args:
        files: the model.
    """

    def __init__(self, files: Included) -> None:
        self._classes: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        for element in files.root:
            if element.tag == "default" and isinstance(element, Element):
                self._read(files, element, None)

    def _read(self, files: Included, element: Element, parent: str | None) -> None:
        name = element.get("class", "main" if parent is None else "")
        if not name or (parent is not None and name in self._classes):
            files.refuse(element, f"a default class {shown(name)}, which needs a name of its own", "Name it.")
        kinds = self._classes.setdefault(name, {})
        for kind, values in self._classes[parent or "main"].items():
            kinds.setdefault(kind, {}).update(values)
        for child in element:
            if child.tag != "default" and isinstance(child, Element):
                if child.tag not in _WITH_DEFAULTS:
                    remedy = did_you_mean(child.tag, _WITH_DEFAULTS).strip()
                    files.refuse(child, f"<{child.tag}> has no defaults", remedy)
                kind = "actuator" if child.tag in ACTUATORS else str(child.tag)
                kinds.setdefault(kind, {}).update(child.attrib)
        for child in element:
            if child.tag == "default" and isinstance(child, Element):
                self._read(files, child, name)

    def of(self, files: Included, element: Element, inherited: str, section: str = "") -> Mapping[str, str]:
        """Return the defaults of an element: of its class, that of the body around it, or of all.

        Args:
            files: the model.
            element: what they are of.
            inherited: class of the body around it.
            section: the section it is in, empty in bodies: all equalities have one default, and so have all tendons.
        """
        name = element.get("class") or inherited or "main"
        if name not in self._classes:
            files.refuse(element, f"there is no default class {shown(name)}", did_you_mean(name, self._classes).strip())
        return self._classes[name].get(section if section in _OF_SECTIONS else str(element.tag), {})


def from_quaternion(wxyz: Array) -> Array:
    """Return the rotation (3, 3) of a unit quaternion w, x, y, z."""
    turn: Array = pin.Quaternion(*map(float, wxyz)).toRotationMatrix()
    return turn


def about(axis: Array, angle: float) -> Array:
    """Return the rotation (3, 3) about a unit axis."""
    turn: Array = pin.exp3(axis * angle)
    return turn


def from_z(z: Array) -> Array:
    """Return the least rotation (3, 3) that takes the z axis to a direction, which may have any length."""
    axis = np.array([-z[1], z[0], 0.0])
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3) if z[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    return about(axis / sine, math.atan2(sine, z[2]))
