"""The command line, ``redundancy-pin``."""

from __future__ import annotations

import click

import redundancy_pin
from redundancy_pin.cli.check import check
from redundancy_pin.cli.errors import OneLineErrors
from redundancy_pin.cli.info import info
from redundancy_pin.cli.inverse_dynamics import inverse_dynamics
from redundancy_pin.cli.map import map_command
from redundancy_pin.cli.plan import plan
from redundancy_pin.cli.reproduce import reproduce
from redundancy_pin.cli.show import show
from redundancy_pin.cli.singularities import singularities
from redundancy_pin.cli.study import study
from redundancy_pin.cli.validate import validate

__all__ = ["main"]


@click.group(
    cls=OneLineErrors,
    no_args_is_help=False,  # no command at all is a mistake like any other: one line and exit code 2
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(redundancy_pin.__version__, prog_name="redundancy-pin")
def main() -> None:
    """Dynamics of parallel robots with internal redundancy.

    Exit codes: 0 done, 1 a check failed, 2 bad input or no plan exists, 3 a plan breaks limits, 4 a plan keeps them but
    is no optimum, or its samples do not show its efforts (one line on stderr says what).
    """


def _keep_lines(command: click.Command) -> None:
    """Turn the two characters that raw docstrings have into the one that keeps a paragraph's lines as they stand."""
    command.help = command.help and command.help.replace("\\b\n", "\b\n")
    if isinstance(command, click.Group):
        for part in command.commands.values():
            _keep_lines(part)


for _command in (reproduce, inverse_dynamics, singularities, plan, check, map_command, show, study, validate, info):
    main.add_command(_command)
_keep_lines(main)
