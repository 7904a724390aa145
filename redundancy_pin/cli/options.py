"""Options that several commands share, and how they become a robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import click

from redundancy_pin.errors import InputError
from redundancy_pin.loading import load_robot
from redundancy_pin.robot import Robot
from redundancy_pin.studies.case import BACKENDS

_Command = TypeVar("_Command", bound=Callable[..., Any])


@dataclass(frozen=True)
class RobotOptions:
    """What the command line says about the robot.

    Attributes:
        source: name of a shipped robot or path of a declaration.
        settings: ``name=value`` pairs, xacro arguments.
        mode: working mode, a sign a leg (``"+-+"``), or None.
        gravity: ``"gx,gy,gz"``, m/s², or None.
    """

    source: str
    settings: tuple[str, ...] = ()
    mode: str | None = None
    gravity: str | None = None

    def load(self) -> Robot:
        """Load the robot.

        Raises:
            InputError: an option that cannot be read.
            RedundancyPinError: whatever ``load_robot`` raises.
        """
        arguments: dict[str, Any] = dict(parse_setting(text) for text in self.settings)
        return load_robot(
            self.source,
            gravity=None if self.gravity is None else parse_vector(self.gravity),
            working_mode=None if self.mode is None else parse_mode(self.mode),
            **arguments,
        )

    @property
    def is_plain(self) -> bool:
        """Whether nothing but the robot itself was given."""
        return not self.settings and self.mode is None and self.gravity is None


def robot_options(*, required: bool = True) -> Callable[[_Command], _Command]:
    """Add ``--robot``, ``--set``, ``--mode`` and ``--gravity`` to a command."""

    def decorate(command: _Command) -> _Command:
        for option in reversed(_robot_option_list(required)):
            command = option(command)
        return command

    return decorate


def json_option(command: _Command) -> _Command:
    """Add ``--json`` to a command (argument ``as_json``)."""
    option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout instead of text.")
    return option(command)


def backend_option(default: str | None, text: str = "How to compute.") -> Callable[[_Command], _Command]:
    """Return the option ``--backend``.

    Args:
        default: the backend where none is named; None leaves it to the command.
        text: its help.
    """
    return click.option(
        "--backend", type=click.Choice(list(BACKENDS)), default=default, show_default=default is not None, help=text
    )


def jobs_option(default: int) -> Callable[[_Command], _Command]:
    """Return the option ``--jobs``: how many processes share the work."""
    return click.option(
        "--jobs", default=default, show_default=True, metavar="N", help="Processes; -1: one for each core."
    )


def _robot_option_list(required: bool) -> list[Callable[[Any], Any]]:
    return [
        click.option(
            "--robot",
            "robot",
            required=required,
            metavar="NAME|PATH",
            help="Shipped robot (see `info`), a robot.yaml, or the folder that holds one.",
        ),
        click.option(
            "--set",
            "settings",
            multiple=True,
            metavar="NAME=VALUE",
            help="Parameter of the robot, such as carrier_mass=2.0; may be repeated.",
        ),
        click.option("--mode", metavar="SIGNS", help="Working mode, one sign a leg, such as +-+."),
        click.option("--gravity", metavar="X,Y,Z", help="Acceleration of gravity, m/s², such as 0,-9.81,0."),
    ]


def parse_setting(text: str) -> tuple[str, float | bool | str]:
    """Return name and value of ``NAME=VALUE``.

    Raises:
        InputError: text of another form, or a name that has an option of its own.
    """
    name, separator, value = text.partition("=")
    name, value = name.strip(), value.strip()
    if not (separator and name and value):
        raise InputError(f"--set {text!r} is not NAME=VALUE.", remedy="Write --set carrier_mass=2.0.", value=text)
    if name in ("gravity", "working_mode", "source"):
        instead = {"gravity": "--gravity", "working_mode": "--mode", "source": "--robot"}[name]
        raise InputError(f"--set cannot change {name}.", remedy=f"Use {instead}.", value=text)
    if value.lower() in ("true", "false"):
        return name, value.lower() == "true"
    try:
        return name, float(value)
    except ValueError:
        return name, value


def parse_mode(text: str) -> tuple[int, ...]:
    """Return the working mode that a row of signs stands for, ±1 a leg.

    Raises:
        InputError: anything but signs.
    """
    signs = {"+": 1, "-": -1}
    if not text or not set(text) <= set(signs):
        raise InputError(f"--mode {text!r} is not a row of + and -.", remedy="Write --mode +-+, one sign a leg.")
    return tuple(signs[sign] for sign in text)


def parse_vector(text: str) -> tuple[float, ...]:
    """Return gravity from ``X,Y,Z``, m/s².

    Raises:
        InputError: not three numbers.
    """
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise InputError(f"--gravity {text!r} is not three numbers.", remedy="Write --gravity 0,-9.81,0 (m/s²).")
    return numbers
