"""Platform motions by name and keys, as flags and problem files give them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import click

from redundancy_pin.arrays import checked
from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.cli.output import require_choice, require_known
from redundancy_pin.errors import InputError
from redundancy_pin.studies.case import TRAJECTORIES
from redundancy_pin.trajectory import Trajectory

_Command = TypeVar("_Command", bound=Callable[..., Any])

FLAGS = ("speed", "radius", "ramp_time", "ramp_length", "straight", "side", "alpha")
"""Keys of trajectories that are flags of their own; the rest can be written as ``name:key=value``."""


def make_trajectory(name: str, options: Mapping[str, Any]) -> Trajectory:
    """Return a trajectory by name.

    Args:
        name: one of ``TRAJECTORIES``.
        options: its keys: numbers (m, m/s, s, rad), and lists of numbers.

    Raises:
        InputError: an unknown name or key, a missing key, or a value out of its domain.
    """
    make = TRAJECTORIES[require_choice(name, tuple(TRAJECTORIES), "the trajectory")]
    signature = inspect.signature(make)
    where = f"the trajectory {name}"
    require_known(options, tuple(signature.parameters), where)
    for key, parameter in signature.parameters.items():
        if parameter.default is inspect.Parameter.empty and key not in options:
            raise InputError(f"The trajectory {name} lacks the key {key!r}.", remedy=f"Add {key}.", key=key)
    return make(**{key: _value(key, value, where) for key, value in options.items()})


def parse_trajectory(text: str, flags: Mapping[str, float | None]) -> Trajectory:
    """Return the trajectory that ``name`` or ``name:key=value,...`` and flags describe together.

    Raises:
        InputError: as ``make_trajectory``, a pair that cannot be read, or a key given twice.
    """
    name, texts = split_trajectory(text)
    options = {key: trajectory_value(key, value, f"the trajectory {name}") for key, value in texts.items()}
    given = {key: value for key, value in flags.items() if value is not None}
    known = inspect.signature(TRAJECTORIES[name]).parameters if name in TRAJECTORIES else given
    for key in given:
        flag = f"--{key.replace('_', '-')}"
        if key in options:
            raise InputError(f"{key} of the {name} is given twice.", remedy=f"Leave {flag} or {key}= out.", key=key)
        if key not in known:
            raise InputError(f"The trajectory {name} takes no {flag}.", remedy=f"It takes {', '.join(known)}.", key=key)
    with in_words(OPTIONS.knowing({key: f"--{key.replace('_', '-')}" for key in given})):
        return make_trajectory(name, {**options, **given})


def split_trajectory(text: str) -> tuple[str, dict[str, str]]:
    """Return the name and the options, as text, of ``name:key=value,...``.

    Raises:
        InputError: a pair that cannot be read.
    """
    name, _, rest = text.partition(":")
    options: dict[str, str] = {}
    for pair in filter(None, rest.split(",")):
        key, separator, value = pair.partition("=")
        if not separator:
            raise InputError(f"{pair!r} of the trajectory is not KEY=VALUE.", remedy="Write circle:speed=0.5.")
        options[key.strip()] = value.strip()
    return name, options


def trajectory_value(key: str, text: str, where: str) -> Any:
    """Return a key's value from the command line: a number, true or false, a row as ``1.0 0.4``, or rows between ``;``.

    Args:
        key: the key.
        text: its value as written.
        where: what takes it, for messages.

    Raises:
        InputError: none of these.
    """
    if text in ("true", "false"):
        return text == "true"
    try:
        if ";" in text:
            return [[float(number) for number in row.split()] for row in text.split(";") if row.strip()]
        row = [float(number) for number in text.split()]
    except ValueError:
        row = []
    if not row:
        wanted = "Write a number, a row such as 1.0 0.4, or rows such as 1.0 0.4;1.0 0.5."
        raise InputError(f"{key} of {where} is {text!r}, neither a number nor rows.", remedy=wanted, key=key)
    return row[0] if len(row) == 1 else row


def trajectory_option(what: str) -> Callable[[_Command], _Command]:
    """Return the option ``--trajectory``; its help says what the trajectory is for."""
    return click.option(
        "--trajectory",
        metavar="NAME[:KEY=VALUE,...]",
        help=f"{what}: {', '.join(TRAJECTORIES)}; such as circle:speed=0.5, or "
        "'points:points=1.0 0.4;1.0 0.5,speed=0.1,ramp_time=0.2,alpha=0'.",
    )


def trajectory_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--trajectory``, ``--motion`` and the flags of trajectories to a command."""
    flags = {
        "--speed": "Cruising speed of the trajectory, m/s.",
        "--radius": "Corner radius, m.",
        "--ramp-time": "Duration of each speed ramp, s.",
        "--ramp-length": "Arc length of the ramp, m.",
        "--straight": "Length of each straight of the corner, m.",
        "--side": "Side of the square, m.",
        "--alpha": "Constant orientation of the platform, rad.",
    }
    for flag, text in reversed(flags.items()):
        command = click.option(flag, type=float, metavar="NUMBER", help=text)(command)
    command = click.option(
        "--motion", "motion_path", metavar="CSV", help="Motion to follow instead: columns t, x0.., xd0.., xdd0..."
    )(command)
    return trajectory_option("Trajectory to follow")(command)


def _value(key: str, value: object, where: str) -> Any:
    """Return a value as a number, a truth value or rows of numbers."""
    if isinstance(value, (bool, list)) or value is None:
        return value
    if isinstance(value, str):
        return trajectory_value(key, value, where)
    return float(checked(value, f"{key} of {where}", ()))  # type: ignore[arg-type]
