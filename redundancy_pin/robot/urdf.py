"""The arguments of a xacro file: which there are, which kinds they have, and what a user may pass."""

from __future__ import annotations

import difflib
import math
import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from redundancy_pin.errors import InputError, ModelFileError

Argument = float | bool | str
"""A xacro argument: a number, a flag, or text (such as ``"auto"``)."""

_XACRO = "{http://www.ros.org/wiki/xacro}"


def known_values(path: Path, arguments: Mapping[str, object]) -> dict[str, Argument]:
    """Check arguments against what a file declares, and return those whose values need no evaluation.

    Args:
        path: a ``.urdf`` or ``.xacro`` file.
        arguments: values by name.

    Returns:
        The given arguments, and the declared ones whose defaults are plain text.

    Raises:
        ModelFileError: missing file or broken XML.
        InputError: an argument that the file and its includes do not declare, or a value of another kind than its
            default.
    """
    defaults, complete = _declared(path)
    if complete:
        _require_known(arguments, tuple(defaults), path)
    values: dict[str, Argument] = {}
    for name in (*defaults, *(extra for extra in arguments if extra not in defaults)):
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


def as_text(value: object) -> str:
    """Return an argument as xacro reads it; whole numbers keep the form they were given in."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else repr(value) if isinstance(value, (int, float)) else str(value)


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


def _require_known(arguments: Mapping[str, object], known: tuple[str, ...], path: Path) -> None:
    for name in arguments:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"Did you mean {close[0]!r}? " if close else ""
            allowed = ", ".join(known) if known else "none"
            raise InputError(
                f"{path.name} has no argument {name!r}.", remedy=f"{hint}Its arguments: {allowed}.", argument=name
            )


def _as_argument(name: str, value: object, default: Argument | None) -> Argument:
    """Return a value of the kind of its default: xacro would write any text into the URDF."""
    if isinstance(value, (bool, str)):
        argument = from_text(value) if isinstance(value, str) else value
    else:
        try:
            argument = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(
                f"The argument {name!r} cannot be {value!r}.",
                remedy="Pass a number, True or False, or text.",
                argument=name,
            ) from error
        if not math.isfinite(argument):
            raise InputError(f"The argument {name!r} is {argument}.", remedy="Pass a finite number.", argument=name)
    if default is None or isinstance(default, str):
        return argument
    if isinstance(argument, str) or isinstance(argument, bool) != isinstance(default, bool):
        allowed = "true or false" if isinstance(default, bool) else "a finite number"
        raise InputError(
            f"The argument {name!r} is {argument!r}.",
            remedy=f"It must be {allowed}, like its default {default}.",
            argument=name,
        )
    return argument


_MOMENTS = ("ixx", "iyy", "izz")
_PRODUCTS = ("ixy", "ixz", "iyz")

_TRIANGLE_TOLERANCE = 1e-6
"""A moment of inertia may exceed the sum of the other two by this fraction: files carry six digits."""


def require_inertias(path: Path, urdf: str) -> None:
    """Check every ``inertial`` element of a URDF.

    Args:
        path: the file it came from, for messages.
        urdf: the rendered URDF.

    Raises:
        ModelFileError: naming the link whose mass is negative or not a number, or whose inertia no body can have.
    """
    for link in ElementTree.fromstring(urdf).iter("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        name = link.get("name", "?")
        mass = _number(path, name, "mass", inertial.find("mass"), "value")
        if mass < 0.0:
            raise _refuse(path, name, f"a negative mass, {mass:g} kg")
        element = inertial.find("inertia")
        if element is None:
            raise _refuse(path, name, "no inertia")
        xx, yy, zz = (_number(path, name, key, element, key) for key in _MOMENTS)
        xy, xz, yz = (_number(path, name, key, element, key, 0.0) for key in _PRODUCTS)
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        allowed = _TRIANGLE_TOLERANCE * float(np.abs(moments).max())
        if moments[0] < -allowed or moments[2] > moments[0] + moments[1] + allowed:
            raise _refuse(
                path,
                name,
                f"principal moments of inertia {np.array2string(moments, precision=4)} that no body can have",
            )


def require_no_mimics(path: Path, urdf: str) -> None:
    """Check that no joint follows another: the tree would be given a freedom it does not have.

    Raises:
        ModelFileError: naming the joint.
    """
    for joint in ElementTree.fromstring(urdf).iter("joint"):
        if joint.find("mimic") is not None:
            raise ModelFileError(
                f"The joint {joint.get('name')!r} of {path.name} mimics another, which closed chains do not cover.",
                remedy="Build the coupling as a loop, or make the joint free or fixed.",
                path=str(path),
            )


def _number(
    path: Path, link: str, what: str, element: ElementTree.Element | None, key: str, default: float | None = None
) -> float:
    text = None if element is None else element.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _refuse(path, link, f"the {what} {text!r}, which is not a finite number")
    return value


def _refuse(path: Path, link: str, what: str) -> ModelFileError:
    return ModelFileError(
        f"The link {link!r} of {path.name} has {what}.",
        remedy="Correct the URDF, or the xacro arguments it is made from.",
        path=str(path),
        link=link,
    )


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
    """Return the path of a robot's declaration.

    Args:
        source: name of a shipped robot, path of a ``robot.yaml``, or of the folder that holds one.

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
    path = Path(source)
    if path.is_dir() and (path / "robot.yaml").is_file():
        return path / "robot.yaml"
    if path.is_file():
        return path
    if path.is_dir():
        raise ModelFileError(
            f"The folder {path} holds no robot.yaml.",
            remedy="Name the declaration itself, or the folder that holds it.",
            source=str(source),
        )
    names = ", ".join(shipped_robots())
    if path.suffix or len(path.parts) > 1:
        raise ModelFileError(
            f"There is no file {path}.",
            remedy=f"Correct the path, or name a shipped robot: {names}.",
            source=str(source),
        )
    close = difflib.get_close_matches(str(source).lower(), shipped_robots(), n=1)
    hint = f"Did you mean {close[0]!r}? " if close else ""
    raise ModelFileError(
        f"There is no robot {str(source)!r}.",
        remedy=f"{hint}Shipped robots: {names}; or pass the path of your own robot.yaml.",
        source=str(source),
    )


def source_of(path: Path) -> str:
    """Return what finds a declaration again from any folder: the name of a shipped robot, or an absolute path."""
    absolute = path.resolve()
    shipped = absolute.name == "robot.yaml" and absolute.parent.parent == models_root().resolve()
    return absolute.parent.name if shipped else str(absolute)


def render(path: Path, arguments: Mapping[str, object]) -> tuple[str, dict[str, Argument]]:
    """Render a URDF or xacro file.

    Args:
        path: a ``.urdf`` or ``.xacro`` file; what it includes is found relative to it.
        arguments: xacro arguments by name, checked by ``arguments.known_values``; those left out keep their defaults.

    Returns:
        The URDF, and every xacro argument with the value that was used.

    Raises:
        ModelFileError: missing file, broken XML, a xacro expression that fails, masses and inertias that are none, or a
            joint that mimics another.
    """
    parsed(path)
    if path.suffix == ".xacro":
        urdf, parameters = _run_xacro(path, {name: as_text(value) for name, value in arguments.items()})
    else:
        urdf, parameters = path.read_text(encoding="utf-8"), {}
    require_inertias(path, urdf)
    require_no_mimics(path, urdf)
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
