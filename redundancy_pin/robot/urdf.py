"""The arguments of a xacro file: which there are, which kinds they have, and what a user may pass."""

from __future__ import annotations

import math
import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from redundancy_pin.errors import InputError, ModelFileError, did_you_mean

Argument = float | bool | str
"""A xacro argument: a number, a flag, or text (such as ``"auto"``)."""

_XACRO = "{http://www.ros.org/wiki/xacro}"


def known_values(path: Path, arguments: Mapping[str, object]) -> dict[str, Argument]:
    """Check arguments against what a file declares; return them, and the declared ones that need no evaluation.

    Raises:
        ModelFileError: missing file or broken XML.
        InputError: an argument that the file and its includes do not declare, or a value of another kind than its
            default.
    """
    defaults, complete = _declared(path)
    unknown = [name for name in arguments if name not in defaults]
    if complete and unknown:
        raise InputError(
            f"{path.name} has no argument {unknown[0]!r}.",
            remedy=f"{did_you_mean(unknown[0], defaults)}Its arguments: {', '.join(defaults) or 'none'}.",
            argument=unknown[0],
        )
    values: dict[str, Argument] = {}
    for name in (*defaults, *unknown):
        default = defaults.get(name)
        literal = None if default is None or "$" in default else from_text(default)
        if name in arguments:
            values[name] = _as_argument(name, arguments[name], literal)
        elif literal is not None:
            values[name] = literal
        elif default is None:
            raise InputError(
                f"{path.name} needs a value for the argument {name!r}.",
                remedy=f"It has no default: pass {name}=....",
                argument=name,
            )
    return values


def parsed(path: Path) -> ElementTree.Element:
    """Return the root element of an XML file.

    Raises:
        ModelFileError: missing file or broken XML.
    """
    if not path.is_file():
        raise ModelFileError(
            f"The URDF {path} does not exist.", remedy="Correct `urdf` in the declaration.", path=str(path)
        )
    try:
        return ElementTree.fromstring(path.read_text(encoding="utf-8"))
    except (ElementTree.ParseError, UnicodeDecodeError, OSError) as error:
        raise ModelFileError(
            f"{path} is not well-formed XML: {error}.", remedy="Repair the file at that place.", path=str(path)
        ) from error


def from_text(text: str) -> Argument:
    """Return what a xacro argument means: a flag, a finite number, or the text itself."""
    lowered = text.strip().lower()
    if lowered in ("true", "false"):
        return lowered == "true"
    try:
        number = float(text)
    except ValueError:
        return text
    return number if math.isfinite(number) else text


def _declared(path: Path) -> tuple[dict[str, str | None], bool]:
    """Return the arguments of a file and its includes with their defaults, and whether every include was found."""
    defaults: dict[str, str | None] = {}
    complete = True
    waiting, seen = [path], set[Path]()
    while waiting:
        current = waiting.pop(0)
        if current in seen:
            continue
        seen.add(current)
        root = parsed(current)
        for argument in root.iter(f"{_XACRO}arg"):
            if "name" in argument.attrib and defaults.get(argument.attrib["name"]) is None:
                defaults[argument.attrib["name"]] = argument.attrib.get("default")
        for include in root.iter(f"{_XACRO}include"):
            target = current.parent / include.attrib.get("filename", "")
            if "$" in include.attrib.get("filename", "$") or not target.is_file():
                complete = False  # xacro alone knows what it will include
            else:
                waiting.append(target)
    return defaults, complete


def _as_argument(name: str, value: object, default: Argument | None) -> Argument:
    """Return a value of the kind of its default: xacro would write any text into the URDF."""
    try:
        argument = value if isinstance(value, bool) else from_text(value) if isinstance(value, str) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"The argument {name!r} cannot be {value!r}.",
            remedy="Pass a number, True or False, or text.",
            argument=name,
        ) from error
    if isinstance(argument, float) and not math.isfinite(argument):
        raise InputError(f"The argument {name!r} is {argument}.", remedy="Pass a finite number.", argument=name)
    # text as default, such as "auto", allows anything
    if default is not None and not isinstance(default, str) and type(argument) is not type(default):
        allowed = "true or false" if isinstance(default, bool) else "a finite number"
        raise InputError(
            f"The argument {name!r} is {argument!r}.",
            remedy=f"It must be {allowed}, like its default {default}.",
            argument=name,
        )
    return argument


_TRIANGLE_TOLERANCE = 1e-6
"""A moment of inertia may exceed the sum of the other two by this fraction: files carry six digits."""


def _require_sound(path: Path, urdf: str) -> None:
    """Check what Pinocchio takes as it is: masses, inertias, and joints that follow another.

    Raises:
        ModelFileError: naming the link whose mass is negative or not a number, or whose inertia no body can have, or
            the joint that mimics another: the tree would be given a freedom it does not have.
    """
    root = ElementTree.fromstring(urdf)
    for joint in root.iter("joint"):
        if joint.find("mimic") is not None:
            raise ModelFileError(
                f"The joint {joint.get('name')!r} of {path.name} mimics another, which closed chains do not cover.",
                remedy="Build the coupling as a loop, or make the joint free or fixed.",
                path=str(path),
            )
    for link in root.iter("link"):
        inertial = link.find("inertial")
        fault = None if inertial is None else _fault(inertial)
        if fault:
            raise ModelFileError(
                f"The link {link.get('name')!r} of {path.name} has {fault}.",
                remedy="Correct the URDF, or the xacro arguments it is made from.",
                path=str(path),
                link=link.get("name"),
            )


def _fault(inertial: ElementTree.Element) -> str:
    """Return what is wrong with the mass or the moments of inertia of a link; empty where nothing is."""
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if inertia is None:
        return "no inertia"
    texts = {"mass": None if mass is None else mass.get("value")}
    texts |= {key: inertia.get(key) for key in ("ixx", "iyy", "izz")}
    texts |= {key: inertia.get(key, "0") for key in ("ixy", "ixz", "iyz")}
    numbers = {}
    for key, text in texts.items():
        number = from_text(text or "")
        if type(number) is not float:
            return f"the {key} {text!r}, which is not a finite number"
        numbers[key] = number
    if numbers["mass"] < 0.0:
        return f"a negative mass, {numbers['mass']:g} kg"
    moments = np.linalg.eigvalsh([[numbers["i" + "".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])
    allowed = _TRIANGLE_TOLERANCE * float(np.abs(moments).max())
    if moments[0] < -allowed or moments[2] > moments[0] + moments[1] + allowed:
        return f"principal moments of inertia {np.array2string(moments, precision=4)} that no body can have"
    return ""


_XACRO_LOCK = threading.Lock()
"""xacro keeps its stacks in globals: two threads at once empty each other's."""


def models_root() -> Path:
    """Return the folder of the shipped models: inside the wheel, or beside the package in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "models"
    return inside if inside.is_dir() else package.parent / "models"


def shipped_robots() -> tuple[str, ...]:
    """Return the names of the shipped robots, sorted."""
    return tuple(sorted(path.parent.name for path in models_root().glob("*/robot.yaml")))


def declaration_path(source: str | Path) -> Path:
    """Return the path of a declaration, given the name of a shipped robot, that path, or the folder that holds it.

    Raises:
        ModelFileError: there is no such robot or file.
    """
    if isinstance(source, str) and source in shipped_robots():
        return models_root() / source / "robot.yaml"
    if not isinstance(source, (str, Path)):
        raise ModelFileError(
            f"A robot is named by text or a path, not by {source!r}.",
            remedy=f"Shipped robots: {', '.join(shipped_robots())}.",
        )
    path, names = Path(source), ", ".join(shipped_robots())
    if path.is_file() or (path / "robot.yaml").is_file():
        return path if path.is_file() else path / "robot.yaml"
    if path.is_dir():
        message = f"The folder {path} holds no robot.yaml."
        remedy = "Name the declaration itself, or the folder that holds it."
    elif path.suffix or len(path.parts) > 1:
        message, remedy = f"There is no file {path}.", f"Correct the path, or name a shipped robot: {names}."
    else:
        hint = did_you_mean(str(source).lower(), shipped_robots())
        message = f"There is no robot {str(source)!r}."
        remedy = f"{hint}Shipped robots: {names}; or pass the path of your own robot.yaml."
    raise ModelFileError(message, remedy=remedy, source=str(source))


def source_of(path: Path) -> str:
    """Return what finds a declaration again from any folder: the name of a shipped robot, or an absolute path."""
    absolute = path.resolve()
    shipped = absolute.name == "robot.yaml" and absolute.parent.parent == models_root().resolve()
    return absolute.parent.name if shipped else str(absolute)


def render(path: Path, arguments: Mapping[str, object]) -> tuple[str, dict[str, Argument]]:
    """Return the URDF that a ``.urdf`` or ``.xacro`` file gives, and every xacro argument with the value that was used.

    What it includes is found relative to it. Arguments are checked by ``known_values``; those left out keep their
    defaults.

    Raises:
        ModelFileError: missing file, broken XML, a xacro expression that fails, masses and inertias that are none, or a
            joint that mimics another.
    """
    parsed(path)
    if path.suffix == ".xacro":
        # as xacro reads them; whole numbers keep the form they were given in
        texts = {
            name: str(value).lower() if isinstance(value, bool) else str(value) for name, value in arguments.items()
        }
        urdf, parameters = _run_xacro(path, texts)
    else:
        urdf, parameters = path.read_text(encoding="utf-8"), {}
    _require_sound(path, urdf)
    return urdf, parameters


def _run_xacro(path: Path, given: dict[str, str]) -> tuple[str, dict[str, Argument]]:
    import xacro
    from xacrodoc import XacroDoc

    resolved = dict(given)  # xacro adds the arguments that were left out, their defaults evaluated
    try:
        with _XACRO_LOCK:
            document = xacro.process_file(str(path.resolve()), mappings=resolved)
            text: str = XacroDoc.from_string(
                document.toxml(),
                rootdir=path.parent,
                resolve_packages=False,  # the meshes of a package that is not there are missed by pictures only
            ).to_urdf_string()
    except Exception as error:  # xacro evaluates Python expressions: anything may come out of it
        raise ModelFileError(
            f"xacro cannot render {path}: {type(error).__name__}: {error}",
            remedy="Check the expression and the arguments it uses.",
            path=str(path),
        ) from error
    return text, {name: from_text(str(value)) for name, value in resolved.items()}
