"""Platform motions by name and keys, as flags and problem files give them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import click

from redundancy_pin.arrays import checked
from redundancy_pin.cli.keys import require_choice, require_known
from redundancy_pin.errors import InputError
from redundancy_pin.experiments.experiment import PATHS
from redundancy_pin.experiments.trajectories import TRAJECTORIES
from redundancy_pin.trajectory import Trajectory

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
    name, options = split_trajectory(text)
    for key, number in flags.items():
        if number is None:
            continue
        if key in options:
            raise InputError(f"{key} of the {name} is given twice.", remedy="Leave one of them out.", key=key)
        options[key] = number
    return make_trajectory(name, options)


def split_trajectory(text: str) -> tuple[str, dict[str, Any]]:
    """Return the name and the options, as text, of ``name:key=value,...``.

    Raises:
        InputError: a pair that cannot be read.
    """
    name, _, rest = text.partition(":")
    options: dict[str, Any] = {}
    for pair in filter(None, rest.split(",")):
        key, separator, value = pair.partition("=")
        if not separator:
            raise InputError(f"{pair!r} of the trajectory is not KEY=VALUE.", remedy="Write circle:speed=0.5.")
        options[key.strip()] = value.strip()
    return name, options


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
    return click.option(
        "--trajectory",
        metavar="NAME[:KEY=VALUE,...]",
        help=f"Trajectory to follow: {', '.join(PATHS)}; such as circle, or line:speed=0.2.",
    )(command)


def _value(key: str, value: object, where: str) -> Any:
    """Return a value as a number, a truth value or an array."""
    if isinstance(value, (bool, list)) or value is None:
        return value
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            raise InputError(
                f"{key} of {where} is {value!r}, not a number.", remedy="Write a number.", key=key
            ) from None
    return float(checked(value, f"{key} of {where}", ()))  # type: ignore[arg-type]
