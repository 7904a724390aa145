"""The arguments of a xacro file: which there are, which kinds they have, and what a user may pass."""

from __future__ import annotations

import difflib
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

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
