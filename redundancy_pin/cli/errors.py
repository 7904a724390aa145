"""A user's mistake becomes one line on stderr and an exit code, never a traceback."""

from __future__ import annotations

import io
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any

import click

from redundancy_pin._startup import INTERRUPTED
from redundancy_pin.errors import (
    CarrierLimitError,
    CrossCheckError,
    RedundancyPinError,
    SingularPoseError,
    UnreachablePoseError,
)

FAILED_CHECK = 1  # exit code where the command ran and what it checked does not hold
BAD_INPUT = 2  # exit code where the command could not run on what it was given

# names without an underscore that are no English words: wherever they stand they are names
_NO_ENGLISH = ("dt", "lam")
# names of parameters that are also words given to another one, here to the objective
_VALUES = ("carrier_force",)
_REWORDED = "reworded"  # detail of an error already reworded for the user: outer wordings leave it alone
# the part of a remedy that only the command with --unreachable can follow
_MARKED = re.compile(r", or (?:pass unreachable=|ask for unreachable samples).*$")


@dataclass(frozen=True)
class Wording:
    """How users write what the package has a name for.

    Attributes:
        names: by name in the package, how it is written: a flag (a truth value's two as ``--on/--off``) or a key.
        separator: between it and its value.
    """

    names: Mapping[str, str]
    separator: str

    def knowing(self, names: Mapping[str, str]) -> Wording:
        """Return this wording with more names, or others for the same."""
        return replace(self, names={**self.names, **names})

    def write(self, name: str, value: str) -> str:
        """Return how a value is given to a name: ``--stop after``, or ``stop: after``."""
        written, is_flag = self.names[name], self.separator == " "
        if value in ("True", "False"):
            on, _, off = written.partition("/")
            if is_flag:
                return on if value == "True" else off
            value = value.lower()
        return f"{written}{self.separator}{value}"

    def reword(self, error: RedundancyPinError) -> RedundancyPinError:
        """Return an error of the same kind that says the same in these words.

        Once reworded it is left alone further up.
        """
        if _REWORDED in error.details:
            return error
        message, remedy = _answer(error, self) or (error.message, error.remedy)
        return type(error)(self._translated(message), remedy=self._translated(remedy), **{_REWORDED: True})

    def _translated(self, text: str) -> str:
        """Replace names: those with a value (``lam = 0``), at the beginning, and those that can be nothing else."""
        # messages have names as Python writes them; a word such as `speed` is one only where it can be nothing else
        for name, written in self.names.items():
            with_value = rf"""(?<![\w-]){name} ?= ?(?:"([^"]*)"|'([^']*)'|(-?\w+(?:\.\w+)*))"""
            text = re.sub(with_value, lambda match, name=name: self.write(name, _value(match)), text)  # type: ignore[misc]
            flag = written.partition("/")[0]
            text = re.sub(rf"^{name}\b(?!-)", flag, text)
            if ("_" in name and name not in _VALUES) or name in _NO_ENGLISH:
                text = re.sub(rf"(?<![\w-]){name}\b(?!-)", flag, text)
        return text


_CHECK_RATES = "--check-rates/--no-check-rates"
OPTIONS = Wording(
    {"backend": "--backend", "working_mode": "--mode", "gravity": "--gravity", "check_rates": _CHECK_RATES}, " "
)
"""The options that commands share."""

KEYS = Wording({"backend": "backend", "working_mode": "mode", "check_rates": "check_rates"}, ": ")
"""The keys of a problem file."""


@contextmanager
def in_words(wording: Wording) -> Iterator[None]:
    """Errors raised in the block are reworded."""
    try:
        yield
    except RedundancyPinError as error:
        raise wording.reword(error) from error


def _value(match: re.Match[str]) -> str:
    return next(part for part in match.groups() if part is not None)


def _answer(error: RedundancyPinError, wording: Wording) -> tuple[str, str] | None:
    """Return message and remedy of errors that need other words than the package's; None for all others."""
    details: Mapping[str, Any] = error.details
    # what an error is about is known by its details, not by its text, which may change
    if "axes" in details:
        return _other_motion(details)
    if "legs" in details:
        return _other_mode(details, wording)
    if "plan_robot" in details:
        return error.message, _other_robot(details)
    if "closed_form" in details:
        return error.message, f"Write {wording.write('backend', 'rnea')}, which covers every robot."
    if isinstance(error, (UnreachablePoseError, SingularPoseError)):
        mark = f", or write {wording.write('unreachable', 'mark')}." if "unreachable" in wording.names else "."
        return error.message, _MARKED.sub(mark, error.remedy)
    if isinstance(error, CarrierLimitError):
        return error.message, error.remedy.partition(";")[0].rstrip(".") + "."
    return None


def _other_robot(details: Mapping[str, Any]) -> str:
    """Say how the robot of a plan or a simulation is named; what Python passes as ``robot=`` has no flag."""
    in_python = "show it there, with its robot: rp.show(plan, robot=robot)"
    return {
        "outside": f"Where you trust that robot, name it: --robot {shlex.quote(str(details.get('source', '')))}.",
        "gone": "Name its robot.yaml where it is now: --robot robot.yaml.",
        "changed": f"Plan again, or name the robot as it was, --robot robot.yaml; one changed in Python: {in_python}.",
        "python": f"{in_python[0].upper()}{in_python[1:]}.",
    }[str(details["plan_robot"])]


def _other_motion(details: Mapping[str, Any]) -> tuple[str, str]:
    axes, robot = details["axes"], details["robot"]
    given = "poses" if details["given_poses"] else f"{details['given']} coordinates"
    moves = "through poses" if details["poses"] else f"in {len(axes)} ({', '.join(axes)})"
    return f"The motion has {given}, but {robot} moves {moves}.", _motions(len(axes), is_pose=details["poses"])


def _motions(coordinates: int, *, is_pose: bool) -> str:
    """Say which motions have so many coordinates."""
    if is_pose:
        columns = "x0 to x6 (position and unit quaternion x, y, z, w), xd0 to xd5 and xdd0 to xdd5"
        return f"Choose the trajectory pose, or a file with {columns}."
    from redundancy_pin.trajectory.reference import PATHS, TRAJECTORIES

    fitting = [name for name in PATHS if TRAJECTORIES[name]().dimension == coordinates]
    own = f"points with {coordinates} number{'s' if coordinates > 1 else ''} a row"
    alpha = " (or 2 and alpha)" if coordinates == 3 else ""
    columns = ", ".join(f"{name}{i}" for name in ("x", "xd", "xdd") for i in range(coordinates))
    return f"Choose the trajectory {', '.join([*fitting, own])}{alpha}, or a file with the columns t, {columns}."


def _other_mode(details: Mapping[str, Any], wording: Wording) -> tuple[str, str]:
    mode, legs = wording.names["working_mode"], int(details["legs"])
    signs = "".join("+" if sign == 1 else "-" for sign in details["working_mode"])
    if not legs:
        return f"{mode} is {signs}, but the robot declares no working modes.", "Leave it out."
    example = wording.write("working_mode", "+" * legs)
    return f"{mode} is {signs}, but the robot has {legs} legs.", f"Give a sign for each, such as {example}."


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
        """Run the command line; see ``click.Group.main``."""
        run: Callable[..., Any] = super().main
        # click's own standalone mode would print errors over several lines and end with 1 where it is interrupted;
        # what a command returns is its exit code
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
            _print_line(error.format_message() + hint)
            sys.exit(BAD_INPUT)
        except CrossCheckError as error:
            _print_line(str(error))
            sys.exit(FAILED_CHECK)
        except RedundancyPinError as error:
            _print_line(str(OPTIONS.reword(error)))
            sys.exit(BAD_INPUT)
        except (click.Abort, KeyboardInterrupt):
            _print_line("interrupted.")
            sys.exit(INTERRUPTED)
        except BrokenPipeError:
            # the reader of a pipe has seen enough (`redundancy-pin info | head`): not an error; without a stdout the
            # interpreter does not try once more, and complain, on its way out
            sys.stdout = None
            sys.exit(0)
        except OSError as error:
            # files have errors of their own, so this is stdout, on a full disk as a rule
            _print_line(f"Cannot write {error.filename or 'the output'}: {error.strerror or error}.")
            sys.stdout = None
            sys.exit(BAD_INPUT)
        except MemoryError:
            _print_line("There is not enough memory. Ask for fewer or longer steps, samples, cells or starts.")
            sys.exit(BAD_INPUT)


def printable(text: str) -> str:
    """Return a text without the codes a terminal would obey: names come from files of strangers."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def _print_line(message: str) -> None:
    # one line, whatever stands in a message: scripts read stderr by lines
    with suppress(OSError):  # there is no other place to say that stderr is full
        click.echo(f"error: {printable(' '.join(message.split()))}", err=True)
