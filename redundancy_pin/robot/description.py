"""Find a robot's files, read its xacro arguments and render its URDF."""

from __future__ import annotations

import difflib
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

from redundancy_pin.errors import InputError, ModelFileError
from redundancy_pin.robot.inertias import require_inertias

Argument = float | bool | str
"""A xacro argument: a number, a flag, or text (such as ``"auto"``)."""

_XACRO_ARG = "{http://www.ros.org/wiki/xacro}arg"


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
    close = difflib.get_close_matches(str(source), shipped_robots(), n=1)
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


def resolve_arguments(path: Path, arguments: Mapping[str, object]) -> dict[str, Argument]:
    """Return the xacro arguments of a file with the values that will be used.

    Args:
        path: a ``.urdf`` or ``.xacro`` file.
        arguments: values by name; those left out keep their defaults.

    Raises:
        ModelFileError: missing file or broken XML.
        InputError: an argument the file does not declare, or a value of another kind than its default.
    """
    root = _parsed(path)
    defaults = {arg.attrib["name"]: arg.attrib.get("default") for arg in root.iter(_XACRO_ARG) if "name" in arg.attrib}
    _require_known(arguments, tuple(defaults), path)
    values = {name: _as_argument(name, arguments.get(name, default), path) for name, default in defaults.items()}
    for name, default in defaults.items():
        _require_kind(name, values[name], default)
    return values


def render(path: Path, values: Mapping[str, Argument]) -> str:
    """Render a URDF or xacro file and return the URDF.

    Args:
        path: a ``.urdf`` or ``.xacro`` file.
        values: from ``resolve_arguments``.

    Raises:
        ModelFileError: missing file, broken XML, a xacro expression that fails, or masses and inertias that are none.
    """
    _parsed(path)
    if path.suffix == ".xacro":
        urdf = _run_xacro(path, {name: _as_text(value) for name, value in values.items()})
    else:
        urdf = path.read_text(encoding="utf-8")
    require_inertias(path, urdf)
    return urdf


def _parsed(path: Path) -> ElementTree.Element:
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


def _require_known(arguments: Mapping[str, object], known: tuple[str, ...], path: Path) -> None:
    for name in arguments:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"Did you mean {close[0]!r}? " if close else ""
            allowed = ", ".join(known) if known else "none"
            raise InputError(
                f"{path.name} has no argument {name!r}.", remedy=f"{hint}Its arguments: {allowed}.", argument=name
            )


def _require_kind(name: str, value: Argument, default: str | None) -> None:
    """Check that a number stays a number and a flag a flag: xacro would write any text into the URDF."""
    if default is None:
        return
    expected = _from_text(default)
    if isinstance(expected, str):
        return
    if isinstance(value, str) or isinstance(value, bool) != isinstance(expected, bool):
        allowed = "true or false" if isinstance(expected, bool) else "a finite number"
        raise InputError(
            f"The argument {name!r} is {value!r}.",
            remedy=f"It must be {allowed}, like its default {default}.",
            argument=name,
        )


def _from_text(text: str) -> Argument:
    lowered = text.strip().lower()
    if lowered in ("true", "false"):
        return lowered == "true"
    try:
        number = float(text)
    except ValueError:
        return text
    return number if math.isfinite(number) else text


def _as_argument(name: str, value: object, path: Path) -> Argument:
    if value is None:
        raise InputError(
            f"{path.name} needs a value for the argument {name!r}.",
            remedy=f"It has no default: pass {name}=....",
            argument=name,
        )
    if isinstance(value, bool):
        return value
    if isinstance(value, str):
        return _from_text(value)
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise InputError(
            f"The argument {name!r} cannot be {value!r}.",
            remedy="Pass a number, True or False, or text.",
            argument=name,
        ) from error
    if not -float("inf") < number < float("inf"):
        raise InputError(f"The argument {name!r} is {number}.", remedy="Pass a finite number.", argument=name)
    return number


def _as_text(value: Argument) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else value


def _run_xacro(path: Path, arguments: dict[str, str]) -> str:
    from xacrodoc import XacroDoc

    try:
        document = XacroDoc.from_file(str(path), walk_up=False, subargs=arguments)
        text: str = document.to_urdf_string()
    except Exception as error:  # xacro evaluates Python expressions: anything may come out of it
        raise ModelFileError(
            f"xacro cannot render {path}: {type(error).__name__}: {error}",
            remedy="Check the expression and the arguments it uses.",
            path=str(path),
        ) from error
    return text
