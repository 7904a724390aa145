"""Files of mechanisms: URDF and xacro, MJCF, SDF, and the robot.yaml of example-parallel-robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from redundancy_pin.errors import InputError, ModelFileError, one_of, shown
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot.formats.mechanism import Mechanism
from redundancy_pin.robot.formats.mjcf import read_mjcf
from redundancy_pin.robot.formats.parallel_yaml import is_parallel_yaml, read_parallel_yaml
from redundancy_pin.robot.formats.sdf import read_sdf
from redundancy_pin.robot.formats.urdf import SEVERAL_FREEDOMS, read_urdf, urdf_mechanism
from redundancy_pin.robot.formats.xacro_file import Argument, known_values, render
from redundancy_pin.robot.formats.xml_files import FORMATS, format_of, read_model, remedy_of_format

_URDF = (".urdf", ".xacro")
_OF_URDF = ("base", "actuated")
"""Arguments of a URDF that is no xacro file."""

_YAML = (".yaml", ".yml")
_SUFFIXES = (".xml", ".mjcf", ".sdf", ".world", *_YAML)
_PARALLEL = "a robot.yaml of example-parallel-robots"
_ARGUMENTS: Mapping[str, Mapping[str, Argument]] = {
    FORMATS["mujoco"]: {"base": "free", "actuated": "", "keyframe": ""},
    FORMATS["sdf"]: {"base": "fixed", "actuated": ""},
    _PARALLEL: {"base": "fixed", "actuated": ""},
}
"""Such files by what they are, and the arguments that they have in place of those of a xacro file."""


def is_urdf(path: Path) -> bool:
    """Return whether a file is a URDF or xacro, by its name."""
    return path.suffix.lower() in _URDF


def states_gravity(path: Path) -> bool:
    """Return whether a model file has gravity in it, by its name: a URDF has none, nor the collection's robot.yaml."""
    return path.suffix.lower() not in (*_URDF, *_YAML)


def is_model_file(path: Path) -> bool:
    """Return whether a file describes a mechanism and needs no declaration: by its name, and by its top element."""
    return is_file(path) and (is_urdf(path) or (path.suffix.lower() in _SUFFIXES and _format(path) in _ARGUMENTS))


def _format(path: Path) -> str:
    text = read_model(path)
    if path.suffix.lower() in _YAML:
        return _PARALLEL if is_parallel_yaml(text) else ""
    return format_of(text)


Reader: TypeAlias = Callable[[Mapping[str, str] | None, Sequence[str]], Mechanism]
"""Returns the mechanism of a file, of two arguments: by joint, the kind that replaces its own, None without a
declaration; and joints that have a role, which the tree must contain. SDF does not say which of its joints these are,
and one that closes a loop is no joint of the tree otherwise; hinges of a ball are its three joints."""


def open_model(
    path: Path, arguments: Mapping[str, object], *, trust: bool = False, untrusted: bool = False
) -> tuple[dict[str, Argument], Reader]:
    """Return the arguments of a model file with their values, and what reads its mechanism.

    Args:
        path: the file.
        arguments: of a xacro file its own; of others ``base``: "free", or "fixed" to fix a free body at its start;
            of all others ``actuated``, names of driven joints with commas between, in place of those that the file
            states; of MJCF ``keyframe``, the name of the one that the mechanism starts from.
        trust: let xacro evaluate its expressions as Python, and MJCF read files of other folders.
        untrusted: let xacro and MuJoCo work in a child process with limits of time and memory.

    Raises:
        ModelFileError: a file that cannot be read, or has content that is not covered.
        InputError: another argument, or another value; trust and untrusted.
    """
    if trust and untrusted:
        raise InputError("trust and untrusted are both true.", remedy="Pass one of them.")
    by_urdf, found, text, values = is_urdf(path), "", "", dict[str, Argument]()
    if by_urdf:
        own = _OF_URDF if is_plain(path) else ()
        given = {name: _text(value) for name, value in arguments.items() if name in own}
    elif (defaults := _ARGUMENTS.get(found := _format(path))) is None:
        what = f"{path} is {found or 'no model'}, and by its name no URDF."
        raise ModelFileError(what, remedy=remedy_of_format(found), path=str(path))
    elif unknown := [name for name in arguments if name not in defaults]:
        remedy = one_of(unknown[0], defaults, "Its arguments")
        raise InputError(f"{path.name} has no argument {unknown[0]!r}.", remedy=remedy, argument=unknown[0])
    else:
        given = {name: _text(arguments.get(name, default)) for name, default in defaults.items()}
    base, driven = given.get("base", "fixed"), _names(given.get("actuated", ""))
    if base not in ("free", "fixed"):
        raise InputError(f"The argument 'base' is {shown(base)}.", remedy="It must be free or fixed.")
    if by_urdf:
        others = {name: value for name, value in arguments.items() if name not in given}
        known_values(path, others)
        text, values = render(path, others, trust=trust, untrusted=untrusted)

    def read(kinds: Mapping[str, str] | None, named: Sequence[str]) -> Mechanism:
        if kinds and not by_urdf:
            raise InputError(f"`joint_types` are of joints of a URDF; {path.name} is none.", remedy="Leave them out.")
        roles = (*driven, *named)
        if by_urdf:
            made = mechanism_of_urdf(text, path, given, kinds)
        elif found == FORMATS["mujoco"]:
            made = read_mjcf(path, base=base, keyframe=given["keyframe"], trust=trust, untrusted=untrusted)
        elif found == FORMATS["sdf"]:
            made = read_sdf(path, base=base, named=roles)
        else:
            made = read_parallel_yaml(path, base=base)
        made = made.with_hinges(roles)
        return replace(made, actuated=driven) if driven else made

    return {**values, **given}, read


def _text(value: object) -> str:
    """Return an argument as text: of several names a list with commas between."""
    return ",".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _names(text: str) -> tuple[str, ...]:
    """Return the names of a text with commas between."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def mechanism_of_urdf(
    text: str, path: Path, arguments: Mapping[str, Argument], kinds: Mapping[str, str] | None
) -> Mechanism:
    """Return what the text of a URDF describes.

    Args:
        text: the file, after xacro.
        path: the file, for messages and its name.
        arguments: ``base`` and ``actuated`` count, as of ``open_model``.
        kinds: by joint, its replacement; None without a declaration.

    Raises:
        ModelFileError, DeclarationError: as ``read_urdf`` and ``urdf_mechanism``.
    """
    file = read_urdf(text, path)
    if kinds is None:
        kinds = {joint.name: SEVERAL_FREEDOMS[joint.kind] for joint in file.joints if joint.kind in SEVERAL_FREEDOMS}
    base = str(arguments.get("base", "fixed")) if is_plain(path) else "fixed"
    made = urdf_mechanism(file, path.stem.partition(".")[0], kinds=kinds, base=base)
    driven = _names(str(arguments.get("actuated", ""))) if is_plain(path) else ()
    return replace(made, actuated=driven) if driven else made


def is_plain(path: Path) -> bool:
    """Return whether a file is a plain URDF, which has the arguments ``base`` and ``actuated``."""
    return path.suffix.lower() == ".urdf"
