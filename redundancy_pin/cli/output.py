"""What commands print: tables for people, JSON for machines, progress as a bar on a terminal and as lines elsewhere."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from redundancy_pin.cli.errors import print_line, printable
from redundancy_pin.errors import OutputError, RedundancyPinError
from redundancy_pin.io.files import require_writable
from redundancy_pin.io.json_data import json_data
from redundancy_pin.io.summary import WIDTH, Summary
from redundancy_pin.status import ResultStatus
from redundancy_pin.visualisation.figures.style import picture_format

if TYPE_CHECKING:  # rich is imported where something is printed by it: `--help` and `--json` do without
    from rich.console import Console

Advance = Callable[[int, int, str], None]
"""Called with steps done, steps in all, and what is being done."""

EVERY = 10.0
"""Time between two lines of progress where there is no terminal, s."""

EXIT_CODES = {
    ResultStatus.OK: 0,
    ResultStatus.LIMIT_VIOLATED: 3,
    ResultStatus.UNBOUNDED: 3,
    ResultStatus.STOPPED: 3,
    ResultStatus.NOT_CONVERGED: 4,
    ResultStatus.UNRESOLVED: 4,
}
"""Exit codes by the status of a result."""


def console() -> Console:
    """Return a console on stdout; plain text of a fixed width when that is not a terminal.

    Texts of users are shown as they stand: ``[green]`` in a name is no colour, ``:a:`` no picture.
    """
    from rich.console import Console

    class Printer(Console):
        def on_broken_pipe(self) -> None:
            raise  # rich handles the error by this, and would end with 1: a reader that has seen enough is no fault

    plain: dict[str, Any] = {} if _is_terminal(sys.stdout) else {"width": WIDTH, "color_system": None}
    return Printer(markup=False, emoji=False, highlight=False, **plain)


def _is_terminal(stream: Any) -> bool:
    return stream is not None and stream.isatty()  # None where it was closed before the start


def print_json(data: Mapping[str, Any]) -> None:
    """Print one JSON document on stdout. NaN and infinity, which JSON lacks, become null."""
    click.echo(json.dumps(json_data(data), indent=2, allow_nan=False))


def report(
    as_json: bool,
    facts: Mapping[str, Any],
    *lines: str,
    by: str = "",
    files: Mapping[str, tuple[str, str | None]] | None = None,
    failed: RedundancyPinError | None = None,
    **more: Any,
) -> None:
    """Print facts, and ``more`` of them, as one JSON document; or the tables of a ``Summary``, and lines.

    The first table is printed with ``by``, such as a backend, in its title, and with rows for ``motion`` and for each
    file that was written: ``files`` has by key of the facts what it is, and its path. Facts with ``ends``, those of a
    motion through points, get a line. Each warning of a summary is a line on stderr. ``failed``, of a picture, is
    raised when all is printed.
    """
    summary = facts if isinstance(facts, Summary) else Summary(facts)
    written = dict(files or {})
    known = {**summary, **more, **{key: path for key, (_, path) in written.items()}}
    if as_json:
        print_json(known)
    else:
        if known.get("ends"):
            start, end = ("at rest" if one == "rest" else "with the rates of the samples" for one in known["ends"])
            click.echo(f"The motion through the points starts {start} and ends {end} (set by `ends`).")
        tables = [*summary.tables]
        for first in tables[:1]:
            rows = [*first.rows, *((f"{what} written to", path) for what, path in written.values() if path)]
            if more.get("motion"):
                rows.insert(1, ("motion", str(more["motion"])))
            tables[0] = replace(first, title=", ".join(filter(None, (first.title, by))), rows=rows)
        for table in tables:
            console().print(table.terminal())
        for line in lines:
            click.echo(printable(line))  # names come from files of strangers
    for text in summary.warnings:
        print_line("warning", text)
    if failed:
        raise failed


def same_file(first: str | Path, second: str | Path) -> bool:
    """Return whether two paths lead to one file that exists."""
    try:
        return os.path.samefile(Path(first).expanduser(), Path(second).expanduser())
    except (OSError, ValueError, RuntimeError):  # no such file, no such name, no such user
        return False


def require_outputs(
    out: str | None,
    suffixes: Sequence[str],
    plot: str | None = None,
    inputs: Iterable[str | Path | None] = (),
    flag: str = "--out",
) -> None:
    """Check, before the work is done, that files can be written, and are none of the inputs.

    ``out`` ends in one of the suffixes: other programs, and people, go by the name.
    """
    if out and Path(out).suffix.lower() not in suffixes:
        named = Path(out)
        # "." and "/" have no name, ".." is none
        stem = named.parent / named.stem if named.stem.strip(".") else named / "result"
        raise OutputError(
            f"{flag} {out} does not end in {' or '.join(suffixes)}.",
            remedy=f"Write {flag} {stem}{suffixes[0]}.",
            path=out,
        )
    if out:
        require_writable(out)
    if plot:
        picture_format(plot)
        require_writable(plot)
    given = [one for one in inputs if one]
    for name, path in ((flag, out), ("--plot", plot)):
        if path and any(same_file(path, one) for one in given):
            raise OutputError(f"{name} is the file {path} to read from.", remedy="Give it another name.", path=path)


def drawn(path: str | None, draw: Callable[[str], object]) -> tuple[str | None, RedundancyPinError | None]:
    """Draw a picture, page or video into a file if there is to be one; return the file, or None and the error.

    A command that computes calls this after its results are written, and hands the error to ``report``.
    """
    try:
        if path is not None:
            draw(path)
    except RedundancyPinError as error:
        return None, error
    except Exception as error:  # whatever a drawing library raises: the results are there
        message = f"{path} cannot be drawn: {type(error).__name__}: {error}"
        remedy = "The results are complete without it. Please report this error."
        return None, OutputError(message, remedy=remedy, path=path)
    return path, None


@contextmanager
def progress(title: str) -> Iterator[Advance]:
    """Show progress on stderr while the block runs: a bar if stdout and stderr are terminals, else a line now and then.

    What is yielded takes steps done, steps in all, and what is being done. The lines come every ``EVERY`` seconds, none
    for shorter work.
    """
    if not (_is_terminal(sys.stderr) and _is_terminal(sys.stdout)):
        state, ended, start = ["", ""], threading.Event(), time.monotonic()

        def note(done: int, total: int, what: str = "") -> None:
            state[:] = what, f"{done} of {total}" if total else ""

        def print_lines() -> None:
            while not ended.wait(EVERY):
                elapsed = f"{timedelta(seconds=int(time.monotonic() - start))} elapsed"
                with suppress(ValueError):  # stderr is closed
                    print_line(title, ", ".join(filter(None, (*state, elapsed))))

        watch = threading.Thread(target=print_lines, daemon=True)  # a step may take minutes
        watch.start()
        try:
            yield note
        finally:
            ended.set()
            watch.join()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True, emoji=False), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def advance(done: int, total: int, what: str = "") -> None:
            bar.update(task, completed=done, total=total, description=f"{title}: {what}" if what else title)

        yield advance
