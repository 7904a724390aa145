"""Files that describe a whole mechanism, loops and motors too: which there are, and how they are read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from redundancy_pin.errors import InputError, did_you_mean, shown
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot.formats.mechanism import Mechanism
from redundancy_pin.robot.formats.mjcf import read_mjcf
from redundancy_pin.robot.formats.parallel_yaml import is_parallel_yaml, read_parallel_yaml
from redundancy_pin.robot.formats.sdf import read_sdf
from redundancy_pin.robot.formats.xml_files import FORMATS, format_of, read_model
from redundancy_pin.robot.urdf import Argument

_SUFFIXES = (".xml", ".mjcf", ".sdf", ".world", ".yaml", ".yml")
_PARALLEL = "a robot.yaml of example-parallel-robots"
_READERS: Mapping[str, Callable[..., Mechanism]] = {
    FORMATS["mujoco"]: read_mjcf,
    FORMATS["sdf"]: read_sdf,
    _PARALLEL: read_parallel_yaml,
}
_ARGUMENTS: Mapping[str, Mapping[str, Argument]] = {
    FORMATS["mujoco"]: {"base": "free", "keyframe": ""},
    FORMATS["sdf"]: {"base": "fixed", "actuated": ""},
    _PARALLEL: {"base": "fixed"},
}
"""Such files by what they are, and the arguments that they have in place of those of a xacro file."""


def is_model_file(path: Path) -> bool:
    """Return whether a file is one of those that need no declaration: by its name, and by its top element."""
    return path.suffix.lower() in _SUFFIXES and is_file(path) and _format(path) in _ARGUMENTS


def _format(path: Path) -> str:
    text = read_model(path)
    if path.suffix.lower() in (".yaml", ".yml"):
        return _PARALLEL if is_parallel_yaml(text) else ""
    return format_of(text)


def defaults_of(path: Path) -> Mapping[str, Argument]:
    """Return the arguments of a model file, and their values when left out."""
    return _ARGUMENTS[_format(path)]


def read_mechanism(path: Path, arguments: Mapping[str, object]) -> tuple[Mechanism, dict[str, Argument]]:
    """Read a model file; return what it describes, and the arguments with their values.

    Args:
        path: the file.
        arguments: ``base``: "free", or "fixed" to hold a free body where it starts; of MJCF ``keyframe``, the name of
            the one that the mechanism starts from; of SDF ``actuated``, names of driven joints with commas between.

    Raises:
        ModelFileError: a file that cannot be read, or says what is not covered.
        InputError: another argument, or another value.
    """
    defaults = defaults_of(path)
    for name in arguments:
        if name not in defaults:
            remedy = f"{did_you_mean(name, defaults)}Its arguments: {', '.join(defaults)}."
            raise InputError(f"{path.name} has no argument {name!r}.", remedy=remedy, argument=name)
    values = {name: str(arguments.get(name, default)) for name, default in defaults.items()}
    if values["base"] not in ("free", "fixed"):
        raise InputError(f"The argument 'base' is {shown(values['base'])}.", remedy="It must be free or fixed.")
    return _READERS[_format(path)](path, **values), dict(values)
