"""Exit codes, and one line on stderr in place of a traceback."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import click

from redundancy_pin.errors import CrossCheckError, RedundancyPinError, did_you_mean

FAILED_CHECK = 1
"""Exit code where the command ran and what it checked does not hold."""

BAD_INPUT = 2
"""Exit code where the command could not run on what it was given."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


class OneLineErrors(click.Group):
    """A group of commands that reports every expected error in one line."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; see ``click.Group.invoke``, whose caller ends with 1 where the reader of a pipe is gone."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            sys.stdout = None
            raise click.exceptions.Exit(0) from None

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run the command line and exit with what the command returns; see ``click.Group.main``."""
        run: Callable[..., Any] = super().main
        # click's own standalone mode prints errors over several lines and ends with 1 where it is interrupted
        if not standalone_mode:
            return run(*args, standalone_mode=False, **extra)
        for stream in (sys.stdout, sys.stderr):
            # a terminal that lacks a letter shows its code: no answer is lost to an m/s²
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        try:
            code = run(*args, standalone_mode=False, **extra)
            if sys.stdout is not None:
                sys.stdout.flush()  # now, where a full disk can still be reported
            sys.exit(code if isinstance(code, int) else 0)
        except click.exceptions.Exit as leaving:
            sys.exit(leaving.exit_code)
        except click.ClickException as error:
            context = getattr(error, "ctx", None)
            hint = f" See `{context.command_path} --help`." if context is not None else ""
            message = error.format_message()
            if isinstance(error, click.NoSuchOption) and context is not None:  # click names the nearest alone
                flags = [
                    flag for one in context.command.get_params(context) for flag in (*one.opts, *one.secondary_opts)
                ]
                message = f"{error.message} {did_you_mean(error.option_name, flags)}".rstrip()
            _end(message + hint, BAD_INPUT)
        except RedundancyPinError as error:
            flag = _flag_of(error, extra.get("args") or next(iter(args), None) or sys.argv[1:])
            _end(f"{flag}{error}", FAILED_CHECK if isinstance(error, CrossCheckError) else BAD_INPUT)
        except (click.Abort, KeyboardInterrupt):
            _end("interrupted.", INTERRUPTED)
        except BrokenPipeError:
            # the reader of a pipe has seen enough (`redundancy-pin info | head`): not an error; without a stdout the
            # interpreter does not try once more, and complain, on its way out
            sys.stdout = None
            sys.exit(0)
        except OSError as error:
            # files have errors of their own, so this is stdout, on a full disk as a rule
            sys.stdout = None
            _end(f"Cannot write {error.filename or 'the output'}: {error.strerror or error}.", BAD_INPUT)
        except MemoryError:
            _end("There is not enough memory. Ask for fewer or longer steps, samples, cells or starts.", BAD_INPUT)


def printable(text: str) -> str:
    """Return a text without the codes a terminal would obey: names come from files of strangers."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def print_line(kind: str, message: str) -> None:
    """Print an error or a warning on stderr in one line: scripts read stderr by lines."""
    with suppress(OSError):  # there is no other place to say that stderr is full
        click.echo(f"{kind}: {printable(' '.join(message.split()))}", err=True)


def _flag_of(error: RedundancyPinError, given: Sequence[str]) -> str:
    """Return the flag whose value an error is about, and a colon; empty if it names none of those given."""
    name = str(next((error.details[key] for key in ("flag", "name", "argument") if key in error.details), ""))
    flag = f"--{name.replace('_', '-')}"
    is_given = any(one == flag or one.startswith(f"{flag}=") for one in given)
    return f"{flag}: " if is_given and flag not in error.message else ""


def _end(message: str, code: int) -> None:
    print_line("error", message)
    sys.exit(code)
