"""Malformed invocations of the command line, made from a seed and run each in a process of its own.

A refused command prints one line on stderr, ends with code 2, leaves no file behind, and takes little time and memory.
``invocation`` makes commands that are almost right: one of their values, or one of their files, is not. ``run`` forks
this process, which has imported the package already: a case takes milliseconds, and one that crashes, hangs or fills
the memory is a result and not the end of the test.

As a program it prints what went wrong, by class: ``python tests/support/malformed.py [count] [first]``.
"""

from __future__ import annotations

import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import click
import yaml
from forked import import_all
from mutated import saved, stepwise_plan

SECONDS = 2.0
"""Of the processor, for what is refused."""

MEGABYTES = 500.0
"""Beyond what the process has when it starts, for what is refused."""

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

    ``program`` takes the arguments and ends by ``SystemExit``; 4 GB of memory is all it gets.
    """
    folder = Path(tempfile.mkdtemp(prefix="malformed-"))
    try:
        work = folder / "work"
        work.mkdir()
        for name, content in invocation.files.items():
            (work / name).write_bytes(content)
        out, err, base = folder / "out", folder / "err", folder / "base"
        sys.stdout.flush()
        sys.stderr.flush()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads: the child has none of its own to wait for
            child = os.fork()
        if child == 0:
            _in_child(invocation, program, work, out, err)
        _, status, usage = os.wait4(child, 0)
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(child, signal.SIGKILL)  # workers it may have left
        left = sorted({entry.name for entry in work.iterdir()} - set(invocation.files))
        return Outcome(
            os.waitstatus_to_exitcode(status),
            out.read_text(encoding="utf-8", errors="replace"),
            err.read_text(encoding="utf-8", errors="replace"),
            usage.ru_utime + usage.ru_stime,
            max(usage.ru_maxrss / 1024.0 - float(base.read_text(encoding="ascii")), 0.0),
            tuple(left),
        )
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _megabytes(column: int) -> float:
    """Return the virtual (0) or resident (1) memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[column])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _in_child(
    invocation: Invocation, program: Callable[[Sequence[str]], object], work: Path, out: Path, err: Path
) -> None:
    code = 99
    try:
        os.setsid()  # so that workers of the command are no workers of the test
        os.chdir(work)
        for path, stream in ((out, 1), (err, 2)):
            handle = os.open(path, os.O_WRONLY | os.O_CREAT)
            os.dup2(handle, stream)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, 0)
        sys.stdin, sys.stdout, sys.stderr = (
            os.fdopen(number, mode, encoding="utf-8", errors="backslashreplace", closefd=False)
            for number, mode in ((0, "r"), (1, "w"), (2, "w"))
        )
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(HANGS[1])
        resource.setrlimit(resource.RLIMIT_CPU, (HANGS[0], resource.RLIM_INFINITY))
        # pages of the parent that a child shares without having read them do not count for it
        work.with_name("base").write_text(repr(_megabytes(1)), encoding="ascii")
        most = int((_megabytes(0) + 4096.0) * 2**20)
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        try:
            program(list(invocation.arguments))
            code = 0
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else 0 if leaving.code is None else 1
        except BaseException:
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


# --- values --------------------------------------------------------------------------------------------------------

NUMBERS = (
    "", " ", "-", "+", ".", "nan", "-nan", "inf", "-inf", "0", "-0", "-1", "1e400", "-1e400", "1e-400", "1e308",
    "1e-308", "9" * 5000, "-" + "9" * 400, "2**1000000", "9**9**9", "10**12", "1,2", "1;2", "0x10", "1_000", "٣", "½",
    "1e", "true", "None", "[]", "1 2;1e200 1e200",
    "1 2", "1\n2", "\x1b[31m", "%s", "{0}", "$(id)", "100000", "99999", "1000000000000",
    "1.5", "-2", "1e9", "1e-9", "1e18", "4294967296", "9223372036854775808", "\udcff",
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


def _motion_rows(n: int, samples: int = 30) -> tuple[list[str], list[list[float]]]:
    """Return names and rows of a motion along x, which the 2-RPR can follow."""
    import math

    names = ["t", *(f"{name}{i}" for name in ("x", "xd", "xdd") for i in range(n))]
    rows = []
    for k in range(samples):
        t = k * 0.01
        wave = (0.05 * math.sin(t), 0.05 * math.cos(t), -0.05 * math.sin(t))
        start = (1.0, 0.5, 0.0)
        still = [0.0] * (n - 1)
        rows.append([t, start[0] + wave[0], *start[1:n], wave[1], *still, wave[2], *still])
    return names, rows


def motion_csv(n: int = 2) -> bytes:
    """Return a motion of ``n`` coordinates as CSV."""
    names, rows = _motion_rows(n)
    return "\n".join([",".join(names), *(",".join(map(repr, row)) for row in rows)]).encode() + b"\n"


def broken_csv(dice: random.Random) -> bytes:
    """Return a motion with one thing wrong with it."""
    names, rows = _motion_rows(dice.choice((1, 2, 3)))
    text = [names, *([repr(value) for value in row] for row in rows)]
    column, row = dice.randrange(len(names)), dice.randrange(1, len(text))
    header = dice.choice(
        (
            "x00",
            "x٣",
            "x99999999999999999999",
            "x" + "9" * 5000,
            "",
            "t",
            " t ",
            "xd",
            "x-1",
            "x1.0",
            "\x00",
            "X0",
            "s0",
        )
    )
    cell = dice.choice(NUMBERS)
    kinds: dict[str, Callable[[], object]] = {
        "header": lambda: text[0].__setitem__(column, header),
        "cell": lambda: text[row].__setitem__(column, cell),
        "short row": lambda: text[row].pop(),
        "long row": lambda: text[row].append("1"),
        "no rows": lambda: b",".join(name.encode() for name in names),
        "empty": lambda: b"",
        "zeros": lambda: b"\x00" * dice.choice((1, 100, 10**6)),
        "noise": lambda: dice.randbytes(dice.choice((10, 1000, 10**5))),
        "one line": lambda: b"t," + b"x" * 200_000 + b"\n1,2\n",
        "quote": lambda: b'"' + b",".join(name.encode() for name in names) + b"\n1,2\n",
        "utf-16": lambda: "\n".join(map(",".join, text)).encode("utf-16"),
        "times back": lambda: text.__setitem__(slice(1, None), text[:0:-1]),
        "times equal": lambda: [line.__setitem__(0, "0.0") for line in text[1:]],
        "swapped columns": lambda: text.__setitem__(0, dice.sample(names, len(names))),
        "other units": lambda: [
            line.__setitem__(i, repr(1000.0 * float(line[i]))) for line in text[1:] for i in range(1, 2)
        ],
        "many columns": lambda: (",".join(f"c{i}" for i in range(20_000)) + "\n" + "1," * 20_000 + "\n").encode(),
    }  # fmt: skip
    done = kinds[dice.choice(list(kinds))]()
    return done if isinstance(done, bytes) else "\n".join(map(",".join, text)).encode("utf-8", "surrogateescape")


VALUES = (
    "2001-12-14t21:59:43.10-05:00", "2001-12-14", "9" * 5000, "-" + "9" * 400, "1e400", ".inf", ".nan",
    "0x" + "f" * 2000, "null", "true", "[]", "{}", "[[[[]]]]", "!!binary aGFsbG8=", "!!set {a, b}",
    "!!python/object:os.system x", "*a", "&a 1", "'text'", '"\\u0000"', "~", "<<", "[1, [2]]", "{a: {b: c}}",
    "2**1000000", "1:30:00", "0o17", "1_000", "- 1", "=", "?", "100000", "1000000000000", "-1", "0", "1.5",
    "[" * 3000 + "]" * 3000, "é" * 300, "~nobody-of-that-name/x", "1e-320",
)  # fmt: skip
PROBLEM = {
    "planner": "switch-off",
    "robot": "2rpr",
    "set": {"carrier_mass": 2.0},
    "working_mode": "++",
    "gravity": [0, 0, 0],
    "backend": "rnea",
    "motion": {"name": "circle", "speed": 0.5},
    "parameters": {"threshold": 7, "dt": 0.01},
}


def broken_yaml(dice: random.Random) -> bytes:
    """Return a problem file with one thing wrong with it."""
    data = {key: dict(value) if isinstance(value, dict) else value for key, value in PROBLEM.items()}
    data["planner"] = dice.choice(("switch-off", "stepwise", "whole-trajectory"))
    mark, value = "MALFORMED", dice.choice(VALUES)
    inside = dice.choice([data, *(entry for entry in data.values() if isinstance(entry, dict))])
    key = dice.choice([*inside, "motion", "baseline", "backend", "set"])
    inside[key] = mark
    text = yaml.safe_dump(data, sort_keys=False)
    whole: tuple[Callable[[], bytes], ...] = (
        lambda: text.replace(f": {mark}", f": {value}").encode("utf-8", "surrogateescape"),
        lambda: text.replace(f"{key}: {mark}", f"{value}: 1").encode("utf-8", "surrogateescape"),
        lambda: dice.randbytes(1000),
        lambda: _bomb().encode(),
        lambda: b"a: &a [" + b"1," * 10**6 + b"]\n",
        lambda: text.encode() + text.encode(),
        lambda: b"# " + b"x" * 5 * 10**7,
    )
    return dice.choices(whole, weights=(12, 6, 1, 1, 1, 1, 1))[0]()


def broken(content: bytes, dice: random.Random) -> bytes:
    """Return a file with some of its bytes changed, cut off, or repeated."""
    at, much = dice.randrange(len(content)), dice.choice((1, 8, 200))
    changed = content[:at] + dice.randbytes(much) + content[at + much :]
    return dice.choice((changed, content[:at], content[at:], content + content, content[:at] * 3))


def _bomb() -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    return "\n".join(lines) + "\nplanner: *a11\nrobot: *a11\n"


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
    files = {"motion.csv": motion_csv(), "p.yaml": yaml.safe_dump(PROBLEM).encode()}
    kind = dice.choice(("number", "number", "path", "file", "word"))
    if command == "problem" and kind in ("number", "file"):
        files["p.yaml"] = broken_yaml(dice)
    elif command == "plan" and kind in ("number", "file"):
        files["plan.npz"] = broken(saved(stepwise_plan), dice)
    elif kind == "file" and command in ("inverse-dynamics", "stepwise", "whole", "switch-off", "show", "singularities"):
        files["motion.csv"] = broken_csv(dice)
        arguments = [
            each for each in arguments if not each.startswith(("--motion", "line", "corner", "circle", MOTION[1]))
        ]
        arguments += MOTION
    elif kind in ("number", "path"):
        fitting = [flag for flag in options_of(arguments) if (flag in PATH_FLAGS) is (kind == "path")]
        flag = dice.choice(fitting or ["--robot"])
        value = dice.choice(NUMBERS) if kind == "number" else dice.choice(PATHS) + dice.choice(SUFFIXES)
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
        word = dice.choice((*NUMBERS, *PATHS, "--", "--help=", "-h1", "---", "--no-such", "plan", "-j", "--json=1"))
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
