"""A user's mistake becomes one line on stderr and an exit code, never a traceback."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import click

from redundancy_pin.cli.output import INTERRUPTED
from redundancy_pin.cli.wording import OPTIONS
from redundancy_pin.errors import CrossCheckError, RedundancyPinError

FAILED_CHECK = 1
"""Exit code where the command ran and what it checked does not hold."""

BAD_INPUT = 2
"""Exit code where the command could not run on what it was given."""


class OneLineErrors(click.Group):
    """A group of commands that reports every expected error in one line."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command line; see ``click.Group.main``."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
        try:
            code = super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
            sys.exit(code if isinstance(code, int) else 0)
        except click.exceptions.Exit as leaving:
            sys.exit(leaving.exit_code)
        except click.ClickException as error:
            _say(error.format_message(), hint=_where_to_look(error))
            sys.exit(BAD_INPUT)
        except CrossCheckError as error:
            _say(str(error))
            sys.exit(FAILED_CHECK)
        except RedundancyPinError as error:
            _say(str(OPTIONS.reword(error)))
            sys.exit(BAD_INPUT)
        except (click.Abort, KeyboardInterrupt):
            _say("interrupted.")
            sys.exit(INTERRUPTED)
        except BrokenPipeError:
            # the reader of a pipe has seen enough (`redundancy-pin info | head`): not an error
            sys.stdout = None
            sys.exit(0)


def _say(message: str, hint: str = "") -> None:
    line = " ".join(f"{message} {hint}".split())
    click.echo(f"error: {line}", err=True)


def _where_to_look(error: click.ClickException) -> str:
    context = getattr(error, "ctx", None)
    return f"See `{context.command_path} --help`." if context is not None else ""
