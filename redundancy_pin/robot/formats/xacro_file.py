"""xacro files: which arguments they have, what a user may pass for them, and the URDF that a file gives."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from redundancy_pin.arrays import decimal
from redundancy_pin.errors import InputError, one_of, shown
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot.formats.packages import may_include, own_folders
from redundancy_pin.robot.formats.xacro_engine import expand
from redundancy_pin.robot.formats.xml_files import MOST_BYTES, parsed, read_model

Argument = float | bool | str
"""A xacro argument: a number, a flag, or text (such as ``"auto"``)."""

_MOST_BYTES = 3 * MOST_BYTES
"""What is looked into for arguments before xacro, which has bounds of its own, expands the files."""

_XACRO = "http://www.ros.org/wiki/xacro"


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
        raise _unknown(path, unknown[0], defaults)
    values: dict[str, Argument] = {}
    for name in (*defaults, *unknown):
        default = defaults.get(name)
        literal = None if default is None or "$" in default else from_text(default)
        if name in defaults and default is None:
            raise InputError(
                f"The argument {name!r} of {path.name} has no default, which xacro demands.",
                remedy=f'Give it one in the file, which a value replaces: <xacro:arg name="{name}" default="0"/>.',
                argument=name,
            )
        if name in arguments:
            values[name] = _as_argument(name, arguments[name], literal)
        elif literal is not None:
            values[name] = literal
    return values


def _unknown(path: Path, name: str, known: Iterable[str]) -> InputError:
    """Return the error for an argument that a file does not have."""
    known = tuple(known)
    return InputError(
        f"{path.name} has no argument {name!r}{'' if known else ', nor any other'}.",
        remedy=one_of(name, known, "Its arguments") if known else _without_arguments(path, name),
        argument=name,
    )


def _without_arguments(path: Path, name: str) -> str:
    """Return what to do where a file has no arguments: a plain URDF never has."""
    declared = f'declare <xacro:arg name="{name}" default="..."/> in it, and write $(arg {name}) where its value stands'
    if path.suffix != ".xacro":
        # xmlns: a xacro file names the namespace of its elements in <robot>
        declared = (
            f"rename it {path.name}.xacro, also under `urdf` of the declaration, add "
            f'xmlns:xacro="{_XACRO}" to its <robot>, {declared}'
        )
    return (
        "In Python masses and lengths change without arguments: "
        f"rp.with_parameters(robot, masses={{...}}, lengths={{...}}). For an argument, {declared}."
    )


def from_text(text: str) -> Argument:
    """Return what a xacro argument means: a flag, a finite number, or the text itself."""
    lowered = text.strip().lower()
    if lowered in ("true", "false"):
        return lowered == "true"
    try:
        number = decimal(text)
    except ValueError:
        return text
    return number if math.isfinite(number) else text


def _declared(path: Path) -> tuple[dict[str, str | None], bool]:
    """Return the arguments of a file and its includes with their defaults, and whether every include was found."""
    defaults: dict[str, str | None] = {}
    files, seen, folders, size = [path], set[Path](), own_folders(path), 0
    complete = True
    for current in files:
        if (place := current.resolve()) in seen:  # a file may include itself by ever longer paths
            continue
        seen.add(place)
        root = parsed(current)
        size += place.stat().st_size
        if size > _MOST_BYTES:
            return defaults, False
        for argument in root.iter("xacro:arg"):
            if "name" in argument.attrib and defaults.get(argument.attrib["name"]) is None:
                defaults[argument.attrib["name"]] = argument.attrib.get("default")
        for include in root.iter("xacro:include"):
            name = include.attrib.get("filename", "$")
            if "$" in name or not is_file(current.parent / name) or not may_include(current.parent / name, folders):
                complete = False  # xacro alone knows what it will include
            else:
                files.append(current.parent / name)
    return defaults, complete


def _as_argument(name: str, value: object, default: Argument | None) -> Argument:
    """Return a value of the kind of its default: xacro would write any text into the URDF."""
    try:
        argument = value if isinstance(value, bool) else from_text(value) if isinstance(value, str) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"The argument {name!r} cannot be {shown(value)}.",
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


def render(
    path: Path, arguments: Mapping[str, object], *, trust: bool = False, untrusted: bool = False
) -> tuple[str, dict[str, Argument]]:
    """Return the URDF that a ``.urdf`` or ``.xacro`` file gives, and every xacro argument with the value that was used.

    What it includes is found relative to it. Arguments are checked by ``known_values``; those left out keep their
    defaults.

    Args:
        path: the file.
        arguments: of the xacro file.
        trust: let xacro evaluate its expressions as Python, with all that Python can do.
        untrusted: let xacro expand it in a child process with limits of time and memory.

    Raises:
        ModelFileError: missing file, broken XML, a xacro expression that fails or that models may not use.
        InputError: an argument that neither the file nor its includes declare or read.
    """
    if path.suffix != ".xacro":
        return read_model(path), {}
    # as xacro reads them; whole numbers keep the form they were given in
    texts = {name: str(value).lower() if isinstance(value, bool) else str(value) for name, value in arguments.items()}
    urdf, resolved = expand(path, texts, trust=trust, untrusted=untrusted)
    if unread := [name for name in texts if name not in resolved]:
        declared, _ = _declared(path)  # in a part of the file that these arguments leave out
        for name in unread:
            if name not in declared:
                raise _unknown(path, name, {**declared, **resolved})
        resolved = {**resolved, **{name: texts[name] for name in unread}}
    return urdf, {name: from_text(value) for name, value in resolved.items()}
