"""The command line, ``redundancy-pin``."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping

import click

from redundancy_pin import __version__
from redundancy_pin.cli.errors import OneLineErrors

__all__ = ["main"]

os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
"""No command has plugins of pydantic, which looks for them in all packages that are installed."""

COMMANDS: Mapping[str, str] = {
    "check": "Re-validate a saved plan.",
    "codegen": "Write C for a controller.",
    "export": "Write a plan for other programs.",
    "identify": "Find masses and friction from measured motions.",
    "info": "Show a robot, or which there are.",
    "inverse-dynamics": "Compute the efforts along a motion.",
    "new": "Write a robot.yaml for a model file.",
    "online": "Plan a motion as if on line.",
    "plan": "Plan the motion of the carriers.",
    "reproduce": "Run the experiments of the thesis.",
    "show": "Show a robot in motion.",
    "simulate": "Simulate a machine that is to follow a plan or a motion.",
    "singularities": "Find singularities: a map, instants of a motion.",
    "validate": "Check the dynamics on random states.",
    "workspace": "Map where the platform can go.",
}
"""Commands, each the function of its name in the file of its name (``file_of``), and what the list of commands says."""


def file_of(command: str) -> str:
    """Return the name of the module that a command is in."""
    return "saved_plan" if command in ("check", "export") else command.replace("-", "_")


class Commands(OneLineErrors):
    """The group of all commands, each of which is imported when it is run: the list of them needs none."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return their names."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None where there is none of that name."""
        if cmd_name in COMMANDS and cmd_name not in self.commands:
            module = importlib.import_module(f"{__name__}.{file_of(cmd_name)}")
            command = getattr(module, cmd_name.replace("-", "_"))
            _keep_lines(command)
            self.add_command(command)
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=Commands,
    no_args_is_help=False,  # no command at all is a mistake like any other: one line and exit code 2
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="redundancy-pin")
def main() -> None:
    """Dynamics of parallel robots with internal redundancy.

    Exit codes: 0 done, 1 a check failed, 2 bad input or no plan exists, 3 a plan breaks limits or a simulation stopped
    at an event, 4 a plan keeps limits but is no optimum, or its samples do not show its efforts, or a simulation could
    not go on (one line on stderr says what).
    """


def _keep_lines(command: click.Command) -> None:
    """Turn the two characters that raw docstrings have into the one that keeps a paragraph's lines as they stand."""
    command.help = command.help and command.help.replace("\\b\n", "\b\n")
    if isinstance(command, click.Group):
        for part in command.commands.values():
            _keep_lines(part)
