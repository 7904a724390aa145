"""Malformed invocations of the command line, made from a seed and run each in a process of its own.

A refused command prints one line on stderr, ends with code 2, leaves no file behind, and takes little time and memory.
``invocation`` makes commands that are almost right: one of their values, or one of their files, is not. ``run`` forks
this process, which has imported the package already: a case takes milliseconds, and one that crashes, hangs or fills
the memory is a result and not the end of the test.

As a program it prints what went wrong, by class: ``python tests/support/malformed.py [count] [first]``.
"""

from __future__ import annotations

import random
import re
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click
import yaml
from forked import MEGABYTES, SECONDS, fork, import_all
from mutated import (
    NUMBERS,
    PROBLEM,
    motion_csv,
    saved,
    spoiled_bytes,
    spoiled_motion,
    spoiled_problem,
    stepwise_plan,
)

HANGS = 8, 60
"""Seconds of the processor, and of the clock, after which a case is ended. Right ones may run on: they are no fault."""

CODES = (0, 1, 2, 3, 4, 130)

_WORKED = re.compile("time ran out|no plan|No plan|in the way|limit")
"""In what a planner says after work: nothing is wrong with the input then, but that no plan exists."""


@dataclass(frozen=True)
class Invocation:
    """Arguments of ``redundancy-pin``, and the files they name, by name in the working folder."""

    arguments: tuple[str, ...]
    files: dict[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """How an invocation ended: its exit code, negative for a signal, and what it printed and took."""

    code: int
    stdout: str
    stderr: str
    seconds: float
    megabytes: float
    left_behind: tuple[str, ...]

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with it, by class; nothing if it ended well or was refused as it should be."""
        wrong = []
        if "Traceback" in self.stderr:
            last = self.stderr.strip().splitlines()[-1]
            wrong.append(f"traceback {last.partition(':')[0]}")
        elif self.code in (-signal.SIGALRM, -signal.SIGXCPU):
            return ()  # a right one that runs on: refused ones are judged by their time below
        elif self.code not in CODES:
            wrong.append(f"exit code {self.code}")
        elif self.code == 2:
            lines = self.stderr.splitlines()
            if len(lines) != 1 or not lines[0].startswith("error: "):
                wrong.append(f"{len(lines)} lines on stderr")
            if len(self.stderr) > 10_000:
                wrong.append("a line of more than 10,000 characters")
            if self.stdout:
                wrong.append("output of a refused command")
            if self.left_behind:
                wrong.append("files left behind")
        if self.code == 2 and not _WORKED.search(self.stderr):
            if self.seconds > SECONDS:
                wrong.append(f"more than {SECONDS:g} s")
            if self.megabytes > MEGABYTES:
                wrong.append(f"more than {MEGABYTES:g} MB")
        return tuple(wrong)


def run(invocation: Invocation, program: Callable[[Sequence[str]], object]) -> Outcome:
    """Run an invocation in a forked process, in a temporary folder with its files.

    ``program`` takes the arguments and ends by ``SystemExit``.
    """

    def body() -> int:
        program(list(invocation.arguments))
        return 0

    with tempfile.TemporaryDirectory(prefix="malformed-") as name:
        work = Path(name)
        for file, content in invocation.files.items():
            (work / file).write_bytes(content)
        ended = fork(body, work, *HANGS)
        left = sorted({entry.name for entry in work.iterdir()} - set(invocation.files))
    return Outcome(ended.code, ended.out, ended.err, ended.seconds, ended.megabytes, tuple(left))


# --- values --------------------------------------------------------------------------------------------------------

VALUES = (
    *NUMBERS, "-", "+", ".", "-1e400", "-" + "9" * 400, "10**12", "1,2", "1;2", "1 2;1e200 1e200", "$(id)", "99999",
    "1000000000000", "1e9", "4294967296", "\udcff",
)  # fmt: skip
PATHS = (
    "", " ", ".", "a" * 300, "a" * 5000, "é" * 200, "x/" * 3000, "no/such/folder/x", "~nobody-of-that-name/x",
    "folder\nname", "\udcff\udcfe", "-", "--", "con:x", "x" * 251 + ".csv", "x" * 250 + ".npz", "x" * 249 + ".html",
    "x" * 248 + ".png", "http://a/b", "file:x", "motion.csv/x", "motion.csv/x.npz", "*", "\t", "%00", "nul",
)  # fmt: skip
# only to read from: nothing outside of the working folder is ever written, not by a command with a fault either
DEVICES = ("/", "..", "~", "/dev/null", "/dev/zero", "/dev/full", "/proc/self/mem", "/proc/self/environ", "/none/x/y")
SUFFIXES = (".npz", ".csv", ".png", ".svg", ".pdf", ".html", ".txt", "", ".NPZ", ".tar.gz")

ROBOTS = ("2rpr", "3rrr", "five_bar", "four_bar", "gough")
MOTION = ("--motion", "motion.csv")
PLANNERS = ("switch-off", "stepwise", "whole-trajectory")


# --- commands ------------------------------------------------------------------------------------------------------

PATH_FLAGS = ("--robot", "--motion", "--out", "--plot", "--problem", "--plan", "--html")


def options_of(arguments: Sequence[str]) -> list[str]:
    """Return the options that take a value, of the command that arguments name."""
    from redundancy_pin.cli import main

    command: click.Command = main
    for word in arguments[:2]:
        if isinstance(command, click.Group):
            command = command.get_command(click.Context(command), word) or command
    taking = [each for each in command.params if isinstance(each, click.Option) and not each.is_flag]
    return [each.opts[0] for each in taking]


def commands(dice: random.Random) -> dict[str, list[str]]:
    """Return right commands by name: quick ones, should nothing be wrong with them.

    ``reproduce`` is none of those: any name that a folder may have makes it work for minutes, in processes of its own.
    """
    robot = dice.choice(ROBOTS)
    line = ("--robot", "2rpr", "--motion", "line")
    corner = ("--robot", "3rrr", "--working-mode", "+++", "--motion", "corner")
    return {
        "info": ["info", "--robot", robot],
        "inverse-dynamics": ["inverse-dynamics", "--robot", "2rpr", *MOTION, "--out", "out.csv"],
        "singularities": ["singularities", "--robot", "2rpr", "--motion", "circle:speed=0.5"],
        "switch-off": ["plan", "switch-off", *line, "--dt", "0.01", "--out", "a.npz"],
        "stepwise": ["plan", "stepwise", *corner, "--dt", "0.02"],
        "whole": ["plan", "whole-trajectory", *line, "--dt", "0.05", "--seconds", "5"],
        "problem": ["plan", "--problem", "p.yaml", "--out", "a.npz"],
        "show": ["show", "--robot", robot, "--html", "a.html"],
        "plan": ["show", "--plan", "plan.npz", "--html", "a.html"],
        "validate": ["validate", "--robot", robot, "--samples", "5"],
        "workspace": ["workspace", "--robot", "2rpr", "--bounds", "0:1,1:2", "--resolution", "4", "--out", "w.csv"],
    }  # fmt: skip


def invocation(dice: random.Random) -> Invocation:
    """Return one malformed invocation."""
    command = dice.choice(list(known := commands(dice)))
    arguments = known[command]
    motion = motion_csv("2rpr")
    files = {"motion.csv": motion.encode(), "p.yaml": yaml.safe_dump(PROBLEM).encode()}
    kind = dice.choice(("number", "number", "path", "file", "word"))
    if command == "problem" and kind in ("number", "file"):
        files["p.yaml"] = spoiled_problem(PROBLEM | {"planner": dice.choice(PLANNERS)}, dice)
    elif command == "plan" and kind in ("number", "file"):
        files["plan.npz"] = spoiled_bytes(saved(stepwise_plan), dice)
    elif kind == "file" and command in ("inverse-dynamics", "stepwise", "whole", "switch-off", "show", "singularities"):
        files["motion.csv"] = spoiled_motion(motion, dice)
        arguments = [
            each for each in arguments if not each.startswith(("--motion", "line", "corner", "circle", MOTION[1]))
        ]
        arguments += MOTION
    elif kind in ("number", "path"):
        fitting = [flag for flag in options_of(arguments) if (flag in PATH_FLAGS) is (kind == "path")]
        flag = dice.choice(fitting or ["--robot"])
        value = dice.choice(VALUES) if kind == "number" else dice.choice(PATHS) + dice.choice(SUFFIXES)
        if flag in ("--robot", "--motion", "--problem", "--plan") and dice.random() < 0.3:
            value = dice.choice(DEVICES)
        if flag in ("--set", "--motion") and dice.random() < 0.7:
            value = {"--set": "carrier_mass=", "--motion": "points:points="}[flag] + value
        if flag in arguments:
            arguments = list(arguments)
            arguments[arguments.index(flag) + 1] = value
        else:
            arguments = [*arguments, flag, value]
    else:
        word = dice.choice((*VALUES, *PATHS, "--", "--help=", "-h1", "---", "--no-such", "plan", "-j", "--json=1"))
        at = dice.randrange(len(arguments) + 1)
        arguments = [*arguments[:at], word, *arguments[at + dice.randrange(2) :]]
    return Invocation(tuple(arguments), files)


def tally(numbers: range, program: Callable[[Sequence[str]], object]) -> tuple[Counter[str], Counter[str]]:
    """Run the malformed invocations of these numbers and print those that went wrong.

    Returns how they ended, a case that went wrong counted once: by exit code, and by class of what went wrong.
    """
    import_all()
    ends: Counter[str] = Counter()
    faults: Counter[str] = Counter()
    for number in numbers:
        each = invocation(random.Random(f"0/{number}"))
        outcome = run(each, program)
        ends["wrong" if outcome.faults else f"ended with {outcome.code}"] += 1
        for fault in outcome.faults:
            faults[f"{fault} ({number})"] += 1
            words = [word if len(word) < 60 else f"{word[:40]}…({len(word)})" for word in each.arguments]
            tail = " | ".join(outcome.stderr.strip().splitlines()[-3:])[-400:]
            text = f"{number}: {fault}: {words}\n    {outcome.seconds:.1f} s, {outcome.megabytes:.0f} MB {tail}"
            click.echo(text.encode("ascii", "backslashreplace"))
    return ends, faults


def main() -> None:
    """Run as many as the first argument says, from the number that is the second, and print what went wrong."""
    from redundancy_pin.cli import main as program

    count, first = (int(text) for text in (*sys.argv[1:], *("300", "0")[len(sys.argv) - 1 :]))
    for counts in tally(range(first, first + count), program):
        click.echo(dict(counts.most_common()))


if __name__ == "__main__":
    main()
