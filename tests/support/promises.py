"""What is promised, how often it was tried, and how often it failed: counted by tests, printed at the end of a run.

``build/promises.json`` keeps the counts of each test, of its last run only: the long lists may be run in pieces, and a
piece again. ``python tests/support/promises.py`` prints their sums and writes them into the table of ``docs/trust.md``,
whose rows name them in comments: ``count: files`` and ``failed: files``.
"""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
COUNTS = ROOT / "build" / "promises.json"
PAGE = ROOT / "docs" / "trust.md"

KEY = "promise"
"""Of a report's ``user_properties``, which reach the process that prints from those that test."""

LEAST = {"mutants": 0.95}
"""Share of cases that keep a promise which need not be kept by all."""

Keep = Callable[[str, str, Mapping[str, int], Mapping[str, int]], None]
"""From a promise as ``docs/trust.md`` names it, the kind of cases, counts of how they ended ("right", "refused",
"wrong"), and of the classes of what was wrong."""

Kept = dict[str, list[dict[str, Any]]]
"""What tests have noted down: promise, counts and classes, by the names of the tests."""


@pytest.fixture
def keep(request: pytest.FixtureRequest) -> Keep:
    """Note down how cases of a promise ended."""

    def note(promise: str, kind: str, counts: Mapping[str, int], classes: Mapping[str, int]) -> None:
        entry = {"promise": f"{promise}: {kind}", "counts": dict(counts), "classes": dict(classes)}
        request.node.user_properties.append((KEY, entry))

    return note


def collected(reports: Iterable[Any]) -> Kept:
    """Return what each test has noted down, by its name."""
    found: Kept = {}
    for report in reports:
        entries = [entry for key, entry in getattr(report, "user_properties", ()) if key == KEY]
        if entries and report.when == "call":
            found[report.nodeid] = entries
    return found


def summed(kept: Kept) -> dict[str, dict[str, Counter[str]]]:
    """Return the counts of each promise, summed over tests."""
    sums: dict[str, dict[str, Counter[str]]] = {}
    for entry in (entry for entries in kept.values() for entry in entries):
        parts = sums.setdefault(entry["promise"], {"counts": Counter(), "classes": Counter()})
        for part in parts:
            parts[part].update(entry[part])
    return dict(sorted(sums.items()))


def too_many(found: Mapping[str, Mapping[str, Counter[str]]]) -> list[str]:
    """Return a line for each promise of ``LEAST`` that fails too often; others fail their test the first time."""
    shares = {promise: 1.0 - sums["counts"]["wrong"] / sums["counts"].total() for promise, sums in found.items()}
    least = {promise: LEAST.get(promise.partition(":")[0], 0.0) for promise in found}
    return [
        f"too many failures: {promise}: {share:.1%} kept, less than {least[promise]:.0%}"
        for promise, share in shares.items()
        if share < least[promise]
    ]


def before() -> Kept:
    """Return what earlier runs have noted down."""
    return json.loads(COUNTS.read_text(encoding="utf-8")) if COUNTS.exists() else {}


def lines(found: Mapping[str, Mapping[str, Counter[str]]]) -> list[str]:
    """Return the table in markdown, and below it the classes of what failed."""
    rows = ["| promise | tried | right | refused | failed |", "|---|---|---|---|---|"]
    for promise, sums in found.items():
        counts = sums["counts"]
        rows.append(
            f"| {promise} | {counts.total():,} | {counts['right']:,} | {counts['refused']:,} | {counts['wrong']:,} |"
        )
    for promise, sums in found.items():
        rows += [f"failed {times} times: {promise}: {why}" for why, times in sums["classes"].most_common()]
    return rows


def summarise(terminal: Any) -> bool:
    """Print the table and the classes of failures of this run, and add its counts to the file; true if few failed."""
    kept = collected(report for reports in terminal.stats.values() for report in reports)
    if not kept:
        return True
    terminal.section("promises")
    for line in lines(summed(kept)):
        terminal.write_line(line)
    COUNTS.parent.mkdir(exist_ok=True)
    kept = {**before(), **kept}
    COUNTS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    failures = too_many(summed(kept))
    for line in failures:
        terminal.write_line(line)
    return not failures


def main() -> None:
    """Print the counts and write them into the page; what was not tried stays as it is."""
    page = PAGE.read_text(encoding="utf-8")
    tried: Counter[str] = Counter()
    failed: Counter[str] = Counter()
    found = summed(before())
    sys.stdout.write("\n".join((*lines(found), "")))
    for promise, sums in found.items():
        name = promise.partition(":")[0]
        tried[name] += sum(sums["counts"].values())
        failed[name] += sums["counts"].get("wrong", 0)
    for name in tried:
        for word, count in (("count", tried[name]), ("failed", failed[name])):
            page = re.sub(rf"\| [^|]*<!-- {word}: {name} -->", f"| {count:,} <!-- {word}: {name} -->", page)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
