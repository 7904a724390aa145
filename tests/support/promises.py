"""What is promised, how often it was tried, and how often it failed: counted by tests, printed at the end of a run.

``build/promises.jsonl`` keeps the counts of each test, a line when it ends, of which the last one counts: the long
lists may be run in pieces, at once or in turn, and a piece again. ``python tests/support/promises.py`` prints their
sums and writes them into the table of ``docs/tables/counts.md``, whose rows name them in comments: ``count: files`` and
``failed: files``.
"""

from __future__ import annotations

import functools
import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
COUNTS = ROOT / "build" / "promises.jsonl"
PAGE = ROOT / "docs" / "tables" / "counts.md"

KEY = "promise"
"""Of a report's ``user_properties``, which reach the process that prints from those that test."""

Keep = Callable[[str, str, Mapping[str, int], Mapping[str, int]], None]
"""From a promise as ``docs/tables/counts.md`` names it, the kind of cases, counts of how they ended ("right",
"refused", "wrong"), and of the classes of what was wrong."""

Kept = dict[str, list[dict[str, Any]]]
"""What tests have noted down: promise, counts and classes, by the names of the tests."""

THIS_RUN: Kept = {}


@pytest.fixture
def keep(request: pytest.FixtureRequest) -> Keep:
    """Note down how cases of a promise ended."""

    def note(promise: str, kind: str, counts: Mapping[str, int], classes: Mapping[str, int]) -> None:
        entry = {"promise": f"{promise}: {kind}", "counts": dict(counts), "classes": dict(classes)}
        request.node.user_properties.append((KEY, entry))

    return note


def note_down(report: Any) -> None:
    """Add a line with what a test has noted down to the file: at once, so that a run can be interrupted."""
    entries = [entry for key, entry in report.user_properties if key == KEY]
    if entries and report.when == "call":
        THIS_RUN[report.nodeid] = entries
        COUNTS.parent.mkdir(exist_ok=True)
        with COUNTS.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({report.nodeid: entries}) + "\n")


def done(item: pytest.Item) -> bool:
    """Return whether an earlier run has noted down that a test has failed in no case."""
    entries = before().get(item.nodeid, [])
    return bool(entries) and not any(entry["counts"].get("wrong") for entry in entries)


def summed(kept: Kept) -> dict[str, dict[str, Counter[str]]]:
    """Return the counts of each promise, summed over tests."""
    sums: dict[str, dict[str, Counter[str]]] = {}
    for entry in (entry for entries in kept.values() for entry in entries):
        parts = sums.setdefault(entry["promise"], {"counts": Counter(), "classes": Counter()})
        for part in parts:
            parts[part].update(entry[part])
    return dict(sorted(sums.items()))


@functools.cache
def before() -> Kept:
    """Return what is noted down in the file: first asked for by the end of a run, or to go on with an earlier one."""
    kept: Kept = {}
    if COUNTS.exists():
        for line in COUNTS.read_text(encoding="utf-8").splitlines():
            kept.update(json.loads(line))
    return kept


def lines(tried: Mapping[str, Mapping[str, Counter[str]]]) -> list[str]:
    """Return the table in markdown, and below it the classes of what failed."""
    rows = ["| promise | tried | right | refused | failed |", "|---|---|---|---|---|"]
    for promise, sums in tried.items():
        counts = sums["counts"]
        rows.append(
            f"| {promise} | {counts.total():,} | {counts['right']:,} | {counts['refused']:,} | {counts['wrong']:,} |"
        )
    for promise, sums in tried.items():
        rows += [f"failed {times} times: {promise}: {why}" for why, times in sums["classes"].most_common()]
    return rows


def summarise(terminal: Any) -> None:
    """Print the table and the classes of failures of this run; a promise that fails has failed its test."""
    if THIS_RUN:
        terminal.section("promises")
        for line in lines(summed(THIS_RUN)):
            terminal.write_line(line)


def main() -> None:
    """Print the counts and write them into the page; what was not tried stays as it is."""
    page = PAGE.read_text(encoding="utf-8")
    tried: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    counts = summed(before())
    sys.stdout.write("\n".join((*lines(counts), "")))
    for promise, sums in counts.items():
        name = promise.partition(":")[0]
        tried[name] += sum(sums["counts"].values())
        failed[name] += sums["counts"].get("wrong", 0)
    for name in tried:
        for word, count in (("count", tried[name]), ("failed", failed[name])):
            page = re.sub(rf"\| [^|]*<!-- {word}: {name} -->", f"| {count:,} <!-- {word}: {name} -->", page)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
