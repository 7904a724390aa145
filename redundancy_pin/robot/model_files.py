"""Files that describe a whole mechanism, loops and motors too: which there are, and how they are read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from redundancy_pin.errors import InputError, did_you_mean, shown
from redundancy_pin.robot.mechanism import Mechanism
from redundancy_pin.robot.mjcf import read_mjcf
from redundancy_pin.robot.urdf import Argument

_SUFFIXES = (".xml", ".mjcf")

DEFAULTS: Mapping[str, Argument] = {"base": "free", "keyframe": ""}
"""Arguments of such files, in place of those of a xacro file."""


def is_model_file(path: Path) -> bool:
    """Return whether a file is one of those that need no declaration, by its name."""
    return path.suffix.lower() in _SUFFIXES


def read_mechanism(path: Path, arguments: Mapping[str, object]) -> tuple[Mechanism, dict[str, Argument]]:
    """Read a model file; return what it describes, and the arguments with their values.

    Args:
        path: the file.
        arguments: ``keyframe``, the name of the one that the mechanism starts from; ``base``: "free", or "fixed" to
            hold a free body where it starts.

    Raises:
        ModelFileError: a file that cannot be read, or says what is not covered.
        InputError: another argument, or another value.
    """
    for name in arguments:
        if name not in DEFAULTS:
            remedy = f"{did_you_mean(name, DEFAULTS)}Its arguments: {', '.join(DEFAULTS)}."
            raise InputError(f"{path.name} has no argument {name!r}.", remedy=remedy, argument=name)
    values = {name: str(arguments.get(name, default)) for name, default in DEFAULTS.items()}
    if values["base"] not in ("free", "fixed"):
        raise InputError(f"The argument 'base' is {shown(values['base'])}.", remedy="It must be free or fixed.")
    return read_mjcf(path, keyframe=values["keyframe"], base=values["base"]), dict(values)
